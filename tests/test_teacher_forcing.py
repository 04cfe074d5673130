"""A window of training and a stream of blocks give the same scores of lexemes."""

import dataclasses
from typing import Any

import numpy as np
import pytest
import torch
from runners import played_lstm

from data_module.motion.movement import Pasts
from data_module.motion.movement_run import PAST
from gesticulator.bundle.features import Normaliser, Statistics
from gesticulator.training import presets
from gesticulator.training.stages import Corpus
from gesticulator.training.stages.q_network import features_of
from gesticulator.training.stages.windows import Windows, sequences
from interpreters.lstm import InterpreterWidths, LstmConfig, LstmInterpreter

SIZE, AUDIO, MOTION, SILENT = 4, 5, 3, 3
Lexemes = np.ndarray[Any, np.dtype[np.int64]]


def random_corpus(seed: int = 0) -> tuple[Corpus, Lexemes]:
    """14 recordings of 24 blocks of noise, every sixth block silent, and their lexemes [N]."""
    rng, frames = np.random.default_rng(seed), presets.preset("tiny").rhythm.frames
    count, recording = 14 * 24, np.repeat(np.arange(14), 24)
    silent = np.arange(count) % 6 == 5
    labels = np.where(silent, SILENT, rng.integers(SILENT, size=count)).astype(np.int64)
    high = rng.normal(size=(count, 3 * frames, AUDIO)).astype(np.float32)
    motion = rng.normal(size=(count, frames, MOTION)).astype(np.float32)
    heard = torch.as_tensor(high.astype(np.float16))
    nothing = np.zeros((1, MOTION))
    statistics = Statistics(("one",), nothing, nothing, np.ones(MOTION), np.array([-np.ones(MOTION), np.ones(MOTION)]),
                            Normaliser(np.zeros(AUDIO), np.ones(AUDIO)), Normaliser(np.zeros(AUDIO), np.ones(AUDIO)))
    return Corpus(
        names=tuple(f"r{i}" for i in range(14)), splits=("train",) * 8 + ("val",) * 2 + ("test",) * 4,
        speaker_of=np.zeros(14, np.int64), motion=torch.as_tensor(motion), low=heard, high=heard, silent=silent,
        pasts=Pasts(torch.zeros(count, PAST, MOTION), torch.ones(count)),
        durations=np.full(count, 0.3), recording=recording, first=torch.zeros(14, MOTION),
        mask=torch.ones(14, MOTION), control=np.zeros((count, frames, 3), np.float32), statistics=statistics,
        has_text=np.zeros(14, bool)), labels


@pytest.mark.parametrize("memory", [0, 3])
def test_a_window_of_training_and_a_stream_tell_the_same(memory: int) -> None:
    corpus, labels = random_corpus()
    corpus = dataclasses.replace(corpus, durations=np.random.default_rng(4).uniform(0.2, 0.5, len(labels)))
    torch.manual_seed(5)
    config = LstmConfig(audio_features=4, width=12, pose_features=6, memory=memory)
    model = LstmInterpreter(config, torch.randn(SIZE, 6),
                            InterpreterWidths(corpus.motion.shape[1], AUDIO, 1, motion=MOTION)).eval()
    own = corpus.blocks_of(2)
    parts = sequences(corpus, labels, "train", np.zeros(len(labels), np.int64))
    batch = Windows(corpus, parts, len(own) - 1).batch(np.array([[2, 0]]))
    with torch.no_grad():
        window, _ = model.scores(batch["lexeme"][:, :-1], batch["audio_high"][:, 1:], batch["speaker"],
                                 pose=model.poses(batch))
    whole = torch.log_softmax(window[0], -1)
    features, runner = features_of(corpus), played_lstm(model)
    state = runner.start(0, int(labels[own[0]]))
    for place, block in enumerate(own[1:]):
        scores, state = runner.step(state, features(int(block)), int(labels[block - 1]))
        np.testing.assert_allclose(scores, whole[place].numpy(), atol=1e-5, rtol=1e-4)


def test_before_the_first_block_of_a_recording_its_first_pose_is_held() -> None:
    corpus, _ = random_corpus()
    corpus = dataclasses.replace(corpus, first=torch.arange(14.0)[:, None].expand(-1, MOTION),
                                 durations=np.arange(1.0, 337.0))
    motion, seconds = corpus.before(np.array([0, 24, 25]))
    assert (motion[0] == 0).all() and (motion[1] == 1).all() and torch.equal(motion[2], corpus.motion[24])
    assert seconds.tolist() == [[1, 1], [25, 25], [25, 26]]
