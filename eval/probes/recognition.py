"""Do named gestures look like people's? A classifier trained on clips of people names what the scripts draw.

    gesticulator probe recognition --source DIR [--speech FILE ...] [--draws 4]

DIR holds meaning/licensed_clips.csv (file, person, label, strokeStart, stroke, relax) and the clips that it names. Only
statistics of them are printed. Classes are the labels with `_CLIPS` clips of `_PEOPLE` people or more. The scripts are
drawn by hand, and none of the clips' motion is in them; so every test of a script is one on a new body. They are drawn
over the rest pose, as the clips stand alone, and, with --speech, within performances of the bundle, where the other
hand and the head go on with what the models generate.

Read every share beside these: chance; a classifier that learned shuffled labels; the rest pose without a gesture; and
the ceiling, clips of people by a classifier that has not seen the take, or the person. "Of five" is the question of
`gesticulator study meaning`: the right class and four others, drawn at random.

What fools it: with few clips of a class, its share hangs on a few people; some classes look alike to people, too (what
is offered, asked or given to all is an open hand); the worst scripts (`cheer arms`, `wave hello`, `point you`) were
mended after a first run, towards the clips (before: .67 of all classes and .78 of five over the rest pose, .51 and .71
in a performance). Scripts without clips can only be told from each other: that says that
they differ, not that they are understood.
"""

from __future__ import annotations

import argparse
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from data_module.errors import InputError
from data_module.files import read_table
from data_module.motion import rotation
from data_module.motion.bvh import read_bvh
from data_module.motion.skeletons import CHARACTERS
from data_module.types import Array, Motion
from eval.acceptance.bounds import Bound, Verdict, at_least, at_most, judged, skipped, verdict_table
from eval.clip.marked_gestures import marked_gestures
from eval.metrics.gesture_recognition import (
    DescribedGesture,
    GestureClassifier,
    GestureSpan,
    chosen_among,
    class_names,
    cross_validated,
    mirrored_label,
)
from eval.stats import Interval, mean_interval
from eval.table import Cell, Column, Table
from gesticulator.directing.gesture_phases import longest
from gesticulator.directing.gesture_scripts import SCRIPTS
from gesticulator.directing.named_gestures import laid_over
from gesticulator.pipeline import Gesticulator
from gesticulator.plan.gestures import REPERTOIRE
from gesticulator.plan.plan import GestureCue

ANSWERS = 5
WANTED, _NOTHING = 0.70, 0.35
"""Least share of scripts that are named, and greatest share of what is named without reason."""
_CLIPS, _PEOPLE = 4, 2
_FPS = 30.0
_ADVICE = "give the folder that holds meaning/licensed_clips.csv and its clips"
_SAME_BODY = {"brad2": "brad"}
"""Clips of one person under two names."""
_WITHOUT_HANDS = 1.0
"""Seconds before and after the middle of a clip in which no hand moves."""
COLUMNS = {"clips": Column("clips"), "people": Column("people"), "person": Column("clips, other people", "", 2),
           "alone": Column("script, alone", "", 2), "five": Column("alone, of five", "", 2),
           "speech": Column("in speech", "", 2), "taken": Column("alone, most often named")}


@dataclass(frozen=True)
class Named:
    """Gestures with the scores that a classifier gives them, [N, C], over `names`."""

    gestures: Sequence[DescribedGesture]
    scores: Array
    names: Sequence[str]

    @property
    def right(self) -> NDArray[np.int64]:
        """[N] numbers of the right classes."""
        return np.array([self.names.index(one.label) for one in self.gestures])

    @property
    def hits(self) -> Array:
        """[N] 1 where the right class is named."""
        return (self.scores.argmax(axis=1) == self.right).astype(np.float64)

    @property
    def of_five(self) -> Array:
        """[N] chance of being named among five."""
        return chosen_among(self.scores, self.right, ANSWERS)

    def mean(self, values: Array) -> Interval:
        """The mean over classes, each of which counts alike; its interval draws classes."""
        labels = [one.label for one in self.gestures]
        counts = Counter(labels)
        return mean_interval(values, [1.0 / counts[label] for label in labels], groups=labels)

    def of(self, values: Array, label: str) -> float:
        """The mean of one class."""
        return float(values[[one.label == label for one in self.gestures]].mean())

    def taken(self, label: str) -> str:
        """The class that gestures of one class are most often given."""
        places = [number for number, one in enumerate(self.gestures) if one.label == label]
        (place, _), *_ = Counter(self.scores[places].argmax(axis=1).tolist()).most_common(1)
        return self.names[place]


# ----------------------------------------------------------------------------------------------------- material

def read_clips(source: Path) -> list[DescribedGesture]:
    """The clips of people, of the classes with enough of them. InputError names the line of a row that cannot be read,
    and says so if no class has enough."""
    file = source / "meaning" / "licensed_clips.csv"
    rows = [(f"{file}, line {line}", {key: cell or "" for key, cell in row.items()})
            for line, row in read_table(file, _ADVICE)]
    if not rows or not {"file", "person", "label", "strokeStart", "stroke", "relax"} <= set(rows[0][1]):
        raise InputError(file, "is no table of clips", _ADVICE)
    people: dict[str, set[str]] = {}
    for _, row in rows:
        people.setdefault(row["label"], set()).add(_SAME_BODY.get(row["person"], row["person"]))
    counts = Counter(row["label"] for _, row in rows)
    enough = {label for label, count in counts.items() if count >= _CLIPS and len(people[label]) >= _PEOPLE
              and label.replace("_", " ") in REPERTOIRE}
    if len(enough) < 2:
        raise InputError(file, f"has {len(enough)} classes with {_CLIPS} clips of {_PEOPLE} people", _ADVICE)
    return [_described(where, row, source) for where, row in rows if row["label"] in enough]


def _described(where: str, row: dict[str, str], source: Path) -> DescribedGesture:
    motion = read_bvh(source / row["file"])
    try:
        begin, apex, end = (float(row[key]) if row["strokeStart"] else 0.0
                            for key in ("strokeStart", "stroke", "relax"))
    except ValueError:
        raise InputError(where, "holds no seconds", _ADVICE) from None
    span = GestureSpan(begin, apex, max(end, begin + 0.3))
    if not row["strokeStart"]:
        middle = motion.duration / 2
        reach = min(_WITHOUT_HANDS, 0.6 * middle)
        span = GestureSpan(middle - reach, middle, middle + reach)
    person = _SAME_BODY.get(row["person"], row["person"])
    return DescribedGesture.of(row["label"].replace("_", " "), motion, span, person, f"{person} {take_of(row['file'])}")


def take_of(file: str) -> str:
    """The name of a take without the hand, the number and the strength, which differ between versions of one take."""
    stem = re.sub(r"(Bt|Lf|Rt|Both)\d*$", "", Path(file).stem).replace("_intense", "")
    return stem.rstrip("0123456789")


def span_of(name: str, apex: float) -> GestureSpan:
    """When a script makes its gesture, at most; head and trunk move from before the apex on."""
    phases = longest(name)
    hands = any(script.main is not None for script in SCRIPTS[name])
    return GestureSpan(apex - phases.stroke, apex, apex + phases.hold) if hands else \
        GestureSpan(apex - 0.3, apex + 0.1, apex + phases.hold)


def drawn_alone(name: str, draw: int, rest: Array, cue: bool = True) -> DescribedGesture:
    """A script over a pose [3 J], in one of its variations; cue: False leaves the gesture out."""
    phases = longest(name)
    times = np.arange(round((phases.before + phases.after + 0.4) * _FPS)) / _FPS
    apex = phases.before + 0.2
    cues = [(GestureCue(name, time=apex), apex)] if cue else []
    poses = laid_over(np.repeat(rest[None], len(times), axis=0), times, cues, seed=draw)
    turns = rotation.from_exponential_map(poses.reshape(len(poses), -1, 3))
    motion = Motion(CHARACTERS[turns.shape[1]], turns, np.zeros((len(turns), 3)), _FPS)
    return DescribedGesture.of(name, motion, span_of(name, apex))


# -------------------------------------------------------------------------------------------------------- probe

def arguments(parser: argparse.ArgumentParser) -> None:
    """What the probe takes."""
    parser.add_argument("--source", type=Path, required=True, metavar="DIR",
                        help="folder of the clips of people: " + _ADVICE)
    parser.add_argument("--speech", nargs="+", type=Path, default=[], metavar="FILE",
                        help="recordings in which the gestures are performed, too")
    parser.add_argument("--draws", type=int, default=4, metavar="N", help="variations of each script (default 4)")
    parser.add_argument("--bundle", metavar="NAME|DIR", help="bundle: default, paper, or a folder (default: default)")


def run(arguments: argparse.Namespace) -> Sequence[Table]:
    """The verdicts, and the shares by class."""
    if arguments.draws < 1:
        raise InputError("--draws", f"cannot be {arguments.draws}", "ask for 1 or more")
    clips = read_clips(arguments.source)
    names, system = class_names(clips), Gesticulator.from_pretrained(arguments.bundle)
    classes = sorted({one.label for one in clips})
    by_take = Named(clips, cross_validated(clips, lambda one: one.take), names)
    by_person = Named(clips, cross_validated(clips, lambda one: one.person), names)
    model, rest = GestureClassifier(clips), system.bundle.statistics.rest_pose[0]
    draws = [drawn_alone(name, draw, rest) for name in classes for draw in range(arguments.draws)]
    alone = Named(draws, model.scores(draws), model.labels)
    spoken = _in_speech(system, arguments.speech, classes * arguments.draws, model) if arguments.speech else None
    found = [*_of_people(by_take, by_person), *_of_scripts(alone, spoken), *_controls(clips, model, alone, rest),
             _told_apart(rest, arguments.draws)]
    chance = 1.0 / len(names)
    return [verdict_table("Gestures named by a classifier", found, [
        f"{len(names)} classes, {len(clips)} clips of {len({one.person for one in clips})} people. Chance is "
        f"{chance:.2f} of all classes, {1 / ANSWERS:.2f} of five. Each class counts alike; intervals draw classes. "
        "Most of what is missing to 1.00 is missing in people's clips, too."]),
        _by_class(classes, by_person, alone, spoken)]


def _in_speech(system: Gesticulator, recordings: Sequence[Path], gestures: Sequence[str], model: GestureClassifier
               ) -> Named:
    drawn = [DescribedGesture.of(one.gesture, one.motion, span_of(one.gesture, one.apex))
             for one in marked_gestures(system, recordings, gestures)]
    return Named(drawn, model.scores(drawn), model.labels)


def _both(what: str, named: Named, bound: Bound | None = None) -> list[Verdict]:
    """Shares of all classes and of five, with one bound."""
    bounds = () if bound is None else (bound,)
    return [judged(f"{what}, of all classes", named.mean(named.hits), *bounds),
            judged(f"{what}, of five", named.mean(named.of_five), *bounds)]


def _of_people(by_take: Named, by_person: Named) -> list[Verdict]:
    return [*_both("clips of people, other takes", by_take), *_both("clips of people, other people", by_person)]


def _of_scripts(alone: Named, spoken: Named | None) -> list[Verdict]:
    found = _both("scripts over the rest pose", alone, at_least(WANTED))
    return found + (_both("scripts in a performance", spoken, at_least(WANTED)) if spoken else
                    [skipped("scripts in a performance", "no --speech")])


def _controls(clips: Sequence[DescribedGesture], model: GestureClassifier, alone: Named, rest: Array) -> list[Verdict]:
    """What is named without reason, and whether mirror images are named alike."""
    rng = np.random.default_rng(0)
    shuffled = [clips[number].label for number in rng.permutation(len(clips))]
    of_clips = Named(clips, cross_validated(clips, lambda one: one.person, shuffled), class_names(clips))
    other = GestureClassifier(clips, shuffled)
    of_scripts = Named(alone.gestures, other.scores(alone.gestures), other.labels)
    still = [drawn_alone(label, 0, rest, cue=False) for label in sorted({one.label for one in alone.gestures})]
    without = Named(still, model.scores(still), model.labels)
    images = np.array([mirrored_label(model.labels[k]) == model.labels[m] for k, m in zip(
        alone.scores.argmax(axis=1), model.scores(alone.gestures, view=1).argmax(axis=1), strict=True)], np.float64)
    return [*_both("control: shuffled labels, clips of people", of_clips, at_most(_NOTHING)),
            *_both("control: shuffled labels, scripts", of_scripts, at_most(_NOTHING)),
            *_both("control: the rest pose without a gesture", without, at_most(_NOTHING)),
            judged("mirror images of scripts named alike", alone.mean(images), at_least(0.95),
                   reason="left and right exchanged")]


def _told_apart(rest: Array, draws: int) -> Verdict:
    """All scripts, told from each other by a classifier that saw other variations of them."""
    seen, held = ([drawn_alone(name, draw, rest) for name in REPERTOIRE for draw in numbers]
                  for numbers in (range(100, 100 + max(draws // 2, 2)), range(max(draws // 4, 1))))
    model = GestureClassifier(seen)
    named = Named(held, model.scores(held), model.labels)
    return judged(f"all {len(REPERTOIRE)} scripts, told from each other", named.mean(named.hits), reason=(
        "learned from other variations of the same scripts"))


def _by_class(classes: Sequence[str], people: Named, alone: Named, spoken: Named | None) -> Table:
    rows: dict[str, dict[str, Cell]] = {}
    for label in sorted(classes, key=lambda name: (alone.of(alone.hits, name), name)):
        own = [one for one in people.gestures if one.label == label]
        rows[label] = {"clips": len(own), "people": len({one.person for one in own}),
                       "person": people.of(people.hits, label), "alone": alone.of(alone.hits, label),
                       "five": alone.of(alone.of_five, label),
                       "speech": None if spoken is None else spoken.of(spoken.hits, label),
                       "taken": alone.taken(label)}
    return Table("By class, the least recognised script first", COLUMNS, rows, "gesture", [
        "Shares of all classes, but for \"of five\". \"Clips, other people\": by a classifier without that person."])
