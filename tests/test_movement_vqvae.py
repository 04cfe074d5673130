"""The lexicon of movements as a VQ-VAE: its loss by hand, the straight-through gradient, planted movements, bundles."""

from pathlib import Path

import numpy as np
import torch
from test_movement import FRAMES, PARTS, WIDTH, planted
from untrained import MOVING, untrained

from gesticulator.bundle import bundle as bundles
from lexicon.movement import MovementVqVae
from lexicon.movement_vqvae import MovementLearner, fit
from lexicon.settings import LexiconConfig

SMALL = LexiconConfig(quantizer="vq-vae", size=4, levels=(8, 8), trunk_components=6, arm_components=6,
                      finger_components=6, code_width=5, hidden=16, warm_up=0.2, revive_below=0.05, commitment=0.5)
STEPS = 150


def fitted(**changes: object) -> MovementVqVae:
    """The basis and the first lexemes on planted movements, without training."""
    torch.manual_seed(0)
    model = MovementVqVae(LexiconConfig(**{**SMALL.__dict__, **changes}), FRAMES, PARTS)
    motion, past, _ = planted(400, 1)
    fit(model, (motion, past), torch.ones(400, WIDTH), 5)
    return model


def trained(**changes: object) -> MovementVqVae:
    """Trained on four planted movements."""
    model = fitted(**changes)
    learner = MovementLearner(model)
    motion, past, _ = planted(400, 1)
    y = model.basis.coefficients(motion, past)
    rng = torch.Generator().manual_seed(3)
    optimiser = torch.optim.Adam(learner.parameters(), 3e-3)
    for step in range(STEPS):
        if step == int(SMALL.warm_up * STEPS):
            learner.start_codebook(y, 0)
        rows = y[torch.randint(len(y), (64,), generator=rng)]
        terms = learner.losses({"coefficients": rows, "known": torch.ones_like(rows)}, step / STEPS)
        optimiser.zero_grad()
        sum(learner.weights[key] * term for key, term in terms.items()).backward()  # type: ignore[union-attr]
        optimiser.step()
    learner.eval().finish(y, past, 5)
    return model


def test_lexemes_are_the_planted_movements_and_are_decoded_to_them() -> None:
    model = trained()
    motion, past, which = planted(200, 2)
    labels = model.label(motion, past)
    pairs = {(int(a), int(b)) for a, b in zip(which, labels, strict=True)}
    assert len(pairs) == 4 and len({b for _, b in pairs}) == 4
    y = model.basis.coefficients(motion, past)
    assert float((model.added(labels) - y).pow(2).sum() / y.pow(2).sum()) < 0.05
    assert (model.ranks(motion, past, labels) == 0).all()
    errors = [float((model.quantised(y, levels) - y).pow(2).mean()) for levels in (0, 1, 2)]
    assert errors[0] > errors[1] > errors[2]


def test_it_tells_more_of_the_movement_than_the_encoder_that_it_started_from() -> None:
    """Narrow latents: a random projection loses movements that the learned one keeps."""
    motion, past, _ = planted(200, 2)
    before, after = fitted(code_width=2), trained(code_width=2)
    y = before.basis.coefficients(motion, past)
    lost = [float((model.added(model.nearest(y)) - y).pow(2).mean()) for model in (before, after)]
    assert lost[1] < 0.5 * lost[0]


def test_losses_are_the_equation_by_hand() -> None:
    model = fitted()
    learner = MovementLearner(model).eval()
    motion, past, _ = planted(30, 4)
    y = model.basis.coefficients(motion, past)
    known = torch.ones_like(y)
    known[:10, model.basis.slices()[2]] = 0
    learner.start_codebook(y, 0)
    weight = model.basis.weight
    terms = learner.losses({"coefficients": y, "known": known}, 1.0)
    latents = model.encoder(y * weight)
    code = learner.quantizer.vectors[torch.cdist(latents, learner.quantizer.vectors).argmin(1)]
    error = (model.decoder(code) - y * weight) * known
    torch.testing.assert_close(terms["reconstruction"], error.pow(2).sum(1).mean())
    torch.testing.assert_close(terms["commitment"], (latents - code).pow(2).sum(1).mean())
    early = learner.losses({"coefficients": y, "known": known}, 0.0)
    plain = (model.decoder(latents) - y * weight) * known
    torch.testing.assert_close(early["reconstruction"], plain.pow(2).sum(1).mean())
    assert early["commitment"] == 0


def test_a_bundle_keeps_it(tmp_path: Path) -> None:
    settings = ("lexicon.quantizer=vq-vae", "lexicon.code_width=9", "lexicon.hidden=12", "lexicon.size=16")
    made = untrained(*MOVING, *settings)
    assert isinstance(made.lexicon, MovementVqVae) and made.vectors.shape == (16, 9)
    bundles.save(made, tmp_path / "bundle", "a card")
    read = bundles.load(tmp_path / "bundle")
    assert isinstance(read.lexicon, MovementVqVae) and read.config == made.config
    y = torch.randn(50, made.lexicon.basis.width) / made.lexicon.basis.weight
    assert torch.equal(read.lexicon.nearest(y), made.lexicon.nearest(y))
    np.testing.assert_array_equal(read.lexicon.added(torch.arange(16)), made.lexicon.added(torch.arange(16)))
