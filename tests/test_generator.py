"""The generator: its equations, its gradients, and that it can learn."""

import math

import pytest
import torch

from generator import losses
from generator.model import (
    BlockInputs,
    Generator,
    GumbelCodes,
    StyleCodes,
)
from generator.settings import GeneratorConfig, GeneratorWidths, positional_block

FRAMES, WIDTH, AUDIO, LEXEME, CONTROL = 6, 5, 4, 7, 6
CONFIG = GeneratorConfig(motion_features=8, audio_features=6, style_width=4, position_width=4, hidden=24, groups=4,
                         classes=8, lstm_width=24, lstm_layers=1)


def make(blocks: int = 20, present: torch.Tensor | None = None, **changes: object) -> Generator:
    torch.manual_seed(0)
    config = GeneratorConfig(**{**CONFIG.__dict__, **changes})
    return Generator(config, GeneratorWidths(FRAMES, WIDTH, AUDIO, LEXEME, CONTROL), blocks, present)


def batch(size: int = 3, blocks: int = 4) -> dict[str, torch.Tensor]:
    torch.manual_seed(1)
    n = blocks + 1
    return {"motion": torch.randn(size, n, FRAMES, WIDTH), "audio": torch.randn(size, n, 3 * FRAMES, AUDIO),
            "lexeme": torch.randn(size, n, LEXEME), "style": torch.randint(1, 21, (size, n)),
            "mask": torch.ones(size, WIDTH), "valid": torch.ones(size, n),
            "control": torch.randn(size, n, FRAMES, CONTROL)}


def encoder(motion: torch.Tensor) -> torch.Tensor:
    return motion.flatten(1)[:, :LEXEME]


def test_positional_block_follows_equation_8_by_hand() -> None:
    block = positional_block(4, 6, beta=100.0)
    assert block[0].tolist() == [0, 1, 0, 1, 0, 1]
    assert math.isclose(float(block[3, 2]), math.sin(3 / 100 ** (2 / 6)), rel_tol=1e-5)
    assert math.isclose(float(block[3, 5]), math.cos(3 / 100 ** (4 / 6)), rel_tol=1e-5)


def test_gumbel_is_one_hot_with_a_gradient_in_training_and_arg_max_in_evaluation() -> None:
    torch.manual_seed(2)
    codes = GumbelCodes(5, groups=3, classes=4, group_width=2)
    hidden = torch.randn(50, 5, requires_grad=True)
    _, choice = codes(hidden, temperature=1.0)
    assert torch.allclose(choice.sum(-1), torch.ones(50, 3))
    assert torch.allclose(choice.max(-1).values, torch.ones(50, 3))
    gradients = []
    for temperature in (1.0, 1000.0):  # the choice is the same, its gradient is that of a softmax at this temperature
        torch.manual_seed(2)
        gradients += torch.autograd.grad(codes(hidden, temperature)[0].pow(2).sum(), hidden)
    assert gradients[0].abs().sum() > 100 * gradients[1].abs().sum() > 0
    codes.eval()
    chosen = codes(hidden, 1.0)[1].argmax(-1)
    assert torch.equal(chosen, codes.logits(hidden).unflatten(-1, (3, 4)).argmax(-1))
    expected = torch.stack([codes.vectors[g, chosen[:, g]] for g in range(3)], 1).flatten(1)
    torch.testing.assert_close(codes(hidden, 1.0)[0], expected)


def test_only_the_style_codes_of_a_batch_have_gradients_and_row_zero_has_none() -> None:
    styles = StyleCodes(6, 3)
    (styles(torch.tensor([0, 2, 2, 5])) - 1).pow(2).sum().backward()
    assert styles.table.weight.grad is not None and styles.table.weight[0].abs().sum() == 0
    assert (styles.table.weight.grad.abs().sum(1) > 0).tolist() == [False, False, True, False, False, True, False]


def test_style_divergence_of_one_code_and_of_none_is_a_number() -> None:
    assert math.isfinite(float(losses.style_divergence(torch.randn(1, 8))))
    assert float(losses.style_divergence(torch.zeros(0, 8))) == 0


def test_lexeme_and_perceptual_losses_are_mean_squares_by_hand() -> None:
    """RG Eq. 11 and 13 with an encoder that takes the first two numbers of a block."""
    def first_two(motion: torch.Tensor) -> torch.Tensor:
        return motion.flatten(1)[:, :2]

    made = torch.tensor([[[1.0, 3.0, 9.0]], [[0.0, -2.0, 9.0]]])
    true = torch.tensor([[[4.0, 3.0, 0.0]], [[0.0, 2.0, 0.0]]])
    assert float(losses.perceptual(made, true, first_two)) == pytest.approx((9 + 0 + 0 + 16) / 4)
    wanted = torch.tensor([[1.0, 1.0], [3.0, 0.0]])
    assert float(losses.lexeme(made, wanted, first_two)) == pytest.approx((0 + 4 + 9 + 4) / 4)


@pytest.mark.parametrize(("mean", "deviation"), [(0.0, 2.0), (0.0, 0.1), (1.5, 1.0), (-0.7, 3.0)])
def test_style_divergence_is_that_of_torchs_normal_distributions(mean: float, deviation: float) -> None:
    torch.manual_seed(5)
    codes = mean + deviation * torch.randn(40, 6)
    own = torch.distributions.Normal(codes.mean(0), codes.std(0, unbiased=False))
    expected = torch.distributions.kl_divergence(own, torch.distributions.Normal(0.0, 1.0)).mean()
    torch.testing.assert_close(losses.style_divergence(codes, eps=0.0), expected, rtol=1e-4, atol=1e-5)


def test_roll_out_is_the_same_as_stepping_block_by_block() -> None:
    model, b = make().eval(), batch()
    style = model.styles(b["style"][:, 1:])
    made, _ = model.roll_out(b["motion"][:, 0], BlockInputs(b["audio"][:, 1:], b["lexeme"][:, 1:], style))
    past, state = b["motion"][:, 0], model.first_state(b["motion"][:, 0, -1], b["lexeme"][:, 1])
    for i in range(4):
        past, state, _ = model.step(past, model.encode_audio(b["audio"][:, i + 1]), b["lexeme"][:, i + 1], style[:, i],
                                    state)
        torch.testing.assert_close(past, made[:, i])
    silent = torch.zeros_like(b["audio"][:, 1:])
    without, _ = model.roll_out(b["motion"][:, 0], BlockInputs(silent, b["lexeme"][:, 1:], style))
    assert (without - made).abs().amax((0, 2, 3)).min() > 1e-4, "it hears in every block"


def test_a_block_follows_the_truth_where_it_is_given_and_else_what_was_made() -> None:
    model, b = make().eval(), batch()
    style, other = model.styles(b["style"][:, 1:]), b["motion"][:, 1:].clone()
    other[:, 0] += 5.0

    def run(truth: torch.Tensor | None) -> torch.Tensor:
        given = BlockInputs(b["audio"][:, 1:], b["lexeme"][:, 1:], style)
        return model.roll_out(b["motion"][:, 0], given, truth)[0]

    true, wrong, own = run(b["motion"][:, 1:]), run(other), run(None)
    assert torch.equal(true[:, 0], wrong[:, 0]) and torch.equal(true[:, 0], own[:, 0]), "the first has the seed"
    assert not torch.equal(true[:, 1], wrong[:, 1])
    torch.testing.assert_close(run(own), own, msg="its own blocks as the truth are its own past")


def test_the_loss_is_the_papers_four_terms_and_training_takes_the_true_past() -> None:
    """RG Eq. 9: nothing else has a weight, and nothing that a block made changes what the next one begins from."""
    model, b = make().eval(), batch()
    assert model.weights == {"reconstruction": 1.0, "perceptual": 0.5, "lexeme": 0.2, "style": 1.0}
    found = model.losses(b, 1.0, encoder)
    assert set(found) == set(model.weights)
    style = model.styles(b["style"][:, 1:])
    state, error = model.first_state(b["motion"][:, 0, -1], b["lexeme"][:, 1]), []
    for i in range(4):
        made, state, _ = model.step(b["motion"][:, i], model.encode_audio(b["audio"][:, i + 1]),
                                    b["lexeme"][:, i + 1], style[:, i], state)
        error.append((made - b["motion"][:, i + 1]).pow(2))
    torch.testing.assert_close(found["reconstruction"], torch.stack(error).mean())


def test_blocks_that_are_not_valid_and_joints_that_are_absent_do_not_count() -> None:
    model = make().eval()
    b = batch()
    b["valid"][:, 3:] = 0
    b["mask"][:, 2] = 0
    other = {key: value.clone() for key, value in b.items()}
    other["motion"][:, 4] += 3.0
    first, second = model.losses(b, 1.0, encoder), model.losses(other, 1.0, encoder)
    assert torch.isclose(first["reconstruction"], second["reconstruction"])


def run(model: Generator, b: dict[str, torch.Tensor], control: torch.Tensor | None) -> torch.Tensor:
    zero = torch.zeros(len(b["style"]), b["style"].shape[1] - 1, model.config.style_width)
    return model.roll_out(b["motion"][:, 0], BlockInputs(b["audio"][:, 1:], b["lexeme"][:, 1:], zero, control))[0]


def test_what_is_asked_is_heard_from_its_block_on_and_nothing_asked_is_zeros() -> None:
    model, b = make(use_control=True).eval(), batch()
    asked = torch.zeros(3, 4, FRAMES, CONTROL)
    free = run(model, b, None)
    assert torch.equal(free, run(model, b, asked))
    asked[:, 2] = 2.0
    told = run(model, b, asked)
    assert torch.equal(free[:, :2], told[:, :2]) and not torch.equal(free[:, 2], told[:, 2])
    with torch.no_grad():
        model.mlp[0].weight[:, -CONTROL:].zero_()
    assert torch.equal(run(model, b, None), run(model, b, asked)), "it enters through those weights alone"


def test_dimensions_that_no_source_has_stay_at_zero() -> None:
    present = torch.tensor([1.0, 0.0, 1.0, 1.0, 0.0])
    model, b = make(present=present).eval(), batch()
    assert b["motion"][:, 0, :, 1].abs().min() > 0, "even after a pose that has them"
    made = run(model, b, None)
    assert (made[..., [1, 4]] == 0).all() and (made[..., [0, 2, 3]] != 0).all()
    assert torch.equal(model.styles(torch.tensor([1, 2])), make().styles(torch.tensor([1, 2]))), "codes as before"
    assert model.state_dict().keys() == make().state_dict().keys(), "the data say it, not the weights"


def test_the_last_pose_fades_out_over_the_block() -> None:
    model = make().eval()
    with torch.no_grad():
        model.to_motion.weight.zero_()
        model.to_motion.bias.zero_()
    past = torch.randn(2, FRAMES, WIDTH)
    made, _, _ = model.step(past, torch.zeros(2, FRAMES, 6), torch.zeros(2, LEXEME), torch.zeros(2, 4),
                            model.first_state(past[:, -1], torch.zeros(2, LEXEME)))
    share = torch.tensor([5, 4, 3, 2, 1, 0]) / 6
    torch.testing.assert_close(made, share[:, None] * past[:, -1:])
