"""Metrics: a chapter each, with its theory, its unit, and what fools it; and `METRICS`, which lists them all.

Values of one clip come from `eval.metrics.evaluate`; `gesticulator score` makes the tables.

    >>> METRICS["maje"].good, METRICS["maje"].unit, METRICS["maje"].fooled_by
    ('low', 'mm', ('still', 'jitter'))
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from data_module.errors import InputError, complain
from data_module.registry import PROJECT, Registry, RegistryEntry

if TYPE_CHECKING:
    from data_module.types import Motion

__all__ = ["METRICS", "Metric"]


@dataclass(frozen=True)
class Metric:
    """A figure of a clip, or of a set of clips.

    chapter: the module of `eval.metrics` that tells its theory. part: the table it stands in. good: "low", "high",
    "near" (the speaker's own value), or "" for a figure that is no judgement. needs: "truth" (the speaker's own motion
    of the clip), "speech", "set" (several clips), "bundle" (a lexicon and a model that judges), "edges" (of the
    system's own blocks), "reference" (the frozen space of the Frechet distance).
    fooled_by: the controls (`eval.baselines`) that it cannot tell from good motion: where less is better, they are
    better than a real person's motion at another moment; else they are as good as the truth, or as near to it. Of the
    figures of lexemes, over a lexicon of postures: among movements jitter does not pass.
    measure: of a metric of another package: the value of a motion beside the speaker's own of the same length, NaN
    where it has none; None for ours, which `eval.metrics.evaluate` measures together.
    """

    chapter: str
    title: str
    unit: str
    digits: int
    part: str
    good: str
    needs: tuple[str, ...] = ()
    fooled_by: tuple[str, ...] = ()
    measure: Callable[[Motion, Motion], float] | None = None

    @property
    def heading(self) -> str:
        """Title and unit, as a table shows them."""
        return f"{self.title}, {self.unit}" if self.unit else self.title


_TRUTH, _SPEECH, _BUNDLE = ("truth",), ("speech",), ("speech", "bundle")
_SEEN_BACKWARDS = ("mirrored", "reversed")
"""Controls that no figure of one hand's shape or of a window's means can tell from real motion."""
_STILL_TOO = ("mirrored", "still", "reversed", "jitter", "bobbing")
_SHAPE = ("shuffled", "reversed")
"""Controls that keep how fast real motion is: what looks at vigour alone takes them for the truth."""

METRICS: dict[str, Metric] = {
    "maje": Metric("joint_error", "MAJE, mean of coordinates", "mm", 1, "joints", "low", _TRUTH, ("still", "jitter")),
    "maje_length": Metric("joint_error", "MAJE, length", "mm", 1, "joints", "low", _TRUTH, ("still", "jitter")),
    "mad": Metric("joint_error", "MAD, length", "mm/s^2", 0, "joints", "low", _TRUTH, ("still",)),
    "mad_per_frame": Metric("joint_error", "MAD, length", "mm/frame^2", 2, "joints", "low", _TRUTH, ("still",)),
    "mad_coordinate_per_frame": Metric("joint_error", "MAD, coordinates", "mm/frame^2", 2, "joints", "low", _TRUTH,
                                       ("still",)),
    "pmb_A": Metric("pmb", "PMB A, 0.1 s", "%", 1, "beats", "high", _SPEECH),
    "chance_A": Metric("pmb", "chance of PMB A", "%", 1, "beats", "", _SPEECH),
    "above_A": Metric("pmb", "PMB A above chance", "%", 1, "beats", "high", _SPEECH),
    "pmb_A_wide": Metric("pmb", "PMB A, 0.2 s", "%", 1, "beats", "high", _SPEECH),
    "area_A": Metric("pmb", "area of the delta curve A", "%", 1, "beats", "high", _SPEECH),
    "pmb_B": Metric("pmb", "PMB B, 0.1 s", "%", 1, "beats", "high", _SPEECH),
    "chance_B": Metric("pmb", "chance of PMB B", "%", 1, "beats", "", _SPEECH),
    "above_B": Metric("pmb", "PMB B above chance", "%", 1, "beats", "high", _SPEECH),
    "consistency": Metric("beat_consistency", "beat consistency", "", 3, "consistency", "high", _SPEECH, ("jitter",)),
    "consistency_chance": Metric("beat_consistency", "chance of consistency", "", 3, "consistency", "", _SPEECH),
    "consistency_above": Metric("beat_consistency", "consistency above chance", "", 3, "consistency", "high", _SPEECH),
    "beats_per_second": Metric("pmb", "motion beats A a second", "", 2, "consistency", "near", (), ("shuffled",)),
    "speed_hands": Metric("smoothness", "hand speed", "m/s", 3, "vigour", "near", (), _SHAPE),
    "acceleration_hands": Metric("smoothness", "hand acceleration", "m/s^2", 2, "vigour", "near", (), _SHAPE),
    "acceleration": Metric("smoothness", "joint acceleration", "m/s^2", 2, "vigour", "near", (), _SHAPE),
    "jerk_hands": Metric("smoothness", "hand jerk", "m/s^3", 1, "vigour", "near", (), _SHAPE),
    "jerk": Metric("smoothness", "joint jerk", "m/s^3", 1, "vigour", "near", (), _SHAPE),
    "reward": Metric("evaluate", "reward of the judging model", "cosine", 3, "lexemes", "high", _BUNDLE, ("still",)),
    "lexeme_accuracy": Metric("accuracy", "lexemes like the speaker's own", "%", 1, "lexemes", "high",
                              (*_TRUTH, *_BUNDLE), ("jitter",)),
    "speed_distance": Metric("smoothness", "distance of hand-speed histograms (Hellinger)", "", 3, "sets", "low",
                             ("truth", "set"), _SHAPE),
    "diversity": Metric("diversity", "diversity", "nats", 2, "sets", "near", ("set", *_BUNDLE), _SHAPE),
    "motion_variance": Metric("diversity", "motion variance", "", 3, "sets", "near", ("set", *_BUNDLE), ("reversed",)),
    "fgd": Metric("fgd", "FGD", "", 2, "fgd", "low", ("truth", "set"), (*_SHAPE, "jitter")),
}
"""Every metric; those for the eye follow. FGD has a column for each network, and each network has its own unit."""
def _eye(chapter: str, title: str, unit: str, digits: int, good: str, fooled_by: tuple[str, ...], *,
         needs: tuple[str, ...] = ()) -> Metric:
    return Metric(f"eye.{chapter}", title, unit, digits, f"eye {chapter}", good, needs, fooled_by)


_MIRROR_OR_NOISE = (*_SEEN_BACKWARDS, "jitter")
_BOBS = (*_SEEN_BACKWARDS, "bobbing")
_EDGES = ("edges",)

EYE_METRICS: dict[str, Metric] = {
    "eye_hand_speed_correlation": _eye("hands", "L/R hand speed correlation", "", 2, "near", ("reversed",)),
    "eye_hand_height_correlation": _eye("hands", "L/R hand height correlation", "", 2, "near", ("reversed", "jitter")),
    "eye_one_handed": _eye("hands", "one-handed share of movement", "%", 0, "near", ("reversed",)),
    "eye_one_hanging": _eye("hands", "exactly one hand hanging", "%", 0, "near", ("reversed", "jitter")),
    "eye_both_hanging": _eye("hands", "both hands hanging", "%", 0, "near", _STILL_TOO),
    "eye_speed_5": _eye("hands", "hand speed, 5 %", "m/s", 2, "near", _SEEN_BACKWARDS),
    "eye_speed_25": _eye("hands", "hand speed, 25 %", "m/s", 2, "near", _SEEN_BACKWARDS),
    "eye_speed_50": _eye("hands", "hand speed, 50 %", "m/s", 2, "near", _SEEN_BACKWARDS),
    "eye_speed_75": _eye("hands", "hand speed, 75 %", "m/s", 2, "near", _BOBS),
    "eye_speed_95": _eye("hands", "hand speed, 95 %", "m/s", 2, "near", _BOBS),
    "eye_speed_99": _eye("hands", "hand speed, 99 %", "m/s", 2, "near", _BOBS),
    "eye_drift": _eye("hands", "mean wrist of the last 15 s from the first", "cm", 0, "low", _STILL_TOO),
    "eye_head": _eye("trunk", "head on chest, spread", "deg", 1, "near", _MIRROR_OR_NOISE),
    "eye_chest": _eye("trunk", "chest, spread", "deg", 1, "near", _SEEN_BACKWARDS),
    "eye_head_yaw": _eye("trunk", "head yaw, 95 %", "deg", 0, "low", _STILL_TOO),
    "eye_freeze": _eye("trunk", "longest freeze of head and hands", "s", 1, "low", _MIRROR_OR_NOISE),
    "eye_freeze_head": _eye("trunk", "longest freeze of the head", "s", 1, "low", _MIRROR_OR_NOISE),
    "eye_freeze_hands": _eye("trunk", "longest rest of both hands", "s", 1, "low", _MIRROR_OR_NOISE),
    "eye_hand_in_torso": _eye("trunk", "hand in the torso", "%", 1, "low", _STILL_TOO),
    "eye_elbow_in_torso": _eye("trunk", "elbow in the torso", "%", 1, "low", _STILL_TOO),
    "eye_fingers": _eye("trunk", "fingers moving", "%", 0, "near", _MIRROR_OR_NOISE),
    "eye_stroke_amplitude": _eye("strokes", "stroke amplitude, median", "cm", 0, "near", _SEEN_BACKWARDS),
    "eye_stroke_amplitude_90": _eye("strokes", "stroke amplitude, 90 %", "cm", 0, "near", _MIRROR_OR_NOISE),
    "eye_stroke_duration": _eye("strokes", "stroke duration, median", "s", 2, "near", (*_MIRROR_OR_NOISE, "bobbing")),
    "eye_stroke_duration_90": _eye("strokes", "stroke duration, 90 %", "s", 2, "near", _MIRROR_OR_NOISE),
    "eye_attack": _eye("strokes", "where a stroke is fastest", "% of it", 1, "near",
                       ("mirrored", "jitter")),
    "eye_rising": _eye("strokes", "hands speeding up, of the time", "%", 1, "near", ("mirrored",)),
    "eye_seam": _eye("strokes", "acceleration at seams over elsewhere", "", 2, "low", (*_MIRROR_OR_NOISE, "bobbing"),
                     needs=_EDGES),
    "eye_repetition": _eye("strokes", "nearest other 2 s window over spread", "", 2, "near", ("reversed", "jitter")),
    "eye_speech_speed": _eye("voice", "hand speed in speech", "m/s", 2, "near", _BOBS, needs=_SPEECH),
    "eye_silence_speed": _eye("voice", "hand speed in silence", "m/s", 2, "near", _BOBS, needs=_SPEECH),
    "eye_speech_over_silence": _eye("voice", "speech over silence, speed", "", 2, "near",
                                    (*_MIRROR_OR_NOISE, "bobbing"), needs=_SPEECH),
    "eye_loudness": _eye("voice", "loudness and hand speed, signed r2", "", 2, "near", (*_MIRROR_OR_NOISE, "bobbing"),
                         needs=_SPEECH),
    "eye_above_1": _eye("voice", "PMB above chance, 0.1 s, first detector", "%", 0, "high", _BOBS, needs=_SPEECH),
    "eye_above_2": _eye("voice", "PMB above chance, 0.1 s, second", "%", 0, "high", (*_MIRROR_OR_NOISE, "bobbing"),
                        needs=_SPEECH),
    "eye_frechet": _eye("frechet", "window Frechet distance to real, mean of clips", "", 1, "low", _SEEN_BACKWARDS,
                        needs=("reference",)),
}
"""The figures for the eye (`eval.metrics.eye`), of one clip each. fooled_by: the controls, made of a real take, that
lie in the range of real people (`eval.metrics.eye.RANGES`) by this figure."""
METRICS |= EYE_METRICS

OTHER_METRICS: Registry[RegistryEntry] = Registry(
    "metrics", "an eval.metrics.Metric with a `measure`", {}, RegistryEntry,
    fits=lambda found: isinstance(found, Metric) and found.measure is not None)
"""Metrics of other packages."""


def _add_others() -> None:
    """Add the metrics of other packages whose names are free; of one that cannot be loaded a line is printed."""
    for name in OTHER_METRICS:
        if name in METRICS:
            complain(f"{PROJECT}: warning: {name} of metrics is ours; {OTHER_METRICS[name].where} is not used")
            continue
        try:
            METRICS[name] = OTHER_METRICS.load(name)
        except InputError as error:
            complain(f"{PROJECT}: {error}")


_add_others()

CLIP_METRICS = {name: one for name, one in METRICS.items()
                if one.part not in ("sets", "fgd") and name not in EYE_METRICS}
"""Those that have a value for each clip, without the eye's."""
SET_METRICS = {name: one for name, one in METRICS.items() if one.part == "sets"}
"""Those of a set of clips, but for FGD."""
