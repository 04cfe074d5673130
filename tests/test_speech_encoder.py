"""The speech encoder against plain arithmetic, and its two training losses by hand."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from learning import learn
from scipy.special import erf, logsumexp
from torch import Tensor, nn

from data_module.speech import speech_encoder as encoding
from data_module.speech.speech_encoder_run import LEVELS, hop_and_reach
from data_module.types import Array
from gesticulator.training.stages.speech import crops_of

PUBLISHED = [(10, 5), (8, 4), (4, 2), (4, 2), (4, 2), (1, 1), (1, 1), (1, 1)]
FRAMES, PER_FRAME = 4, 400


def by_hand(encoder: encoding.SpeechEncoder, samples: Array) -> list[Array]:
    """The eight levels [C, T_l] of samples [T] in double precision, from the encoder's weights."""
    x, out = samples[None].astype(np.float64), []
    for layer, (kernel, stride) in enumerate(PUBLISHED):
        w, scale, shift = (encoder.state_dict()[name].double().numpy() for name in (
            f"convolutions.{layer}.weight", f"norms.{layer}.weight", f"norms.{layer}.bias"))
        pieces = np.lib.stride_tricks.sliding_window_view(x, kernel, axis=1)[:, ::stride]
        x = np.einsum("oik,itk->ot", w, pieces)
        x = (x - x.mean()) / np.sqrt(x.var() + 1e-5) * scale[:, None] + shift[:, None]
        x = 0.5 * x * (1 + erf(x / np.sqrt(2)))
        out.append(x)
    out[-1] = np.log(1 + np.abs(x))
    return out


def test_the_eight_levels_are_what_plain_arithmetic_gives() -> None:
    torch.manual_seed(3)
    encoder = encoding.SpeechEncoder(7)
    for norm in encoder.norms:
        nn.init.normal_(norm.weight, 1.0, 0.3)
        nn.init.normal_(norm.bias, 0.0, 0.3)
    samples = 0.1 * np.random.default_rng(0).standard_normal((2, 3000)).astype(np.float32)
    with torch.no_grad():
        found = encoder(torch.from_numpy(samples))
    for row in range(2):
        for level, wanted in enumerate(by_hand(encoder, samples[row])):
            assert np.allclose(found[level][row].numpy(), wanted, atol=1e-4), level + 1


def test_a_row_hears_its_own_samples_and_no_others() -> None:
    encoder = encoding.SpeechEncoder(6).double()
    encoder.norms = nn.ModuleList(nn.Identity() for _ in range(LEVELS))  # which hears the whole window
    samples = torch.randn(1, 2000, dtype=torch.float64, requires_grad=True)
    for level, row in ((1, 17), (2, 30), (5, 3), (8, 5)):
        gradient, = torch.autograd.grad(encoder(samples)[level - 1][0, :, row].sum(), samples)
        hop, reach = hop_and_reach(level)
        heard = np.flatnonzero(gradient[0].numpy())
        assert (heard[0], heard[-1]) == (hop * row, hop * row + reach - 1)


class Numbered(nn.Module):
    """An "encoder" whose row t is the t-th unit vector, so that a score tells which row it is of."""

    width = 20

    def forward(self, samples: Tensor) -> list[Tensor]:
        return [torch.eye(20).expand(len(samples), 20, 20)]


def test_predictive_coding_asks_for_the_row_that_comes_and_for_others_of_the_crop() -> None:
    model = encoding.PredictiveCoding(Numbered())  # type: ignore[arg-type]
    with torch.no_grad():
        model.predict.weight.zero_()
        model.predict.bias.copy_(torch.arange(20.0).repeat(encoding.PREDICTION_STEPS) * 20 ** 0.5)
    torch.manual_seed(0)
    scores, there = model.scores(torch.zeros(20, 1))
    assert scores.shape == (20, 20, encoding.PREDICTION_STEPS, 1 + encoding.NEGATIVES)
    rows = scores.round().long()
    for t in range(20):
        assert there[t].tolist() == [t > step for step in range(encoding.PREDICTION_STEPS)]
        assert (rows[:, t, :, 0] == t).all()
        assert set(rows[:, t, :, 1:].flatten().tolist()) == set(range(20)) - {t}


def test_predictive_coding_is_at_chance_untold_and_learns_what_repeats() -> None:
    torch.manual_seed(0)
    model = encoding.PredictiveCoding(encoding.SpeechEncoder(12))
    generator = np.random.default_rng(0)

    def crops() -> dict[str, Tensor]:
        # Tones that climb a scale of four steps of 30 ms, begun anywhere: what comes next is known from what came.
        starts = generator.integers(0, 4 * 480, 6)
        time = np.arange(6400)
        steps = (time[None] + starts[:, None]) // 480 % 4
        return {"samples": torch.tensor(np.sin(2 * np.pi * (300 * 2 ** steps) * time / 16000), dtype=torch.float32)}

    with torch.no_grad():
        model.predict.weight.zero_()
        model.predict.bias.zero_()
        assert float(model.losses(crops())["predictive"]) == pytest.approx(np.log(11), abs=1e-5)
    nn.init.normal_(model.predict.weight, std=0.1)
    learn(model, lambda _: model.losses(crops())["predictive"], 40)
    with torch.no_grad():
        scores, there = model.scores(crops()["samples"])
    assert float((scores.argmax(-1) == 0)[:, there[:, 0], 0].float().mean()) > 0.5
    assert float(model.losses(crops())["predictive"].detach()) < 0.75 * np.log(11)
    assert set(model.weights) == set(model.losses(crops()))


def contrast(width: int = 6, text_width: int = 9) -> encoding.TextContrast:
    torch.manual_seed(1)
    return encoding.TextContrast(encoding.SpeechEncoder(width), text_width, FRAMES)


def batch_of(seed: int, blocks: int = 5, text_width: int = 9) -> dict[str, Tensor]:
    """Blocks with runs of words, -1 between them; frames of a word share its vector."""
    rng = np.random.default_rng(seed)
    words = np.sort(rng.integers(-1, 3, (blocks, FRAMES)), axis=1)
    vectors = rng.standard_normal((4, text_width))
    samples = 0.1 * rng.standard_normal((blocks, 3 * FRAMES * PER_FRAME))
    return {"samples": torch.tensor(samples, dtype=torch.float32), "word": torch.tensor(words),
            "text": torch.tensor(vectors[words], dtype=torch.float32)}


def cosines(model: encoding.TextContrast, batch: dict[str, Tensor]) -> Array:
    """Eq. 2, [B, K, 8, K], one vector at a time."""
    with torch.no_grad():
        levels = model.encoder.levels(batch["samples"], 3 * FRAMES, range(1, 9))
    text = batch["text"].double().numpy() @ model.text.weight.detach().double().numpy().T
    out = np.zeros((len(text), FRAMES, 8, FRAMES))
    for b, k, level, i in np.ndindex(out.shape):
        audio = model.audio[level].weight.detach().double().numpy() @ levels[level][b, FRAMES + i].double().numpy()
        out[b, k, level, i] = audio @ text[b, k] / np.linalg.norm(audio) / np.linalg.norm(text[b, k])
    return out


def test_the_contrast_is_equation_1_word_for_word() -> None:
    model, batch = contrast(), batch_of(0)
    similar, word = cosines(model, batch), batch["word"].numpy()
    terms = []
    for b, k in np.argwhere(word >= 0):
        terms.append(logsumexp(similar[b, k] / 0.1) - similar[b, k, 7, k] / 0.1)
    assert 0 < len(terms) < word.size
    assert float(model.losses(batch)["contrast"].detach()) == pytest.approx(np.mean(terms), abs=1e-4)
    scaled = {**batch, "text": 3 * batch["text"]}
    assert float(model.losses(scaled)["contrast"].detach()) == pytest.approx(np.mean(terms), abs=1e-4)
    assert set(model.weights) == {"contrast"}


def test_silence_gives_no_anchor_and_the_neighbouring_blocks_no_candidates() -> None:
    model, batch = contrast(), batch_of(5)
    nothing = {**batch, "word": torch.full_like(batch["word"], -1)}
    loss = model.losses(nothing)["contrast"]
    loss.backward()
    assert float(loss.detach()) == 0
    assert all(torch.isfinite(p.grad).all() for p in model.parameters() if p.grad is not None)
    assert torch.isnan(model.retrieval(nothing)).all()
    middle = model.similarities(batch).detach()
    seen = batch["samples"].clone().requires_grad_(True)
    model.encoder.norms = nn.ModuleList(nn.Identity() for _ in range(LEVELS))
    model.similarities({**batch, "samples": seen}).sum().backward()
    assert middle.shape == (5, FRAMES, 8, FRAMES)
    assert seen.grad is not None
    heard = np.flatnonzero(seen.grad.abs().sum(0).numpy())
    assert heard[0] >= FRAMES * PER_FRAME - 240 and heard[-1] < 2 * FRAMES * PER_FRAME + 240


def test_training_draws_level_8_to_the_words() -> None:
    model, batch = contrast(24), batch_of(2, blocks=6)
    first = float(model.losses(batch)["contrast"].detach())
    learn(model, lambda _: model.losses(batch)["contrast"], 60, 3e-3)
    assert float(model.losses(batch)["contrast"].detach()) < 0.8 * first
    best = model.similarities(batch)[batch["word"] >= 0].flatten(1).argmax(1) // FRAMES
    assert float((best == LEVELS - 1).float().mean()) > 0.9


@given(st.lists(st.integers(3, 40), min_size=1, max_size=6), st.integers(0, 2**31))
def test_a_crop_never_runs_over_two_recordings(sizes: list[int], seed: int) -> None:
    sounds = (np.full(size, number + 1.0, np.float32) for number, size in enumerate(sizes))
    drawn = crops_of(sounds, 3)(np.random.default_rng(seed), 200)
    assert drawn.shape == (200, 3) and drawn.dtype == np.float32
    assert (drawn == drawn[:, :1]).all() and set(drawn[:, 0]) <= set(range(1, len(sizes) + 1))
