"""The lexicon of beat-aligned blocks (RG 5.1) or RACER's codec at a fixed rate (RACER 4.1), and the corpus labelled by
it: lexemes, silent lexemes, and their frequencies (RG 6.4.1)."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_module.errors import InputError
from data_module.motion.kinematics import positions_of
from data_module.motion.movement import Pasts
from data_module.motion.representation import Representation
from gesticulator.bundle import models
from gesticulator.bundle.config import Config
from gesticulator.bundle.features import Sizes, representation_of
from gesticulator.bundle.models import system_of
from gesticulator.training import fit as fitting
from gesticulator.training.stages.base import Figures, Node, Run, Stage
from gesticulator.training.stages.corpus import BLOCKS, MEASURED, Corpus, evenly, sizes
from gesticulator.training.stages.speech import CORPUS
from lexicon import inventory as inventories
from lexicon.autoencoder import Lexicon
from lexicon.movement import MovementLexicon, MovementVqVae
from lexicon.movement_vqvae import MovementLearner
from lexicon.quantizer import perplexity
from lexicon.racer import RacerCodec

BlockLexicon = Lexicon | MovementLexicon
"""A lexicon of beat-aligned blocks: the paper's VQ-VAE, or the lexicon of movements."""
Tokens = BlockLexicon | RacerCodec
"""A lexicon of beat-aligned blocks, or RACER's codec."""

_MOTION = ("motion.representation", "motion.joints", "motion.least_deviation")
"""Settings that affect the motion of the corpus."""
_TOGETHER = 4096
"""Blocks decoded at a time, to bound memory."""


def _fit_movements(run: Run, model: MovementLexicon) -> Figures:
    """Fit in closed form and by k-means, on the CPU, without steps."""
    corpus = run.get(BLOCKS)
    known = torch.as_tensor(corpus.some("train"))
    mask = corpus.mask[torch.as_tensor(corpus.recording)[known]]
    model.fit(corpus.motion[known], corpus.pasts[known], mask, run.seed(LEXICON))
    return _held_figures(run, model)


def _held_figures(run: Run, model: MovementLexicon) -> Figures:
    """`movement_figures` on the validation split (on the training split if it is empty)."""
    corpus = run.get(BLOCKS)
    held = torch.as_tensor(corpus.some("val") if corpus.recordings("val") else corpus.some("train"))
    return movement_figures(model, corpus.motion[held], corpus.pasts[held])


def _movements_task(run: Run, model: MovementVqVae) -> fitting.Task:
    """The VQ-VAE over movements: the basis in closed form, encoder, lexemes and decoder by steps, and the levels below
    by k-means."""
    corpus = run.get(BLOCKS)
    known = torch.as_tensor(corpus.some("train"))
    mask = corpus.mask[torch.as_tensor(corpus.recording)[known]]
    # Closed forms on the CPU in double precision, and the corpus need not fit on a GPU.
    model.cpu()
    model.basis.fit(corpus.motion[known], corpus.pasts[known], mask)
    present = model.basis.known(mask)
    coefficients = torch.cat([model.basis.coefficients(corpus.motion[part], corpus.pasts[part])
                              for part in known.split(_TOGETHER)]) * present
    learner = MovementLearner(model)

    def make_batch(rng: np.random.Generator, size: int) -> fitting.Batch:
        index = torch.as_tensor(rng.integers(len(known), size=size))
        return {"coefficients": coefficients[index], "known": present[index]}

    def finish() -> Figures:
        # Back on the CPU, where the coefficients of all blocks are.
        learner.cpu()
        learner.finish(coefficients, corpus.pasts[known], run.seed(LEXICON))
        return _held_figures(run, model)

    return fitting.Task(make_batch, before_step=_codebook_start(run, learner, coefficients), learner=learner,
                        finish=finish)


def _codebook_start(run: Run, learner: MovementLearner | Lexicon, rows: Tensor) -> Callable[[int], None]:
    """What starts the codebook from rows of the training split when the warm-up is over."""
    steps = run.schedule(LEXICON).steps
    begin = next((s for s in range(steps) if s / steps >= run.config.lexicon.warm_up), 0)

    def before_step(step: int) -> None:
        if step == begin:
            learner.start_codebook(rows.to(run.device), run.seed(LEXICON))

    return before_step


@torch.no_grad()
def movement_figures(lexicon: MovementLexicon, motion: Tensor, past: Pasts) -> Figures:
    """Mean squared errors (normalised features) of blocks [B, K, D_m] given their true pasts, for the predictor alone,
    the lexeme, lexeme and residual levels, and all coefficients; usage and perplexity."""
    true = lexicon.basis.coefficients(motion, past)
    labels = lexicon.nearest(true)
    levels = {"predicted": torch.zeros_like(true), "lexeme": lexicon.quantised(true, 0),
              "quantised": lexicon.quantised(true), "unquantised": true}
    return {**{name: _error(lexicon.basis.compose(level, past), motion) for name, level in levels.items()},
            **_use(labels, lexicon.size)}


def _error(decoded: Tensor, true: Tensor) -> float:
    return float((decoded - true).pow(2).mean())


def _use(labels: Tensor, size: int) -> Figures:
    return {"usage": float((torch.bincount(labels, minlength=size) > 0).float().mean()),
            "perplexity": perplexity(labels, size)}


def _lexicon_task(run: Run, model: BlockLexicon) -> fitting.Task | Figures:
    if isinstance(model, MovementVqVae):
        return _movements_task(run, model)
    if isinstance(model, MovementLexicon):
        return _fit_movements(run, model)
    corpus = run.get(BLOCKS)
    known, some, val = map(torch.as_tensor, (corpus.select("train"), corpus.some("train"), corpus.some("val")))
    recording = torch.as_tensor(corpus.recording)

    def make_batch(rng: np.random.Generator, size: int) -> fitting.Batch:
        index = known[torch.as_tensor(rng.integers(len(known), size=size))]
        return {"motion": corpus.motion[index], "mask": corpus.mask[recording[index]]}

    def validate() -> Figures:
        return lexicon_figures(model, corpus.motion[val if len(val) else some].to(run.device))

    return fitting.Task(make_batch, validate=validate, before_step=_codebook_start(run, model, corpus.motion[some]))


LEXICON: Stage[BlockLexicon] = Stage(
    "lexicon", settings=("system", "lexicon", *_MOTION), needs=lambda config: (BLOCKS,), schedule="lexicon",
    part="lexicon", train=_lexicon_task,
    build=lambda run: models.build("lexicon", sizes(run.config, run.get(BLOCKS))))


@torch.no_grad()
def lexicon_figures(lexicon: Lexicon, motion: Tensor) -> Figures:
    """Mean squared errors (normalised features) of motion [B, K, D_m] with and without quantisation, usage,
    perplexity."""
    latents = lexicon.latents(motion)
    labels = lexicon.quantizer.labels(latents)
    quantised = torch.cat([lexicon.decode(lexicon.vectors[part]) for part in labels.split(_TOGETHER)])
    plain = torch.cat([lexicon.decode(part) for part in latents.split(_TOGETHER)])
    return {"quantised": _error(quantised, motion), "unquantised": _error(plain, motion),
            **_use(labels, len(lexicon.vectors))}


def _starts(corpus: Corpus, split: str, length: int) -> NDArray[np.int64]:
    """Blocks of a split followed by at least `length` - 1 more of the same recording."""
    starts = [corpus.blocks_of(r)[:1 - length] for r in corpus.recordings(split) if len(corpus.blocks_of(r)) >= length]
    if not starts:
        raise InputError("store", f"has no recording of {length} codes in its {split} split",
                         "build it from longer recordings")
    return np.concatenate(starts)


def _codec_task(run: Run, model: RacerCodec) -> fitting.Task:
    """Train on windows of as many codes as a decision sees (120 frames in the paper)."""
    corpus, length = run.get(BLOCKS), run.config.cql.decisions
    known = _starts(corpus, "train", length)
    held = (_starts(corpus, "val", length) if corpus.recordings("val") else known)[::length]
    held, begun = (evenly(starts, MEASURED // length) for starts in (held, known[::length]))

    def crops(starts: NDArray[np.int64]) -> Tensor:
        return corpus.motion[torch.as_tensor(starts)[:, None] + torch.arange(length)].flatten(1, 2)

    def make_batch(rng: np.random.Generator, size: int) -> fitting.Batch:
        chosen = rng.choice(known, size)
        return {"motion": crops(chosen), "mask": corpus.mask[torch.as_tensor(corpus.recording[chosen])]}

    def before_step(step: int) -> None:
        if step == 0:
            model.start_codebook(crops(begun).to(run.device), run.seed(CODEC))

    return fitting.Task(make_batch, before_step=before_step,
                        validate=lambda: codec_figures(model, crops(held).to(run.device)))


@torch.no_grad()
def codec_figures(model: RacerCodec, true: Tensor) -> Figures:
    """As `lexicon_figures`, for motion [B, T, D_m]."""
    latents = model.encode(true)
    labels = model.quantizer.labels(latents.flatten(0, 1))
    decoded = model.decode(model.vectors[labels].unflatten(0, latents.shape[:2]))
    return {"quantised": _error(decoded, true), "unquantised": _error(model.decode(latents), true),
            **_use(labels, len(model.vectors))}


CODEC: Stage[RacerCodec] = Stage(
    "codec", settings=("racer", "cql.decisions", *_MOTION), needs=lambda config: (BLOCKS,), schedule="lexicon",
    part="lexicon", train=_codec_task,
    build=lambda run: models.build("lexicon", sizes(run.config, run.get(BLOCKS))))


def _of(config: Config) -> Stage[Any]:
    return CODEC if CODEC.name in system_of(config).STAGES else LEXICON


TOKENS: Node[Tokens] = Node("tokens", settings=(), needs=lambda config: (_of(config),),
                            make=lambda run: run.get(_of(run.config)))
"""The lexicon or the codec, depending on the settings."""


@torch.no_grad()
def decoded_blocks(tokens: Tokens, labels: NDArray[np.int64], corpus: Corpus) -> Tensor:
    """[N, K, D_m] every block decoded from its lexeme; movements are decoded from the block's own past."""
    if isinstance(tokens, Lexicon):
        return tokens.shown()[torch.as_tensor(labels)]
    if isinstance(tokens, MovementLexicon):
        return tokens.basis.compose(tokens.added(torch.as_tensor(labels)), corpus.pasts[:])
    rows = [tokens.decode_tokens(torch.as_tensor(labels[corpus.blocks_of(r)])[None])[0]
            for r in range(len(corpus.names))]
    return torch.cat(rows)


def token_labels(tokens: Tokens, corpus: Corpus) -> NDArray[np.int64]:
    """[N] the lexeme of every block."""
    if not isinstance(tokens, RacerCodec):
        # In parts, since all motion of a large corpus does not fit into memory.
        parts = torch.arange(len(corpus.motion)).split(_TOGETHER)
        return torch.cat([tokens.label(corpus.motion[part]) if isinstance(tokens, Lexicon)
                          else tokens.label(corpus.motion[part], corpus.pasts[part]) for part in parts]).numpy()
    out = np.empty(len(corpus.motion), dtype=np.int64)
    for recording in range(len(corpus.names)):
        blocks = corpus.blocks_of(recording)
        out[blocks] = tokens.label(corpus.motion[torch.as_tensor(blocks)].flatten(0, 1)[None])[0].numpy()
    return out


@dataclass(frozen=True)
class Labelled:
    """The labels of a corpus.

    labels: [N] lexemes; hinted: [N] the same, with a silent lexeme on every silent block; silent: the silent lexemes;
    nearest: [S] the nearest silent lexeme to each lexeme; active: [N] whether the block is a gesture; style_numbers:
    [N] 1 and up for training blocks, 0 for others; inventory: counts over the training split.
    """

    labels: NDArray[np.int64]
    hinted: NDArray[np.int64]
    silent: NDArray[np.int64]
    nearest: NDArray[np.int64]
    active: NDArray[np.bool_]
    style_numbers: NDArray[np.int64]
    inventory: inventories.Inventory


def lexeme_speeds(corpus: Corpus, labels: NDArray[np.int64], size: int, config: Config, most: int = 100
                  ) -> NDArray[np.float64]:
    """[S] mean speed of all joints in the training blocks of each lexeme, metres per second of normalised time.

    Measured on the blocks themselves (up to `most` per lexeme): a decoded lexeme is a mean, and its small errors from
    frame to frame would look like movement. A lexeme without blocks counts as infinitely fast.
    """
    train = corpus.select("train")
    speeds = np.full(size, np.inf)
    for lexeme in range(size):
        blocks = train[labels[train] == lexeme]
        # Evenly over all recordings: the first ones may be of one speaker.
        blocks = blocks[:: max(1, len(blocks) // most)][:most]
        if len(blocks):
            speeds[lexeme] = _mean_speed(corpus, blocks, representation_of(config), config.rhythm.fps)
    return speeds


def _mean_speed(corpus: Corpus, blocks: NDArray[np.int64], representation: Representation, fps: float) -> float:
    """Mean speed over blocks [B]."""
    speakers = corpus.speaker_of[corpus.recording[blocks]]
    # Speeds in metres need poses in radians, so the normalisation is undone.
    poses = np.stack([corpus.statistics.denormalise(corpus.motion[int(block)].double().numpy(), int(speaker))
                      for block, speaker in zip(blocks, speakers, strict=True)])
    places = positions_of(representation.motion(poses.reshape(-1, poses.shape[-1]), fps))
    moved = np.diff(places.reshape(*poses.shape[:2], *places.shape[1:]), axis=1)
    return float(np.linalg.norm(moved, axis=-1).mean() * fps)


def silent_lexemes(config: Config, corpus: Corpus, labels: NDArray[np.int64]) -> NDArray[np.int64]:
    """The silent lexemes from the settings, or detected: slow, and frequent in silence (RG 6.4.1)."""
    named, size = config.silence.lexemes, config.lexicon.size
    if not system_of(config).SILENCE:
        return np.zeros(0, dtype=np.int64)
    if named:
        if max(named) >= size:
            raise InputError("silence.lexemes", f"names {list(named)}", f"there are 0 to {size - 1}")
        return np.array(sorted(set(named)), dtype=np.int64)
    train = corpus.select("train")
    return inventories.silent_lexemes(lexeme_speeds(corpus, labels, size, config), labels[train], corpus.silent[train])


def label(config: Config, corpus: Corpus, tokens: Tokens) -> Labelled:
    """Label a corpus: lexemes, silent lexemes, the hint on silent blocks, and counts (RG 6.4.1, Eq. 24)."""
    labels = token_labels(tokens, corpus)
    train = corpus.select("train")
    silent = silent_lexemes(config, corpus, labels)
    nearest = inventories.nearest_silent(tokens.vectors.detach().double().numpy(), silent)
    # The silent hint (RG 6.4.1): silent blocks get the silent lexeme nearest to their own.
    hinted = np.where(corpus.silent & (config.silence.hint and len(silent) > 0), nearest[labels], labels)
    numbers = np.zeros(len(labels), dtype=np.int64)
    # 0 is the zero style code, for inserted silence and for blocks outside the training split.
    numbers[train] = np.arange(1, len(train) + 1)
    names = corpus.statistics.speakers
    counts = inventories.count(((names[corpus.speaker_of[r]], hinted[corpus.blocks_of(r)])
                                for r in corpus.recordings("train")), len(tokens.vectors))
    return Labelled(labels, hinted, silent, nearest, ~np.isin(labels, silent), numbers, counts)


LABELS: Node[Labelled] = Node(
    "labels", settings=("silence.lexemes",), needs=lambda config: (BLOCKS, TOKENS),
    make=lambda run: label(run.config, run.get(BLOCKS), run.get(TOKENS)))


def model_sizes(run: Run, training: bool = False) -> Sizes:
    """The model dimensions of the corpus and its lexicon; training: include a style code for every training block."""
    labelled, vectors = run.get(LABELS), run.get(TOKENS).vectors.cpu().numpy()
    return sizes(run.config, run.get(CORPUS), vectors=vectors, silent=tuple(labelled.silent.tolist()),
                 training_blocks=int(labelled.style_numbers.max()) if training else 0)
