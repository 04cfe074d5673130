"""Does the motion do what is asked of its style? (RG 7.2.1, Fig. 10)

    gesticulator probe style-editing --data STORE [--bundle DIR] [--picture FILE.png] [--rhythm]

For each feature (height of the right hand, speed of both hands, radius of both hands) and each level (low, mid, high:
the 15, 50 and 85 % quantiles of training) every clip is generated with that level asked for throughout and nothing
else, and what came out is measured, unsmoothed, and averaged over the clip. Every row plays the same clips with the
same seed, so differences between rows are paired. An editing signal is accepted when low, mid and high stand in order
and neighbouring 95 % intervals do not overlap.

Floor: the row where nothing is asked. Beside it: the motion that the store holds for the same clips. What fools these
figures: a hand that trembles is a fast hand, so speed is given a second time after smoothing over 50 ms, which takes
tremor off; features go together in a body (raising a hand from the hip takes it outwards), so that a change of what
was not asked for need not be an error; and fewer than about ten clips make an interval too narrow.
"""

from __future__ import annotations

import argparse
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from data_module.controls import FEATURES, LEVELS, UNITS, Controls, Levels, measure, per_frame
from data_module.errors import InputError
from data_module.motion.motion_beats import ACTING, acting_positions, acting_speed
from data_module.store import Recording, RecordingInfo, Store
from data_module.types import Array, Motion, Speech, Word
from eval.clip import ClipMeasurement
from eval.clip import measure as measure_clip
from eval.draw.strips import save_strip
from eval.stats import Interval, mean_interval
from eval.table import Column, Marked, Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from gesticulator.pipeline import Gesticulator

CLIPS = 8
SECONDS = 40.0
SHORTEST = 5.0
"""Seconds: a shorter recording holds no more than a window and is left out."""
MEASURED = (*FEATURES, "steady_speed")
"""What is measured on every clip: the features, and the speed of the hands without tremor."""
FREE, REFERENCE = "nothing asked", "the store's own motion"
_UNITS = UNITS | {"steady_speed": UNITS["speed"]}
_NAMES = {"height": "right hand height", "speed": "hand speed", "radius": "hand radius",
          "steady_speed": "hand speed without tremor"}
_STEADY = 0.5  # of a rise in speed must be left without tremor
_HAND_COLUMNS = [column for column, name in enumerate(ACTING) if name.endswith("Hand")]


@dataclass(frozen=True)
class Excerpt:
    """A stretch of speech that is played in every row. reference: [T frames] what the store holds for it."""

    name: str
    speaker: str
    speech: Speech
    reference: Motion


Play = Callable[[Excerpt, Controls], Motion]
"""Whoever is judged: motion for an excerpt, with what is asked of its style."""


# ----------------------------------------------------------------------------------------------------- clips

def excerpts(store: Store, count: int = CLIPS, seconds: float = SECONDS) -> list[Excerpt]:
    """The middle `seconds` of up to `count` test recordings, one of each group, the long ones first."""
    if count < 2:
        raise InputError(f"--clips {count}", "is too few for an interval", "give 2 or more")
    if not SHORTEST <= seconds < math.inf:
        raise InputError(f"--seconds {seconds:g}", "is out of range", f"give {SHORTEST:g} or more")
    groups: dict[str, RecordingInfo] = {}
    for info in store.of_split("test"):
        if info.seconds >= SHORTEST:
            groups.setdefault(info.group or info.name, info)
    chosen = sorted(groups.values(), key=lambda info: -min(info.seconds, seconds))[:count]
    if len(chosen) < 2:
        raise InputError(store.path, f"has {len(chosen)} test recordings of {SHORTEST:g} s or more",
                         "an interval needs 2: build a larger store")
    return [excerpt(store.load(info.name), seconds) for info in chosen]


def excerpt(recording: Recording, seconds: float) -> Excerpt:
    """The middle `seconds` of a recording (all of it when it is shorter), with the words that lie in it."""
    speech, motion = recording.speech, recording.motion
    start = max(0.0, (speech.duration - seconds) / 2)
    stop = min(speech.duration, start + seconds)
    first, last = (round(at * speech.sample_rate) for at in (start, stop))
    words = None if speech.words is None else tuple(
        Word(word.text, word.start - start, word.end - start) for word in speech.words
        if start <= word.start and word.end <= stop)
    frames = motion.crop(round(start * motion.fps), max(round(stop * motion.fps), round(start * motion.fps) + 1))
    return Excerpt(recording.info.name, recording.info.speaker,
                   replace(speech, samples=np.ascontiguousarray(speech.samples[first:last]), words=words), frames)


def played_by(system: Gesticulator, seed: int = 0) -> Play:
    """A bundle as one who plays: in the habits of each excerpt's own performer where the bundle knows them."""
    def play(clip: Excerpt, controls: Controls) -> Motion:
        speaker = clip.speaker if clip.speaker in system.speakers else None
        return system(clip.speech, speaker=speaker, controls=controls, seed=seed).motion

    return play


# --------------------------------------------------------------------------------------------------- figures

def realised(motion: Motion) -> Array:
    """What a motion does, [4] in the order of `MEASURED`: means over all frames, nothing smoothed but the last."""
    hands = acting_positions(motion)[:, _HAND_COLUMNS]
    return np.append(per_frame(motion).mean(axis=0), acting_speed(hands, motion.fps).mean() / len(_HAND_COLUMNS))


def apart(lower: Interval, upper: Interval) -> bool:
    """True when the whole of one interval lies below the other (False where either is not defined)."""
    return lower.high < upper.low


def rises(low: Interval, mid: Interval, high: Interval) -> bool:
    """The rule of acceptance: low, mid and high stand in order and neighbouring intervals do not overlap."""
    return apart(low, mid) and apart(mid, high)


def row_name(feature: str, level: str) -> str:
    """The name of the row in which one level of one feature is asked for."""
    return f"{feature} {level}"


def asked_for(levels: Levels) -> dict[str, Controls]:
    """What each generated row asks for: nothing, then every level of every feature alone."""
    rows = {FREE: Controls.free()}
    for feature, level in itertools.product(FEATURES, LEVELS):
        rows[row_name(feature, level)] = Controls(**{feature: levels.value(feature, level)})
    return rows


def figures(play: Play, clips: Sequence[Excerpt], levels: Levels, *, rhythm: bool = False,
            progress: bool = False) -> dict[str, Any]:
    """Everything that is told, as plain values.

    "values" has each row's measures clip by clip, "series" the asked feature of the first clip over time (averaged over
    four seconds, as in training), "rows" means with intervals, "editing" what became of each feature's three levels,
    "elsewhere" what asking for one feature does to the others, "rhythm" (when asked) PMB beside its chance level.
    """
    from tqdm import tqdm

    values = {REFERENCE: np.array([realised(clip.reference) for clip in clips])}
    series: dict[str, Any] = {}
    beats: dict[str, list[ClipMeasurement]] = {
        REFERENCE: [measure_clip(clip.reference, clip.speech) for clip in clips]} if rhythm else {}
    for name, controls in tqdm(asked_for(levels).items(), desc="style editing", disable=not progress):
        measured = []
        for number, clip in enumerate(clips):
            motion = play(clip, controls)
            measured.append(realised(motion))
            if rhythm:
                beats.setdefault(name, []).append(measure_clip(motion, clip.speech))
            if number == 0:
                series[name] = {"fps": motion.fps, "values": measure(motion).T.round(4).tolist()}
        values[name] = np.array(measured)
    told: dict[str, Any] = {
        "clips": [{"name": clip.name, "speaker": clip.speaker, "seconds": round(clip.speech.duration, 2)}
                  for clip in clips],
        "asked": {feature: {level: levels.value(feature, level) for level in LEVELS} for feature in FEATURES},
        "spread": dict(zip(FEATURES, levels.spread.tolist(), strict=True)),
        "rows": {name: _row(of) for name, of in values.items()},
        "editing": {feature: editing(feature, values, levels) for feature in FEATURES},
        "elsewhere": {feature: _changes(values, feature) for feature in FEATURES},
        "values": {name: dict(zip(MEASURED, of.T.tolist(), strict=True)) for name, of in values.items()},
        "series": series,
    }
    if rhythm:
        told["rhythm"] = {name: rhythm_row(measured) for name, measured in beats.items()}
    return told


def rhythm_row(clips: Sequence[ClipMeasurement]) -> dict[str, Interval]:
    """Motion beats a second, and PMB beside its chance level at `pmb.DELTA`, percent."""
    rhythms = [clip.rhythm() for clip in clips]
    return {"beats": mean_interval([clip.beats_per_second for clip in clips]),
            **{key: mean_interval([getattr(one, key) for one in rhythms]) for key in ("pmb", "chance", "above_chance")}}


def _row(values: Array) -> dict[str, Interval]:
    return {name: mean_interval(column) for name, column in zip(MEASURED, values.T, strict=True)}


def editing(feature: str, values: Mapping[str, Array], levels: Levels) -> dict[str, Any]:
    """What became of the three levels of one feature, from values [clips, 4] by the name of each row.

    "error" is realised less asked; "share" is how much of the asked range, low to high, was realised (1 is all of it),
    clip by clip; "in_order" is the share of clips whose own three values rise; "steady", for speed alone, is how much
    of its rise from low to high is left without tremor.
    """
    own = {level: values[row_name(feature, level)][:, MEASURED.index(feature)] for level in LEVELS}
    asked = {level: levels.value(feature, level) for level in LEVELS}
    around = {level: mean_interval(own[level]) for level in LEVELS}
    span = asked["high"] - asked["low"]
    told: dict[str, Any] = {
        "realised": {level: around[level] for level in LEVELS},
        "error": {level: mean_interval(own[level] - asked[level]) for level in LEVELS},
        "low_to_mid": mean_interval(own["mid"] - own["low"]),
        "mid_to_high": mean_interval(own["high"] - own["mid"]),
        "share": mean_interval((own["high"] - own["low"]) / (span if span > 0 else math.nan)),
        "in_order": float(np.mean((own["low"] < own["mid"]) & (own["mid"] < own["high"]))),
        "overlap_low_mid": not apart(around["low"], around["mid"]),
        "overlap_mid_high": not apart(around["mid"], around["high"]),
        "rises": rises(*around.values()),
    }
    if feature == "speed":
        low, high = (values[row_name(feature, level)][:, MEASURED.index("steady_speed")].mean()
                     for level in ("low", "high"))
        rise = float((own["high"] - own["low"]).mean())
        told["steady"] = float(high - low) / rise if rise > 0 else math.nan
    return told


def _changes(values: Mapping[str, Array], feature: str) -> dict[str, Interval]:
    """What everything measured changes by, clip by clip, when one feature is asked for at high instead of at low."""
    return _row(values[row_name(feature, "high")] - values[row_name(feature, "low")])


# ---------------------------------------------------------------------------------------------------- tables

EDITING = {"asked": Column("asked low / mid / high"), "low": Column("realised low", digits=3),
           "mid": Column("mid", digits=3), "high": Column("high", digits=3), "apart": Column("intervals apart"),
           "low_to_mid": Column("low to mid", digits=3), "mid_to_high": Column("mid to high", digits=3),
           "share": Column("share of the asked range"), "in_order": Column("clips in order", "%", 0)}
RHYTHM = {"beats": Column("motion beats", "Hz"), "pmb": Column("PMB at 0.1 s", "%", 1),
          "chance": Column("chance", "%", 1), "above_chance": Column("above chance", "%", 1)}


def tables(result: Mapping[str, Any]) -> list[Table]:
    """What became of each level, what every row does, and what else an edit changes.

    The facts of the first have the claim of RG Fig. 10: what each feature rises by from level to level, in spreads of
    training.
    """
    clips = result["clips"]
    about = (f"{len(clips)} test clips, {sum(clip['seconds'] for clip in clips):.0f} s; the same clips and seed in "
             "every row.")
    edited = {_heading(feature): {
        "asked": " / ".join(f"{value:.3f}" for value in result["asked"][feature].values()), **told["realised"],
        "apart": _verdict(told), "in_order": 100 * told["in_order"],
        **{key: told[key] for key in ("low_to_mid", "mid_to_high", "share")}}
        for feature, told in result["editing"].items()}
    claim = [{key: value if key == "n" else value / _spread(result, feature)
              for key, value in told[step].to_dict().items()}
             for feature, told in result["editing"].items() for step in ("low_to_mid", "mid_to_high")]
    measured = {name: Column(_NAMES[name], _UNITS[name], 3) for name in MEASURED}
    changes = {_NAMES[feature]: {name: Marked(row[name], f"({row[name].mean / _spread(result, name):+.1f})")
                                 for name in MEASURED} for feature, row in result["elsewhere"].items()}
    facts = {key: result[key] for key in ("clips", "asked", "spread", "values")} | {"claim": claim}
    out = [Table("Style editing", EDITING, edited, "feature", [about], facts),
           Table("What every row does", measured, result["rows"], "row"),
           Table("What asking for a feature at high instead of at low changes", measured, changes, "asked",
                 ["In brackets: in spreads of training."])]
    if "rhythm" in result:
        out.append(Table("In time with the voice", RHYTHM, result["rhythm"], "row"))
    return out


def _heading(name: str) -> str:
    return f"{_NAMES[name]}, {_UNITS[name]}"


def _spread(result: Mapping[str, Any], name: str) -> float:
    return float(result["spread"]["speed" if name == "steady_speed" else name])


def _verdict(told: Mapping[str, Any]) -> str:
    if told["rises"]:
        return "only by tremor" if told.get("steady", 1.0) < _STEADY else "yes"
    pairs = [name for name, key in (("low, mid", "overlap_low_mid"), ("mid, high", "overlap_mid_high")) if told[key]]
    return "no: " + " and ".join(pairs)


def figure_10(result: Mapping[str, Any]) -> Figure:
    """After Fig. 10: for each feature the first clip over time beside what was asked, and box plots of all clips.

    Whiskers reach the extremes; dashes are what was asked for.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 3 * len(FEATURES)), layout="constrained")
    colours = dict(zip(LEVELS, ("tab:blue", "tab:green", "tab:red"), strict=True))
    for index, (feature, axes) in enumerate(zip(FEATURES, figure.subplots(
            len(FEATURES), 2, width_ratios=(2, 1), sharey="row"), strict=True)):
        over_time, boxes = axes
        for level, colour in colours.items():
            series = result["series"][row_name(feature, level)]
            curve = series["values"][index]
            over_time.plot(np.arange(len(curve)) / series["fps"], curve, color=colour, label=level)
            over_time.axhline(result["asked"][feature][level], color=colour, linestyle="--", linewidth=0.8)
        rows = [row_name(feature, level) for level in LEVELS]
        drawn = boxes.boxplot([result["values"][row][feature] for row in (*rows, FREE, REFERENCE)], whis=(0, 100))
        boxes.set_xticks(range(1, len(rows) + 3), [*LEVELS, "free", "store"])
        for place, (level, colour) in enumerate(colours.items(), 1):
            boxes.hlines(result["asked"][feature][level], place - 0.4, place + 0.4, color=colour, linestyle="--")
            drawn["boxes"][place - 1].set_color(colour)
        over_time.set_ylabel(f"{_NAMES[feature]}, {UNITS[feature]}")
        if index == 0:
            over_time.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=len(LEVELS), frameon=False)
    over_time.set_xlabel(f"seconds of {result['clips'][0]['name']} (mean over 4 s)")
    boxes.set_xlabel(f"means over {len(result['clips'])} clips")
    return figure


def arguments(parser: argparse.ArgumentParser) -> None:
    """A store, a bundle, how many clips."""
    parser.add_argument("--data", required=True, metavar="STORE", help="its test split is played")
    parser.add_argument("--bundle", metavar="DIR", help="default: the shipped one")
    parser.add_argument("--picture", type=Path, metavar="FILE.png", help="also draw RG Fig. 10")
    parser.add_argument("--clips", type=int, default=CLIPS, help=f"how many clips (default {CLIPS})")
    parser.add_argument("--seconds", type=float, default=SECONDS, help=f"of each clip (default {SECONDS:g})")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rhythm", action="store_true", help="also PMB beside its chance level in every row")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")


def run(arguments: argparse.Namespace) -> list[Table]:
    """Play every level; InputError for a bundle without controls."""
    import torch

    from gesticulator.pipeline import Gesticulator

    if arguments.picture and arguments.picture.suffix.lower() != ".png":
        raise InputError(f"--picture {arguments.picture}", "does not end in .png", "name it FILE.png")
    clips = excerpts(Store.open(arguments.data), arguments.clips, arguments.seconds)
    torch.set_num_threads(1)
    system = Gesticulator.from_pretrained(arguments.bundle)
    if system.bundle.levels is None:
        raise InputError(arguments.bundle or "the shipped bundle", "has no controls",
                         "use a bundle trained with style editing")
    result = figures(played_by(system, arguments.seed), clips, system.bundle.levels, rhythm=arguments.rhythm,
                     progress=not arguments.quiet)
    if arguments.picture:
        save_strip(figure_10(result), arguments.picture)
    return tables(result)
