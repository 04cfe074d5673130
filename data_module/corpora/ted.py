"""The TED gesture data of Yoon et al. 2020 (speech, words and 3-D joints of talks), as they published it.

DIR is `ted_dataset` with the folders `lmdb_train`, `lmdb_val` and `lmdb_test`, which are the split. A value of such a
database is a video: its name and its clips, each with `skeletons_3d` [T, 10, 3], `audio_raw` (16 kHz), `words`
([text, start, end], seconds of the video) and `start_time`, `end_time`. Clips are read whole, not as the usual samples
of 34 frames, and at the video's frame rate. Positions become rotations of the 16-joint character; only the directions
of bones matter. Nothing is unpickled (see `data_module.corpora.serialised`).
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from data_module.corpora import serialised
from data_module.corpora.base import DroppedError, Item, Options, needed
from data_module.errors import InputError
from data_module.motion.representation import rotations_from_positions
from data_module.registry import Requirement
from data_module.store import SPLITS, Recording, RecordingInfo, Split
from data_module.types import Array, Motion, Speech, Word

SAMPLE_RATE = 16000
_AXES = np.array([-1.0, -1.0, 1.0])
"""The published joints have Y down, the speaker's left (joints 4 to 6) at -X and face +Z; ours Y up and left at +X."""
_NEEDED = ("skeletons_3d", "audio_raw", "words", "start_time", "end_time")
_FPS_RANGE = (5.0, 120.0)


class Ted:
    """A reader of the TED databases."""

    licence = "that of the talks (TED: CC BY-NC-ND 4.0) and of the data's authors; weights trained on it likewise"

    def __init__(self, source: Path | None, options: Options) -> None:
        source = needed(source, "name the folder that holds lmdb_train, lmdb_val and lmdb_test")
        # Checked before the folder is listed, so that the first error is the one that must be repaired first.
        for library in ("lmdb", "pyarrow"):
            Requirement(library, library, "ted").check("reading the TED databases")
        self._places: dict[Split, Path] = {split: source / f"lmdb_{split}" for split in SPLITS
                                           if (source / f"lmdb_{split}" / "data.mdb").is_file()}
        self._notes = [f"{source / f'lmdb_{split}' / 'data.mdb'} is missing, so nothing is in {split}"
                       for split in SPLITS if split not in self._places]
        if not self._places:
            raise InputError(source, "holds none of lmdb_train, lmdb_val and lmdb_test",
                             "name the folder ted_dataset that they lie in")

    def settings(self) -> Mapping[str, Any]:
        return {"databases": {split: (place / "data.mdb").stat().st_size for split, place in self._places.items()}}

    def items(self) -> Sequence[Item]:
        items: list[Item] = []
        known: Counter[str] = Counter()
        # Arrays are left out: listing all clips would otherwise read every pose and sample of the databases.
        for split, place in self._places.items():
            for key, value in _videos(place):
                video = serialised.deserialise(value, arrays=False, source=f"{place}, key {key}")
                if not isinstance(video, dict) or not isinstance(video.get("clips"), list) or "vid" not in video:
                    raise InputError(f"{place}, key {key}", "holds no vid and clips", "take the published databases")
                speaker = str(video["vid"])
                for number in range(len(video["clips"])):
                    name = f"ted_{speaker}_{number:03d}"
                    # A video may have clips in several splits, and names are unique in a store.
                    known[name] += 1
                    name += f"_{known[name]}" if known[name] > 1 else ""
                    items.append(Item(RecordingInfo(name, split, speaker, speaker, "en", group=name), len(items),
                                      (key, number)))
        return items

    def read(self, item: Item) -> Recording:
        key, number = item.content
        place = self._places[item.info.split]
        where = f"{place}, key {key}, clip {number}"
        try:
            video = serialised.deserialise(_value(place, key), source=where)
            clip = video["clips"][number]
            lacking = [name for name in _NEEDED if clip.get(name) is None]
            if lacking:
                raise InputError(where, f"has no {', '.join(lacking)}", "take the published databases")
            begin, end = float(clip["start_time"]), float(clip["end_time"])
            # Each clip has its own pose and sound; words have the times of the whole talk.
            motion = _motion(clip["skeletons_3d"], end - begin)
            speech = Speech(_sound(clip["audio_raw"]), SAMPLE_RATE, _words(clip["words"], begin), item.info.speaker)
        except InputError as error:
            raise DroppedError(str(error)) from None
        except (KeyError, IndexError, TypeError, ValueError) as error:
            raise DroppedError(f"{where}: {error}") from None
        return Recording(item.info, speech, motion)

    def notes(self) -> Sequence[str]:
        return self._notes


def _motion(skeletons_3d: Any, seconds: float) -> Motion:
    """The clip on the 16-joint character, at the frame rate that fits its duration."""
    points: Array = np.asarray(skeletons_3d, dtype=np.float64)
    # Some versions store each frame as one row of 30 numbers.
    if points.ndim == 2 and points.shape[1] == 30:
        points = points.reshape(-1, 10, 3)
    if points.shape[1:] != (10, 3) or len(points) < 2 or not np.isfinite(points).all():
        raise ValueError(f"skeletons_3d has shape {points.shape} or joints that are not numbers")
    # The data name no frame rate, and videos have different ones: frames over seconds is the true one.
    fps = len(points) / seconds if seconds > 0 else 0.0
    if not _FPS_RANGE[0] <= fps <= _FPS_RANGE[1]:
        raise ValueError(f"{len(points)} frames in {seconds:.2f} s are not a plausible frame rate")
    return rotations_from_positions(points * _AXES, fps)


def _sound(audio: Any) -> Any:
    samples = np.asarray(audio)
    if samples.ndim != 1 or len(samples) == 0 or samples.dtype.kind not in "fi":
        raise ValueError(f"audio_raw is {samples.dtype} of shape {samples.shape}")
    # Versions differ in the type of the samples: half precision from -1 to 1, or integers of full scale.
    scale = 1.0 if samples.dtype.kind == "f" else float(np.iinfo(samples.dtype).max)
    return np.clip(samples.astype(np.float32) / np.float32(scale), -1.0, 1.0)


def _words(words: Sequence[Sequence[Any]], begin: float) -> tuple[Word, ...]:
    """The words in seconds from the start of the clip, without those before it."""
    timed = [Word(str(text), float(start) - begin, float(end) - begin) for text, start, end in words]
    return tuple(Word(word.text, max(word.start, 0.0), word.end) for word in timed if word.end > 0)


@contextmanager
def _database(place: Path) -> Iterator[Any]:
    import lmdb

    try:
        # No lock: several workers read the database at once, and a published one may lie on a read-only disk.
        with (lmdb.open(str(place), readonly=True, lock=False, readahead=False, create=False) as environment,
              environment.begin() as transaction):
            yield transaction
    except lmdb.Error as error:
        raise InputError(place, f"is not a database that can be read ({error})", "fetch it again") from None


def _videos(place: Path) -> Iterator[tuple[str, bytes]]:
    with _database(place) as transaction:
        for key, value in transaction.cursor():
            yield key.decode("latin-1"), value


def _value(place: Path, key: str) -> bytes:
    with _database(place) as transaction:
        value: bytes | None = transaction.get(key.encode("latin-1"))
    if value is None:
        raise InputError(place, f"has no key {key} any more", "build from the beginning")
    return value
