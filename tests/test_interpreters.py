"""Every lexeme interpreter keeps the same contract; each also does its own job."""

import dataclasses

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from learning import learn
from numpy.typing import NDArray
from runners import played_lstm, played_q, played_style

from data_module.errors import InputError
from interpreters import INTERPRETERS, base
from interpreters.cql import QConfig, QNetwork
from interpreters.cql_run import LiteralQRunner, QRunner
from interpreters.lstm import InterpreterWidths, LstmConfig, LstmInterpreter, StyleConfig, StyleInterpreter
from interpreters.statistical import StatisticalInterpreter

FRAMES, AUDIO, SIZE, CODE, TEXT, CONTROL, MOTION = 5, 4, 6, 3, 3, 6, 9


def lstm(**changes: object) -> LstmInterpreter:
    torch.manual_seed(0)
    config = LstmConfig(**{"audio_features": 8, "width": 16, "dropout": 0.0, **changes})  # type: ignore[arg-type]
    return LstmInterpreter(config, torch.randn(SIZE, 7), InterpreterWidths(FRAMES, AUDIO, 2, TEXT, CONTROL,
                                                                                 MOTION))


def statistical() -> StatisticalInterpreter:
    rng = np.random.default_rng(0)
    moves = rng.random((SIZE, SIZE))
    return StatisticalInterpreter(np.stack([np.full(SIZE, 1 / SIZE), np.eye(SIZE)[2]]),
                                  moves / moves.sum(1, keepdims=True))


def style(**changes: object) -> StyleInterpreter:
    torch.manual_seed(0)
    config = StyleConfig(**{"audio_features": 8, "width": 16, "dropout": 0.0, **changes})  # type: ignore[arg-type]
    return StyleInterpreter(config, FRAMES, AUDIO, torch.randn(SIZE, 7), CODE, 2, TEXT).eval()


def q_network(kind: type[QRunner] = QRunner) -> QRunner:
    torch.manual_seed(0)
    config = QConfig(width=8, heads=2, layers=1, decisions=3, audio_features=4, audio_bottleneck=0)
    return played_q(QNetwork(config, FRAMES, AUDIO, SIZE, 2, [1]).eval(), kind)


class Outsider:
    """Somebody else's: nothing but `start` and `step`."""

    def start(self, speaker: int, first_lexeme: int) -> int:
        """Blocks before."""
        return 0

    def step(self, state: int, features: base.BlockFeatures, previous_lexeme: int) -> tuple[base.Scores, int]:
        """Loud blocks favour the next lexeme."""
        scores = np.full(SIZE, -3.0)
        scores[(previous_lexeme + 1) % SIZE] = float(np.abs(features.high).mean())
        return scores - np.logaddexp.reduce(scores), state + 1


MAKERS = {"lstm": lambda: played_lstm(lstm()), "cql": q_network, "cql-literal": lambda: q_network(LiteralQRunner),
          "statistical": statistical}


def hear(seed: int = 0, **also: NDArray[np.float32]) -> base.BlockFeatures:
    window = torch.randn(3 * FRAMES, AUDIO, generator=torch.Generator().manual_seed(seed)).numpy()
    return base.BlockFeatures(window, window, **also)


def windows(seed: int, blocks: int, width: int = TEXT) -> torch.Tensor:
    """[1, blocks, 3K, width] as they overlap in a recording: each window holds the blocks before and after."""
    rows = torch.randn(blocks + 2, FRAMES, width, generator=torch.Generator().manual_seed(seed))
    return torch.cat([rows[:-2], rows[1:-1], rows[2:]], dim=1)[None]


PLAYED = {**MAKERS, "by ear": lambda: base.InterpreterByEar(played_lstm(lstm(audio_dropout=0.1)), 0.5),
          "reads all": lambda: played_lstm(lstm(text_features=4, use_control=True, pose_features=4)),
          "outsider": Outsider}
"""Every registered interpreter, two more forms of the LSTM, and an object from outside."""


@pytest.mark.parametrize("name", INTERPRETERS)
def test_a_registered_interpreter_is_of_its_class_and_name(name: str) -> None:
    system = MAKERS[name]()
    assert isinstance(system, INTERPRETERS[name].load()) and base.as_interpreter(system) is system
    assert base.as_interpreter(system).name == name


def everything(seed: int = 0) -> base.BlockFeatures:
    """A block of which all is known."""
    generator = torch.Generator().manual_seed(seed)
    past = torch.randn(FRAMES, MOTION, generator=generator).numpy()
    return dataclasses.replace(hear(seed), text=windows(seed, 1)[0, 0].numpy(), past=past, durations=(0.4, 0.5),
                               control=torch.randn(FRAMES, CONTROL, generator=generator).numpy())


@pytest.mark.parametrize("name", PLAYED)
def test_what_an_interpreter_does_not_need_changes_nothing(name: str) -> None:
    system = base.as_interpreter(PLAYED[name]())
    assert system.needs <= base.EVERY_NEED
    full = everything()
    others = {"text": {"text": everything(1).text}, "pose": {"past": everything(1).past},
              "control": {"control": everything(1).control}, "durations": {"durations": (0.4, 0.8)}}
    scores, _ = system.step(system.start(0, 1), full, 1)
    for need, other in others.items():
        changed, _ = system.step(system.start(0, 1), dataclasses.replace(full, **other), 1)
        if name != "outsider":  # who may read anything, for all that is known
            assert np.array_equal(scores, changed) == (need not in system.needs), need
    bare = dataclasses.replace(full, **{field: None for need, field in (
        ("text", "text"), ("pose", "past"), ("control", "control"), ("durations", "durations"))
        if need not in system.needs})
    np.testing.assert_array_equal(system.step(system.start(0, 1), bare, 1)[0], scores)


def test_an_object_with_start_and_step_is_enough_and_less_is_refused() -> None:
    class Partly(Outsider):
        gives_values = True

    class Derived(base.InterpreterDefaults, Partly):
        name = "derived"
        gives_values = True

    adapted = base.as_interpreter(Outsider())
    assert adapted.name == "Outsider" and base.as_interpreter(adapted) is adapted and not adapted.gives_values
    assert base.as_interpreter(Derived()).gives_values
    with pytest.raises(InputError, match="gives_values"):
        base.as_interpreter(Partly())
    with pytest.raises(InputError, match="no start and step"):
        base.as_interpreter(object())


@pytest.mark.parametrize("name", PLAYED)
def test_contract(name: str) -> None:
    system = base.as_interpreter(PLAYED[name]())
    state = system.start(1, 2)
    scores, after = system.step(state, everything(), 2)
    assert scores.shape == (SIZE,) and np.isfinite(scores).all()
    if not system.gives_values:
        assert np.exp(scores).sum() == pytest.approx(1, abs=1e-6)
    again, _ = system.step(state, everything(), 2)
    np.testing.assert_array_equal(scores, again, "a step must not change the state it is given")
    later, _ = system.step(after, everything(1), int(scores.argmax()))
    assert later.shape == (SIZE,)


@pytest.mark.parametrize("changes", [{}, {"text_features": 4, "use_control": True}, {"text_head": 6},
                                     {"text_features": 4, "text_bottleneck": 2},
                                     {"reads_by": "block", "lexeme_features": 3, "text_features": 4,
                                      "use_control": True},
                                     {"reads_by": "block", "text_head": 6}])
def test_lstm_streams_as_it_trains(changes: dict[str, object]) -> None:
    model = lstm(**changes).eval()
    previous = torch.randint(SIZE, (1, 5))
    audio, text, control = windows(1, 5, AUDIO), windows(2, 5), torch.randn(1, 5, FRAMES, CONTROL)
    speaker = torch.tensor([[0.0, 1.0]])
    whole = torch.log_softmax(model.scores(previous, audio, speaker, None, text, control)[0], -1)[0]
    runner = played_lstm(model)
    state = runner.start(1, int(previous[0, 0]))
    for i in range(5):
        sound, words, rows = (values[0, i].numpy() for values in (audio, text, control))
        heard = base.BlockFeatures(np.zeros_like(sound), sound, text=words, control=rows)
        scores, state = runner.step(state, heard, int(previous[0, i]))
        np.testing.assert_allclose(scores, whole[i].detach().numpy(), atol=1e-5)


def test_a_reading_head_adds_to_the_voice_and_nothing_else_learns() -> None:
    deaf, reads = lstm().eval(), lstm(text_head=6, text_bottleneck=3)
    reads.init_from_audio_only(deaf)
    arguments = (torch.tensor([[0, 3, 2]]), windows(1, 3, AUDIO), torch.tensor([[0.0, 1.0]]))
    text = windows(2, 3)
    torch.testing.assert_close(reads.eval().scores(*arguments, text=text)[0], deaf.scores(*arguments)[0])
    before = {name: value.clone() for name, value in reads.state_dict().items()}
    optimiser = torch.optim.SGD([p for p in reads.parameters() if p.requires_grad], lr=0.5)
    batch = {"lexeme": torch.tensor([[0, 1, 2, 3]]), "audio_high": windows(1, 4, AUDIO), "text": windows(2, 4),
             "speaker": arguments[2], "valid": torch.ones(1, 4)}
    for _ in range(3):
        optimiser.zero_grad()
        reads.train().losses(batch, 0.0)["nll"].backward()
        optimiser.step()
    after = reads.eval().state_dict()
    moved = {name for name, value in after.items() if not torch.equal(value, before[name])}
    assert moved and all(name.startswith("text_head.") for name in moved)
    # The words of one block have no say in another's: the head has no memory.
    other = text.clone()
    other[:, 1] += 1.0
    changed = (reads.scores(*arguments, text=text)[0] - reads.scores(*arguments, text=other)[0]).abs().amax((0, 2))
    assert changed[1] > 0 and changed[0] == changed[2] == 0


def test_lstm_learns_a_lexeme_from_sound_and_filled_blocks_do_not_count() -> None:
    model = lstm()
    torch.manual_seed(5)
    prototypes = torch.randn(SIZE, 3 * FRAMES, AUDIO)

    def batch() -> dict[str, torch.Tensor]:
        lexeme = torch.randint(SIZE, (16, 5))
        return {"lexeme": lexeme, "audio_high": prototypes[lexeme] + 0.3 * torch.randn(16, 5, 3 * FRAMES, AUDIO),
                "speaker": torch.eye(2)[torch.zeros(16, dtype=torch.long)], "valid": torch.ones(16, 5)}

    learn(model, lambda step: model.losses(batch(), step / 60)["nll"], 60)
    b = batch()
    logits = model.scores(b["lexeme"][:, :-1], b["audio_high"][:, 1:], b["speaker"])[0]
    assert (logits.argmax(-1) == b["lexeme"][:, 1:]).float().mean() > 0.9
    b["valid"][:, 3:] = 0
    other = {**b, "lexeme": b["lexeme"].clone()}
    other["lexeme"][:, 4] = (other["lexeme"][:, 4] + 1) % SIZE
    assert torch.equal(model.losses(b)["nll"], model.losses(other)["nll"])


def test_equation_24_on_three_lexemes_by_hand() -> None:
    moves = np.array([[0.5, 0.5, 0.0], [0.0, 0.5, 0.5], [0.2, 0.3, 0.5]])
    system = StatisticalInterpreter(np.array([[0.5, 0.3, 0.2]]), moves)
    _, state = system.step(system.start(0, 0), hear(), 0)  # lexeme 0 was shown once: f_t = (1, 0, 0)
    weights = np.exp([-0.5, 0.3, 0.2])
    weights /= weights.sum()
    np.testing.assert_allclose(system.distribution(state), weights @ moves)


def test_a_lexeme_that_only_the_word_tells_is_learned_from_the_word() -> None:
    model = lstm(text_features=8, own_past_most=0.0)
    torch.manual_seed(6)
    words = torch.randn(SIZE, TEXT)

    def batch() -> dict[str, torch.Tensor]:
        lexeme = torch.randint(SIZE, (16, 5))
        text = torch.randn(16, 5, 3 * FRAMES, TEXT)
        text[:, :, FRAMES:2 * FRAMES] = words[lexeme][:, :, None]
        return {"lexeme": lexeme, "audio_high": torch.randn(16, 5, 3 * FRAMES, AUDIO), "text": text,
                "speaker": torch.eye(2)[torch.zeros(16, dtype=torch.long)], "valid": torch.ones(16, 5)}

    learn(model, lambda step: model.losses(batch(), step / 80)["nll"], 80)
    b = batch()
    logits = model.scores(b["lexeme"][:, :-1], b["audio_high"][:, 1:], b["speaker"], None, b["text"][:, 1:])[0]
    assert (logits.argmax(-1) == b["lexeme"][:, 1:]).float().mean() > 0.8


@pytest.mark.parametrize("changes", [{}, {"text_features": 4, "text_bottleneck": 2}])
def test_style_streams_as_it_runs_and_starts_from_the_code_of_stillness(changes: dict[str, object]) -> None:
    model = style(**changes)
    text = windows(4, 3)
    features, lexemes = [hear(i, text=text[0, i].numpy()) for i in range(3)], [0, 4, 2]
    runner, codes = played_style(model), [np.zeros(CODE, np.float32)]
    state = runner.start(0)
    for heard, lexeme in zip(features, lexemes, strict=True):
        code, state = runner.step(state, heard, lexeme)
        codes.append(code)
    whole, _ = model.codes(torch.as_tensor(np.stack(codes[:-1]))[None], torch.tensor([lexemes]),
                           torch.as_tensor(np.stack([f.low for f in features]))[None], torch.eye(2)[:1], None, text)
    np.testing.assert_allclose(whole[0].detach().numpy(), np.stack(codes[1:]), atol=1e-5, rtol=1e-4)


@given(st.lists(st.floats(-5, 5), min_size=2, max_size=9), st.data())
def test_the_mask_is_never_broken(values: list[float], data: st.DataObject) -> None:
    allowed = np.array(data.draw(st.sets(st.integers(0, len(values) - 1), min_size=1)) and
                       sorted(data.draw(st.sets(st.integers(0, len(values) - 1), min_size=1))))
    for temperature in (0.0, 1.0):
        chosen = base.select(np.array(values), allowed=allowed, temperature=temperature, rng=np.random.default_rng(0))
        assert chosen in allowed


def test_select_known_cases() -> None:
    scores = np.log([0.6, 0.3, 0.1])
    assert base.select(scores) == 0
    assert base.select(scores, allowed=np.array([], dtype=np.int64)) == 0, "an empty mask masks nothing"
    rng = np.random.default_rng(2)
    drawn = [base.select(scores, temperature=1.0, top=2, rng=rng) for _ in range(200)]
    assert set(drawn) == {0, 1}
    with pytest.raises(ValueError):
        base.select(scores, temperature=-1)


@pytest.mark.parametrize("temperature", [0.5, 1.0, 2.0])
def test_lexemes_are_drawn_from_the_tempered_softmax(temperature: float) -> None:
    scores, rng = np.log([0.6, 0.3, 0.1]), np.random.default_rng(8)
    drawn = [base.select(scores, temperature=temperature, rng=rng) for _ in range(6000)]
    wanted = np.array([0.6, 0.3, 0.1]) ** (1 / temperature)
    np.testing.assert_allclose(np.bincount(drawn, minlength=3) / 6000, wanted / wanted.sum(), atol=0.025)
