"""Which lexemes does each interpreter play? `python benchmarks/cql.py STORE [--bundle DIR] [--limit 10] [--seconds 40]`.

The middle of recordings of the validation and the test split, each gestured for by its performer, and a recording of
speech (`--speech`) by the default speaker. Of the blocks with voice: the share of the commonest lexeme (the mean over
recordings, the largest of a recording, and of all recordings together), the lexemes used, the entropy of their use
(RG Eq. 23) and the longest run of one. Of the motion: the figures that have a bound in the acceptance, held against
twice their margin (`benchmarks/speakers.py`), and each recording's Frechet distance to real people less the lstm's.

`--temperatures` adds a row of `cql` at each, by which the bundle's `selection.q_temperature` is chosen: on the
validation split, the one whose entropy is nearest to the performers'.
"""

from __future__ import annotations

import argparse
import math
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_module.speech import audio
from data_module.types import Array, Blocks
from eval import stats
from eval.acceptance.motion.bounds import BOUNDS
from eval.claim import Bound
from eval.metrics import eye
from eval.metrics.diversity import diversity, longest_run
from eval.metrics.encode import SpeechBlocks, encode_motion
from eval.metrics.eye import ReferenceSpace, common_body
from eval.runner.context import opened
from eval.runner.renderings import AcceptanceVoice, held_out_voices
from eval.table import Cell, Column, Provenance, Table, publish
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle.files import INDEX
from gesticulator.pipeline import Gesticulator

Labels = NDArray[np.int64]
FIGURES = tuple(name for name in BOUNDS if name.startswith("eye_"))
FRECHET = "eye_frechet"
ROWS: dict[str, dict[str, Any]] = {
    "lstm": {"interpreter": "lstm"}, "statistical": {"interpreter": "statistical"},
    "advantage": {"interpreter": "advantage"}, "cql": {"interpreter": "cql"},
    "cql, arg max": {"interpreter": "cql", "temperature": 0.0}}
PERFORMER = "performer"
COLUMNS = {"commonest": Column("commonest lexeme", "% of voiced blocks", 1),
           "most": Column("most of a recording", "%", 1), "pooled": Column("all recordings", "%", 1),
           "used": Column("lexemes of a recording", digits=1), "nats": Column("entropy", "nats"),
           "run": Column("longest run", digits=1), "kept": Column("bounds kept", digits=0), "of": Column("of", digits=0),
           "beyond": Column("outside of twice the margin", digits=0),
           "frechet": Column("Frechet distance less the lstm's", digits=1)}


def doubled(bound: Bound) -> Bound:
    """Twice the margin of a bound."""
    if math.isfinite(bound.low) and math.isfinite(bound.high):
        spare = 0.5 * (bound.high - bound.low)
        return Bound(bound.low - spare, bound.high + spare)
    return Bound(0.5 * bound.low, 2.0 * bound.high)


@dataclass
class Played:
    """Of one row, by recording: lexemes of voiced blocks, whole sequences, and figures for the eye."""

    voiced: list[Labels] = field(default_factory=list)
    whole: list[Labels] = field(default_factory=list)
    seen: list[Mapping[str, float]] = field(default_factory=list)

    def add(self, lexemes: Labels, blocks: Blocks, seen: Mapping[str, float]) -> None:
        """A recording."""
        self.voiced.append(lexemes[~blocks.silent[:len(lexemes)]])
        self.whole.append(lexemes)
        self.seen.append(seen)

    def frechet(self) -> Array:
        """[recordings]."""
        return np.array([one.get(FRECHET, math.nan) for one in self.seen])


def shares(lexemes: Sequence[Labels], size: int) -> Array:
    """[recordings] % of each recording's blocks that have its commonest lexeme; NaN without a block."""
    return np.array([100 * np.bincount(own, minlength=size).max() / len(own) if len(own) else math.nan
                     for own in lexemes])


def cells(played: Played, size: int, lstm: Played | None) -> dict[str, Cell]:
    """A row of the table. lstm: on the same recordings, None for its own row."""
    own = shares(played.voiced, size)
    used = [diversity(one, size) for one in played.voiced if len(one)]
    row: dict[str, Cell] = {
        "commonest": stats.mean_interval(own), "most": float(np.nanmax(own)),
        "pooled": float(shares([np.concatenate(played.voiced)], size)[0]),
        "used": stats.mean_interval([one.used for one in used]), "nats": stats.mean_interval([one.nats for one in used]),
        "run": stats.mean_interval([longest_run([one]) for one in played.whole])}
    means = {name: stats.mean(np.array([one.get(name, math.nan) for one in played.seen])) for name in FIGURES}
    known = {name: value for name, value in means.items() if math.isfinite(value)}
    row |= {"kept": float(sum(BOUNDS[name].keeps(value) for name, value in known.items())), "of": float(len(known)),
            "beyond": float(sum(not doubled(BOUNDS[name]).keeps(value) for name, value in known.items()))}
    if lstm is not None and np.isfinite(played.frechet()).any():
        row["frechet"] = stats.paired(played.frechet(), lstm.frechet())
    return row


def measured(gesticulator: Gesticulator, voices: Sequence[AcceptanceVoice], rows: Mapping[str, Mapping[str, Any]],
             space: ReferenceSpace | None) -> dict[str, Played]:
    """Every row on the voices, and the performers' own motion where it is known."""
    found = {name: Played() for name in (*rows, PERFORMER)}
    for seed, voice in enumerate(voices):
        speech = audio.resample(voice.speech, audio.SAMPLE_RATE)
        encoded = gesticulator.encode_speech(speech)
        for name, asked in rows.items():
            made = gesticulator(speech, encoded=encoded, seed=seed, speaker=voice.performer, **asked)
            found[name].add(made.lexemes, made.blocks,
                            eye.of_body(common_body(made.motion), voice.heard, made.blocks.edges, space))
        if voice.own is not None:
            heard = SpeechBlocks.of(gesticulator.bundle, voice.speech)
            read = encode_motion(gesticulator.bundle, voice.own, heard.blocks, voice.performer or "")
            found[PERFORMER].add(read.labels, heard.blocks, eye.of_body(common_body(voice.own), voice.heard, None,
                                                                        space))
    return {name: own for name, own in found.items() if own.whole}


def table(title: str, found: Mapping[str, Played], size: int, notes: Sequence[str]) -> Table:
    """Rows of one set of voices."""
    rows = {name: cells(own, size, found["lstm"] if name != "lstm" else None) for name, own in found.items()}
    return Table(title, COLUMNS, rows, "interpreter", list(notes))


def main() -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("store", help="a store built by `gesticulator build`")
    p.add_argument("--bundle", metavar="DIR", help="bundle (default: the shipped one)")
    p.add_argument("--seconds", type=float, default=40.0, help="of each recording (default 40)")
    p.add_argument("--limit", type=int, default=10, help="recordings of a split (default 10)")
    p.add_argument("--splits", nargs="*", default=["val", "test"], choices=("val", "test"))
    p.add_argument("--speech", metavar="FILE", help="also a recording by itself, such as examples/speech.flac")
    p.add_argument("--only", nargs="+", choices=tuple(ROWS), help="rows beside the lstm's (default: all)")
    p.add_argument("--temperatures", nargs="*", type=float, default=[], metavar="T", help="more rows of cql")
    p.add_argument("--out")
    a = p.parse_args()
    folder = Path(a.bundle) if a.bundle else bundles.SHIPPED
    gesticulator = Gesticulator(bundles.load(folder))
    rows = {name: asked for name, asked in ROWS.items() if a.only is None or name in ("lstm", *a.only)}
    rows |= {f"cql, T = {t:g}": {"interpreter": "cql", "temperature": t} for t in a.temperatures}
    bundle, space = gesticulator.bundle, ReferenceSpace.found()
    settings = bundle.config.selection
    about = (f"{a.limit} recordings, evenly spread over the split, {a.seconds:g} s of each, one seed; lstm, statistical and advantage at a "
             f"temperature of {settings.temperature:g}, cql at {settings.q_temperature:g} unless a row says otherwise.")
    store, _ = opened(a.store, None)
    sets = {f"{split} split": spread(held_out_voices(store, None, bundle.config.motion.joints, split, a.seconds), a.limit)
            for split in a.splits}
    if a.speech:
        sets[Path(a.speech).name] = [AcceptanceVoice(Path(a.speech).stem, audio.load_speech(a.speech), "made")]
    publish([table(title, measured(gesticulator, voices, rows, space), len(bundle.vectors), [about])
             for title, voices in sets.items()], a.out, Provenance.now(
        shlex.join(["python", "benchmarks/cql.py", *sys.argv[1:]]), folder / INDEX))


def spread(voices: Sequence[AcceptanceVoice], count: int) -> list[AcceptanceVoice]:
    """So many of them, evenly spread over all, so that every performer has a part."""
    return [voices[k] for k in np.linspace(0, len(voices) - 1, min(count, len(voices))).round().astype(int)]


if __name__ == "__main__":
    main()
