"""The clips that several systems have in common, brought onto one frame rate and one length, so that they compare."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from data_module.errors import InputError
from data_module.motion.kinematics import resample
from data_module.types import Motion, Speech
from eval.clip.foreign import Clip

TRUTH = "truth"
_UNEVEN = 0.5
"""Seconds by which lengths may differ without a note."""


@dataclass
class ClipSet:
    """The same clips by every row. groups: those of one group share their sound. speeches: None where not known.

    motions: by row, one for each clip; notes: what was left out or changed.
    """

    names: list[str]
    groups: list[str]
    speeches: list[Speech | None]
    motions: dict[str, list[Motion]]
    fps: float
    notes: list[str] = field(default_factory=list)

    @property
    def seconds(self) -> float:
        """Duration of all clips."""
        return sum(motion.duration for motion in self.motions[TRUTH])


def common_clips(folders: Mapping[str, Mapping[str, Clip]]) -> ClipSet:
    """The clips that all of truth and systems have, at one frame rate, each of one length; InputError when no name is
    common."""
    names, notes = shared_names({row: list(clips) for row, clips in folders.items()})
    # The lowest rate of all: frames that were made up between two would have no acceleration.
    fps = min(clips[name].motion.fps for clips in folders.values() for name in names)
    clip_set = ClipSet([], [], [], {row: [] for row in folders}, fps, [*notes, *_body_notes(folders, names, fps)])
    for name in names:
        _add(clip_set, {row: clips[name] for row, clips in folders.items()})
    return clip_set


def shared_names(names: Mapping[str, Sequence[str]]) -> tuple[list[str], list[str]]:
    """The names that all rows have, in the truth's order, and a note for each row that has more.

    InputError when there is none.
    """
    common = [name for name in names[TRUTH] if all(name in others for others in names.values())]
    if not common:
        raise InputError("truth and systems", "have no clip in common", "give files of one clip one name: "
                         + "; ".join(f"{row} has {listed(held, 3)}" for row, held in names.items()))
    # A name that one row lacks is compared for none, and the reader is told which.
    over = {row: [name for name in held if name not in common] for row, held in names.items()}
    notes = [f"{row}: {listed(some, 4)} not compared, because not every row has that name"
             for row, some in over.items() if some]
    return common, notes


def listed(names: Sequence[str], most: int) -> str:
    """The first names, and how many more there are."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def _body_notes(folders: Mapping[str, Mapping[str, Clip]], names: Sequence[str], fps: float) -> list[str]:
    """Notes on the frame rate and the joints that a row lost in the comparison."""
    notes = []
    for row, clips in folders.items():
        rates = sorted({clips[name].motion.fps for name in names} - {fps})
        if rates:
            notes.append(f"{row}: brought from {', '.join(f'{rate:g}' for rate in rates)} to {fps:g} fps")
        absent = sorted({joint for name in names for joint in clips[name].motion.absent})
        if absent:
            notes.append(f"{row}: {', '.join(absent)} {'is' if len(absent) == 1 else 'are'} not known, so that MAJE "
                         "and MAD are over the other joints: compare them with care with rows that have more")
    return notes


def _add(joined: ClipSet, clips: Mapping[str, Clip]) -> None:
    """One clip of all rows, cut to the shortest."""
    first, fps = clips[TRUTH], joined.fps
    speech = next((clip.speech for clip in clips.values() if clip.speech is not None), None)
    motions = {row: resample(clip.motion, fps) for row, clip in clips.items()}
    # Every row loses what the shortest lacks: else a longer clip would be judged on other speech.
    frames = min(map(len, motions.values()))
    if speech is not None:
        frames = max(1, min(frames, int(speech.duration * fps + 1e-6)))
    joined.notes += [f"{first.name}: {row} lasts {motion.duration:.2f} s, and {frames / fps:.2f} s are compared"
                   for row, motion in motions.items() if motion.duration - frames / fps > _UNEVEN]
    joined.names.append(first.name)
    joined.groups.append(first.group or first.name)
    # The words go: the end of the last one may be cut off.
    joined.speeches.append(None if speech is None else replace(
        speech, samples=speech.samples[:max(1, round(frames / fps * speech.sample_rate))], words=None))
    for row, motion in motions.items():
        joined.motions[row].append(motion.crop(0, frames))
