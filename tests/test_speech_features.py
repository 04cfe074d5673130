"""What the models hear: sound and words on the right blocks, the same in training and in use."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from performances import babble

from data_module.speech.audio import SAMPLE_RATE
from data_module.store import Store
from data_module.text.word_vectors import WordEncoder
from data_module.types import Speech, Word
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle import config as configs
from gesticulator.bundle.features import front_end_for, tempo_column, three_blocks
from gesticulator.sampling.cutter import encode_speech
from gesticulator.training import presets
from gesticulator.training.stages.corpus import Corpus, prepare

WORDS = (Word("one", 0.5, 1.0), Word("two", 1.1, 1.5), Word("", 1.5, 2.2), Word("three", 2.2, 2.9))


class Numbers:
    """A word encoder that says which word it was: the vector of word w is (w + 1, 10)."""

    width = 2

    def encode_into(self, out: np.ndarray, words: tuple[Word, ...], so_far: bool) -> Iterator[None]:
        out[:] = [[number + 1.0, 10.0] if word.text else [0.0, 0.0] for number, word in enumerate(words)]
        yield


@pytest.fixture(scope="module")
def prepared(tiny_store: Path, tiny_bundle: Path) -> tuple[bundles.Bundle, Store, Corpus]:
    bundle, store = bundles.load(tiny_bundle), Store.open(tiny_store)
    work = tiny_bundle.with_name(tiny_bundle.name + ".work")
    return bundle, store, prepare(store, bundle.config, work, bundle.encoder, progress=False)


def test_three_blocks_by_hand() -> None:
    assert three_blocks(np.arange(6).reshape(3, 2), np.array(9)).tolist() == [
        [9, 9, 0, 1, 2, 3], [0, 1, 2, 3, 4, 5], [2, 3, 4, 5, 9, 9]]
    assert three_blocks(np.array([[7]]), np.zeros(())).tolist() == [[0, 7, 0]], "one block has no neighbours"
    vectors = three_blocks(np.arange(4.0).reshape(2, 1, 2), np.array([8.0, 9.0]))
    assert vectors.tolist() == [[[8, 9], [0, 1], [2, 3]], [[0, 1], [2, 3], [8, 9]]]


def test_the_tempo_column_is_the_logarithm_of_each_blocks_own_duration() -> None:
    column = tempo_column(np.array([0.5, 0.25]), 0.5, 2)[..., 0]
    half = np.log(0.5)
    np.testing.assert_allclose(column, [[0, 0, 0, 0, half, half], [0, 0, half, half, half, half]], atol=1e-7)


def test_words_sit_on_the_frames_at_which_they_sound() -> None:
    config = configs.with_settings(presets.preset("tiny"), ["front_end.name=mel"])
    speech = Speech(babble(3.3), SAMPLE_RATE, WORDS)
    heard = encode_speech(speech, config, words=Numbers())  # type: ignore[arg-type]
    blocks, frames = heard.blocks, config.rhythm.frames
    assert heard.text is not None and heard.text.shape == (len(blocks), 3 * frames, 3)
    # One and two are 0.1 s apart, which is bridged; after two there is a silence that the transcript names.
    spoken = {1: (0.5, 1.05), 2: (1.05, 1.5), 4: (2.2, 2.9)}
    rows = np.zeros((len(blocks) + 2, frames, 3))
    rows[..., 2] = 1.0  # before the first block and after the last nobody speaks
    seen = set()
    for block, (start, end) in enumerate(zip(blocks.edges[:-1], blocks.edges[1:], strict=True)):
        for frame in range(frames):
            time = start + (end - start) * (frame + 1) / frames
            for number, (first, last) in spoken.items():
                if first < time <= last:
                    rows[block + 1, frame] = [number, 10.0, 0.0]
                    seen.add(number)
    assert seen == {1, 2, 4} and (rows[1:-1, :, 2] == 1).any(), "words and silence"
    expected = np.concatenate([rows[:-2], rows[1:-1], rows[2:]], axis=1)
    np.testing.assert_array_equal(heard.text, expected)


def test_in_use_a_bundle_hears_what_it_was_trained_on(prepared: tuple[bundles.Bundle, Store, Corpus]) -> None:
    bundle, store, corpus = prepared
    front = front_end_for(bundle.config, bundle.runners.get("encoder"))
    words = WordEncoder.open(bundle.config.text.encoder)
    for recording in (0, 7):
        speech = store.load(corpus.names[recording]).speech
        heard = encode_speech(speech, bundle.config, front, words)
        own = corpus.blocks_of(recording)
        np.testing.assert_array_equal(heard.blocks.silent, corpus.silent[own])
        for level, cached, normaliser in ((heard.low, corpus.low, bundle.statistics.low),
                                          (heard.high, corpus.high, bundle.statistics.high)):
            error = np.abs(normaliser.apply(level) - cached[own].float().numpy())
            # The sound and the features are kept in half precision, which counts most where the voice is faint.
            assert error.mean() < 0.01 and np.quantile(error, 0.999) < 0.1
            shifted = np.abs(normaliser.apply(level)[1:] - cached[own].float().numpy()[:-1])
            assert shifted.mean() > 20 * error.mean(), "the next block's are others"
        assert heard.text is not None
        np.testing.assert_array_equal(heard.text.astype(np.float16).astype(np.float32), corpus.text(own).numpy())
