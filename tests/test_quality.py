"""The quality of a bundle's models: which rows the tables have, and that each does what its name says."""

from pathlib import Path

import numpy as np
import pytest

from data_module.store import Store
from eval.baselines.interpreters import Bigram
from eval.commands import QUALITY
from eval.context import EvalContext
from eval.table import load
from gesticulator.bundle import bundle as bundles


def test_successors_are_the_most_frequent_next_lexemes(tiny_store: Path, tiny_bundle: Path) -> None:
    work = tiny_bundle.with_name(tiny_bundle.name + ".work")
    corpus = EvalContext.over(Store.open(tiny_store), bundles.load(tiny_bundle), work, progress=False).corpus
    bigram = Bigram.fitted(corpus, np.arange(len(corpus.silent)) % 3, 3)  # 0 1 2 0 1 2 ... within a recording
    for previous, expected in ((0, 1), (1, 2), (2, 0)):
        assert int(bigram.step(0, None, previous)[0].argmax()) == expected  # type: ignore[arg-type]


def test_the_command_writes_every_table(tiny_store: Path, tiny_bundle: Path, tmp_path: Path,
                                        monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.delenv("GESTICULATOR_DATA", raising=False)
    out = tmp_path / "quality.json"
    assert QUALITY.main("gesticulator quality", [
        "--data", str(tiny_store), "--bundle", str(tiny_bundle), "--out", str(out), "--quiet", "--work",
        str(tiny_bundle.with_name(tiny_bundle.name + ".work"))]) == 0
    lexicon, accuracy = load(out)
    systems = {"lstm", "lstm with text", "statistical", "majority"}
    assert set(accuracy.rows) == {"previous lexeme and speaker", *systems}
    assert set(lexicon.rows) == {"quantised", "unquantised", "variance"} and "Lexemes used" in lexicon.notes[0]
    assert accuracy.rows["majority"]["teacher_forced"] == accuracy.rows["majority"]["free_running"]
    assert "majority" in capsys.readouterr().out
