"""The map of the lexicon: what goes with a lexeme, and a page that works."""

from __future__ import annotations

import csv
import math
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from performances import perform

from data_module.blocks import cut
from data_module.errors import InputError
from data_module.motion import rotation
from data_module.motion.skeletons import CHARACTER
from data_module.store import Recording, RecordingInfo, Store, StoreWriter
from data_module.truth import PlayedStroke, Truth
from data_module.types import Blocks, Motion, Speech, Word
from eval.commands import PLOT
from eval.metrics.encode import EncodedMotion, encode_motion
from eval.pictures import embedding
from eval.pictures import lexicon_map as maps
from eval.pictures.lexicon_sheet import in_words
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle.bundle import Bundle

# ------------------------------------------------------------------------------------------ what goes with a lexeme

def test_distinctive_words_are_the_planted_ones() -> None:
    rng = np.random.default_rng(0)
    vocabulary = ["the", "of", "stop", "me", "rare"]
    counts = rng.multinomial(200, [0.5, 0.5, 0, 0, 0], size=12)
    counts[:, 2] = 2
    counts[3, 2] = 40
    counts[7, 3], counts[7, 4] = 25, 4  # one that stands nowhere else, and one too few to tell
    got = maps.distinctive(counts, vocabulary)
    assert [[word.text for word in own] for own in got] == [
        ["stop"] if i == 3 else ["me"] if i == 7 else [] for i in range(12)]
    assert got[3][0].count == 40


def test_distinctive_is_the_log_odds_by_hand() -> None:
    counts = np.array([[30, 70], [20, 380]])
    word = maps.distinctive(counts, ["a", "b"], sure=0.0)[0][0]
    prior = maps.PRIOR * 50 / 500
    odds = [math.log((y + prior) / (n + maps.PRIOR - y - prior)) for y, n in ((30, 100), (20, 400))]
    assert (word.text, word.count) == ("a", 30)
    assert word.z == pytest.approx((odds[0] - odds[1]) / math.sqrt(1 / (30 + prior) + 1 / (20 + prior)))


def test_words_by_chance_hardly_ever_stand_out() -> None:
    rng = np.random.default_rng(1)
    shares = 1 / np.arange(1, 301)
    counts = rng.multinomial(400, shares / shares.sum(), size=50)
    found = sum(len(own) for own in maps.distinctive(counts, [str(i) for i in range(300)], most=300))
    assert found < 0.005 * (counts >= maps.LEAST).sum()


def still(seconds: float, fps: float = 20.0) -> Motion:
    count = round(seconds * fps)
    unit = np.tile([1.0, 0, 0, 0], (count, len(CHARACTER), 1))
    return Motion(CHARACTER, unit, np.zeros((count, 3)), fps)


def take(motion: Motion, words: tuple[Word, ...] = (), strokes: tuple[PlayedStroke, ...] = (), name: str = "take"
         ) -> Recording:
    speech = Speech(np.zeros(round(motion.duration * 16000), np.float32), 16000, words)
    return Recording(RecordingInfo(name, "train", "ann", "tone", "en"), speech, motion, Truth(strokes))


def stroke(kind: str, start: float, end: float) -> PlayedStroke:
    return PlayedStroke(kind, "clip", "both", start, (start + end) / 2, end, end, start, 1.0, False)


def test_words_and_strokes_find_their_blocks() -> None:
    words = (Word("Well,", 0.0, 0.4), Word("", 0.4, 0.6), Word("»Nein!«", 0.9, 1.2), Word("late", 3.0, 3.5),
             Word("…", 0.1, 0.2), Word("don't", 0.6, 1.4))
    own = take(still(2.0), words, (stroke("Point", 0.7, 1.3), stroke("Me", 1.9, 2.0)))
    edges = np.array([0.0, 0.5, 1.0, 1.5, 2.0])
    assert maps.words_on_blocks(own, edges) == [(0, "well"), (2, "nein"), (2, "don't")]
    assert maps.strokes_on_blocks(own, edges) == [maps.NO_STROKE, "Point", "Point", maps.NO_STROKE]
    assert maps.strokes_on_blocks(take(still(2.0)), edges) == []


def turning(seconds: float, fps: float, turn: np.ndarray) -> Motion:
    """The right arm turned at the shoulder about the axis that points forward, by turn [T] radians."""
    pose = np.zeros((round(seconds * fps), len(CHARACTER), 3))
    pose[:, CHARACTER.index("RightArm"), 2] = turn
    return Motion(CHARACTER, rotation.from_exponential_map(pose), np.zeros((len(pose), 3)), fps)


def test_survey_counts_and_measures() -> None:
    fps, rate = 60.0, 1.5
    turn = np.clip(np.arange(240) / fps - 2.0, 0, None) * rate  # still for two seconds, then at a constant rate
    arm = CHARACTER.index("RightArm")
    way = CHARACTER.offsets[CHARACTER.index("RightForeArm")] + CHARACTER.offsets[CHARACTER.index("RightHand")]
    radius = float(np.hypot(way[0], way[1]))
    assert CHARACTER.parents[CHARACTER.index("RightForeArm")] == arm
    edges = np.arange(9) / 2
    blocks = Blocks(edges, np.ones(8, np.int8), np.array([1, 1, 0, 0, 0, 0, 0, 0], bool), 10, 20.0)
    labels = np.array([2, 2, 2, 2, 0, 0, 0, 1])
    own = take(turning(4.0, fps, turn), (Word("go", 2.1, 2.3),), (stroke("Wave", 2.0, 3.5),))
    survey = maps.Survey(4)
    survey.add(own, blocks, labels)
    entries = survey.entries([2], np.full(4, 7.0))
    assert [e.blocks for e in entries] == [3, 1, 4, 0]
    assert [e.silent for e in entries] == [False, False, True, False]
    assert [e.shares["ann"] for e in entries] == [e.share for e in entries] == [3 / 8, 1 / 8, 0.5, 0]
    assert [e.in_silence for e in entries] == [0, 0, 0.5, 0]
    # One of two hands moves, at rate times its distance from the axis.
    assert entries[0].hand_speed == pytest.approx(rate * radius / 2, rel=1e-3)
    assert entries[2].hand_speed == pytest.approx(0, abs=1e-6)
    assert math.isnan(entries[3].hand_speed) and entries[3].decoded_speed == 7.0
    assert entries[0].strokes == {"Wave": 1.0} and entries[2].strokes == {maps.NO_STROKE: 1.0}


@pytest.mark.parametrize(("end", "says"), [(-0.6, "up"), (0.6, "down"), (-1.5, "up and in"), (1.5, "down and in")])
def test_a_lexeme_is_told_in_words(end: float, says: str) -> None:
    """The right arm stands out to the side and is turned in the plane of the body."""
    way = CHARACTER.offsets[CHARACTER.index("RightForeArm")] + CHARACTER.offsets[CHARACTER.index("RightHand")]
    told = in_words(turning(1.0, 20.0, np.linspace(0, end, 20)))
    chord = 100 * 2 * float(np.hypot(way[0], way[1])) * math.sin(abs(end) / 2)
    assert told == f"right {chord:.0f} cm {says}; left rests"
    back = in_words(turning(1.0, 20.0, np.concatenate([np.linspace(0, end, 10), np.linspace(end, 0, 10)])))
    assert back == told.replace("; left", ", and back; left")


def test_who_stands_still_rests() -> None:
    assert in_words(still(1.0)) == "both rest"


def test_frames_lie_in_their_blocks() -> None:
    got = maps.block_of_frames(np.array([0.0, 0.2, 1.0]), 12, 10.0)
    assert got.tolist() == [0, 0, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1]
    assert maps.block_of_frames(np.array([0.0, 0.25, 1.0]), 3, 10.0).tolist() == [0, 0, 0]  # a beat closes its block


# ------------------------------------------------------------------------------------------------------ latents

def test_neighbours_and_embedding_of_two_heaps() -> None:
    rng = np.random.default_rng(0)
    labels = np.repeat([0, 1], 40)
    heaps = rng.standard_normal((80, 8)) + 30.0 * labels[:, None]
    assert embedding.neighbours_agree(heaps, labels) == 1.0
    assert embedding.neighbours_agree(heaps, np.arange(80) % 2) == pytest.approx(0.5, abs=0.1)
    flat = embedding.embed(heaps)
    assert flat.shape == (80, 2) and embedding.neighbours_agree(flat, labels) == 1.0
    np.testing.assert_array_equal(flat, embedding.embed(heaps))


def test_colours_differ() -> None:
    made = embedding.colours(100)
    assert len(set(made)) == 100 and all(re.fullmatch("#[0-9a-f]{6}", own) for own in made)


# ----------------------------------------------------------------------------------------------------- the whole

@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """store/, bundle/ (a copy of the shipped one) and map/ of it, by the command."""
    folder = tmp_path_factory.mktemp("map")
    bundle = bundles.load(bundles.SHIPPED)
    writer = StoreWriter(folder / "store", "tones", {}, 0, "none")
    names = []
    for index, speaker in enumerate((bundle.speakers[0], "somebody <else>")):
        own = perform(6.0, seed=index, fps=50.0)
        # A hostile word, often enough on one block to be listed with its lexeme.
        words = (Word("</script><b>", 0.02, 0.04),) * 400 + (Word("fine", 3.0, 3.1),) * 400
        speech = Speech(own.speech.samples, own.speech.sample_rate, words)
        names.append(f"take{index}")
        writer.add(Recording(RecordingInfo(names[-1], "train", speaker, "tone", "en"), speech, own.motion,
                             Truth((stroke("Point", 0.0, 3.0),))))
    writer.finish(names)
    shutil.copytree(bundles.SHIPPED, folder / "my bundle")
    assert PLOT.main("gesticulator plot", [
        "lexicon", "--data", str(folder / "store"), "--bundle", str(folder / "my bundle"), "--out",
        str(folder / "map"), "--points", "30"]) == 0
    return folder


def table(made: Path) -> list[dict[str, str]]:
    with (made / "map" / "lexicon.csv").open(encoding="utf-8", newline="") as lines:
        return list(csv.DictReader(lines))


def test_the_table_and_the_sheet_hold_the_lexicon(made: Path) -> None:
    rows, bundle = table(made), bundles.load(made / "my bundle")
    assert [int(row["lexeme"]) for row in rows] == list(range(bundle.config.lexicon.size))
    assert [int(row["lexeme"]) for row in rows if row["silent"] == "1"] == bundle.silent.tolist()
    assert any("</script><b> (400)" in row["words"].split("; ") for row in rows)
    assert sum(float(row["share"]) for row in rows) == pytest.approx(1.0, abs=0.01)
    assert "share of somebody <else>" in rows[0] and all(row["does"] for row in rows)
    assert (made / "map" / "lexemes.png").read_bytes().startswith(b"\x89PNG")
    for suffix, head in (("png", b"\x89PNG"), ("svg", b"<?xml")):
        assert (made / "map" / f"latents.{suffix}").read_bytes().startswith(head)


def encoded(bundle: Bundle, own: Recording) -> EncodedMotion:
    return encode_motion(bundle, own.motion, cut(own.speech, bundle.config.rhythm), own.info.speaker)


def test_labels_are_the_nearest_lexemes(made: Path) -> None:
    bundle, store = bundles.load(made / "my bundle"), Store.open(made / "store")
    own = encoded(bundle, store.load("take0"))
    vectors = bundle.lexicon.vectors.numpy()
    gaps = np.array([[float(((latent - vector) ** 2).sum()) for vector in vectors] for latent in own.latents.numpy()])
    rows = np.arange(len(gaps))
    np.testing.assert_allclose(gaps[rows, own.labels], gaps.min(axis=1), rtol=1e-3, atol=1e-5)
    counts = np.array([float(row[f"share of {bundle.speakers[0]}"]) for row in table(made)]) * len(gaps)
    np.testing.assert_allclose(counts.sum(), len(gaps), rtol=0.01)
    # Of a block that is equally near to two lexemes, rounding decides.
    near = gaps <= gaps.min(axis=1, keepdims=True) * 1.001 + 1e-5
    only = near & (near.sum(axis=1, keepdims=True) == 1)
    assert (counts > only.sum(axis=0) - 0.05).all() and (counts < near.sum(axis=0) + 0.05).all()


def test_an_unknown_performer_is_centred_on_their_own_pose(made: Path) -> None:
    bundle, own = bundles.load(made / "my bundle"), Store.open(made / "store").load("take1")
    # Joints that the store has not are at zero, where their mean is.
    np.testing.assert_allclose(encoded(bundle, own).poses.mean(dim=(0, 1)).numpy(), 0, atol=1e-5)


def test_recordings_are_chosen_evenly(made: Path) -> None:
    store = Store.open(made / "store")
    assert [info.name for info in maps.evenly(store, "all")] == ["take0", "take1"]
    assert [info.name for info in maps.evenly(store, "train", 1)] == ["take0"]
    with pytest.raises(InputError, match="test split"):
        maps.evenly(store, "test")
    with pytest.raises(SystemExit) as stopped:
        PLOT.main("gesticulator plot", ["lexicon", "--data", str(made / "store"), "--out", str(made / "no"),
                                        "--points", "3"])
    assert stopped.value.code == 2 and not (made / "no").exists()
