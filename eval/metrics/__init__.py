"""Metrics: a chapter each, with its theory, its unit, and what fools it; and `METRICS`, the table of them all.

Values of one clip come from `eval.metrics.evaluate`; `gesticulator score` makes the tables.

    >>> METRICS["maje"].good, METRICS["maje"].unit, METRICS["maje"].heading
    ('low', 'mm', 'MAJE, mean of coordinates, mm')
"""

from dataclasses import dataclass

from eval.table import Column

__all__ = ["METRICS", "Metric"]


@dataclass(frozen=True)
class Metric(Column):
    """A figure of a clip, or of a set of clips, as tables show it. good: "low", "high", "near" the speaker's own value,
    or "" for a figure that is no judgement; part: the table it stands in."""

    part: str = ""


CLIP_METRICS: dict[str, Metric] = {
    "maje": Metric("MAJE, mean of coordinates", "mm", 1, "low", "joints"),
    "mad": Metric("MAD, length", "mm/s^2", 0, "low", "joints"),
    "mad_per_frame": Metric("MAD, length", "mm/frame^2", 2, "low", "joints"),
    # Beats A are where the arms brake hardest, B where they are slowest: the paper's words fit either.
    "pmb_A": Metric("PMB A, 0.1 s", "%", 1, "high", "beats"),
    "chance_A": Metric("chance of PMB A", "%", 1, "", "beats"),
    "above_A": Metric("PMB A above chance", "%", 1, "high", "beats"),
    "pmb_A_wide": Metric("PMB A, 0.2 s", "%", 1, "high", "beats"),
    "pmb_B": Metric("PMB B, 0.1 s", "%", 1, "high", "beats"),
    "chance_B": Metric("chance of PMB B", "%", 1, "", "beats"),
    "above_B": Metric("PMB B above chance", "%", 1, "high", "beats"),
    "beats_per_second": Metric("motion beats A a second", "", 2, "near", "beats"),
    "speed_hands": Metric("hand speed", "m/s", 3, "near", "vigour"),
    "acceleration_hands": Metric("hand acceleration", "m/s^2", 2, "near", "vigour"),
    "jerk_hands": Metric("hand jerk", "m/s^3", 1, "near", "vigour"),
    # Of a lexicon, so undefined without --bundle.
    "lexeme_accuracy": Metric("lexemes like the speaker's own", "%", 1, "high", "lexemes"),
}
"""Those that have a value for each clip, without the eye's."""

SET_METRICS: dict[str, Metric] = {
    # Of all clips together: a histogram, an entropy or a covariance of one clip says little.
    "speed_distance": Metric("distance of hand-speed histograms (Hellinger)", "", 3, "low", "sets"),
    "diversity": Metric("diversity", "nats", 2, "near", "sets"),
    "motion_variance": Metric("motion variance", "", 3, "near", "sets"),
}
"""Those of a set of clips, but for FGD."""

EYE_METRICS: dict[str, Metric] = {
    "eye_hand_speed_correlation": Metric("L/R hand speed correlation", "", 2, "near", "eye hands"),
    "eye_hand_height_correlation": Metric("L/R hand height correlation", "", 2, "near", "eye hands"),
    "eye_one_handed": Metric("one-handed share of movement", "%", 0, "near", "eye hands"),
    "eye_one_hanging": Metric("exactly one hand hanging", "%", 0, "near", "eye hands"),
    "eye_both_hanging": Metric("both hands hanging", "%", 0, "near", "eye hands"),
    "eye_speed_25": Metric("hand speed, 25 %", "m/s", 2, "near", "eye hands"),
    "eye_speed_50": Metric("hand speed, 50 %", "m/s", 2, "near", "eye hands"),
    "eye_speed_75": Metric("hand speed, 75 %", "m/s", 2, "near", "eye hands"),
    "eye_speed_95": Metric("hand speed, 95 %", "m/s", 2, "near", "eye hands"),
    # Anything that looks at both ends of a clip is judged on long ones only (30 s).
    "eye_drift": Metric("mean wrist of the last 15 s from the first", "cm", 0, "low", "eye hands"),
    "eye_head": Metric("head on chest, spread", "deg", 1, "near", "eye trunk"),
    "eye_chest": Metric("chest, spread", "deg", 1, "near", "eye trunk"),
    "eye_hand_in_torso": Metric("hand in the torso", "%", 1, "low", "eye trunk"),
    "eye_fingers": Metric("fingers moving", "%", 0, "near", "eye trunk"),
    "eye_stroke_amplitude": Metric("stroke amplitude, median", "cm", 0, "near", "eye strokes"),
    "eye_stroke_amplitude_90": Metric("stroke amplitude, 90 %", "cm", 0, "near", "eye strokes"),
    "eye_seam": Metric("acceleration at seams over elsewhere", "", 2, "low", "eye strokes"),
    "eye_repetition": Metric("nearest other 2 s window over spread", "", 2, "near", "eye strokes"),
    "eye_speech_speed": Metric("hand speed in speech", "m/s", 2, "near", "eye voice"),
    "eye_silence_speed": Metric("hand speed in silence", "m/s", 2, "near", "eye voice"),
    "eye_speech_over_silence": Metric("speech over silence, speed", "", 2, "near", "eye voice"),
    "eye_above_1": Metric("PMB above chance, 0.1 s, first detector", "%", 0, "high", "eye voice"),
    "eye_above_2": Metric("PMB above chance, 0.1 s, second", "%", 0, "high", "eye voice"),
    "eye_jumps": Metric("jumps of an arm, a minute", "", 1, "near", "eye arms"),
    "eye_flips": Metric("flips of an elbow, a minute", "", 1, "near", "eye arms"),
    "eye_strong_jumps": Metric("strong jumps, a minute", "", 1, "low", "eye arms"),
    "eye_frozen": Metric("frozen arms, a minute of speech", "", 1, "low", "eye arms"),
    "eye_folded": Metric("elbow bent by over 145 degrees, of the time", "%", 1, "", "eye arms"),
    "eye_lean": Metric("sideways lean, spread over 8 s", "deg", 1, "near", "eye arms"),
    "eye_tilt": Metric("tilt of the shoulders, spread over 8 s", "deg", 1, "near", "eye arms"),
    "eye_neck_still": Metric("neck still, of the time", "%", 1, "near", "eye arms"),
    "eye_left_behind": Metric("raised and still while the other hand is fast", "%", 1, "low", "eye arms"),
    "eye_prepared": Metric("strokes with a preparation", "%", 0, "near", "eye arms"),
    "eye_retracted": Metric("units with a retraction", "%", 0, "near", "eye arms"),
    "eye_splay": Metric("forearm outward, of the time", "%", 0, "low", "eye posture"),
    "eye_splay_both": Metric("both forearms outward, of the time", "%", 0, "low", "eye posture"),
    "eye_azimuth": Metric("azimuth of the forearm, outward", "deg", 0, "near", "eye posture"),
    "eye_elbow": Metric("elbow bend", "deg", 0, "near", "eye posture"),
    "eye_face": Metric("arm before the face, of the time", "%", 1, "low", "eye posture"),
    "eye_hands_apart": Metric("hands apart", "cm", 0, "near", "eye posture"),
    "eye_shoulder": Metric("shoulder lift, spread", "cm", 1, "near", "eye posture"),
    "eye_wrist_95": Metric("wrist bend, 95 %", "deg", 0, "near", "eye posture"),
    "eye_finger_bend": Metric("finger bend", "deg", 0, "near", "eye posture"),
    "eye_finger_between": Metric("finger bend, spread between joints", "deg", 1, "near", "eye posture"),
    "eye_thumb_index": Metric("thumb with index finger, correlation", "", 2, "near", "eye posture"),
    "eye_head_with_hands": Metric("head with hands, correlation", "", 2, "near", "eye together"),
    "eye_head_travel": Metric("head travel", "cm/s", 1, "near", "eye together"),
    "eye_chest_travel": Metric("chest travel", "cm/s", 1, "near", "eye together"),
    "eye_fast": Metric("hand velocity in 3 to 6 Hz", "%", 1, "low", "eye together"),
    "eye_held": Metric("raised hand held, of speech", "%", 1, "near", "eye phrases"),
    "eye_pause_moving": Metric("pauses with a moving hand", "%", 0, "near", "eye phrases"),
    "eye_pause_speed": Metric("speed in pauses over around them", "", 2, "near", "eye phrases"),
    "eye_loud": Metric("log hand speed with loudness, correlation", "", 2, "near", "eye phrases"),
    "eye_variation_speech": Metric("variation over 4 s, in speech", "", 2, "near", "eye phrases"),
}
"""The figures for the eye (`eval.metrics.eye`), of one clip each, in the order of a table. Which controls pass depends
on the speaker: each chapter tells it, and `gesticulator score` marks it on the clips at hand."""

# FGD has a column for each space, and each space has its own unit.
METRICS: dict[str, Metric] = {**CLIP_METRICS, **SET_METRICS, "fgd": Metric("FGD", "", 2, "low", "fgd"), **EYE_METRICS}
"""Every metric by name."""
