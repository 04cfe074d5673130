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
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from data_module.errors import InputError
from data_module.features import Normaliser
from data_module.layers import freeze
from data_module.skeletons import CHARACTER
from generator.model import Generator
from gesticulator import __version__
from gesticulator.config import Config, from_dict, to_dict
from gesticulator.prepare import MOTION_WIDTH, Statistics
from interpreters.lstm import LstmInterpreter
from interpreters.statistical import StatisticalInterpreter
from interpreters.style import StyleInterpreter
from lexicon.autoencoder import Lexicon
from lexicon.inventory import Inventory

FORMAT = 1
_INDEX = "bundle.json"
CARD = "MODEL_CARD.md"
SHIPPED = Path(__file__).parent / "assets" / "bundle"
"""The bundle that comes with the package."""


@dataclass(frozen=True)
class Bundle:
    """Trained models and all that goes with them. provenance: what the weights were trained on, in plain values."""

    config: Config
    statistics: Statistics
    lexicon: Lexicon
    generator: Generator
    interpreter: LstmInterpreter
    style: StyleInterpreter
    inventory: Inventory
    silent: NDArray[np.int64]
    provenance: dict[str, Any]
    figures: dict[str, Any]

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
        return torch.as_tensor(rest, dtype=torch.float32)

    def rest_lexeme(self, speaker: int) -> int:
        """The silent lexeme nearest to standing still in the resting pose (a_0, s_0)."""
        still = self.rest_feature(speaker).expand(1, self.lexicon.frames, -1)
        distances = self.lexicon.quantizer.distances(self.lexicon.latents(still))[0]
        return int(self.silent[int(distances[torch.as_tensor(self.silent)].argmin())])


def lexicon_hash(lexicon: Lexicon) -> str:
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
    return {key: torch.as_tensor(np.ascontiguousarray(value), dtype=torch.float32) for key, value in arrays.items()}


def _half(module: nn.Module, leave_out: str = " ") -> dict[str, Tensor]:
    return {key: (value.half() if value.is_floating_point() else value).contiguous().cpu()
            for key, value in module.state_dict().items() if not key.startswith(leave_out)}


def save(bundle: Bundle, path: str | Path, card: str) -> None:
    """Write a bundle whole or not at all; a bundle that is already there is replaced, anything else is left alone."""
    target = Path(path)
    if target.exists() and not (target / _INDEX).is_file() and not (target.is_dir() and not any(target.iterdir())):
        raise InputError(target, "exists and is not a bundle", "choose another path")
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = Path(tempfile.mkdtemp(dir=target.parent, prefix=f".{target.name}."))
    try:
        save_file(_half(bundle.lexicon), temporary / "lexicon.safetensors")
        # The table of style codes belongs to the training blocks; nothing at inference looks into it.
        save_file(_half(bundle.generator, "styles."), temporary / "generator.safetensors")
        save_file(_half(bundle.interpreter), temporary / "lexeme_interpreter.safetensors")
        save_file(_half(bundle.style), temporary / "style_interpreter.safetensors")
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
            "lexicon_hash": lexicon_hash(bundle.lexicon), "provenance": bundle.provenance, "figures": bundle.figures,
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
    if version != FORMAT:
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
    except (SafetensorError, RuntimeError, KeyError, ValueError) as error:
        raise InputError(folder, f"does not fit together ({str(error).splitlines()[0]})", "train it again") from None


def _read(folder: Path, name: str) -> dict[str, Tensor]:
    return {key: value.float() if value.is_floating_point() else value
            for key, value in load_file(folder / f"{name}.safetensors").items()}


def _assemble(folder: Path, index: dict[str, Any], config: Config) -> Bundle:
    tensors = {key: value.double().numpy() for key, value in _read(folder, "statistics").items()}
    speakers = tuple(index["speakers"])
    low, high = (Normaliser.from_dict({key.partition("_")[2]: value for key, value in tensors.items()
                                       if key.startswith(f"{level}_")}) for level in ("low", "high"))
    statistics = Statistics(speakers, tensors["mean_pose"], tensors["rest_pose"], tensors["deviation"],
                            tensors["bounds"], low, high)
    inventory = Inventory(dict(zip(speakers, tensors["frequencies"], strict=True)), tensors["transitions"])
    frames = config.rhythm.frames
    lexicon = Lexicon(config.lexicon, frames, MOTION_WIDTH)
    lexicon.load_state_dict(_read(folder, "lexicon"))
    low_width, high_width = (len(next(iter(n.to_dict().values()))) for n in (low, high))
    generator = Generator(config.generator, frames, MOTION_WIDTH, low_width, config.lexicon.code_width)
    generator.load_state_dict(_read(folder, "generator"))
    interpreter = LstmInterpreter(config.interpreter, frames, high_width, lexicon.vectors, len(speakers))
    interpreter.load_state_dict(_read(folder, "lexeme_interpreter"))
    style = StyleInterpreter(config.style, frames, low_width, lexicon.vectors, config.generator.style_width,
                             len(speakers))
    style.load_state_dict(_read(folder, "style_interpreter"))
    for module in (lexicon, generator, interpreter, style):
        freeze(module)
    return Bundle(config, statistics, lexicon, generator, interpreter, style, inventory,
                  np.array(index["silent_lexemes"], dtype=np.int64), index["provenance"], index["figures"])
