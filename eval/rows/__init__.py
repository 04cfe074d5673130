"""Every row of the ablations and every table of the papers, of both papers, by name."""

from __future__ import annotations

from eval.rows import racer, rg
from eval.rows.rg import CONTROLS, FLOOR, OURS, PERFORMER, REAL_TAKE, REFERENCES, STILL, SYSTEMS
from eval.rows.row import PaperTable, Row

__all__ = ["CONTROLS", "FLOOR", "OURS", "PERFORMER", "REAL_TAKE", "REFERENCES", "ROWS", "STILL", "SYSTEMS", "TABLES"]

ROWS: dict[str, Row] = {**rg.ROWS, **racer.ROWS}
TABLES: dict[str, PaperTable] = {**rg.TABLES, **racer.TABLES}
