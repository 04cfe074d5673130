"""The speech encoder: predictive coding on audio, then the contrastive loss with text (RG 4.1.3, Eq. 1).
The last node is the corpus with the features of the trained encoder.
"""

import copy
from collections.abc import Callable, Iterable, Sequence
from typing import TypeAlias

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from data_module.blocks import samples_per_frame
from data_module.layers import freeze
from data_module.speech.audio import SAMPLE_RATE, resample
from data_module.speech.speech_encoder import PredictiveCoding, SpeechEncoder, TextContrast
from gesticulator.bundle import models
from gesticulator.bundle.config import Config
from gesticulator.training import fit as fitting
from gesticulator.training.stages.base import Figures, Node, Run, Stage, checked
from gesticulator.training.stages.corpus import BLOCKS, Corpus, prepare, sizes

Crops: TypeAlias = "Callable[[np.random.Generator, int], NDArray[np.float32]]"
"""[count, length] crops of sound, every start equally likely, none over two recordings."""


def crops_of(sounds: Iterable[NDArray[np.float32]], length: int) -> Crops:
    """Crops of `length` samples of these sounds."""
    # A recording shorter than a crop is padded, so that it has one possible start.
    parts = [np.pad(samples, (0, max(0, length - len(samples)))).astype(np.float16) for samples in sounds]
    lengths = np.array([len(part) for part in parts])
    whole, first, room = np.concatenate(parts), np.cumsum(lengths) - lengths, lengths - length + 1
    ends = np.cumsum(room)

    def sample(rng: np.random.Generator, count: int) -> NDArray[np.float32]:
        # Uniform over all possible starts, so long recordings are sampled more often.
        place = rng.integers(ends[-1], size=count)
        recording = np.searchsorted(ends, place, side="right")
        starts = first[recording] + place - (ends - room)[recording]
        return np.stack([whole[start:start + length] for start in starts]).astype(np.float32)

    return sample


_CHECKS, _CROPS = 4, 32
"""Validation batches, and crops in each."""


def _learned(config: Config) -> bool:
    return config.front_end.name == "vqwav2vec"


def _predictive_task(run: Run, model: PredictiveCoding) -> fitting.Task:
    store, config = run.store, run.config
    known, held = ([info.name for info in store.of_split(split)] for split in ("train", "val"))
    length = 3 * config.rhythm.frames * samples_per_frame(SAMPLE_RATE, config.rhythm.fps)
    crops, check = (crops_of((resample(store.load(name).speech, SAMPLE_RATE).samples for name in names), length)
                    for names in (known, held or known[:1]))
    checks = [{"samples": torch.as_tensor(check(fitting.generator_for(0, i), _CROPS))} for i in range(_CHECKS)]

    def validate(batches: list[fitting.Batch]) -> Figures:
        # The same random numbers in each validation, so that figures are comparable.
        torch.manual_seed(0)
        return {"predictive": sum(float(model.losses(b)["predictive"]) for b in batches) / len(batches)}

    return fitting.Task(lambda rng, size: {"samples": torch.as_tensor(crops(rng, size))},
                        validate=checked(run, checks, validate))


SPEECH: Stage[PredictiveCoding] = Stage(
    "speech", settings=("encoder", "rhythm"), schedule="speech", wanted=_learned, train=_predictive_task,
    build=lambda run: PredictiveCoding(SpeechEncoder(run.config.encoder.width)))


def _contrast_batches(corpus: Corpus, recordings: Sequence[int], frames: int) -> fitting.MakeBatch:
    """Windows of three blocks with a word in the middle one, as `TextContrast` reads them: the anchors of Eq. 1.
    recordings: with words; frames: of a block."""
    assert corpus.word_at is not None
    word_at, middle = corpus.word_at, slice(frames, 2 * frames)
    # The middle block of three; row 0 is the empty word.
    spoken = (word_at[:, middle] > 0).any(1).numpy()
    blocks = {r: corpus.blocks_of(r) for r in recordings}
    anchors = np.concatenate([each[spoken[each]] for each in blocks.values()])
    sounds = {r: np.load(corpus.files[r].with_suffix(".npy"), mmap_mode="r") for r in recordings}

    def make_batch(rng: np.random.Generator, size: int) -> fitting.Batch:
        chosen = rng.choice(anchors, size)
        samples = np.stack([_around(sounds[r], b - blocks[r][0])
                            for r, b in zip(corpus.recording[chosen], chosen, strict=True)])
        return {"samples": torch.as_tensor(samples).float(), "text": corpus.text(chosen)[:, middle, :-1],
                "word": word_at[torch.as_tensor(chosen), middle].long() - 1}

    return make_batch


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
    held = _contrast_batches(corpus, corpus.recordings("val", with_text=True) or known[:1], frames)
    checks = [held(fitting.generator_for(1, i), size) for i in range(_CHECKS)]

    def validate(batches: list[fitting.Batch]) -> Figures:
        retrieval = torch.stack([model.retrieval(batch) for batch in batches]).nanmean(0)
        return {"contrast": sum(float(model.losses(b)["contrast"]) for b in batches) / len(batches),
                **{f"retrieval_{level + 1}": float(value) for level, value in enumerate(retrieval)}}

    return fitting.Task(_contrast_batches(corpus, known, frames), validate=checked(run, checks, validate))


def _contrasted(config: Config) -> bool:
    return _learned(config) and bool(config.text.encoder) and config.schedules.contrast.steps > 0


CONTRAST: Stage[TextContrast] = Stage(
    "contrast", settings=("encoder", "text"), needs=lambda config: (SPEECH, BLOCKS), schedule="contrast",
    wanted=_contrasted, build=_build_contrast, train=_contrast_task)


def _encoder(run: Run) -> SpeechEncoder | None:
    if not _learned(run.config):
        return None
    encoder = models.build("encoder", sizes(run.config, run.get(BLOCKS)))
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
