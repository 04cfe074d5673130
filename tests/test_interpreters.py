"""Every lexeme interpreter keeps the same contract; each also does its own job."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from interpreters import INTERPRETERS, BlockFeatures, LexemeInterpreter, select
from interpreters.lstm import LstmConfig, LstmInterpreter
from interpreters.statistical import StatisticalConfig, StatisticalInterpreter
from interpreters.style import StyleConfig, StyleInterpreter

FRAMES, AUDIO, SIZE, CODE = 5, 4, 6, 3


def lstm(**changes: object) -> LstmInterpreter:
    torch.manual_seed(0)
    config = LstmConfig(**{"audio_features": 8, "width": 16, "dropout": 0.0, **changes})  # type: ignore[arg-type]
    return LstmInterpreter(config, FRAMES, AUDIO, torch.randn(SIZE, 7), speakers=2)


def statistical(**changes: object) -> StatisticalInterpreter:
    rng = np.random.default_rng(0)
    moves = rng.random((SIZE, SIZE))
    return StatisticalInterpreter(np.stack([np.full(SIZE, 1 / SIZE), np.eye(SIZE)[2]]),
                                  moves / moves.sum(1, keepdims=True), StatisticalConfig(**changes))  # type: ignore[arg-type]


def style() -> StyleInterpreter:
    torch.manual_seed(0)
    return StyleInterpreter(StyleConfig(audio_features=8, width=16, dropout=0.0), FRAMES, AUDIO, torch.randn(SIZE, 7),
                            CODE, speakers=2).eval()


MAKERS = {"lstm": lambda: lstm().eval(), "statistical": statistical}


def hear(seed: int = 0) -> BlockFeatures:
    window = torch.randn(3 * FRAMES, AUDIO, generator=torch.Generator().manual_seed(seed))
    return BlockFeatures(window, window)


def test_every_interpreter_has_a_maker_here() -> None:
    assert set(MAKERS) == set(INTERPRETERS)


def test_the_command_line_offers_every_interpreter() -> None:
    from gesticulator import infer  # it lists them by hand, so that --help need not import torch

    assert set(infer.INTERPRETERS) == set(INTERPRETERS)


@pytest.mark.parametrize("name", MAKERS)
def test_contract(name: str) -> None:
    system = MAKERS[name]()
    assert isinstance(system, LexemeInterpreter) and isinstance(system, INTERPRETERS[name])
    state = system.start(1, 2)
    scores, after = system.step(state, hear(), 2)
    assert scores.shape == (SIZE,) and np.isfinite(scores).all()
    assert np.exp(scores).sum() == pytest.approx(1, abs=1e-6)
    again, _ = system.step(state, hear(), 2)
    np.testing.assert_array_equal(scores, again, "a step must not change the state it is given")
    later, _ = system.step(after, hear(1), int(scores.argmax()))
    assert later.shape == (SIZE,)


def test_lstm_streams_as_it_trains() -> None:
    model = lstm().eval()
    previous = torch.randint(SIZE, (1, 5))
    audio = torch.randn(1, 5, 3 * FRAMES, AUDIO)
    speaker = torch.tensor([[0.0, 1.0]])
    whole = torch.log_softmax(model.scores(previous, audio, speaker)[0], -1)[0]
    state = model.start(1, int(previous[0, 0]))
    for i in range(5):
        scores, state = model.step(state, BlockFeatures(audio[0, i], audio[0, i]), int(previous[0, i]))
        np.testing.assert_allclose(scores, whole[i].detach().numpy(), atol=1e-5)


def test_lstm_is_causal_in_windows_and_hears_each() -> None:
    model = lstm().eval()
    previous, speaker = torch.zeros(1, 4, dtype=torch.long), torch.eye(2)[:1]
    audio = torch.randn(1, 4, 3 * FRAMES, AUDIO)
    changed = audio.clone()
    changed[:, 2] += 1
    a, b = model.scores(previous, audio, speaker)[0], model.scores(previous, changed, speaker)[0]
    assert torch.equal(a[:, :2], b[:, :2]) and not torch.equal(a[:, 2], b[:, 2])


def test_the_speaker_matters_only_when_it_is_an_input() -> None:
    for use in (True, False):
        model = lstm(use_speaker=use).eval()
        a, b = (model.step(model.start(s, 0), hear(), 0)[0] for s in (0, 1))
        assert np.array_equal(a, b) != use


def test_lstm_learns_a_lexeme_from_sound_and_filled_blocks_do_not_count() -> None:
    model = lstm()
    optimiser = torch.optim.Adam(model.parameters(), 1e-2)
    torch.manual_seed(5)
    prototypes = torch.randn(SIZE, 3 * FRAMES, AUDIO)

    def batch() -> dict[str, torch.Tensor]:
        lexeme = torch.randint(SIZE, (16, 5))
        return {"lexeme": lexeme, "audio_high": prototypes[lexeme] + 0.3 * torch.randn(16, 5, 3 * FRAMES, AUDIO),
                "speaker": torch.eye(2)[torch.zeros(16, dtype=torch.long)], "valid": torch.ones(16, 5)}

    for step in range(60):
        loss = model.losses(batch(), step / 60)["cross_entropy"]
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    model.eval()
    b = batch()
    logits = model.scores(b["lexeme"][:, :-1], b["audio_high"][:, 1:], b["speaker"])[0]
    assert (logits.argmax(-1) == b["lexeme"][:, 1:]).float().mean() > 0.9
    b["valid"][:, 3:] = 0
    other = {**b, "lexeme": b["lexeme"].clone()}
    other["lexeme"][:, 4] = (other["lexeme"][:, 4] + 1) % SIZE
    assert torch.equal(model.losses(b)["cross_entropy"], model.losses(other)["cross_entropy"])


def test_equation_24_on_three_lexemes_by_hand() -> None:
    moves = np.array([[0.5, 0.5, 0.0], [0.0, 0.5, 0.5], [0.2, 0.3, 0.5]])
    system = StatisticalInterpreter(np.array([[0.5, 0.3, 0.2]]), moves)
    _, state = system.step(system.start(0, 0), hear(), 0)  # lexeme 0 was shown once: f_t = (1, 0, 0)
    weights = np.exp([-0.5, 0.3, 0.2])
    weights /= weights.sum()
    np.testing.assert_allclose(system.distribution(state, 0), weights @ moves)
    conditioned = StatisticalInterpreter(np.array([[0.5, 0.3, 0.2]]), moves, StatisticalConfig(1.0, True))
    by_hand = weights * moves[0]
    np.testing.assert_allclose(conditioned.distribution(state, 0), by_hand / by_hand.sum())


def test_a_high_gain_brings_the_frequencies_to_the_speakers() -> None:
    rng = np.random.default_rng(1)
    target = np.array([0.5, 0.25, 0.15, 0.1])
    moves = np.full((4, 4), 0.25)
    system = StatisticalInterpreter(target[None], moves, StatisticalConfig(gain=50.0, condition_on_current=True))
    state, current, shown = system.start(0, 0), 0, np.zeros(4)
    for _ in range(400):
        scores, state = system.step(state, hear(), current)
        current = select(scores, temperature=1.0, rng=rng)
        shown[current] += 1
    assert np.abs(shown / 400 - target).max() < 0.02


def test_rows_that_do_not_sum_to_one_are_refused() -> None:
    with pytest.raises(ValueError, match="sum to 1"):
        StatisticalInterpreter(np.ones((1, 3)) / 3, np.ones((3, 3)))


def test_style_streams_as_it_runs_and_starts_from_the_code_of_stillness() -> None:
    model = style()
    features, lexemes = [hear(i) for i in range(3)], [0, 4, 2]
    state, codes = model.start(0), [torch.zeros(1, CODE)]
    for heard, lexeme in zip(features, lexemes, strict=True):
        code, state = model.step(state, heard, lexeme)
        codes.append(code)
    whole, _ = model.codes(torch.stack(codes[:-1], 1), torch.tensor([lexemes]),
                           torch.stack([f.low for f in features])[None], torch.eye(2)[:1])
    torch.testing.assert_close(whole[0], torch.cat(codes[1:]).clone(), atol=1e-5, rtol=1e-4)


@given(st.lists(st.floats(-5, 5), min_size=2, max_size=9), st.data())
def test_the_mask_is_never_broken(values: list[float], data: st.DataObject) -> None:
    allowed = np.array(data.draw(st.sets(st.integers(0, len(values) - 1), min_size=1)) and
                       sorted(data.draw(st.sets(st.integers(0, len(values) - 1), min_size=1))))
    for temperature in (0.0, 1.0):
        chosen = select(np.array(values), allowed=allowed, temperature=temperature, rng=np.random.default_rng(0))
        assert chosen in allowed


def test_select_known_cases() -> None:
    scores = np.log([0.6, 0.3, 0.1])
    assert select(scores) == 0
    assert select(scores, allowed=np.array([], dtype=np.int64)) == 0, "an empty mask masks nothing"
    rng = np.random.default_rng(2)
    drawn = np.bincount([select(scores, temperature=1.0, rng=rng) for _ in range(4000)], minlength=3) / 4000
    np.testing.assert_allclose(drawn, [0.6, 0.3, 0.1], atol=0.03)
    drawn = [select(scores, temperature=1.0, top=2, rng=rng) for _ in range(200)]
    assert set(drawn) == {0, 1}
    with pytest.raises(ValueError):
        select(scores, temperature=-1)
