"""The folder of a bundle: its index (`bundle.json`), its weight files, and their hashes.

Everything read is checked first: the format, the content of the index, and size and hash of each file. A bundle is
written to a temporary folder, which is synced and renamed.
"""

import hashlib
import json
import os
import platform
import re
import shutil
from collections.abc import Callable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import load as load_tensors

from data_module.errors import InputError
from data_module.files import is_free, new_folder, read_object, rename
from data_module.layers_run import Floats
from data_module.types import Skeleton
from gesticulator.cli import __version__

FORMAT = 7
"""The first released format. Bundles of formats 1 to 6 were never published."""
INDEX = "bundle.json"
CARD = "MODEL_CARD.md"
TIED = "lexicon_hash"
"""Metadata key of a weight file: the hash of the codebook that it was trained with."""
ENDING = ".safetensors"
_SHARED_FROM = 4096
"""Size of the smallest tensor that is stored once for all files that hold it, bytes."""
_ASSETS = Path(__file__).parents[1] / "assets"
NAMED = {"default": _ASSETS / "bundle", "paper": _ASSETS / "paper"}
"""Name -> folder of the shipped bundles; `paper` is both papers in their own form."""
_HUB_ID = re.compile(r"\w[\w.-]*/\w[\w.-]*(@\S+)?")
_LARGEST = 2**30
"""Largest weight file, bytes: a hundred times the generator of the shipped bundles."""


def bundle_folder(given: str | os.PathLike[str] | None) -> Path:
    """The folder of a bundle that is given by name (a string of `NAMED`), by folder, or by "org/name" or
    "org/name@revision" of a hub, unless that is a folder here; that of `default` for None.

    A name means the shipped bundle even where a bundle of that name lies in the current folder, so that a command does
    not depend on where it runs. `./paper`, and any `Path`, is a folder.
    """
    if given is None:
        return NAMED["default"]
    # A `Path` is a folder, whatever its name.
    if isinstance(given, str) and _HUB_ID.fullmatch(given) and not Path(given).exists():
        from gesticulator_hub.download import downloaded

        return downloaded(given)
    return NAMED[given] if isinstance(given, str) and given in NAMED else Path(given)


def lexicon_hash(vectors: Floats) -> str:
    """SHA-256 of a codebook [S, D_s], which ties an interpreter's weights to it."""
    # In half precision, as it is stored, so that a bundle in training and one on disk agree.
    return hashlib.sha256(vectors.astype(np.float16).tobytes()).hexdigest()


def shared_tensors(files: Mapping[str, Mapping[str, NDArray[Any]]]) -> dict[str, dict[str, str]]:
    """File -> large tensor -> the file before it that has the same one under the same name, so that it is stored once.
    files: their tensors by the names of the files without suffix."""
    first = dict[tuple[str, tuple[int, ...], bytes], str]()
    holders = {name: {key: first.setdefault((key, value.shape, value.tobytes()), name)
                      for key, value in tensors.items() if value.nbytes >= _SHARED_FROM}
               for name, tensors in files.items()}
    return {name: {key: holder for key, holder in of_file.items() if holder != name}
            for name, of_file in holders.items()}


def write_index(folder: Path, skeleton: Skeleton, index: dict[str, Any]) -> None:
    """Write `bundle.json` with the hashes of all files in the folder. skeleton: that the models animate."""
    index = {"format": FORMAT,
             "made_by": {"gesticulator": __version__, "torch": version("torch").split("+")[0],
                         "python": platform.python_version()},
             "skeleton": {"names": list(skeleton.names), "parents": list(skeleton.parents),
                          "offsets": skeleton.offsets.tolist()},
             **index, "files": {file.name: hashlib.sha256(file.read_bytes()).hexdigest()
                                for file in sorted(folder.iterdir()) if file.name != INDEX}}
    (folder / INDEX).write_text(json.dumps(index, indent=1, sort_keys=True) + "\n", encoding="utf-8")


def replace_folder(target: Path, write: Callable[[Path], Any]) -> None:
    """Replace a bundle by what `write(folder)` writes; InputError if anything but a bundle is there."""
    if not (target / INDEX).is_file() and not is_free(target):
        raise InputError(target, "exists and is not a bundle", "choose another path")
    # The old bundle stays until the new one is whole.
    fresh = target.with_name(f".{target.name}.new")
    shutil.rmtree(fresh, ignore_errors=True)
    with new_folder(fresh) as folder:
        write(folder)
        for file in folder.iterdir():
            file.chmod(0o644)  # safetensors restricts access to the owner
            # Flushed before the rename: after a power failure there is the old bundle or the new one.
            with file.open("rb+") as written:
                os.fsync(written.fileno())
    if target.exists():
        # A folder cannot be replaced in one step; the old one is moved away for an instant.
        old = target.with_name(f".{target.name}.old")
        shutil.rmtree(old, ignore_errors=True)
        rename(target, old)
        rename(fresh, target)
        shutil.rmtree(old, ignore_errors=True)
    else:
        rename(fresh, target)


class _TextEntry(msgspec.Struct, forbid_unknown_fields=True):
    encoder: str
    width: Annotated[int, msgspec.Meta(gt=0, le=2**16)]


class _IndexEntries(msgspec.Struct):
    """The required entries of `bundle.json` and their types."""

    config: dict[str, Any]
    skeleton: dict[str, Any]
    speakers: Annotated[list[str], msgspec.Meta(min_length=1, max_length=10_000)]
    silent_lexemes: list[Annotated[int, msgspec.Meta(ge=0, lt=2**31)]]
    files: dict[str, str]
    provenance: dict[str, Any]
    figures: dict[str, dict[str, Any]]
    audio_levels: Literal[1, 2]
    text: _TextEntry | None
    shared: dict[str, dict[str, str]] = {}


def read_index(path: str | Path) -> dict[str, Any]:
    """`bundle.json`, checked as far as possible without the weights; InputError if it is broken or of another
    format."""
    folder = Path(path)
    file = folder / INDEX
    if not file.is_file():
        raise InputError(folder, f"is not a bundle (no {INDEX})", "give default, paper, or a folder that gesticulator "
                         "train made")
    index = read_object(file, "copy the bundle again")
    # Checked first: with another format all other messages would mislead.
    version = index.get("format")
    if version != FORMAT or isinstance(version, bool):
        raise InputError(file, f"has format {str(version)[:20]}, and this version reads format {FORMAT}",
                         "train it again or use the matching version")
    try:
        msgspec.convert(index, _IndexEntries)
    except msgspec.ValidationError as error:
        raise InputError(file, f"has invalid values ({error})", "copy the bundle again") from None
    return index


class Weights:
    """The weight files of a bundle; each is checked when it is read: listed, hash, finite values."""

    def __init__(self, folder: Path, index: Mapping[str, Any]) -> None:
        """index: as of `read_index`. InputError if a listed file is missing or a weight file is not listed."""
        self.folder, self.listed, self.shared = folder, index["files"], index.get("shared", {})
        for name in self.listed:
            # A name with a folder in it would read files outside the bundle.
            if Path(name).name != name or not (folder / name).is_file():
                raise InputError(folder / name[:200], "is missing from the bundle", "copy the bundle again")
        # A stray file of weights is most likely left over from a broken copy.
        for file in sorted(folder.glob(f"*{ENDING}")):
            if file.name not in self.listed:
                raise InputError(file, f"is not in the list of {INDEX}", "delete it, or copy the bundle again")

    def __contains__(self, name: str) -> bool:
        return f"{name}{ENDING}" in self.listed

    def path(self, name: str) -> Path:
        return self.folder / f"{name}{ENDING}"

    def read(self, name: str, tied: str | None = None) -> dict[str, NDArray[Any]]:
        """The tensors of a file, in single precision. tied: hash of the codebook that the file must have been trained
        with."""
        tensors, made_with = self._read(name)
        if tied is not None and made_with.get(TIED) != tied:
            raise InputError(self.path(name), "was trained over another lexicon than the bundle's",
                             "train it again")
        shared = self.shared.get(name, {})
        held = {holder: self._read(holder)[0] for holder in set(shared.values())}
        # The part that needs a tensor reports it if neither file has it.
        tensors |= {key: held[holder][key] for key, holder in shared.items() if key in held[holder]}
        return _finite(self.path(name), tensors)

    def _read(self, name: str) -> tuple[dict[str, NDArray[Any]], dict[str, str]]:
        """The tensors that a file itself holds, and its metadata."""
        file = self.path(name)
        if name not in self:
            raise InputError(file, "is missing from the bundle", "copy the bundle again")
        # The size bounds the memory, whatever a header claims.
        if file.stat().st_size > _LARGEST:
            raise InputError(file, f"is larger than {_LARGEST >> 20} MiB", "train it again")
        data = file.read_bytes()
        if hashlib.sha256(data).hexdigest() != self.listed[file.name]:
            raise InputError(file, "is not the file that the bundle was made with (wrong SHA-256)",
                             "copy the bundle again")
        try:
            # `load` gives no metadata, so the header is read a second time for them.
            with safe_open(file, framework="np") as opened:
                return load_tensors(data), opened.metadata() or {}
        except _BROKEN as error:
            raise InputError(file, f"is broken ({str(error).splitlines()[0][:100]})", "copy the bundle again") from None


_BROKEN = (SafetensorError, ValueError, TypeError, KeyError, RuntimeError, OverflowError)
"""Exceptions raised by reading a damaged file of tensors."""


def _finite(file: Path, tensors: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Tensors in single precision; InputError for NaN or infinity."""
    # NaN in weights gives NaN poses, which show only at the end, in the file that is written.
    broken = next((key for key, value in tensors.items() if not np.isfinite(value).all()), None)
    if broken is not None:
        raise InputError(file, f"holds values that are no numbers ({broken})", "train it again")
    return {key: value.astype(np.float32) if np.issubdtype(value.dtype, np.floating) else value
            for key, value in tensors.items()}
