"""The layers that models share."""

from __future__ import annotations

import pytest
import torch

from data_module.layers import run_lstm


@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.parametrize("begun", [False, True])
def test_an_lstm_run_row_by_row_gives_what_the_module_gives(count: int, begun: bool) -> None:
    torch.manual_seed(count)
    lstm = torch.nn.LSTM(7, 5, count, batch_first=True).eval()
    rows = torch.randn(2, 6, 7)
    hidden = (torch.randn(count, 2, 5), torch.randn(count, 2, 5)) if begun else None
    with torch.no_grad():
        wanted, (h, c) = lstm(rows, hidden)
        found, state = run_lstm(lstm, rows, hidden)
    for one, other in ((found, wanted), (state[0], h), (state[1], c)):
        torch.testing.assert_close(one, other, atol=1e-6, rtol=1e-5)


def test_an_lstm_that_is_trained_keeps_its_gradient_and_its_dropout() -> None:
    lstm = torch.nn.LSTM(7, 5, 2, batch_first=True, dropout=0.5)
    run_lstm(lstm, torch.randn(2, 6, 7))[0].sum().backward()
    assert all(weight.grad is not None and weight.grad.abs().sum() > 0 for weight in lstm.parameters())
    with torch.no_grad():
        rows = torch.randn(1, 4, 7)
        assert not torch.equal(run_lstm(lstm, rows)[0], run_lstm(lstm, rows)[0])
