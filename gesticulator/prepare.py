"""From a store to what the stages train on: blocks of motion and of speech, cached by the settings that shape them."""

from __future__ import annotations

import os
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from tqdm import tqdm

from data_module.blocks import first_pose, normalise_motion
from data_module.errors import InputError
from data_module.features import Normaliser
from data_module.skeletons import CHARACTER
from data_module.store import Store
from data_module.types import Array
from gesticulator import config as configs
from gesticulator.config import Config
from gesticulator.fit import Batch
from gesticulator.hear import hear

MOTION_WIDTH = 3 * len(CHARACTER)


@dataclass(frozen=True)
class Statistics:
    """What turns poses and features into numbers near 1, measured on the training split.

    speakers: names in order. mean_pose: [speakers, D_m] exponential maps; rest_pose: [speakers, D_m] the same in
    silence. deviation: [D_m]. bounds: [2, D_m] the least and the most of the normalised training data, but for one
    frame in a thousand at either end. low, high: normalisers of the audio features. A pose becomes
    (pose - mean_pose[speaker]) / deviation: without the speaker's own mean every lexeme would be a speaker.
    """

    speakers: tuple[str, ...]
    mean_pose: Array
    rest_pose: Array
    deviation: Array
    bounds: Array
    low: Normaliser
    high: Normaliser

    def normalise(self, poses: Array, speaker: int) -> Array:
        """Exponential maps [..., D_m] to normalised features."""
        return (poses - self.mean_pose[speaker]) / self.deviation

    def denormalise(self, features: Array, speaker: int) -> Array:
        """The inverse of `normalise`."""
        return features * self.deviation + self.mean_pose[speaker]


@dataclass(frozen=True)
class Corpus:
    """All blocks of a store in a row. N blocks, R recordings.

    motion: [N, K, D_m] normalised; low, high: [N, 3K, d] normalised audio windows; silent: [N]; durations: [N] s;
    recording: [N] index; first: [R, D_m] normalised pose at time 0; mask: [R, D_m] joints that the source has.
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
    statistics: Statistics

    def blocks_of(self, recording: int) -> NDArray[np.int64]:
        """Block numbers of a recording, in order."""
        return np.flatnonzero(self.recording == recording)

    def recordings(self, split: str) -> list[int]:
        """Recording numbers of a split."""
        return [index for index, own in enumerate(self.splits) if own == split]

    def select(self, split: str) -> NDArray[np.int64]:
        """Block numbers of a split."""
        return np.flatnonzero(np.isin(self.recording, self.recordings(split)))


def _prepare_one(store_path: str, name: str, config: Config, target: str) -> str:
    torch.set_num_threads(1)
    recording = Store.open(store_path).load(name)
    heard = hear(recording.speech, config)
    motion = recording.motion
    arrays: dict[str, NDArray[Any]] = {
        "motion": normalise_motion(motion, heard.blocks).astype(np.float32),
        "first": first_pose(motion).astype(np.float32),
        "low": heard.low.astype(np.float16),
        "silent": heard.blocks.silent,
        "edges": heard.blocks.edges,
        "mask": np.repeat([joint not in motion.absent for joint in CHARACTER.names], 3),
    }
    if heard.high is not heard.low and not np.array_equal(heard.high, heard.low):
        arrays["high"] = heard.high.astype(np.float16)
    temporary = f"{target}.tmp.npz"
    np.savez(temporary, allow_pickle=False, **arrays)
    os.replace(temporary, target)
    return name


def _cache(store: Store, config: Config, folder: Path, workers: int, progress: bool) -> Path:
    """Blocks and features of every recording, in a folder named by the hash of what shapes them."""
    key = configs.digest(store.fingerprint, configs.to_dict(config.rhythm), configs.to_dict(config.front_end))
    cache = folder / f"blocks-{key}"
    cache.mkdir(parents=True, exist_ok=True)
    wanted = [info.name for info in store.recordings if not (cache / f"{info.name}.npz").exists()]
    jobs = [(str(store.path), name, config, str(cache / f"{name}.npz")) for name in wanted]
    bar = tqdm(total=len(store.recordings), initial=len(store.recordings) - len(wanted), desc="blocks",
               disable=not progress)
    for _ in _run(jobs, workers):
        bar.update()
    bar.close()
    return cache


def _run(jobs: list[tuple[str, str, Config, str]], workers: int) -> Iterable[str]:
    if workers <= 1 or len(jobs) <= 1:
        for job in jobs:
            yield _prepare_one(*job)
        return
    # spawn: a forked torch may hang in its thread pool.
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        yield from pool.map(_prepare_one, *zip(*jobs, strict=True))


def prepare(store: Store, config: Config, folder: Path, *, workers: int = 1, progress: bool = True) -> Corpus:
    """Cut, encode and normalise a store; what is cached in `folder` under the same settings is reused."""
    cache = _cache(store, config, folder, workers, progress)
    infos = store.recordings
    loaded = []
    for info in infos:
        with np.load(cache / f"{info.name}.npz", allow_pickle=False) as arrays:
            loaded.append({key: arrays[key] for key in arrays.files})
    speakers = tuple(sorted({info.speaker for info in infos if info.split == "train"}))
    if not speakers:
        raise InputError(store.path, "has no recordings in its training split", "build the store again")
    speaker_of = np.array([speakers.index(info.speaker) if info.speaker in speakers else 0 for info in infos])
    statistics = _statistics(config, speakers, speaker_of, [info.split for info in infos], loaded)
    motion = [statistics.normalise(own["motion"], speaker) for own, speaker in zip(loaded, speaker_of, strict=True)]
    first = [statistics.normalise(own["first"], speaker) for own, speaker in zip(loaded, speaker_of, strict=True)]
    mask = np.stack([own["mask"] for own in loaded])
    low = torch.as_tensor(np.concatenate([statistics.low.apply(own["low"]).astype(np.float32) for own in loaded]))
    high = low if "high" not in loaded[0] else torch.as_tensor(
        np.concatenate([statistics.high.apply(own["high"]).astype(np.float32) for own in loaded]))
    return Corpus(
        names=tuple(info.name for info in infos), splits=tuple(info.split for info in infos), speaker_of=speaker_of,
        motion=torch.as_tensor(np.concatenate(motion).astype(np.float32)), low=low, high=high,
        silent=np.concatenate([own["silent"] for own in loaded]),
        durations=np.concatenate([np.diff(own["edges"]) for own in loaded]),
        recording=np.repeat(np.arange(len(infos)), [len(own["silent"]) for own in loaded]),
        first=torch.as_tensor(np.stack(first).astype(np.float32)), mask=torch.as_tensor(mask.astype(np.float32)),
        statistics=statistics)


def _statistics(config: Config, speakers: tuple[str, ...], speaker_of: NDArray[np.int64], splits: list[str],
                loaded: list[dict[str, NDArray]]) -> Statistics:
    train = [index for index, split in enumerate(splits) if split == "train"]
    mean, rest = np.zeros((len(speakers), MOTION_WIDTH)), np.zeros((len(speakers), MOTION_WIDTH))
    centred = []
    for speaker in range(len(speakers)):
        own = [loaded[i] for i in train if speaker_of[i] == speaker]
        poses = np.concatenate([arrays["motion"] for arrays in own]).astype(np.float64)
        silent = np.concatenate([arrays["silent"] for arrays in own])
        mean[speaker] = poses.mean(axis=(0, 1))
        still = _settled(silent)
        rest[speaker] = poses[still, -1].mean(axis=0) if still.any() else mean[speaker]
        centred.append((poses - mean[speaker]).reshape(-1, MOTION_WIDTH))
    deviation = np.concatenate(centred).std(axis=0)
    present = np.stack([loaded[i]["mask"] for i in train]).any(axis=0)
    deviation = np.where(present, np.maximum(deviation, config.motion.least_deviation), 1.0)
    bounds = np.percentile(np.concatenate(centred) / deviation, [0.1, 99.9], axis=0)
    low = Normaliser.fit(np.concatenate([loaded[i]["low"] for i in train]).astype(np.float32))
    high = low if "high" not in loaded[0] else Normaliser.fit(
        np.concatenate([loaded[i]["high"] for i in train]).astype(np.float32))
    return Statistics(speakers, mean, rest, deviation, bounds, low, high)


def _settled(silent: NDArray[np.bool_], wait: int = 3) -> NDArray[np.bool_]:
    """Silent blocks with `wait` silent ones before them: the arms have come to rest by then."""
    settled = silent.copy()
    for back in range(1, wait + 1):
        settled[back:] &= silent[:-back]
        settled[:back] = False
    return settled


@dataclass(frozen=True)
class Sequence:
    """A recording as a row of blocks, inserted silence included. All arrays are [M].

    motion: block numbers; held: the pose at the end of that block is held instead (inserted silence);
    audio: block numbers of the audio windows; style: style code numbers, 0 for inserted silence.
    """

    recording: int
    motion: NDArray[np.int64]
    held: NDArray[np.bool_]
    audio: NDArray[np.int64]
    lexeme: NDArray[np.int64]
    style: NDArray[np.int64]


def sequences(corpus: Corpus, labels: NDArray[np.int64], split: str, style_numbers: NDArray[np.int64]
              ) -> list[Sequence]:
    """The recordings of a split as they are."""
    out = []
    for recording in corpus.recordings(split):
        own = corpus.blocks_of(recording)
        out.append(Sequence(recording, own, np.zeros(len(own), bool), own, labels[own], style_numbers[own]))
    return out


def with_silence(parts: list[Sequence], corpus: Corpus, nearest_silent: NDArray[np.int64], share: float, longest: int,
                 rng: np.random.Generator) -> list[Sequence]:
    """Insert runs of 1 to `longest` silent blocks after silent ones until they make up `share` of all (RG 6.4.1).

    An inserted block hears noise of the same recording (a settled silence; its quietest block when it has none), holds
    the last pose, carries the zero style code and the silent lexeme nearest to the lexeme before.
    """
    total = sum(len(part.motion) for part in parts)
    places = [(p, int(at)) for p, part in enumerate(parts) for at in np.flatnonzero(corpus.silent[part.motion])]
    budget = round(share * total / (1 - share)) if places else 0
    runs: dict[tuple[int, int], int] = {}
    for index in rng.permutation(len(places)):
        if budget <= 0:
            break
        runs[places[index]] = min(int(rng.integers(1, longest + 1)), budget)
        budget -= runs[places[index]]
    return [_inserted(part, {at: count for (p, at), count in runs.items() if p == own}, corpus, nearest_silent, rng)
            for own, part in enumerate(parts)]


def _inserted(part: Sequence, runs: dict[int, int], corpus: Corpus, nearest_silent: NDArray[np.int64],
              rng: np.random.Generator) -> Sequence:
    if not runs:
        return part
    noise = part.audio[_settled(corpus.silent[part.audio], 1)]
    if len(noise) == 0:
        noise = part.audio[[int(corpus.low[part.audio].mean(dim=(1, 2)).argmin())]]
    columns: dict[str, list[int]] = {"motion": [], "held": [], "audio": [], "lexeme": [], "style": []}
    for at in range(len(part.motion)):
        rows = [(part.motion[at], False, part.audio[at], part.lexeme[at], part.style[at])]
        rows += [(part.motion[at], True, int(rng.choice(noise)), nearest_silent[part.lexeme[at]], 0)
                 for _ in range(runs.get(at, 0))]
        for row in rows:
            for key, value in zip(columns, row, strict=True):
                columns[key].append(int(value))
    arrays = {key: np.array(values) for key, values in columns.items()}
    return Sequence(part.recording, arrays["motion"], arrays["held"].astype(bool), arrays["audio"], arrays["lexeme"],
                    arrays["style"])


class Windows:
    """Windows of a seed block and N more over sequences, drawn at any start, or tiled without overlap."""

    def __init__(self, corpus: Corpus, parts: list[Sequence], blocks: int) -> None:
        self.corpus, self.parts, self.length = corpus, parts, blocks + 1
        self.starts = np.array([(p, s) for p, part in enumerate(parts)
                                for s in range(max(1, len(part.motion) - blocks))], dtype=np.int64)
        if len(self.starts) == 0:
            raise InputError("store", "has no recording for this split", "build the store again")

    def drawn(self, rng: np.random.Generator, count: int) -> Batch:
        """A batch of `count` windows at random."""
        return self.batch(self.starts[rng.integers(len(self.starts), size=count)])

    def tiled(self, size: int) -> Iterable[Batch]:
        """Every block (but seeds), in batches; the last window of a recording may overlap the one before."""
        places = []
        for p, part in enumerate(self.parts):
            last = max(0, len(part.motion) - self.length)
            places += [(p, start) for start in sorted({*range(0, last + 1, self.length - 1), last})]
        tiles = np.array(places, dtype=np.int64)
        for at in range(0, len(tiles), size):
            yield self.batch(tiles[at:at + size])

    def batch(self, starts: NDArray[np.int64]) -> Batch:
        """The windows at (part, start) [B, 2]: everything that any stage's losses ask for."""
        corpus = self.corpus
        rows: dict[str, list[NDArray]] = {key: [] for key in ("motion", "held", "audio", "lexeme", "style", "valid")}
        recordings = []
        for p, start in starts:
            part = self.parts[p]
            index = np.arange(start, start + self.length)
            inside = np.minimum(index, len(part.motion) - 1)
            for key in ("motion", "held", "audio", "lexeme", "style"):
                rows[key].append(getattr(part, key)[inside])
            rows["valid"].append((index == inside).astype(np.float32))
            recordings.append(part.recording)
        stacked = {key: torch.as_tensor(np.stack(values)) for key, values in rows.items()}
        motion = corpus.motion[stacked["motion"]]
        held = stacked["held"][:, :, None, None]
        motion = torch.where(held, motion[:, :, -1:].expand_as(motion), motion)
        speaker = torch.as_tensor(corpus.speaker_of[recordings])
        low = corpus.low[stacked["audio"]]
        return {
            "motion": motion, "audio": low, "audio_low": low,
            "audio_high": low if corpus.high is corpus.low else corpus.high[stacked["audio"]],
            "lexeme_index": stacked["lexeme"], "style": stacked["style"], "valid": stacked["valid"],
            "mask": corpus.mask[recordings],
            "speaker": torch.nn.functional.one_hot(speaker, len(corpus.statistics.speakers)).float(),
        }
