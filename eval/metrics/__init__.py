"""Metrics: a chapter each, with its theory, its unit, and what fools it; and `METRICS`, which lists them all.

Values of one clip come from `eval.metrics.evaluate`; `gesticulator score` makes the tables.

    >>> METRICS["maje"].good, METRICS["maje"].unit, METRICS["maje"].fooled_by
    ('low', 'mm', ('still', 'jitter'))
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Metric:
    """A figure of a clip, or of a set of clips.

    chapter: the module of `eval.metrics` that tells its theory. part: the table it stands in. good: "low", "high",
    "near" (the speaker's own value), or "" for a figure that is no judgement. needs: "truth" (the speaker's own motion
    of the clip), "speech", "set" (several clips), "bundle" (a lexicon and a model that judges).
    fooled_by: the controls (`eval.baselines`) that it cannot tell from good motion: where less is better, they are
    better than a real person's motion at another moment; else they are as good as the truth, or as near to it.
    """

    chapter: str
    title: str
    unit: str
    digits: int
    part: str
    good: str
    needs: tuple[str, ...] = ()
    fooled_by: tuple[str, ...] = ()

    @property
    def heading(self) -> str:
        """Title and unit, as a table shows them."""
        return f"{self.title}, {self.unit}" if self.unit else self.title


_TRUTH, _SPEECH, _BUNDLE = ("truth",), ("speech",), ("speech", "bundle")
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
"""Every metric of `gesticulator score`. FGD has a column for each network; its values have a network's own unit."""
CLIP_METRICS = {name: one for name, one in METRICS.items() if one.part not in ("sets", "fgd")}
"""Those that have a value for each clip."""
SET_METRICS = {name: one for name, one in METRICS.items() if one.part == "sets"}
"""Those of a set of clips, but for FGD."""
