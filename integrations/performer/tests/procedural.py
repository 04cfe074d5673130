"""Strokes by formula on the 16-joint character, and what else a performance needs without any recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from gesticulator_performer import plan
from gesticulator_performer.hands import STEADY, Manner
from gesticulator_performer.play import Played, Staging, perform
from gesticulator_performer.strokes import (
    LEFT,
    RIGHT,
    SIDES,
    PerformerBody,
    Stroke,
    StrokeSet,
    arm_joints,
    home_pose,
    measured_stroke,
    mirror,
    trunk_joints,
)
from gesticulator_performer.styles import NEUTRAL, StyleTrack
from gesticulator_performer.trunk import Segment
from gesticulator_performer.types import Spoken
from test_takes import moving

from data_module.motion import kinematics, rotation
from data_module.motion.kinematics import minimum_jerk
from data_module.motion.skeletons import CHARACTER, HIP_HEIGHT
from data_module.types import Array

PERFORMER = "puppet"
_FPS = 30.0
"""Frames per second of the clips, as of the recorded ones."""
_LEAD = 0.2
"""Seconds at rest before a clip's preparation."""
_HANGING = np.array([0.06, -0.50, 0.04])
"""Metres from the shoulder (left, up, forward) of a hand that hangs."""

# The start (ready) and the target of the left hand, metres from the left shoulder (left, up, forward); whether the
# right hand does the same in the mirror.
_REACHES: dict[str, tuple[tuple[float, float, float], tuple[float, float, float], bool]] = {
    "BeatLow": ((0.06, -0.30, 0.28), (0.06, -0.40, 0.26), False),
    "BeatMid": ((0.04, -0.16, 0.30), (0.04, -0.30, 0.34), False),
    "BeatHigh": ((0.08, 0.06, 0.30), (0.05, -0.14, 0.38), False),
    "BeatBoth": ((0.06, -0.10, 0.28), (0.08, -0.28, 0.35), True),
    "You": ((0.02, -0.24, 0.24), (-0.02, -0.16, 0.45), False),
    "Me": ((-0.02, -0.22, 0.34), (-0.12, -0.20, 0.20), False),
    "Left": ((0.02, -0.22, 0.28), (0.36, -0.14, 0.24), False),
    "Negate": ((-0.10, -0.20, 0.32), (0.22, -0.28, 0.30), True),
    "All": ((0.00, -0.28, 0.30), (0.30, -0.16, 0.34), True),
}
_PREPARATION, _STROKE, _HOLD, _BACK = 0.42, 0.28, 0.40, 0.75
"""Seconds of the phases of a clip: up, stroke, hold, back to rest."""


def _ease(times: Array, start: float, duration: float) -> Array:
    return minimum_jerk(np.clip((times - start) / duration, 0.0, 1.0)[:, None])


def _hand_path(times: Array, ready: Array, target: Array) -> Array:
    rest = _HANGING
    path = rest + (ready - rest) * _ease(times, _LEAD, _PREPARATION)
    path = path + (target - ready) * _ease(times, _LEAD + _PREPARATION - 0.06, _STROKE)
    return path + (rest - target) * _ease(times, _LEAD + _PREPARATION + _STROKE + _HOLD, _BACK)


def _two_bones(reach: Array, side: int) -> tuple[Array, Array]:
    """World rotations [T, 4] of the upper arm and the forearm that bring the hand to `reach` [T, 3] from the shoulder.
    The law of cosines gives the elbow, which points down and a little outwards."""
    sign = 1.0 if side == LEFT else -1.0
    upper, fore = (float(np.linalg.norm(CHARACTER.offsets[CHARACTER.index(SIDES[side] + part)]))
                   for part in ("ForeArm", "Hand"))
    length = np.clip(np.linalg.norm(reach, axis=-1, keepdims=True), 0.1, 0.98 * (upper + fore))
    along = reach / np.linalg.norm(reach, axis=-1, keepdims=True)
    share = (upper ** 2 + length ** 2 - fore ** 2) / (2.0 * length)
    pole = np.array([0.35 * sign, -1.0, -0.5])
    aside = pole - (along @ pole)[:, None] * along
    aside = aside / np.linalg.norm(aside, axis=-1, keepdims=True)
    elbow = share * along + np.sqrt(np.maximum(upper ** 2 - share ** 2, 1e-6)) * aside
    bone = np.array([sign, 0.0, 0.0])
    hand = along * length
    upper_arm = np.stack([rotation.between(bone, e) for e in elbow])
    forearm = np.stack([rotation.between(bone, h) for h in hand - elbow])
    return upper_arm, forearm


def _clip(paths: dict[int, Array], frames: int) -> Array:
    """Local rotations [T, J, 4] of the character with hands on paths [T, 3] from their shoulders."""
    world = np.zeros((frames, len(CHARACTER), 4))
    world[..., 0] = 1.0
    for side, path in paths.items():
        upper_arm, forearm = _two_bones(path, side)
        world[:, CHARACTER.index(SIDES[side] + "Arm")] = upper_arm
        for part in ("ForeArm", "Hand"):
            world[:, CHARACTER.index(SIDES[side] + part)] = forearm
    return rotation.continuous(kinematics.local_rotations(CHARACTER, world))


def procedural_strokes() -> StrokeSet:
    """A performer, "puppet", with three sizes of nine strokes and their mirror images; the third of each is held out.
    Lexemes: BeatLow, BeatMid, BeatHigh, You, Me, Left, Right, Negate, All."""
    flip = np.array([-1.0, 1.0, 1.0])
    frames = int((_LEAD + _PREPARATION + _STROKE + _HOLD + _BACK + 0.25) * _FPS)
    times = np.arange(frames) / _FPS
    idle = np.repeat(_HANGING[None], frames, axis=0)
    rest = _clip({LEFT: idle, RIGHT: idle * flip}, frames)[0]
    arms, trunk = arm_joints(CHARACTER), trunk_joints(CHARACTER)
    figure = PerformerBody(PERFORMER, CHARACTER, rest, np.array([0.0, HIP_HEIGHT, 0.0]), arms, trunk,
                           np.zeros((2, len(arms[0]), 3)))
    strokes: list[Stroke] = []
    for name, (ready, target, both) in _REACHES.items():
        for variant, size in enumerate((1.0, 0.88, 1.1)):
            path = _hand_path(times, _HANGING + size * (np.array(ready) - _HANGING),
                              _HANGING + size * (np.array(target) - _HANGING))
            rotations = _clip({LEFT: path, RIGHT: (path if both else idle) * flip}, frames)
            row = {"file": f"{PERFORMER}_{name}{variant + 1:02d}.bvh", "speaker": PERFORMER, "posture": "Standing",
                   "lexeme": "BeatMid" if name == "BeatBoth" else name, "emphasis": str(_LEAD + _PREPARATION + _STROKE)}
            stroke = measured_stroke(figure, row, rotations, _FPS)
            assert stroke is not None
            stroke = replace(stroke, held_out=variant == 2)
            strokes += [stroke, mirror(stroke)]
    figure = replace(figure, home=home_pose(strokes))
    return StrokeSet(tuple(strokes), {PERFORMER: figure})


def segments() -> tuple[Segment, ...]:
    """The trunks and arms of two busy people and one who waits."""
    out = []
    for seed, quiet in ((1, False), (2, False), (3, True)):
        logs = moving(30.0, seed) * (0.3 if quiet else 1.5)
        bends = np.stack([logs[:, 0], 3.0 * logs[:, 1], 3.0 * logs[:, 5]], axis=1)
        arms = 0.02 * np.stack([logs[:, 12:16].reshape(len(logs), -1)] * 2)
        out.append(Segment(f"person_{seed}", bends, arms, quiet))
    return tuple(out)


def played(spoken: Spoken, strokes: StrokeSet, seed: int, manner: Manner = STEADY, style: StyleTrack = NEUTRAL,
           performer: str = PERFORMER) -> Played:
    """A performance of `spoken`."""
    return perform(spoken, performer, strokes, Staging(manner, segments(), style), np.random.default_rng(seed))


def planned(spoken: Spoken, strokes: StrokeSet, seed: int, split: str = "train") -> tuple[plan.Planned, ...]:
    """The strokes of a performance of `spoken`."""
    rng = np.random.default_rng(seed)
    casting = plan.cast(spoken, PERFORMER, STEADY, NEUTRAL, rng)
    return plan.plan(spoken, PERFORMER, strokes, casting, rng, split)
