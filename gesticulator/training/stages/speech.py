"""The speech encoder: predictive coding on audio, then the contrastive loss with text (RG 4.1.3, Eq. 1).
The last node is the corpus with the features of the trained encoder.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from data_module.blocks import samples_per_frame
from data_module.layers import freeze
from data_module.speech.audio import SAMPLE_RATE, resample
from data_module.speech.speech_encoder import PredictiveCoding, SpeechEncoder, TextContrast
from data_module.store import Store
from gesticulator.bundle import models
from gesticulator.bundle.config import Config
from gesticulator.training import fit as fitting
from gesticulator.training.stages.base import Figures, Node, Run, Stage
from gesticulator.training.stages.corpus import BLOCKS, Corpus, prepare, sizes


@dataclass(frozen=True)
class Crops:
    """Concatenated audio, and the possible starts of crops within each recording.

    samples: [T] half precision. first: [R] start of each recording; room: [R] number of possible starts in it.
    """

    samples: NDArray[np.float16]
    first: NDArray[np.int64]
    room: NDArray[np.int64]
    length: int

    @classmethod
    def of_store(cls, store: Store, names: Sequence[str], length: int) -> Crops:
        """Crops of `length` samples from recordings of a store."""
        parts = []
        for name in names:
            samples = resample(store.load(name).speech, SAMPLE_RATE).samples
            # A recording shorter than a crop is padded, so that it has one possible start.
            parts.append(np.pad(samples, (0, max(0, length - len(samples)))).astype(np.float16))
        sizes = np.array([len(part) for part in parts])
        return cls(np.concatenate(parts), np.cumsum(sizes) - sizes, sizes - length + 1, length)

    def sample(self, rng: np.random.Generator, count: int) -> NDArray[np.float32]:
        """[count, length] crops, every start equally likely."""
        ends = np.cumsum(self.room)
        # Uniform over all possible starts, so long recordings are sampled more often.
        place = rng.integers(ends[-1], size=count)
        recording = np.searchsorted(ends, place, side="right")
        starts = self.first[recording] + place - (ends - self.room)[recording]
        return np.stack([self.samples[start:start + self.length] for start in starts]).astype(np.float32)


_CHECKS, _CROPS = 4, 32
"""Validation batches, and crops in each."""


def _learned(config: Config) -> bool:
    return config.front_end.name == "vqwav2vec"


def _predictive_task(run: Run, model: PredictiveCoding) -> fitting.Task:
    store, config = run.store, run.config
    known, held = ([info.name for info in store.of_split(split)] for split in ("train", "val"))
    length = 3 * config.rhythm.frames * samples_per_frame(SAMPLE_RATE, config.rhythm.fps)
    crops, check = (Crops.of_store(store, names, length) for names in (known, held or known[:1]))
    checks = [torch.as_tensor(check.sample(fitting.generator_for(0, i), _CROPS)) for i in range(_CHECKS)]

    @torch.no_grad()
    def validate() -> Figures:
        # The same random numbers in each validation, so that figures are comparable.
        torch.manual_seed(0)
        return {"predictive": sum(float(model.losses({"samples": b.to(run.device)})["predictive"])
                                  for b in checks) / len(checks)}

    return fitting.Task(lambda rng, size: {"samples": torch.as_tensor(crops.sample(rng, size))}, validate=validate)


SPEECH: Stage[PredictiveCoding] = Stage(
    "speech", settings=("encoder", "rhythm"), schedule="speech", wanted=_learned, train=_predictive_task,
    build=lambda run: PredictiveCoding(SpeechEncoder(run.config.encoder.width)))


@dataclass(frozen=True)
class ContrastWindows:
    """Windows of three blocks with a word in the middle one, as the anchors of Eq. 1.

    blocks: [n] the middle ones; sounds: by recording; begins: the first block of each recording.
    """

    corpus: Corpus
    frames: int
    blocks: NDArray[np.int64]
    sounds: Mapping[int, NDArray[np.float16]]
    begins: Mapping[int, int]

    @classmethod
    def of(cls, corpus: Corpus, recordings: Sequence[int], frames: int) -> ContrastWindows:
        """All of these recordings, which have words; frames: of a block."""
        assert corpus.word_at is not None
        # The middle block of three; row 0 is the empty word.
        spoken = (corpus.word_at[:, frames:2 * frames] > 0).any(1).numpy()
        blocks = [corpus.blocks_of(r) for r in recordings]
        return cls(corpus, frames, np.concatenate([each[spoken[each]] for each in blocks]),
                   {r: np.load(corpus.files[r].with_suffix(".npy"), mmap_mode="r") for r in recordings},
                   {r: int(each[0]) for r, each in zip(recordings, blocks, strict=True)})

    def batch(self, chosen: NDArray[np.int64]) -> fitting.Batch:
        """The windows around these blocks [B], as `TextContrast` reads them."""
        corpus, middle = self.corpus, slice(self.frames, 2 * self.frames)
        assert corpus.word_at is not None
        owners = corpus.recording[chosen]
        samples = np.stack([_around(self.sounds[r], b - self.begins[r]) for r, b in zip(owners, chosen, strict=True)])
        return {"samples": torch.as_tensor(samples).float(), "text": corpus.text(chosen)[:, middle, :-1],
                "word": corpus.word_at[torch.as_tensor(chosen), middle].long() - 1}

    def sample(self, rng: np.random.Generator, size: int) -> fitting.Batch:
        """Some of them."""
        return self.batch(rng.choice(self.blocks, size))


def _around(sound: NDArray[np.float16], block: int) -> NDArray[np.float16]:
    """[3 L] the audio of a block of [N, L] with the blocks before and after; silence beyond the ends."""
    # Beyond the recording there is silence.
    out = np.zeros((3, sound.shape[1]), np.float16)
    there = [k for k in (0, 1, 2) if 0 <= block + k - 1 < len(sound)]
    out[there] = np.asarray(sound[np.array(there) + block - 1])
    return out.reshape(-1)


def _build_contrast(run: Run) -> nn.Module:
    encoder = copy.deepcopy(run.get(SPEECH).encoder)
    encoder.requires_grad_(True)
    return TextContrast(encoder, run.get(BLOCKS).text_width - 1, run.config.rhythm.frames)


def _contrast_task(run: Run, model: TextContrast) -> fitting.Task:
    corpus, frames, size = run.get(BLOCKS), run.config.rhythm.frames, run.schedule(CONTRAST).batch
    known = corpus.recordings("train", with_text=True)
    held = ContrastWindows.of(corpus, corpus.recordings("val", with_text=True) or known[:1], frames)
    checks = [held.sample(fitting.generator_for(1, i), size) for i in range(_CHECKS)]
    learn = ContrastWindows.of(corpus, known, frames)

    @torch.no_grad()
    def validate() -> Figures:
        on = [fitting.moved(b, run.device) for b in checks]
        retrieval = torch.stack([model.retrieval(b) for b in on]).nanmean(0)
        return {"contrast": sum(float(model.losses(b)["contrast"]) for b in on) / len(on),
                **{f"retrieval_{level + 1}": float(value) for level, value in enumerate(retrieval)}}

    return fitting.Task(learn.sample, validate=validate)


def _contrasted(config: Config) -> bool:
    return _learned(config) and bool(config.text.encoder) and config.schedules.contrast.steps > 0


CONTRAST: Stage[TextContrast] = Stage(
    "contrast", settings=("encoder", "text"), needs=lambda config: (SPEECH, BLOCKS), schedule="contrast",
    wanted=_contrasted, build=_build_contrast, train=_contrast_task)


def _encoder(run: Run) -> SpeechEncoder | None:
    if not _learned(run.config):
        return None
    encoder = models.encoder(sizes(run.config, run.get(BLOCKS)))
    encoder.load_state_dict((run.get(CONTRAST) if _contrasted(run.config) else run.get(SPEECH)).encoder.state_dict())
    # A bundle stores half precision: train on the same features as at inference.
    encoder.half().float()
    freeze(encoder)
    return encoder


ENCODER: Node[SpeechEncoder | None] = Node(
    "encoder", settings=(), make=_encoder,
    needs=lambda config: () if not _learned(config) else (CONTRAST,) if _contrasted(config) else (SPEECH,))
"""The trained speech encoder in a bundle's precision; None for other front ends."""


def _encoded_corpus(run: Run) -> Corpus:
    encoder = run.get(ENCODER)
    if encoder is None:
        return run.get(BLOCKS)
    return prepare(run.store, run.config, run.work, encoder, workers=run.workers, progress=run.progress)


CORPUS: Node[Corpus] = Node(
    "corpus", settings=("front_end",), needs=lambda config: (BLOCKS, ENCODER), make=_encoded_corpus)
"""The corpus with the audio features of the trained speech encoder."""
