"""Products of few rows: those of double precision, and of the weights as they are now."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor, nn

from data_module.layers import Linear, Product, few

SIZES = st.integers(1, 200)


def exactly(rows: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
    made = rows.double() @ weight.double().T
    return made if bias is None else made + bias.double()


@given(rows=st.integers(1, 20), depth=SIZES, width=SIZES, seed=st.integers(0, 99), biased=st.booleans())
def test_products_are_those_of_double_precision(rows: int, depth: int, width: int, seed: int, biased: bool) -> None:
    generator = torch.Generator().manual_seed(seed)
    x, weight, bias = (torch.randn(*shape, generator=generator)
                       for shape in ((rows, depth), (width, depth), (width,)))
    made = Product(weight, bias if biased else None)(x)
    torch.testing.assert_close(made.double(), exactly(x, weight, bias if biased else None), atol=1e-4, rtol=1e-5)
    columns = torch.randn(depth, rows, generator=generator).T  # not contiguous
    torch.testing.assert_close(Product(weight)(columns).double(), exactly(columns, weight, None), atol=1e-4, rtol=1e-5)


@pytest.mark.parametrize("shape", [(256,), (3, 256), (2, 3, 256), (1000, 256)])
def test_a_layer_is_that_of_torch(shape: tuple[int, ...]) -> None:
    torch.manual_seed(0)
    ours, theirs = Linear(256, 200), nn.Linear(256, 200)
    theirs.load_state_dict(ours.state_dict())
    x = torch.randn(*shape)
    with torch.no_grad():
        assert few(x) is (shape != (1000, 256))
        torch.testing.assert_close(ours(x), theirs(x), atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(ours(x), theirs(x))
    ours(x).sum().backward()
    assert ours.weight.grad is not None, "a gradient needs torch's own product"
