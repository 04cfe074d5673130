"""Metrics: a chapter each, with its theory, its unit, and what fools it; and `METRICS`, the table of them all.

Values of one clip come from `eval.metrics.evaluate`; `gesticulator score` makes the tables.

    >>> METRICS["maje"].good, METRICS["maje"].unit, METRICS["maje"].fooled_by
    ('low', 'mm', ('still', 'jitter'))
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from data_module.errors import InputError, complain
from data_module.registry import PROJECT, Registry, RegistryEntry

__all__ = ["METRICS", "Metric"]


Direction = Literal["low", "high", "near", ""]
"""Which values are good: lower, higher, nearer to the speaker's own value; "" for a figure that is no judgement."""


@dataclass(frozen=True)
class Metric(RegistryEntry):
    """A figure of a clip, or of a set of clips.

    about: its title. where: the function that measures it, in the module that tells its theory (its chapter). Of
    another package: a function of a motion and the speaker's own motion of the same length, which gives a number, NaN
    where there is none; ours take what `inputs` names, and `eval.metrics.evaluate` calls those of one chapter together.
    unit: "" for a figure without one. digits: behind the point, in tables. part: the table it stands in. inputs:
    "truth" (the speaker's own motion of the clip), "speech", "set" (several clips), "bundle" (a lexicon and a model
    that judges), "edges" (of the system's own blocks), "reference" (the frozen space of the Frechet distance).
    fooled_by: the controls (`eval.baselines`) that it cannot tell from good motion, for any performer: where less is
    better, they are better than a real person's motion at another moment; else they are as good as the truth, or as
    near to it. Of the figures of lexemes, over a lexicon of postures: among movements jitter does not pass.
    """

    unit: str = ""
    digits: int = 2
    part: str = "vigour"
    good: Direction = ""
    inputs: tuple[str, ...] = ()
    fooled_by: tuple[str, ...] = ()

    @property
    def chapter(self) -> str:
        """The module that tells its theory, within `eval.metrics` for ours."""
        return self.where.partition(":")[0].removeprefix("eval.metrics.")

    @property
    def heading(self) -> str:
        """Title and unit, as a table shows them."""
        return f"{self.about}, {self.unit}" if self.unit else self.about


_TRUTH, _SPEECH, _BUNDLE = ("truth",), ("speech",), ("speech", "bundle")
_SHAPE = ("shuffled", "reversed")
"""Controls that keep how fast real motion is: what looks at vigour alone takes them for the truth."""

_JOINTS, _VIGOUR = "eval.metrics.joint_error:motion_error", "eval.metrics.smoothness:motion_smoothness"
_PMB, _CONSISTENCY = "eval.metrics.pmb", "eval.metrics.beat_consistency:consistency"
_DIVERSITY = "eval.metrics.diversity"

_OURS: dict[str, Metric] = {
    "maje": Metric("MAJE, mean of coordinates", _JOINTS, "mm", 1, "joints", "low", _TRUTH, ("still", "jitter")),
    "maje_length": Metric("MAJE, length", _JOINTS, "mm", 1, "joints", "low", _TRUTH, ("still", "jitter")),
    "mad": Metric("MAD, length", _JOINTS, "mm/s^2", 0, "joints", "low", _TRUTH, ("still",)),
    "mad_per_frame": Metric("MAD, length", _JOINTS, "mm/frame^2", 2, "joints", "low", _TRUTH, ("still",)),
    "mad_coordinate_per_frame": Metric("MAD, coordinates", _JOINTS, "mm/frame^2", 2, "joints", "low", _TRUTH,
                                       ("still",)),
    # Beats A are where the arms brake hardest, B where they are slowest: the paper's words fit either.
    "pmb_A": Metric("PMB A, 0.1 s", f"{_PMB}:pmb", "%", 1, "beats", "high", _SPEECH),
    "chance_A": Metric("chance of PMB A", f"{_PMB}:chance", "%", 1, "beats", "", _SPEECH),
    "above_A": Metric("PMB A above chance", f"{_PMB}:above_chance", "%", 1, "beats", "high", _SPEECH),
    "pmb_A_wide": Metric("PMB A, 0.2 s", f"{_PMB}:pmb", "%", 1, "beats", "high", _SPEECH),
    "pmb_B": Metric("PMB B, 0.1 s", f"{_PMB}:pmb", "%", 1, "beats", "high", _SPEECH),
    "chance_B": Metric("chance of PMB B", f"{_PMB}:chance", "%", 1, "beats", "", _SPEECH),
    "above_B": Metric("PMB B above chance", f"{_PMB}:above_chance", "%", 1, "beats", "high", _SPEECH),
    "consistency": Metric("beat consistency", _CONSISTENCY, "", 3, "consistency", "high", _SPEECH, ("jitter",)),
    "consistency_chance": Metric("chance of consistency", _CONSISTENCY, "", 3, "consistency", "", _SPEECH),
    "consistency_above": Metric("consistency above chance", _CONSISTENCY, "", 3, "consistency", "high", _SPEECH),
    "beats_per_second": Metric("motion beats A a second", f"{_PMB}:beat_rate", "", 2, "consistency", "near", (),
                               ("shuffled",)),
    "speed_hands": Metric("hand speed", _VIGOUR, "m/s", 3, "vigour", "near", (), _SHAPE),
    "acceleration_hands": Metric("hand acceleration", _VIGOUR, "m/s^2", 2, "vigour", "near", (), _SHAPE),
    "acceleration": Metric("joint acceleration", _VIGOUR, "m/s^2", 2, "vigour", "near", (), _SHAPE),
    "jerk_hands": Metric("hand jerk", _VIGOUR, "m/s^3", 1, "vigour", "near", (), _SHAPE),
    "jerk": Metric("joint jerk", _VIGOUR, "m/s^3", 1, "vigour", "near", (), _SHAPE),
    # Of a lexicon and a judging model, so undefined without --bundle.
    "reward": Metric("reward of the judging model", "eval.metrics.encode:judged_reward", "cosine", 3, "lexemes",
                     "high", _BUNDLE, ("still",)),
    "lexeme_accuracy": Metric("lexemes like the speaker's own", "eval.metrics.accuracy:lexeme_accuracy", "%", 1,
                              "lexemes", "high", (*_TRUTH, *_BUNDLE), ("jitter",)),
    # Of all clips together: a histogram, an entropy or a covariance of one clip says little.
    "speed_distance": Metric("distance of hand-speed histograms (Hellinger)", "eval.metrics.smoothness:hellinger", "",
                             3, "sets", "low", ("truth", "set"), _SHAPE),
    "diversity": Metric("diversity", f"{_DIVERSITY}:diversity", "nats", 2, "sets", "near", ("set", *_BUNDLE), _SHAPE),
    "motion_variance": Metric("motion variance", f"{_DIVERSITY}:motion_variance", "", 3, "sets", "near",
                              ("set", *_BUNDLE), ("reversed",)),
    "fgd": Metric("FGD", "eval.metrics.fgd:fgd", "", 2, "fgd", "low", ("truth", "set"), (*_SHAPE, "jitter")),
}
"""Without those for the eye. FGD has a column for each network, and each network has its own unit."""


def _eye(part: str, about: str, unit: str, digits: int, good: Direction, inputs: tuple[str, ...] = ()) -> Metric:
    """A figure of `eval.metrics.eye`: of the chapter of its part, but for the two whose measure has another name."""
    # The Frechet distance needs its frozen space, and the phrases need the sound.
    measure = {"frechet": "frechet:ReferenceSpace", "phrases": "units:sound_figures"}.get(part, f"{part}:figures")
    return Metric(about, f"eval.metrics.eye.{measure}", unit, digits, f"eye {part}", good, inputs)


EYE_METRICS: dict[str, Metric] = {
    "eye_hand_speed_correlation": _eye("hands", "L/R hand speed correlation", "", 2, "near"),
    "eye_hand_height_correlation": _eye("hands", "L/R hand height correlation", "", 2, "near"),
    "eye_one_handed": _eye("hands", "one-handed share of movement", "%", 0, "near"),
    "eye_one_hanging": _eye("hands", "exactly one hand hanging", "%", 0, "near"),
    "eye_both_hanging": _eye("hands", "both hands hanging", "%", 0, "near"),
    "eye_speed_5": _eye("hands", "hand speed, 5 %", "m/s", 2, "near"),
    "eye_speed_25": _eye("hands", "hand speed, 25 %", "m/s", 2, "near"),
    "eye_speed_50": _eye("hands", "hand speed, 50 %", "m/s", 2, "near"),
    "eye_speed_75": _eye("hands", "hand speed, 75 %", "m/s", 2, "near"),
    "eye_speed_95": _eye("hands", "hand speed, 95 %", "m/s", 2, "near"),
    "eye_speed_99": _eye("hands", "hand speed, 99 %", "m/s", 2, "near"),
    # Anything that looks at both ends of a clip is judged on long ones only (30 s).
    "eye_drift": _eye("hands", "mean wrist of the last 15 s from the first", "cm", 0, "low"),
    "eye_head": _eye("trunk", "head on chest, spread", "deg", 1, "near"),
    "eye_chest": _eye("trunk", "chest, spread", "deg", 1, "near"),
    "eye_head_yaw": _eye("trunk", "head yaw, 95 %", "deg", 0, "low"),
    "eye_freeze_head": _eye("trunk", "longest freeze of the head", "s", 1, "low"),
    "eye_hand_in_torso": _eye("trunk", "hand in the torso", "%", 1, "low"),
    "eye_elbow_in_torso": _eye("trunk", "elbow in the torso", "%", 1, "low"),
    "eye_elbow_behind": _eye("trunk", "elbow behind the trunk, hand ahead", "%", 1, "low"),
    "eye_elbow_fastest": _eye("trunk", "fastest elbow", "m/s", 1, "low"),
    "eye_fingers": _eye("trunk", "fingers moving", "%", 0, "near"),
    "eye_stroke_amplitude": _eye("strokes", "stroke amplitude, median", "cm", 0, "near"),
    "eye_stroke_amplitude_90": _eye("strokes", "stroke amplitude, 90 %", "cm", 0, "near"),
    "eye_attack": _eye("strokes", "where a stroke is fastest", "% of it", 1, "near"),
    "eye_seam": _eye("strokes", "acceleration at seams over elsewhere", "", 2, "low", ("edges",)),
    "eye_repetition": _eye("strokes", "nearest other 2 s window over spread", "", 2, "near"),
    "eye_speech_speed": _eye("voice", "hand speed in speech", "m/s", 2, "near", _SPEECH),
    "eye_silence_speed": _eye("voice", "hand speed in silence", "m/s", 2, "near", _SPEECH),
    "eye_speech_over_silence": _eye("voice", "speech over silence, speed", "", 2, "near", _SPEECH),
    "eye_above_1": _eye("voice", "PMB above chance, 0.1 s, first detector", "%", 0, "high", _SPEECH),
    "eye_above_2": _eye("voice", "PMB above chance, 0.1 s, second", "%", 0, "high", _SPEECH),
    "eye_splay": _eye("posture", "forearm outward, of the time", "%", 0, "low"),
    "eye_splay_both": _eye("posture", "both forearms outward, of the time", "%", 0, "low"),
    "eye_azimuth": _eye("posture", "azimuth of the forearm, outward", "deg", 0, "near"),
    "eye_elbow": _eye("posture", "elbow bend", "deg", 0, "near"),
    "eye_face": _eye("posture", "arm before the face, of the time", "%", 1, "low"),
    "eye_hands_apart": _eye("posture", "hands apart", "cm", 0, "near"),
    "eye_shoulder": _eye("posture", "shoulder lift, spread", "cm", 1, "near"),
    "eye_wrist_95": _eye("posture", "wrist bend, 95 %", "deg", 0, "near"),
    "eye_finger_bend": _eye("posture", "finger bend", "deg", 0, "near"),
    "eye_finger_between": _eye("posture", "finger bend, spread between joints", "deg", 1, "near"),
    "eye_thumb_index": _eye("posture", "thumb with index finger, correlation", "", 2, "near"),
    "eye_head_with_hands": _eye("together", "head with hands, correlation", "", 2, "near"),
    "eye_head_travel": _eye("together", "head travel", "cm/s", 1, "near"),
    "eye_chest_travel": _eye("together", "chest travel", "cm/s", 1, "near"),
    "eye_fast": _eye("together", "hand velocity in 3 to 6 Hz", "%", 1, "low"),
    "eye_variation": _eye("together", "variation over 4 s", "", 2, "near"),
    "eye_units": _eye("units", "gesture units a minute and hand", "", 1, "near"),
    "eye_unit_length": _eye("units", "unit length, median", "s", 1, "near"),
    "eye_held": _eye("phrases", "raised hand held, of speech", "%", 1, "near", _SPEECH),
    "eye_pause_moving": _eye("phrases", "pauses with a moving hand", "%", 0, "near", _SPEECH),
    "eye_pause_speed": _eye("phrases", "speed in pauses over around them", "", 2, "near", _SPEECH),
    "eye_loud": _eye("phrases", "log hand speed with loudness, correlation", "", 2, "near", _SPEECH),
    "eye_variation_speech": _eye("phrases", "variation over 4 s, in speech", "", 2, "near", _SPEECH),
    "eye_frechet": _eye("frechet", "window Frechet distance to real, mean of clips", "", 1, "low", ("reference",)),
}
"""The figures for the eye (`eval.metrics.eye`), of one clip each, in the order of a table. Which controls pass depends
on the speaker: each chapter tells it, and `gesticulator score` marks it on the clips at hand."""

METRICS: Registry[Metric] = Registry("metrics", "an eval.metrics.Metric, or a function of two motions",
                                     {**_OURS, **EYE_METRICS}, Metric)
"""Every metric by name, then those of other packages."""


def _usable() -> dict[str, Metric]:
    """The metrics without those of other packages that cannot be loaded; of each of these a line is printed."""
    # Loaded here once, so that a broken package is told of before an hour of measuring and not after it.
    entries = METRICS.usable()
    for name in [name for name in METRICS.points if name in entries]:
        try:
            METRICS.load(name)
        except InputError as error:
            complain(f"{PROJECT}: {error}")
            del entries[name]
    return entries


_USABLE = _usable()
CLIP_METRICS = {name: metric for name, metric in _USABLE.items()
                if metric.part not in ("sets", "fgd") and name not in EYE_METRICS}
"""Those that have a value for each clip, without the eye's."""
SET_METRICS = {name: metric for name, metric in _USABLE.items() if metric.part == "sets"}
"""Those of a set of clips, but for FGD."""
