"""The classifier of gestures: what it must tell apart and must not see, and the probe that asks it."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from data_module.errors import InputError
from data_module.motion import bvh, rotation
from data_module.motion.skeletons import FINGERED
from data_module.types import Motion
from eval.metrics.gesture_recognition import (
    DescribedGesture,
    GestureBody,
    GestureClassifier,
    GestureSpan,
    chosen_among,
    cross_validated,
    mirrored_label,
)
from eval.probes import recognition
from gesticulator.body.mirror import mirrored_motion
from gesticulator.directing.gesture_phases import longest
from gesticulator.directing.named_gestures import laid_over
from gesticulator.plan.plan import GestureCue

NAMES = ("point right", "stop palm", "shrug", "head scratch", "nod")


def _hanging() -> np.ndarray:
    """[3 J] a pose with both arms down."""
    pose = np.zeros((len(FINGERED), 3))
    pose[FINGERED.index("LeftArm"), 2], pose[FINGERED.index("RightArm"), 2] = -1.3, 1.3
    return pose.reshape(-1)


def _drawn(name: str, draw: int) -> tuple[Motion, GestureSpan]:
    phases = longest(name)
    times = np.arange(round((phases.before + phases.after + 0.4) * 30.0)) / 30.0
    apex = phases.before + 0.2
    poses = laid_over(np.repeat(_hanging()[None], len(times), axis=0), times, [(GestureCue(name), apex)], seed=draw)
    turns = rotation.from_exponential_map(poses.reshape(len(poses), -1, 3))
    return Motion(FINGERED, turns, np.zeros((len(turns), 3)), 30.0), recognition.span_of(name, apex)


@pytest.fixture(scope="module")
def drawn() -> list[DescribedGesture]:
    """Four variations of five scripts; the person is the number of the variation."""
    return [DescribedGesture.of(name, *_drawn(name, draw), person=str(draw)) for name in NAMES for draw in range(4)]


def test_other_variations_of_a_script_are_recognised_and_shuffled_labels_are_not(drawn: list[DescribedGesture]) -> None:
    named = recognition.Named(drawn, cross_validated(drawn, lambda one: one.person),
                              sorted({*NAMES, "point left"}))
    assert named.mean(named.hits).mean >= 0.9 and named.mean(named.of_five).mean >= 0.95
    labels = [drawn[k].label for k in np.random.default_rng(1).permutation(len(drawn))]
    other = cross_validated(drawn, lambda one: one.person, labels)
    assert replace(named, scores=other).hits.mean() < 0.5


def test_a_mirror_image_gets_the_mirrored_name() -> None:
    assert mirrored_label("point left") == "point right" and mirrored_label("shrug") == "shrug"
    motion, span = _drawn("point right", 0)
    there, back = (DescribedGesture.of("point right", one, span) for one in (motion, mirrored_motion(motion)))
    np.testing.assert_allclose(there.views[0], back.views[1], atol=1e-9)
    classes = [DescribedGesture.of(name, *_drawn(name, draw)) for name in NAMES for draw in (1, 2, 3)]
    model = GestureClassifier(classes)
    assert model.labels == tuple(sorted({*NAMES, "point left"})), "a mirror image may be a class of its own"
    for view, label in ((0, "point right"), (1, "point left")):
        assert model.labels[int(model.scores([there], view).argmax())] == label


def test_where_the_body_stands_and_turns_does_not_matter() -> None:
    motion, span = _drawn("stop palm", 0)
    turned = motion.rotations.copy()
    yaw = np.array([np.cos(0.6), 0.0, np.sin(0.6), 0.0])
    turned[:, 0] = rotation.multiply(np.broadcast_to(yaw, turned[:, 0].shape), turned[:, 0])
    moved = replace(motion, rotations=turned, root_positions=motion.root_positions + np.array([3.0, 0.1, -2.0]))
    np.testing.assert_allclose(GestureBody(moved).figures(span), GestureBody(motion).figures(span), atol=1e-6)


def test_a_hanging_hand_tells_nothing_of_where_it_hangs() -> None:
    """One that waves beside the thigh is out of the gesture; one that is raised is not."""
    motion, span = _drawn("head scratch", 0)
    figures = GestureBody(motion).figures(span)
    for joint, angle, same in (("LeftHand", 0.5, True), ("LeftArm", 1.3, False)):
        turns = motion.rotations.copy()
        bend = np.array([np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)])
        place = FINGERED.index(joint)
        turns[:, place] = rotation.multiply(turns[:, place], np.broadcast_to(bend, turns[:, place].shape))
        change = np.abs(GestureBody(replace(motion, rotations=turns)).figures(span) - figures).max()
        assert (change < 0.1) == same, (joint, change)


def test_among_five_is_chance_for_equal_scores_and_sure_for_the_best() -> None:
    rng = np.random.default_rng(0)
    scores, right = rng.normal(size=(2000, 18)), rng.integers(18, size=2000)
    assert chosen_among(scores, right, 5).mean() == pytest.approx(0.2, abs=0.02)
    best = scores.copy()
    best[np.arange(2000), right] = 9.0
    assert (chosen_among(best, right, 5) == 1.0).all()
    assert chosen_among(scores, right, 99).mean() == pytest.approx(1 / 18, abs=0.01), "among all, if there are no more"
    # A class with 12 of 17 others below it is the best of five with the chance of drawing four of these twelve.
    ranked = np.arange(18.0)[None]
    assert chosen_among(ranked, np.array([12]), 5, draws=20000)[0] == pytest.approx(
        12 * 11 * 10 * 9 / (17 * 16 * 15 * 14), abs=0.01)


def test_versions_of_a_take_are_one_take() -> None:
    of = recognition.take_of
    assert len({of(f"strokes/x/brad_Idle01_{name}.bvh") for name in ("ChopBt01", "ChopLf01", "ChopBoth01")}) == 1
    assert of("pn_we2.bvh") == of("pn_we_intense2.bvh") != of("pn_us2.bvh")


# ---------------------------------------------------------------- the probe

def _source(folder: Path, rows: Sequence[Sequence[object]]) -> Path:
    (folder / "meaning").mkdir(exist_ok=True)
    with (folder / "meaning" / "licensed_clips.csv").open("w", newline="") as file:
        csv.writer(file).writerows([("file", "person", "label", "strokeStart", "stroke", "relax"), *rows])
    return folder


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Clips of two people, of three classes; one has too few, and one is of no gesture."""
    folder, rows = tmp_path_factory.mktemp("clips"), []
    for name, count in (("stop palm", 4), ("nod", 4), ("shrug", 3), ("head scratch", 4)):
        for number in range(count):
            motion, span = _drawn(name, number)
            bvh.write_bvh(folder / f"{name}{number}.bvh", motion)
            times = ("", "", "") if name == "nod" else (span.begin, span.apex, span.end)
            label = "juggling" if name == "head scratch" else name.replace(" ", "_")
            rows.append((f"{name}{number}.bvh", ("brad", "brad2", "garza", "garza")[number], label, *times))
    return _source(folder, rows)


def test_classes_are_those_with_enough_clips_of_enough_people(source: Path) -> None:
    clips = recognition.read_clips(source)
    assert {one.label for one in clips} == {"stop palm", "nod"} and len(clips) == 8
    assert {one.person for one in clips} == {"brad", "garza"}, "two names of one person"


def test_bad_tables_are_refused(source: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not exist"):
        recognition.read_clips(tmp_path)
    with pytest.raises(InputError, match="has 0 classes"):
        recognition.read_clips(_source(tmp_path, [("a.bvh", "x", "shrug", 1, 2, 3)]))
    rows = [(str(source / "stop palm0.bvh"), person, label, "soon", 2, 3) for person in ("a", "b")
            for label in ("shrug", "nod") for _ in range(2)]
    with pytest.raises(InputError, match="line 2: holds no seconds"):
        recognition.read_clips(_source(tmp_path, rows))


def test_without_a_gesture_nothing_of_it_is_left() -> None:
    rest = _hanging()
    one, other = (recognition.drawn_alone(name, 0, rest, cue=False) for name in ("stop palm", "sweep no"))
    still, drawn = one.views[0, 0], recognition.drawn_alone("stop palm", 0, rest).views[0, 0]
    np.testing.assert_allclose(still, other.views[0, 0], atol=1e-9)
    assert np.abs(still - drawn).max() > 0.5
