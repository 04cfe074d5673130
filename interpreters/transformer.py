"""The trunk of the Q-network: a transformer over two streams, audio and actions (RACER 4.3, Eq. 12).

The streams are concatenated in time, [U; A]: token j of the first is the audio u_{j+1} of the next decision, token j of
the second is the action a_j before it. Pre-norm layers with GELU and a feed-forward of four times the width.
"""

from collections.abc import Callable

import torch
from torch import Tensor, nn
from torch.nn import functional

INITIAL = 0.02
"""Standard deviation of every weight at the start, that of GPT-2."""


def two_stream_mask(steps: int, device: torch.device | None = None) -> Tensor:
    """The mask M of RACER Eq. 12, additive: [2 T', 2 T'], 0 where a token attends to another and -inf elsewhere. A
    lower triangular block of size T' = `steps` repeated 2 x 2: token j of either stream attends to tokens 0..j of both,
    so the action half at j depends on a_0..a_j and u_1..u_{j+1}, which is exactly the state s_{j+1}."""
    # Strictly above the diagonal: a token attends to the one at its own time in both streams, since u_{j+1} is known
    # when action j + 1 is decided.
    block = torch.full((steps, steps), -torch.inf, device=device).triu(1)
    return block.repeat(2, 2)


def sliding(tokens: Tensor, window: int, read: Callable[[Tensor], Tensor]) -> Tensor:
    """The result [B, M, X] of `read` at each step, over the step and at most `window - 1` steps before it.

    tokens: [B, 2, M, C] pairs without positions; read: [B', 2, T', C] to [B', T', X], causal, T' <= window. Steps past
    the first window are the last of their trailing window, as in a stream: dropping the oldest pair from the cache
    would give another result, since later tokens have attended to it. Memory grows with M x window.
    """
    batch, steps = tokens.shape[0], tokens.shape[2]
    # One causal reading serves all steps while no token has left the window.
    if steps <= window:
        return read(tokens)
    # Each window is read whole from its own first position, as `QNetwork.step` does once its window slides.
    every = tokens.unfold(2, window, 1).permute(0, 2, 1, 4, 3)  # [B, M - window + 1, 2, window, C]
    out = read(every.flatten(0, 1)).unflatten(0, (batch, -1))
    return torch.cat([out[:, 0], out[:, 1:, -1]], dim=1)


class Attention(nn.Module):
    """softmax(Q K^T / sqrt(C / heads) + M) V, heads side by side (RACER Eq. 12)."""

    def __init__(self, width: int, heads: int, dropout: float) -> None:
        super().__init__()
        if width % heads:
            raise ValueError(f"a width of {width} cannot be shared by {heads} heads")
        self.heads, self.dropout = heads, dropout
        self.project = nn.Linear(width, 3 * width)
        self.out = nn.Linear(width, width)

    def forward(self, x: Tensor, mask: Tensor | None) -> Tensor:
        """[B, tokens, C] to [B, tokens, C]."""
        query, key, value = (part.unflatten(-1, (self.heads, -1)).transpose(1, 2)
                             for part in self.project(x).chunk(3, dim=-1))
        # Dropout is an argument here, which `eval` does not switch off by itself.
        attended = functional.scaled_dot_product_attention(query, key, value, mask,
                                                       dropout_p=self.dropout if self.training else 0.0)
        out: Tensor = self.out(attended.transpose(1, 2).flatten(-2))
        return out


class Layer(nn.Module):
    """x + attention(norm(x)), then x + feed-forward(norm(x))."""

    def __init__(self, width: int, heads: int, dropout: float) -> None:
        super().__init__()
        # Norms stand before the sublayers (pre-norm), so the residual path carries the tokens unchanged.
        self.before_attention, self.before_feed = nn.LayerNorm(width), nn.LayerNorm(width)
        self.attention = Attention(width, heads, dropout)
        self.feed = nn.Sequential(nn.Linear(width, 4 * width), nn.GELU(), nn.Linear(4 * width, width))
        self.dropout = nn.Dropout(dropout)

    def forward(self, x: Tensor, mask: Tensor | None) -> Tensor:
        """[B, tokens, C] to [B, tokens, C]."""
        x = x + self.dropout(self.attention(self.before_attention(x), mask))
        out: Tensor = x + self.dropout(self.feed(self.before_feed(x)))
        return out


class Head(nn.Sequential):
    """The final norm and a linear layer, [..., C] to [..., size]."""

    def __init__(self, width: int, size: int) -> None:
        super().__init__(nn.LayerNorm(width), nn.Linear(width, size))


@torch.no_grad()
def begin_small(module: nn.Module) -> None:
    """Initialise linear layers and embeddings from N(0, 0.02), biases at zero; for `nn.Module.apply`."""
    # Norms keep their ones and zeros.
    if isinstance(module, nn.Linear | nn.Embedding):
        module.weight.normal_(0.0, INITIAL)
    if isinstance(module, nn.Linear):
        module.bias.zero_()
