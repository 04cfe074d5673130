"""A short training, for tests of what a model can learn."""

from collections.abc import Callable

import torch


def learn(model: torch.nn.Module, loss: Callable[[int], torch.Tensor], steps: int, rate: float = 1e-2) -> None:
    """Steps of Adam on `loss`, which is given the number of each; afterwards the model is as in use."""
    optimiser = torch.optim.Adam(model.parameters(), rate)
    for step in range(steps):
        optimiser.zero_grad()
        loss(step).backward()
        optimiser.step()
    model.eval()
