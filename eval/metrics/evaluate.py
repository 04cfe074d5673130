"""Every metric of one clip: each one's number, and why where there is none.

With a bundle, a motion is also read as blocks at the beat of its speech, from any system: lexeme accuracy is the share
of blocks whose nearest lexeme is that of the speaker's own motion, percent, more is better. What fools it: many
gestures suit a word, so a good system may have little of it; lexemes of rest are common, so standing still may have
much; jitter leaves most blocks with their lexeme. `shuffled` is its chance level.

A clip without speech has the metrics of motion alone:

    >>> from data_module.motion import rotation, skeletons
    >>> still = Motion(skeletons.CHARACTER, rotation.from_exponential_map(np.zeros((40, 16, 3))), np.zeros((40, 3)), 20)
    >>> got = clip_values(still, still, MotionBeats.of(still), None, seed=0)
    >>> got.numbers["maje"], got.numbers["speed_hands"], got.reasons["pmb_A"]
    (0.0, 0.0, 'its speech is not known')
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from data_module.motion.motion_beats import MODES, motion_beats
from data_module.speech.onsets import detect_onsets
from data_module.types import Array, Motion, Speech
from eval.metrics import CLIP_METRICS, EYE_METRICS, eye, pmb
from eval.metrics.accuracy import lexeme_accuracy
from eval.metrics.encode import EncodedMotion
from eval.metrics.joint_error import motion_error
from eval.metrics.smoothness import hand_figures

WIDE = 0.2
"""Seconds: the delta that the papers print."""
NO_SPEECH = "its speech is not known"
NO_EDGES = "the edges of its blocks are not known (--bundle)"
ACCURACY = "lexeme_accuracy"
MOTION_METRICS = tuple(name for name in CLIP_METRICS if name != ACCURACY)
"""Those that take no bundle."""


@dataclass(frozen=True)
class OnsetTrack:
    """The onsets of a clip's speech, and its duration, both in seconds."""

    onsets: Array
    duration: float

    @classmethod
    def of(cls, speech: Speech) -> OnsetTrack:
        """By `detect_onsets`."""
        return cls(detect_onsets(speech.samples, speech.sample_rate), speech.duration)

    def lasting(self, duration: float) -> OnsetTrack:
        """As if it lasted this long: cut, or repeated."""
        return OnsetTrack(pmb.wrapped(self.onsets, self.duration, duration), duration)


@dataclass(frozen=True)
class MotionBeats:
    """The beats of a clip's motion, seconds, by the mode of `motion_beats`."""

    modes: dict[str, Array]
    duration: float

    @classmethod
    def of(cls, motion: Motion) -> MotionBeats:
        """By both modes."""
        return cls({mode: motion_beats(motion, mode) for mode in MODES}, motion.duration)


@dataclass
class Values:
    """The numbers of a clip by metric, and the reason of each that is NaN."""

    numbers: dict[str, float] = field(default_factory=dict)
    reasons: dict[str, str] = field(default_factory=dict)

    def put(self, name: str, number: float, reason: str) -> None:
        """Store a number; the reason only where it is undefined."""
        self.numbers[name] = float(number)
        if not np.isfinite(number):
            self.reasons[name] = reason or "it is not defined for this clip"


def clip_values(motion: Motion, truth: Motion, beats: MotionBeats, track: OnsetTrack | None, seed: int) -> Values:
    """Every one of `MOTION_METRICS` for a motion beside the speaker's own of the same length, and its speech."""
    out, joints = Values(), motion_error(motion, truth)
    # Undefined joint errors have a reason of their own: too few frames, or no joint that both have.
    for name in ("maje", "mad", "mad_per_frame"):
        out.put(name, getattr(joints, name), joints.reason)
    for name, value in hand_figures(motion).items():
        out.put(name, value, f"{len(motion)} frames are too few for it")
    out.put("beats_per_second", len(beats.modes["A"]) / motion.duration, "")
    if track is not None:
        _synchrony_values(out, beats, track.lasting(beats.duration), seed)
    for name in MOTION_METRICS:
        if name not in out.numbers:
            out.put(name, float("nan"), NO_SPEECH)
    return out


def eye_values(motion: Motion, voice: eye.VoiceActivity | None, edges: Array | None) -> Values:
    """Every one of `EYE_METRICS` of a motion, as `eval.metrics.eye.figures` takes it."""
    out = Values()
    # The reason follows from what the metric takes: the figures themselves only know that they are undefined.
    unheard = "" if voice else NO_SPEECH
    lacking = {"eye voice": unheard, "eye phrases": unheard}
    for name, number in eye.figures(motion, voice, edges).items():
        why = NO_EDGES if name == "eye_seam" and edges is None else lacking.get(EYE_METRICS[name].part, "")
        out.put(name, number, why or "the clip is too short for it, or holds none of what it counts")
    return out


def _synchrony_values(out: Values, beats: MotionBeats, track: OnsetTrack, seed: int) -> None:
    for mode, times in beats.modes.items():
        percent = pmb.pmb(times, track.onsets)
        chance = pmb.chance(times, track.onsets, track.duration, seed=seed)
        out.put(f"pmb_{mode}", percent, pmb.NO_BEAT)
        out.put(f"chance_{mode}", chance, pmb.NO_BEAT)
        out.put(f"above_{mode}", 100.0 * pmb.above_chance(percent, chance),
                "chance leaves no room" if len(times) else pmb.NO_BEAT)
    # The papers print this one: nearly all beats are matched at 0.2 s, so it stands beside its chance level.
    out.put("pmb_A_wide", pmb.pmb(beats.modes["A"], track.onsets, WIDE), pmb.NO_BEAT)


def lexeme_values(encoded: EncodedMotion | None, truth: EncodedMotion | None) -> Values:
    """Lexeme accuracy of a motion beside the speaker's own; None where there is no speech."""
    out = Values()
    out.put(ACCURACY, float("nan") if encoded is None or truth is None
            else lexeme_accuracy(encoded.labels, truth.labels), NO_SPEECH)
    return out
