"""The contrastive reward: its loss, its windows, the rewards of every lexeme, and that it learns what goes together."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from learning import learn
from torch import Tensor
from torch.nn import functional

from interpreters import reward as rewards
from interpreters.reward_table import Centred, RewardTable

FRAMES, MOTION, AUDIO, LEXEMES, BLOCKS = 4, 5, 3, 7, 40


def model(seed: int = 0, **changes: object) -> rewards.RewardModel:
    torch.manual_seed(seed)
    config = rewards.RewardConfig(**{"width": 16, "projection": 8, **changes})  # type: ignore[arg-type]
    return rewards.RewardModel(config, FRAMES, MOTION, AUDIO).eval()


def drawn(*shape: int, seed: int = 0) -> Tensor:
    return torch.as_tensor(np.random.default_rng(seed).standard_normal(shape), dtype=torch.float32)


def batch(count: int, width: int, seed: int = 0) -> dict[str, Tensor]:
    """Windows that have nothing to do with each other, of random lengths, each its own group."""
    lengths = torch.as_tensor(np.random.default_rng(seed).integers(1, width + 1, count))
    return {"motion": drawn(count, width, FRAMES, MOTION, seed=seed),
            "audio": drawn(count, width, FRAMES, AUDIO, seed=seed + 1),
            "group": torch.arange(count),
            "valid": (torch.arange(width) >= width - lengths[:, None]).float()}


def alone(lexemes: Tensor) -> Tensor:
    """Each lexeme decoded by itself: [B, W] to [B, W, K, D_m]."""
    return drawn(LEXEMES, FRAMES, MOTION, seed=9)[lexemes]


def together(lexemes: Tensor) -> Tensor:
    """Each lexeme decoded with both its neighbours and its distance from the start."""
    each = alone(lexemes)
    out = each + 0.1 * torch.arange(lexemes.shape[1])[:, None, None]
    out[:, 1:] += 0.5 * each[:, :-1]
    out[:, :-1] += 0.3 * each[:, 1:]
    return out


def table(way: str = "decoded", seed: int = 0, window: int = 6, **changes: object) -> RewardTable:
    net = model(seed, window=window, **changes)
    audio = drawn(BLOCKS, FRAMES, AUDIO, seed=3)
    if way == "decoded":
        return RewardTable(net, audio, alone(torch.arange(LEXEMES)))
    return RewardTable(net, audio, decode=(alone if way == "alone" else together, LEXEMES))


def windows(count: int, width: int, seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    """Lexemes, blocks and valid, [B, W] each, with every length from 1 to W."""
    rng = np.random.default_rng(seed)
    lengths = torch.as_tensor(1 + np.arange(count) % width)
    return (torch.as_tensor(rng.integers(LEXEMES, size=(count, width))),
            torch.as_tensor(rng.integers(BLOCKS, size=(count, width))),
            torch.arange(width) >= width - lengths[:, None])


# The loss


@pytest.mark.parametrize("count", [1, 2, 5, 64])
def test_equal_embeddings_cost_log_n(count: int) -> None:
    same = functional.normalize(torch.ones(count, 8), dim=-1)
    assert float(rewards.contrast(same, same, 0.07, torch.arange(count))) == pytest.approx(math.log(count), abs=1e-5)


def test_orthogonal_pairs_cost_what_the_formula_says() -> None:
    unit = torch.eye(3)
    value = rewards.contrast(unit, unit, 0.5, torch.arange(3))
    assert float(value) == pytest.approx(math.log(1 + 2 * math.exp(-1 / 0.5)), abs=1e-6)


def test_rows_of_a_group_are_not_negatives() -> None:
    unit = torch.eye(3)
    value = rewards.contrast(unit, unit, 1.0, torch.tensor([4, 4, 1]))
    expected = (2 * math.log(1 + math.exp(-1)) + math.log(1 + 2 * math.exp(-1))) / 3
    assert float(value) == pytest.approx(expected, abs=1e-6)
    cosines = rewards.similarities(unit, unit, torch.tensor([4, 4, 1]))
    assert torch.isneginf(cosines).nonzero().tolist() == [[0, 1], [1, 0]]


# The temperature


def test_the_temperature_begins_where_it_is_set_and_stays_above_its_floor() -> None:
    net = model()
    assert net.temperature == pytest.approx(0.07)
    with torch.no_grad():
        net.log_temperature.fill_(-20.0)
    assert net.temperature == rewards.LEAST_TEMPERATURE
    value = net.losses(batch(6, 4))["contrast"].detach()
    motion, audio = (vectors.detach() for vectors in net.embed(batch(6, 4)))
    again = rewards.contrast(motion, audio, rewards.LEAST_TEMPERATURE, torch.arange(6))
    assert float(value) == pytest.approx(float(again), rel=1e-4)


def test_a_temperature_at_its_floor_can_rise_again() -> None:
    net = model()
    with torch.no_grad():
        net.log_temperature.fill_(-20.0)
    # Nothing to be learned from noise: a cold softmax is punished.
    learn(net, lambda step: net.losses(batch(16, 4, seed=10 * step))["contrast"], 5, 0.02)
    assert net.temperature > rewards.LEAST_TEMPERATURE * 1.02


# The encoders


@given(st.integers(1, 9), st.integers(0, 5))
def test_padding_on_the_left_does_not_matter(length: int, more: int) -> None:
    net, tokens = model(), drawn(3, length, 16)
    padded = torch.cat([100 * drawn(3, more, 16, seed=1), tokens], 1)
    valid = torch.cat([torch.zeros(3, more), torch.ones(3, length)], 1)
    for embed in (net.embed_motion, net.embed_audio):
        assert torch.allclose(embed(tokens, torch.ones(3, length)), embed(padded, valid), atol=1e-5)


def test_what_is_masked_does_not_matter() -> None:
    net, given_batch = model(), batch(8, 6)
    other = {key: value.clone() for key, value in given_batch.items()}
    hidden = given_batch["valid"] == 0
    assert hidden.any()
    for key in ("motion", "audio"):
        other[key][hidden] = 50.0
    assert torch.allclose(net.losses(given_batch)["contrast"], net.losses(other)["contrast"], atol=1e-5)


@pytest.mark.parametrize("changed", range(8))
def test_a_token_hears_none_after_it(changed: int) -> None:
    net, tokens, valid = model(), drawn(2, 8, 16), torch.ones(2, 8)
    other = tokens.clone()
    other[:, changed] += drawn(2, 16, seed=1)
    for encoder in (net.encode_motion, net.encode_audio):
        moved = (encoder.features(tokens, valid) - encoder.features(other, valid)).abs().amax((0, 2))
        assert (moved[:changed] == 0).all()
        assert (moved[changed:] > 1e-6).all()  # three layers reach 15 blocks back


def test_rivals_are_more_negatives_of_the_audio_and_of_nothing_else() -> None:
    alike = functional.normalize(torch.ones(5, 4), dim=1)
    apart = torch.arange(5)
    rivals = torch.full((5, 3), float(alike[0] @ alike[0]) / 0.5)
    # Nothing can be told apart: 5 audios for a motion, 5 motions and 3 rivals for an audio.
    assert float(rewards.contrast(alike, alike, 0.5, apart, rivals)) == pytest.approx(0.5 * (math.log(5) + math.log(8)))
    none = torch.full((5, 3), -math.inf)
    assert float(rewards.contrast(alike, alike, 0.5, apart, none)) == pytest.approx(math.log(5))
    net, given_batch = model(), batch(4, 6)
    rival = torch.randn(4, 2, *given_batch["motion"].shape[1:])
    unmarked = {**given_batch, "rival": rival, "rivalled": torch.zeros(4)}
    assert float(net.losses(unmarked)["contrast"]) == pytest.approx(float(net.losses(given_batch)["contrast"]))
    marked = {**unmarked, "rivalled": torch.tensor([1.0, 0, 0, 0])}
    assert float(net.losses(marked)["contrast"]) > float(net.losses(unmarked)["contrast"])
    # By hand: the cosine of the audio with each rival, as if it were the window itself.
    _, audio = net.embed(given_batch)
    second, _ = net.embed({**given_batch, "motion": rival[:, 1]})
    torch.testing.assert_close(net.against_rivals(marked, audio)[:, 1], (second * audio).sum(1))


# Retrieval


@pytest.mark.parametrize("filling", [0.0, math.nan])
def test_an_encoder_that_maps_all_to_one_point_finds_nothing(filling: float) -> None:
    net = model()
    with torch.no_grad():
        for encoder in (net.encode_motion, net.encode_audio):
            encoder.project.weight.fill_(filling)
    figures = net.retrieval(batch(10, 4))
    assert figures["motion_r1"] == figures["audio_r5"] == 0
    assert figures["chance_r1"] == pytest.approx(0.1) and figures["chance_r5"] == pytest.approx(0.5)


def test_retrieval_counts_places(monkeypatch: pytest.MonkeyPatch) -> None:
    """Audio i is motion i - 1 (and the first has a place of its own): sought from motion, its own is never first."""
    net, unit = model(), torch.eye(6)
    monkeypatch.setattr(net, "embed", lambda _: (unit, functional.normalize(unit + 2 * unit.roll(1, 0), dim=-1)))
    apart = net.retrieval({"group": torch.arange(6)})
    assert apart["motion_r1"] == apart["audio_r1"] == 0
    assert apart["motion_r5"] == apart["audio_r5"] == 1
    one_group = net.retrieval({"group": torch.zeros(6, dtype=torch.int64)})
    assert one_group["motion_r1"] == one_group["chance_r1"] == 1


# The table


@pytest.mark.parametrize("way", ["decoded", "alone", "together"])
def test_rewards_are_the_models_cosines(way: str) -> None:
    asked, (lexemes, blocks, valid) = table(way), windows(12, 6)
    net, audio = model(window=6), drawn(BLOCKS, FRAMES, AUDIO, seed=3)
    got = asked.rewards(lexemes, blocks, valid)
    for row in range(12):
        kept = slice(6 - int(valid[row].sum()), None)
        at, width = blocks[row:row + 1, kept], int(valid[row].sum())
        motion = (together if way == "together" else alone)(lexemes[row:row + 1, kept])
        ones = torch.ones(1, width)
        m = net.embed_motion(net.block_motion(motion), ones)
        u = net.embed_audio(net.block_audio(audio[at]), ones)
        assert float(got[row]) == pytest.approx(float((m * u).detach().sum()), abs=1e-5)
    assert (got.abs() <= 1).all() and not got.requires_grad


@pytest.mark.parametrize("way", ["decoded", "alone", "together"])
@pytest.mark.parametrize("width", [1, 2, 6, 11])
def test_every_equals_one_by_one(way: str, width: int) -> None:
    asked, (lexemes, blocks, valid) = table(way), windows(2 * width, width)
    got = asked.every(lexemes[:, :-1], blocks, valid)
    assert got.shape == (2 * width, LEXEMES)
    for lexeme in range(LEXEMES):
        whole = torch.cat([lexemes[:, :-1], torch.full((2 * width, 1), lexeme)], 1)
        assert torch.allclose(got[:, lexeme], asked.rewards(whole, blocks, valid), atol=1e-5)
    assert got.std(1).min() > 1e-4  # the last lexeme is heard


@pytest.mark.parametrize("way", ["decoded", "together"])
def test_a_sequence_is_scored_window_by_window(way: str, monkeypatch: pytest.MonkeyPatch) -> None:
    asked, rng = table(way), np.random.default_rng(2)
    lexemes, blocks = torch.as_tensor(rng.integers(LEXEMES, size=17)), torch.arange(5, 22)
    got = asked.sequence(lexemes, blocks)
    monkeypatch.setattr("interpreters.reward_table._AT_ONCE", 3 * LEXEMES)  # several parts
    every = asked.sequence_every(lexemes, blocks)
    assert got.shape == (17,) and every.shape == (17, LEXEMES)
    for i in range(17):
        first = max(0, i - 5)
        ones = torch.ones(1, i + 1 - first)
        one = asked.rewards(lexemes[None, first:i + 1], blocks[None, first:i + 1], ones)
        assert float(got[i]) == pytest.approx(float(one), abs=1e-5)
        row = asked.every(lexemes[None, first:i], blocks[None, first:i + 1], ones)
        assert torch.allclose(every[i], row[0], atol=1e-5)
    assert torch.allclose(every.gather(1, lexemes[:, None])[:, 0], got, atol=1e-5)


# Learning


def recording(blocks: int, seed: int) -> tuple[Tensor, Tensor]:
    """Audio [N, K, d] that drifts from block to block, and motion [N, K, D_m] that is a function of it, and noise."""
    rng, maps = np.random.default_rng(seed), np.random.default_rng(0)
    steps = rng.standard_normal((blocks, FRAMES, AUDIO))
    audio = np.zeros_like(steps)
    for i in range(1, blocks):
        audio[i] = 0.5 * audio[i - 1] + steps[i]
    motion = np.tanh(audio @ maps.standard_normal((AUDIO, MOTION)))
    motion += 0.3 * rng.standard_normal(motion.shape)
    return torch.as_tensor(audio, dtype=torch.float32), torch.as_tensor(motion, dtype=torch.float32)


def cut(audio: Tensor, motion: Tensor, starts: np.ndarray, width: int) -> dict[str, Tensor]:
    at = torch.as_tensor(starts)[:, None] + torch.arange(width)
    return {"motion": motion[at], "audio": audio[at],
            "valid": torch.ones(at.shape), "group": torch.as_tensor(starts // width)}


def test_what_goes_together_is_learned() -> None:
    net = model(width=32, projection=16).train()
    spoken, shown = recording(2000, seed=1)

    def loss(step: int) -> Tensor:
        rng = np.random.default_rng([7, step])
        torch.manual_seed(step)
        starts = 8 * rng.choice(240, 32, replace=False) + rng.integers(8)
        return net.losses(cut(spoken, shown, starts, int(rng.integers(2, 9))), step / 150)["contrast"]

    learn(net, loss, 150, 3e-3)
    audio, motion = recording(600, seed=2)  # never seen
    figures = net.retrieval(cut(audio, motion, 8 * np.arange(64), 8))
    assert figures["chance_r1"] == pytest.approx(1 / 64)
    assert min(figures["motion_r1"], figures["audio_r1"]) > 0.6
    assert min(figures["motion_r5"], figures["audio_r5"]) > 0.9
    # As a lexicon of 600 lexemes, each block's motion its own. A window that comes a block late still holds most of
    # what was said, and the negatives of training were eight blocks away: the reward falls with the shift, not at once.
    asked = RewardTable(net, audio, motion)
    blocks = torch.arange(600)
    matched, late, later, anything = (float(asked.sequence(lexemes, blocks).mean()) for lexemes in (
        blocks, blocks.roll(1), blocks.roll(4), torch.as_tensor(np.random.default_rng(3).permutation(600))))
    assert matched > 0.8
    assert matched > late + 0.02
    assert late > later + 0.1
    assert later > anything + 0.1
    assert abs(anything) < 0.3
    # Judged window by window, the true one wins nearly always over one from elsewhere.
    wins = asked.sequence(blocks, blocks) > asked.sequence(blocks.roll(300), blocks)
    assert float(wins.double().mean()) > 0.95
    # And of all lexemes the one that was made for the block ranks high (by chance its median place is half the way).
    every = asked.sequence_every(blocks[:100], blocks[:100])
    place = (every > every.diagonal()[:, None]).sum(1).double()
    assert float(place.median()) < 0.2 * 600


def test_rows_that_are_no_rivals_leave_every_gradient_a_number() -> None:
    torch.manual_seed(0)
    model = rewards.RewardModel(rewards.RewardConfig(width=8, projection=4, window=2, longest=3), 2, 3, 4)
    batch = {"motion": torch.randn(4, 3, 2, 3), "audio": torch.randn(4, 3, 2, 4),
             "valid": torch.ones(4, 3), "group": torch.tensor([1, 1, 2, 3])}
    model.losses(batch)["contrast"].backward()
    assert all(torch.isfinite(p.grad).all() for p in model.parameters() if p.grad is not None)
    assert float(model.log_temperature.grad.abs()) > 0  # type: ignore[union-attr]


def test_centred_rewards_are_told_from_chance_and_order_lexemes_alike() -> None:
    audio = drawn(12, FRAMES, AUDIO, seed=3)
    table = RewardTable(model(window=3, longest=4), audio, drawn(LEXEMES, FRAMES, MOTION, seed=5))
    parts = [torch.arange(0, 7), torch.arange(7, 12)]
    centred = Centred(table, parts, 400)
    # What random lexemes earn is nothing, but for the draw.
    generator = torch.Generator().manual_seed(99)
    fresh = [centred.sequence(torch.randint(LEXEMES, (7,), generator=generator), parts[0]) for _ in range(400)]
    assert torch.stack(fresh).mean(0).abs().max() < 0.15 < torch.stack(fresh).std(0).max()
    lexemes = torch.tensor([1, 0, 2, 2, 1, 0, 1])
    difference = table.sequence(lexemes, parts[0]) - centred.sequence(lexemes, parts[0])
    torch.testing.assert_close(difference, centred.baseline[parts[0]])
    torch.testing.assert_close(centred.sequence_every(lexemes, parts[0]).argsort(1),
                               table.sequence_every(lexemes, parts[0]).argsort(1))
    torch.testing.assert_close(centred.sequence_every(lexemes, parts[0]).gather(1, lexemes[:, None])[:, 0],
                               centred.sequence(lexemes, parts[0]))
    blocks, valid = torch.tensor([[7, 8, 9]]), torch.ones(1, 3)
    torch.testing.assert_close(centred.every(torch.tensor([[0, 1]]), blocks, valid)[:, 2],
                               centred.rewards(torch.tensor([[0, 1, 2]]), blocks, valid))
