"""A bundle: one folder that holds everything inference needs.

`bundle.json` (format, versions, settings, skeleton, data fingerprint and licence, figures, SHA-256 of every file),
`MODEL_CARD.md` and `*.safetensors` in half precision. It is written to a temporary folder and renamed. An unknown
format, a foreign skeleton or a file that is not what its hash says is refused by name.
"""

from __future__ import annotations

import hashlib
import json
import platform
import shutil
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from data_module.controls import Levels
from data_module.errors import InputError
from data_module.layers import freeze
from data_module.motion.skeletons import CHARACTER
from data_module.speech.features import Normaliser
from data_module.speech.speech_encoder import SpeechEncoder
from generator.model import Generator
from gesticulator import __version__
from gesticulator.config import Config, from_dict, to_dict
from gesticulator.prepare import CONTROL_WIDTH, Statistics, representation_of
from interpreters.cql import QNetwork
from interpreters.gate import ActivityGate
from interpreters.lstm import LstmInterpreter
from interpreters.reward import RewardModel
from interpreters.statistical import StatisticalInterpreter
from interpreters.style import StyleInterpreter
from lexicon.autoencoder import Lexicon
from lexicon.inventory import Inventory
from lexicon.racer import RacerCodec

FORMAT = 3
_READABLE = (1, 2, 3)
"""Format 1 had no text, speech levels, gate or style editing, format 2 no Q-network; what they hold means the same."""
_INDEX = "bundle.json"
_TIED = "lexicon_hash"
CARD = "MODEL_CARD.md"
_LONG = 65
"""Codes of a stillness whose middle no longer sees where it begins and ends."""
SHIPPED = Path(__file__).parent / "assets" / "bundle"
"""The bundle that comes with the package."""


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
class Drawn:
    """What a bundle of blocks at the beat cannot do without."""

    lexicon: Lexicon
    generator: Generator
    interpreter: LstmInterpreter
    style: StyleInterpreter


@dataclass(frozen=True)
class Bundle:
    """Trained models and all that goes with them.

    interpreter, style: the audio-only ones; interpreter_text, style_text: those that read the words too, where there
    are any. encoder: the speech levels. gate: whether to gesture at all. text: where the word vectors come from.
    provenance: what the weights were trained on, in plain values.
    """

    config: Config
    statistics: Statistics
    lexicon: Lexicon | RacerCodec
    generator: Generator | None
    interpreter: LstmInterpreter | None
    style: StyleInterpreter | None
    inventory: Inventory
    silent: NDArray[np.int64]
    provenance: dict[str, Any]
    figures: dict[str, Any]
    encoder: SpeechEncoder | None = None
    gate: ActivityGate | None = None
    interpreter_text: LstmInterpreter | None = None
    style_text: StyleInterpreter | None = None
    text: TextSource | None = None
    q_network: QNetwork | None = None
    reward: RewardModel | None = None
    reward_judge: RewardModel | None = None

    @property
    def drawn(self) -> Drawn:
        """Lexicon, generator and interpreters of Rhythmic Gesticulator; InputError for a bundle of RACER's own."""
        if not isinstance(self.lexicon, Lexicon) or not (self.generator and self.interpreter and self.style):
            raise InputError("the bundle", "holds RACER's own codec, without lexicon, generator and style",
                             "use one of blocks at the beat (--preset default)")
        return Drawn(self.lexicon, self.generator, self.interpreter, self.style)

    @property
    def interpreters(self) -> tuple[str, ...]:
        """Names of the interpreters that it holds; the first is taken when none is named."""
        there = {"lstm": self.interpreter is not None, "cql": self.q_network is not None, "statistical": True}
        return tuple(name for name, own in there.items() if own)

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
        frequencies = np.stack([self.inventory.frequencies[name] for name in self.speakers])
        return StatisticalInterpreter(frequencies, self.inventory.transitions, self.config.statistical)

    def rest_feature(self, speaker: int) -> Tensor:
        """[D_m] the speaker's resting pose as the models see it."""
        rest = self.statistics.normalise(self.statistics.rest_pose[speaker], speaker)
        return torch.as_tensor(rest, dtype=torch.float32, device=self.lexicon.vectors.device)

    def rest_lexeme(self, speaker: int) -> int:
        """The silent lexeme nearest to standing still in the resting pose (a_0, s_0); of RACER's codec, which has no
        silence, its code in the middle of a long stillness."""
        rest = self.rest_feature(speaker)
        if isinstance(self.lexicon, RacerCodec):
            codes = self.lexicon.label(rest.expand(1, _LONG * self.lexicon.frames, -1))[0]
            return int(codes[_LONG // 2])
        distances = self.lexicon.quantizer.distances(self.lexicon.latents(rest.expand(1, self.lexicon.frames, -1)))[0]
        return int(self.silent[int(distances[torch.as_tensor(self.silent, device=distances.device)].argmin())])


def lexicon_hash(lexicon: Lexicon | RacerCodec) -> str:
    """SHA-256 of the codebook, which ties an interpreter to its lexicon."""
    return hashlib.sha256(lexicon.vectors.detach().half().cpu().numpy().tobytes()).hexdigest()


def _statistics_tensors(bundle: Bundle) -> dict[str, Tensor]:
    s = bundle.statistics
    arrays = {"mean_pose": s.mean_pose, "rest_pose": s.rest_pose, "deviation": s.deviation,
              "bounds": s.bounds,
              "frequencies": np.stack([bundle.inventory.frequencies[name] for name in s.speakers]),
              "transitions": bundle.inventory.transitions}
    for name, normaliser in (("low", s.low), ("high", s.high)):
        arrays.update({f"{name}_{key}": value for key, value in normaliser.to_dict().items()})
    if s.quiet_low is not None and s.quiet_high is not None:
        arrays.update({"quiet_low": s.quiet_low, "quiet_high": s.quiet_high})
    if s.levels is not None:
        arrays.update({f"levels_{key}": value for key, value in s.levels.to_dict().items()})
    return {key: torch.as_tensor(np.ascontiguousarray(value), dtype=torch.float32) for key, value in arrays.items()}


def _check_lexicon(file: Path, lexicon: Lexicon | RacerCodec) -> None:
    """InputError unless the weights were trained over this very lexicon: their actions are its lexemes."""
    with safe_open(file, framework="pt") as opened:
        if (opened.metadata() or {}).get(_TIED) != lexicon_hash(lexicon):
            raise InputError(file, "was trained over another lexicon than the bundle's",
                             "train the Q-network again (gesticulator.train --redo cql)")


def _half(module: nn.Module, leave_out: str = " ") -> dict[str, Tensor]:
    return {key: (value.half() if value.is_floating_point() else value).contiguous().cpu()
            for key, value in module.state_dict().items() if not key.startswith(leave_out)}


_OPTIONAL = {"generator": "generator", "lexeme_interpreter": "interpreter", "style_interpreter": "style",
             "lexeme_interpreter_text": "interpreter_text", "style_interpreter_text": "style_text",
             "speech_encoder": "encoder", "gate": "gate", "q_network": "q_network", "reward": "reward",
             "reward_judge": "reward_judge"}
"""File of a bundle -> field of `Bundle`; any may be absent."""


def save(bundle: Bundle, path: str | Path, card: str) -> None:
    """Write a bundle whole or not at all; a bundle that is already there is replaced, anything else is left alone."""
    target = Path(path)
    if target.exists() and not (target / _INDEX).is_file() and not (target.is_dir() and not any(target.iterdir())):
        raise InputError(target, "exists and is not a bundle", "choose another path")
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = Path(tempfile.mkdtemp(dir=target.parent, prefix=f".{target.name}."))
    try:
        save_file(_half(bundle.lexicon), temporary / "lexicon.safetensors")
        # The table of style codes belongs to the training blocks; nothing at inference looks into it ("styles.").
        for name, module in _OPTIONAL.items():
            own = getattr(bundle, module)
            if own is not None:
                tied = {_TIED: lexicon_hash(bundle.lexicon)} if name == "q_network" else None
                save_file(_half(own, "styles."), temporary / f"{name}.safetensors", tied)
        save_file(_statistics_tensors(bundle), temporary / "statistics.safetensors")
        (temporary / CARD).write_text(card, encoding="utf-8")
        files = {file.name: _sha(file) for file in sorted(temporary.iterdir())}
        index = {
            "format": FORMAT, "made_by": {"gesticulator": __version__, "torch": torch.__version__.split("+")[0],
                                          "python": platform.python_version()},
            "config": to_dict(bundle.config),
            "skeleton": {"names": list(CHARACTER.names), "parents": list(CHARACTER.parents),
                         "offsets": CHARACTER.offsets.tolist()},
            "speakers": list(bundle.speakers), "silent_lexemes": bundle.silent.tolist(),
            "lexicon_hash": lexicon_hash(bundle.lexicon),
            "text": {"encoder": bundle.text.encoder, "width": bundle.text.width} if bundle.text else None,
            "provenance": bundle.provenance, "figures": bundle.figures,
            "files": files,
        }
        (temporary / _INDEX).write_text(json.dumps(index, indent=1, sort_keys=True) + "\n", encoding="utf-8")
        temporary.chmod(0o755)  # mkdtemp and safetensors keep others out; a bundle is there to be shared
        for file in temporary.iterdir():
            file.chmod(0o644)
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


def _sha(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def read_index(path: str | Path) -> dict[str, Any]:
    """`bundle.json`, after the checks that need no weights."""
    folder = Path(path)
    index_path = folder / _INDEX
    if not folder.exists():
        raise InputError(folder, "does not exist", "give the folder of a bundle, or leave --bundle out")
    if not index_path.is_file():
        raise InputError(folder, f"is not a bundle (no {_INDEX})", "give a folder that gesticulator.train made")
    try:
        index = json.loads(index_path.read_text(encoding="utf-8"))
        version = index["format"]
    except (ValueError, KeyError, TypeError):
        raise InputError(index_path, "is broken", "copy the bundle again") from None
    if version not in _READABLE:
        raise InputError(index_path, f"has format {version}, and this version reads format {FORMAT}",
                         "train it again or use the matching version")
    lacking = [key for key in ("config", "skeleton", "speakers", "silent_lexemes", "files", "provenance", "figures")
               if key not in index]
    if lacking:
        raise InputError(index_path, f"lacks {', '.join(lacking)}", "copy the bundle again")
    if tuple(index["skeleton"]["names"]) != CHARACTER.names:
        raise InputError(index_path, "was trained on another skeleton", "train it again")
    return dict(index)


def load(path: str | Path) -> Bundle:
    """Read a bundle; InputError for one that is broken, foreign or not what its hashes say."""
    folder = Path(path)
    index = read_index(folder)
    for name, expected in index["files"].items():
        file = folder / name
        if Path(name).name != name or not file.is_file():
            raise InputError(file, "is missing from the bundle", "copy the bundle again")
        if _sha(file) != expected:
            raise InputError(file, "is not the file that the bundle was made with (wrong SHA-256)",
                             "copy the bundle again")
    config = from_dict(Config, index["config"])
    try:
        return _assemble(folder, index, config)
    except (SafetensorError, RuntimeError, KeyError, TypeError, ValueError) as error:
        raise InputError(folder, f"does not fit together ({str(error).splitlines()[0]})", "train it again") from None


def _read(folder: Path, name: str) -> dict[str, Tensor]:
    return {key: value.float() if value.is_floating_point() else value
            for key, value in load_file(folder / f"{name}.safetensors").items()}


def _assemble(folder: Path, index: dict[str, Any], config: Config) -> Bundle:
    tensors = {key: value.double().numpy() for key, value in _read(folder, "statistics").items()}
    speakers = tuple(index["speakers"])
    low, high, levels = ({key.partition("_")[2]: value for key, value in tensors.items() if key.startswith(f"{name}_")}
                         for name in ("low", "high", "levels"))
    statistics = Statistics(speakers, tensors["mean_pose"], tensors["rest_pose"], tensors["deviation"],
                            tensors["bounds"], Normaliser.from_dict(low), Normaliser.from_dict(high),
                            tensors.get("quiet_low"), tensors.get("quiet_high"),
                            Levels.from_dict(levels) if levels else None)
    inventory = Inventory(dict(zip(speakers, tensors["frequencies"], strict=True)), tensors["transitions"])
    width = representation_of(config).width
    frames = config.rhythm.frames
    lexicon: Lexicon | RacerCodec = (
        RacerCodec(config.racer, width, statistics.present) if config.tokens == "racer"
        else Lexicon(config.lexicon, frames, width, statistics.present))
    lexicon.load_state_dict(_read(folder, "lexicon"))
    text = TextSource(**index["text"]) if index.get("text") else None
    silent = np.array(index["silent_lexemes"], dtype=np.int64)
    there = {name.removesuffix(".safetensors") for name in index["files"]}
    parts = _optional_models(folder, there, config, lexicon, text, (len(low["mean"]), len(high["mean"])),
                             len(speakers), silent)
    if lacking := [name for name in _REQUIRED[config.tokens] if name not in parts]:
        raise KeyError(f"lacks {', '.join(lacking)}")
    for module in (lexicon, *parts.values()):
        freeze(module)
    return Bundle(config, statistics, lexicon, inventory=inventory, silent=silent, provenance=index["provenance"],
                  figures=index["figures"], text=text, **{name: parts.pop(name, None) for name in _DRAWN}, **parts)


_DRAWN = ("generator", "interpreter", "style")
_REQUIRED = {"lexicon": _DRAWN, "racer": ("q_network",)}
"""Fields that a bundle of either kind of token cannot do without."""


def _optional_models(folder: Path, there: set[str], config: Config, lexicon: Lexicon | RacerCodec,
                     text: TextSource | None, widths: tuple[int, int], speakers: int, silent: NDArray[np.int64]
                     ) -> dict[str, Any]:
    """The models of `_OPTIONAL` that are there, by field. widths: of the low and the high level."""
    frames, words, (low, high) = config.rhythm.frames, text.width if text else 0, widths
    motion = lexicon.motion_width
    made: dict[str, Any] = {}
    for file, name in _OPTIONAL.items():
        if file not in there:
            continue
        reads = name.endswith("_text")
        if name == "generator":
            model: nn.Module = Generator(config.generator, frames, motion, low, config.lexicon.code_width,
                                         control_width=CONTROL_WIDTH, present=lexicon.present)
        elif name == "q_network":
            _check_lexicon(folder / f"{file}.safetensors", lexicon)
            model = QNetwork(config.cql, frames, high, len(lexicon.vectors), speakers, silent.tolist())
        elif name.startswith("reward"):
            # One level of audio or both, as the front end has it: the weights know.
            heard = _read(folder, file)["read_audio.weight"].shape[1] // frames
            model = RewardModel(config.reward, frames, motion, heard)
        elif name.startswith("interpreter"):
            sized = config.interpreter if reads else config.interpreter.without_text()
            model = LstmInterpreter(sized, frames, high, lexicon.vectors, speakers, words, CONTROL_WIDTH)
        elif name.startswith("style"):
            style = config.style if reads else replace(config.style, text_features=0)
            model = StyleInterpreter(style, frames, low, lexicon.vectors, config.generator.style_width, speakers, words)
        elif name == "encoder":
            model = SpeechEncoder(config.encoder)
        else:
            model = ActivityGate(config.gate, frames, low, speakers)
        model.load_state_dict(_read(folder, file))
        made[name] = model
    return made
