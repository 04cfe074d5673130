"""The lexicon as pictures and a table (RG Fig. 6): `gesticulator plot lexicon --data STORE --out FOLDER`.

`latents.png` and `latents.svg`: t-SNE (van der Maaten and Hinton 2008) of the latents of blocks (E(M), or the weighted
coefficients of a lexicon of movements), coloured by lexeme. What fools it: t-SNE tears and clumps; only who is near
whom means anything, so the share of nearest neighbours with the same lexeme is printed, in the picture and among the
latents themselves.

`lexemes.png`, a contact sheet: the most used lexemes as the decoder makes them, each at its start, middle and end, with
what the hands do in words (a movement begins where the training block nearest to it began). `lexicon.csv` has a row for
each lexeme: whether it is silent, how often it occurs and how often each performer uses it, how fast the hands are, how
much of it lies in pauses, and the words and the strokes that go with it. `gesticulator bundle silent` changes which
lexemes are silent. What fools it: the decoder alone has never been made to move smoothly, so a decoded lexeme may
tremble where the block did not; the performed speed is the one that counts.
"""

from __future__ import annotations

import argparse
import csv
import io
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from tqdm import tqdm

from data_module.blocks import cut
from data_module.errors import InputError
from data_module.files import write_text
from data_module.store import SPLITS, Recording, RecordingInfo, Store
from data_module.types import Array, Blocks, Motion
from eval.clip.excerpts import block_of_frames, evenly
from eval.metrics.encode import encode_motion
from eval.metrics.smoothness import hand_speeds
from eval.pictures.embedding import NEIGHBOURS, Labels, embed, embedding_panels, neighbours_agree
from eval.pictures.lexicon_sheet import MOST, in_words, sheet
from eval.pictures.strips import save_strip
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.features import representation_of
from gesticulator.bundle.files import bundle_folder
from lexicon.movement import MovementLexicon

LEAST, SURE, PRIOR = 5, 3.0, 500.0
"""A word is listed when it stands on a lexeme's blocks this often and this many standard errors too often; the strength
of the prior in words."""
MOST_WORDS, MOST_STROKES = 6, 3
NO_STROKE = "no stroke"


@dataclass(frozen=True)
class LexemeWord:
    """A word on the blocks of a lexeme: how often, and how many standard errors more often than elsewhere."""

    text: str
    count: int
    z: float


@dataclass(frozen=True)
class LexemeEntry:
    """One lexeme. share: of all blocks; shares: of each performer's; hand_speed: m/s on its blocks as performed (NaN
    where it has none); decoded_speed: m/s of the decoded lexeme in normalised time; in_silence: share of its blocks
    that lie in a pause; strokes: shares of its blocks; does: what the hands do in it as decoded, in words."""

    lexeme: int
    silent: bool
    blocks: int
    share: float
    shares: dict[str, float]
    hand_speed: float
    decoded_speed: float
    in_silence: float
    words: tuple[LexemeWord, ...]
    strokes: dict[str, float]
    does: str = ""


# ---------------------------------------------------------------------------------------------- what goes with it

def distinctive(counts: NDArray[np.int64], vocabulary: Sequence[str], least: int = LEAST, sure: float = SURE,
                most: int = MOST_WORDS) -> list[tuple[LexemeWord, ...]]:
    """For each lexeme the words that stand on its blocks more often than on others.

    counts: [S, W] of words on the blocks of each lexeme. The measure is the z-score of the difference in log odds
    between the lexeme and all others, with a Dirichlet prior in proportion to the whole (Monroe, Colaresi and Quinn
    2008), which keeps rare words from coming out on top. Words with fewer than `least` or below `sure` are left out.
    """
    total, per_word = counts.sum(), counts.sum(axis=0)
    # In proportion to the whole: a rare word needs more evidence than a common one.
    prior = PRIOR * per_word / max(total, 1)
    here, here_all = counts + prior, counts.sum(axis=1, keepdims=True) + PRIOR
    rest, rest_all = per_word - counts + prior, total - counts.sum(axis=1, keepdims=True) + PRIOR
    with np.errstate(divide="ignore", invalid="ignore"):
        difference = np.log(here / (here_all - here)) - np.log(rest / (rest_all - rest))
        z = difference / np.sqrt(1 / here + 1 / rest)
    z = np.where((counts >= least) & np.isfinite(z), z, -np.inf)
    chosen = [[w for w in np.argsort(-row, kind="stable")[:most] if row[w] >= sure] for row in z]
    return [tuple(LexemeWord(vocabulary[w], int(counts[lexeme, w]), float(z[lexeme, w])) for w in places)
            for lexeme, places in enumerate(chosen)]


def words_on_blocks(recording: Recording, edges: Array) -> list[tuple[int, str]]:
    """(block, word in lower case without its punctuation) for each word whose middle lies in a block."""
    out = []
    for word in recording.speech.words or ():
        text = word.text.lower().strip(" .,;:!?\"'“”‘’„«»()[]-–—…¿¡")
        # By the middle, so that a word counts for one block only.
        middle = (word.start + word.end) / 2
        if text and edges[0] <= middle < edges[-1]:
            out.append((int(np.searchsorted(edges, middle, side="right")) - 1, text))
    return out


def strokes_on_blocks(recording: Recording, edges: Array) -> list[str]:
    """For each block [N] the kind of stroke that its middle lies in, or `NO_STROKE`; empty without a truth."""
    if recording.truth is None or not recording.truth.strokes:
        return []
    middles, kinds = (edges[1:] + edges[:-1]) / 2, [NO_STROKE] * (len(edges) - 1)
    for stroke in recording.truth.strokes:
        for block in np.flatnonzero((middles >= stroke.start) & (middles < stroke.end)):
            kinds[block] = stroke.lexeme
    return kinds


class Survey:
    """Counts over recordings, one at a time."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.blocks: dict[str, Array] = {}
        self.silent, self.seconds, self.way = np.zeros(size), np.zeros(size), np.zeros(size)
        self.words: Counter[tuple[int, str]] = Counter()
        self.strokes: Counter[tuple[int, str]] = Counter()

    def add(self, recording: Recording, blocks: Blocks, labels: Labels) -> None:
        """Count one recording, whose blocks have these labels [N]."""
        name = recording.info.speaker
        self.blocks[name] = self.blocks.get(name, np.zeros(self.size)) + np.bincount(labels, minlength=self.size)
        self.silent += np.bincount(labels[blocks.silent], minlength=self.size)
        speed = hand_speeds(recording.motion).mean(axis=1)
        of_frames = labels[block_of_frames(blocks.edges, len(speed), recording.motion.fps)]
        self.way += np.bincount(of_frames, speed, self.size)
        self.seconds += np.bincount(of_frames, minlength=self.size)
        self.words.update((int(labels[block]), text) for block, text in words_on_blocks(recording, blocks.edges))
        self.strokes.update((int(label), kind) for label, kind in
                            zip(labels, strokes_on_blocks(recording, blocks.edges), strict=False))

    def entries(self, silent: Sequence[int], decoded_speed: Array) -> list[LexemeEntry]:
        """The lexicon, lexeme by lexeme. decoded_speed: [S] m/s."""
        total = sum(self.blocks.values(), np.zeros(self.size))
        vocabulary = sorted({text for _, text in self.words})
        place = {text: i for i, text in enumerate(vocabulary)}
        counts = np.zeros((self.size, len(vocabulary)), dtype=np.int64)
        for (lexeme, text), count in self.words.items():
            counts[lexeme, place[text]] = count
        words = distinctive(counts, vocabulary)
        speed = np.where(self.seconds > 0, self.way / np.maximum(self.seconds, 1), np.nan)
        return [LexemeEntry(i, i in silent, int(total[i]), float(total[i] / max(total.sum(), 1)),
                      {name: float(used[i] / max(used.sum(), 1)) for name, used in sorted(self.blocks.items())},
                      float(speed[i]), float(decoded_speed[i]), float(self.silent[i] / max(total[i], 1)), words[i],
                      self._strokes_of(i))
                for i in range(self.size)]

    def _strokes_of(self, lexeme: int) -> dict[str, float]:
        kinds = Counter({kind: count for (label, kind), count in self.strokes.items() if label == lexeme})
        return {kind: count / kinds.total() for kind, count in kinds.most_common(MOST_STROKES)}


@torch.no_grad()
def decoded(bundle: Bundle) -> list[Motion]:
    """Each lexeme through the decoder, on the mean pose of all performers: K frames of normalised time.

    A movement begins where the training block nearest to it began: its first frame is the pose before that block.
    """
    lexicon = bundle.block_lexicon
    blocks = lexicon.shown()
    if isinstance(lexicon, MovementLexicon):
        blocks = torch.cat([lexicon.examples[:, -1:], blocks], dim=1)
    poses = blocks.double().numpy() * bundle.statistics.deviation + bundle.statistics.mean_pose.mean(axis=0)
    representation = representation_of(bundle.config)
    return [representation.motion(pose, bundle.config.rhythm.fps) for pose in poses]


# --------------------------------------------------------------------------------------------------- the command

def survey(bundle: Bundle, store: Store, infos: Sequence[RecordingInfo]) -> tuple[Survey, Array, Labels]:
    """Everything counted, and the latents [N, D] and labels [N] of all blocks."""
    counts, latents, labels = Survey(bundle.config.lexicon.size), [], []
    for info in tqdm(infos, desc="recordings"):
        recording = store.load(info.name, bundle.config.motion.joints)
        blocks = cut(recording.speech, bundle.config.rhythm)
        read = encode_motion(bundle, recording.motion, blocks, info.speaker)
        counts.add(recording, read.blocks, read.labels)
        latents.append(read.latents.double().numpy())
        labels.append(read.labels)
    return counts, np.concatenate(latents), np.concatenate(labels)


def as_csv(entries: Sequence[LexemeEntry]) -> str:
    """A row for each lexeme; speeds in m/s, shares from 0 to 1, lists separated by "; "."""
    speakers = sorted({name for entry in entries for name in entry.shares})
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["lexeme", "silent", "blocks", "share", "hand_speed", "decoded_speed", "in_silence", "does", "words",
                   "strokes", *(f"share of {name}" for name in speakers)])
    for entry in entries:
        rows.writerow([entry.lexeme, int(entry.silent), entry.blocks, f"{entry.share:.4f}",
                       f"{entry.hand_speed:.3f}" if entry.blocks else "", f"{entry.decoded_speed:.3f}",
                       f"{entry.in_silence:.3f}", entry.does,
                       "; ".join(f"{word.text} ({word.count})" for word in entry.words),
                       "; ".join(f"{kind} {100 * share:.0f} %" for kind, share in entry.strokes.items()),
                       *(f"{entry.shares.get(name, 0.0):.4f}" for name in speakers)])
    return text.getvalue()


def write_map(bundle: Bundle, store: Store, infos: Sequence[RecordingInfo], out: Path, points: int) -> str:
    """Both pictures and the table into the folder `out`; a sentence on what they show."""
    counts, latents, labels = survey(bundle, store, infos)
    motions, size, silent = decoded(bundle), bundle.config.lexicon.size, bundle.silent.tolist()
    speeds = np.array([float(hand_speeds(motion).mean()) for motion in motions])
    entries = [replace(entry, does=in_words(motion))
               for entry, motion in zip(counts.entries(silent, speeds), motions, strict=True)]
    # t-SNE grows faster than linearly in the number of points; sorted, so that the order stays that of time.
    few = np.sort(np.random.default_rng(0).permutation(len(labels))[:points])
    flat = embed(latents[few])
    shown, true = neighbours_agree(flat, labels[few]), neighbours_agree(latents[few], labels[few])
    used = sum(entry.blocks > 0 for entry in entries)
    latent = "movements" if isinstance(bundle.lexicon, MovementLexicon) else "E(M)"
    caption = (f"{latent} by t-SNE; {used} of {size} lexemes are used, x silent\n{100 * shown:.0f} % of the "
               f"{NEIGHBOURS} nearest neighbours share the lexeme, {100 * true:.0f} % in latent space")
    out.mkdir(parents=True, exist_ok=True)
    figure = embedding_panels({caption: (flat, labels[few])}, size, silent)
    for suffix in ("png", "svg"):
        save_strip(figure, out / f"latents.{suffix}")
    order = sorted((entry for entry in entries if entry.blocks), key=lambda entry: (-entry.blocks, entry.lexeme))
    save_strip(sheet([entry.lexeme for entry in order[:MOST]], motions, [entry.does for entry in entries], silent),
               out / "lexemes.png", dpi=100)
    write_text(out / "lexicon.csv", as_csv(entries))
    return (f"{len(infos)} recordings, {len(labels)} blocks of {store.corpus}; {used} of {size} lexemes used, "
            f"{len(silent)} silent; {100 * shown:.0f} % of neighbours in the picture share the lexeme, "
            f"{100 * true:.0f} % in latent space")


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `gesticulator plot lexicon`."""
    parser.add_argument("--bundle", metavar="NAME|DIR", help="bundle: default, paper, or a folder (default: default)")
    parser.add_argument("--data", required=True, metavar="STORE")
    parser.add_argument("--out", required=True, type=Path, metavar="FOLDER")
    parser.add_argument("--split", default="train", choices=(*SPLITS, "all"))
    parser.add_argument("--limit", type=int, metavar="N", help="number of recordings, evenly chosen (default: all)")
    parser.add_argument("--points", type=int, default=4000, metavar="N",
                        help="number of blocks in the t-SNE (default 4000)")


def run(arguments: argparse.Namespace) -> list[Path]:
    """Plot it, and print a sentence on it; the files that were written."""
    if arguments.points < 10:
        raise InputError("--points", "must be 10 or more")
    torch.set_num_threads(1)
    store = Store.open(arguments.data)
    print(write_map(bundles.load(bundle_folder(arguments.bundle)), store,
                    evenly(store, arguments.split, arguments.limit), arguments.out, arguments.points))
    return [arguments.out / name for name in ("lexemes.png", "latents.png", "latents.svg", "lexicon.csv")]
