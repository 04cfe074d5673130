"""Which lexemes does each interpreter play? `python benchmarks/cql.py STORE [--bundle DIR] [--limit 10]`.

The middle of recordings of the validation and the test split, each gestured for by its performer, and a recording of
speech (`--speech`) by the default speaker. Of the blocks with voice: the share of the commonest lexeme (the mean over
recordings, the largest of a recording, and of all recordings together), the lexemes used, the entropy of their use
(RG Eq. 23) and the longest run of one. Of the motion: the figures that have a bound in the acceptance, held against
twice their margin (`benchmarks/speakers.py`), and each recording's Frechet distance to real people less the lstm's.

`--choices-only` generates nothing, which costs a sixth: interpreters then see the performer's motion (`cql` and
`statistical` see none, so that their lexemes are the same), and the figures of motion are left out.

`--temperatures` adds a row of `cql` at each, by which the bundle's `selection.q_temperature` is chosen: on the
validation split, the one whose entropy is nearest to the performers'.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from data_module.speech import audio
from data_module.types import Array
from eval import stats
from eval.acceptance.bounds import Bound, bounds_of
from eval.context import opened
from eval.metrics import eye
from eval.metrics.diversity import diversity, longest_run
from eval.metrics.encode import SpeechBlocks, encode_motion
from eval.metrics.eye import ReferenceSpace, common_body
from eval.renderings import AcceptanceVoice, BundleSystem, KeptRenderings, held_out_voices
from eval.table import Cell, Column, Provenance, Table, publish
from gesticulator.bundle.files import INDEX, bundle_folder
from gesticulator.pipeline import Gesticulator
from gesticulator.systems.movement import BlockToSample, FlowState

Labels = NDArray[np.int64]
BOUNDS = {name: row.bound for name, row in bounds_of("motion").items() if not row.over}
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
           "run": Column("longest run", digits=1),
           "kept": Column("bounds kept", digits=0), "of": Column("of", digits=0),
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

    def add(self, lexemes: Labels, silent: NDArray[np.bool_], seen: Mapping[str, float]) -> None:
        """A recording of N blocks."""
        self.voiced.append(lexemes[~silent[:len(lexemes)]])
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
        "used": stats.mean_interval([one.used for one in used]),
        "nats": stats.mean_interval([one.nats for one in used]),
        "run": stats.mean_interval([longest_run([one]) for one in played.whole])}
    means = {name: stats.mean(np.array([one.get(name, math.nan) for one in played.seen])) for name in FIGURES}
    known = {name: value for name, value in means.items() if math.isfinite(value)}
    if not known:
        return row
    row |= {"kept": float(sum(BOUNDS[name].keeps(value) for name, value in known.items())), "of": float(len(known)),
            "beyond": float(sum(not doubled(BOUNDS[name]).keeps(value) for name, value in known.items()))}
    if lstm is not None and np.isfinite(played.frechet()).any():
        row["frechet"] = stats.paired(played.frechet(), lstm.frechet())
    return row


def measured(ours: BundleSystem, voices: Sequence[AcceptanceVoice], rows: Mapping[str, Mapping[str, Any]],
             space: ReferenceSpace | None) -> dict[str, Played]:
    """Every row on the voices, and the performers' own motion where it is known."""
    found = {name: Played() for name in (*rows, PERFORMER)}
    for seed, voice in enumerate(voices):
        for name, asked in rows.items():
            made = ours.render(voice, seed, **asked)
            found[name].add(made.lexemes, made.silent,
                            eye.of_body(common_body(made.motion), voice.heard, made.edges, space))
        if voice.own is not None:
            blocks = SpeechBlocks.of(ours.bundle, voice.speech).blocks
            read = encode_motion(ours.bundle, voice.own, blocks, voice.performer or "")
            found[PERFORMER].add(read.labels, blocks.silent, eye.of_body(common_body(voice.own), voice.heard, None,
                                                                         space))
    return {name: own for name, own in found.items() if own.whole}


def chosen(ours: BundleSystem, voices: Sequence[AcceptanceVoice], rows: Mapping[str, Mapping[str, Any]]
           ) -> dict[str, Played]:
    """Every row on the voices without motion: each block is the performer's, or the one before where there is none."""
    found = {name: Played() for name in (*rows, PERFORMER)}
    for seed, voice in enumerate(voices):
        speech = audio.resample(voice.speech, audio.SAMPLE_RATE)
        encoded = ours.gesticulator.encode_speech(speech)
        poses: Tensor | None = None
        if voice.own is not None:
            read = encode_motion(ours.bundle, voice.own, encoded.blocks, voice.performer or "")
            poses = read.poses
            found[PERFORMER].add(read.labels, encoded.blocks.silent, {})
        for name, asked in rows.items():
            seen = Choices(encoded.blocks.edges, poses)
            with (mock.patch.object(FlowState, "sample", seen.sample),
                  mock.patch.object(Gesticulator, "to_motion", no_motion), contextlib.suppress(EnoughChosenError)):
                ours.gesticulator(speech, encoded=encoded, seed=seed, speaker=voice.performer, **asked)
            found[name].add(np.array(seen.lexemes), encoded.blocks.silent, {})
    return {name: own for name, own in found.items() if own.whole}


@dataclass
class Choices:
    """In place of the sampler of motion: keeps the lexemes, and gives the performer's blocks (edges [N + 1]; poses [N,
    K, D_m], or None)."""

    edges: Array
    poses: Tensor | None
    lexemes: list[int] = field(default_factory=list)

    @property
    def sample(self) -> Any:
        """A method in place of `FlowState.sample`: the block of this time [1, K, D_m], and no style code."""
        def sample(state: FlowState, block: BlockToSample, past: Tensor) -> tuple[Tensor, Tensor, FlowState]:
            self.lexemes.append(block.lexeme)
            at = int(np.searchsorted(self.edges, block.speech.start + 1e-6)) - 1
            return past if self.poses is None else self.poses[at:at + 1], past.new_zeros(1, 1), state

        return sample


class EnoughChosenError(Exception):
    """All lexemes are chosen, and nothing else is asked."""


def no_motion(*_: Any, **__: Any) -> None:
    """In place of what makes joint rotations of features."""
    raise EnoughChosenError


def table(title: str, found: Mapping[str, Played], size: int, notes: Sequence[str]) -> Table:
    """Rows of one set of voices."""
    rows = {name: cells(own, size, found["lstm"] if name != "lstm" else None) for name, own in found.items()}
    shown = {key: column for key, column in COLUMNS.items() if any(key in row for row in rows.values())}
    return Table(title, shown, rows, "interpreter", list(notes))


def main() -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("store", help="a store built by `gesticulator build`")
    p.add_argument("--bundle", metavar="NAME|DIR", help="bundle: default, paper, or a folder (default: default)")
    p.add_argument("--seconds", type=float, default=40.0, help="of each recording (default 40)")
    p.add_argument("--limit", type=int, default=10, help="recordings of a split (default 10)")
    p.add_argument("--splits", nargs="*", default=["val", "test"], choices=("val", "test"))
    p.add_argument("--choices-only", action="store_true", help="generate no motion")
    p.add_argument("--speech", metavar="FILE", help="also a recording by itself, such as examples/speech.flac")
    p.add_argument("--only", nargs="+", choices=tuple(ROWS), help="rows beside the lstm's (default: all)")
    p.add_argument("--temperatures", nargs="*", type=float, default=[], metavar="T", help="more rows of cql")
    p.add_argument("--work", metavar="DIR", help="work folder, in which renderings are kept (default: STORE.work)")
    p.add_argument("--out")
    a = p.parse_args()
    folder = bundle_folder(a.bundle)
    store, work = opened(a.store, a.work)
    ours = BundleSystem("ours", folder, KeptRenderings(work / "choices"))
    rows = {name: asked for name, asked in ROWS.items() if a.only is None or name in ("lstm", *a.only)}
    rows |= {f"cql, T = {t:g}": {"interpreter": "cql", "temperature": t} for t in a.temperatures}
    bundle, space = ours.bundle, ReferenceSpace.found()
    settings = bundle.config.selection
    several = f"{a.limit} recordings, evenly spread over the split, {a.seconds:g} s of each, one seed"
    temperatures = (f"lstm, statistical and advantage at a temperature of {settings.temperature:g}, cql at "
                    f"{settings.q_temperature:g} unless a row says otherwise.")
    joints = bundle.config.motion.joints
    sets = {f"{split} split": (several, held_out_voices(store, a.limit, joints, split, a.seconds, spread=True))
            for split in a.splits}
    if a.speech:
        sets[Path(a.speech).name] = ("One recording, whole, one seed", [
            AcceptanceVoice(Path(a.speech).stem, audio.load_speech(a.speech), "made")])
    tables = []
    for title, (which, voices) in sets.items():
        values = chosen(ours, voices, rows) if a.choices_only else measured(ours, voices, rows, space)
        tables.append(table(title, values, len(bundle.vectors), [f"{which}; {temperatures}"]))
    publish(tables, a.out, Provenance.now(shlex.join(["python", "benchmarks/cql.py", *sys.argv[1:]]), folder / INDEX))



if __name__ == "__main__":
    main()
