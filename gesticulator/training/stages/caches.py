"""Per-recording results cached in the work folder: blocks, features, word vectors."""

from __future__ import annotations

import hashlib
import signal
import zipfile
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
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
from data_module.files import new_file
from data_module.speech.silence import reference_level
from data_module.store import Store
from data_module.text.word_vectors import BRIDGE, WordEncoder, word_frames
from gesticulator.bundle.config import Config, digest
from gesticulator.bundle.features import encode, front_end_for, representation_of

if TYPE_CHECKING:
    from data_module.speech.speech_encoder import SpeechEncoder


@dataclass(frozen=True)
class CachedBlocks:
    """The blocks of a store on disk. names: [R] of the recordings; files: [R] of their blocks, each with the stretched
    audio [N, L] beside it (.npy); features: [R] files of their audio features, None without a front end; words:
    recording -> word vectors [W, d_t]; frames: K; name: a hash of everything here."""

    names: tuple[str, ...]
    files: tuple[Path, ...]
    features: tuple[Path, ...] | None
    words: Mapping[str, NDArray[np.float16]]
    frames: int
    name: str

    def arrays(self, recording: int, only: tuple[str, ...] | None = None) -> dict[str, NDArray[Any]]:
        """The blocks of a recording, by name of the array."""
        return read_arrays(self.files[recording], only)

    def features_of(self, recording: int) -> dict[str, NDArray[Any]]:
        """Features of a recording, by level; one column of zeros without a front end."""
        if self.features is None:
            count = len(self.arrays(recording, only=("silent",))["silent"])
            return {"low": np.zeros((count, 3 * self.frames, 1), np.float16)}
        return read_arrays(self.features[recording])


def cached_blocks(store: Store, config: Config, folder: Path, encoder: SpeechEncoder | None = None, *, workers: int = 1,
                  progress: bool = True) -> CachedBlocks:
    """Cut and encode a store, or use what is in `folder` under the same settings. Without the encoder that the front
    end needs there are no features."""
    # Only what changes the blocks: other settings reuse the folder.
    key = digest(store.fingerprint, config.rhythm, config.motion.representation, config.motion.joints,
                 controls.WINDOW, BRIDGE)
    blocks = folder / f"blocks-{key}"
    files = tuple(blocks / f"{name}.npz" for name in store.names)
    _all(_cut_one, [(str(store.path), name, config, file) for name, file in zip(store.names, files, strict=True)],
         workers, "blocks", progress)
    features, encoded = None, ""
    if encoder is not None or config.front_end.name != "vqwav2vec":
        encoded = digest(blocks.name, config.front_end, weights_hash(encoder) if encoder else "")
        features = tuple(folder / f"features-{encoded}" / file.name for file in files)
        _all(_encode_one, [(file, config, encoder, target) for file, target in zip(files, features, strict=True)],
             workers, "features", progress)
    words = word_file(store, config, folder, progress=progress)
    return CachedBlocks(store.names, files, features, {} if words is None else read_arrays(words),
                        config.rhythm.frames, digest(key, encoded, words.name if words else ""))


def _cut_one(store_path: str, name: str, config: Config, target: Path) -> None:
    torch.set_num_threads(1)
    recording = Store.open(store_path).load(name, config.motion.joints)
    speech, motion = recording.speech, recording.motion
    representation = representation_of(config)
    blocks = block_module.cut(speech, config.rhythm)
    control = controls.at_knots(controls.measure(motion), motion.fps, blocks)
    arrays: dict[str, NDArray[Any]] = {
        "motion": normalise_motion(motion, blocks, representation).astype(np.float32),
        "first": first_pose(motion, representation).astype(np.float32),
        "reference": reference_level(speech.samples, speech.sample_rate, blocks.edges),
        "silent": blocks.silent, "edges": blocks.edges, "mask": representation.present(motion.absent),
        "control": control.astype(np.float32),
    }
    if speech.words is not None and any(word.text for word in speech.words):
        arrays["word_at"] = word_frames(speech.words, blocks).astype(np.int32)
    # A file of its own, from which training maps single blocks; written before the one that marks both complete.
    with new_file(target.with_suffix(".npy")) as stream:
        np.save(stream, block_module.stretch_speech(speech, blocks).astype(np.float16))
    _write(target, arrays)


def _encode_one(source: Path, config: Config, encoder: SpeechEncoder | None, target: Path) -> None:
    torch.set_num_threads(1)
    from data_module.speech.speech_encoder import runner_of

    arrays = read_arrays(source, only=("reference", "edges"))
    front = front_end_for(config, None if encoder is None else runner_of(encoder))
    low, high = encode(np.load(source.with_suffix(".npy")).astype(np.float32), arrays["reference"],
                       np.diff(arrays["edges"]), config, front)
    out = {"low": low.astype(np.float16)}
    # One copy on disk for front ends with a single level.
    if high is not low and not np.array_equal(high, low):
        out["high"] = high.astype(np.float16)
    _write(target, out)


def _write(target: Path, arrays: dict[str, NDArray[Any]]) -> None:
    with new_file(target) as stream:
        np.savez(stream, allow_pickle=False, **arrays)


def whole(file: Path) -> bool:
    """Whether a cached file of arrays exists and is complete (its list of arrays is at its end)."""
    try:
        with zipfile.ZipFile(file) as arrays:
            return bool(arrays.namelist())
    except (OSError, zipfile.BadZipFile):
        return False


def _all(job: Callable[..., None], calls: list[tuple[Any, ...]], workers: int, title: str, progress: bool) -> None:
    """Run the calls of a job whose last argument is a file that is not complete yet."""
    calls[0][-1].parent.mkdir(parents=True, exist_ok=True)
    todo = [call for call in calls if not whole(call[-1])]
    with tqdm(total=len(calls), initial=len(calls) - len(todo), desc=title, disable=not progress) as bar:
        if workers <= 1 or len(todo) <= 1:
            for call in todo:
                job(*call)
                bar.update()
            return
        # spawn: a forked torch may hang in its thread pool. Ctrl C is for the first process, which then wants no more.
        with ProcessPoolExecutor(workers, get_context("spawn"), signal.signal, (signal.SIGINT, signal.SIG_IGN)) as pool:
            try:
                for _ in pool.map(job, *zip(*todo, strict=True)):
                    bar.update()
            except KeyboardInterrupt:
                pool.shutdown(cancel_futures=True)
                raise


def weights_hash(module: torch.nn.Module) -> str:
    """A short hash of a module's weights in half precision, as stored in a bundle."""
    sha = hashlib.sha256()
    for key, value in sorted(module.state_dict().items()):
        sha.update(key.encode() + value.detach().cpu().half().contiguous().numpy().tobytes())
    return sha.hexdigest()[:16]


def word_file(store: Store, config: Config, folder: Path, *, progress: bool = True) -> Path | None:
    """The file of word vectors [W, d_t] of all recordings with words, created if missing; None without a word
    encoder."""
    if not config.text.encoder:
        return None
    encoder = WordEncoder.open(config.text.encoder)
    key = digest(store.fingerprint, encoder.name, encoder.fingerprint)
    cache = folder / f"words-{key}.npz"
    if not whole(cache):
        vectors: dict[str, NDArray[Any]] = {}
        for info in tqdm(store.recordings, desc="words", disable=not progress):
            words = store.load(info.name).speech.words
            if words is not None and any(word.text for word in words):
                vectors[info.name] = encoder.encode(words).astype(np.float16)
        _write(cache, vectors)
    return cache


def read_arrays(file: Path, only: tuple[str, ...] | None = None) -> dict[str, NDArray[Any]]:
    """The arrays of a cached file, or only `only`."""
    with np.load(file, allow_pickle=False) as arrays:
        return {key: arrays[key] for key in arrays.files if only is None or key in only}
