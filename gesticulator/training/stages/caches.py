"""Per-recording results cached in the work folder: blocks, features, word vectors."""

from __future__ import annotations

import hashlib
import zipfile
import zlib
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from tqdm import tqdm

from data_module import blocks as block_module
from data_module import controls
from data_module.blocks import first_pose, normalise_motion
from data_module.errors import InputError
from data_module.files import new_file
from data_module.speech.silence import reference_level
from data_module.store import Store
from data_module.text.word_vectors import WordEncoder, word_frames
from gesticulator.bundle.config import Config, digest
from gesticulator.bundle.features import encode, front_end_for, representation_of

if TYPE_CHECKING:
    from data_module.speech.speech_encoder import SpeechEncoder


def _cut_one(store_path: str, name: str, config: Config, target: str) -> str:
    torch.set_num_threads(1)
    recording = Store.open(store_path).load(name, config.motion.joints)
    speech, motion = recording.speech, recording.motion
    representation = representation_of(config)
    blocks = block_module.cut(speech, config.rhythm)
    control = controls.at_knots(controls.measure(motion, config.control.window), motion.fps, blocks)
    arrays: dict[str, NDArray[Any]] = {
        "motion": normalise_motion(motion, blocks, representation).astype(np.float32),
        "first": first_pose(motion, representation).astype(np.float32),
        "sound": block_module.stretch_speech(speech, blocks).astype(np.float16),
        "reference": reference_level(speech.samples, speech.sample_rate, blocks.edges),
        "silent": blocks.silent, "edges": blocks.edges, "mask": representation.present(motion.absent),
        "control": control.astype(np.float32),
    }
    if speech.words is not None and any(word.text for word in speech.words):
        arrays["word_at"] = word_frames(speech.words, blocks, config.text.bridge).astype(np.int32)
    return _write(target, arrays, name)


def _encode_one(source: str, config: Config, encoder: SpeechEncoder | None, target: str) -> str:
    torch.set_num_threads(1)
    with np.load(source, allow_pickle=False) as arrays:
        low, high = encode(arrays["sound"].astype(np.float32), arrays["reference"], np.diff(arrays["edges"]), config,
                           front_end_for(config, encoder))
    out = {"low": low.astype(np.float16)}
    # One copy on disk for front ends with a single level.
    if high is not low and not np.array_equal(high, low):
        out["high"] = high.astype(np.float16)
    return _write(target, out, source)


def _write(target: str, arrays: dict[str, NDArray[Any]], name: str) -> str:
    with new_file(target) as stream:
        np.savez(stream, allow_pickle=False, **arrays)
    return name


def whole(file: Path) -> bool:
    """Whether a cached file of arrays exists and is complete (its list of arrays is at its end)."""
    try:
        with zipfile.ZipFile(file) as arrays:
            return bool(arrays.namelist())
    except (OSError, zipfile.BadZipFile):
        return False


def _all(job: Callable[..., str], calls: list[tuple[Any, ...]], workers: int, title: str, progress: bool) -> None:
    """Run the calls of a job whose last argument is a file that is not complete yet."""
    todo = [call for call in calls if not whole(Path(call[-1]))]
    with tqdm(total=len(calls), initial=len(calls) - len(todo), desc=title, disable=not progress) as bar:
        if workers <= 1 or len(todo) <= 1:
            for call in todo:
                job(*call)
                bar.update()
            return
        # spawn: a forked torch may hang in its thread pool.
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            for _ in pool.map(job, *zip(*todo, strict=True)):
                bar.update()


def blocks_folder(store: Store, config: Config, folder: Path) -> Path:
    """The folder of the blocks of a store, one file per recording."""
    # Only what changes the blocks: other settings reuse the folder.
    key = digest(store.fingerprint, config.rhythm, config.motion.representation, config.motion.joints,
                 config.control.window, config.text.bridge)
    return folder / f"blocks-{key}"


def features_folder(blocks: Path, config: Config, encoder: SpeechEncoder | None = None) -> Path:
    """The folder of the audio features of the blocks in a folder."""
    key = digest(blocks.name, config.front_end, weights_hash(encoder) if encoder else "")
    return blocks.parent / f"features-{key}"


def cut(store: Store, config: Config, folder: Path, *, workers: int = 1, progress: bool = True) -> tuple[Path, ...]:
    """The blocks of every recording, one file each, in a folder named by the hash of their inputs."""
    cache = blocks_folder(store, config, folder)
    cache.mkdir(parents=True, exist_ok=True)
    files = tuple(cache / f"{info.name}.npz" for info in store.recordings)
    _all(_cut_one, [(str(store.path), info.name, config, str(file))
                    for info, file in zip(store.recordings, files, strict=True)], workers, "blocks", progress)
    return files


def weights_hash(module: torch.nn.Module) -> str:
    """A short hash of a module's weights in half precision, as stored in a bundle."""
    sha = hashlib.sha256()
    for key, value in sorted(module.state_dict().items()):
        sha.update(key.encode() + value.detach().cpu().half().contiguous().numpy().tobytes())
    return sha.hexdigest()[:16]


def encode_all(files: tuple[Path, ...], config: Config, encoder: SpeechEncoder | None = None, *, workers: int = 1,
             progress: bool = True) -> tuple[Path, ...]:
    """The audio features of blocks, one file per recording, in a folder named by the front end's hash."""
    cache = features_folder(files[0].parent, config, encoder)
    cache.mkdir(parents=True, exist_ok=True)
    out = tuple(cache / file.name for file in files)
    _all(_encode_one, [(str(file), config, encoder, str(target)) for file, target in zip(files, out, strict=True)],
         workers, "features", progress)
    return out


def word_file(store: Store, config: Config, folder: Path, *, progress: bool = True) -> Path | None:
    """The file of word vectors [W, d_t] of all recordings with words, created if missing; None without a word
    encoder."""
    if not config.text.encoder:
        return None
    encoder = WordEncoder.open(config.text.encoder)
    key = digest(store.fingerprint, encoder.name, encoder.fingerprint)
    cache = folder / f"words-{key}.npz"
    if not whole(cache):
        # Like numpy's savez, but one array at a time.
        with new_file(cache) as file, zipfile.ZipFile(file, "w") as archive:
            for info in tqdm(store.recordings, desc="words", disable=not progress):
                words = store.load(info.name).speech.words
                if words is not None and any(word.text for word in words):
                    with archive.open(f"{info.name}.npy", "w", force_zip64=True) as stream:
                        np.lib.format.write_array(stream, encoder.encode(words).astype(np.float16), allow_pickle=False)
    return cache


def read_words(store: Store, config: Config, folder: Path, *, progress: bool = True) -> dict[str, NDArray[np.float16]]:
    """Word vectors [W, d_t] of all recordings with words; empty without a word encoder."""
    file = word_file(store, config, folder, progress=progress)
    return {} if file is None else read_arrays(file)


def read_arrays(file: Path, leave_out: tuple[str, ...] = (), only: tuple[str, ...] | None = None
                ) -> dict[str, NDArray[Any]]:
    """The arrays of a cached file, without `leave_out`, or only `only`; InputError if it is damaged."""
    try:
        with np.load(file, allow_pickle=False) as arrays:
            return {key: arrays[key] for key in arrays.files if key not in leave_out and (only is None or key in only)}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise InputError(file, f"is damaged ({error})", "delete it and start again") from None
