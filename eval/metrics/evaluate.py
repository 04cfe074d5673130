"""Every metric of one clip: each one's number, and why where there is none.

With a bundle, a motion is also read as blocks at the beat of its speech, from any system:

- the reward is the mean cosine between the motion and the speech in the windows that end with each block, by the
  model that judges, which no policy was trained to please (RACER Eq. 8). No unit, from -1 to 1, more is better. What
  fools it: a model knows what its training data taught it, so motion of another style, or of joints that it never saw,
  gets less for that alone, and random motion far more than 0; a body that keeps still may get as much as the speaker.
  Look at the distance from the row `shuffled`, not at the value.
- lexeme accuracy is the share of blocks whose nearest lexeme is that of the speaker's own motion, percent, more is
  better. What fools it: many gestures suit a word, so a good system may have little of it; lexemes of rest are common,
  so standing still may have much; jitter leaves most blocks with their lexeme. `shuffled` is its chance level.

A clip without speech has the metrics of motion alone:

    >>> from data_module.motion import rotation, skeletons
    >>> still = Motion(skeletons.CHARACTER, rotation.from_exponential_map(np.zeros((40, 16, 3))), np.zeros((40, 3)), 20)
    >>> got = clip_values(still, still, MotionBeats.of(still), None, seed=0)
    >>> got.numbers["maje"], got.numbers["speed_hands"], got.reasons["pmb_A"]
    (0.0, 0.0, 'its speech is not known')
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field

import numpy as np

from data_module.motion.motion_beats import MODES, motion_beats
from data_module.speech.onsets import detect_onsets
from data_module.types import Array, Motion, Speech
from eval.metrics import CLIP_METRICS, EYE_METRICS, METRICS, eye, pmb
from eval.metrics.accuracy import lexeme_accuracy
from eval.metrics.beat_consistency import consistency, mean_score, motion_joint_beats
from eval.metrics.encode import EncodedMotion
from eval.metrics.joint_error import motion_error
from eval.metrics.mismatch import wrapped
from eval.metrics.smoothness import motion_smoothness

WIDE = 0.2
"""Seconds: the delta that the papers print."""
SYNCHRONY = ("pmb_A", "pmb_B", "consistency")
"""Metrics that the mismatch test tries."""
NO_SPEECH = "its speech is not known"
NO_EDGES = "the edges of its blocks are not known (--bundle)"
NO_SPACE = f"{eye.frechet.REFERENCE} is not in GESTICULATOR_DATA"
LEXEME_METRICS = tuple(name for name, metric in CLIP_METRICS.items() if metric.part == "lexemes")
MOTION_METRICS = tuple(name for name in CLIP_METRICS if name not in LEXEME_METRICS)
"""Those that take no bundle."""
_OTHERS = {name: METRICS.load(name) for name in METRICS.points if name in MOTION_METRICS}


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
        return OnsetTrack(wrapped(self.onsets, self.duration, duration), duration)


@dataclass(frozen=True)
class MotionBeats:
    """The beats of a clip's motion, seconds: by the mode of `motion_beats`, and of each joint by BEAT's rule."""

    modes: dict[str, Array]
    joints: list[Array]
    duration: float

    @classmethod
    def of(cls, motion: Motion) -> MotionBeats:
        """Both kinds."""
        return cls({mode: motion_beats(motion, mode) for mode in MODES}, motion_joint_beats(motion), motion.duration)


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
    out = Values()
    for measured in (motion_error(motion, truth), motion_smoothness(motion)):
        # The fields of both are the names of their metrics.
        for name, value in asdict(measured).items():
            if name in CLIP_METRICS:
                out.put(name, value, measured.reason)
    for name, measure in _OTHERS.items():
        out.put(name, measure(motion, truth), "")
    out.put("beats_per_second", pmb.beat_rate(beats.modes["A"], motion.duration), "")
    if track is not None:
        _synchrony_values(out, beats, track.lasting(beats.duration), seed)
    for name in MOTION_METRICS:
        if name not in out.numbers:
            out.put(name, float("nan"), NO_SPEECH)
    return out


def eye_values(motion: Motion, voice: eye.VoiceActivity | None, edges: Array | None, space: eye.ReferenceSpace | None
               ) -> Values:
    """Every one of `EYE_METRICS` of a motion, as `eval.metrics.eye.figures` takes it."""
    out = Values()
    # The reason follows from what the metric takes: the figures themselves only know that they are undefined.
    lacking = {"speech": None if voice else NO_SPEECH, "edges": None if edges is not None else NO_EDGES,
               "reference": None if space else NO_SPACE}
    for name, number in eye.figures(motion, voice, edges, space).items():
        why = next((reason for need in EYE_METRICS[name].inputs if (reason := lacking[need])), "")
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
    score, by_chance = consistency(beats.joints, track.onsets, track.duration, seed=seed)
    reason = "the sound has no onset" if beats.joints else "no joint moves"
    for name, value in (("consistency", score), ("consistency_chance", by_chance),
                        ("consistency_above", pmb.above_chance(score, by_chance, best=1.0))):
        out.put(name, value, reason)


def synchrony(name: str, beats: MotionBeats, track: OnsetTrack) -> float:
    """One of `SYNCHRONY` of a motion with any speech, which is cut or repeated to last as long."""
    # Another's speech may be shorter than the motion that it is tried on.
    onsets = track.lasting(beats.duration).onsets
    if name == "consistency":
        return mean_score(beats.joints, onsets)
    return pmb.pmb(beats.modes[name.removeprefix("pmb_")], onsets)


def lexeme_values(encoded: EncodedMotion | None, truth: EncodedMotion | None, reward: float, judged: bool) -> Values:
    """Both of `LEXEME_METRICS` of a motion beside the speaker's own; None where there is no speech.

    reward: of `eval.metrics.encode.judged_reward`. judged: whether the bundle has a model that judges.
    """
    out = Values()
    if encoded is None or truth is None:
        for name in LEXEME_METRICS:
            out.put(name, float("nan"), NO_SPEECH)
        return out
    out.put("reward", reward, "nothing is said" if judged
            else "no judging reward model of the bundle's training was found in the work folder (--work)")
    out.put("lexeme_accuracy", lexeme_accuracy(encoded.labels, truth.labels), "")
    return out
