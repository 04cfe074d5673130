"""Interpreters: from speech to lexemes and style codes. One protocol, several systems.

A new interpreter is one file and one entry here.
"""

from __future__ import annotations

from interpreters.base import BlockFeatures, LexemeInterpreter, select
from interpreters.cql import QNetwork
from interpreters.lstm import LstmInterpreter
from interpreters.statistical import StatisticalInterpreter

INTERPRETERS: dict[str, type] = {"lstm": LstmInterpreter, "cql": QNetwork, "statistical": StatisticalInterpreter}

__all__ = ["INTERPRETERS", "BlockFeatures", "LexemeInterpreter", "LstmInterpreter", "QNetwork",
           "StatisticalInterpreter", "select"]
