"""The results of `eval.score` and their tables: figures by part, the flags, and how to read them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from data_module.types import Array, Motion
from eval.clip.clip_set import TRUTH
from eval.metrics import Metric
from eval.metrics.evaluate import MotionBeats
from eval.stats import Indices
from eval.table import Column, Marked, Table, shown_cell

FEW = 10
"""Clips below which intervals are too narrow."""
FLOOR, STILL, BOBBING = "truth, half against half", "still", "bobbing"

Figures = dict[str, dict[str, Marked]]
"""row -> metric -> a figure, with the reason where it is undefined or not to be trusted."""


@dataclass
class ScoreRow:
    """A set of motions and what was measured. kind: "truth", "system" or "control".

    values: metric -> [clips]; sets: metric -> a figure of the clips with these numbers; features: network -> [n, E] by
    clip; reasons: metric -> why its figure is undefined.
    """

    name: str
    kind: str
    motions: list[Motion]
    beats: list[MotionBeats]
    values: dict[str, Array] = field(default_factory=dict)
    sets: dict[str, Callable[[Indices], float]] = field(default_factory=dict)
    features: dict[str, list[Array]] = field(default_factory=dict)
    reasons: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Flag:
    """A metric by which a control is no worse than these rows."""

    metric: str
    control: str
    beaten: Sequence[str]

    @property
    def says(self) -> str:
        """For a reader."""
        return f"does no worse than {', '.join(self.beaten)}"


@dataclass(frozen=True)
class Scores:
    """All that was measured. metrics: by column, FGD by network; kinds: row -> truth, system, control or floor; worth:
    of metrics beside ratings, where there are any."""

    clips: Sequence[str]
    seconds: float
    fps: float
    metrics: Mapping[str, Metric]
    kinds: Mapping[str, str]
    figures: Figures
    differences: Figures
    flags: Sequence[Flag]
    notes: Sequence[str]
    worth: Table | None = None


_GOOD = {"low": "less is better", "high": "more is better", "near": "near the truth's is good", "": "no judgement"}
_PARTS = {"joints": "Joint errors against the speaker", "beats": "Motion beats and onsets",
          "vigour": "Speed and smoothness", "lexemes": "Measured by the bundle",
          "eye hands": "Perceptual figures: two hands", "eye trunk": "Perceptual figures: trunk and idle motion",
          "eye strokes": "Perceptual figures: strokes", "eye voice": "Perceptual figures: synchrony",
          "eye posture": "Perceptual figures: posture", "eye together": "Perceptual figures: parts together",
          "eye phrases": "Perceptual figures: holds and pauses",
          "eye arms": "Perceptual figures: arms as people's",
          "sets": "Sets of motion", "fgd": "Sets of motion, by a network's features"}
_ROWS = {TRUTH: "the speakers' own motion", STILL: "the truth's mean pose, clip by clip, without movement",
         "shuffled": "the truth of another clip with this speech", "reversed": "the truth played backwards",
         "jitter": "the truth with every joint 2 cm off, anew in each frame",
         "mirrored": "the truth with the right arm's motion on both arms",
         BOBBING: "the truth's mean pose whose forearms stop at every onset"}
_HEADLINES = ("maje", "above_A", "above_B", "speed_hands", "jerk_hands", "speed_distance", "diversity",
              "lexeme_accuracy", "eye_stroke_amplitude", "eye_jumps", "eye_frozen", "eye_held", "eye_pause_moving",
              "eye_chest_travel", "eye_hands_apart", "eye_splay", "eye_speech_over_silence")
"""Metrics on the screen, in their order; distances by networks follow."""
_MOST_SHOWN = 6
"""Rows on the screen, the speakers' among them."""
_LEGEND = (
    "[low, high]: 95 % interval over clips. -: undefined; the JSON says why. (!): a metric that a control beats, see "
    "below. (?): a distance of a set too small for it.",
    "PMB: share of motion beats with an onset of the speech within the given number of seconds. Beats A: greatest "
    "deceleration of the arms; B: least speed. Chance: the same motion with the speech shifted in time.")


def tables(scores: Scores) -> list[Table]:
    """A table of the compared rows, one for each part, and the flags; metrics that a control beats bear (!)."""
    flagged = {flag.metric for flag in scores.flags}
    out = [_about(scores)]
    for part, title in _PARTS.items():
        metrics = {name: metric for name, metric in scores.metrics.items() if metric.part == part}
        # The floor is of distances between sets; in the other parts its row would be empty.
        rows = {name: row for name, row in scores.figures.items() if part in ("sets", "fgd") or name != FLOOR}
        if metrics:
            # The mark goes with the title, wherever a figure is quoted.
            columns = {name: Column(f"{metric.title}{' (!)' if name in flagged else ''}",
                                    f"{metric.unit}{', ' if metric.unit else ''}{_GOOD[metric.good]}", metric.digits,
                                    metric.good) for name, metric in metrics.items()}
            out.append(Table(title, columns, {name: {key: row[key] for key in columns if key in row}
                                              for name, row in {**rows, **scores.differences}.items()}, "row"))
    return [*out, _flag_table(scores), *([] if scores.worth is None else [scores.worth])]


def screen(scores: Scores, out: str | Path | None) -> str:
    """What matters most, on a terminal of 100 columns and 40 lines; out: the file that holds the rest, if any."""
    rows = [name for name, kind in scores.kinds.items() if kind in (TRUTH, "system")][:_MOST_SHOWN]
    width, flagged = 66 // len(rows), {flag.metric for flag in scores.flags}
    lines = [_about(scores).title, "", " " * 34 + "".join(f"{name[:width - 2]:>{width}}" for name in rows)]
    for name in (*_HEADLINES, *(key for key, metric in scores.metrics.items() if metric.part == "fgd")):
        metric = scores.metrics[name]
        cells = [scores.figures[row].get(name, Marked(None)) for row in rows]
        shown = [shown_cell(cell, metric.digits) for cell in cells]
        # Without the interval where the column is too narrow for it.
        shown = [text if len(text) < width else text.partition(" ")[0] for text in shown]
        if set(shown) != {"-"}:
            mark = " (!)" if name in flagged else ""
            title = metric.heading[:33 - len(mark)] + mark
            lines.append(f"{title:<34}" + "".join(f"{text:>{width}}" for text in shown))
    lines += ["", *(f"Note: {note}."[:100] for note in scores.notes[:5])]
    where = f"in {Path(out).with_suffix('.md')}" if out else "with --out FILE.json"
    return "\n".join([*lines, "(!): a control that is known to be wrong does as well. (?): the set is too small.",
                      f"All {len(scores.metrics)} figures, controls and differences: {where}"]) + "\n"


def _about(scores: Scores) -> Table:
    """The compared clips, the rows, and how to read the cells."""
    clips, kinds = len(scores.clips), scores.kinds
    # In the title, so that it goes with every figure that is quoted.
    few = f" Fewer than {FEW} clips: the intervals are too narrow." if clips < FEW else ""
    rows: dict[str, str] = {TRUTH: _ROWS[TRUTH]} | {name: "judged" for name, kind in kinds.items() if kind == "system"}
    rows |= {name: f"{_ROWS[name]} (control, known to be wrong)" for name, kind in kinds.items() if kind == "control"}
    rows[FLOOR] = "as far apart as two sets of real motion of this size are"
    if scores.differences:
        rows["A - B"] = "the difference of two systems, paired over clips"
    facts = {"clips": list(scores.clips), "seconds": scores.seconds, "fps": scores.fps, "notes": list(scores.notes),
             "systems": [name for name, kind in kinds.items() if kind == "system"],
             "controls": [name for name, kind in kinds.items() if kind == "control"]}
    return Table(f"{clips} clip{'' if clips == 1 else 's'}, {scores.seconds:.0f} s, at {scores.fps:g} fps.{few}",
                 {"what": Column("what it is")}, {name: {"what": text} for name, text in rows.items()}, "row",
                 [*_LEGEND, *(f"Note: {note}." for note in scores.notes)], facts)


def _flag_table(scores: Scores) -> Table:
    """Which metrics cannot be trusted."""
    title, column = "Metrics that a control beats", {"says": Column("by what")}
    lines: dict[str, list[str]] = {}
    for flag in scores.flags:
        lines.setdefault(scores.metrics[flag.metric].heading, []).append(f"*{flag.control}* {flag.says}")
    return Table(title, column if lines else {}, {name: {"says": ". ".join(says)} for name, says in lines.items()},
                 "metric", [] if lines else ["None."],
                 {"flags": [vars(flag) | {"title": scores.metrics[flag.metric].heading} for flag in scores.flags]})
