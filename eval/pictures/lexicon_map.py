"""What is in the lexicon, for the eye (RG Fig. 6): `gesticulator draw lexicon --data STORE --out FOLDER`.

`latents.png` and `latents.svg`: t-SNE (van der Maaten and Hinton 2008) of the latents of blocks (E(M), or the weighted
coefficients of a lexicon of movements), coloured by lexeme. What fools it: t-SNE tears and clumps; only who is near
whom means anything, so the share of nearest neighbours with the same lexeme is printed, in the picture and among the
latents themselves.

`lexicon.html`, one page with nothing outside it: for each lexeme a sample gesture (the performed block whose latent
lies nearest to it) beside what the decoder makes of it (a movement begins where the training block nearest to it
began), how often each performer uses it, how fast the hands are, how much of it lies in pauses, the words and the
strokes that go with it, what the hands do in words, and whether it is silent. `lexemes.png` has the most used ones in a
picture, each at its start, middle and end. Ticking that writes the command that tells the bundle so
(`gesticulator bundle silent`). `lexicon.json` has the same in numbers. What fools it: the decoder alone has never been
made to move smoothly, so a decoded lexeme may tremble where the block did not; the speed that counts is the performed
one.
"""

from __future__ import annotations

import argparse
import json
import math
import shlex
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

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
from eval.pictures.lexicon_page import LexemeEntry, LexemeWord, page, pictures
from eval.pictures.lexicon_sheet import MOST, in_words, sheet
from eval.pictures.strips import save_strip
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.features import representation_of
from gesticulator.bundle.files import NAMED, bundle_folder
from lexicon.movement import MovementLexicon

LEAST, SURE, PRIOR = 5, 3.0, 500.0
"""A word is listed when it stands on a lexeme's blocks this often and this many standard errors too often; the strength
of the prior in words."""
MOST_WORDS, MOST_STROKES = 6, 3
NO_STROKE = "no stroke"


# ---------------------------------------------------------------------------------------------- what goes with it

def distinctive(counts: NDArray[np.int64], vocabulary: Sequence[str], least: int = LEAST, sure: float = SURE,
                most: int = MOST_WORDS) -> list[tuple[LexemeWord, ...]]:
    """For each lexeme the words that stand on its blocks more often than on others.

    counts: [S, W] of words on the blocks of each lexeme. The measure is the z-score of the difference in log odds
    between the lexeme and all others, with a Dirichlet prior in proportion to the whole (Monroe, Colaresi and Quinn
    2008), which keeps rare words from coming out on top. Words with fewer than `least` or below `sure` are left out.
    """
    total, per_word = counts.sum(), counts.sum(axis=0)
    prior = PRIOR * per_word / max(total, 1)
    here, here_all = counts + prior, counts.sum(axis=1, keepdims=True) + PRIOR
    rest, rest_all = per_word - counts + prior, total - counts.sum(axis=1, keepdims=True) + PRIOR
    with np.errstate(divide="ignore", invalid="ignore"):
        difference = np.log(here / (here_all - here)) - np.log(rest / (rest_all - rest))
        z = difference / np.sqrt(1 / here + 1 / rest)
    z = np.where((counts >= least) & np.isfinite(z), z, -np.inf)
    chosen = [[w for w in np.argsort(-row, kind="stable")[:most] if row[w] >= sure] for row in z]
    return [tuple(LexemeWord(vocabulary[w], int(counts[lexeme, w]), float(z[lexeme, w])) for w in own)
            for lexeme, own in enumerate(chosen)]


def words_on_blocks(recording: Recording, edges: Array) -> list[tuple[int, str]]:
    """(block, word in lower case without its punctuation) for each word whose middle lies in a block."""
    out = []
    for word in recording.speech.words or ():
        text = word.text.lower().strip(" .,;:!?\"'“”‘’„«»()[]-–—…¿¡")
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


@dataclass(frozen=True)
class Sample:
    """The performed block nearest to a lexeme: squared distance of its latent, where it is from, and its motion."""

    distance: float
    source: str
    motion: Motion


class Survey:
    """Counts over recordings, one at a time."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.blocks: dict[str, Array] = {}
        self.silent, self.seconds, self.way = np.zeros(size), np.zeros(size), np.zeros(size)
        self.words: Counter[tuple[int, str]] = Counter()
        self.strokes: Counter[tuple[int, str]] = Counter()
        self.samples: dict[int, Sample] = {}

    def add(self, recording: Recording, blocks: Blocks, labels: Labels, distances: Array) -> None:
        """Count one recording, whose blocks have these labels [N] and lie this far (squared) from their lexemes [N]."""
        name = recording.info.speaker
        self.blocks[name] = self.blocks.get(name, np.zeros(self.size)) + np.bincount(labels, minlength=self.size)
        self.silent += np.bincount(labels[blocks.silent], minlength=self.size)
        speed = hand_speeds(recording.motion).mean(axis=1)
        own = labels[block_of_frames(blocks.edges, len(speed), recording.motion.fps)]
        self.way += np.bincount(own, speed, self.size)
        self.seconds += np.bincount(own, minlength=self.size)
        self.words.update((int(labels[block]), text) for block, text in words_on_blocks(recording, blocks.edges))
        self.strokes.update((int(label), kind) for label, kind in
                            zip(labels, strokes_on_blocks(recording, blocks.edges), strict=False))
        for lexeme in np.unique(labels).tolist():
            nearest = int(np.where(labels == lexeme, distances, np.inf).argmin())
            known = self.samples.get(lexeme)
            if known is None or distances[nearest] < known.distance:
                start, end = blocks.edges[nearest:nearest + 2]
                self.samples[lexeme] = Sample(float(distances[nearest]), f"{recording.info.name}, {start:.2f} s",
                                              _stretch(recording.motion, start, end))

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
                      {name: float(own[i] / max(own.sum(), 1)) for name, own in sorted(self.blocks.items())},
                      float(speed[i]), float(decoded_speed[i]), float(self.silent[i] / max(total[i], 1)), words[i],
                      self._strokes_of(i), self.samples[i].source if i in self.samples else "")
                for i in range(self.size)]

    def _strokes_of(self, lexeme: int) -> dict[str, float]:
        own = Counter({kind: count for (label, kind), count in self.strokes.items() if label == lexeme})
        return {kind: count / own.total() for kind, count in own.most_common(MOST_STROKES)}


def _stretch(motion: Motion, start: float, end: float) -> Motion:
    first = max(0, math.floor(start * motion.fps))
    return motion.crop(first, max(first + 2, math.ceil(end * motion.fps) + 1))


@torch.no_grad()
def decoded(bundle: Bundle) -> list[Motion]:
    """Each lexeme through the decoder, on the mean pose of all performers: K frames of normalised time.

    A movement begins where the training block nearest to it began: its first frame is the pose before that block.
    """
    lexicon = bundle.block_models.lexicon
    blocks = lexicon.shown()
    if isinstance(lexicon, MovementLexicon):
        blocks = torch.cat([lexicon.examples[:, -1:], blocks], dim=1)
    poses = blocks.double().numpy() * bundle.statistics.deviation + bundle.statistics.mean_pose.mean(axis=0)
    representation = representation_of(bundle.config)
    return [representation.motion(own, bundle.config.rhythm.fps) for own in poses]


# --------------------------------------------------------------------------------------------------- the command

def survey(bundle: Bundle, store: Store, infos: Sequence[RecordingInfo], progress: bool = True
           ) -> tuple[Survey, Array, Labels]:
    """Everything counted, and the latents [N, D] and labels [N] of all blocks."""
    counts, latents, labels = Survey(bundle.config.lexicon.size), [], []
    for info in tqdm(infos, desc="recordings", disable=not progress):
        recording = store.load(info.name, bundle.config.motion.joints)
        blocks = cut(recording.speech, bundle.config.rhythm)
        read = encode_motion(bundle, recording.motion, blocks, info.speaker)
        nearest = bundle.vectors[torch.as_tensor(read.labels)]
        counts.add(recording, read.blocks, read.labels, (read.latents - nearest).square().sum(1).double().numpy())
        latents.append(read.latents.double().numpy())
        labels.append(read.labels)
    return counts, np.concatenate(latents), np.concatenate(labels)


def write_map(bundle: Bundle, folder: str | None, store: Store, infos: Sequence[RecordingInfo], out: Path,
              points: int = 4000, progress: bool = True) -> dict[str, Any]:
    """Both pictures, the page and its numbers into the folder `out`; the numbers."""
    counts, latents, labels = survey(bundle, store, infos, progress)
    motions, size, silent = decoded(bundle), bundle.config.lexicon.size, bundle.silent.tolist()
    entries = [replace(own, does=in_words(motion)) for own, motion in zip(
        counts.entries(silent, np.array([float(hand_speeds(own).mean()) for own in motions])), motions, strict=True)]
    few = np.sort(np.random.default_rng(0).permutation(len(labels))[:points])
    flat = embed(latents[few])
    shown, true = neighbours_agree(flat, labels[few]), neighbours_agree(latents[few], labels[few])
    used = sum(own.blocks > 0 for own in entries)
    told = "movements" if isinstance(bundle.lexicon, MovementLexicon) else "E(M)"
    caption = (f"{told} by t-SNE; {used} of {size} lexemes are used, x silent\n{100 * shown:.0f} % of the "
               f"{NEIGHBOURS} nearest neighbours share the lexeme, {100 * true:.0f} % in latent space")
    out.mkdir(parents=True, exist_ok=True)
    figure = embedding_panels({caption: (flat, labels[few])}, size, silent)
    for suffix in ("png", "svg"):
        save_strip(figure, out / f"latents.{suffix}")
    order = sorted((own for own in entries if own.blocks), key=lambda own: (-own.blocks, own.lexeme))
    save_strip(sheet([own.lexeme for own in order[:MOST]], motions, [own.does for own in entries], silent),
               out / "lexemes.png", dpi=100)
    shipped = bundle_folder(folder).resolve() in {own.resolve() for own in NAMED.values()}
    command = (f"gesticulator bundle silent{'' if folder is None else ' ' + shlex.quote(str(folder))}",
               " --out my-bundle" if shipped else "")
    note = (f"{len(infos)} recordings, {len(labels)} blocks of {store.corpus}; {used} of {size} lexemes used, "
            f"{len(silent)} silent. Words: at least {LEAST} times and {SURE:g} standard errors too often. Pictures: "
            "the performed block nearest to the lexeme, and the lexeme as decoded; first to last pose faint to full, "
            "the hands' ways in eleven even dots to a ring.")
    drawings = [pictures(own, counts.samples[own.lexeme].motion if own.lexeme in counts.samples else None, motion)
                for own, motion in zip(entries, motions, strict=True)]
    write_text(out / "lexicon.html", page(entries, drawings, command, f"Lexicon of {bundle.config.name}", note))
    lexemes = [asdict(own) | {"hand_speed": own.hand_speed if own.blocks else None} for own in entries]
    result = {"recordings": len(infos), "blocks": len(labels), "points": len(few), "neighbours_in_picture": shown,
              "neighbours_in_latents": true, "lexemes": lexemes}
    write_text(out / "lexicon.json", json.dumps(result, indent=1) + "\n")
    return result


def arguments(parser: argparse.ArgumentParser) -> None:
    """What `gesticulator draw lexicon` takes."""
    parser.add_argument("--bundle", metavar="NAME|DIR", help="bundle: default, paper, or a folder (default: default)")
    parser.add_argument("--data", required=True, metavar="STORE")
    parser.add_argument("--out", required=True, type=Path, metavar="FOLDER")
    parser.add_argument("--split", default="train", choices=(*SPLITS, "all"))
    parser.add_argument("--limit", type=int, metavar="N", help="number of recordings, evenly chosen (default: all)")
    parser.add_argument("--points", type=int, default=4000, metavar="N",
                        help="number of blocks in the t-SNE (default 4000)")


def run(arguments: argparse.Namespace) -> list[Path]:
    """Draw it; the files that were written, and what they say on the screen."""
    if arguments.points < 10:
        raise InputError("--points", "must be 10 or more")
    torch.set_num_threads(1)
    store = Store.open(arguments.data)
    result = write_map(bundles.load(bundle_folder(arguments.bundle)), arguments.bundle, store,
                       evenly(store, arguments.split, arguments.limit), arguments.out, arguments.points)
    print(f"{result['blocks']} blocks, {sum(own['blocks'] > 0 for own in result['lexemes'])} of "
          f"{len(result['lexemes'])} lexemes used; {100 * result['neighbours_in_picture']:.0f} % of neighbours in the "
          f"picture share the lexeme, {100 * result['neighbours_in_latents']:.0f} % in latent space")
    return [arguments.out / name for name in ("lexicon.html", "lexemes.png", "latents.png", "latents.svg",
                                              "lexicon.json")]
