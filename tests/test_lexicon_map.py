"""The map of the lexicon: what is counted of a lexeme, and the files of the command."""

from __future__ import annotations

import csv
import math
import shutil
from pathlib import Path

import numpy as np
import pytest
from bursts import turned
from performances import perform

from data_module.blocks import cut
from data_module.errors import InputError
from data_module.motion.skeletons import CHARACTER
from data_module.store import Recording, RecordingInfo, Store, StoreWriter
from data_module.types import Blocks, Motion, Speech
from eval.commands import PLOT
from eval.metrics.encode import EncodedMotion, encode_motion
from eval.pictures import embedding
from eval.pictures import lexicon_map as maps
from eval.pictures.lexicon_sheet import in_words
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle.bundle import Bundle


def turning(seconds: float, fps: float, turn: np.ndarray) -> Motion:
    """The right arm turned at the shoulder about the axis that points forward, by turn [T] radians."""
    return turned(round(seconds * fps), fps, {"RightArm": np.outer(turn, [0, 0, 1])})


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
    speech = Speech(np.zeros(4 * 16000, np.float32), 16000)
    survey = maps.Survey(4)
    survey.add(Recording(RecordingInfo("take", "train", "ann", "tone", "en"), speech, turning(4.0, fps, turn)), blocks,
               labels)
    rows = survey.table([2], ["rests"] * 4)
    columns = {name: [row[name] for row in rows] for name in rows[0]}
    assert columns["blocks"] == ["3", "1", "4", "0"] and columns["silent"] == ["0", "0", "1", "0"]
    assert columns["share"] == columns["share of ann"] == ["0.3750", "0.1250", "0.5000", "0.0000"]
    assert columns["in_silence"] == ["0.000", "0.000", "0.500", "0.000"]
    # One of two hands moves, at rate times its distance from the axis; a lexeme without blocks has no speed.
    assert columns["hand_speed"][2:] == ["0.000", ""]
    assert [float(speed) for speed in columns["hand_speed"][:2]] == pytest.approx([rate * radius / 2] * 2, abs=0.002)


@pytest.mark.parametrize(("end", "says"), [(-0.6, "up"), (0.6, "down"), (-1.5, "up and in"), (1.5, "down and in")])
def test_a_lexeme_is_told_in_words(end: float, says: str) -> None:
    """The right arm stands out to the side and is turned in the plane of the body."""
    way = CHARACTER.offsets[CHARACTER.index("RightForeArm")] + CHARACTER.offsets[CHARACTER.index("RightHand")]
    told = in_words(turning(1.0, 20.0, np.linspace(0, end, 20)))
    chord = 100 * 2 * float(np.hypot(way[0], way[1])) * math.sin(abs(end) / 2)
    assert told == f"right {chord:.0f} cm {says}; left rests"
    back = in_words(turning(1.0, 20.0, np.concatenate([np.linspace(0, end, 10), np.linspace(end, 0, 10)])))
    assert back == told.replace("; left", ", and back; left")


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
        names.append(f"take{index}")
        writer.add(Recording(RecordingInfo(names[-1], "train", speaker, "tone", "en"), own.speech, own.motion))
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
