"""The codebook and the VQ-VAE: invariants of quantisation, an independent oracle, and what a lexicon must do."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from learning import learn

from lexicon.autoencoder import Lexicon, LexiconConfig
from lexicon.inventory import count, nearest_silent, silent_lexemes
from lexicon.quantizer import Quantizer, perplexity


def small(**changes: object) -> Lexicon:
    torch.manual_seed(0)
    config = LexiconConfig(**{"size": 8, "code_width": 12, "widths": (8, 12, 12, 16), **changes})  # type: ignore[arg-type]
    return Lexicon(config, frames=10, motion_width=6)


def test_labels_agree_with_an_independent_library() -> None:
    oracle = pytest.importorskip("vector_quantize_pytorch")
    torch.manual_seed(2)
    ours, theirs = Quantizer(16, 5), oracle.VectorQuantize(dim=5, codebook_size=16)
    theirs._codebook.embed.copy_(ours.vectors[None])
    theirs.eval()
    latents = torch.randn(100, 5)
    quantised, labels, _ = theirs(latents[None])
    assert torch.equal(labels[0], ours.labels(latents))
    torch.testing.assert_close(quantised[0], ours.eval()(latents).codes)


@given(st.permutations(range(12)))
def test_labels_follow_the_blocks_through_any_shuffle(order: list[int]) -> None:
    lexicon = small().eval()
    motion = torch.randn(12, 10, 6, generator=torch.Generator().manual_seed(3))
    assert torch.equal(lexicon.label(motion)[list(order)], lexicon.label(motion[list(order)]))


def test_labels_do_not_depend_on_the_batch_size_or_the_mode() -> None:
    lexicon = small()
    lexicon.losses({"motion": torch.randn(64, 10, 6), "mask": torch.ones(64, 6)})  # moves the batch statistics
    motion = torch.randn(50, 10, 6)
    assert torch.equal(lexicon.train().label(motion, batch=7), lexicon.eval().label(motion, batch=50))


def test_straight_through_hands_the_decoders_gradient_to_the_encoder_unaltered() -> None:
    quantizer, latents = Quantizer(8, 4).eval(), torch.randn(6, 4, requires_grad=True)
    slope = torch.randn(6, 4)
    (quantizer(latents).codes * slope).sum().backward()
    torch.testing.assert_close(latents.grad, slope)


def test_commitment_draws_the_latents() -> None:
    """The gradient of mean |e - s|^2 with s held is 2 (e - s) / elements (RG Eq. 3)."""
    quantizer, latents = Quantizer(4, 3).eval(), torch.randn(20, 3, requires_grad=True)
    chosen = quantizer.vectors[quantizer.labels(latents)]
    drawn, = torch.autograd.grad(quantizer(latents).commitment, latents)
    torch.testing.assert_close(drawn, 2 * (latents.detach() - chosen) / latents.numel())


def test_ema_vectors_converge_to_the_means_of_their_clusters() -> None:
    torch.manual_seed(4)
    centres = torch.tensor([[5.0, 0.0], [-5.0, 0.0], [0.0, 5.0]])
    quantizer = Quantizer(3, 2, revive_below=0.0)
    quantizer.set_vectors(centres + 0.5)
    for _ in range(600):
        quantizer(centres[torch.randint(3, (300,))] + 0.1 * torch.randn(300, 2))
    torch.testing.assert_close(quantizer.vectors, centres, atol=0.05, rtol=0)


def test_dead_codes_come_back_to_life() -> None:
    torch.manual_seed(5)
    quantizer = Quantizer(6, 2)
    quantizer.set_vectors(torch.full((6, 2), 100.0) + torch.arange(6)[:, None])
    data = torch.randn(400, 2)
    for _ in range(400):
        quantizer(data)
    assert len(quantizer.eval().labels(data).unique()) == 6


def test_perplexity_is_exact_for_even_and_single_use() -> None:
    assert math.isclose(perplexity(torch.arange(8).repeat(3), 8), 8.0, rel_tol=1e-6)
    assert math.isclose(perplexity(torch.zeros(9, dtype=torch.long), 8), 1.0, rel_tol=1e-6)


def test_losses_are_the_equation_by_hand() -> None:
    lexicon = small().eval()
    motion, mask = torch.randn(5, 10, 6), torch.ones(5, 6)
    mask[:, 4:] = 0
    loss = lexicon.losses({"motion": motion, "mask": mask})
    latents = lexicon.encode(motion)
    chosen = lexicon.vectors[lexicon.quantizer.labels(latents)]
    error = lexicon.decode(chosen) - motion
    assert torch.isclose(loss["reconstruction"], error[..., :4].pow(2).mean(), rtol=1e-5)
    assert torch.isclose(loss["commitment"], (latents - chosen).pow(2).mean(), rtol=1e-5)


def test_a_lexicon_learns_to_tell_four_gestures_apart() -> None:
    lexicon = small(size=4, warm_up=0.3)
    shapes = torch.sin(torch.linspace(0, 3, 10)[None, :, None] * torch.arange(1, 5)[:, None, None]
                       + torch.linspace(0, 2, 6))
    rng = torch.Generator().manual_seed(6)

    def batch() -> tuple[torch.Tensor, torch.Tensor]:
        which = torch.randint(4, (64,), generator=rng)
        return shapes[which] + 0.05 * torch.randn(64, 10, 6, generator=rng), which

    def loss(step: int) -> torch.Tensor:
        if step == 45:
            lexicon.start_codebook(batch()[0], seed=0)
        terms = lexicon.losses({"motion": batch()[0], "mask": torch.ones(64, 6)}, step / 150)
        return sum((lexicon.weights[k] * v for k, v in terms.items()), torch.zeros(()))

    learn(lexicon, loss, 150, 3e-3)
    motion, which = batch()
    labels = lexicon.label(motion)
    assert len({(int(a), int(b)) for a, b in zip(which, labels, strict=True)}) == 4, "one lexeme for each gesture"
    error = (lexicon.decode(lexicon.vectors[labels]) - shapes[which]).pow(2).mean()
    assert error < 0.1 * shapes.var()


def test_dimensions_that_no_source_has_are_decoded_to_zero_and_nothing_else_changes() -> None:
    torch.manual_seed(0)
    config = LexiconConfig(size=8, code_width=12, widths=(8, 12, 12, 16))
    present = torch.tensor([1.0, 1, 0, 1, 0, 1])
    whole, masked = small().eval(), Lexicon(config, 10, 6, present).eval()
    masked.load_state_dict(whole.state_dict())
    codes = torch.randn(5, 12)
    assert torch.equal(masked.decode(codes), whole.decode(codes) * present)
    assert (whole.decode(codes)[..., present == 0] != 0).any()
    motion = torch.randn(5, 10, 6)
    assert torch.equal(masked.encode(motion), whole.encode(motion))


def test_inventory_counts_what_a_hand_counts() -> None:
    inventory = count([("a", np.array([0, 1, 0, 1, 2])), ("b", np.array([2, 2]))], size=3, smoothing=0.0)
    np.testing.assert_allclose(inventory.frequencies["a"], [0.4, 0.4, 0.2])
    np.testing.assert_allclose(inventory.frequencies["b"], [0, 0, 1])
    np.testing.assert_allclose(inventory.transitions[:2], [[0, 1, 0], [0.5, 0, 0.5]])
    np.testing.assert_allclose(inventory.transitions[2], [0, 0, 1])


def test_unseen_transitions_keep_a_finite_probability() -> None:
    transitions = count([("a", np.array([0, 0]))], size=4).transitions
    np.testing.assert_allclose(transitions.sum(1), 1)
    assert (transitions > 0).all()


def test_silent_lexemes_are_slow_and_belong_to_silence() -> None:
    labels = np.repeat([0, 1, 2, 3, 4], 20)
    silent = np.zeros(100, dtype=bool)
    silent[0:18] = True   # lexeme 0: slow and silent
    silent[20:23] = True  # lexeme 1: fast though sometimes silent
    speeds = np.array([0.01, 2.0, 0.02, 1.0, 1.5])  # lexeme 2 is slow and never silent
    assert silent_lexemes(speeds, labels, silent, slow_share=0.4).tolist() == [0]
    assert len(silent_lexemes(speeds, labels, np.zeros(100, dtype=bool))) == 1, "never empty"
    few = np.concatenate([[0.2, 0.1, 0.5], np.full(97, np.inf)])
    used = np.array([0, 1, 1, 2] * 25)
    assert silent_lexemes(few, used, used == 1).tolist() == [1], "of a hundred lexemes three are used"


def test_nearest_silent_is_itself_for_a_silent_lexeme() -> None:
    vectors = np.array([[0.0, 0], [10, 0], [1, 0], [9, 0]])
    assert nearest_silent(vectors, np.array([0, 1])).tolist() == [0, 1, 0, 1]
