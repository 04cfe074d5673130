"""The report of a build: minutes, blocks, intervals, missing joints, and omissions with their reasons.

It is printed and written to `report.json` in the store. It does not depend on the run (time, order), so equal builds
have equal reports.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from data_module.errors import InputError
from data_module.files import parse_json, read_json

if TYPE_CHECKING:
    from data_module.store import RecordingInfo, Store

FILE = "report.json"


@dataclass(frozen=True)
class Outcome:
    """The result of building one recording: what was written, or why it was dropped, and the warnings. absent: joints
    that the source lacks. blocks: with the default settings. intervals: `Intervals.as_json`. unit, words: see
    `corpora.Imported`."""

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
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> Outcome:
        fields = parse_json(text, "the outcome of a recording", "build it again", python=True)
        return cls(**fields | {"absent": tuple(fields["absent"]), "warnings": tuple(fields["warnings"])})


@dataclass(frozen=True)
class Report:
    """A finished build. content: the content of report.json; elapsed: seconds; reused: recordings of an earlier
    build."""

    store: Store
    content: Mapping[str, Any]
    elapsed: float = 0.0
    reused: int = 0

    def lines(self) -> Iterator[str]:
        """The report, line by line, for the terminal."""
        from data_module.intervals import Intervals

        content = self.content
        yield (f"{self.store.path}: {self.store.corpus}, {content['recordings']} recordings, "
               f"{content['minutes']:.1f} minutes{_blocks(content)}, built in {self.elapsed:.0f} s "
               f"({self.reused} recordings were there already)")
        for split, part in content["splits"].items():
            speakers = ", ".join(f"{name} {minutes:.1f}" for name, minutes in part["speakers"].items())
            yield (f"  {split:5s} {part['recordings']:4d} recordings {part['minutes']:7.1f} minutes{_blocks(part)}"
                   + (f";  speakers: {speakers};  voices: {', '.join(part['voices'])}" if part["recordings"] else ""))
        for unit, count in content["units"].items():
            yield f"  a unit of length is {unit} ({count} recordings)"
        for how, count in content["words"].items():
            yield f"  {_WORDS.get(how, how)} in {count} recordings"
        for joint, count in content["lacking"].items():
            yield f"  joint {joint} is missing in {count} recordings: it follows its parent and is masked"
        if content["intervals"]:
            yield f"  {Intervals.from_json(content['intervals']).line()}"
        for name, why in content["dropped"].items():
            yield f"  dropped {name}: {why}"
        for name, lines in content["warnings"].items():
            yield from (f"  {name}: {line}" for line in lines)
        yield from (f"  {note}" for note in content["notes"])
        yield from (f"  warning: {line}" for line in doubts(self.store))
        yield f"  licence: {self.store.licence}"
        yield f"  fingerprint: {self.store.fingerprint}"

LEAST_MINUTES = 60.0
"""Minutes of training data below which a warning is given: the shipped corpus has hours, and the papers have four."""
_WORDS = {"given": "the times of words are given", "heard": "the times of words come from the aligner",
          "guessed": "the times of words are estimates", "": "no words are known"}


def doubts(store: Store) -> Iterator[str]:
    """Warnings about training on a store, a line each: an empty split, too little data."""
    uses = {"train": "nothing can be trained", "val": "training cannot stop early", "test": "nothing can be evaluated"}
    for split, use in uses.items():
        if not any(info.split == split for info in store.recordings):
            yield f"the {split} split is empty, so {use}; add recordings, or change --split"
    # Zero minutes have been reported above as an empty split.
    minutes = _minutes([info for info in store.recordings if info.split == "train"])
    if 0 < minutes < LEAST_MINUTES:
        yield (f"{minutes:.0f} minutes of training data are little, and the weights will memorise them; "
               f"{LEAST_MINUTES:g} minutes or more are recommended")


def _blocks(counts: Mapping[str, Any]) -> str:
    return f", {counts['blocks']} blocks" if counts["blocks"] else ""


def summary(infos: Sequence[RecordingInfo], outcomes: Sequence[Outcome], notes: Sequence[str]) -> dict[str, Any]:
    """The content of report.json. infos: the recordings in the store; outcomes: of all recordings, including dropped
    ones (empty for a store without a report)."""
    from data_module.intervals import Intervals

    used = {outcome.name: outcome for outcome in outcomes if not outcome.dropped}
    # Blocks and minutes by split: whether a corpus suffices depends on its training part.
    splits = {split: _part([info for info in infos if info.split == split], used) for split in ("train", "val", "test")}
    measured = (Intervals.from_json(outcome.intervals) for outcome in used.values() if outcome.intervals)
    intervals = sum(measured, Intervals())
    return {
        "recordings": len(infos), "minutes": _minutes(infos), "blocks": sum(o.blocks for o in used.values()),
        "splits": splits,
        "units": _counted(outcome.unit for outcome in used.values() if outcome.unit),
        "words": _counted(outcome.words for outcome in used.values()),
        "lacking": _counted(joint for info in infos for joint in info.absent),
        "intervals": intervals.as_json() if used else {},
        "dropped": {outcome.name: outcome.dropped for outcome in outcomes if outcome.dropped},
        "warnings": {outcome.name: list(outcome.warnings) for outcome in outcomes if outcome.warnings},
        "notes": list(notes),
    }


def _part(infos: Sequence[RecordingInfo], used: Mapping[str, Outcome]) -> dict[str, Any]:
    speakers = sorted({info.speaker for info in infos})
    return {"recordings": len(infos), "minutes": _minutes(infos),
            "blocks": sum(used[info.name].blocks for info in infos if info.name in used),
            "speakers": {name: _minutes([info for info in infos if info.speaker == name]) for name in speakers},
            "voices": sorted({info.voice for info in infos})}


def _minutes(infos: Sequence[RecordingInfo]) -> float:
    return round(sum(info.seconds for info in infos) / 60, 4)


def _counted(values: Iterator[str]) -> dict[str, int]:
    return dict(Counter(values).most_common())


def report_of(store: Store) -> dict[str, Any]:
    """The content of report.json in a finished store, or a summary of a store without one."""
    file = Path(store.path) / FILE
    if not file.is_file():
        return summary(store.recordings, (), ())
    try:
        # A report may have been edited by hand, so its entries are checked before any is printed.
        content = read_json(file, "delete it", python=True)
        if not set(summary((), (), ())) <= set(content):
            raise ValueError("entries are missing")
    except (ValueError, TypeError):
        raise InputError(file, "is not the report of a build", "delete it") from None
    return dict(content)
