"""The speech encoder: eight convolutions over samples, whose outputs are levels from sound to content (RG 4.1.3).

Two stages train it on speech: `PredictiveCoding` predicts the next rows, and `TextContrast` pulls the last level
towards the words and pushes the others away (Eq. 1).
"""

from collections.abc import Mapping, Sequence

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from data_module.layers import masked_mean
from data_module.layers_run import Tensors
from data_module.speech import speech_encoder_run as run

PROJECTION = 128
"""Width of the space in which Eq. 1 compares text with audio."""
TEMPERATURE = 0.1
"""tau of Eq. 1."""
PREDICTION_STEPS, NEGATIVES = 12, 10
"""Of predictive coding: rows of 10 ms that it looks ahead, and negative rows from the same crop."""
CONTEXT_WIDTH = 128
"""Width of the recurrent net of predictive coding that summarises the past."""


class SpeechEncoder(nn.Module):
    """vq-wav2vec's feature extractor: each convolution is followed by normalisation and activation. The normalisation
    uses statistics of the whole input, so a level depends on the length of the input: all callers use a window of three
    blocks, in training and inference."""

    def __init__(self, width: int) -> None:
        """width: channels of every convolution."""
        super().__init__()
        self.width, widths = width, (1, *[width] * run.LEVELS)
        self.convolutions = nn.ModuleList(nn.Conv1d(widths[layer], width, kernel, stride, bias=False)
                                          for layer, (kernel, stride) in enumerate(run.SHAPES))
        self.norms = nn.ModuleList(nn.GroupNorm(1, width) for _ in run.SHAPES)

    def forward(self, samples: Tensor) -> list[Tensor]:
        """Samples [B, T] at 16 kHz to the eight levels, each [B, C, T_l]; the last as log(1 + |x|). ValueError when a
        window is too short for a row of the last level (465 samples)."""
        shortest = run.hop_and_reach(run.LEVELS)[1]
        if samples.ndim != 2 or samples.shape[1] < shortest:
            raise ValueError(f"samples {tuple(samples.shape)} are not [B, T] with {shortest} or more")
        x = samples.unsqueeze(1)
        out = []
        for convolve, norm in zip(self.convolutions, self.norms, strict=True):
            x = F.gelu(norm(convolve(x)))
            out.append(x)
        out[-1] = torch.log1p(out[-1].abs())
        return out

    def levels(self, samples: Tensor, frames: int, which: Sequence[int] = (run.LOW, run.HIGH)) -> tuple[Tensor, ...]:
        """The levels `which` (1 to 8) of windows [B, T], averaged over each motion frame: [B, frames, C] each."""
        out = self(samples)
        pooled = []
        for level in which:
            matrix = torch.from_numpy(run.pooling(level, samples.shape[1], frames)).to(samples.device)
            pooled.append((out[level - 1] @ matrix).transpose(1, 2))
        return tuple(pooled)


class PredictiveCoding(nn.Module):
    """Contrastive predictive coding: from level 8 so far, identify the row 1 to 12 steps later among `negatives` others
    of the same crop, by the dot product with a linear prediction per step."""

    def __init__(self, encoder: SpeechEncoder) -> None:
        super().__init__()
        self.encoder = encoder
        self.context = nn.GRU(encoder.width, CONTEXT_WIDTH, batch_first=True)
        self.predict = nn.Linear(CONTEXT_WIDTH, PREDICTION_STEPS * encoder.width)

    @property
    def weights(self) -> dict[str, float]:
        return {"predictive": 1.0}

    def scores(self, samples: Tensor) -> tuple[Tensor, Tensor]:
        """[B, T, steps, 1 + negatives] scores of each row by the prediction 1, 2, ... steps before it, the true row
        first; and [T, steps] which of them exist. The negatives come from torch's global generator, as in dropout."""
        rows = self.encoder(samples)[-1].transpose(1, 2)
        batch, count, width = rows.shape
        if count < 2:
            raise ValueError(f"crops of {samples.shape[1]} samples are too short for a prediction")
        context, _ = self.context(rows)
        # Scaled as in attention: dot products of wide vectors would saturate the softmax.
        predicted = self.predict(context).unflatten(-1, (-1, width)) / width ** 0.5
        time = torch.arange(count, device=rows.device)
        ahead = torch.arange(PREDICTION_STEPS, device=rows.device)
        since = time[:, None] - 1 - ahead
        # Row t is compared with the prediction for t made `ahead` + 1 steps earlier.
        foreseen = predicted[:, since.clamp_min(0), ahead]
        positive = time[None, :, None].expand(batch, -1, 1)
        others = torch.randint(count - 1, (batch, count, NEGATIVES), device=rows.device)
        # Sampled among count - 1 rows and moved past the true one, so that it is never its own negative.
        picked = torch.cat([positive, others + (others >= positive)], dim=-1)
        candidates = rows[torch.arange(batch, device=rows.device)[:, None, None], picked]
        return torch.einsum("btsc,btnc->btsn", foreseen, candidates), since >= 0

    def losses(self, batch: Mapping[str, Tensor], progress: float = 1.0) -> dict[str, Tensor]:
        """Cross-entropy of the true row, averaged over rows and steps. batch: "samples" [B, T], crops of speech."""
        scores, there = self.scores(batch["samples"])
        chosen = scores[:, there].flatten(0, 1)
        return {"predictive": F.cross_entropy(chosen, chosen.new_zeros(len(chosen), dtype=torch.long))}


class TextContrast(nn.Module):
    """Eq. 1 and 2: the text of a frame retrieves level 8 of its frame among all levels of all frames of the block.

    F_t and one F_a per level are linear without bias. They can lower Eq. 1 without a change of the encoder, because the
    projection of a level can turn its mean away from the text. The effect on the encoder is therefore measured by
    `retrieval` and by linear probes on frozen levels (docs/results/earlier/speech_levels.md), not by the loss.
    """

    def __init__(self, encoder: SpeechEncoder, text_width: int, frames: int) -> None:
        super().__init__()
        self.encoder, self.frames = encoder, frames
        self.text = nn.Linear(text_width, PROJECTION, bias=False)
        self.audio = nn.ModuleList(nn.Linear(encoder.width, PROJECTION, bias=False) for _ in range(run.LEVELS))

    @property
    def weights(self) -> dict[str, float]:
        return {"contrast": 1.0}

    def similarities(self, batch: Mapping[str, Tensor]) -> Tensor:
        """Eq. 2 for each anchor frame, level and frame of the middle block: [B, K, 8, K] cosines."""
        middle = slice(self.frames, 2 * self.frames)
        levels = self.encoder.levels(batch["samples"], 3 * self.frames, range(1, run.LEVELS + 1))
        audio = torch.stack([project(level[:, middle]) for project, level in zip(self.audio, levels, strict=True)], 1)
        text = F.normalize(self.text(batch["text"]), dim=-1)
        return torch.einsum("bkp,blip->bkli", text, F.normalize(audio, dim=-1))

    def losses(self, batch: Mapping[str, Tensor], progress: float = 1.0) -> dict[str, Tensor]:
        """Eq. 1, averaged over anchors, the frames with a word. batch: "samples" [B, 3K * samples per frame], windows
        of three blocks; "text" [B, K, d_t] word vectors of the middle block; "word" [B, K] which word of the recording
        sounds, -1 for none."""
        logits = self.similarities(batch) / TEMPERATURE
        word = batch["word"]
        # The other frames of the anchor's word stay in the denominator, as in the paper.
        positive = torch.arange(word.shape[1], device=word.device).expand_as(word)
        spread = torch.logsumexp(logits.flatten(2), dim=-1)
        terms = spread - logits[:, :, -1].gather(2, positive[..., None])[..., 0]
        return {"contrast": masked_mean(terms, word >= 0)}

    @torch.no_grad()
    def retrieval(self, batch: Mapping[str, Tensor]) -> Tensor:
        """[8]: share of text frames for which the most similar frame of a level has the same word. Anchors are the
        frames with a word, in blocks that also have another word or silence; NaN without any."""
        best = self.similarities(batch).argmax(dim=-1)
        word = batch["word"]
        anchors = (word >= 0) & (word[:, :, None] != word[:, None]).any(dim=-1)
        retrieved = torch.gather(word[:, :, None].expand(-1, -1, run.LEVELS), 1, best)
        return (retrieved == word[..., None])[anchors].float().mean(dim=0)


def runner_of(encoder: SpeechEncoder) -> run.SpeechEncoderRunner:
    """The encoder as it is played, on arrays."""
    tensors = Tensors({key: value.detach().cpu().numpy() for key, value in encoder.state_dict().items()})
    return run.SpeechEncoderRunner(encoder.width, tensors)
