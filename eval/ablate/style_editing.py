"""Motion with something asked of its style, and what came of it (RG 7.2.1, Fig. 10).

For each feature (height of the right hand, speed and radius of both hands) and each level (low, mid, high: the 15, 50
and 85 % quantiles of training) every clip is generated with that level requested throughout, with the same seed, so
that differences between rows are paired.

What fools these figures: a hand that trembles is a fast hand, so speed is given a second time after smoothing over
50 ms; features go together in a body (raising a hand from the hip takes it outwards), so that a change of another
feature need not be an error; and fewer than about ten clips make an interval too narrow.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from tqdm import tqdm

from data_module.controls import FEATURES, LEVELS, UNITS, Controls, Levels, measure, per_frame
from data_module.errors import InputError
from data_module.motion.motion_beats import ACTING, acting_positions, acting_speed
from data_module.store import Recording, RecordingInfo, Store
from data_module.types import Array, Motion
from eval.clip.excerpts import excerpt
from eval.stats import Interval, mean_interval
from eval.table import Column
from gesticulator.gesticulator import Gesticulator

CLIPS = 8
SECONDS = 40.0
SHORTEST = 5.0
"""Seconds: a shorter recording holds no more than a window and is left out."""
FREE, REFERENCE = "no request", "the store's own motion"
SHOWN = {"height": Column("right hand height", UNITS["height"], 3), "speed": Column("hand speed", UNITS["speed"], 3),
         "radius": Column("hand radius", UNITS["radius"], 3),
         "steady_speed": Column("hand speed without tremor", UNITS["speed"], 3)}
"""Figures of every clip: the features, and the speed of the hands without tremor."""
_HAND_COLUMNS = [column for column, name in enumerate(ACTING) if name.endswith("Hand")]


Play = Callable[[Recording, Controls], Motion]
"""The system under test: motion for a recording's speech, with what is asked of its style."""


def excerpts(store: Store, count: int = CLIPS, seconds: float = SECONDS) -> list[Recording]:
    """The middle `seconds` of up to `count` test recordings, one of each group, the long ones first."""
    if count < 2:
        raise InputError(f"--clips {count}", "is too few for an interval", "give 2 or more")
    if not SHORTEST <= seconds < math.inf:
        raise InputError(f"--seconds {seconds:g}", "is out of range", f"give {SHORTEST:g} or more")
    groups: dict[str, RecordingInfo] = {}
    for info in store.of_split("test"):
        if info.seconds >= SHORTEST:
            # One recording of each group: clips of one sound or text would count as several.
            groups.setdefault(info.group or info.name, info)
    chosen = sorted(groups.values(), key=lambda info: -min(info.seconds, seconds))[:count]
    if len(chosen) < 2:
        raise InputError(store.path, f"has {len(chosen)} test recordings of {SHORTEST:g} s or more",
                         "an interval needs 2: build a larger store")
    return [excerpt(store.load(info.name), seconds) for info in chosen]


def played_by(system: Gesticulator) -> Play:
    """A bundle as one who plays: in the habits of each clip's own performer where the bundle knows them."""
    def play(clip: Recording, controls: Controls) -> Motion:
        speaker = clip.info.speaker if clip.info.speaker in system.speakers else None
        return system(clip.speech, speaker=speaker, controls=controls, seed=0).motion

    return play


def realised(motion: Motion) -> Array:
    """Figures of a motion, [4] in the order of `SHOWN`: means over all frames, nothing smoothed but the last."""
    hands = acting_positions(motion)[:, _HAND_COLUMNS]
    return np.append(per_frame(motion).mean(axis=0), acting_speed(hands, motion.fps).mean() / len(_HAND_COLUMNS))


def row_name(feature: str, level: str) -> str:
    """The name of the row in which one level of one feature is asked for."""
    return f"{feature} {level}"


def figures(play: Play, clips: Sequence[Recording], levels: Levels, *, progress: bool = False) -> dict[str, Any]:
    """Everything that is told, as plain values.

    "values" has each row's measures clip by clip, "series" the asked feature of the first clip over time (averaged over
    four seconds, as in training), "rows" means with intervals.
    """
    requests = {FREE: Controls.free()} | {row_name(feature, level): Controls(**{feature: levels.value(feature, level)})
                                       for feature, level in itertools.product(FEATURES, LEVELS)}
    values = {REFERENCE: np.array([realised(clip.motion) for clip in clips])}
    series: dict[str, Any] = {}
    for name, controls in tqdm(requests.items(), desc="style editing", disable=not progress):
        motions = [play(clip, controls) for clip in clips]
        values[name] = np.array([realised(motion) for motion in motions])
        series[name] = {"fps": motions[0].fps, "values": measure(motions[0]).T.round(4).tolist()}
    return {
        "clips": [{"name": clip.info.name, "speaker": clip.info.speaker, "seconds": round(clip.speech.duration, 2)}
                  for clip in clips],
        "asked": {feature: {level: levels.value(feature, level) for level in LEVELS} for feature in FEATURES},
        "spread": dict(zip(FEATURES, levels.spread.tolist(), strict=True)),
        "rows": {name: _intervals(of) for name, of in values.items()},
        "values": {name: dict(zip(SHOWN, of.T.tolist(), strict=True)) for name, of in values.items()},
        "series": series, "beside": {"free": FREE, "store": REFERENCE},
        "titles": {name: column.heading for name, column in SHOWN.items()}}


def _intervals(values: Array) -> dict[str, Interval]:
    return {name: mean_interval(column) for name, column in zip(SHOWN, values.T, strict=True)}
