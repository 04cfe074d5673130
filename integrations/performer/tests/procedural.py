"""Strokes by formula on the 16-joint character, and what else a performance needs without any recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from gesticulator_performer import plan
from gesticulator_performer import strokes as performed
from gesticulator_performer.joints import MIRROR
from gesticulator_performer.plan import STEADY, Manner
from gesticulator_performer.play import Played, Staging, perform
from gesticulator_performer.strokes import PerformerBody, Stroke, StrokeSet
from gesticulator_performer.syllables import Phrase, Spoken, Syllable
from gesticulator_performer.trunk import Segment
from gesticulator_performer.voices import NEUTRAL
from test_takes import hanging, moving

from data_module.motion import rotation
from data_module.motion.kinematics import minimum_jerk
from data_module.motion.skeletons import CHARACTER, HIP_HEIGHT
from data_module.types import Array, Speech, Word

PERFORMER = "puppet"
_FPS = 30.0
# Seconds at rest before a clip's preparation, and of its phases: up, stroke, hold, back to rest.
_LEAD, _PREPARATION, _STROKE, _HOLD, _BACK = 0.2, 0.42, 0.28, 0.40, 0.75

# The start (ready) and the target of the left arm, radians: the upper arm ahead and sideways, the elbow's bend; whether
# the right arm does the same in the mirror.
_REACHES: dict[str, tuple[tuple[float, float, float], tuple[float, float, float], bool]] = {
    "BeatLow": ((0.25, 0.0, 1.4), (0.15, 0.0, 1.1), False),
    "BeatMid": ((0.50, 0.0, 1.6), (0.35, 0.0, 1.2), False),
    "BeatHigh": ((0.70, 0.1, 2.0), (0.50, 0.0, 1.5), False),
    "BeatBoth": ((0.50, 0.0, 1.7), (0.35, 0.1, 1.2), True),
    "You": ((0.30, 0.0, 1.5), (0.90, 0.0, 0.7), False),
    "Me": ((0.30, 0.0, 1.6), (0.20, -0.2, 2.0), False),
    "Left": ((0.30, 0.0, 1.4), (0.40, 0.8, 1.0), False),
    "Negate": ((0.30, -0.2, 1.5), (0.30, 0.5, 1.4), True),
    "All": ((0.30, 0.0, 1.3), (0.40, 0.6, 1.2), True),
}


def _arm(ready: Array, target: Array, times: Array) -> Array:
    """Log rotations [T, 4, 3] of a left arm against its rest."""
    def ease(start: float, duration: float) -> Array:
        return minimum_jerk(np.clip((times - start) / duration, 0.0, 1.0)[:, None])

    begin = _LEAD + _PREPARATION
    bends = ready * ease(_LEAD, _PREPARATION) + (target - ready) * ease(begin - 0.06, _STROKE) \
        - target * ease(begin + _STROKE + _HOLD, _BACK)
    out = np.zeros((len(times), 4, 3))
    out[:, 1, 1], out[:, 1, 2], out[:, 2, 1] = -bends[:, 0], bends[:, 1], -bends[:, 2]
    return out


def procedural_strokes() -> StrokeSet:
    """A performer, "puppet", with three sizes of nine strokes and their mirror images; the third of each is held out.
    Lexemes: BeatLow, BeatMid, BeatHigh, You, Me, Left, Right, Negate, All."""
    times = np.arange(int((_LEAD + _PREPARATION + _STROKE + _HOLD + _BACK + 0.25) * _FPS)) / _FPS
    arms, rest = performed.arm_joints(CHARACTER), hanging()
    figure = PerformerBody(PERFORMER, CHARACTER, rest, np.array([0.0, HIP_HEIGHT, 0.0]), arms,
                           performed.trunk_joints(CHARACTER), np.zeros((2, len(arms[0]), 3)))
    strokes: list[Stroke] = []
    for name, (ready, target, both) in _REACHES.items():
        for variant, size in enumerate((1.0, 0.88, 1.1)):
            logs = _arm(size * np.array(ready), size * np.array(target), times)
            rotations = np.repeat(rest[None], len(times), axis=0)
            for side, turn in ((0, logs), (1, MIRROR * logs if both else 0.0 * logs)):
                joints = list(arms[side])
                rotations[:, joints] = rotation.multiply(rest[joints], rotation.from_exponential_map(turn))
            row = {"file": f"{PERFORMER}_{name}{variant + 1:02d}.bvh", "speaker": PERFORMER, "posture": "Standing",
                   "lexeme": "BeatMid" if name == "BeatBoth" else name, "emphasis": str(_LEAD + _PREPARATION + _STROKE)}
            stroke = performed.measured_stroke(figure, row, rotations, _FPS)
            assert stroke is not None
            stroke = replace(stroke, held_out=variant == 2)
            strokes += [stroke, performed.mirror(stroke)]
    return StrokeSet(tuple(strokes), {PERFORMER: replace(figure, home=performed.home_pose(strokes))})


def segments() -> tuple[Segment, ...]:
    """The trunks and arms of two busy people and one who waits."""
    out = []
    for seed, quiet in ((1, False), (2, False), (3, True)):
        logs = moving(30.0, seed) * (0.3 if quiet else 1.5)
        bends = np.stack([logs[:, 0], 3.0 * logs[:, 1], 3.0 * logs[:, 5]], axis=1)
        arms = 0.02 * np.stack([logs[:, 12:16].reshape(len(logs), -1)] * 2)
        out.append(Segment(f"person_{seed}", bends, arms, quiet))
    return tuple(out)


def said(text: str, repeat: int = 1, language: str = "en") -> Spoken:
    """A syllable of 0.3 s for each word from 1 s on, and a pause of half a second after each sentence ("|")."""
    words: list[Word] = []
    phrases: list[Phrase] = []
    clock = 1.0
    for sentence in text.split("|") * repeat:
        begin = clock
        for word in sentence.split():
            words.append(Word(word, clock, clock + 0.3))
            clock += 0.3
        phrases.append(Phrase(begin, clock, 0.5 * (-1.0) ** len(phrases)))
        clock += 0.5
    syllables = tuple(Syllable(w.start, w.start + 0.05, w.end, k, 0.0, float(1 + k % 3), 0.5)
                      for k, w in enumerate(words))
    return Spoken(Speech(np.zeros(int(16000 * (clock + 2)), np.float32), 16000, tuple(words)), syllables,
                  tuple(phrases), language)


def played(spoken: Spoken, strokes: StrokeSet, seed: int, manner: Manner = STEADY,
           performer: str = PERFORMER) -> Played:
    """A performance of `spoken`."""
    return perform(spoken, performer, strokes, Staging(manner, segments()), np.random.default_rng(seed))


def planned(spoken: Spoken, strokes: StrokeSet, seed: int, split: str = "train") -> tuple[plan.Planned, ...]:
    """The strokes of a performance of `spoken`."""
    rng = np.random.default_rng(seed)
    casting = plan.cast(spoken, PERFORMER, STEADY, NEUTRAL, rng)
    return plan.plan(spoken, PERFORMER, strokes, casting, rng, split)
