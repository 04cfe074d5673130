"""The report of a build: minutes, blocks, missing joints, and omissions with their reasons.

It is printed and written to `report.json` in the store. It does not depend on the run (time, order), so equal builds
have equal reports.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from data_module.store import SPLITS, RecordingInfo, Store

FILE = "report.json"
LEAST_MINUTES = 60.0
"""Minutes of training data below which a warning is given: the shipped corpus has hours, and the papers have four."""
_WORDS = {"given": "the times of words are given", "heard": "the times of words come from the aligner",
          "guessed": "the times of words are estimates", "": "no words are known"}


@dataclass(frozen=True)
class Outcome:
    """The result of building one recording: what was written, or why it was dropped, and the warnings. absent: joints
    that the source lacks. blocks: with the default settings. unit, words: see `corpora.Imported`."""

    name: str
    seconds: float = 0.0
    absent: tuple[str, ...] = ()
    blocks: int = 0
    unit: str = ""
    words: str = ""
    dropped: str = ""
    warnings: tuple[str, ...] = ()


def report_lines(store: Store, content: Mapping[str, Any]) -> Iterator[str]:
    """The report of a finished build, line by line, for the terminal. content: of `summary`."""
    yield (f"{store.path}: {store.corpus}, {content['recordings']} recordings, {content['minutes']:.1f} minutes, "
           f"{content['blocks']} blocks")
    for split, part in content["splits"].items():
        speakers = ", ".join(f"{name} {minutes:.1f}" for name, minutes in part["speakers"].items())
        yield (f"  {split:5s} {part['recordings']:4d} recordings {part['minutes']:7.1f} minutes, "
               f"{part['blocks']} blocks" + (f";  speakers: {speakers}" if part["recordings"] else ""))
    for unit, count in content["units"].items():
        yield f"  a unit of length is {unit} ({count} recordings)"
    for how, count in content["words"].items():
        yield f"  {_WORDS.get(how, how)} in {count} recordings"
    for joint, count in content["lacking"].items():
        yield f"  joint {joint} is missing in {count} recordings: it follows its parent and is masked"
    for name, why in content["dropped"].items():
        yield f"  dropped {name}: {why}"
    for name, lines in content["warnings"].items():
        yield from (f"  {name}: {line}" for line in lines)
    yield from (f"  {note}" for note in content["notes"])
    yield from (f"  warning: {line}" for line in doubts(store))
    yield f"  licence: {store.licence}"
    yield f"  fingerprint: {store.fingerprint}"


def doubts(store: Store) -> Iterator[str]:
    """Warnings about training on a store, a line each: an empty split, too little data."""
    uses = {"train": "nothing can be trained", "val": "training cannot stop early", "test": "nothing can be evaluated"}
    for split, use in uses.items():
        if not any(info.split == split for info in store.recordings):
            yield f"the {split} split is empty, so {use}; add recordings, or change --split"
    # Zero minutes have been reported above as an empty split.
    minutes = _minutes(store.of_split("train"))
    if 0 < minutes < LEAST_MINUTES:
        yield (f"{minutes:.0f} minutes of training data are little, and the weights will memorise them; "
               f"{LEAST_MINUTES:g} minutes or more are recommended")


def summary(infos: Sequence[RecordingInfo], outcomes: Sequence[Outcome], notes: Sequence[str]) -> dict[str, Any]:
    """The content of report.json. infos: the recordings in the store; outcomes: of all recordings, including dropped
    ones."""
    used = {outcome.name: outcome for outcome in outcomes if not outcome.dropped}
    return {
        "recordings": len(infos), "minutes": _minutes(infos), "blocks": sum(o.blocks for o in used.values()),
        # Blocks and minutes by split: whether a corpus suffices depends on its training part.
        "splits": {split: _part([info for info in infos if info.split == split], used) for split in SPLITS},
        "units": _counted(outcome.unit for outcome in used.values() if outcome.unit),
        "words": _counted(outcome.words for outcome in used.values()),
        "lacking": _counted(joint for outcome in used.values() for joint in outcome.absent),
        "dropped": {outcome.name: outcome.dropped for outcome in outcomes if outcome.dropped},
        "warnings": {outcome.name: list(outcome.warnings) for outcome in outcomes if outcome.warnings},
        "notes": list(notes),
    }


def _part(infos: Sequence[RecordingInfo], used: Mapping[str, Outcome]) -> dict[str, Any]:
    speakers = sorted({info.speaker for info in infos})
    return {"recordings": len(infos), "minutes": _minutes(infos), "blocks": sum(used[i.name].blocks for i in infos),
            "speakers": {name: _minutes([info for info in infos if info.speaker == name]) for name in speakers}}


def _minutes(infos: Sequence[RecordingInfo]) -> float:
    return round(sum(info.seconds for info in infos) / 60, 4)


def _counted(values: Iterator[str]) -> dict[str, int]:
    return dict(Counter(values).most_common())
