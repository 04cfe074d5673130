"""The contact sheet of a lexicon, and how its lexemes are told apart: latents, labels, neighbours."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from performances import perform

from data_module.blocks import cut
from data_module.motion.skeletons import CHARACTER, from_vector
from data_module.store import Recording, RecordingInfo, Store, StoreWriter
from data_module.types import Speech, Word
from eval.clip.excerpts import evenly, excerpt
from eval.commands import PLOT
from eval.metrics.encode import encode_motion, normalised_blocks
from eval.pictures import embedding, lexicon_sheet
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle.files import NAMED


def test_neighbours_and_embedding_of_two_heaps() -> None:
    rng = np.random.default_rng(0)
    labels = np.repeat([0, 1], 40)
    heaps = rng.standard_normal((80, 8)) + 30.0 * labels[:, None]
    assert embedding.neighbours_agree(heaps, labels) == 1.0
    assert embedding.neighbours_agree(heaps, np.arange(80) % 2) == pytest.approx(0.5, abs=0.1)
    flat = embedding.embed(heaps)
    assert flat.shape == (80, 2) and embedding.neighbours_agree(flat, labels) == 1.0
    np.testing.assert_array_equal(flat, embedding.embed(heaps))


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two takes, one of a performer whom the shipped bundle knows."""
    folder = tmp_path_factory.mktemp("map") / "store"
    writer = StoreWriter(folder, "tones", {}, 0, "none")
    for split, speaker in (("train", bundles.load(NAMED["default"]).speakers[0]), ("test", "somebody")):
        own = perform(6.0, seed=len(split), fps=50.0)
        writer.add(Recording(RecordingInfo(split, split, speaker, "tone", "en"), own.speech, own.motion))
    writer.finish(["train", "test"])
    return folder


def test_the_sheet_shows_the_lexemes_that_are_used(store: Path, tmp_path: Path,
                                                   monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[str] = []
    real = lexicon_sheet.sheet

    def heard(motions: list, titles: list[str]):
        told.extend(titles)
        return real(motions, titles)

    monkeypatch.setattr(lexicon_sheet, "sheet", heard)
    out = tmp_path / "lexemes.png"
    assert PLOT.main("gesticulator plot", ["lexicon", "--data", str(store), "--work", str(tmp_path), "--quiet", "--out",
                                           str(out)]) == 0
    assert out.read_bytes().startswith(b"\x89PNG")
    shares = [float(title.rsplit(", ", 1)[1].removesuffix(" %")) for title in told]
    assert 1 < len(told) <= lexicon_sheet.MOST and shares == sorted(shares, reverse=True) and 0 < sum(shares) <= 101
    silent = {int(title.split()[0]) for title in told if "(silent)" in title}
    assert silent <= set(bundles.load(NAMED["default"]).silent.tolist())


def test_labels_are_the_nearest_lexemes(store: Path) -> None:
    bundle, own = bundles.load(NAMED["default"]), Store.open(store).load("train")
    read = encode_motion(bundle, own.motion, cut(own.speech, bundle.config.rhythm), own.info.speaker)
    gaps = np.square(read.latents.numpy()[:, None] - bundle.lexicon.vectors.numpy()).sum(axis=2)
    np.testing.assert_allclose(gaps[np.arange(len(gaps)), read.labels], gaps.min(axis=1), rtol=1e-3, atol=1e-5)


def test_an_unknown_performer_is_centred_on_their_own_pose(store: Path) -> None:
    bundle, own = bundles.load(NAMED["default"]), Store.open(store).load("test")
    poses, _ = normalised_blocks(bundle.config, bundle.statistics, own.motion, cut(own.speech, bundle.config.rhythm),
                                 own.info.speaker)
    # Joints that the store has not are at zero, where their mean is.
    np.testing.assert_allclose(poses.mean(dim=(0, 1)).numpy(), 0, atol=1e-5)


def test_recordings_are_chosen_evenly(store: Path) -> None:
    assert [info.name for info in evenly(Store.open(store), "all")] == ["train", "test"]
    assert [info.name for info in evenly(Store.open(store), "all", 1)] == ["train"]


def test_an_excerpt_is_the_middle_with_sound_words_and_motion_together() -> None:
    def recording(seconds: float) -> Recording:
        words = tuple(Word(str(n), n + 0.1, n + 0.9) for n in range(int(seconds)))
        samples = np.linspace(0, 0.5, round(seconds * 16000)).astype(np.float32)
        motion = from_vector(np.zeros((round(20 * seconds), 3 * len(CHARACTER))), 20.0)
        place = np.outer(np.arange(len(motion)) / 20, [1.0, 0.0, 0.0])
        return Recording(RecordingInfo("one", "test", "brad", "awb", "en"), Speech(samples, 16000, words),
                         dataclasses.replace(motion, root_positions=place))

    cut = excerpt(recording(20.0), 10.0)
    assert cut.speech.duration == pytest.approx(10) and cut.motion.duration == pytest.approx(10)
    assert cut.speech.samples[0] == pytest.approx(0.5 * 5 / 20, abs=1e-5)
    assert cut.motion.root_positions[0, 0] == pytest.approx(5)
    assert cut.speech.words is not None and [w.text for w in cut.speech.words] == [str(n) for n in range(5, 15)]
    assert cut.speech.words[0].start == pytest.approx(0.1)
    narrow = excerpt(recording(20.0), 9.0)
    assert narrow.speech.words is not None and narrow.speech.words[0].text == "6", "a word that is cut is left out"
    whole = excerpt(recording(6.0), 10.0)
    assert whole.speech.duration == pytest.approx(6) and len(whole.motion) == 120
