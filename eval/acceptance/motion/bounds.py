"""What the motion of a bundle must keep: the bounds of the figures for the eye and of its timing.

They are what is wanted of the default speaker, inside or beside what three real speakers do; a real take may miss some
of them, and the tables show which. Values are means over the renderings of a group of voices. What is pooled over
recordings (`timing`) is judged where there are several.

- Arms and hands: forearms in front of the chest, elbows bent, fingers of different bends, wrists that bend.
- Trunk and head: they travel, shoulders rise, the head moves with the hands.
- Phrases: hands hold, keep moving in pauses, start before the voice, and wax and wane over seconds.
- Two hands, strokes, seams: what mirrored, stiff, small and pulsing motion misses.

What fools them: no bound tells whether a gesture fits what is said, and no figure here predicts a rater's judgement.
They are necessary, not sufficient: look at the motion, too.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from eval.acceptance.motion import timing
from eval.claim import Bound, Claim, Verdict, at_least, at_most, skipped
from eval.metrics import EYE_METRICS
from eval.metrics.eye.sample import heading as eye_heading
from eval.stats import Interval

Figures = Mapping[str, Interval]

REAL_SPEED = {25: 0.174, 50: 0.366, 75: 0.714, 95: 1.459}
"""m/s: percentiles of hand speed in 53 pieces of 10 seconds of three real speakers, averaged."""
_BESIDE = 0.25
"""Share by which they may be missed."""
BOUNDS: dict[str, Bound] = {
    "eye_splay": at_most(15.0), "eye_splay_both": at_most(7.0), "eye_face": at_most(1.0),
    "eye_azimuth": Bound(-35.0, 5.0),
    "eye_elbow": Bound(55.0, 95.0), "eye_hands_apart": Bound(45.0, 70.0), "eye_chest_travel": Bound(3.5, 7.0),
    "eye_head_travel": Bound(6.0, 12.0), "eye_head_with_hands": at_least(0.2), "eye_shoulder": at_least(0.6),
    "eye_wrist_95": at_least(12.0), "eye_finger_bend": Bound(18.0, 35.0), "eye_finger_between": at_least(8.0),
    "eye_thumb_index": at_most(0.85), "eye_fingers": at_least(30.0),
    timing.PITCH_P: Bound(high=0.05, strict=True), timing.FIRST_P: Bound(high=0.05, strict=True),
    "eye_held": Bound(4.0, 20.0), "eye_pause_moving": Bound(45.0, 90.0), "eye_pause_speed": Bound(0.45, 0.95),
    "eye_speech_over_silence": Bound(1.1, 2.3), "eye_loud": at_most(0.5), "eye_variation_speech": Bound(0.25, 0.45),
    "eye_both_hanging": Bound(4.0, 20.0), "eye_fast": at_most(6.0),
    "eye_hand_height_correlation": Bound(0.05, 0.60), "eye_hand_speed_correlation": at_most(0.68),
    "eye_one_handed": Bound(18.0, 37.0), "eye_one_hanging": at_least(12.0), "eye_head": Bound(7.0, 16.0),
    "eye_chest": Bound(3.4, 10.0),
    **{f"eye_speed_{percent}": Bound((1 - _BESIDE) * speed, (1 + _BESIDE) * speed)
       for percent, speed in REAL_SPEED.items()},
    "eye_stroke_amplitude": Bound(20.0, 32.0), "eye_stroke_amplitude_90": at_least(38.0), "eye_seam": at_most(1.20)}
"""Figure -> its bound."""
UNBROKEN = BOUNDS["eye_variation_speech"]
"""The same of speech whose pauses were cut out."""
OF_FINGERS = ("eye_wrist_95", "eye_finger_bend", "eye_finger_between", "eye_thumb_index", "eye_fingers")
"""Not measured of a motion without finger joints."""
OF_PAUSES = ("eye_pause_moving", "eye_pause_speed", "eye_speech_over_silence")
"""Not measured on voices without pauses."""


def title(name: str) -> str:
    """What a row of a table is called."""
    return timing.TITLES[name] if name in timing.TITLES else eye_heading(name)


def digits(name: str) -> int:
    """Behind the point, in tables."""
    if name.startswith("eye_speed"):
        return 2
    return EYE_METRICS[name].digits if name in EYE_METRICS else timing.DIGITS.get(name, 1)


def verdicts(where: str, figures: Figures) -> list[Verdict]:
    """Every bound, held against the figures of some voices; where: their name."""
    return [_verdict(name, where, figures.get(name, Interval.undefined())) if _known(name, figures)
            else skipped(f"{title(name)}, {where}", _why(name)) for name in BOUNDS]


def _verdict(name: str, where: str, value: Interval) -> Verdict:
    return Claim(f"{title(name)}, {where}", BOUNDS[name], digits(name)).judge(value)


def _known(name: str, figures: Figures) -> bool:
    """Whether a figure could be measured at all; one that could and is undefined does not hold."""
    value = figures.get(name, Interval.undefined()).mean
    if math.isfinite(value):
        return True
    # Fingers that stand still have no correlation, and that is a fault and not a lack of data.
    fingers = math.isfinite(figures.get("eye_fingers", Interval.undefined()).mean)
    return not (name in timing.TITLES or name in OF_PAUSES or name == "eye_seam" or (
        name in OF_FINGERS and not fingers))


def _why(name: str) -> str:
    if name in timing.TITLES:
        return "needs several recordings with a voice"
    if name in OF_FINGERS:
        return "the motion has no finger joints"
    return "block boundaries are not known" if name == "eye_seam" else "too few pauses"


def mark(name: str, value: Interval) -> str:
    """" !" where a figure lies outside of its bound."""
    return " !" if name in BOUNDS and math.isfinite(value.mean) and not BOUNDS[name].keeps(value.mean) else ""
