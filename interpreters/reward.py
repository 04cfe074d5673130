"""The contrastive reward: how well a sequence of gestures suits the speech under it (RACER 4.2, Eq. 6 to 8).

Two encoders bring a window of motion and a window of audio to one vector each; they are trained so that the two
vectors of a real pair agree and those of pairs put together from different moments do not. The cosine of the two is the
reward of reinforcement learning. A window is a row of blocks in normalised time, so a token is one block.

The paper gives 1-D temporal convolutions and no more. Here they are causal: a token never hears a later one. Windows
that share their past then share all work but that of their last token, which is what makes it cheap to ask for the
reward of every lexeme (`interpreters.reward_table`).

Whoever optimises a reward finds its errors too. Figures must come from a second model, trained with another seed on
other recordings than the one that taught the policy.
"""

from __future__ import annotations

import math
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from data_module.layers import masked_mean
from interpreters.settings import LEAST_TEMPERATURE, RewardConfig

__all__ = ["RewardEnsemble", "RewardModel", "contrast"]


def contrast(motion: Tensor, audio: Tensor, temperature: Tensor | float, group: Tensor,
             rivals: Tensor | None = None) -> Tensor:
    """InfoNCE in both directions, in nats (RACER Eq. 6 and 7), the mean over the batch.

    L = mean_i 1/2 [-log softmax_k(m_i . u_k / tau)_i - log softmax_k(u_i . m_k / tau)_i]

    rivals: [B, H] products u_i . m_ij / tau of the audio with motion made wrong, more negatives in the second softmax
    (-inf for none).

    motion, audio: [B, P] of unit length; row i of both belongs together. group: [B] rows of one group are never each
    other's negatives (see `similarities`). The paper adds the two directions up; their mean has the same minimum and
    makes chance log B.
    """
    from data_module.parallel import batch_rows, full_precision  # only training asks for them

    # Every window is told from those of the whole batch.
    motion, audio, group = batch_rows(motion), batch_rows(audio), batch_rows(group)
    rivals = None if rivals is None else batch_rows(rivals)
    # Scaled before it is masked: a temperature that divided -inf would get NaN for a gradient.
    logits = full_precision(similarities)(motion / temperature, audio, group)
    pairs = torch.arange(len(logits), device=logits.device)
    heard = logits.T if rivals is None else torch.cat([logits.T, rivals], dim=1)
    return 0.5 * (functional.cross_entropy(logits, pairs) + functional.cross_entropy(heard, pairs))


def similarities(motion: Tensor, audio: Tensor, group: Tensor) -> Tensor:
    """Products m_i . u_k [B, B] of vectors [B, P] (cosines of unit vectors), -inf for two different rows of one group.

    Windows that overlap in time, or hold silence only, suit each other's audio: to push them apart would be wrong, so
    they leave the sum under the softmax of RACER Eq. 7.
    """
    same = group[:, None] == group[None, :]
    same.fill_diagonal_(False)
    return (motion @ audio.T).masked_fill(same, -math.inf)


class CausalLayer(nn.Module):
    """x + mix(gelu(convolution(norm(x)))), a dilated convolution over tokens that hears this one and earlier ones."""

    def __init__(self, width: int, kernel: int, dilation: int, dropout: float) -> None:
        super().__init__()
        self.kernel, self.dilation = kernel, dilation
        self.norm = nn.LayerNorm(width)
        self.convolve = nn.Conv1d(width, width, kernel, dilation=dilation)
        self.dropout = nn.Dropout(dropout)
        self.mix = nn.Linear(width, width)

    def forward(self, tokens: Tensor, valid: Tensor) -> Tensor:
        """[B, W, C] to [B, W, C]; valid: [B, W, 1]. A token that is padding is silent, as if the window began later."""
        heard = (self.norm(tokens) * valid).transpose(1, 2)
        rows = self.convolve(functional.pad(heard, ((self.kernel - 1) * self.dilation, 0))).transpose(1, 2)
        return tokens + self._respond(rows)

    def last(self, history: Tensor, valid: Tensor, candidates: Tensor) -> Tensor:
        """What `forward` gives at the last position for each candidate that may stand there, [B, S, C].

        history: [B, W - 1, C] the tokens before; valid: [B, W - 1, 1]; candidates: [B, S, C]. What the taps on the
        history hear is the same for all candidates.
        """
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

    Causal residual layers, the mean over the tokens that are no padding beside the last token, a linear projection and
    the L2 norm, which makes the paper's inner product the cosine that its text speaks of. The last token is the
    decision that is rewarded: in the mean alone it would be one voice among eight.
    """

    def __init__(self, config: RewardConfig) -> None:
        super().__init__()
        self.layers = nn.ModuleList(
            CausalLayer(config.width, config.kernel, dilation, config.dropout) for dilation in config.dilations)
        self.project = nn.Linear(2 * config.width, config.projection)

    def features(self, tokens: Tensor, valid: Tensor) -> Tensor:
        """[B, W, C] to [B, W, C], each token with its past; what stands at padding means nothing. valid: [B, W]."""
        mask = valid.to(tokens.dtype)[..., None]
        for layer in self.layers:
            tokens = layer(tokens, mask)
        return tokens

    def forward(self, tokens: Tensor, valid: Tensor) -> Tensor:
        """[B, W, C] to unit vectors [B, P]; valid: [B, W], 0 at padding, which stands on the left."""
        mask = valid.to(tokens.dtype)[..., None]
        rows = self.features(tokens, valid) * mask
        return self._finish(rows.sum(1), mask.sum(1), rows[:, -1])

    def every_last(self, history: Tensor, valid: Tensor, candidates: Tensor) -> Tensor:
        """Unit vectors [B, S, P] of the windows that end in each of the candidates.

        history: [B, W - 1, C]; valid: [B, W]; candidates: [B, S, C]. Equal to `forward` on the B * S whole windows.
        """
        mask = valid.to(history.dtype)[..., None]
        before = mask[:, :-1]
        for layer in self.layers:
            assert isinstance(layer, CausalLayer)
            candidates = layer.last(history, before, candidates)
            if history.shape[1]:
                history = layer(history, before)
        last = candidates * mask[:, -1:]
        return self._finish(last + (history * before).sum(1, keepdim=True), mask.sum(1, keepdim=True), last)

    def _finish(self, total: Tensor, count: Tensor, last: Tensor) -> Tensor:
        return functional.normalize(self.project(torch.cat([total / count.clamp_min(1.0), last], dim=-1)), dim=-1)


class RewardModel(nn.Module):
    """Motion encoder, audio encoder and a temperature, trained on pairs of windows (RACER Fig. 3).

    A token is one block: all K frames of it through one layer, which is a convolution over frames of kernel and stride
    K. Normalised time hides the tempo of a block; the audio side has its log duration among the features, and the
    motion side hears of it only where the settings say so.
    """

    def __init__(self, config: RewardConfig, frames: int, motion_width: int, audio_width: int) -> None:
        """frames: K; motion_width: D_m; audio_width: d, the log duration included."""
        super().__init__()
        self.config, self.frames = config, frames
        self.read_motion = nn.Linear(frames * motion_width, config.width)
        self.read_tempo = nn.Linear(1, config.width, bias=False) if config.tempo else None
        self.read_audio = nn.Linear(frames * audio_width, config.width)
        self.encode_motion, self.encode_audio = WindowEncoder(config), WindowEncoder(config)
        self.log_temperature = nn.Parameter(torch.tensor(math.log(config.temperature)))

    @property
    def weights(self) -> dict[str, float]:
        """Loss weights, keyed like `losses`."""
        return {"contrast": 1.0, **({"choice": self.config.choice} if self.config.choice else {})}

    @property
    def models(self) -> list[RewardModel]:
        """Itself, as an ensemble gives its members."""
        return [self]

    @property
    def temperature(self) -> float:
        """tau of RACER Eq. 7."""
        return max(float(self.log_temperature.detach().exp()), LEAST_TEMPERATURE)

    def block_motion(self, motion: Tensor, log_duration: Tensor) -> Tensor:
        """Tokens [..., C] of motion blocks [..., K, D_m] that last exp(log_duration [...]) seconds."""
        tokens: Tensor = self.read_motion(motion.flatten(-2))
        return tokens + self.tempo(log_duration)

    def tempo(self, log_duration: Tensor) -> Tensor:
        """What the log duration [...] of a block adds to its motion token, [..., C]: nothing unless `tempo` is on, nor
        for a block of 1 s."""
        if self.read_tempo is None:
            return log_duration.new_zeros(*log_duration.shape, self.config.width)
        added: Tensor = self.read_tempo(log_duration[..., None])
        return added

    def block_audio(self, audio: Tensor) -> Tensor:
        """Tokens [..., C] of audio blocks [..., K, d]."""
        tokens: Tensor = self.read_audio(audio.flatten(-2))
        return tokens

    def embed_motion(self, tokens: Tensor, valid: Tensor) -> Tensor:
        """E_m: unit vectors [B, P] of windows [B, W, C]; valid: [B, W], 0 at padding, which stands on the left."""
        vectors: Tensor = self.encode_motion(tokens, valid)
        return vectors

    def embed_audio(self, tokens: Tensor, valid: Tensor) -> Tensor:
        """E_u: unit vectors [B, P] of windows [B, W, C]; valid: [B, W], 0 at padding, which stands on the left."""
        vectors: Tensor = self.encode_audio(tokens, valid)
        return vectors

    def embed(self, batch: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
        """Unit vectors m and u, [B, P] each, of a batch as `losses` takes it."""
        motion = self.block_motion(batch["motion"], batch["log_duration"])
        return (self.embed_motion(motion, batch["valid"]),
                self.embed_audio(self.block_audio(batch["audio"]), batch["valid"]))

    def losses(self, batch: dict[str, Tensor], progress: float = 1.0) -> dict[str, Tensor]:
        """The contrastive loss (RACER Eq. 6 and 7, see `contrast`).

        batch: motion [B, W, K, D_m], audio [B, W, K, d], log_duration [B, W], valid [B, W] with padding on the left,
        group [B] int64, alike for windows that are not to be told apart: overlapping ones, and silent ones. Where
        there are rivals, also rival [B, H, W, K, D_m], the same window made wrong, and rivalled [B], 1 for rows that
        have them. With `choice`, also last [B] the last lexeme, prior [B, S] its log odds by the one before, and what
        `against_all` takes.
        """
        with torch.no_grad():  # the parameter itself is held: a clamp in the loss would leave it without a gradient
            self.log_temperature.clamp_(min=math.log(LEAST_TEMPERATURE))
        motion, audio = self.embed(batch)
        temperature = self.log_temperature.exp()
        rivals = None
        if "rival" in batch:
            against = self.against_rivals(batch, audio) / temperature
            rivals = against.masked_fill(~batch["rivalled"].bool()[:, None], -math.inf)
        terms = {"contrast": contrast(motion, audio, temperature, batch["group"], rivals)}
        if self.config.choice:
            odds = self.against_all(batch, audio) / temperature + batch["prior"]
            nll = functional.cross_entropy(odds, batch["last"], reduction="none")
            terms["choice"] = masked_mean(nll, batch["rivalled"].to(nll))
        return terms

    def against_all(self, batch: dict[str, Tensor], audio: Tensor) -> Tensor:
        """Cosines [B, S] of audio vectors [B, P] with each window as it would be with each lexeme at its end.

        batch: motion, valid and log_duration as `losses` takes them; base [B, K, D_m] what the last block shows before
        without its lexeme; lexemes [S, K, D_m] what each adds.
        """
        history = self.block_motion(batch["motion"][:, :-1], batch["log_duration"][:, :-1])
        base = self.block_motion(batch["base"], batch["log_duration"][:, -1])
        candidates = base[:, None] + functional.linear(batch["lexemes"].flatten(-2), self.read_motion.weight)
        motion = self.encode_motion.every_last(history, batch["valid"], candidates)
        return torch.einsum("bsp,bp->bs", motion, audio)

    @torch.no_grad()
    def choices(self, batch: dict[str, Tensor]) -> dict[str, float]:
        """Of the windows that show lexemes: nats by which the sound tells the last one better than the one before does
        (`told`; negative where it misleads), and the share of lexemes that suit the sound better than it (`worse`,
        chance 0.5)."""
        _, audio = self.embed(batch)
        each, kept = self.against_all(batch, audio), batch["rivalled"].bool()
        own = each.gather(1, batch["last"][:, None])
        odds = (each / self.temperature + batch["prior"]).log_softmax(1)
        told = (odds - batch["prior"]).gather(1, batch["last"][:, None])
        return {"told": float(told[kept].mean()), "worse": float((each > own)[kept].double().mean())}

    def against_rivals(self, batch: dict[str, Tensor], audio: Tensor) -> Tensor:
        """Cosines [B, H] of audio vectors [B, P] with each window's rivals."""
        count = batch["rival"].shape[1]
        times, valid = (batch[key].repeat_interleave(count, 0) for key in ("log_duration", "valid"))
        tokens = self.block_motion(batch["rival"].flatten(0, 1), times)
        return torch.einsum("bhp,bp->bh", self.embed_motion(tokens, valid).unflatten(0, (-1, count)), audio)

    @torch.no_grad()
    def right_one(self, batch: dict[str, Tensor]) -> float:
        """How often a window's motion suits its audio better than all its rivals do; chance is 1 / (H + 1)."""
        motion, audio = self.embed(batch)
        best = self.against_rivals(batch, audio).amax(1)
        kept = batch["rivalled"].bool()
        return float(((motion * audio).sum(-1) > best)[kept].double().mean())

    @torch.no_grad()
    def window_rewards(self, motion: Tensor, log_duration: Tensor, audio: Tensor, valid: Tensor) -> Tensor:
        """Cosines [B] of windows of motion [B, W, K, D_m] and audio [B, W, K, d] (RACER Eq. 8); log_duration, valid:
        [B, W]."""
        moved = self.embed_motion(self.block_motion(motion, log_duration), valid)
        return (moved * self.embed_audio(self.block_audio(audio), valid)).sum(-1)

    @torch.no_grad()
    def retrieval(self, batch: dict[str, Tensor]) -> dict[str, float]:
        """How often a window's counterpart is the first, or among the first five, of the batch (as `losses` takes it).

        Gives motion_r1 and motion_r5 (audio sought for a motion), audio_r1 and audio_r5 (motion sought for an audio),
        chance_r1 and chance_r5, what blind guessing would give. Rows of one group do not compete. A tie counts as lost,
        so an encoder that maps everything to one point scores nothing. Call it in evaluation mode.
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
    """Several reward models of different beginnings, which learn in turns, each from windows of its own.

    One model's opinion of a single lexeme is half noise; what several agree on is less so, and where they disagree
    nobody knows (`interpreters.reward_table.EnsembleReward` takes the disagreement off).
    """

    def __init__(self, config: RewardConfig, frames: int, motion_width: int, audio_width: int) -> None:
        """As `RewardModel`; `config.members` of them."""
        super().__init__()
        self.config, self.frames, self.turn = config, frames, 0
        self.members = nn.ModuleList(RewardModel(config, frames, motion_width, audio_width)
                                     for _ in range(config.members))

    @property
    def models(self) -> list[RewardModel]:
        """The members."""
        return [cast(RewardModel, member) for member in self.members]

    @property
    def weights(self) -> dict[str, float]:
        """Loss weights, keyed like `losses`."""
        return self.models[0].weights

    def before_step(self, step: int) -> None:
        """Whose turn it is; the others have no gradient in that step and stay as they are."""
        self.turn = step % len(self.members)

    def losses(self, batch: dict[str, Tensor], progress: float = 1.0) -> dict[str, Tensor]:
        """As of the member whose turn it is."""
        return self.models[self.turn].losses(batch, progress)

    @torch.no_grad()
    def window_rewards(self, motion: Tensor, log_duration: Tensor, audio: Tensor, valid: Tensor) -> Tensor:
        """The members' mean of what `RewardModel.window_rewards` gives, [B]."""
        return torch.stack([own.window_rewards(motion, log_duration, audio, valid) for own in self.models]).mean(0)

    @torch.no_grad()
    def figures(self, batch: dict[str, Tensor]) -> dict[str, float]:
        """The members' mean loss, retrieval and, where there are rivals, share of windows preferred to all of them."""
        rows = [{"contrast": float(own.losses(batch)["contrast"]), **own.retrieval(batch),
                 **({"right_one": own.right_one(batch)} if "rival" in batch else {}),
                 **(own.choices(batch) if "prior" in batch else {})} for own in self.models]
        return {key: sum(row[key] for row in rows) / len(rows) for key in rows[0]}
