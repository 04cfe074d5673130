"""Windows of blocks, the training data of most stages, optionally with inserted silence."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_module import controls
from data_module.errors import InputError
from gesticulator.bundle.config import ControlConfig
from gesticulator.bundle.features import control_rows
from gesticulator.training import fit as fitting
from gesticulator.training.fit import Batch
from gesticulator.training.stages.base import Figures, Run, checked
from gesticulator.training.stages.corpus import Corpus
from gesticulator.training.stages.measured import settled

_CONTROLLED = 0.5
"""Probability that each style feature is controlled, in windows that are not free."""


@dataclass(frozen=True)
class Sequence:
    """A recording as a sequence of M blocks, including inserted silence. All arrays are [M].

    motion: block numbers; held: whether the pose at the end of that block is held instead (inserted silence); audio:
    block numbers of the audio windows; style: style code numbers, 0 for inserted silence.
    """

    recording: int
    motion: NDArray[np.int64]
    held: NDArray[np.bool_]
    audio: NDArray[np.int64]
    lexeme: NDArray[np.int64]
    style: NDArray[np.int64]


def sequences(corpus: Corpus, labels: NDArray[np.int64], split: str, style_numbers: NDArray[np.int64],
              with_text: bool = False) -> list[Sequence]:
    """The recordings of a split; with_text: only those with words."""
    return [Sequence(recording, blocks, np.zeros(len(blocks), bool), blocks, labels[blocks], style_numbers[blocks])
            for recording in corpus.recordings(split, with_text) for blocks in [corpus.blocks_of(recording)]]


def with_silence(parts: list[Sequence], corpus: Corpus, nearest_silent: NDArray[np.int64], share: float, longest: int,
                 rng: np.random.Generator) -> list[Sequence]:
    """Insert runs of 1 to `longest` silent blocks after silent ones until they make up `share` of all (RG 6.4.1).

    An inserted block has noise of the same recording as audio (a settled silence, or its quietest block), holds the
    last pose, and has the zero style code and the silent lexeme nearest to the lexeme before.
    """
    total = sum(len(part.motion) for part in parts)
    places = [(p, int(at)) for p, part in enumerate(parts) for at in np.flatnonzero(corpus.silent[part.motion])]
    # Inserted blocks are `share` of the sum: x = s (n + x), so x = s n / (1 - s).
    budget = round(share * total / (1 - share)) if places else 0
    runs: dict[tuple[int, int], int] = {}
    for index in rng.permutation(len(places)):
        if budget <= 0:
            break
        runs[places[index]] = min(int(rng.integers(1, longest + 1)), budget)
        budget -= runs[places[index]]
    return [_inserted(part, {at: count for (p, at), count in runs.items() if p == number}, corpus, nearest_silent, rng)
            for number, part in enumerate(parts)]


def _inserted(part: Sequence, runs: dict[int, int], corpus: Corpus, nearest_silent: NDArray[np.int64],
              rng: np.random.Generator) -> Sequence:
    if not runs:
        return part
    noise = part.audio[settled(corpus.silent[part.audio], 1)]
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
    """Windows of a seed block and N more over sequences, sampled at random starts, or tiled without overlap.

    text: include word vectors. control: settings for sampling style controls; None for no controls. moving: include the
    flow head's inputs about time and context.
    """

    def __init__(self, corpus: Corpus, parts: list[Sequence], blocks: int, *, text: bool = False,
                 control: ControlConfig | None = None, moving: bool = False) -> None:
        self.corpus, self.parts, self.length = corpus, parts, blocks + 1
        self.text, self.control, self.moving = text, control, moving
        if not parts:
            raise InputError("store", "has no recording for this split", "build the store again")
        rooms = [max(1, len(part.motion) - blocks) for part in parts]
        self.starts = np.stack([np.repeat(np.arange(len(parts)), rooms),
                                np.concatenate([np.arange(room) for room in rooms])], axis=1)

    def sample(self, rng: np.random.Generator, count: int) -> Batch:
        """A batch of `count` random windows."""
        starts = self.starts[rng.integers(len(self.starts), size=count)]
        given = None
        if self.control is not None:
            given = rng.random((count, len(controls.FEATURES))) < _CONTROLLED
            # Some windows are left free of all controls, so that the model also learns without.
            given &= rng.random((count, 1)) >= self.control.free
        return self.batch(starts, given)

    def tiled(self, size: int) -> Iterable[Batch]:
        """All blocks (except seeds), in batches; the last window of a recording may overlap the one before."""
        places = []
        for p, part in enumerate(self.parts):
            last = max(0, len(part.motion) - self.length)
            places += [(p, start) for start in sorted({*range(0, last + 1, self.length - 1), last})]
        tiles = np.array(places, dtype=np.int64)
        for at in range(0, len(tiles), size):
            yield self.batch(tiles[at:at + size])

    def batch(self, starts: NDArray[np.int64], given: NDArray[np.bool_] | None = None) -> Batch:
        """The windows at (part, start) [B, 2] with the inputs of all stages' losses. given: [B, F] which style features
        are controlled; None for none."""
        corpus = self.corpus
        rows: dict[str, list[NDArray]] = {key: [] for key in ("motion", "held", "audio", "lexeme", "style", "valid")}
        recordings = []
        for p, start in starts:
            part = self.parts[p]
            index = np.arange(start, start + self.length)
            # A recording shorter than a window repeats its last block, marked as not valid.
            inside = np.minimum(index, len(part.motion) - 1)
            for key in ("motion", "held", "audio", "lexeme", "style"):
                rows[key].append(getattr(part, key)[inside])
            rows["valid"].append((index == inside).astype(np.float32))
            recordings.append(part.recording)
        stacked = {key: torch.as_tensor(np.stack(values)) for key, values in rows.items()}
        motion = corpus.motion[stacked["motion"]]
        # Inserted silence holds the last pose of its block for all frames.
        held = stacked["held"][:, :, None, None]
        motion = torch.where(held, motion[:, :, -1:].expand_as(motion), motion)
        speaker = torch.as_tensor(corpus.speaker_of[recordings])
        low = corpus.low[stacked["audio"]].float()
        batch = {
            "motion": motion, "audio": low, "audio_low": low, "block": stacked["motion"],
            "audio_high": low if corpus.high is corpus.low else corpus.high[stacked["audio"]].float(),
            "lexeme": stacked["lexeme"], "style": stacked["style"], "valid": stacked["valid"],
            "duration": torch.as_tensor(corpus.durations[stacked["audio"].numpy()], dtype=torch.float32),
            "mask": corpus.mask[recordings],
            "speaker": torch.nn.functional.one_hot(speaker, len(corpus.statistics.speakers)).float(),
        }
        if self.moving:
            shown = stacked["motion"]
            # An inserted block holds the pose at the end of the block before.
            batch["ratio"] = torch.where(stacked["held"], torch.ones(()), corpus.pasts.ratio[shown])
            batch["circumstances"] = corpus.circumstances[shown]
        if self.text:
            batch["text"] = corpus.text(stacked["audio"])
        if given is not None:
            assert corpus.statistics.levels is not None
            values = np.asarray(corpus.control[stacked["motion"].numpy()])
            wanted = np.broadcast_to(given[:, None, None], values.shape)
            batch["control"] = torch.as_tensor(control_rows(corpus.statistics.levels, values, wanted))
        return batch


VALIDATED, AT_ONCE = 8, 64
"""Batches of validation windows, and windows in each: a second of computing, for two significant digits."""


def validation(corpus: Corpus, labels: NDArray[np.int64], blocks: int, text: bool = False, moving: bool = False
               ) -> list[Batch]:
    """The first windows of the validation split (of the training split if it is empty), without style codes."""
    split = "val" if corpus.recordings("val", text) else "train"
    windows = Windows(corpus, sequences(corpus, labels, split, np.zeros(len(labels), np.int64), text), blocks,
                      text=text, moving=moving)
    return [batch for batch, _ in zip(windows.tiled(AT_ONCE), range(VALIDATED), strict=False)]


def task_of(run: Run, windows: Windows, checks: list[Batch], validate: Callable[[list[Batch]], Figures],
            more: Mapping[str, Tensor] | None = None, watch: str = "", losses: fitting.Losses | None = None
            ) -> fitting.Task:
    """Training on windows, and validation on the windows `checks`, which are given on the run's device. more: [N, ...]
    further values of every block, by their names in a batch. watch, losses: see `fitting.Task`."""
    def complete(batch: Batch) -> Batch:
        return {**batch, **{name: table[batch["block"]] for name, table in (more or {}).items()}}

    validated = checked(run, [complete(batch) for batch in checks], validate)
    return fitting.Task(lambda rng, size: complete(windows.sample(rng, size)), losses, validated, watch=watch)
