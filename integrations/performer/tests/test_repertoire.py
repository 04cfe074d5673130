"""Scripted gestures as strokes of the performer: drawn with marked phases, lent, placed at words within a budget."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gesticulator_performer import text
from gesticulator_performer.cues import Cues
from gesticulator_performer.repertoire import Repertoire, read_repertoire, write_takes
from gesticulator_performer.strokes import SCRIPTED, StrokeSet, standing_body
from procedural import PERFORMER, planned, played, procedural_strokes, said

from data_module.errors import InputError
from data_module.motion import rotation
from data_module.motion.bvh import read_bvh
from gesticulator.cli import main
from gesticulator.directing.meaning_cues import meaning_cues
from gesticulator.plan.gestures import REPERTOIRE

NAMES = ("thumbs up", "now press", "point left", "point ahead", "bow", "zip lips")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Takes of six gestures."""
    out = tmp_path_factory.mktemp("takes") / "takes"
    # Four core gestures in four variations, two others in two, each in three sizes.
    assert write_takes(out, 3, NAMES) == 3 * (4 * 4 + 2 * 2)
    return out


@pytest.fixture(scope="module")
def takes(folder: Path) -> Repertoire:
    return read_repertoire(folder)


@pytest.fixture(scope="module")
def strokes(takes: Repertoire) -> StrokeSet:
    return replace(procedural_strokes(), repertoire=takes, cues=Cues({}, {}, takes.labels, detected=True))


TALK = ("great job with this lovely stone| the lamp is on the table and the river is long| at this moment we walk home "
        "with the old horse| from now on the house is open for the farmer| turn left at the old mill and the bridge| "
        "that is excellent said the farmer")


def test_no_two_takes_are_alike_and_the_same_seed_draws_the_same_bytes(folder: Path, tmp_path: Path) -> None:
    write_takes(tmp_path / "again", 3, NAMES[:1])
    files = {file.name: file.read_bytes() for file in (tmp_path / "again").glob("*.bvh")}
    assert files == {name: (folder / name).read_bytes() for name in files} and len(set(files.values())) == 12


def test_a_take_on_the_body_it_was_drawn_for_is_what_was_drawn(folder: Path, takes: Repertoire) -> None:
    outline = next(one for one in takes.outlines if one.base == SCRIPTED + "point_ahead_large_1")
    motion = read_bvh(folder / "point_ahead_large_1.bvh", unit=1.0)
    body = standing_body("itself", [motion])
    stroke = takes.played(outline, body)
    rotations = np.repeat(body.rest[None], len(motion), axis=0)
    for joints, logs in ((body.arms[0], stroke.arms[0]), (body.arms[1], stroke.arms[1]), (body.trunk, stroke.trunk)):
        rotations[:, list(joints)] = rotation.multiply(body.rest[list(joints)], rotation.from_exponential_map(logs))
    assert np.degrees(rotation.angle_between(rotations, motion.rotations)).max() < 0.01
    other = takes.played(next(one for one in takes.outlines if one.clip == outline.base + "-mirrored"), body)
    assert (outline.hand, other.hand, other.meaning) == ("right", "left", "point_ahead")
    assert np.allclose(other.arms[0] * [1.0, -1.0, -1.0], stroke.arms[1])
    assert (other.start, other.beat, other.hold_end, other.end) == (
        stroke.start, stroke.beat, stroke.hold_end, stroke.end)


def test_gestures_come_at_their_words_within_the_budget(strokes: StrokeSet) -> None:
    spoken = said(TALK, 4)
    words = [word.text for word in spoken.speech.words or ()]
    at = defaultdict(set)
    count = 0
    for seed in range(12):
        meant = [p for p in planned(spoken, strokes, seed) if p.meaning]
        count += len(meant)
        for p in meant:
            assert p.stroke.scripted and p.gain == 1.0
            at[p.meaning].add(words[p.word])
            # The apex falls -0.20 to 0.05 s from the vowel, after the preparation; the hold keeps its length.
            assert -0.2 <= p.beat - p.syllable <= 0.05 and p.start < p.syllable - 0.3
            assert p.hold_end - p.beat >= p.stroke.hold_end - p.stroke.beat - 1e-9
        times = [p.syllable for p in meant]
        assert np.diff(times).min() >= 3.0
        for label in at:
            assert all(np.diff([p.syllable for p in meant if p.meaning == label]) >= 20.0)
    assert at == {"thumbs_up": {"job", "excellent"}, "now_press": {"moment"}, "point_ahead": {"now"},
                  "point_left": {"left"}}
    assert count > 60


def test_a_played_take_shows_its_pose_at_the_apex(strokes: StrokeSet) -> None:
    performance = played(said(TALK), strokes, 2)
    meant = [p for p in performance.strokes if p.stroke.scripted and p.stroke.hand != "none"]
    assert len(meant) >= 2 and all(stroke.meaning in ("thumbs_up", "now_press", "point_ahead", "point_left")
                                   for stroke in meant)
    body = strokes.figures[PERFORMER]
    assert strokes.repertoire is not None
    for stroke in meant:
        outline = next(one for one in strokes.of(PERFORMER) if one.clip == stroke.stroke.clip)
        drawn = strokes.played(outline, PERFORMER)
        for side in outline.sides:
            joints = list(body.arms[side][1:3])
            wanted = rotation.multiply(body.rest[joints], rotation.from_exponential_map(
                drawn.arm_at(side, np.array([drawn.beat])).reshape(-1, 3)[1:3]))
            frames = [round(60 * time) for time in (stroke.beat + 0.1, stroke.start)]
            shown = (performance.motion.rotations[frame][joints] for frame in frames)
            apart = [np.degrees(rotation.angle_between(pose, wanted)).max() for pose in shown]
            assert apart[0] < 15.0 < apart[1]


def test_the_build_refuses_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for more, message in ((["--hours", "0"], "--hours: is 0"), (["--seed", "-1"], "--seed: is -1")):
        with pytest.raises(SystemExit) as stopped:
            main(["build", "performer", "--out", str(tmp_path / "store"), *more])
        assert stopped.value.code == 2 and message in capsys.readouterr().err
    with pytest.raises(InputError, match=r"takes\.csv: does not exist"):
        read_repertoire(tmp_path / "nothing")
    assert not (tmp_path / "store").exists()


def test_every_gesture_has_sentences_whose_words_call_for_it() -> None:
    """In the training and in the test texts; most are found by the detector."""
    labels = {name.replace(" ", "_") for name, gesture in REPERTOIRE.items() if not gesture.offensive}
    detector = meaning_cues("en")
    known = set(detector.gestures)
    for split, new in text.REPERTOIRE.items():
        assert labels <= set(text.MEANINGS[split]) | set(new)
        topics = text.TOPICS[split]
        rng = np.random.default_rng(0)
        hits = []
        for label, templates in new.items():
            for template in templates if label in known else ():
                words = text._fill(rng, topics[len(hits) % len(topics)], template).replace("|", " ").split()
                hits.append(label in {call.label for call in detector.called(words)})
        assert np.mean(hits) > 0.85
