"""The contents of `gesticulator ablate`: the rows of rows.toml, the tables and claims of papers.toml, as types.

Both files say at their head what each key means. A row is a change of settings, as one would type it after --set, so
which of its stages are trained again follows from the hashes of its settings. The presets are of the papers' system
(poses, regression); what the preset `default` has in its place is the row `flow`.
"""

import math
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from data_module.errors import InputError
from eval.table import Column
from gesticulator.bundle import config as configs
from gesticulator.bundle.config import Config
from gesticulator.training import presets

OURS, PERFORMER, REAL_TAKE, FLOOR = "ours", "performer", "real-take", "halves"
RACER_OURS, RACER_SUPERVISED = "racer-cql", "racer-supervised"
REFERENCES = {PERFORMER: "the motion that the store was made with", REAL_TAKE: "a person speaking (BEAT), one take"}
CONTROLS = {"shuffled": "the performer's motion for another speech", "reversed": "the performer's motion, backwards",
            "jitter": "the performer's motion, each joint 2 cm off, anew in each frame",
            "still": "the performer's mean pose, held", "bobbing": "that pose, its forearms up and down at the onsets",
            FLOOR: "one half of the performer's clips against the other"}
"""References and controls stand in every table; nothing is trained for them."""
DOSES = {"jitter": 3, "smaller": 2, "larger": 2, "frozen-trunk": 2, "mirrored": 2}
"""Damage to the performer's motion and its rising doses (`eval.baselines.controls.damaged`), which a distance between
sets must order."""
DOSED = tuple(f"{kind}-{dose}" for kind, doses in DOSES.items() for dose in range(1, doses + 1))
SYSTEMS = ("SG", "Ges", "GTC", "S2AG", "Bailando")
"""The papers' baselines, by the names under which `--system NAME=DIR` fills their lines."""
DECIDED = 3
"""Seeds; fewer decide nothing."""
SIGNS = {"<": "lower than", ">": "higher than", "=": "about that of"}


class Row(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A variant of a system; the fields are the keys of rows.toml."""

    ask: str
    set: tuple[str, ...] = ()
    play: str = "lstm"
    style: str = "interpreted"
    split: str = "test"
    train: str = "stages"
    scale: float = 1.0


@dataclass(frozen=True)
class FigureColumn(Column):
    """A column of the rows' tables; the fields are the keys of papers.toml."""

    metric: str = ""
    paper: str = ""
    valid: str = ""
    margin: str = "as it stands"
    alike: float = math.nan
    controls: tuple[str, ...] = ()
    doses: bool = False


class TableLine(msgspec.Struct, frozen=True, array_like=True):
    """A line of a table: the paper's name for it, our row, and the paper's figures by column, one for each data set."""

    label: str
    row: str
    paper: dict[str, tuple[float, ...]] = {}


@dataclass(frozen=True)
class Claim:
    """`first`'s figure by a column is lower (<) or higher (>) than `second`'s, or about the same (=)."""

    where: str
    metric: str
    first: str
    sign: str
    second: str


class PaperTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A table or figure of a paper. sentences: its claims as papers.toml writes them; places: the data sets of the
    paper's figures; references: whether the performer and the controls stand below."""

    title: str
    columns: tuple[str, ...]
    lines: tuple[TableLine, ...]
    sentences: tuple[str, ...] = msgspec.field(default=(), name="claims")
    split: str = "test"
    places: tuple[str, ...] = ("Trinity", "TED")
    references: bool = True

    @property
    def claims(self) -> Iterator[Claim]:
        """Every column of a sentence with every row that it compares."""
        # "fgd: ours < no-style no-lexemes" is a claim by one column about each of two rows.
        for sentence in self.sentences:
            metrics, _, comparison = sentence.partition(": ")
            first, sign, *others = comparison.split()
            for metric in metrics.split():
                for second in others:
                    yield Claim(self.title, metric, first, sign, second)

    def printed(self, row: str, column: str) -> tuple[float, ...]:
        """The paper's figures of a row by a column, NaN for a data set that it has none of; empty without any."""
        line = next((line for line in self.lines if line.row == row), None)
        return () if line is None else line.paper.get(COLUMNS[column].paper, ())

    def both(self, claim: Claim) -> list[tuple[str, float, float]]:
        """Place and the two figures of a claim's rows, on each data set on which the paper prints both."""
        pair = [self.printed(row, claim.metric) for row in (claim.first, claim.second)]
        return [(place, one, other) for place, one, other in zip(self.places, *pair, strict=False)
                if math.isfinite(one + other)]


class Elsewhere(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A claim that no table carries; the fields are the keys of papers.toml."""

    where: str
    says: str
    needs: str = ""
    lowest: tuple[float, ...] = ()
    intervals: int = 1
    source: str = ""


def _toml(name: str) -> dict[str, Any]:
    return tomllib.loads((Path(__file__).parent / name).read_text(encoding="utf-8"))


def _rows() -> dict[str, Row]:
    """The rows by name, each with the settings of the row that it is `from` before its own."""
    entries = _toml("rows.toml")
    for entry in entries.values():
        # A base stands above the rows that start from it, so its own base is in its settings already.
        entry["set"] = [*entries.get(entry.pop("from", ""), {}).get("set", []), *entry.get("set", [])]
    return msgspec.convert(entries, dict[str, Row])


_PAPERS = _toml("papers.toml")
ROWS: dict[str, Row] = _rows()
COLUMNS: dict[str, FigureColumn] = msgspec.convert(_PAPERS["columns"], dict[str, FigureColumn])
TABLES: dict[str, PaperTable] = {table.title: table for table in msgspec.convert(_PAPERS["table"], list[PaperTable])}
ELSEWHERE: list[Elsewhere] = msgspec.convert(_PAPERS["elsewhere"], list[Elsewhere])


# ------------------------------------------------------------------------------------------------------------- presets

def base(name: str) -> Config:
    """The preset of that name, without what no row of the papers has: gate, planner, style editing, a Q-network (which
    is a row). InputError for a preset of another system than the papers' generator.
    """
    config = presets.preset(name)
    if config.system != "paper":
        papers = [other for other in presets.PRESETS if presets.preset(other).system == "paper"]
        raise InputError(f"--preset {name}", "is not of the system whose rows these are",
                         f"choose among {', '.join(papers)}")
    # `style-reads` is the row whose style interpreter has words, so no other has them.
    return configs.with_settings(config, [
        "schedules.gate.steps=0", "schedules.planner.steps=0", "schedules.reward.steps=0", "schedules.cql.steps=0",
        "schedules.cql_literal.steps=0", "generator.use_control=false",
        "interpreter.use_control=false", "style.text_features=0"])


RACER_SIZES = {
    "paper-quick": ("cql.width=64", "cql.layers=4", "cql.heads=4", "schedules.cql.steps=400", "schedules.cql.batch=32",
                    "cql.warm_up=0", "cql.copy_every=8"),
    "tiny": ("cql.width=16", "cql.layers=4", "cql.heads=2", "schedules.cql.steps=10", "schedules.cql.batch=8")}
"""Shared by RACER's rows on top of the bundle's settings, by the preset's name (others train these
rows at their own sizes). Targets are copied far more often than 1 / (1 - gamma), so that temporal differences are
learned all along; a run takes 45 s to 3 min of one core."""


def is_racer(row: str) -> bool:
    """True for a row of RACER's, which stand on a bundle of their own and are compared with each other."""
    return row.startswith("racer-")
