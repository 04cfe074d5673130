"""A bundle: one folder with everything that inference needs.

`bundle.json` (format, versions, settings, skeleton, data fingerprint and licence, figures, SHA-256 of every file),
`MODEL_CARD.md` and `*.safetensors` in half precision. An unknown format, a different skeleton, a file with a wrong
hash and an unlisted file of weights are rejected with the name of the file. Each model is loaded when it is first used,
so generating one gesture reads no reward model; its tensor shapes are compared with the settings before memory is
allocated.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar, cast

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import save_file

from data_module.controls import Levels
from data_module.errors import InputError
from data_module.motion.skeletons import CHARACTERS
from gesticulator.bundle import files, models
from gesticulator.bundle.config import Config, from_dict, to_dict
from gesticulator.bundle.features import Features, Normaliser, Sizes, Statistics, representation_of
from interpreters import INTERPRETERS, entries
from interpreters.base import InterpreterParts, opened

if TYPE_CHECKING:
    from torch import nn

    from data_module.speech.speech_encoder import SpeechEncoder
    from data_module.text.word_vectors import WordEncoder
    from generator.flow import FlowGenerator
    from generator.model import Generator
    from interpreters.base import Interpreter
    from interpreters.lstm import LstmInterpreter, StyleInterpreter
    from interpreters.planner import UnitStyleInterpreter
    from interpreters.reward import RewardEnsemble
    from lexicon.autoencoder import Lexicon
    from lexicon.movement import MovementLexicon
    from lexicon.racer import RacerCodec

    BlockLexicon = Lexicon | MovementLexicon
    Tokens = Lexicon | MovementLexicon | RacerCodec

__all__ = ["Bundle", "load"]

P = TypeVar("P")
_STATISTICS = "statistics"


@dataclass(frozen=True)
class TextSource:
    """The word encoder that the interpreters were trained with. width: d_t + 1, including the flag of the empty
    word."""

    encoder: str
    width: int

    @classmethod
    def of(cls, config: Config, width: int) -> TextSource | None:
        """From the settings; None without text."""
        return cls(config.text.encoder, width) if config.text.encoder and width else None

    def open(self) -> WordEncoder:
        """The encoder; `InputError` if what is installed gives vectors of another width."""
        from data_module.text.word_vectors import WordEncoder

        words = WordEncoder.open(self.encoder)
        if words.width + 1 != self.width:
            # Vectors of another version would fit in shape and mean nothing to the models.
            raise InputError(self.encoder, "is not the word encoder that the bundle was trained with",
                             "install the same version")
        return words


class _Part(Generic[P]):
    """An attribute of `Bundle`: the trained model of the same name; None if the bundle lacks it."""

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    def __get__(self, bundle: Bundle, owner: type | None = None) -> P | None:
        # Not `Mapping.get`, which would hide a KeyError raised while loading.
        return cast("P", bundle.trained(self.name)) if self.name in bundle.parts else None


@dataclass(frozen=True)
class Bundle:
    """Trained models with their settings and statistics.

    parts: the trained models by name (`gesticulator.bundle.models.part_table`); those of a bundle read from disk are
    read when they are first used, as they are played (`runners`) or as they were trained (`trained`). vectors: [S, D_s]
    the codebook; rest_distances: [speakers, S] squared distance of each lexeme, in the codebook, from standing still in
    the speaker's resting pose. silent: the silent lexemes. frequencies: [speakers, S] of each lexeme, and transitions:
    [S, S] between lexemes, on the training split. text: the source of the word vectors. provenance: the training data,
    in plain values; figures: stage -> its validation figures.
    """

    config: Config
    statistics: Statistics
    silent: NDArray[np.int64]
    frequencies: NDArray[np.float64]
    transitions: NDArray[np.float64]
    vectors: Features
    rest_distances: NDArray[np.float32]
    parts: Mapping[str, Any]
    provenance: dict[str, Any]
    figures: dict[str, Any]
    text: TextSource | None = None

    @cached_property
    def runners(self) -> Mapping[str, Any]:
        """The parts by name as they are played, on arrays: without torch, each made when it is first used."""
        return models.LazyParts({name: partial(self._played, name) for name in self.parts})

    def _played(self, name: str) -> Any:
        part = self.parts[name]
        return part.played() if isinstance(part, models.StoredPart) else models.runner_of(name, self.sizes, part)

    def trained(self, name: str) -> Any:
        """The trained model of a part, for training and evaluation."""
        return self._trained[name]

    @cached_property
    def _trained(self) -> Mapping[str, Any]:
        return models.LazyParts({name: partial(part.trained) if isinstance(part, models.StoredPart) else part
                                 for name, part in self.parts.items()})

    @property
    def sizes(self) -> Sizes:
        """The sizes of its models that depend on the data."""
        s = self.statistics
        return Sizes(self.config, representation_of(self.config).width, len(s.low.mean), len(s.high.mean),
                     not np.array_equal(s.low.mean, s.high.mean), len(s.speakers), self.text.width if self.text else 0,
                     s.present, self.vectors, tuple(self.silent.tolist()))

    @property
    def lexicon(self) -> Tokens:
        """The gesture vocabulary: a lexicon of blocks, or RACER's codec."""
        return cast("Tokens", self.trained("lexicon"))

    @property
    def interpreter(self) -> LstmInterpreter:
        """The audio-only lexeme interpreter; KeyError in a bundle of RACER's codec."""
        return cast("LstmInterpreter", self.trained("interpreter"))

    generator: ClassVar[_Part[Generator | FlowGenerator]] = _Part()
    """Generates blocks at the beat; None in a bundle of RACER's codec."""
    style: ClassVar[_Part[StyleInterpreter | UnitStyleInterpreter]] = _Part()
    """The audio-only style interpreter; None if the generator takes no style codes."""
    encoder: ClassVar[_Part[SpeechEncoder]] = _Part()
    """The speech encoder."""
    reward: ClassVar[_Part[RewardEnsemble]] = _Part()
    """The reward that trained the policies; None unless it was added (`JUDGES`)."""
    reward_judge: ClassVar[_Part[RewardEnsemble]] = _Part()
    """The reward that evaluates them; None unless it was added (`JUDGES`)."""

    def with_parts(self, **changes: Any) -> Bundle:
        """A copy with other parts; None removes one. Parts that are not loaded yet stay so."""
        others = {name: part for name, part in self.parts.items() if name not in changes}
        return replace(self, parts={**others, **{name: part for name, part in changes.items() if part is not None}})

    @property
    def block_lexicon(self) -> BlockLexicon:
        """The lexicon of blocks at the beat; InputError for a bundle of RACER's codec."""
        if not self.system.BLOCKS:
            raise InputError("the bundle", "holds RACER's own codec, without lexicon, generator and style",
                             "use one of blocks at the beat (--preset default)")
        return cast("BlockLexicon", self.lexicon)

    @cached_property
    def system(self) -> models.System:
        """Its system, a module of `gesticulator.systems`."""
        return models.system_of(self.config)

    @property
    def frames(self) -> int:
        """K, frames per block."""
        return self.config.rhythm.frames

    @property
    def interpreters(self) -> tuple[str, ...]:
        """Names of the available interpreters; the first is the default."""
        return tuple(name for name, entry in entries().items() if not entry.part or entry.part in self.parts)

    def interpreter_named(self, name: str, text: bool = False) -> Interpreter:
        """The lexeme interpreter of that name; with `text`, the variant that reads the words, if any. InputError lists
        the available names."""
        if name not in self.interpreters:
            raise InputError(f"interpreter {name}", "is not in the bundle",
                             f"choose among {', '.join(self.interpreters)}")
        # With words, the variant that reads them; without one, the audio-only model serves.
        entry = entries()[name]
        part = entry.text_part if text and entry.text_part in self.parts else entry.part
        system = opened(INTERPRETERS.load(name), InterpreterParts(
            self.runners[part] if part else None, self.frequencies, self.transitions,
            getattr(self.config, entry.settings, None)))
        return system.guided(self.config.selection.interpreter_guidance)

    @property
    def levels(self) -> Levels | None:
        """The values of low, mid and high for each style feature; None if the models take no controls."""
        return self.statistics.levels if self.config.generator.use_control else None

    @property
    def speakers(self) -> tuple[str, ...]:
        """Names of the performers."""
        return self.statistics.speakers

    def rest_feature(self, speaker: int) -> Features:
        """[D_m] the speaker's resting pose, normalised."""
        return rest_feature(self.statistics, speaker)

    def rest_lexeme(self, speaker: int) -> int:
        """The silent lexeme nearest to standing still in the resting pose (a_0, s_0); any lexeme if none is silent, as
        in RACER's codec."""
        # At rest in silence a lexeme of stillness is taken, though a moving one may lie nearer.
        allowed = self.silent if len(self.silent) else np.arange(len(self.vectors))
        return int(allowed[int(self.rest_distances[speaker][allowed].argmin())])


def rest_feature(statistics: Statistics, speaker: int) -> Features:
    """[D_m] a speaker's resting pose, normalised."""
    return statistics.normalise(statistics.rest_pose[speaker], speaker).astype(np.float32)


def rest_distances(tokens: Tokens, statistics: Statistics) -> Features:
    """[speakers, S] squared distances of the codebook from standing still in each speaker's resting pose."""
    still = tokens.eval().still_distances
    return np.stack([still(tokens.vectors.new_tensor(rest_feature(statistics, speaker))).numpy()
                     for speaker in range(len(statistics.speakers))]).astype(np.float32)


# ------------------------------------------------------------------------------------------------------------ writing

def statistics_tensors(bundle: Bundle) -> dict[str, Features]:
    """The contents of `statistics.safetensors`."""
    s = bundle.statistics
    # Single precision: in half precision poses would shift by hundredths of a degree.
    arrays = {"mean_pose": s.mean_pose, "rest_pose": s.rest_pose, "deviation": s.deviation, "bounds": s.bounds,
              "frequencies": bundle.frequencies, "transitions": bundle.transitions,
              "rest_distances": bundle.rest_distances}
    arrays |= {"low_mean": s.low.mean, "low_spread": s.low.spread, "high_mean": s.high.mean,
               "high_spread": s.high.spread}
    if s.quiet_low is not None and s.quiet_high is not None:
        arrays.update({"quiet_low": s.quiet_low, "quiet_high": s.quiet_high})
    if s.levels is not None:
        arrays.update({f"levels_{key}": value for key, value in s.levels.to_dict().items()})
    return {key: np.ascontiguousarray(value, np.float32) for key, value in arrays.items()}


def _half(model: nn.Module) -> dict[str, NDArray[Any]]:
    arrays = {key: value.detach().cpu().numpy() for key, value in models.trained_tensors(model).items()}
    return {key: np.asarray(value, np.float16 if np.issubdtype(value.dtype, np.floating) else value.dtype, order="C")
            for key, value in arrays.items()}


def save(bundle: Bundle, path: str | Path, card: str) -> None:
    """Write a bundle atomically; an existing bundle is replaced, any other folder is left alone."""
    def write(folder: Path) -> None:
        # In one order, which decides the file that holds a shared tensor. Policies are played without the models that
        # judge them, so those are no parts here.
        parts = {name: part for name, part in models.part_table().items() if name in bundle.parts}
        weights = {part.file: _half(bundle.trained(name)) for name, part in parts.items()}
        shared = files.shared_tensors(weights)
        for part in parts.values():
            # A tied part names its codebook, because lexeme 7 of another one is another gesture.
            tied = {files.TIED: files.lexicon_hash(bundle.vectors)} if part.tied else None
            save_file({key: value for key, value in weights[part.file].items() if key not in shared[part.file]},
                      folder / f"{part.file}{files.ENDING}", tied)
        save_file(statistics_tensors(bundle), folder / f"{_STATISTICS}{files.ENDING}")
        (folder / files.CARD).write_text(card, encoding="utf-8")
        files.write_index(folder, CHARACTERS[bundle.config.motion.joints], {
            "config": to_dict(bundle.config), "speakers": list(bundle.speakers),
            "silent_lexemes": bundle.silent.tolist(), "lexicon_hash": files.lexicon_hash(bundle.vectors),
            "text": {"encoder": bundle.text.encoder, "width": bundle.text.width} if bundle.text else None,
            "audio_levels": 1 if np.array_equal(bundle.statistics.low.mean, bundle.statistics.high.mean) else 2,
            "shared": {name: holders for name, holders in shared.items() if holders},
            "provenance": bundle.provenance, "figures": bundle.figures})

    files.replace_folder(Path(path), write)


def load(path: str | Path) -> Bundle:
    """Open a bundle; InputError if it is broken, of another format, or does not match its hashes.

    The settings, the statistics and the codebook are read at once; each model when it is first used, which may raise
    InputError as well.
    """
    folder = Path(path)
    index = files.read_index(folder)
    try:
        config = from_dict(Config, index["config"])
    except InputError as error:  # settings come and go between versions
        raise InputError(folder / files.INDEX, f"has other settings than this version ({error.subject} {error.wrong})",
                         "use the version that wrote it, or train it again") from None
    # Joints in another order would move the wrong limbs.
    if index["skeleton"].get("names") != list(CHARACTERS[config.motion.joints].names):
        raise InputError(folder / files.INDEX, "was trained on another skeleton", "train it again")
    weights = files.Weights(folder, index)
    # Which parts are optional depends on the settings; the others must be there.
    system = models.system_of(config)
    required = ("lexicon", *system.PARTS, *(("style",) if system.BLOCKS and config.generator.styled else ()))
    lacking = [name for name in required if models.part_table()[name].file not in weights]
    if lacking:
        raise InputError(folder, f"lacks {', '.join(lacking)}", "copy the bundle again")
    # Before any weights: the width of word vectors decides shapes of the interpreters.
    text = None if index["text"] is None else TextSource(**index["text"])
    speakers, silent = tuple(index["speakers"]), np.array(index["silent_lexemes"], dtype=np.int64)
    # Frequencies and distances lie in the file of the statistics, but belong to the lexicon.
    statistics, tensors = _statistics(weights, config, speakers)
    sizes = Sizes(config, representation_of(config).width, len(statistics.low.mean), len(statistics.high.mean),
                  index["audio_levels"] == 2, len(speakers), text.width if text else 0, statistics.present,
                  silent=tuple(silent.tolist()))
    # The shapes of some models depend on the codebook.
    vectors = _codebook(weights, config)
    if len(silent) and silent.max() >= len(vectors):
        raise InputError(folder / files.INDEX, f"names silent lexemes beyond the {len(vectors)} of the lexicon",
                         "copy the bundle again")
    return Bundle(config, statistics, silent, tensors["frequencies"], tensors["transitions"], vectors,
                  tensors["rest_distances"].astype(np.float32),
                  models.stored_parts(weights, replace(sizes, vectors=vectors)), index["provenance"], index["figures"],
                  text)


def _codebook(weights: files.Weights, config: Config) -> Features:
    """[S, D_s] the vectors of the lexemes, from the file of the lexicon."""
    system, name = models.system_of(config), models.part_table()["lexicon"].file
    vectors = weights.read(name).get(system.CODEBOOK)
    if vectors is None or tuple(vectors.shape) != system.codebook_shape(config):
        raise InputError(weights.path(name), f"does not fit the settings ({system.CODEBOOK})", "train it again")
    return vectors


def _statistics(weights: files.Weights, config: Config, speakers: tuple[str, ...]
                ) -> tuple[Statistics, dict[str, NDArray[np.float64]]]:
    """The statistics, and all arrays of their file."""
    # Stored in single precision; in double, normalising and its inverse do not drift apart.
    tensors = {key: value.astype(np.float64) for key, value in weights.read(_STATISTICS).items()}
    levels = {key.removeprefix("levels_"): value for key, value in tensors.items() if key.startswith("levels_")}
    motion, count = representation_of(config).width, len(speakers)
    size, _ = models.system_of(config).codebook_shape(config)
    shapes = {"mean_pose": (count, motion), "rest_pose": (count, motion), "deviation": (motion,),
              "bounds": (2, motion), "frequencies": (count, size), "transitions": (size, size),
              "rest_distances": (count, size)}
    wrong = [name for name, shape in shapes.items() if name not in tensors or tensors[name].shape != shape]
    try:
        if wrong:
            raise ValueError(wrong[0])
        return Statistics(
            speakers, tensors["mean_pose"], tensors["rest_pose"], tensors["deviation"], tensors["bounds"],
            Normaliser(tensors["low_mean"], tensors["low_spread"]),
            Normaliser(tensors["high_mean"], tensors["high_spread"]), tensors.get("quiet_low"),
            tensors.get("quiet_high"), Levels.from_dict(levels) if levels else None), tensors
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(weights.path(_STATISTICS), f"does not fit the settings ({error})", "train it again") from None
