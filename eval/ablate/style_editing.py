"""Motion with something asked of its style, and what came of it (RG 7.2.1, Fig. 10).

For each feature (height of the right hand, speed and radius of both hands) and each level (low, mid, high: the 15, 50
and 85 % quantiles of training) every clip is generated with that level requested throughout, with the same seed, so
that differences between rows are paired.

What fools these figures: a hand that trembles is a fast hand; features go together in a body (raising a hand from the
hip takes it outwards), so that a change of another feature need not be an error.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from data_module.controls import FEATURES, LEVELS, UNITS, Controls, Levels, measure, per_frame
from data_module.errors import InputError
from data_module.store import Recording, RecordingInfo, Store
from data_module.types import Array, Motion
from eval.clip.excerpts import excerpt
from gesticulator.gesticulator import Gesticulator

CLIPS = 4
SECONDS = 40.0
"""Of each clip: a control is a mean over four seconds, so this is ten of its windows."""
SHORTEST = 5.0
"""Seconds: a shorter recording holds no more than a window and is left out."""
FREE, REFERENCE = "no request", "the store's own motion"
TITLES = {"height": f"right hand height, {UNITS['height']}", "speed": f"hand speed, {UNITS['speed']}",
          "radius": f"hand radius, {UNITS['radius']}"}


def excerpts(store: Store) -> list[Recording]:
    """The middle `SECONDS` of up to `CLIPS` test recordings, one of each group, the long ones first."""
    groups: dict[str, RecordingInfo] = {}
    for info in store.of_split("test"):
        if info.seconds >= SHORTEST:
            # One recording of each group: clips of one sound or text would count as several.
            groups.setdefault(info.group or info.name, info)
    chosen = sorted(groups.values(), key=lambda info: -min(info.seconds, SECONDS))[:CLIPS]
    if not chosen:
        raise InputError(store.path, f"has no test recording of {SHORTEST:g} s or more", "build a larger store")
    return [excerpt(store.load(info.name), SECONDS) for info in chosen]


def realised(motion: Motion) -> Array:
    """[3] the features of a motion, in the order of `FEATURES`: means over all frames, nothing smoothed."""
    return np.asarray(per_frame(motion).mean(axis=0))


def figures(system: Gesticulator, clips: Sequence[Recording], levels: Levels) -> dict[str, Any]:
    """What was asked for, and what came of it.

    "values" has each row's features clip by clip, "series" the asked feature of the first clip over time (averaged over
    four seconds, as in training). Every clip is played in the habits of its own performer, with one seed.
    """
    requests = {FREE: Controls()} | {f"{feature} {level}": Controls(**{feature: levels.value(feature, level)})
                                          for feature, level in itertools.product(FEATURES, LEVELS)}
    values = {REFERENCE: np.array([realised(clip.motion) for clip in clips])}
    series: dict[str, Any] = {}
    for name, controls in requests.items():
        motions = [system(clip.speech, speaker=clip.info.speaker, controls=controls, seed=0).motion for clip in clips]
        values[name] = np.array([realised(motion) for motion in motions])
        series[name] = {"fps": motions[0].fps, "values": measure(motions[0]).T.round(4).tolist()}
    return {
        "clips": [{"name": clip.info.name} for clip in clips],
        "asked": {feature: {level: levels.value(feature, level) for level in LEVELS} for feature in FEATURES},
        "values": {name: dict(zip(FEATURES, of.T.tolist(), strict=True)) for name, of in values.items()},
        "series": series, "beside": {"free": FREE, "store": REFERENCE}, "titles": TITLES}
