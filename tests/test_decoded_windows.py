"""Windows of decoded lexemes: what is decoded is the lexicon's own, and the lexemes beside are wrong in every way."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch
from untrained import PLAIN, untrained

from data_module.errors import InputError
from data_module.layers import freeze
from data_module.store import Store
from eval.context import EvalContext
from eval.metrics.reward_model import RewardProbe
from eval.runner.decoded_windows import WRONG, DecodedWindows, Decoder
from gesticulator.bundle import bundle as bundles
from gesticulator.training.stages.lexicon import decoded_blocks
from gesticulator.training.stages.reward import drawn_windows
from interpreters.reward import RewardModel
from interpreters.settings import RewardConfig

CONFIG = RewardConfig(width=16, projection=8, rivals=3, window=6, shortest=4, longest=8)


@pytest.fixture(scope="module")
def decoder(tiny_store: Path, tiny_movement_bundle: Path) -> Decoder:
    work = tiny_movement_bundle.with_name(tiny_movement_bundle.name + ".work")
    context = EvalContext.over(Store.open(tiny_store), bundles.load(tiny_movement_bundle), work, progress=False)
    return Decoder.of(context.bundle, context.corpus, context.labels)


@pytest.fixture(scope="module")
def windows(decoder: Decoder) -> DecodedWindows:
    return DecodedWindows(decoder, decoder.corpus.recordings("train"), CONFIG)


def test_a_block_is_decoded_from_its_recorded_past_and_the_next_from_that(decoder: Decoder, tiny_movement_bundle: Path,
                                                                         windows: DecodedWindows) -> None:
    lexicon = bundles.load(tiny_movement_bundle).block_models.lexicon
    blocks, valid = drawn_windows(decoder.corpus, windows.recordings, CONFIG, np.random.default_rng(0), 16)
    at, real = torch.as_tensor(blocks), torch.as_tensor(valid)
    shown = decoder.context.shown(torch.as_tensor(decoder.labels[blocks]), at, real)
    first = CONFIG.longest - valid.sum(1).astype(int)
    each = decoded_blocks(lexicon, decoder.labels, decoder.corpus)
    for row, start in enumerate(first):
        torch.testing.assert_close(shown[row, start], each[blocks[row, start]], atol=1e-4, rtol=1e-4)
    assert not torch.allclose(shown[:, -1], each[at[:, -1]], atol=1e-3), "later ones follow what was decoded"
    changed = decoder.labels[blocks].copy()
    changed[:, -1] = (changed[:, -1] + 1) % decoder.size
    other = decoder.context.shown(torch.as_tensor(changed), at, real)
    torch.testing.assert_close(other[:, :-1], shown[:, :-1])
    added = decoder.context.added
    moved = added[torch.as_tensor(changed[:, -1])] - added[torch.as_tensor(decoder.labels[blocks[:, -1]])]
    torch.testing.assert_close(other[:, -1] - shown[:, -1], moved, atol=1e-4, rtol=1e-3)


def test_a_bundle_of_poses_is_refused_in_a_line(decoder: Decoder) -> None:
    with pytest.raises(InputError, match="has no lexicon of movements"):
        Decoder.of(untrained(*PLAIN), decoder.corpus, decoder.labels)


def test_wrong_lexemes_are_wrong_where_it_counts_and_in_every_way(decoder: Decoder, windows: DecodedWindows) -> None:
    rng = np.random.default_rng(1)
    blocks, valid = drawn_windows(decoder.corpus, windows.recordings, CONFIG, rng, 400)
    wrong, own = windows.wrong(blocks, valid, rng), decoder.labels[blocks][:, None]
    differs = (wrong != own) & (valid > 0)[:, None]
    assert differs.any(-1).all()
    assert wrong.min() >= 0 and wrong.max() < decoder.size
    constant = (wrong == wrong[..., :1]).all(-1).mean()
    tail = ~differs[..., :CONFIG.longest // 2].any(-1)
    assert constant > 0.5 / len(WRONG), "one lexeme throughout"
    assert tail.mean() > 0.5 / len(WRONG), "the first half is the performer's"
    likely = decoder.transitions > 0
    chained = likely[wrong[..., :-1], wrong[..., 1:]].all(-1)
    assert chained.mean() > 0.5 / len(WRONG), "each follows the one before as it does in the corpus"


def test_what_the_lstm_draws_is_its_distribution(decoder: Decoder) -> None:
    known = np.concatenate([decoder.corpus.blocks_of(r) for r in decoder.corpus.recordings("train")])
    assert (decoder.drawn[:, known] != decoder.labels[known]).mean() > 0.3
    others = np.setdiff1d(np.arange(len(decoder.labels)), known)
    assert (decoder.drawn[:, others] == decoder.labels[others]).all(), "only the training split is drawn"


def test_a_probe_scores_them_as_the_table_that_teaches_does(decoder: Decoder, tiny_movement_bundle: Path) -> None:
    bundle = bundles.load(tiny_movement_bundle)
    torch.manual_seed(2)
    model = RewardModel(dataclasses.replace(CONFIG, speeds=True), decoder.audio.shape[1],
                        decoder.corpus.motion.shape[2], decoder.audio.shape[2])
    freeze(model)
    probe = RewardProbe.of(model, bundle, decoder.corpus, decoder.labels, decoder.context)
    blocks = decoder.corpus.blocks_of(0)[:CONFIG.window + 3]
    at = np.lib.stride_tricks.sliding_window_view(blocks, CONFIG.window).copy()
    decoded = probe.score("decoded", at, at)
    np.testing.assert_allclose(decoded, probe.played(decoder.labels[at], at), atol=1e-5)
    assert abs(decoded - probe.score("captured", at, at)).max() > 1e-4, "lexemes without the performer's detail"


def test_half_of_the_batches_are_captured_motion(windows: DecodedWindows) -> None:
    corpus, captured = windows.decoder.corpus, []
    blocks = corpus.motion.float()
    for seed in range(12):
        batch = windows.sample(np.random.default_rng(seed), 16)
        assert batch["rival"].shape == (16, 3, *batch["motion"].shape[1:])
        real = batch["valid"].bool()
        rows = batch["motion"][real][:5]
        captured.append(all(bool((blocks == row).flatten(1).all(1).any()) for row in rows))
    assert 2 < sum(captured) < 10
