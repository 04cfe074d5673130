"""The figures for the eye: is it mirrored, stiff, small, or dead? A chapter each, on one common body.

Tables of joint errors and beats passed motion that any viewer refuses: both hands rising together, a fixed head, small
strokes with a pulse at every block. These figures see that. They are defined on `body.CommonBody`, at 60 Hz, so that
people and rigs of all sizes compare; each chapter tells its theory, unit, and what fools it.

`hands` (two hands, speeds, drift) · `trunk` (head, chest, freezes, contact, fingers) · `strokes` (size, length, seams,
repetition) · `posture` (forearms, elbows, wrists, fingers, shoulders) · `together` (head and trunk with the hands,
activity over seconds) · `units` (gesture units, holds, pauses, first movements) · `voice` (timing by two detectors,
loudness, silence) · `frechet` (everything at once). `stability` compares two takes, `pitch` many recordings.

Real people differ: `RANGES` is the span of two real takes of about 65 s (a strong gesturer, and BEAT's Scott), whole
and in halves, widened by a quarter of its width. Outside of it a figure is unlike these two, not wrong; two people are
few. Inside of it nothing is proven: `eval.metrics.METRICS` names for each figure the controls that lie inside, too.
"""

from __future__ import annotations

import math

import numpy as np

from data_module.types import Array, Motion
from eval.metrics.eye import frechet, hands, posture, strokes, together, trunk, units, voice
from eval.metrics.eye.body import CommonBody, common_body
from eval.metrics.eye.frechet import ReferenceSpace
from eval.metrics.eye.voice import VoiceActivity, hear

SHORTEST = 2.0
"""Seconds: shorter motion has no figure."""
RANGES: dict[str, tuple[float, float]] = {
    "eye_hand_speed_correlation": (0.287, 0.832), "eye_hand_height_correlation": (0.0, 0.778),
    "eye_one_handed": (12.99, 47.11), "eye_one_hanging": (18.17, 28.94), "eye_both_hanging": (0.0, 42.11),
    "eye_speed_5": (0.015, 0.087), "eye_speed_25": (0.048, 0.268), "eye_speed_50": (0.147, 0.522),
    "eye_speed_75": (0.384, 1.133), "eye_speed_95": (0.786, 2.563), "eye_speed_99": (1.122, 4.101),
    "eye_head": (6.14, 18.42), "eye_chest": (2.34, 10.18),
    "eye_stroke_duration": (0.275, 1.025), "eye_stroke_duration_90": (0.665, 2.433),
    "eye_stroke_amplitude": (21.35, 36.14), "eye_stroke_amplitude_90": (41.73, 58.98),
    "eye_attack": (47.1, 49.45), "eye_rising": (46.65, 49.51),
    "eye_repetition": (0.559, 0.773), "eye_freeze": (0.0, 0.25), "eye_freeze_hands": (0.0, 1.325),
    "eye_speech_speed": (0.278, 1.129), "eye_silence_speed": (0.153, 0.628),
    "eye_speech_over_silence": (0.755, 2.842), "eye_above_1": (0.93, 100.0), "eye_above_2": (-26.56, 100.0),
    "eye_splay": (0.0, 14.14), "eye_splay_both": (0.0, 7.49), "eye_azimuth": (-37.78, 6.09),
    "eye_elbow": (45.0, 100.0), "eye_folded": (0.0, 5.97), "eye_hands_apart": (38.8, 74.3),
    "eye_shoulder": (0.242, 1.409), "eye_wrist_50": (4.38, 15.7), "eye_wrist_95": (11.91, 83.94),
    "eye_finger_bend": (11.9, 40.88), "eye_finger_over_time": (0.0, 35.41), "eye_finger_between": (6.69, 22.98),
    "eye_thumb_index": (0.393, 1.0), "eye_head_with_hands": (0.114, 0.635), "eye_chest_with_hands": (0.0, 0.621),
    "eye_chest_side": (-0.81, 0.473), "eye_head_travel": (4.41, 9.7), "eye_chest_travel": (2.67, 8.61),
    "eye_fast": (0.0, 15.0), "eye_variation": (0.216, 0.435), "eye_units": (1.28, 13.35),
    "eye_unit_length": (0.0, 17.95), "eye_unit_length_90": (0.65, 43.55), "eye_unit_time": (69.27, 100.0),
    "eye_unit_strokes": (0.0, 29.5), "eye_unit_single": (0.0, 67.31), "eye_held": (0.0, 23.47),
    "eye_holds": (0.0, 24.61), "eye_pause_moving": (29.88, 100.0), "eye_pause_speed": (0.4, 1.2),
    "eye_lead": (-0.308, 0.042), "eye_lead_before": (44.44, 100.0), "eye_loud": (-0.231, 0.805),
    "eye_loud_speech": (-0.427, 0.52), "eye_variation_speech": (0.027, 0.513),
    # Rules instead of ranges: what no person shows, or what a second take could not have told.
    "eye_seam": (0.0, 1.35), "eye_frechet": (0.0, 19.5), "eye_frechet_pooled": (0.0, 19.5),
    "eye_freeze_head": (0.0, 1.0), "eye_hand_in_torso": (0.0, 1.0), "eye_elbow_in_torso": (0.0, 1.0),
    "eye_elbow_behind": (0.0, 1.0), "eye_elbow_fastest": (0.0, 4.0),
    "eye_head_yaw": (0.0, 25.0), "eye_loudness": (-0.07, 0.36), "eye_drift": (0.0, 15.0), "eye_fingers": (30.0, 100.0),
    "eye_face": (0.0, 1.0),
}
"""Figure -> (low, high). Frechet: one and a half times the farther half of a real take (13). Timing has no upper end:
what is more in time than a person is not refused for it, so bobbing passes, and is named as a control that does."""


def figures(motion: Motion, heard: VoiceActivity | None = None, edges: Array | None = None,
            space: ReferenceSpace | None = None) -> dict[str, float]:
    """Every figure of a motion of any upper body; NaN where one is not defined.

    heard: of its speech (`hear`), without which the chapter of the voice is left undefined; edges: [N + 1] seconds of
    its own blocks, for the seams; space: for the Frechet distance. InputError where the joints are not known.
    """
    return of_body(common_body(motion), heard, edges, space)


def of_body(body: CommonBody, heard: VoiceActivity | None = None, edges: Array | None = None,
            space: ReferenceSpace | None = None) -> dict[str, float]:
    """The same of a body that is at hand."""
    out = dict.fromkeys(FIGURES, math.nan)
    if body.duration < SHORTEST:
        return out
    out |= hands.figures(body) | trunk.figures(body) | strokes.figures(body, edges)
    out |= posture.figures(body) | together.figures(body) | units.figures(body)
    if heard is not None:
        out |= voice.figures(body, heard) | units.sound_figures(body, heard)
    if space is not None:
        out["eye_frechet"] = space.distance(frechet.windows(body))
    return out


def within(name: str, value: float) -> bool | None:
    """True if a figure lies in the range of real people; None without a range or a value."""
    if name not in RANGES or not np.isfinite(value):
        return None
    low, high = RANGES[name]
    return low <= value <= high


FIGURES: tuple[str, ...] = (
    "eye_hand_speed_correlation", "eye_hand_height_correlation", "eye_one_handed", "eye_one_hanging",
    "eye_both_hanging", *(f"eye_speed_{percent}" for percent in hands.PERCENTILES), "eye_drift", "eye_head",
    "eye_chest", "eye_head_yaw", "eye_freeze", "eye_freeze_head", "eye_freeze_hands", "eye_hand_in_torso",
    "eye_elbow_in_torso", "eye_elbow_behind", "eye_elbow_fastest", "eye_fingers", "eye_stroke_amplitude",
    "eye_stroke_amplitude_90", "eye_stroke_duration", "eye_stroke_duration_90", "eye_attack", "eye_rising", "eye_seam",
    "eye_repetition", "eye_speech_speed",
    "eye_silence_speed", "eye_speech_over_silence", "eye_loudness", "eye_above_1", "eye_above_2",
    *posture.FIGURES, *together.FIGURES, *units.FIGURES, *units.SOUND_FIGURES, "eye_frechet")
"""Every figure of a clip, in the order of a table."""

__all__ = ["FIGURES", "RANGES", "SHORTEST", "CommonBody", "ReferenceSpace", "VoiceActivity", "common_body", "figures",
           "hear", "of_body", "within"]
