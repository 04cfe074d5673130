"""What is shipped: the bundle, the example and the stored figures."""

from pathlib import Path

import performances
import pytest

from eval.acceptance.rest import Rested
from eval.table import load_with_provenance, markdown
from gesticulator.bundle.files import CARD, NAMED, read_index
from gesticulator.gesticulator import Gesticulator
from gesticulator.performance import Performance

ROOT = Path(__file__).parent.parent


@pytest.fixture(scope="module")
def example(system: Gesticulator) -> Performance:
    return system(performances.example())


def test_the_bundle_is_small_and_says_what_it_was_trained_on() -> None:
    size = sum(file.stat().st_size for file in NAMED["default"].iterdir())
    assert size < 25e6
    index = read_index(NAMED["default"])
    assert index["config"]["name"] == "default"
    assert "LGPL" in index["provenance"]["licence"] and "SmartBody" in (ROOT / "NOTICE").read_text()
    card = (NAMED["default"] / CARD).read_text()
    assert index["provenance"]["fingerprint"] in card and "## Limits" in card


def test_the_example_is_gestured_in_speech_and_rests_in_its_pause(example: Performance) -> None:
    rested = Rested.of(example.motion, example.speech)
    start, stop = max(rested.pauses, key=lambda pause: pause[1] - pause[0])
    assert stop - start > 3.0, "the example has a pause of several seconds"
    speech = rested.in_speech()
    # Between coming to rest, 2.3 seconds, and getting ready for the next phrase, two thirds of one.
    rest = float(rested.between(start + 2.3, stop - 2 / 3).mean())
    assert speech > 0.15, "m/s"
    assert rest < 0.1, "m/s"
    assert rest < 0.4 * speech


def test_the_stored_figures_are_those_of_the_shipped_weights() -> None:
    tables, about = load_with_provenance(ROOT / "docs/results/quality.json")
    assert markdown(tables, about) == (ROOT / "docs/results/quality.md").read_text(), "what is read is what is kept"
    assert tables[0].facts["store"]["fingerprint"] == read_index(NAMED["default"])["provenance"]["fingerprint"]
