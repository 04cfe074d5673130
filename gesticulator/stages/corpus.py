"""The corpus: blocks of motion, speech and words of a whole store, cached by what shapes them."""

from __future__ import annotations

import functools
import hashlib
import os
import zipfile
import zlib
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from tqdm import tqdm

from data_module import blocks as block_module
from data_module import controls
from data_module.blocks import first_pose, normalise_motion
from data_module.errors import InputError
from data_module.files import rename
from data_module.motion.kinematics import positions_of
from data_module.motion.movement import Pasts, joined, pasts_of
from data_module.motion.skeletons import CHARACTER
from data_module.speech.silence import reference_level
from data_module.store import Store
from data_module.text.word_vectors import WordEncoder, word_frames
from data_module.types import Array
from generator.flow import circumstances
from gesticulator.config import Config, digest
from gesticulator.features import (
    Normaliser,
    Statistics,
    encode,
    front_end_for,
    representation_of,
    three_blocks,
    word_table,
)
from gesticulator.models import Sizes, parts_of_body
from gesticulator.stages.base import Node, Run

if TYPE_CHECKING:
    from data_module.speech.speech_encoder import SpeechEncoder

@dataclass(frozen=True)
class Corpus:
    """All blocks of a store in a row. N blocks, R recordings, W words, F features of style.

    motion: [N, K, D_m] normalised; low, high: [N, 3K, d] normalised audio windows in half precision (`low` and `high`
    are the same array where the front end has one level); silent: [N]; durations: [N] s; recording: [N] index;
    first: [R, D_m] normalised pose at time 0; mask: [R, D_m] dimensions that the source has; control: [N, K, F]
    features of style in their units; has_text: [R]; word_at: [N, 3K] rows of `words` [W + 1, d_t + 1] (None without a
    word encoder); files: the cached blocks of each recording.
    """

    names: tuple[str, ...]
    splits: tuple[str, ...]
    speaker_of: NDArray[np.int64]
    motion: Tensor
    low: Tensor
    high: Tensor
    silent: NDArray[np.bool_]
    durations: Array
    recording: NDArray[np.int64]
    first: Tensor
    mask: Tensor
    control: NDArray[np.float32]
    statistics: Statistics
    has_text: NDArray[np.bool_]
    word_at: Tensor | None = None
    words: Tensor | None = None
    files: tuple[Path, ...] = ()

    def blocks_of(self, recording: int) -> NDArray[np.int64]:
        """Block numbers of a recording, in order."""
        return np.flatnonzero(self.recording == recording)

    def recordings(self, split: str, with_text: bool = False) -> list[int]:
        """Recording numbers of a split; only those with words when asked."""
        return [index for index, own in enumerate(self.splits)
                if own == split and (self.has_text[index] or not with_text)]

    def select(self, split: str) -> NDArray[np.int64]:
        """Block numbers of a split."""
        return np.flatnonzero(np.isin(self.recording, self.recordings(split)))

    def text(self, blocks: NDArray[np.int64] | Tensor) -> Tensor:
        """[..., 3K, d_t + 1] word vectors around blocks [...]."""
        if self.word_at is None or self.words is None:
            raise ValueError("this corpus was prepared without text")
        return self.words[self.word_at[torch.as_tensor(blocks)].long()].float()

    @functools.cached_property
    def pasts(self) -> Pasts:
        """What every block is told from, [N, 3, D_m]."""
        rows = [torch.as_tensor(self.blocks_of(recording)) for recording in range(len(self.names))]
        return joined(pasts_of(self.motion[own], torch.as_tensor(self.durations)[own], first)
                      for own, first in zip(rows, self.first, strict=True))

    @functools.cached_property
    def circumstances(self) -> Tensor:
        """[N, 8] every block's place in speech (`generator.flow.circumstances`)."""
        rows = [torch.as_tensor(self.blocks_of(recording)) for recording in range(len(self.names))]
        return torch.cat([circumstances(torch.as_tensor(self.durations)[own], torch.as_tensor(self.silent)[own])
                          for own in rows])

    def before(self, blocks: NDArray[np.int64]) -> tuple[Tensor, Tensor]:
        """Of each block [n], the block before as it was performed [n, K, D_m] (a recording's first pose, held, before
        its first block), and the seconds of the block before and of its own [n, 2]."""
        earlier = np.maximum(blocks - 1, 0)
        begins = (blocks == 0) | (self.recording[earlier] != self.recording[blocks])
        held = self.first[torch.as_tensor(self.recording[blocks])][:, None].expand(-1, self.motion.shape[1], -1)
        motion = torch.where(torch.as_tensor(begins)[:, None, None], held, self.motion[torch.as_tensor(earlier)])
        seconds = np.stack([self.durations[np.where(begins, blocks, earlier)], self.durations[blocks]], axis=-1)
        return motion, torch.as_tensor(seconds, dtype=torch.float32)

    @property
    def text_width(self) -> int:
        """d_t + 1, 0 without text."""
        return 0 if self.words is None else self.words.shape[-1]

    def sound(self, recording: int) -> NDArray[np.float16]:
        """[N, L] the stretched sound of a recording's blocks."""
        with np.load(self.files[recording], allow_pickle=False) as arrays:
            return np.asarray(arrays["sound"])


def _cut_one(store_path: str, name: str, config: Config, target: str) -> str:
    torch.set_num_threads(1)
    recording = Store.open(store_path).load(name, config.motion.joints)
    speech, motion = recording.speech, recording.motion
    representation = representation_of(config)
    blocks = block_module.cut(speech, config.rhythm)
    asked = controls.at_knots(controls.measure(motion, config.control.window), motion.fps, blocks)
    arrays: dict[str, NDArray[Any]] = {
        "motion": normalise_motion(motion, blocks, representation).astype(np.float32),
        "first": first_pose(motion, representation).astype(np.float32),
        "sound": block_module.stretch_speech(speech, blocks).astype(np.float16),
        "reference": reference_level(speech.samples, speech.sample_rate, blocks.edges),
        "silent": blocks.silent, "edges": blocks.edges, "mask": representation.present(motion.absent),
        "control": asked.astype(np.float32),
    }
    if speech.words is not None and any(word.text for word in speech.words):
        arrays["word_at"] = word_frames(speech.words, blocks, config.text.bridge).astype(np.int32)
    return _write(target, arrays, name)


def _encode_one(source: str, target: str, config: Config, encoder: SpeechEncoder | None) -> str:
    torch.set_num_threads(1)
    with np.load(source, allow_pickle=False) as arrays:
        low, high = encode(arrays["sound"].astype(np.float32), arrays["reference"], np.diff(arrays["edges"]), config,
                           front_end_for(config, encoder))
    out = {"low": low.astype(np.float16)}
    if high is not low and not np.array_equal(high, low):
        out["high"] = high.astype(np.float16)
    return _write(target, out, source)


def _write(target: str, arrays: dict[str, NDArray[Any]], name: str) -> str:
    temporary = Path(f"{target}.tmp")
    with temporary.open("wb") as stream:
        np.savez(stream, allow_pickle=False, **arrays)
        stream.flush()
        os.fsync(stream.fileno())
    rename(temporary, Path(target))
    return name


def whole(file: Path) -> bool:
    """Whether a cached file of arrays is there and no crash cut it short (its list of arrays stands at its end)."""
    try:
        with zipfile.ZipFile(file) as arrays:
            return bool(arrays.namelist())
    except (OSError, zipfile.BadZipFile):
        return False


def _all(job: Callable[..., str], jobs: list[tuple[Any, ...]], workers: int, title: str, progress: bool) -> None:
    todo = [arguments for arguments, target in ((j, j[-1]) for j in jobs) if not whole(Path(target))]
    calls = [arguments[:-1] for arguments in todo]
    bar = tqdm(total=len(jobs), initial=len(jobs) - len(todo), desc=title, disable=not progress)
    for _ in _run(job, calls, workers):
        bar.update()
    bar.close()


def _run(job: Callable[..., str], calls: list[tuple[Any, ...]], workers: int) -> Iterable[str]:
    if workers <= 1 or len(calls) <= 1:
        for call in calls:
            yield job(*call)
        return
    # spawn: a forked torch may hang in its thread pool.
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        yield from pool.map(job, *zip(*calls, strict=True))


def cut(store: Store, config: Config, folder: Path, *, workers: int = 1, progress: bool = True) -> tuple[Path, ...]:
    """The blocks of every recording, one file each, in a folder named by the hash of what shapes them."""
    key = digest(store.fingerprint, config.rhythm, config.motion.representation, config.motion.joints,
                         config.control.window, config.text.bridge)
    cache = folder / f"blocks-{key}"
    cache.mkdir(parents=True, exist_ok=True)
    files = tuple(cache / f"{info.name}.npz" for info in store.recordings)
    _all(_cut_one, [(str(store.path), info.name, config, str(file), str(file))
                    for info, file in zip(store.recordings, files, strict=True)], workers, "blocks", progress)
    return files


def weights_hash(module: torch.nn.Module) -> str:
    """A short hash of a module's weights in half precision, as a bundle keeps them."""
    sha = hashlib.sha256()
    for key, value in sorted(module.state_dict().items()):
        sha.update(key.encode() + value.detach().cpu().half().contiguous().numpy().tobytes())
    return sha.hexdigest()[:16]


def encode_all(files: tuple[Path, ...], config: Config, encoder: SpeechEncoder | None = None, *, workers: int = 1,
             progress: bool = True) -> tuple[Path, ...]:
    """The audio features of blocks that are cut, one file each, in a folder named by the front end's hash."""
    cut_folder = files[0].parent
    key = digest(cut_folder.name, config.front_end, weights_hash(encoder) if encoder else "")
    cache = cut_folder.parent / f"features-{key}"
    cache.mkdir(parents=True, exist_ok=True)
    out = tuple(cache / file.name for file in files)
    _all(_encode_one, [(str(file), str(own), config, encoder, str(own)) for file, own in zip(files, out, strict=True)],
         workers, "features", progress)
    return out


def read_words(store: Store, config: Config, folder: Path, *, progress: bool = True) -> dict[str, NDArray[np.float16]]:
    """Word vectors [W, d_t] of every recording that has words; empty when the settings name no word encoder."""
    if not config.text.encoder:
        return {}
    encoder = WordEncoder.open(config.text.encoder)
    key = digest(store.fingerprint, encoder.name, encoder.fingerprint)
    cache = folder / f"words-{key}.npz"
    if not whole(cache):
        vectors: dict[str, NDArray[Any]] = {}
        for info in tqdm(store.recordings, desc="words", disable=not progress):
            words = store.load(info.name).speech.words
            if words is not None and any(word.text for word in words):
                vectors[info.name] = encoder.encode(words).astype(np.float16)
        _write(str(cache), vectors, "")
    return _read(cache)


def prepare(store: Store, config: Config, folder: Path, encoder: SpeechEncoder | None = None, *, workers: int = 1,
            progress: bool = True) -> Corpus:
    """Cut, encode and normalise a store; what is cached in `folder` under the same settings is reused.

    encoder: the trained stack, where the front end is "vqwav2vec"; without it the audio is left out (one column of
    zeros), which is all that the lexicon needs.
    """
    files = cut(store, config, folder, workers=workers, progress=progress)
    encoded: list[dict[str, NDArray[Any]]]
    loaded = [_read(file, leave_out=("sound",)) for file in files]
    if encoder is None and config.front_end.name == "vqwav2vec":
        encoded = [{"low": np.zeros((len(own["silent"]), 3 * config.rhythm.frames, 1), np.float16)} for own in loaded]
    else:
        encoded = [_read(file) for file in encode_all(files, config, encoder, workers=workers, progress=progress)]
    infos = store.recordings
    speakers = tuple(sorted({info.speaker for info in infos if info.split == "train"}))
    if not speakers:
        raise InputError(store.path, "has no recordings in its training split", "build the store again")
    speaker_of = np.array([speakers.index(info.speaker) if info.speaker in speakers else 0 for info in infos])
    statistics = measured(config, speakers, speaker_of, [info.split for info in infos], loaded, encoded)
    motion = [statistics.normalise(own["motion"], speaker) for own, speaker in zip(loaded, speaker_of, strict=True)]
    first = [statistics.normalise(own["first"], speaker) for own, speaker in zip(loaded, speaker_of, strict=True)]
    low = _normalised(statistics.low, [own["low"] for own in encoded])
    high = low if "high" not in encoded[0] else _normalised(statistics.high, [own["high"] for own in encoded])
    word_at, words, has_text = _text(infos, loaded, read_words(store, config, folder, progress=progress))
    return Corpus(
        names=tuple(info.name for info in infos), splits=tuple(info.split for info in infos), speaker_of=speaker_of,
        motion=torch.as_tensor(np.concatenate(motion).astype(np.float32)), low=low, high=high,
        silent=np.concatenate([own["silent"] for own in loaded]),
        durations=np.concatenate([np.diff(own["edges"]) for own in loaded]),
        recording=np.repeat(np.arange(len(infos)), [len(own["silent"]) for own in loaded]),
        first=torch.as_tensor(np.stack(first).astype(np.float32)),
        mask=torch.as_tensor(np.stack([own["mask"] for own in loaded]).astype(np.float32)),
        control=np.concatenate([own["control"] for own in loaded]), statistics=statistics, has_text=has_text,
        word_at=word_at, words=words, files=files)


def _read(file: Path, leave_out: tuple[str, ...] = ()) -> dict[str, NDArray[Any]]:
    try:
        with np.load(file, allow_pickle=False) as arrays:
            return {key: arrays[key] for key in arrays.files if key not in leave_out}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise InputError(file, f"is damaged ({error})", "delete it and start again") from None


def _normalised(normaliser: Normaliser, parts: list[NDArray[Any]]) -> Tensor:
    return torch.as_tensor(np.concatenate([normaliser.apply(part.astype(np.float32)).astype(np.float16)
                                           for part in parts]))


def _text(infos: Iterable[Any], loaded: list[dict[str, NDArray[Any]]], vectors: dict[str, NDArray[np.float16]]
          ) -> tuple[Tensor | None, Tensor | None, NDArray[np.bool_]]:
    """[N, 3K] rows, the table [W + 1, d_t + 1] and which recordings have words [R]."""
    has = np.array([info.name in vectors and "word_at" in own for info, own in zip(infos, loaded, strict=True)])
    if not has.any():
        return None, None, has
    rows, tables, begin = [], [], 1
    for info, own in zip(infos, loaded, strict=True):
        frames = own.get("word_at")
        if frames is None or info.name not in vectors:
            rows.append(np.zeros((len(own["silent"]), 3 * own["motion"].shape[1]), np.int32))
            continue
        rows.append(three_blocks(np.where(frames >= 0, frames + begin, 0).astype(np.int32), np.zeros(())))
        tables.append(vectors[info.name])
        begin += len(vectors[info.name])
    table = np.concatenate(tables)
    return (torch.as_tensor(np.concatenate(rows)),
            torch.as_tensor(word_table(table, table.shape[1]).astype(np.float16)), has)


BOUNDS = (0.1, 99.9)
"""Percent: one frame in a thousand at either end is left out, as captures jump now and then."""


def measured(config: Config, speakers: tuple[str, ...], speaker_of: NDArray[np.int64], splits: list[str],
                loaded: list[dict[str, NDArray[Any]]], encoded: list[dict[str, NDArray[Any]]]) -> Statistics:
    """What is measured on the training split, of the cached blocks and features of every recording.

    speaker_of: [R]; splits, loaded, encoded: of each of R recordings.
    """
    width = loaded[0]["motion"].shape[-1]
    train = [index for index, split in enumerate(splits) if split == "train"]
    mean, rest = np.zeros((len(speakers), width)), np.zeros((len(speakers), width))
    centred = []
    for speaker in range(len(speakers)):
        own = [loaded[i] for i in train if speaker_of[i] == speaker]
        poses = np.concatenate([arrays["motion"] for arrays in own]).astype(np.float64)
        silent = np.concatenate([arrays["silent"] for arrays in own])
        mean[speaker] = poses.mean(axis=(0, 1))
        still = settled(silent)
        rest[speaker] = resting(poses[still, -1], config) if still.any() else mean[speaker]
        centred.append((poses - mean[speaker]).reshape(-1, width))
    deviation = np.concatenate(centred).std(axis=0)
    present = np.stack([loaded[i]["mask"] for i in train]).any(axis=0)
    deviation = np.where(present, np.maximum(deviation, config.motion.least_deviation), 1.0)
    bounds = np.percentile(np.concatenate(centred) / deviation, BOUNDS, axis=0)
    quiet = [settled(loaded[i]["silent"], 1) for i in train]
    normalisers, silences = [], []
    for level in ("low", "high"):
        rows = [encoded[i].get(level, encoded[i]["low"]) for i in train]
        normaliser = Normaliser.fit(np.concatenate(rows).astype(np.float32))
        silences_heard = np.concatenate([own[which] for own, which in zip(rows, quiet, strict=True)]).astype(np.float32)
        normalisers.append(normaliser)
        silences.append(normaliser.apply(silences_heard).mean(axis=0, dtype=np.float64) if len(silences_heard)
                        else np.zeros(rows[0].shape[1:]))
    levels = controls.Levels.fit(np.concatenate([loaded[i]["control"] for i in train]).reshape(
        -1, len(controls.FEATURES)).astype(np.float64))
    return Statistics(speakers, mean, rest, deviation, bounds, normalisers[0], normalisers[1], silences[0],
                      silences[1], levels)


LOWEST = 0.3
"""Share of the poses that silences end in, those with the lowest hands, of which rest is made."""


def resting(poses: Array, config: Config) -> Array:
    """[D_m] the pose of rest among those that silences end in, [n, D_m]: their mean; or, where a body that rests lives
    (`silence.rest`), the arms of the one in the middle of those with the lowest hands, as a mean of poses with the
    hands down and poses with the hands held up would have them half way, and the mean of these for trunk and head,
    which in any one of them may look aside."""
    if config.silence.rest == "decay":
        return np.asarray(poses.mean(axis=0))
    places = positions_of(representation_of(config).motion(poses, config.rhythm.fps))
    height = places[:, [CHARACTER.index("LeftHand"), CHARACTER.index("RightHand")], 1].mean(axis=1) - places[:, 0, 1]
    low = poses[height <= np.quantile(height, LOWEST)]
    rest = low.mean(axis=0)
    arms = [column for part, columns in parts_of_body(config).items() if part not in ("torso", "head")
            for column in columns]
    rest[arms] = low[np.linalg.norm(low[:, arms] - rest[arms], axis=1).argmin()][arms]
    return np.asarray(rest)


def settled(silent: NDArray[np.bool_], wait: int = 3) -> NDArray[np.bool_]:
    """Silent blocks with `wait` silent ones before them: the arms have come to rest by then."""
    settled = silent.copy()
    for back in range(1, wait + 1):
        settled[back:] &= silent[:-back]
        settled[:back] = False
    return settled


def sizes(config: Config, corpus: Corpus, **more: Any) -> Sizes:
    """What shapes the models over a corpus; more: fields of `Sizes` that the corpus does not know."""
    return Sizes(config, corpus.motion.shape[-1], corpus.low.shape[-1], corpus.high.shape[-1],
                 corpus.high is not corpus.low, len(corpus.statistics.speakers), corpus.text_width,
                 corpus.statistics.present, **more)


def _blocks(run: Run) -> Corpus:
    corpus = prepare(run.store, run.config, run.work, workers=run.workers, progress=run.progress)
    if run.config.text.encoder and corpus.words is None:
        raise InputError(run.store.path, "has no recording with words",
                         "set text.encoder= (nothing) to train without text")
    return corpus


BLOCKS: Node[Corpus] = Node(
    "blocks", settings=("rhythm",), make=_blocks)
"""The corpus before it is heard: motion, stretched sound and words (and mel features, which need no training). How
motion becomes numbers stands with the lexicon, which alone looks at it first."""
