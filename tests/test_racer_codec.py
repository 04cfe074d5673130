"""RACER's codec: the published layer table, the equations by hand, and the invariants of any codebook."""

import copy

import numpy as np
import pytest
import torch
from runners import tensors_of
from torch import Tensor, nn

from lexicon.racer import FRAMES, RacerCodec, RacerConfig
from lexicon.racer_run import CodecRunner

WIDTH_M = 6


def small(seed: int = 0, present: Tensor | None = None, **changes: object) -> RacerCodec:
    torch.manual_seed(seed)
    return RacerCodec(RacerConfig(**{"width": 16, "size": 12, **changes}), WIDTH_M, present)  # type: ignore[arg-type]


def moving(count: int, frames: int = 120, seed: int = 1) -> Tensor:
    """Swings of several speeds, [count, frames, 6]."""
    rng = torch.Generator().manual_seed(seed)
    rate, phase = 0.2 + torch.rand(2, count, 1, WIDTH_M, generator=rng)
    return torch.sin(rate * torch.arange(frames)[:, None] + 6 * phase)


def described(layers: nn.Module) -> list[tuple[object, ...]]:
    """Every convolution, in order, as the published table writes it."""
    return [(type(layer).__name__, layer.in_channels, layer.out_channels, layer.kernel_size[0], layer.stride[0],
             layer.padding[0], layer.dilation[0])
            for layer in layers.modules() if isinstance(layer, (nn.Conv1d, nn.ConvTranspose1d))]


def test_the_layers_are_those_of_the_published_table() -> None:
    with torch.device("meta"):
        codec = RacerCodec(RacerConfig(), motion_width=48)
    point = ("Conv1d", 512, 512, 1, 1, 0, 1)
    one, three, nine = ([("Conv1d", 512, 512, 3, 1, d, d), point] for d in (1, 3, 9))
    first, down = ("Conv1d", 48, 512, 4, 2, 1, 1), ("Conv1d", 512, 512, 4, 2, 1, 1)
    up, last = ("ConvTranspose1d", 512, 512, 4, 2, 1, 1), ("ConvTranspose1d", 512, 48, 4, 2, 1, 1)
    same = ("Conv1d", 512, 512, 3, 1, 1, 1)
    forth, back = [*one, *three, *nine], [*nine, *three, *one]
    assert described(codec.encoder) == [first, *forth, down, *forth, down, *forth, same]
    assert described(codec.decoder) == [same, *back, up, *back, up, *back, last]


@pytest.mark.parametrize("frames", [8, 120, 248])
def test_any_multiple_of_eight_frames_gives_a_code_for_each_eight(frames: int) -> None:
    codec = small()
    motion = moving(3, frames)
    labels = codec.label(motion)
    assert labels.shape == (3, frames // FRAMES) and labels.dtype == torch.int64
    decoded = codec.decode_tokens(labels)
    assert decoded.shape == (3, frames // FRAMES, FRAMES, WIDTH_M)
    assert torch.equal(decoded.flatten(1, 2), codec.decode(codec.vectors[labels]))


def wide_open() -> RacerCodec:
    """A codec whose weights are all positive: no ReLU closes, so whatever can be reached is reached."""
    codec = small(width=2).double()
    with torch.no_grad():
        for parameter in codec.parameters():
            parameter.fill_(0.1)
    return codec


def test_a_code_sees_as_far_as_the_table_lets_it_and_no_farther() -> None:
    codec, token = wide_open(), 60
    motion = torch.ones(1, 1000, WIDTH_M, dtype=torch.float64, requires_grad=True)
    codec.encode(motion)[0, token].sum().backward()
    assert motion.grad is not None
    reached = motion.grad[0].abs().sum(1).nonzero().flatten()
    # Outwards from the code: +-1 of the last layer, then three times +-13 of the blocks and 2n - 1 to 2n + 2.
    assert (int(reached[0]), int(reached[-1])) == (8 * token - 197, 8 * token + 204)
    assert len(reached) == 402


def test_losses_are_the_equations_by_hand() -> None:
    codec = small().eval()
    motion, mask = moving(4, 24), torch.ones(4, WIDTH_M)
    mask[:, 4:] = 0
    loss = codec.losses({"motion": motion, "mask": mask})
    latents = codec.encode(motion)
    chosen = codec.vectors[torch.cdist(latents, codec.vectors).argmin(-1)]
    made, true = codec.decode(chosen)[..., :4], motion[..., :4]

    def speed(x: Tensor) -> Tensor:
        return x[:, 1:] - x[:, :-1]

    assert torch.isclose(loss["reconstruction"], (made - true).abs().mean(), rtol=1e-5)
    assert torch.isclose(loss["velocity"], (speed(made) - speed(true)).abs().mean(), rtol=1e-5)
    assert torch.isclose(loss["acceleration"], (speed(speed(made)) - speed(speed(true))).abs().mean(), rtol=1e-5)
    assert torch.isclose(loss["commitment"], (latents - chosen).pow(2).mean(), rtol=1e-5)
    assert codec.weights == {"reconstruction": 1, "velocity": 1, "acceleration": 1, "commitment": 0.1}
    assert codec.weights.keys() == loss.keys()


def test_labels_do_not_depend_on_the_batch_size_or_the_mode() -> None:
    codec, motion = small(), moving(13)
    codec.start_codebook(motion, seed=0)
    whole = codec.train().label(motion)
    before = copy.deepcopy(codec.state_dict())
    for batch in (1, 4, 13):
        assert torch.equal(codec.eval().label(motion, batch=batch), whole)
    assert torch.equal(torch.cat([codec.label(one[None]) for one in motion]), whole)
    assert all(torch.equal(value, before[key]) for key, value in codec.state_dict().items()), "asking moves nothing"


def test_dimensions_that_no_source_has_are_decoded_to_zero_and_nothing_else_changes() -> None:
    present = torch.tensor([1.0, 1, 0, 1, 0, 1])
    whole, masked = small(), small(present=present)
    motion = moving(3, 40)
    tokens = whole.label(motion)
    assert torch.equal(masked.label(motion), tokens)
    assert torch.equal(masked.decode_tokens(tokens), whole.decode_tokens(tokens) * present)
    assert (whole.decode_tokens(tokens)[..., present == 0] != 0).any()
    assert "present" not in masked.state_dict()


def test_the_runner_decodes_codes_as_the_codec_does() -> None:
    torch.manual_seed(3)
    codec = RacerCodec(RacerConfig(width=12, size=9), WIDTH_M).eval()
    tensors = tensors_of(codec)
    runner, codes = CodecRunner(codec.config, codec.present.numpy(), tensors), [0, 3, 3, 8, 1]
    tensors.finish()
    wanted = codec.decode_tokens(torch.tensor([codes]))[0].numpy()
    np.testing.assert_allclose(runner.decode(codes), wanted, atol=1e-5)
