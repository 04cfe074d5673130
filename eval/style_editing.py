"""Does the motion do what is asked of its style? (RG 7.2.1, Fig. 10)

    python -m eval.style_editing --data STORE [--bundle DIR] [--out FILE.json] [--picture FILE.png] [--rhythm]

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
import io
import itertools
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from data_module.controls import FEATURES, LEVELS, UNITS, Controls, Levels, measure, per_frame
from data_module.errors import InputError, one_line_errors
from data_module.files import write_bytes
from data_module.motion.motion_beats import ACTING, acting_positions, acting_speed
from data_module.store import Recording, RecordingInfo, Store
from data_module.types import Array, Motion, Speech, Word
from eval.bootstrap import Interval, interval
from eval.results import keep

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
    heard: dict[str, list[Any]] = {REFERENCE: [_heard(clip.reference, clip) for clip in clips]} if rhythm else {}
    for name, controls in tqdm(asked_for(levels).items(), desc="style editing", disable=not progress):
        measured = []
        for number, clip in enumerate(clips):
            motion = play(clip, controls)
            measured.append(realised(motion))
            if rhythm:
                heard.setdefault(name, []).append(_heard(motion, clip))
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
        from eval.figures import rhythm_row

        told["rhythm"] = {name: rhythm_row(of) for name, of in heard.items()}
    return told


def _heard(motion: Motion, clip: Excerpt) -> Any:
    from eval.figures import measure as measure_rhythm

    return measure_rhythm(motion, clip.speech)


def _row(values: Array) -> dict[str, Any]:
    return {name: interval(column).to_dict() for name, column in zip(MEASURED, values.T, strict=True)}


def editing(feature: str, values: Mapping[str, Array], levels: Levels) -> dict[str, Any]:
    """What became of the three levels of one feature, from values [clips, 4] by the name of each row.

    "error" is realised less asked; "share" is how much of the asked range, low to high, was realised (1 is all of it),
    clip by clip; "in_order" is the share of clips whose own three values rise; "steady", for speed alone, is how much
    of its rise from low to high is left without tremor.
    """
    own = {level: values[row_name(feature, level)][:, MEASURED.index(feature)] for level in LEVELS}
    asked = {level: levels.value(feature, level) for level in LEVELS}
    around = {level: interval(own[level]) for level in LEVELS}
    span = asked["high"] - asked["low"]
    told: dict[str, Any] = {
        "realised": {level: around[level].to_dict() for level in LEVELS},
        "error": {level: interval(own[level] - asked[level]).to_dict() for level in LEVELS},
        "low_to_mid": interval(own["mid"] - own["low"]).to_dict(),
        "mid_to_high": interval(own["high"] - own["mid"]).to_dict(),
        "share": interval((own["high"] - own["low"]) / (span if span > 0 else math.nan)).to_dict(),
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


def _changes(values: Mapping[str, Array], feature: str) -> dict[str, Any]:
    """What everything measured changes by, clip by clip, when one feature is asked for at high instead of at low."""
    return _row(values[row_name(feature, "high")] - values[row_name(feature, "low")])


# ---------------------------------------------------------------------------------------------------- report

def _cell(value: Mapping[str, float], digits: int = 3, sign: str = "") -> str:
    if math.isnan(value["mean"]):
        return "-"
    return f"{value['mean']:{sign}.{digits}f} [{value['low']:{sign}.{digits}f}, {value['high']:{sign}.{digits}f}]"


def markdown(result: Mapping[str, Any]) -> str:
    """The tables of `figures` for a reader."""
    clips = result["clips"]
    lines = [f"{len(clips)} test clips, {sum(clip['seconds'] for clip in clips):.0f} s; means over clips with "
             "bootstrap 95 % intervals; the same clips and seed in every row.", "",
             "| feature | asked low / mid / high | realised low | mid | high | intervals apart | low to mid | "
             "mid to high | share of the asked range | clips in order |", "|---|---|---|---|---|---|---|---|---|---|"]
    for feature, told in result["editing"].items():
        asked = " / ".join(f"{value:.3f}" for value in result["asked"][feature].values())
        cells = [f"{_NAMES[feature]}, {UNITS[feature]}", asked, *(_cell(told["realised"][level]) for level in LEVELS),
                 _verdict(told), _cell(told["low_to_mid"], sign="+"), _cell(told["mid_to_high"], sign="+"),
                 _cell(told["share"], 2), f"{100 * told['in_order']:.0f} %"]
        lines.append(f"| {' | '.join(cells)} |")
    lines += ["", f"| row | {' | '.join(f'{_NAMES[name]}, {_UNITS[name]}' for name in MEASURED)} |",
              "|---|" + "---|" * len(MEASURED)]
    lines += [f"| {name} | {' | '.join(_cell(row[one]) for one in MEASURED)} |" for name, row in result["rows"].items()]
    lines += ["", "What asking for a feature at high instead of at low changes (in spreads of training):", "",
              f"| asked | {' | '.join(_NAMES[name] for name in MEASURED)} |", "|---|" + "---|" * len(MEASURED)]
    for feature, row in result["elsewhere"].items():
        cells = [f"{_cell(row[name], sign='+')} ({row[name]['mean'] / _spread(result, name):+.1f})"
                 for name in MEASURED]
        lines.append(f"| {_NAMES[feature]} | {' | '.join(cells)} |")
    if "rhythm" in result:
        lines += ["", "| in time with the voice | beats/s | PMB at 0.1 s | chance | above chance, % |",
                  "|---|---|---|---|---|"]
        lines += [f"| {name} | {row['motion_beats_per_second']['mean']:.2f} | {_cell(row['0.1']['pmb'], 1)} | "
                  f"{row['0.1']['chance']['mean']:.1f} | {_cell(row['0.1']['above_chance'], 1)} |"
                  for name, row in result["rhythm"].items()]
    return "\n".join(lines) + "\n"


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


def picture(result: Mapping[str, Any]) -> bytes:
    """`figure_10` as a PNG, the same bytes for the same figures."""
    memory = io.BytesIO()
    figure_10(result).savefig(memory, format="png", dpi=120, metadata={"Software": None})
    return memory.getvalue()


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point."""
    p = argparse.ArgumentParser("eval.style_editing", description="Does the motion do what is asked of its style?")
    p.add_argument("--data", required=True, metavar="STORE", help="its test split is played")
    p.add_argument("--bundle", metavar="DIR", help="default: the shipped one")
    p.add_argument("--out", default="docs/results/style_editing.json", metavar="FILE.json",
                   help="a .md is written beside it")
    p.add_argument("--picture", metavar="FILE.png", help="also draw Figure 10")
    p.add_argument("--clips", type=int, default=CLIPS, help=f"how many clips (default {CLIPS})")
    p.add_argument("--seconds", type=float, default=SECONDS, help=f"of each clip (default {SECONDS:g})")
    p.add_argument("--seed", type=int, default=0)
    p.add_argument("--rhythm", action="store_true", help="also PMB beside its chance level in every row")
    p.add_argument("--quiet", action="store_true", help="no progress bar")
    arguments = p.parse_args(argv)
    with one_line_errors("eval.style_editing"):
        if arguments.picture and Path(arguments.picture).suffix.lower() != ".png":
            raise InputError(f"--picture {arguments.picture}", "does not end in .png", "name it FILE.png")
        clips = excerpts(Store.open(arguments.data), arguments.clips, arguments.seconds)
        import torch

        from gesticulator.pipeline import Gesticulator

        torch.set_num_threads(1)
        system = Gesticulator.from_pretrained(arguments.bundle)
        if system.bundle.levels is None:
            raise InputError(arguments.bundle or "the shipped bundle", "hears no controls",
                             "use a bundle trained with style editing")
        result = figures(played_by(system, arguments.seed), clips, system.bundle.levels, rhythm=arguments.rhythm,
                         progress=not arguments.quiet)
        keep(result, markdown(result), arguments.out)
        if arguments.picture:
            write_bytes(arguments.picture, picture(result))
        print(markdown(result))
    return 0


if __name__ == "__main__":
    sys.exit(main())
