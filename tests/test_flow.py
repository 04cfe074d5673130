"""The flow head: that it samples instead of averaging, obeys what it is given, and can be guided beyond it."""

import dataclasses

import numpy as np
import pytest
import torch
from learning import learn
from runners import played_flow

from data_module.motion.movement import MovementBasis, pasts_of
from generator.flow import FlowGenerator, FlowInputs, FlowTime, _fade
from generator.flow_run import CIRCUMSTANCES
from generator.settings import GeneratorConfig, GeneratorWidths
from gesticulator.sampling.loop import Keys

FRAMES, WIDTH, AUDIO = 4, 3, 5
CONFIG = GeneratorConfig(motion_features=8, audio_features=4, style_width=0, position_width=4, hidden=16,
                         groups=2, classes=4, lstm_layers=1, blocks=4, context=32, lexeme_width=16, flow_width=64,
                         dropout=0.0, past_noise=0.0, velocity_noise=0.0)
TWO = 2


def made(motion: torch.Tensor, config: GeneratorConfig = CONFIG) -> FlowGenerator:
    """An untrained generator whose basis is fitted on blocks [N, K, D]."""
    torch.manual_seed(0)
    basis = MovementBasis(FRAMES, {"body": tuple(range(WIDTH))}, {"body": 6})
    durations = torch.full((len(motion),), 0.3, dtype=torch.float64)
    past = pasts_of(motion, durations, motion[0, 0])
    y = basis.fit(motion, past, torch.ones(len(motion), WIDTH))
    generator = FlowGenerator(config, GeneratorWidths(FRAMES, WIDTH, AUDIO, 6, 0, TWO, 1),
                              MovementBasis(FRAMES, basis.parts, {"body": 6}))
    generator.adopt(basis, y, torch.zeros(TWO, basis.width))
    return generator


def swings(count: int, heard: bool, seed: int = 0) -> dict[str, torch.Tensor]:
    """Windows of a body that in every block swings out and back, to one side or the other, at random.

    heard: the audio of a block tells the side; else it is noise.
    """
    rng = np.random.default_rng(seed)
    side = torch.as_tensor(rng.choice([-1.0, 1.0], (count, CONFIG.blocks + 1)), dtype=torch.float32)
    shape = torch.sin(torch.pi * torch.arange(1, FRAMES + 1) / FRAMES)
    way = torch.tensor([1.0, 0.5, -0.3])
    motion = side[..., None, None] * shape[:, None] * way
    motion = motion + 0.02 * torch.as_tensor(rng.normal(size=motion.shape), dtype=torch.float32)
    audio = torch.as_tensor(rng.normal(size=(count, CONFIG.blocks + 1, 3 * FRAMES, AUDIO)), dtype=torch.float32) * 0.1
    if heard:
        audio[..., 0] = side[..., None]
    ones = torch.ones(count, CONFIG.blocks + 1)
    return {"motion": motion, "audio": audio, "ratio": ones, "valid": ones, "mask": torch.ones(count, WIDTH),
            "circumstances": torch.zeros(count, CONFIG.blocks + 1, CIRCUMSTANCES), "speaker": torch.ones(count, 1),
            "side": side}


def trained(heard: bool, named: bool, steps: int = 250, config: GeneratorConfig = CONFIG) -> FlowGenerator:
    """named: lexeme 0 is one side and lexeme 1 the other; else lexemes are drawn at random."""
    generator = made(swings(100, heard)["motion"].flatten(0, 1), config)
    rest = torch.zeros(2, FRAMES, WIDTH)
    shape = torch.sin(torch.pi * torch.arange(1, FRAMES + 1) / FRAMES)
    sides = torch.tensor([-1.0, 1.0])[:, None, None] * shape[:, None] * torch.tensor([1.0, 0.5, -0.3])
    still = pasts_of(rest, torch.full((2,), 0.3, dtype=torch.float64), torch.zeros(WIDTH))
    codes = generator.basis.coefficients(sides, still)

    def nearest(y: torch.Tensor) -> torch.Tensor:
        if not named:
            return torch.randint(0, 2, (len(y),))
        return torch.cdist(y, codes).argmin(-1)

    def loss(step: int) -> torch.Tensor:
        torch.manual_seed(step)
        return generator.losses(swings(32, heard, step), step / steps, nearest)["flow"]

    learn(generator, loss, steps, 5e-3)
    return generator


def drawn(generator: FlowGenerator, lexeme: int, side: float, gains: tuple[float, float] = (0.0, 0.0), count: int = 200
          ) -> np.ndarray:
    """[count] how far to the one side blocks from rest go, of all the way."""
    before = torch.zeros(3, 1, FRAMES, WIDTH)
    audio = torch.zeros(3, 1, 3 * FRAMES, AUDIO)
    audio[..., 0] = side
    given = FlowInputs(audio, torch.tensor([[lexeme], [lexeme], [TWO]]), before, torch.ones(3, 1),
                       torch.zeros(3, 1, CIRCUMSTANCES), torch.ones(3, 1),
                       without_audio=torch.tensor([False, True, False]))
    with torch.no_grad():
        context, _ = generator.contexts(given, torch.zeros(3, 1, generator.basis.width))
        width = generator.basis.width
        pull = np.repeat(np.array(gains, np.float32)[:, None], width, axis=1)
        y = played_flow(generator, 1).sample(context[:, 0].numpy(), pull, Keys(1).noise(0, (count, width)), 6)
        block = generator.basis.compose(torch.as_tensor(y), given.past[:1, 0][torch.zeros(count, dtype=torch.long)])
    found: np.ndarray = block[:, FRAMES // 2 - 1, 0].numpy()
    return found


def test_a_shift_is_taken_back_along_a_quintic() -> None:
    """Of a block of four frames: 1 - (10 x^3 - 15 x^4 + 6 x^5) at its quarters."""
    torch.testing.assert_close(_fade(4, torch.zeros(1)), torch.tensor([0.896484375, 0.5, 0.103515625, 0.0]))


def test_the_loss_before_training_is_that_of_unit_gaussian_data() -> None:
    """Of u - noise, which has variance 2, (2 t - 1) / s u_t leaves 1 / s; its mean over t is pi / 2."""
    batch = swings(300, False)
    generator = made(batch["motion"].flatten(0, 1)).eval()
    loss = generator.losses(batch, 0.0, lambda y: torch.zeros(len(y), dtype=torch.long))["flow"]
    assert loss.item() == pytest.approx(np.pi / 2, rel=0.1)


@pytest.mark.parametrize("shared", [False, True])
def test_drawing_follows_the_field_that_was_trained(shared: bool) -> None:
    """The Adams method over `FlowHead` itself, context by context, against the head that drawing uses: also after the
    weights have changed. Where guidance is shared, that of the first row holds for the others."""
    generator = made(swings(50, False)["motion"].flatten(0, 1)).eval()
    contexts = torch.randn(3, CONFIG.context + generator.basis.width, generator=torch.manual_seed(1))
    gains, noise = torch.rand(2, generator.basis.width), torch.randn(4, generator.basis.width)

    def slowly(steps: int) -> torch.Tensor:
        def v(u: torch.Tensor, time: float) -> torch.Tensor:
            at = FlowTime.of(torch.full((len(u), 1), time))
            one, *others = (generator.head(u, at, generator.head.conditions(own.expand(len(u), -1)))
                            for own in contexts)
            pull = sum(gain * (one - other) for gain, other in zip(gains, others, strict=True))
            return one + (pull[:1] if shared else pull)

        u, known = noise, [v(noise, 0.0)]
        for i in range(steps):
            ahead = known[-1] if i == 0 else 1.5 * known[-1] - 0.5 * known[-2]
            known.append(v(u + ahead / steps, (i + 1) / steps))
            u = u + (known[-2] + known[-1]) / 2 / steps
        return generator.stretch(u)

    for seed in range(2):
        with torch.no_grad():
            for weight in generator.head.parameters():
                weight.copy_(0.3 * torch.randn(weight.shape, generator=torch.manual_seed(seed)))
            wanted = slowly(3)
            found = played_flow(generator, 1).sample(contexts.numpy(), gains.numpy(), noise.numpy(), 3, shared)
        assert wanted.std() > 0.1
        np.testing.assert_allclose(found, wanted.numpy(), atol=1e-4, rtol=1e-3)


def test_it_draws_either_side_and_never_the_mean() -> None:
    """A regression would draw 0, which nobody ever does."""
    found = drawn(trained(heard=False, named=False), 0, 0.0)
    assert (np.abs(found) > 0.5).mean() > 0.8
    assert 0.25 < (found > 0).mean() < 0.75


def test_it_draws_the_lexeme_that_it_is_told() -> None:
    generator = trained(heard=False, named=True)
    assert (drawn(generator, 0, 0.0) < -0.5).mean() > 0.9
    assert (drawn(generator, 1, 0.0) > 0.5).mean() > 0.9
    both = drawn(generator, TWO, 0.0)
    assert 0.2 < (both > 0).mean() < 0.8


def test_it_hears_the_side_and_guidance_goes_beyond() -> None:
    """A faint voice tells little; guidance makes more of it."""
    generator = trained(heard=True, named=False)
    assert (drawn(generator, 0, 1.0) > 0.5).mean() > 0.9
    assert (drawn(generator, 0, -1.0) < -0.5).mean() > 0.9
    faint = [(drawn(generator, 0, 0.08, (gain, 0.0)) > 0).mean() for gain in (0.0, 2.0)]
    assert faint[1] > faint[0]


@pytest.mark.parametrize(("heard", "named"), [(True, False), (False, True)])
def test_where_the_code_is_the_only_way_it_tells_what_was_heard_and_asked_for(heard: bool, named: bool) -> None:
    generator = trained(heard, named, 400, dataclasses.replace(CONFIG, hears_through="code"))

    def right() -> tuple[float, float]:
        left, other = (drawn(generator, int(named and side > 0), side if heard else 0.0) for side in (-1.0, 1.0))
        return float((left < -0.5).mean()), float((other > 0.5).mean())

    assert min(right()) > 0.85
    with torch.no_grad():
        generator.codes.vectors.zero_()
    assert min(right()) < 0.7, "no other way tells them apart"
    assert np.array_equal(drawn(generator, 0, 1.0), drawn(generator, 1, -1.0))


def test_what_no_source_has_weighs_nothing() -> None:
    batch = swings(8, False)
    generator = made(batch["motion"].flatten(0, 1))
    batch["mask"] = torch.zeros(8, WIDTH)
    assert float(generator.losses(batch, 0.0, lambda y: torch.zeros(len(y), dtype=torch.long))["flow"]) == 0.0
