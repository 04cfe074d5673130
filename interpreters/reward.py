"""The contrastive reward: how well a sequence of gestures matches the speech (RACER 4.2, Eq. 6 to 8).

Two encoders map a window of motion and a window of audio to one vector each; they are trained so that the vectors of a
real pair agree and those of mismatched pairs do not. Their cosine is the reward of reinforcement learning. A window is
a sequence of blocks in normalised time, so a token is one block.

The paper specifies only 1-D temporal convolutions. Here they are causal, so that windows with the same past share all
work except that of the last token, which makes the reward of every lexeme cheap (`interpreters.reward_table`).

Optimising a reward also exploits its errors. Evaluation must use a second model, trained with another seed on other
recordings than the one that trained the policy.
"""

from __future__ import annotations

import math
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from data_module.layers import masked_mean
from interpreters.settings import RewardConfig

TEMPERATURE, LEAST_TEMPERATURE = 0.07, 0.01
"""tau of RACER Eq. 7 before training, and its least value: below it a single pair of a batch would dominate the
gradient."""
DROPOUT = 0.1

__all__ = ["RewardEnsemble", "RewardModel", "contrast"]


def contrast(motion: Tensor, audio: Tensor, temperature: Tensor | float, group: Tensor,
             rivals: Tensor | None = None) -> Tensor:
    """InfoNCE in both directions, in nats (RACER Eq. 6 and 7), the mean over the batch.

    L = mean_i 1/2 [-log softmax_k(m_i . u_k / tau)_i - log softmax_k(u_i . m_k / tau)_i]

    rivals: [B, H] products u_i . m_ij / tau of the audio with wrong motion, additional negatives in the second softmax
    (-inf for none).

    motion, audio: [B, P] of unit length; row i of both is a pair. group: [B] rows of one group are never negatives of
    each other (see `similarities`). The paper sums the two directions; their mean has the same minimum and makes
    chance log B.
    """
    # Scaled before masking: the gradient of a temperature that divides -inf would be NaN.
    logits = similarities(motion / temperature, audio, group)
    pairs = torch.arange(len(logits), device=logits.device)
    by_audio = logits.T if rivals is None else torch.cat([logits.T, rivals], dim=1)
    return 0.5 * (functional.cross_entropy(logits, pairs) + functional.cross_entropy(by_audio, pairs))


def similarities(motion: Tensor, audio: Tensor, group: Tensor) -> Tensor:
    """Products m_i . u_k [B, B] of vectors [B, P] (cosines of unit vectors), -inf for two different rows of one group.
    Windows that overlap in time, and silent windows, match each other's audio, so they are excluded from the softmax of
    RACER Eq. 7."""
    same = group[:, None] == group[None, :]
    same.fill_diagonal_(False)
    return (motion @ audio.T).masked_fill(same, -math.inf)


class CausalLayer(nn.Module):
    """x + mix(gelu(convolution(norm(x)))), with a causal dilated convolution over tokens."""

    def __init__(self, width: int, kernel: int, dilation: int, dropout: float) -> None:
        super().__init__()
        self.kernel, self.dilation = kernel, dilation
        self.norm = nn.LayerNorm(width)
        self.convolve = nn.Conv1d(width, width, kernel, dilation=dilation)
        self.dropout = nn.Dropout(dropout)
        self.mix = nn.Linear(width, width)

    def forward(self, tokens: Tensor, valid: Tensor) -> Tensor:
        """[B, W, C] to [B, W, C]; valid: [B, W, 1], 0 for padding, which has no effect on later tokens."""
        # Masked after the norm, whose bias would give padding a value.
        inputs = (self.norm(tokens) * valid).transpose(1, 2)
        rows = self.convolve(functional.pad(inputs, ((self.kernel - 1) * self.dilation, 0))).transpose(1, 2)
        return tokens + self._respond(rows)

    def last(self, history: Tensor, valid: Tensor, candidates: Tensor) -> Tensor:
        """The output of `forward` at the last position for each candidate token there, [B, S, C]. history: [B, W - 1,
        C] the tokens before; valid: [B, W - 1, 1]; candidates: [B, S, C]. The contribution of the history is the same
        for all candidates."""
        # The convolution at the last position is a sum over its taps. Those on the history are summed once; only the
        # newest tap meets all S candidates.
        taps = self.convolve.weight.unbind(-1)
        assert self.convolve.bias is not None
        past: Tensor = self.convolve.bias
        for back, tap in enumerate(reversed(taps[:-1]), start=1):
            at = history.shape[1] - back * self.dilation
            if at >= 0:
                past = past + functional.linear(self.norm(history[:, at]) * valid[:, at], tap)[:, None]
        return candidates + self._respond(functional.linear(self.norm(candidates), taps[-1]) + past)

    def _respond(self, rows: Tensor) -> Tensor:
        mixed: Tensor = self.mix(self.dropout(functional.gelu(rows)))
        return mixed


class WindowEncoder(nn.Module):
    """E_m or E_u of RACER Eq. 8: the tokens of a window of any length to one unit vector.

    Causal residual layers, the mean over the valid tokens concatenated with the last token, a linear projection and the
    L2 norm, which makes the paper's inner product a cosine. The last token is the rewarded decision, which would have
    little weight in the mean alone.
    """

    def __init__(self, config: RewardConfig) -> None:
        super().__init__()
        self.layers = nn.ModuleList(
            CausalLayer(config.width, config.kernel, dilation, DROPOUT) for dilation in config.dilations)
        self.project = nn.Linear(2 * config.width, config.projection)

    def features(self, tokens: Tensor, valid: Tensor) -> Tensor:
        """[B, W, C] to [B, W, C], causal; undefined at padding. valid: [B, W]."""
        mask = valid.to(tokens.dtype)[..., None]
        for layer in self.layers:
            tokens = layer(tokens, mask)
        return tokens

    def forward(self, tokens: Tensor, valid: Tensor) -> Tensor:
        """[B, W, C] to unit vectors [B, P]; valid: [B, W], 0 at padding, which is on the left."""
        mask = valid.to(tokens.dtype)[..., None]
        rows = self.features(tokens, valid) * mask
        # Padding is on the left, so the last row is always a token.
        return self._finish(rows.sum(1), mask.sum(1), rows[:, -1])

    def every_last(self, history: Tensor, valid: Tensor, candidates: Tensor) -> Tensor:
        """Unit vectors [B, S, P] of the windows that end in each of the candidates. history: [B, W - 1, C]; valid: [B,
        W]; candidates: [B, S, C]. Equal to `forward` on the B * S windows."""
        mask = valid.to(history.dtype)[..., None]
        before = mask[:, :-1]
        for layer in self.layers:
            assert isinstance(layer, CausalLayer)
            candidates = layer.last(history, before, candidates)
            # The history is causal and has no candidate in it, so one pass through the layer serves all of them.
            if history.shape[1]:
                history = layer(history, before)
        last = candidates * mask[:, -1:]
        return self._finish(last + (history * before).sum(1, keepdim=True), mask.sum(1, keepdim=True), last)

    def _finish(self, total: Tensor, count: Tensor, last: Tensor) -> Tensor:
        return functional.normalize(self.project(torch.cat([total / count.clamp_min(1.0), last], dim=-1)), dim=-1)


class RewardModel(nn.Module):
    """Motion encoder, audio encoder and a temperature, trained on pairs of windows (RACER Fig. 3).

    A token is one block: all its K frames through one layer, a convolution over frames of kernel and stride K.
    The audio features include the log duration of a block, but not the motion tokens: durations alone would then
    identify 9 pairs in 10, and a policy cannot change them.
    """

    def __init__(self, config: RewardConfig, frames: int, motion_width: int, audio_width: int) -> None:
        """frames: K; motion_width: D_m; audio_width: d, including the log duration."""
        super().__init__()
        self.config, self.frames = config, frames
        self.read_motion = nn.Linear(frames * motion_width, config.width)
        self.read_audio = nn.Linear(frames * audio_width, config.width)
        self.encode_motion, self.encode_audio = WindowEncoder(config), WindowEncoder(config)
        # Learned as a logarithm, which keeps the temperature positive.
        self.log_temperature = nn.Parameter(torch.tensor(math.log(TEMPERATURE)))

    @property
    def weights(self) -> dict[str, float]:
        return {"contrast": 1.0, **({"choice": self.config.choice} if self.config.choice else {})}

    @property
    def models(self) -> list[RewardModel]:
        return [self]

    @property
    def temperature(self) -> float:
        return max(float(self.log_temperature.detach().exp()), LEAST_TEMPERATURE)

    def block_motion(self, motion: Tensor) -> Tensor:
        """Tokens [..., C] of motion blocks [..., K, D_m]."""
        tokens: Tensor = self.read_motion(motion.flatten(-2))
        return tokens

    def block_candidates(self, base: Tensor, added: Tensor) -> Tensor:
        """Tokens [B, S, C] of the blocks base [B, K, D_m] with each contribution added [S, K, D_m]: poses are read
        linearly, so a sum of tokens is the token of the sum."""
        return self.block_motion(base)[:, None] + functional.linear(added.flatten(-2), self.read_motion.weight)

    def block_audio(self, audio: Tensor) -> Tensor:
        """Tokens [..., C] of audio blocks [..., K, d]."""
        tokens: Tensor = self.read_audio(audio.flatten(-2))
        return tokens

    def embed_motion(self, tokens: Tensor, valid: Tensor) -> Tensor:
        """E_m: unit vectors [B, P] of windows [B, W, C]; valid: [B, W], 0 at padding, which is on the left."""
        vectors: Tensor = self.encode_motion(tokens, valid)
        return vectors

    def embed_audio(self, tokens: Tensor, valid: Tensor) -> Tensor:
        """E_u: unit vectors [B, P] of windows [B, W, C]; valid: [B, W], 0 at padding, which is on the left."""
        vectors: Tensor = self.encode_audio(tokens, valid)
        return vectors

    def embed(self, batch: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
        """Unit vectors m and u, [B, P] each, of a batch (see `losses`)."""
        return (self.embed_motion(self.block_motion(batch["motion"]), batch["valid"]),
                self.embed_audio(self.block_audio(batch["audio"]), batch["valid"]))

    def losses(self, batch: dict[str, Tensor], progress: float = 1.0) -> dict[str, Tensor]:
        """The contrastive loss (RACER Eq. 6 and 7, see `contrast`).

        batch: motion [B, W, K, D_m], audio [B, W, K, d], valid [B, W] with padding on the left, group [B] int64, equal
        for windows that are not negatives of each other (overlapping or silent). With rivals also rival [B, H, W, K,
        D_m], wrong versions of the window, and rivalled [B], 1 for rows that have them. With `choice` also last [B] the
        last lexeme, prior [B, S] its log odds given the previous one, and the inputs of `against_all`.
        """
        with torch.no_grad():  # clamp the parameter itself: a clamp in the loss would cut off its gradient
            self.log_temperature.clamp_(min=math.log(LEAST_TEMPERATURE))
        motion, audio = self.embed(batch)
        temperature = self.log_temperature.exp()
        rivals = None
        if "rival" in batch:
            against = self.against_rivals(batch, audio) / temperature
            # Captured windows have no wrong versions; -inf takes their places out of the softmax.
            rivals = against.masked_fill(~batch["rivalled"].bool()[:, None], -math.inf)
        terms = {"contrast": contrast(motion, audio, temperature, batch["group"], rivals)}
        if self.config.choice:
            # Adding the log odds of the lexeme given the previous one leaves to the audio only what those odds do not
            # explain.
            odds = self.against_all(batch, audio) / temperature + batch["prior"]
            nll = functional.cross_entropy(odds, batch["last"], reduction="none")
            terms["choice"] = masked_mean(nll, batch["rivalled"].to(nll))
        return terms

    def against_all(self, batch: dict[str, Tensor], audio: Tensor) -> Tensor:
        """Cosines [B, S] of audio vectors [B, P] with each window for each lexeme at its end. batch: motion and valid
        as in `losses`; base [B, K, D_m] the motion of the last block without its lexeme; lexemes [S, K,
        D_m] the motion that each adds."""
        history = self.block_motion(batch["motion"][:, :-1])
        candidates = self.block_candidates(batch["base"], batch["lexemes"])
        motion = self.encode_motion.every_last(history, batch["valid"], candidates)
        return torch.einsum("bsp,bp->bs", motion, audio)

    def against_rivals(self, batch: dict[str, Tensor], audio: Tensor) -> Tensor:
        """Cosines [B, H] of audio vectors [B, P] with each window's rivals."""
        count = batch["rival"].shape[1]
        valid, tokens = batch["valid"].repeat_interleave(count, 0), self.block_motion(batch["rival"].flatten(0, 1))
        return torch.einsum("bhp,bp->bh", self.embed_motion(tokens, valid).unflatten(0, (-1, count)), audio)

    @torch.no_grad()
    def window_rewards(self, motion: Tensor, audio: Tensor, valid: Tensor) -> Tensor:
        """Cosines [B] of windows of motion [B, W, K, D_m] and audio [B, W, K, d] (RACER Eq. 8); valid: [B, W]."""
        moved = self.embed_motion(self.block_motion(motion), valid)
        return (moved * self.embed_audio(self.block_audio(audio), valid)).sum(-1)

    @torch.no_grad()
    def retrieval(self, batch: dict[str, Tensor]) -> dict[str, float]:
        """Recall at 1 and 5 of a window's counterpart in the batch (see `losses`).

        motion_r1 and motion_r5 (audio retrieved for a motion), audio_r1 and audio_r5 (motion retrieved for an audio),
        and the chance levels chance_r1 and chance_r5. Rows of one group do not compete. A tie counts as a miss, so that
        a constant encoder scores 0. Call it in evaluation mode.
        """
        cosines = similarities(*self.embed(batch), batch["group"])
        rivals = (~torch.isneginf(cosines)).sum(1).double()
        figures = {}
        for name, table in (("motion", cosines), ("audio", cosines.T)):
            place = len(table) - (table < table.diagonal()[:, None]).sum(1)  # 1 is the first; not a number is last
            for first in (1, 5):
                figures[f"{name}_r{first}"] = float((place <= first).double().mean())
                figures[f"chance_r{first}"] = float((first / rivals).clamp_max(1.0).mean())
        return figures


class RewardEnsemble(nn.Module):
    """Several reward models with different initial weights, which learn in turns, each from separate windows. The
    reward of a single lexeme by one model is half noise; the mean of several is less noisy, and their disagreement
    measures the uncertainty (`interpreters.reward_table.EnsembleReward`)."""

    def __init__(self, config: RewardConfig, frames: int, motion_width: int, audio_width: int) -> None:
        super().__init__()
        self.config, self.frames, self.turn = config, frames, 0
        self.members = nn.ModuleList(RewardModel(config, frames, motion_width, audio_width)
                                     for _ in range(config.members))

    @property
    def models(self) -> list[RewardModel]:
        return [cast(RewardModel, member) for member in self.members]

    @property
    def weights(self) -> dict[str, float]:
        return self.models[0].weights

    def before_step(self, step: int) -> None:
        # One member per step: each sees other windows than the rest, so that their errors differ.
        self.turn = step % len(self.members)

    def losses(self, batch: dict[str, Tensor], progress: float = 1.0) -> dict[str, Tensor]:
        return self.models[self.turn].losses(batch, progress)

    @torch.no_grad()
    def window_rewards(self, motion: Tensor, audio: Tensor, valid: Tensor) -> Tensor:
        return torch.stack([model.window_rewards(motion, audio, valid) for model in self.models]).mean(0)

    @torch.no_grad()
    def figures(self, batch: dict[str, Tensor]) -> dict[str, float]:
        """The members' mean loss and retrieval."""
        rows = [{"contrast": float(model.losses(batch)["contrast"]), **model.retrieval(batch)} for model in self.models]
        return {key: sum(row[key] for row in rows) / len(rows) for key in rows[0]}
