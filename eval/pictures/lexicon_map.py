"""The lexicon as pictures and a table (RG Fig. 6): `gesticulator plot lexicon --data STORE --out FOLDER`.

`latents.png` and `latents.svg`: t-SNE (van der Maaten and Hinton 2008) of the latents of blocks (E(M), or the weighted
coefficients of a lexicon of movements), coloured by lexeme. What fools it: t-SNE tears and clumps; only who is near
whom means anything, so the share of nearest neighbours with the same lexeme is printed, in the picture and among the
latents themselves.

`lexemes.png`, a contact sheet: the most used lexemes as the decoder makes them, each at its start, middle and end, with
what the hands do in words (a movement begins where the training block nearest to it began). `lexicon.csv` has a row for
each lexeme: whether it is silent, how often it occurs and how often each performer uses it, how fast the hands are, and
how much of it lies in pauses. What fools it: the decoder alone has never been made to move smoothly, so a decoded
lexeme may tremble where the block did not.
"""

from __future__ import annotations

import argparse
import csv
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
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

LexemeRows = list[dict[str, str]]
"""A row for each lexeme, by column: what `lexicon.csv` holds."""


class Survey:
    """Counts over recordings, one at a time."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.blocks: dict[str, Array] = {}
        self.silent, self.frames, self.way = np.zeros(size), np.zeros(size), np.zeros(size)

    def add(self, recording: Recording, blocks: Blocks, labels: Labels) -> None:
        """Count one recording, whose blocks have these labels [N]."""
        name = recording.info.speaker
        self.blocks[name] = self.blocks.get(name, np.zeros(self.size)) + np.bincount(labels, minlength=self.size)
        self.silent += np.bincount(labels[blocks.silent], minlength=self.size)
        # Performed speed, frame by frame: blocks differ in length.
        speed = hand_speeds(recording.motion).mean(axis=1)
        of_frames = labels[block_of_frames(blocks.edges, len(speed), recording.motion.fps)]
        self.way += np.bincount(of_frames, speed, self.size)
        self.frames += np.bincount(of_frames, minlength=self.size)

    @property
    def total(self) -> Array:
        """[S] blocks of each lexeme."""
        return sum(self.blocks.values(), np.zeros(self.size))

    def table(self, silent: Sequence[int], does: Sequence[str]) -> LexemeRows:
        """The lexicon, lexeme by lexeme. does: [S] what the hands do in each; speeds in m/s, shares from 0 to 1."""
        total = self.total
        # A lexeme without a block has no speed, and no share of it lies in pauses.
        speed, paused = self.way / np.maximum(self.frames, 1), self.silent / np.maximum(total, 1)
        shares = {f"share of {name}": blocks / max(blocks.sum(), 1) for name, blocks in sorted(self.blocks.items())}
        return [{"lexeme": str(i), "silent": str(int(i in silent)), "blocks": str(int(total[i])),
                 "share": f"{total[i] / max(total.sum(), 1):.4f}", "hand_speed": f"{speed[i]:.3f}" if total[i] else "",
                 "in_silence": f"{paused[i]:.3f}", "does": does[i],
                 **{title: f"{share[i]:.4f}" for title, share in shares.items()}} for i in range(self.size)]


@torch.no_grad()
def decoded(bundle: Bundle) -> list[Motion]:
    """Each lexeme through the decoder, on the mean pose of all performers: K frames of normalised time.

    A movement begins where the training block nearest to it began: its first frame is the pose before that block.
    """
    lexicon = bundle.block_lexicon
    # In normalised time, as the lexicon was trained.
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


def as_csv(table: LexemeRows) -> str:
    """With a head."""
    text = io.StringIO()
    rows = csv.DictWriter(text, list(table[0]), lineterminator="\n")
    rows.writeheader()
    rows.writerows(table)
    return text.getvalue()


def write_map(bundle: Bundle, store: Store, infos: Sequence[RecordingInfo], out: Path, points: int) -> str:
    """Both pictures and the table into the folder `out`; a sentence on what they show."""
    counts, latents, labels = survey(bundle, store, infos)
    motions, size, silent = decoded(bundle), bundle.config.lexicon.size, bundle.silent.tolist()
    does, total = [in_words(motion) for motion in motions], counts.total
    # t-SNE grows faster than linearly in the number of points; sorted, so that the order stays that of time.
    few = np.sort(np.random.default_rng(0).permutation(len(labels))[:points])
    flat = embed(latents[few])
    agree = [100 * neighbours_agree(space, labels[few]) for space in (flat, latents[few])]
    used = int((total > 0).sum())
    latent = "movements" if isinstance(bundle.lexicon, MovementLexicon) else "E(M)"
    caption = (f"{latent} by t-SNE; {used} of {size} lexemes are used, x silent\n{agree[0]:.0f} % of the "
               f"{NEIGHBOURS} nearest neighbours share the lexeme, {agree[1]:.0f} % in latent space")
    out.mkdir(parents=True, exist_ok=True)
    figure = embedding_panels({caption: (flat, labels[few])}, size, silent)
    for suffix in ("png", "svg"):
        save_strip(figure, out / f"latents.{suffix}")
    # The most used first, without lexemes that the motion never uses.
    order = np.argsort(-total, kind="stable")[:min(MOST, used)].tolist()
    save_strip(sheet(order, motions, does, silent), out / "lexemes.png", dpi=100)
    write_text(out / "lexicon.csv", as_csv(counts.table(silent, does)))
    return (f"{len(infos)} recordings, {len(labels)} blocks of {store.corpus}; {used} of {size} lexemes used, "
            f"{len(silent)} silent; {agree[0]:.0f} % of neighbours in the picture share the lexeme, "
            f"{agree[1]:.0f} % in latent space")


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
    # t-SNE sums in another order on several threads, and the picture would differ.
    torch.set_num_threads(1)
    store = Store.open(arguments.data)
    print(write_map(bundles.load(bundle_folder(arguments.bundle)), store,
                    evenly(store, arguments.split, arguments.limit), arguments.out, arguments.points))
    return [arguments.out / name for name in ("lexemes.png", "latents.png", "latents.svg", "lexicon.csv")]
