"""What a build found: minutes, blocks, intervals, joints that are lacking, and what was left out and why.

It is printed, and kept as `report.json` beside the store's listing. It tells nothing of the run that made it (no time,
no order), so equal builds have equal reports.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from data_module.errors import InputError
from data_module.json_files import parse_json, read_json

if TYPE_CHECKING:
    from data_module.intervals import Intervals
    from data_module.store import RecordingInfo, Store

FILE = "report.json"


@dataclass(frozen=True)
class Outcome:
    """What became of one recording: what was written, or why it was dropped, and what was said on the way.

    absent: joints that the source lacks. blocks: with the default settings. intervals: `Intervals.as_json`. unit,
    words: see `corpora.Imported`.
    """

    name: str
    seconds: float = 0.0
    absent: tuple[str, ...] = ()
    blocks: int = 0
    intervals: Mapping[str, Any] = field(default_factory=dict)
    unit: str = ""
    words: str = ""
    dropped: str = ""
    warnings: tuple[str, ...] = ()

    def as_json(self) -> str:
        """For the file of a recording in a build that is under way; `from_json` is the inverse."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> Outcome:
        """The inverse of `as_json`."""
        told = parse_json(text, "the outcome of a recording", "build it again", python=True)
        return cls(**told | {"absent": tuple(told["absent"]), "warnings": tuple(told["warnings"])})


@dataclass(frozen=True)
class Report:
    """A finished build. told: the content of report.json; elapsed: seconds; reused: recordings that were there."""

    store: Store
    told: Mapping[str, Any]
    elapsed: float = 0.0
    reused: int = 0

    def intervals(self) -> Intervals:
        """Between onsets and between beats, over all recordings; `InputError` when the build did not measure them."""
        from data_module.intervals import Intervals

        try:
            return Intervals.from_json(self.told["intervals"])
        except (AttributeError, KeyError, TypeError, ValueError):
            raise InputError(self.store.path, "was built without a histogram of intervals", "build it again") from None

    def lines(self, verbose: bool = False) -> Iterator[str]:
        """The report, line by line, for the terminal. verbose: with the histogram of intervals."""
        told = self.told
        yield (f"{self.store.path}: {self.store.corpus}, {told['recordings']} recordings, {told['minutes']:.1f} minutes"
               f"{_blocks(told)}, built in {self.elapsed:.0f} s ({self.reused} recordings were there already)")
        for split, own in told["splits"].items():
            speakers = ", ".join(f"{name} {minutes:.1f}" for name, minutes in own["speakers"].items())
            yield (f"  {split:5s} {own['recordings']:4d} recordings {own['minutes']:7.1f} minutes{_blocks(own)}"
                   + (f";  speakers: {speakers};  voices: {', '.join(own['voices'])}" if own["recordings"] else ""))
        for unit, count in told["units"].items():
            yield f"  a unit of length is {unit} ({count} recordings)"
        for how, count in told["words"].items():
            yield f"  {_WORDS.get(how, how)} in {count} recordings"
        for joint, count in told["lacking"].items():
            yield f"  joint {joint} is lacking in {count} recordings: it follows its parent and is masked"
        if told["intervals"]:
            intervals = self.intervals()
            yield from (f"  {line}" for line in (intervals.lines() if verbose else [intervals.line()]))
        for name, why in told["dropped"].items():
            yield f"  dropped {name}: {why}"
        for name, said in told["warnings"].items():
            yield from (f"  {name}: {line}" for line in said)
        yield from (f"  {note}" for note in told["notes"])
        yield from (f"  warning: {line}" for line in doubts(self.store))
        yield f"  licence: {self.store.licence}"
        yield f"  fingerprint: {self.store.fingerprint}"



LEAST_MINUTES = 60.0
"""Minutes of training data below which a warning is given: our own corpus has hours, and the papers have four."""
_WORDS = {"given": "the times of words are given", "heard": "the times of words were heard by the aligner",
          "guessed": "the times of words were guessed", "": "no words are known"}


def doubts(store: Store) -> Iterator[str]:
    """What speaks against training on a store, a line each: a split that is empty, too little to train on."""
    uses = {"train": "nothing can be trained", "val": "training cannot stop early", "test": "nothing can be judged"}
    for split, use in uses.items():
        if not any(info.split == split for info in store.recordings):
            yield f"the {split} split is empty, so {use}; add recordings, or change --split"
    minutes = _minutes([info for info in store.recordings if info.split == "train"])
    if 0 < minutes < LEAST_MINUTES:
        yield (f"{minutes:.0f} minutes to train on are little, and weights will repeat what is in them; "
               f"{LEAST_MINUTES:g} minutes or more are advised")


def _blocks(told: Mapping[str, Any]) -> str:
    return f", {told['blocks']} blocks" if told["blocks"] else ""


def summary(infos: Sequence[RecordingInfo], outcomes: Sequence[Outcome], notes: Sequence[str]) -> dict[str, Any]:
    """The content of report.json. infos: what is in the store, with seconds and absent joints; outcomes: of all
    recordings, the dropped ones too (of none for a store without a report).
    """
    from data_module.intervals import Intervals

    made = {outcome.name: outcome for outcome in outcomes if not outcome.dropped}
    splits = {split: _part([info for info in infos if info.split == split], made) for split in ("train", "val", "test")}
    found = sum((Intervals.from_json(outcome.intervals) for outcome in made.values() if outcome.intervals), Intervals())
    return {
        "recordings": len(infos), "minutes": _minutes(infos), "blocks": sum(o.blocks for o in made.values()),
        "splits": splits,
        "units": _counted(outcome.unit for outcome in made.values() if outcome.unit),
        "words": _counted(outcome.words for outcome in made.values()),
        "lacking": _counted(joint for info in infos for joint in info.absent),
        "intervals": found.as_json() if made else {},
        "dropped": {outcome.name: outcome.dropped for outcome in outcomes if outcome.dropped},
        "warnings": {outcome.name: list(outcome.warnings) for outcome in outcomes if outcome.warnings},
        "notes": list(notes),
    }


def _part(infos: Sequence[RecordingInfo], made: Mapping[str, Outcome]) -> dict[str, Any]:
    speakers = sorted({info.speaker for info in infos})
    return {"recordings": len(infos), "minutes": _minutes(infos),
            "blocks": sum(made[info.name].blocks for info in infos if info.name in made),
            "speakers": {name: _minutes([info for info in infos if info.speaker == name]) for name in speakers},
            "voices": sorted({info.voice for info in infos})}


def _minutes(infos: Sequence[RecordingInfo]) -> float:
    return round(sum(info.seconds for info in infos) / 60, 4)


def _counted(values: Iterator[str]) -> dict[str, int]:
    return dict(Counter(values).most_common())


def report_of(store: Store) -> dict[str, Any]:
    """What report.json of a finished store tells, or what can be told of a store without one."""
    file = Path(store.path) / FILE
    if not file.is_file():
        return summary(store.recordings, (), ())
    try:
        told = read_json(file, "delete it", python=True)
        if not set(summary((), (), ())) <= set(told):
            raise ValueError("entries are missing")
    except (ValueError, TypeError):
        raise InputError(file, "is not the report of a build", "delete it") from None
    return dict(told)
