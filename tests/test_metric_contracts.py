"""What every metric keeps: unit and direction as data, a number for a clip, a reason where there is none, and the
direction itself on motion that is known to be worse."""

import math

import numpy as np
import pytest
from bursts import turned
from scipy.spatial.distance import cdist

from data_module.motion.kinematics import positions_of
from data_module.motion.skeletons import WHOLE_BODY, to_character
from data_module.types import Array, Motion, Speech
from eval.metrics import CLIP_METRICS, EYE_METRICS, METRICS, Metric, eye
from eval.metrics.diversity import diversity, motion_variance
from eval.metrics.encode import EncodedMotion
from eval.metrics.evaluate import MotionBeats, OnsetTrack, Values, clip_values, eye_values, lexeme_values
from eval.metrics.fgd import measure
from eval.metrics.gesture_features import RawFeatures, pooled
from eval.metrics.smoothness import hand_speeds, hellinger, speed_histogram
from eval.score import tables

SECONDS, FPS, RATE = 36.0, 30.0, 16000
UNITS = {"", "%", "cm", "cm/s", "deg", "m/s", "m/s^2", "m/s^3", "mm", "mm/frame^2", "mm/s^2", "nats"}
BEATS = np.cumsum(np.random.default_rng(0).uniform(0.45, 1.1, 200))
BEATS = BEATS[BEATS < SECONDS - 0.5]
TIME = np.arange(round(SECONDS * FPS)) / FPS


SLOW = np.sin(0.9 * TIME)
SILENCES = ((3.0, 3.8), (8.0, 8.9), (14.0, 20.0), (25.0, 25.7), (30.0, 30.8))
"""Seconds without a voice."""


def posed(**joints: Array) -> Motion:
    """A character whose arms hang; joints: exponential maps [T, 3] or [3]."""
    hanging = {"LeftArm": np.array([0.0, 0.0, -1.3]), "RightArm": np.array([0.0, 0.0, 1.3])}
    return turned(len(TIME), FPS, {**hanging, **joints}, WHOLE_BODY)


def turn(axis: int, angle: Array | float) -> Array:
    """[T, 3] an angle about one axis."""
    out = np.zeros((len(TIME), 3))
    out[:, axis] = angle
    return out


def lively() -> Motion:
    """Arms that swing, faster up to each beat, where they stop; the head, the trunk and the fingers move."""
    edges = np.concatenate([[0.0], BEATS, [SECONDS]])
    stroke = np.clip(np.searchsorted(edges, TIME, side="right") - 1, 0, len(edges) - 2)
    done = (TIME - edges[stroke]) / np.diff(edges)[stroke]
    size = np.random.default_rng(1).uniform(0.4, 1.2, len(edges))
    height = np.where(stroke % 2, 1.0 - done ** 2, done ** 2) * np.minimum(size[stroke], size[stroke])
    return posed(LeftArm=turn(2, -1.2 + 0.5 * height), RightArm=turn(2, 1.2 - height),
                 LeftForeArm=turn(1, -1.1 - 0.6 * height), RightForeArm=turn(1, 1.1 + 0.9 * height),
                 Head=turn(1, 0.2 * np.sin(1.7 * TIME)), Spine1=turn(0, 0.05 * np.sin(TIME)) + turn(1, 0.05 * SLOW),
                 LeftHandIndex2=turn(2, 0.3 * np.sin(3 * TIME)), RightHandIndex2=turn(2, 0.3 * np.sin(3 * TIME)),
                 LeftHandThumb2=turn(2, 0.2 * np.sin(3 * TIME)), RightHandThumb2=turn(2, 0.2 * np.sin(2 * TIME)))


def speech() -> Speech:
    """A burst at each beat over a quieter voice, with pauses."""
    rng = np.random.default_rng(2)
    samples = (0.04 * rng.normal(size=round(SECONDS * RATE))).astype(np.float32)
    for beat in BEATS:
        samples[int(beat * RATE):int(beat * RATE) + 3000] = 0.4 * rng.normal(size=3000).clip(-2, 2)
    for begin, stop in SILENCES:
        samples[int(begin * RATE):int(stop * RATE)] = 0.0
    return Speech(samples, RATE)


TRUTH, SPEECH = lively(), speech()
WORSE: dict[str, Motion] = {
    "statue": posed(Head=turn(1, 1.2)),
    "slow, one hand": posed(RightArm=turn(2, 0.9 + 0.4 * SLOW), Head=turn(0, 0.4 * SLOW), Spine1=turn(1, 0.3 * SLOW)),
    "arms in the trunk": posed(LeftArm=turn(2, -1.9), RightArm=turn(2, 1.9), LeftForeArm=turn(1, -0.6),
                               RightForeArm=turn(1, 0.6)),
    "drifting": posed(RightArm=turn(2, 1.3 - 1.3 * TIME / SECONDS), LeftArm=turn(2, -1.3 + 1.3 * TIME / SECONDS)),
    "whirling": posed(LeftArm=turn(2, 0.6 * np.sin(3.1 * TIME) - 1.6 * TIME),
                      RightArm=turn(2, 0.6 * np.sin(2 * TIME) + 1.1 * TIME)),
    "waiter": posed(LeftArm=turn(2, -1.4), RightArm=turn(2, 1.4), LeftForeArm=turn(1, -1.0) + turn(2, 1.0),
                    RightForeArm=turn(1, 1.0) + turn(2, -1.0)),
    "folded": posed(LeftArm=turn(2, -1.3), RightArm=turn(2, 1.3), LeftForeArm=turn(1, -2.5),
                    RightForeArm=turn(1, 2.5)),
    "shrugging, wrists and thumbs": posed(
        LeftShoulder=turn(2, 0.4 * SLOW), RightShoulder=turn(2, -0.4 * SLOW), LeftHand=turn(2, 0.8),
        RightHand=turn(2, -0.8), Spine1=turn(1, 0.4 * SLOW), LeftArm=turn(2, -1.2) + turn(1, -0.5 * SLOW),
        LeftHandThumb2=turn(2, 0.4 * SLOW), LeftHandIndex2=turn(2, -0.4 * SLOW),
        RightHandThumb2=turn(2, 0.4 * SLOW), RightHandIndex2=turn(2, -0.4 * SLOW)),
    "jumping at seams": posed(RightArm=turn(2, 1.0 - 0.8 * (np.floor(TIME) % 2))),
}
"""Motion that is wrong, each in a way that some metric is there to see."""
EDGES = np.arange(0.0, SECONDS + 0.5, 1.0)


def blocks(motion: Motion) -> Array:
    """[n, 48] the places of both arms' joints, a second each: what stands for a lexicon's latents."""
    names = [WHOLE_BODY.index(side + joint) for side in ("Left", "Right") for joint in ("ForeArm", "Hand")]
    places = positions_of(motion)[:, names]
    return places[:len(places) // 30 * 30:].reshape(-1, 30, 12)[:, ::8].reshape(-1, 48)


def measured(motion: Motion, sound: Speech = SPEECH) -> Values:
    """Every metric of a motion beside the truth: all that needs no model, and lexemes by place."""
    values = clip_values(motion, TRUTH, MotionBeats.of(motion), OnsetTrack.of(sound), seed=0)
    seen = eye_values(motion, eye.hear(sound), EDGES)
    lexicon = blocks(TRUTH)[::4]
    latents = blocks(motion)
    own, real = (EncodedMotion(part, cdist(part, lexicon).argmin(axis=1))  # type: ignore[arg-type]
                 for part in (latents, blocks(TRUTH)))
    of_lexemes = lexeme_values(own, real)
    out = Values({**values.numbers, **seen.numbers, **of_lexemes.numbers},
                 {**values.reasons, **seen.reasons, **of_lexemes.reasons})
    histograms = [speed_histogram(hand_speeds(one)) for one in (motion, TRUTH)]
    out.put("speed_distance", hellinger(*histograms), "")
    out.put("diversity", diversity(own.labels, len(lexicon)), "")
    out.put("motion_variance", motion_variance(latents, own.labels, lexicon), "")
    raw = RawFeatures(12)
    out.put("fgd", measure(*(pooled([to_character(one)], raw) for one in (motion, TRUTH))).interval.mean, "")
    return out


@pytest.fixture(scope="module")
def truth() -> Values:
    return measured(TRUTH)


@pytest.fixture(scope="module")
def worse() -> dict[str, Values]:
    rng = np.random.default_rng(5)
    late = Speech(np.roll(SPEECH.samples, int(0.31 * RATE)), RATE)
    noise = Speech((0.2 * rng.normal(size=len(SPEECH.samples))).astype(np.float32), RATE)
    return {**{name: measured(motion) for name, motion in WORSE.items()},
            "late speech": measured(TRUTH, late), "noise for speech": measured(TRUTH, noise)}


@pytest.mark.parametrize("name", METRICS)
def test_it_says_its_unit_its_direction_and_its_table(name: str) -> None:
    metric = METRICS[name]
    assert metric.unit in UNITS and metric.good in ("low", "high", "near", "") and 0 <= metric.digits <= 3
    assert metric.part in tables._PARTS and metric.heading.startswith(metric.title)


@pytest.mark.parametrize("name", METRICS)
def test_it_has_a_number_for_a_clip_within_its_unit(name: str, truth: Values) -> None:
    value = truth.numbers[name]
    assert math.isfinite(value), truth.reasons.get(name)
    if METRICS[name].unit == "%" and "above" not in name:
        assert 0 <= value <= 100
    if METRICS[name].unit in ("mm", "cm", "m/s", "m/s^2", "m/s^3", "nats", "deg") and name != "eye_azimuth":
        assert value >= 0


@pytest.mark.parametrize(("seconds", "sound"), [(4.0, None), (4.0, "silent"), (0.2, "silent")])
def test_what_is_not_defined_is_nan_with_a_reason_and_nothing_is_raised(seconds: float, sound: str | None,
                                                                         recwarn: pytest.WarningsRecorder) -> None:
    motion = posed().crop(0, round(seconds * FPS))
    speech = Speech(np.zeros(round(seconds * RATE), np.float32), RATE) if sound else None
    values = clip_values(motion, motion, MotionBeats.of(motion), OnsetTrack.of(speech) if speech else None, seed=0)
    seen = eye_values(motion, eye.hear(speech) if speech else None, None)
    lexemes = lexeme_values(None, None)
    numbers = {**values.numbers, **seen.numbers, **lexemes.numbers}
    reasons = {**values.reasons, **seen.reasons, **lexemes.reasons}
    assert numbers.keys() == {**CLIP_METRICS, **EYE_METRICS}.keys()
    assert {name for name, number in numbers.items() if not math.isfinite(number)} == reasons.keys()
    assert all(reason and "\n" not in reason for reason in reasons.values())
    assert "pmb_A" in reasons and numbers["speed_hands"] == pytest.approx(0, abs=1e-9)
    assert not [warning for warning in recwarn if issubclass(warning.category, RuntimeWarning)]


def badness(metric: Metric, value: float, true: float) -> float:
    """How far from good: less is better."""
    return abs(value - true) if metric.good == "near" else -value if metric.good == "high" else value


@pytest.mark.parametrize("name", [name for name, metric in METRICS.items() if metric.good])
def test_its_direction_holds_for_motion_that_is_known_to_be_worse(name: str, truth: Values, worse: dict[str, Values]
                                                                  ) -> None:
    metric, true = METRICS[name], truth.numbers[name]
    found = {motion: badness(metric, values.numbers[name], true) for motion, values in worse.items()}
    found = {motion: value for motion, value in found.items() if math.isfinite(value)}
    assert max(found.values()) > badness(metric, true, true) + 0.02 * max(abs(true), 0.05), found
    if metric.good == "low" and name not in EYE_METRICS:
        assert true == pytest.approx(0.0, abs=1e-9)
        assert min(found.values()) >= -1e-9
