"""The layers that models share."""

from __future__ import annotations

import pytest
import torch

from data_module import layers
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


@pytest.mark.parametrize("begun", [False, True])
def test_a_processor_without_an_lstm_in_half_precision_takes_single(begun: bool, monkeypatch: pytest.MonkeyPatch
                                                                    ) -> None:
    torch.manual_seed(0)
    lstm, rows = torch.nn.LSTM(7, 5, batch_first=True), torch.randn(20, 6, 7)
    hidden = (torch.randn(1, 20, 5), torch.randn(1, 20, 5)) if begun else None
    wanted, (h, c) = lstm(rows, hidden)
    with torch.autocast("cpu", torch.bfloat16):
        here, _ = run_lstm(lstm, rows, hidden)
        monkeypatch.setattr(layers, "_has_narrow_lstm", lambda dtype: False)
        elsewhere, state = run_lstm(lstm, rows, hidden)
    torch.testing.assert_close(here.float(), wanted, atol=0.02, rtol=0)  # bfloat16 has 8 binary digits, sums fewer
    for one, other in ((elsewhere, wanted), (state[0], h), (state[1], c)):
        torch.testing.assert_close(one, other, atol=0, rtol=0)
    elsewhere.sum().backward()
    assert all(weight.grad is not None and weight.grad.dtype == torch.float32 for weight in lstm.parameters())
