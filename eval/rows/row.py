"""What a row of an ablation is, the columns that rows are judged by, and what a table of a paper is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from eval.metrics import pmb
from eval.table import Column

PAPERS_DELTA = 0.2
"""Seconds: the tolerance of PMB that the papers print."""
DECIDED = 3
"""Seeds; fewer decide nothing."""
EPISODE = 15
"""Decisions in an episode, RACER's 6 seconds of codes."""
Paper = Mapping[str, tuple[float | None, float | None]]
"""Figures of the paper by column: on Trinity and on the table's other data set."""


@dataclass(frozen=True)
class Row:
    """A variant: what it asks, what it changes on top of a preset, as after --set, and how it is trained and played."""

    question: str
    settings: tuple[str, ...] = ()
    interpreter: str = "lstm"
    """Who chooses the lexemes, as after `--interpreter`."""
    style: str = "interpreted"
    """Whose style codes are played: "interpreted", or "random" for z drawn from N(0, I) on each block."""
    split: str = "test"
    """"val" for what is there to choose a setting by."""
    training: str = "stages"
    """"stages": those of the training command; else a Q-network over a given lexicon: see `eval.rows.racer`."""
    scale: float = 1.0
    """Of such a network: what rewards are multiplied by before it learns from them. One head is both classifier and
    value: rewards that are small beside the log-odds of a lexeme change no choice, whatever their sign."""
    matched: str = ""
    """Of such a network: the row whose network it is, which is then sampled at the temperature that makes it as
    undecided as the lstm; empty for a network of its own, which takes the best."""


@dataclass(frozen=True)
class RowColumn(Column):
    """A column of the rows' tables. paper: key of the paper's figures that stand beside it. by_blocks: clips count by
    their decisions."""

    paper: str = ""
    by_blocks: bool = False

    def shown(self) -> Column:
        """As a column of a table."""
        return Column(self.title, self.unit, self.digits, self.good)


COLUMNS: dict[str, RowColumn] = {
    "maje": RowColumn("MAJE", "mm", 1, "low", "maje"), "mad": RowColumn("MAD", "mm/s^2", 0, "low", "mad"),
    "fgd": RowColumn("FGD", "", 2, "low", "fgd"), "pmb": RowColumn(f"PMB at {PAPERS_DELTA} s", "%", 1, "high", "pmb"),
    "pmb_above_chance": RowColumn(f"PMB at {pmb.DELTA} s above chance", "%", 1, "high"),
    "diversity": RowColumn("diversity", "nats", 2, "near", "diversity"),
    "variance": RowColumn("motion variance", "", 3, "near", "variance"),
    "accuracy": RowColumn("right, free-running", "%", 1, "", "accuracy"),
    "teacher_forced": RowColumn("right, teacher-forced", "%", 1),
    "speech_speed": RowColumn("hands in speech", "m/s", 3, "near"),
    "silence_speed": RowColumn("hands in silence", "m/s", 3, "near"),
}
"""One value a clip, of every row that is played."""

TRAINING, JUDGING, LEXEMES, SUPPORT, VALUES, PLAYED = (
    "training reward", "judging reward", "lexemes", "support", "values", "motion")
DECISIONS: dict[str, dict[str, RowColumn]] = {
    TRAINING: {"return": RowColumn(f"return of {EPISODE} steps", "", 2, "high", "return"),
               "cosine": RowColumn("cosine", "", 3, "high", by_blocks=True),
               "regret": RowColumn("regret", "", 3, "low", by_blocks=True)},
    JUDGING: {"judge_return": RowColumn(f"return of {EPISODE} steps", "", 2, "high"),
              "judge_cosine": RowColumn("cosine", "", 3, "high", by_blocks=True),
              "judge_regret": RowColumn("regret", "", 3, "low", by_blocks=True)},
    LEXEMES: {"accuracy": RowColumn("right, free-running", "%", 1, "", by_blocks=True),
              "teacher_forced": RowColumn("right, teacher-forced", "%", 1, "", by_blocks=True),
              "lexeme_diversity": RowColumn("diversity", "nats", 2),
              "longest_run": RowColumn("longest run", "", 1), "distinct_2": RowColumn("distinct-2", "", 2)},
    SUPPORT: {"rare": RowColumn("out of distribution", "%", 1, "", by_blocks=True),
              "unseen_bigrams": RowColumn("unseen bigrams", "%", 1, "", by_blocks=True),
              "silent": RowColumn("silent lexeme in silence", "%", 1)},
    VALUES: {"nll": RowColumn("E[logsumexp Q - Q(a_data)]", "", 2), "gap": RowColumn("E[max Q - Q(a_data)]", "", 2),
             "calibration": RowColumn("Q(s_1, a_1) - discounted return", "", 2),
             "spearman": RowColumn("Spearman of Q with the return-to-go", "", 2)},
    PLAYED: {"pmb_narrow": RowColumn(f"PMB at {pmb.DELTA} s", "%", 1, "high", "pmb"),
             "fgd": RowColumn("FGD, by the jackknife", "", 2, "low", "fgd"),
             **{key: COLUMNS[key] for key in ("pmb_above_chance", "speech_speed", "silence_speed", "maje", "mad")}},
}
"""What policies are judged by, one value a clip, by the table that shows it."""


@dataclass(frozen=True)
class TableLine:
    """A line of a table: the paper's name for it, our row, the paper's figures."""

    label: str
    row: str
    paper: Paper = field(default_factory=dict)


@dataclass(frozen=True)
class PaperTable:
    """A table or figure of a paper: its columns in order and its lines. places: what the paper's two figures are of;
    references: whether the performer and the controls stand below."""

    columns: Mapping[str, RowColumn]
    lines: tuple[TableLine, ...]
    split: str = "test"
    places: tuple[str, str] = ("Trinity", "TED")
    references: bool = True


def line(label: str, row: str, keys: str = "", first: tuple[float, ...] = (), second: tuple[float, ...] = ()
         ) -> TableLine:
    """The paper's figures on its two data sets; () for a set that it has none of."""
    named = keys.split()
    one, other = (values or (None,) * len(named) for values in (first, second))
    return TableLine(label, row, {key: (a, b) for key, a, b in zip(named, one, other, strict=True)})
