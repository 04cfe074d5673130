"""The layers of the runners are those of torch in evaluation, for any sizes."""

from collections.abc import Callable

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from runners import tensors_of
from torch import nn

from data_module import layers_run as run
from data_module.errors import InputError
from data_module.layers import BlockLinear, convolutions

SIZE, COUNT, SEED = st.integers(1, 70), st.integers(1, 9), st.integers(0, 99)


def same(module: nn.Module, build: Callable[[run.Tensors], Callable[[run.Floats], run.Floats]], *shape: int) -> None:
    """The runner takes every tensor of the module and gives what it gives for rows of this shape."""
    tensors, x = tensors_of(module.eval()), torch.randn(*shape)
    runner = build(tensors)
    tensors.finish()
    with torch.no_grad():
        np.testing.assert_allclose(runner(x.numpy()), module(x).numpy(), atol=1e-4, rtol=1e-5)


class Transposed(nn.Module):
    """A module over [B, D, T], for rows [B, T, D]."""

    def __init__(self, inner: nn.Module) -> None:
        super().__init__()
        self.inner = inner

    def forward(self, rows: torch.Tensor) -> torch.Tensor:
        return self.inner(rows.transpose(1, 2)).transpose(1, 2)


@given(SIZE, SIZE, st.integers(1, 200), SEED, st.booleans())
def test_dense(width_in: int, width: int, rows: int, seed: int, bias: bool) -> None:
    torch.manual_seed(seed)
    same(nn.Sequential(nn.Linear(width_in, width, bias)), lambda at: at.dense("0", width_in, width, bias), rows,
         width_in)


@given(COUNT, COUNT, st.integers(1, 5), st.integers(1, 3), st.integers(0, 2), st.integers(1, 2), SEED)
def test_a_convolution(width_in: int, width: int, kernel: int, stride: int, padding: int, dilation: int, seed: int
                       ) -> None:
    torch.manual_seed(seed)
    same(Transposed(nn.Conv1d(width_in, width, kernel, stride, padding, dilation)),
         lambda at: run.Conv(at.take("inner.weight", width, width_in, kernel), at.take("inner.bias", width),
                             stride=stride, padding=padding, dilation=dilation), 2, 11, width_in)


@given(st.lists(COUNT, min_size=2, max_size=4), st.sampled_from((1, 3, 5)), st.booleans(), st.booleans(), SEED)
def test_convolutions(widths: list[int], kernel: int, norm: bool, last_linear: bool, seed: int) -> None:
    torch.manual_seed(seed)
    module = convolutions(widths, kernel, norm=norm, last_linear=last_linear)
    for layer in module:
        if isinstance(layer, nn.BatchNorm1d):
            layer.load_state_dict(layer.state_dict() | {"running_mean": torch.randn(layer.num_features),
                                                        "running_var": 0.1 + 3 * torch.rand(layer.num_features)})
    same(Transposed(module), lambda at: run.Convolutions(at.within("inner"), widths, kernel, norm=norm,
                                                         last_linear=last_linear), 2, 7, widths[0])


@given(SIZE, st.integers(1, 12), SEED)
def test_norms(width: int, rows: int, seed: int) -> None:
    torch.manual_seed(seed)
    layer, group = nn.LayerNorm(width), Transposed(nn.GroupNorm(1, width))
    for parameter in (*layer.parameters(), *group.parameters()):
        nn.init.normal_(parameter)
    same(layer, lambda at: run.Norm(at, width), 3, rows + 1, width)
    same(group, lambda at: run.Norm(at.within("inner"), width, axes=2), 3, rows + 1, width)


@given(SIZE, SIZE, st.integers(1, 3), st.integers(1, 3), SEED)
def test_recurrent_layers_over_thirty_rows_and_on_from_their_state(width_in: int, width: int, layers: int, batch: int,
                                                                   seed: int) -> None:
    torch.manual_seed(seed)
    lstm, gru = nn.LSTM(width_in, width, layers, batch_first=True), nn.GRU(width_in, width, batch_first=True)
    rows = torch.randn(batch, 30, width_in)
    with torch.no_grad():
        (wanted, (h, c)), (wanted_gru, end) = lstm(rows), gru(rows)
    runner, gru_runner = run.Lstm(tensors_of(lstm), width_in, width, layers), run.Gru(tensors_of(gru), width_in, width)
    first, later = rows[:, :13].numpy(), rows[:, 13:].numpy()
    out, state = runner(later, runner(first)[1])
    out_gru, gru_state = gru_runner(later, gru_runner(first)[1])
    for found, true in ((out, wanted[:, 13:]), (state[0], h), (state[1], c), (out_gru, wanted_gru[:, 13:]),
                        (gru_state, end[0])):
        np.testing.assert_allclose(found, true.numpy(), atol=1e-4)


@given(COUNT, COUNT, COUNT, st.sampled_from((1, 3)), st.integers(0, 5), SEED)
def test_a_map_of_three_blocks(frames: int, width_in: int, width: int, blocks: int, bottleneck: int, seed: int) -> None:
    torch.manual_seed(seed)
    same(BlockLinear(frames, width_in, width, blocks, bottleneck),
         lambda at: run.BlockDense(at, frames, width_in, width, blocks=blocks, bottleneck=bottleneck),
         2, 4, 3 * frames, width_in)


def test_activations_over_the_whole_range() -> None:
    # Where exp overflows, too.
    x = torch.cat([torch.linspace(-12, 12, 4801), torch.tensor([-3e4, -200.0, 200.0, 3e4])])
    for found, wanted in ((run.gelu, nn.functional.gelu), (run.sigmoid, torch.sigmoid),
                          (run.leaky_relu, lambda rows: nn.functional.leaky_relu(rows, run.SLOPE)),
                          (run.softmax, lambda rows: rows.softmax(-1)),
                          (run.log_softmax, lambda rows: rows.log_softmax(-1))):
        with np.errstate(over="raise", invalid="raise", divide="ignore"):
            np.testing.assert_allclose(found(x.numpy()), wanted(x).numpy(), atol=2e-6, rtol=1e-6)


def test_tensors_are_taken_once_by_name_and_shape() -> None:
    arrays: dict[str, NDArray[np.floating]] = {"a.weight": np.ones((2, 3), np.float16), "a.bias": np.ones(2),
                                               "b": np.array(4.0)}
    tensors = run.Tensors(arrays, "file")
    for name, shape, problem in (("weight", (3, 2), "(2, 3) instead of (3, 2)"), ("none", (1,), "absent instead of")):
        with pytest.raises(InputError, match="file: does not fit the settings") as refused:
            run.Tensors(arrays, "file").within("a").take(name, *shape)
        assert f"(a.{name}: {problem}" in str(refused.value)
    weight = tensors.within("a").take("weight", 2, 3)
    assert weight.dtype == np.float32 and tensors.take("b").shape == ()
    with pytest.raises(InputError, match=r"a.weight: absent"):
        tensors.take("a.weight", 2, 3)
    with pytest.raises(InputError, match=r"a.bias: \(2,\) instead of absent"):
        tensors.finish()
    tensors.take("a.bias", 2)
    tensors.finish()
