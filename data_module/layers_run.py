"""Layers of the runners: those of `data_module.layers` and torch in evaluation, on NumPy arrays in single precision.

A runner stands in the file beside its torch module (`x.py`, `x_run.py`). Its constructor takes every weight from
`Tensors` by the name that the module gave it, with its shape; `start` and `step` then are those of the module.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import accumulate, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError

__all__ = ["BlockDense", "Conv", "Convolutions", "Dense", "Floats", "Gru", "Lstm", "Norm", "Tensors", "attention",
           "gelu", "leaky_relu", "log_softmax", "normed", "side_by_side", "sigmoid", "softmax"]

Floats = NDArray[np.float32]

SLOPE = 0.2
"""Negative slope of every leaky ReLU."""
EPSILON = 1e-5
"""Added to a variance before its root is divided by, as in torch."""
# Columns of a product: NumPy's BLAS copies no weight for blocks of this width, and takes a third to a half of the time.
_COLUMNS = 32
# More rows are multiplied in one product, which then is the faster one.
_FEW_ROWS = 64


class Tensors:
    """The tensors of a part by name, each taken once and with its shape."""

    def __init__(self, arrays: Mapping[str, NDArray[Any]], source: object = "the weights") -> None:
        """source: where they are from, for the messages."""
        self._arrays, self._source, self._prefix = dict(arrays), source, ""

    def within(self, prefix: str) -> Tensors:
        """The tensors whose names begin with `prefix` and a dot, under the rest of their names. They count as taken
        here as well."""
        inner = Tensors({}, self._source)
        # One dictionary for all: whatever is taken anywhere is gone everywhere.
        inner._arrays, inner._prefix = self._arrays, f"{self._prefix}{prefix}."
        return inner

    def take(self, name: str, *shape: int) -> Floats:
        """The tensor of that name in single precision; InputError if there is none of this shape (any more)."""
        array = self._arrays.pop(self._prefix + name, None)
        if array is None or array.shape != shape:
            shape_here = "absent" if array is None else array.shape
            raise self._refused(self._prefix + name, f"{shape_here} instead of {shape}")
        return np.asarray(array, np.float32, order="C")

    def dense(self, name: str, width_in: int, width: int, bias: bool = True) -> Dense:
        """From the tensors `name.weight` [width, width_in] and `name.bias` [width]."""
        return Dense(self.take(f"{name}.weight", width, width_in), self.take(f"{name}.bias", width) if bias else None)

    def drop(self, *prefixes: str) -> None:
        """Leave out what only training uses: the tensors whose names begin with one of the prefixes."""
        starts = tuple(self._prefix + prefix for prefix in prefixes)
        for name in [name for name in self._arrays if name.startswith(starts)]:
            del self._arrays[name]

    def finish(self) -> None:
        """InputError if a tensor is left over: weights of other settings."""
        for name in sorted(self._arrays)[:1]:
            raise self._refused(name, f"{self._arrays[name].shape} instead of absent")

    def _refused(self, name: str, problem: str) -> InputError:
        return InputError(self._source, f"does not fit the settings ({name[:80]}: {problem})", "train it again")


class Dense:
    """x W^T + b."""

    def __init__(self, weight: Floats, bias: Floats | None = None) -> None:
        """weight: [N, K]; bias: [N]."""
        self.width, depth = weight.shape
        self._bias = bias
        self._whole = np.ascontiguousarray(weight.T)
        # Blocks of columns, each contiguous.
        padded = np.pad(weight, ((0, -self.width % _COLUMNS), (0, 0)))
        self._blocks = np.ascontiguousarray(padded.reshape(-1, _COLUMNS, depth).transpose(0, 2, 1))

    def __call__(self, x: Floats) -> Floats:
        """[..., K] to [..., N]."""
        rows = x.reshape(-1, x.shape[-1])
        if len(rows) > _FEW_ROWS:
            out = rows @ self._whole
        else:
            out = np.empty((len(rows), len(self._blocks), _COLUMNS), np.float32)
            np.matmul(rows, self._blocks, out=out.transpose(1, 0, 2))
            out = out.reshape(len(rows), -1)[:, :self.width]
        if self._bias is not None:
            out += self._bias
        return out.reshape(*x.shape[:-1], self.width)


class Conv:
    """A 1-D convolution over rows in time: torch's Conv1d with time before channels."""

    def __init__(self, weight: Floats, bias: Floats | None = None, *, stride: int = 1, padding: int = 0,
                 dilation: int = 1) -> None:
        """weight: [N, D, kernel]; padding: zero rows before and after."""
        self._stride, self._padding, self._dilation = stride, padding, dilation
        self._reach = (weight.shape[2] - 1) * dilation + 1
        self._map = Dense(weight.reshape(len(weight), -1), bias)

    def __call__(self, rows: Floats) -> Floats:
        """[..., T, D] to [..., T', N]."""
        *leading, count, width = rows.shape
        if self._padding:
            inside, count = rows, count + 2 * self._padding
            rows = np.zeros((*leading, count, width), np.float32)
            rows[..., self._padding:count - self._padding, :] = inside
        # [..., T', D, kernel]: a few slices take a third of the time of NumPy's view of windows.
        starts = range(0, self._reach, self._dilation)
        last = count - self._reach + 1
        windows = np.stack([rows[..., start:start + last:self._stride, :] for start in starts], -1)
        return self._map(windows.reshape(*windows.shape[:-2], -1))


class Convolutions:
    """`data_module.layers.convolutions` over rows: the same length, batch normalisation folded into the weights."""

    def __init__(self, tensors: Tensors, widths: Sequence[int], kernel: int = 3, *, norm: bool = True,
                 last_linear: bool = False) -> None:
        """Arguments as of `convolutions`."""
        self._layers, self._last_linear, number = [], last_linear, 0
        for index, (width_in, width) in enumerate(pairwise(widths)):
            at = tensors.within(str(number))
            weight, bias = at.take("weight", width, width_in, kernel), at.take("bias", width)
            ends = last_linear and index == len(widths) - 2
            if norm and not ends:
                scale, shift = _batch_norm(tensors.within(str(number + 1)), width)
                weight, bias = weight * scale[:, None, None], bias * scale + shift
            self._layers.append(Conv(weight, bias, padding=kernel // 2))
            # The convolution, its normalisation and its activation have a number each.
            number += 3 if norm else 2

    def __call__(self, rows: Floats) -> Floats:
        """[..., T, widths[0]] to [..., T, widths[-1]]."""
        for index, layer in enumerate(self._layers):
            rows = layer(rows)
            if not (self._last_linear and index == len(self._layers) - 1):
                rows = leaky_relu(rows)
        return rows


def _batch_norm(tensors: Tensors, width: int) -> tuple[Floats, Floats]:
    """Scale and shift of a batch normalisation in evaluation."""
    weight, bias, mean, variance = (tensors.take(name, width)
                                    for name in ("weight", "bias", "running_mean", "running_var"))
    tensors.take("num_batches_tracked")
    scale = weight / np.sqrt(variance + np.float32(EPSILON))
    return scale, bias - mean * scale


class Norm:
    """Layer normalisation over the last `axes` axes, with a weight and a bias for each of the last one's D numbers.
    Over two axes, of rows [..., T, D], it is torch's GroupNorm of one group."""

    def __init__(self, tensors: Tensors, width: int, *, axes: int = 1, epsilon: float = EPSILON) -> None:
        self._weight, self._bias = tensors.take("weight", width), tensors.take("bias", width)
        self._axes, self._epsilon = axes, epsilon

    def __call__(self, x: Floats) -> Floats:
        """[..., D] to [..., D]."""
        return normed(x, self._axes, self._epsilon) * self._weight + self._bias


class Lstm:
    """Layers of an LSTM over rows [B, T, W]."""

    def __init__(self, tensors: Tensors, width_in: int, width: int, layers: int = 1) -> None:
        self._width = width
        self._layers = [_recurrent(tensors, layer, width if layer else width_in, 4 * width, width)
                        for layer in range(layers)]

    def __call__(self, rows: Floats, hidden: tuple[Floats, Floats] | None = None
                 ) -> tuple[Floats, tuple[Floats, Floats]]:
        """[B, T, width] and the state after them, h and c [layers, B, width]; a zero state without one."""
        zero = np.zeros((len(self._layers), len(rows), self._width), np.float32)
        ends, width = [], self._width
        for (into, again), h, c in zip(self._layers, *(hidden or (zero, zero)), strict=True):
            inputs = into(rows)
            rows = np.empty((*inputs.shape[:2], self._width), np.float32)
            for time in range(inputs.shape[1]):
                # The order of the gates in the weights: input, forget, cell, output.
                gates = inputs[:, time] + again(h)
                opened, new = sigmoid(gates), gates[:, 2 * width:3 * width]
                c = opened[:, width:2 * width] * c + opened[:, :width] * np.tanh(new)
                rows[:, time] = h = opened[:, 3 * width:] * np.tanh(c)
            ends.append((h, c))
        return rows, (np.array([h for h, _ in ends]), np.array([c for _, c in ends]))


class Gru:
    """A GRU of one layer over rows [B, T, W]."""

    def __init__(self, tensors: Tensors, width_in: int, width: int) -> None:
        self._width = width
        self._into, self._again = _recurrent(tensors, 0, width_in, 3 * width, width)

    def __call__(self, rows: Floats, hidden: Floats | None = None) -> tuple[Floats, Floats]:
        """[B, T, width] and the state after them [B, width]; a zero state without one."""
        h = np.zeros((len(rows), self._width), np.float32) if hidden is None else hidden
        inputs = self._into(rows)
        out = np.empty((*inputs.shape[:2], self._width), np.float32)
        for time in range(inputs.shape[1]):
            # The order of the gates in the weights: reset, update, new.
            into, again, both = inputs[:, time], self._again(h), 2 * self._width
            opened = sigmoid(into[:, :both] + again[:, :both])
            reset, update = opened[:, :self._width], opened[:, self._width:]
            out[:, time] = h = (1 - update) * np.tanh(into[:, both:] + reset * again[:, both:]) + update * h
        return out, h


def _recurrent(tensors: Tensors, layer: int, width_in: int, gates: int, width: int) -> tuple[Dense, Dense]:
    """The maps of a recurrent layer from its inputs and from its state to its gates."""
    into, again = (Dense(tensors.take(f"weight_{kind}_l{layer}", gates, depth),
                         tensors.take(f"bias_{kind}_l{layer}", gates))
                   for kind, depth in (("ih", width_in), ("hh", width)))
    return into, again


class BlockDense:
    """`data_module.layers.BlockLinear`: from the rows of three blocks (or of the middle one) to K rows."""

    def __init__(self, tensors: Tensors, frames: int, width_in: int, width: int, *, blocks: int = 3,
                 bottleneck: int = 0) -> None:
        """Arguments as of `BlockLinear`."""
        self._frames, self._width, self._blocks = frames, width, blocks
        self._narrow = tensors.dense("narrow", width_in, bottleneck) if bottleneck else None
        self._linear = tensors.dense("linear", blocks * frames * (bottleneck or width_in), frames * width)

    def __call__(self, windows: Floats) -> Floats:
        """[..., 3K, D] to [..., K, width]."""
        if self._blocks == 1:
            windows = windows[..., self._frames:2 * self._frames, :]
        if self._narrow is not None:
            windows = self._narrow(windows)
        return self._linear(windows.reshape(*windows.shape[:-2], -1)).reshape(*windows.shape[:-2], self._frames,
                                                                              self._width)


def attention(query: Floats, key: Floats, value: Floats, heads: int, mask: Floats | None = None) -> Floats:
    """softmax(Q K^T / sqrt(C / heads) + M) V [n, C], heads side by side, of queries [n, C], keys and values [m, C] and
    the mask [n, m] (RACER Eq. 12)."""
    query, key, value = (rows.reshape(len(rows), heads, -1).swapaxes(0, 1) for rows in (query, key, value))
    scores = query @ key.swapaxes(1, 2) / np.float32(math.sqrt(query.shape[-1]))
    attended = softmax(scores if mask is None else scores + mask) @ value
    return attended.swapaxes(0, 1).reshape(attended.shape[1], -1)


def side_by_side(parts: Sequence[Floats]) -> Floats:
    """Concatenate parts [..., D], whose leading axes broadcast, to [..., sum D]."""
    ends = [0, *accumulate(part.shape[-1] for part in parts)]
    out = np.empty((*np.broadcast_shapes(*(part.shape[:-1] for part in parts)), ends[-1]), np.float32)
    # Written in place: `numpy.broadcast_to` takes longer than the copy.
    for part, first, last in zip(parts, ends[:-1], ends[1:], strict=True):
        out[..., first:last] = part
    return out


def normed(x: Floats, axes: int = 1, epsilon: float = EPSILON) -> Floats:
    """(x - mean) / sqrt(variance + epsilon) over the last `axes` axes."""
    over, count = tuple(range(-axes, 0)), np.float32(math.prod(x.shape[-axes:]))
    # A sum over a count is what `numpy.mean` gives, in half of its time.
    centred: Floats = np.subtract(x, np.divide(np.add.reduce(x, over, keepdims=True), count, dtype=np.float32))
    variance: Floats = np.divide(np.add.reduce(np.square(centred), over, keepdims=True), count, dtype=np.float32)
    return centred / np.sqrt(variance + np.float32(epsilon))


def sigmoid(x: Floats) -> Floats:
    """1 / (1 + exp(-x))."""
    # As a tanh, which cannot overflow.
    return np.float32(0.5) * np.tanh(np.float32(0.5) * x) + np.float32(0.5)


def leaky_relu(x: Floats) -> Floats:
    """x, and `SLOPE` x where it is negative."""
    return np.maximum(x, np.float32(SLOPE) * x)


def log_softmax(x: Floats) -> Floats:
    """log(exp(x) / sum exp(x)) over the last axis."""
    below = x - x.max(-1, keepdims=True)
    return below - np.log(np.exp(below).sum(-1, keepdims=True))


def softmax(x: Floats) -> Floats:
    """exp(x) / sum exp(x) over the last axis."""
    weights = np.exp(x - x.max(-1, keepdims=True))
    return weights / weights.sum(-1, keepdims=True)


# Of erf (Abramowitz and Stegun 7.1.26, error at most 1.5e-7): it saves a third of a second, which the import of scipy's
# takes.
_P = np.float32(0.3275911)
_A = tuple(map(np.float32, (1.061405429, -1.453152027, 1.421413741, -0.284496736, 0.254829592)))


def gelu(x: Floats) -> Floats:
    """x (1 + erf(x / sqrt 2)) / 2."""
    # In place, because rows of samples fill no cache: half the time of the same in new arrays.
    root = np.float32(math.sqrt(0.5))
    size = np.abs(x) * root
    t = size * _P
    t += 1
    np.reciprocal(t, out=t)
    polynomial = t * _A[0]
    for coefficient in _A[1:]:
        polynomial += coefficient
        polynomial *= t
    # x Phi(x) = max(x, 0) - |x| (1 - erf(|x| / sqrt 2)) / 2, on either side of 0.
    polynomial *= root * size
    polynomial *= np.exp(-size * size)
    return np.maximum(x, 0) - polynomial
