"""What a corpus plants between voice and gesture units: `python benchmarks/unit_links.py STORE [--out FILE]`.

Of each gesture unit (`Truth.phases`, cut to 4.5 s at most) of the talks that a scripted performer plays, the loudness
and the pitch range of the syllables in it are compared with the speed, range, height and reach of its hands
(`unit_styles.style_of`). All are taken against the mean of their recording, since talks differ in manner.

- effort, pitch range: correlation with the mean loudness of the syllables, and with the deviation of their pitch;
- explained: R^2 of a linear regression on both.
"""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from data_module.errors import InputError
from data_module.motion.phases import hand_places
from data_module.motion.skeletons import FINGERED
from data_module.store import Recording, Store
from data_module.truth import Truth
from data_module.types import Array
from eval import stats
from eval.table import Column, Provenance, Table, publish
from gesticulator.training.stages.planner import RATE
from gesticulator.training.stages.unit_styles import style_of
from interpreters.planner import CODE

LONGEST = 4.5
"""Seconds of a unit, at most, as in training."""
_APART = 0.05
_FEWEST = 3
"""Voiced syllables that tell a unit's pitch range, and units of a recording that are compared."""


def units_of(truth: Truth) -> Iterator[tuple[float, float]]:
    """(start, end) of the gesture units, seconds; long ones are cut into equal parts."""
    spans: list[list[float]] = []
    for phase in sorted(truth.phases, key=lambda phase: phase.start):
        if spans and phase.start <= spans[-1][1] + _APART:
            spans[-1][1] = max(spans[-1][1], phase.end)
        else:
            spans.append([phase.start, phase.end])
    for start, end in spans:
        edges = np.linspace(start, end, max(1, int(np.ceil((end - start) / LONGEST))) + 1)
        yield from zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)


def measured(recording: Recording) -> Array:
    """[units, 2 + d_z] loudness (dB), pitch range (semitones) and style of each unit, against the recording's mean."""
    assert recording.truth is not None
    hands, rows = hand_places(recording.motion, RATE), []
    for start, end in units_of(recording.truth):
        own = hands[round(start * RATE):round(end * RATE)]
        said = [s for s in recording.truth.syllables if start <= s.vowel < end]
        pitch = [s.pitch for s in said if s.pitch != 0.0]
        if len(own) > _FEWEST and len(pitch) >= _FEWEST:
            rows.append([np.mean([s.loudness for s in said]), np.std(pitch), *style_of(own)])
    units = np.array(rows).reshape(-1, 2 + len(CODE))
    return units - units.mean(axis=0) if len(units) >= _FEWEST else units[:0]


def correlation(rows: Sequence[Array], heard: int, dimension: int, chosen: Sequence[int]) -> float:
    """Correlation of a column of the voice with one of the style, over the units of the chosen recordings."""
    units = np.concatenate([rows[k] for k in chosen])
    return float(np.corrcoef(units[:, heard], units[:, 2 + dimension])[0, 1])


def explained(rows: Sequence[Array], dimension: int, chosen: Sequence[int]) -> float:
    """Percentage of the variance of a style's column that both columns of the voice explain."""
    units = np.concatenate([rows[k] for k in chosen])
    x, y = np.column_stack([np.ones(len(units)), units[:, :2]]), units[:, 2 + dimension]
    left = y - x @ np.linalg.lstsq(x, y, rcond=None)[0]
    return float(100.0 * (1.0 - left.var() / y.var()))


def table(rows: Sequence[Array]) -> Table:
    """A row for each figure of the style."""
    columns = {"effort": Column("effort, r", "", 2), "pitch": Column("pitch range, r", "", 2),
               "explained": Column("explained", "%", 1)}
    cells = {name: {"effort": stats.of_set(partial(correlation, rows, 0, k), len(rows)),
                    "pitch": stats.of_set(partial(correlation, rows, 1, k), len(rows)),
                    "explained": stats.of_set(partial(explained, rows, k), len(rows))}
             for k, name in enumerate(CODE)}
    return Table("Voice and gesture units of the corpus", columns, cells, "of the unit", [
        f"{len(rows)} recordings, {sum(map(len, rows))} units, against the mean of their recording; bootstrap 95 % "
        "intervals over recordings. These links are planted by the corpus' rules."])


def main() -> None:
    """Entry point."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("store", help="a store built by `gesticulator build performer`")
    p.add_argument("--limit", type=int, help="recordings, at most")
    p.add_argument("--out")
    a = p.parse_args()
    store = Store.open(a.store)
    played = [info for info in store.recordings if info.part in ("talk", "style", "reading")][:a.limit]
    rows = [measured(recording) for recording in (store.load(info.name, len(FINGERED)) for info in played)
            if recording.truth and recording.truth.phases]
    rows = [units for units in rows if len(units)]
    if not rows:
        raise InputError(a.store, "has no talks with gesture units and syllables", "build it as the performer")
    publish([table(rows)], a.out, Provenance.now(shlex.join(["python", "benchmarks/unit_links.py", *sys.argv[1:]])))


if __name__ == "__main__":
    main()
