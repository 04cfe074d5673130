"""A bundle: one folder that holds everything inference needs.

`bundle.json` (format, versions, settings, skeleton, data fingerprint and licence, figures, SHA-256 of every file),
`MODEL_CARD.md` and `*.safetensors` in half precision. It is written to a temporary folder, synced and renamed. An
unknown format, a foreign skeleton, a file that is not what its hash says and a file of weights that nobody listed are
refused by name. A model is opened when it is asked for, so that drawing one gesture reads no reward model; its shapes
are compared with the settings before memory is taken for it.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.torch import load as load_tensors
from safetensors.torch import save_file
from torch import Tensor, nn

from data_module.controls import Levels
from data_module.errors import InputError
from data_module.json_files import parse_json, read_object
from data_module.layers import freeze
from data_module.motion.skeletons import CHARACTER, CHARACTERS
from data_module.types import Skeleton
from gesticulator.bundle.config import Config, from_dict, section, to_dict
from gesticulator.bundle.features import Normaliser, Statistics, representation_of
from gesticulator.bundle.models import BUILDERS, Sizes, codebook_name, codebook_shape, shapes
from gesticulator.bundle.system import System, system_of
from gesticulator.version import __version__
from interpreters import INTERPRETERS
from interpreters.base import InterpreterParts

if TYPE_CHECKING:
    from data_module.speech.speech_encoder import SpeechEncoder
    from generator.flow import FlowGenerator
    from generator.model import Generator
    from interpreters.advantage import Critics
    from interpreters.base import Interpreter
    from interpreters.cql import QNetwork
    from interpreters.gate import ActivityGate
    from interpreters.lstm import LstmInterpreter, StyleInterpreter
    from interpreters.reward import RewardEnsemble
    from interpreters.statistical import StatisticalInterpreter
    from lexicon.autoencoder import Lexicon
    from lexicon.movement import MovementLexicon
    from lexicon.racer import RacerCodec

    BlockLexicon = Lexicon | MovementLexicon
    Tokens = Lexicon | MovementLexicon | RacerCodec

__all__ = ["Bundle", "load"]

FORMAT = 6
"""Format 5 had another flow head; format 4 knew no lexicon of movements, no flow head and no fingers; format 3 had
other names of settings and tensors and no resting distances (see `gesticulator.bundle.upgrade`)."""
OLDER = (1, 2, 3, 4, 5)
"""Formats that `gesticulator bundle upgrade` can bring to this one."""
INDEX = "bundle.json"
CARD = "MODEL_CARD.md"
SHIPPED = Path(__file__).parents[1] / "assets" / "bundle"
"""The bundle that comes with the package."""
FILES = {"lexicon": "lexicon", "generator": "generator", "interpreter": "lexeme_interpreter",
         "style": "style_interpreter", "interpreter_text": "lexeme_interpreter_text",
         "style_text": "style_interpreter_text", "encoder": "speech_encoder", "gate": "gate", "q_network": "q_network",
         "advantage": "advantage"}
"""Part of a bundle -> its file, without the ending; only the lexicon is never absent."""
JUDGES = ("reward", "reward_judge")
"""Models that teach and judge a policy and play nothing: they stay in the work folder of the training, and whoever
measures adds them to an opened bundle (`with_parts`). A bundle that is written leaves them out."""
_OVER_LEXICON = ("q_network", "advantage")
"""Parts that are worthless over another codebook than they were trained on."""
_NO_BLOCKS = "holds RACER's own codec, without lexicon, generator and style"
_TIED = "lexicon_hash"
_STATISTICS = "statistics"
_ENDING = ".safetensors"
_LARGEST_INDEX = 16 * 2**20
"""Bytes: a list of files, settings and figures is a thousand times smaller."""
_HEADER = 2**20
"""Bytes that the header of a file of weights may take beside its tensors."""
_LARGEST_STATISTICS = 256 * 2**20
"""Bytes: the transition matrix of 8,192 lexemes."""
_MOST_SPEAKERS = 10_000


@dataclass(frozen=True)
class TextSource:
    """The word encoder that the interpreters were trained on. width: d_t + 1, with the flag of the empty word."""

    encoder: str
    width: int

    @classmethod
    def of(cls, config: Config, width: int) -> TextSource | None:
        """None where no text was read."""
        return cls(config.text.encoder, width) if config.text.encoder and width else None


@dataclass(frozen=True)
class BlockModels:
    """What a bundle of blocks at the beat cannot do without."""

    lexicon: BlockLexicon
    generator: Generator | FlowGenerator
    interpreter: LstmInterpreter
    style: StyleInterpreter | None


@dataclass(frozen=True)
class Bundle:
    """Trained models and all that goes with them.

    parts: the models by name (see `FILES`); of a bundle that was read, each is opened when it is asked for. vectors:
    [S, D_s] the codebook; rest_distances: [speakers, S] how far each lexeme is from standing still in the speaker's
    resting pose, in the codebook's own (squared) distance. silent: the silent lexemes. frequencies: [speakers, S] how
    often each uses each lexeme, and transitions: [S, S] what follows what, on the training split. text: where the word
    vectors come from. provenance: what the weights were trained on, in plain values; figures: stage -> its figures on
    the validation split.
    """

    config: Config
    statistics: Statistics
    silent: NDArray[np.int64]
    frequencies: NDArray[np.float64]
    transitions: NDArray[np.float64]
    vectors: Tensor
    rest_distances: NDArray[np.float32]
    parts: Mapping[str, nn.Module]
    provenance: dict[str, Any]
    figures: dict[str, Any]
    text: TextSource | None = None

    def _part(self, name: str) -> nn.Module | None:
        """A part, opened; not `Mapping.get`, to which a KeyError on the way would look like absence."""
        return self.parts[name] if name in self.parts else None  # noqa: SIM401

    # The parts, by attribute: those that every bundle of blocks has, and those that may be absent.
    @property
    def lexicon(self) -> Tokens:
        """What names gestures."""
        return cast("Tokens", self.parts["lexicon"])

    @property
    def generator(self) -> Generator | FlowGenerator | None:
        """What draws blocks at the beat; None in a bundle of RACER's own."""
        return cast("Generator | FlowGenerator | None", self._part("generator"))

    @property
    def interpreter(self) -> LstmInterpreter | None:
        """The lexeme interpreter that hears alone."""
        return cast("LstmInterpreter | None", self._part("interpreter"))

    @property
    def interpreter_text(self) -> LstmInterpreter | None:
        """The lexeme interpreter that reads the words too."""
        return cast("LstmInterpreter | None", self._part("interpreter_text"))

    @property
    def style(self) -> StyleInterpreter | None:
        """The style interpreter that hears alone; None where the generator takes no style codes."""
        return cast("StyleInterpreter | None", self._part("style"))

    @property
    def style_text(self) -> StyleInterpreter | None:
        """The style interpreter that reads the words too."""
        return cast("StyleInterpreter | None", self._part("style_text"))

    @property
    def encoder(self) -> SpeechEncoder | None:
        """The speech levels."""
        return cast("SpeechEncoder | None", self._part("encoder"))

    @property
    def gate(self) -> ActivityGate | None:
        """Whether to gesture at all."""
        return cast("ActivityGate | None", self._part("gate"))

    @property
    def q_network(self) -> QNetwork | None:
        """RACER's Q-network."""
        return cast("QNetwork | None", self._part("q_network"))

    @property
    def advantage(self) -> Critics | None:
        """What lexemes are worth beyond the behaviour policy's own."""
        return cast("Critics | None", self._part("advantage"))

    @property
    def reward(self) -> RewardEnsemble | None:
        """The reward that taught the policies; None unless it was added (`JUDGES`)."""
        return cast("RewardEnsemble | None", self._part("reward"))

    @property
    def reward_judge(self) -> RewardEnsemble | None:
        """The reward that judges them; None unless it was added (`JUDGES`)."""
        return cast("RewardEnsemble | None", self._part("reward_judge"))

    def with_parts(self, **changes: nn.Module | None) -> Bundle:
        """A copy with other parts; None takes one out. A part that is not opened yet stays so."""
        return replace(self, parts=_Changed(self.parts, changes))

    @property
    def block_models(self) -> BlockModels:
        """Lexicon, generator and interpreters of Rhythmic Gesticulator; InputError for a bundle of RACER's own."""
        if not self.system.blocks or not (self.generator and self.interpreter):
            raise InputError("the bundle", _NO_BLOCKS, "use one of blocks at the beat (--preset default)")
        return BlockModels(cast("BlockLexicon", self.lexicon), self.generator, self.interpreter, self.style)

    @cached_property
    def system(self) -> System:
        """What names gestures, what draws them, and what follows from that."""
        return system_of(self.config)

    @property
    def code_width(self) -> int:
        """d_z, 0 where the generator takes no style codes."""
        return self.config.generator.style_width if self.config.generator.styled else 0

    @property
    def frames(self) -> int:
        """K, frames per block."""
        return self.config.rhythm.frames

    @property
    def interpreters(self) -> tuple[str, ...]:
        """Names of the interpreters that it holds; the first is taken when none is named."""
        return tuple(name for name, entry in INTERPRETERS.usable().items()
                     if not entry.part or entry.part in self.parts)

    def interpreter_named(self, name: str, text: bool = False) -> Interpreter:
        """The lexeme interpreter of that name; with `text`, the one that reads the words where there is one.

        InputError lists those that the bundle has.
        """
        if name not in self.interpreters:
            raise InputError(f"interpreter {name}", "is not in the bundle",
                             f"choose among {', '.join(self.interpreters)}")
        entry = INTERPRETERS[name]
        part = entry.text_part if text and entry.text_part in self.parts else entry.part
        opened: Interpreter = entry.load().open(InterpreterParts(
            self.parts[part] if part else None, self.interpreter_named(entry.prior, text) if entry.prior else None,
            self.frequencies, self.transitions, section(self.config, entry.settings), self.config.selection.beta))
        return opened.guided(self.config.selection.interpreter_guidance)

    @property
    def levels(self) -> Levels | None:
        """What low, mid and high mean for each feature of style; None where the models hear no control."""
        return self.statistics.levels if self.config.generator.use_control else None

    @property
    def speakers(self) -> tuple[str, ...]:
        """Names of the performers."""
        return self.statistics.speakers

    def statistical(self) -> StatisticalInterpreter:
        """The speech-blind interpreter over the same lexicon."""
        from interpreters.statistical import StatisticalInterpreter

        return StatisticalInterpreter(self.frequencies, self.transitions, self.config.statistical)

    def rest_feature(self, speaker: int) -> Tensor:
        """[D_m] the speaker's resting pose as the models see it."""
        return rest_feature(self.statistics, speaker, self.vectors.device)

    def rest_lexeme(self, speaker: int) -> int:
        """The silent lexeme nearest to standing still in the resting pose (a_0, s_0); any lexeme where none is
        silent, as in RACER's codec."""
        allowed = self.silent if len(self.silent) else np.arange(len(self.vectors))
        return int(allowed[int(self.rest_distances[speaker][allowed].argmin())])


class _Changed(Mapping[str, nn.Module]):
    """Parts with some of them replaced or taken out; the others are asked for only when they are wanted."""

    def __init__(self, parts: Mapping[str, nn.Module], changes: Mapping[str, nn.Module | None]) -> None:
        unknown = sorted(set(changes) - {*FILES, *JUDGES})
        if unknown:
            raise ValueError(f"no parts of a bundle: {', '.join(unknown)}")
        self._parts, self._changes = parts, dict(changes)

    def __getitem__(self, name: str) -> nn.Module:
        if name not in self._changes:
            return self._parts[name]
        changed = self._changes[name]
        if changed is None:
            raise KeyError(name)
        return changed

    def __iter__(self) -> Iterator[str]:
        names = [*self._parts, *(name for name in self._changes if name not in self._parts)]
        return (name for name in names if self._changes.get(name, self) is not None)

    def __len__(self) -> int:
        return sum(1 for _ in self)


def rest_feature(statistics: Statistics, speaker: int, device: torch.device | None = None) -> Tensor:
    """[D_m] a speaker's resting pose as the models see it."""
    rest = statistics.normalise(statistics.rest_pose[speaker], speaker)
    return torch.as_tensor(rest, dtype=torch.float32, device=device)


@torch.no_grad()
def rest_distances(tokens: Tokens, statistics: Statistics) -> NDArray[np.float32]:
    """[speakers, S] squared distances of the codebook from standing still in each speaker's resting pose."""
    return np.stack([tokens.eval().still_distances(rest_feature(statistics, speaker)).numpy()
                     for speaker in range(len(statistics.speakers))]).astype(np.float32)


def lexicon_hash(vectors: Tensor) -> str:
    """SHA-256 of a codebook [S, D_s], which ties an interpreter to its lexicon."""
    return hashlib.sha256(vectors.detach().half().cpu().numpy().tobytes()).hexdigest()


# ------------------------------------------------------------------------------------------------------------ writing

def statistics_tensors(bundle: Bundle) -> dict[str, Tensor]:
    """What `statistics.safetensors` holds."""
    s = bundle.statistics
    arrays = {"mean_pose": s.mean_pose, "rest_pose": s.rest_pose, "deviation": s.deviation, "bounds": s.bounds,
              "frequencies": bundle.frequencies, "transitions": bundle.transitions,
              "rest_distances": bundle.rest_distances}
    for name, normaliser in (("low", s.low), ("high", s.high)):
        arrays.update({f"{name}_{key}": value for key, value in normaliser.to_dict().items()})
    if s.quiet_low is not None and s.quiet_high is not None:
        arrays.update({"quiet_low": s.quiet_low, "quiet_high": s.quiet_high})
    if s.levels is not None:
        arrays.update({f"levels_{key}": value for key, value in s.levels.to_dict().items()})
    return {key: torch.as_tensor(np.ascontiguousarray(value), dtype=torch.float32) for key, value in arrays.items()}


def _half(module: nn.Module) -> dict[str, Tensor]:
    # The table of style codes belongs to the training blocks; nothing at inference looks into it ("styles.").
    return {key: (value.half() if value.is_floating_point() else value).contiguous().cpu()
            for key, value in module.state_dict().items() if not key.startswith("styles.")}


def save(bundle: Bundle, path: str | Path, card: str) -> None:
    """Write a bundle whole or not at all; a bundle that is already there is replaced, anything else is left alone."""
    def write(folder: Path) -> None:
        for name, module in bundle.parts.items():
            if name in JUDGES:
                continue
            tied = {_TIED: lexicon_hash(bundle.vectors)} if name in _OVER_LEXICON else None
            save_file(_half(module), folder / f"{FILES[name]}{_ENDING}", tied)
        save_file(statistics_tensors(bundle), folder / f"{_STATISTICS}{_ENDING}")
        (folder / CARD).write_text(card, encoding="utf-8")
        write_index(folder, {
            "config": to_dict(bundle.config), "speakers": list(bundle.speakers),
            "silent_lexemes": bundle.silent.tolist(), "lexicon_hash": lexicon_hash(bundle.vectors),
            "text": {"encoder": bundle.text.encoder, "width": bundle.text.width} if bundle.text else None,
            "audio_levels": 2 if _two_levels(bundle) else 1,
            "provenance": bundle.provenance, "figures": bundle.figures})

    replace_folder(Path(path), write)


def _two_levels(bundle: Bundle) -> bool:
    low, high = bundle.statistics.low, bundle.statistics.high
    return len(low.mean) != len(high.mean) or not np.array_equal(low.mean, high.mean)


def write_index(folder: Path, index: dict[str, Any]) -> None:
    """Write `bundle.json` with the hashes of all files that are there."""
    skeleton = _skeleton_of(index["config"])
    index = {"format": FORMAT,
             "made_by": {"gesticulator": __version__, "torch": torch.__version__.split("+")[0],
                         "python": platform.python_version()},
             "skeleton": {"names": list(skeleton.names), "parents": list(skeleton.parents),
                          "offsets": skeleton.offsets.tolist()},
             **index, "files": {file.name: hashlib.sha256(file.read_bytes()).hexdigest()
                                for file in sorted(folder.iterdir()) if file.name != INDEX}}
    (folder / INDEX).write_text(json.dumps(index, indent=1, sort_keys=True) + "\n", encoding="utf-8")


def replace_folder(target: Path, write: Any) -> None:
    """Put what `write(folder)` writes in the place of a bundle, whole or not at all; InputError for anything else that
    is there."""
    if target.exists() and not (target / INDEX).is_file() and not (target.is_dir() and not any(target.iterdir())):
        raise InputError(target, "exists and is not a bundle", "choose another path")
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = Path(tempfile.mkdtemp(dir=target.parent, prefix=f".{target.name}."))
    try:
        write(temporary)
        temporary.chmod(0o755)  # mkdtemp and safetensors keep others out; a bundle is there to be shared
        for file in temporary.iterdir():
            file.chmod(0o644)
            _sync(file)
        _sync(temporary)
        if target.exists():
            old = temporary.with_name(temporary.name + ".old")
            target.rename(old)
            temporary.rename(target)
            shutil.rmtree(old)
        else:
            temporary.rename(target)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        raise


def _sync(path: Path) -> None:
    """Have the disk hold a file (or a folder's list of files) before it is relied on."""
    if path.is_dir() and os.name == "nt":
        return  # Windows opens no folders
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


# ------------------------------------------------------------------------------------------------------------ reading

def read_json(path: Path) -> dict[str, Any]:
    """A JSON object from a file; InputError for anything else, however it is broken."""
    return read_object(path, "copy the bundle again", _LARGEST_INDEX)


_KINDS: dict[str, Any] = {"config": dict, "skeleton": dict, "speakers": list, "silent_lexemes": list, "files": dict,
                          "provenance": dict, "figures": dict, "audio_levels": int, "text": (dict, type(None))}
"""What `bundle.json` must hold."""


def read_index(path: str | Path) -> dict[str, Any]:
    """`bundle.json`, after the checks that need no weights; InputError for one that is broken or foreign."""
    folder = Path(path)
    file = folder / INDEX
    if not folder.exists():
        raise InputError(folder, "does not exist", "give the folder of a bundle, or leave --bundle out")
    if not file.is_file():
        raise InputError(folder, f"is not a bundle (no {INDEX})", "give a folder that gesticulator train made")
    index = read_json(file)
    version = index.get("format")
    if version != FORMAT or isinstance(version, bool):
        advice = (f"run gesticulator bundle upgrade {folder} NEW" if version in OLDER
                  else "train it again or use the matching version")
        raise InputError(file, f"has format {str(version)[:20]}, and this version reads format {FORMAT}", advice)
    lacking = [key for key in _KINDS if key not in index]
    if lacking:
        raise InputError(file, f"lacks {', '.join(lacking)}", "copy the bundle again")
    wrong = [key for key, kind in _KINDS.items() if not isinstance(index[key], kind)]
    if not wrong:
        wrong = [name for name, fine in (
            ("speakers", _strings(index["speakers"]) and 0 < len(index["speakers"]) <= _MOST_SPEAKERS),
            ("silent_lexemes", all(type(n) is int and 0 <= n < 2**31 for n in index["silent_lexemes"])),
            ("audio_levels", index["audio_levels"] in (1, 2)),
            ("files", _strings(index["files"].values())),
            ("figures", all(isinstance(own, dict) for own in index["figures"].values()))) if not fine]
    if wrong:
        raise InputError(file, f"holds something else than it should under {', '.join(wrong)}",
                         "copy the bundle again")
    if index["skeleton"].get("names") != list(_skeleton_of(index["config"]).names):
        raise InputError(file, "was trained on another skeleton", "train it again")
    return index


def _skeleton_of(config: Mapping[str, Any]) -> Skeleton:
    """The character that settings as they stand in a file draw: older ones do not say, and mean the papers' joints."""
    motion = config.get("motion")
    joints = motion.get("joints") if isinstance(motion, Mapping) else None
    return CHARACTERS[joints] if type(joints) is int and joints in CHARACTERS else CHARACTER


def _strings(values: Any) -> bool:
    return all(isinstance(value, str) for value in values)


class Weights:
    """The files of a bundle, each checked when it is read: listed, of the listed hash, of the right shapes, finite."""

    def __init__(self, folder: Path, listed: Mapping[str, str]) -> None:
        """InputError when a listed file is missing, or when there are weights that the list leaves out."""
        self.folder, self.listed = folder, listed
        for name in listed:
            if Path(name).name != name or not (folder / name).is_file():
                raise InputError(folder / name[:200], "is missing from the bundle", "copy the bundle again")
        for file in sorted(folder.glob(f"*{_ENDING}")):
            if file.name not in listed:
                raise InputError(file, f"is not in the list of {INDEX}", "delete it, or copy the bundle again")

    def __contains__(self, name: str) -> bool:
        return f"{name}{_ENDING}" in self.listed

    def tensor(self, name: str, key: str, shape: tuple[int, ...]) -> Tensor:
        """One tensor of a file, which must have this shape, in single precision."""
        file = self._listed(name)
        digest = hashlib.sha256()
        with file.open("rb") as stream:
            while part := stream.read(_HEADER):
                digest.update(part)
        self._check_hash(file, digest.hexdigest())
        try:
            with safe_open(file, framework="pt") as opened:
                found = tuple(opened.get_slice(key).get_shape()) if key in opened.keys() else ()  # noqa: SIM118
                if found != shape:
                    raise InputError(file, f"does not fit the settings ({_difference({key: found}, {key: shape})})",
                                     "train it again")
                return _finite(file, {key: opened.get_tensor(key)})[key]
        except _BROKEN as error:
            raise InputError(file, f"is broken ({str(error).splitlines()[0][:100]})", "copy the bundle again") from None

    def _listed(self, name: str) -> Path:
        file = self.folder / f"{name}{_ENDING}"
        if file.name not in self.listed:
            raise InputError(file, "is missing from the bundle", "copy the bundle again")
        return file

    def _check_hash(self, file: Path, found: str) -> None:
        if found != self.listed[file.name]:
            raise InputError(file, "is not the file that the bundle was made with (wrong SHA-256)",
                             "copy the bundle again")

    def read(self, name: str, shapes: Mapping[str, tuple[int, ...]] | None, tied: str | None = None
             ) -> dict[str, Tensor]:
        """The tensors of a file in single precision.

        shapes: what they must be; None for a file whose shapes are checked by its reader. tied: the hash of the
        codebook that the file must have been trained over.
        """
        file = self._listed(name)
        largest = _LARGEST_STATISTICS if shapes is None else _HEADER + sum(8 * _size(s) for s in shapes.values())
        if file.stat().st_size > largest:
            raise InputError(file, "is larger than the settings say", "train it again")
        data = file.read_bytes()
        self._check_hash(file, hashlib.sha256(data).hexdigest())
        header = _header(file, data)
        if shapes is not None and _shapes_of(header) != dict(shapes):
            raise InputError(file, f"does not fit the settings ({_difference(_shapes_of(header), shapes)})",
                             "train it again")
        if tied is not None and header.get("__metadata__", {}).get(_TIED) != tied:
            raise InputError(file, "was trained over another lexicon than the bundle's",
                             f"train it again (gesticulator train --redo {name})")
        try:
            return _finite(file, load_tensors(data))
        except _BROKEN as error:
            raise InputError(file, f"is broken ({str(error).splitlines()[0][:100]})", "copy the bundle again") from None


_BROKEN = (SafetensorError, ValueError, KeyError, RuntimeError, OverflowError)
"""What reading a file of tensors may end in."""


def _finite(file: Path, tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    """Tensors in single precision; InputError where one holds NaN or infinity."""
    broken = next((key for key, value in tensors.items() if not bool(torch.isfinite(value).all())), None)
    if broken is not None:
        raise InputError(file, f"holds values that are no numbers ({broken})", "train it again")
    return {key: value.float() if value.is_floating_point() else value for key, value in tensors.items()}


def _header(file: Path, data: bytes) -> dict[str, Any]:
    text = data[8:8 + min(int.from_bytes(data[:8], "little"), _HEADER)]
    header = parse_json(text, file, "copy the bundle again")
    if isinstance(header, dict) and isinstance(header.get("__metadata__", {}), dict):
        return header
    raise InputError(file, "is broken (no header of tensors)", "copy the bundle again")


def _shapes_of(header: Mapping[str, Any]) -> dict[str, tuple[int, ...]]:
    return {key: tuple(value["shape"]) if isinstance(value, dict) and isinstance(value.get("shape"), list) else ()
            for key, value in header.items() if key != "__metadata__"}


def _size(shape: tuple[int, ...]) -> int:
    size = 1
    for length in shape:
        size *= length
    return size


def _difference(found: Mapping[str, tuple[int, ...]], wanted: Mapping[str, tuple[int, ...]]) -> str:
    name = next(key for key in sorted({*found, *wanted}) if found.get(key) != wanted.get(key))
    return f"{name[:80]}: {found.get(name, 'absent')} instead of {wanted.get(name, 'absent')}"


class StoredParts(Mapping[str, nn.Module]):
    """The models of a bundle on disk, each opened when it is asked for first."""

    def __init__(self, weights: Weights, sizes: Sizes) -> None:
        self._weights, self._sizes = weights, sizes
        self._opened: dict[str, nn.Module] = {}

    def __getitem__(self, name: str) -> nn.Module:
        if name not in self._opened:
            if FILES.get(name, "") not in self._weights:
                raise KeyError(name)
            tied = lexicon_hash(self._sizes.lexemes) if name in _OVER_LEXICON else None
            tensors = self._weights.read(FILES[name], shapes(name, self._sizes), tied)
            model = BUILDERS[name](self._sizes)
            model.load_state_dict(tensors)
            self._opened[name] = freeze(model)
        return self._opened[name]

    def __contains__(self, name: object) -> bool:
        return FILES.get(str(name), "") in self._weights

    def __iter__(self) -> Iterator[str]:
        return (name for name in FILES if name in self)

    def __len__(self) -> int:
        return sum(1 for _ in self)


def required(config: Config) -> tuple[str, ...]:
    """Parts that a bundle of these settings cannot do without."""
    system = system_of(config)
    return "lexicon", *system.drawing.parts, *(("style",) if system.blocks and config.generator.styled else ())


def load(path: str | Path) -> Bundle:
    """Open a bundle; InputError for one that is broken, foreign or not what its hashes say.

    The settings, the statistics and the codebook are read at once; a model when it is asked for, which may raise
    InputError in its turn.
    """
    folder = Path(path)
    index = read_index(folder)
    config = from_dict(Config, index["config"])
    weights = Weights(folder, index["files"])
    lacking = [name for name in required(config) if FILES[name] not in weights]
    if lacking:
        raise InputError(folder, f"lacks {', '.join(lacking)}", "copy the bundle again")
    text = _text_source(folder, index["text"])
    speakers, silent = tuple(index["speakers"]), np.array(index["silent_lexemes"], dtype=np.int64)
    statistics, tensors = _statistics(folder, weights, config, speakers)
    sizes = Sizes(config, representation_of(config).width, len(statistics.low.mean), len(statistics.high.mean),
                  index["audio_levels"] == 2, len(speakers), text.width if text else 0, statistics.present,
                  silent=tuple(silent.tolist()))
    vectors = weights.tensor(FILES["lexicon"], codebook_name(config), codebook_shape(config))
    if len(silent) and silent.max() >= len(vectors):
        raise InputError(folder / INDEX, f"names silent lexemes beyond the {len(vectors)} of the lexicon",
                         "copy the bundle again")
    return Bundle(config, statistics, silent, tensors["frequencies"], tensors["transitions"], vectors,
                  tensors["rest_distances"].astype(np.float32),
                  StoredParts(weights, replace(sizes, vectors=vectors)), index["provenance"], index["figures"], text)


def _text_source(folder: Path, found: dict[str, Any] | None) -> TextSource | None:
    if found is None:
        return None
    encoder, width = found.get("encoder"), found.get("width")
    if set(found) != {"encoder", "width"} or not isinstance(encoder, str) or type(width) is not int \
            or not 0 < width <= 2**16:
        raise InputError(folder / INDEX, "holds something else than it should under text", "copy the bundle again")
    return TextSource(encoder, width)


def _statistics(folder: Path, weights: Weights, config: Config, speakers: tuple[str, ...]
                ) -> tuple[Statistics, dict[str, NDArray[np.float64]]]:
    """The statistics, and the arrays that are beside them in the file."""
    tensors = {key: value.double().numpy() for key, value in weights.read(_STATISTICS, None).items()}
    motion, count, size = representation_of(config).width, len(speakers), codebook_shape(config)[0]
    wanted = {"mean_pose": (count, motion), "rest_pose": (count, motion), "deviation": (motion,),
              "bounds": (2, motion), "frequencies": (count, size), "transitions": (size, size),
              "rest_distances": (count, size)}
    for name, shape in wanted.items():
        if name not in tensors or tensors[name].shape != shape:
            raise InputError(folder / f"{_STATISTICS}{_ENDING}", f"does not fit the settings ({name})",
                             "train it again")
    groups = {name: {key.partition("_")[2]: value for key, value in tensors.items() if key.startswith(f"{name}_")}
              for name in ("low", "high", "levels")}
    try:
        low, high = Normaliser.from_dict(groups["low"]), Normaliser.from_dict(groups["high"])
        levels = Levels.from_dict(groups["levels"]) if groups["levels"] else None
        statistics = Statistics(speakers, tensors["mean_pose"], tensors["rest_pose"], tensors["deviation"],
                                tensors["bounds"], low, high, tensors.get("quiet_low"), tensors.get("quiet_high"),
                                levels)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(folder / f"{_STATISTICS}{_ENDING}", f"does not fit together ({str(error)[:100]})",
                         "train it again") from None
    return statistics, tensors
