"""What is shipped: the bundle, the example and the stored figures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import performances
import pytest

from eval.clip.measure import measure
from eval.table import load_with_provenance, markdown
from gesticulator.bundle import bundle as bundles
from gesticulator.bundle.files import CARD, read_index
from gesticulator.gesticulator import Gesticulator
from gesticulator.performance import Performance

ROOT = Path(__file__).parent.parent


@pytest.fixture(scope="module")
def example(system: Gesticulator) -> Performance:
    return system(performances.example())


def test_the_bundle_is_small_and_says_what_it_was_trained_on() -> None:
    size = sum(file.stat().st_size for file in bundles.SHIPPED.iterdir())
    assert size < 25e6
    index = read_index(bundles.SHIPPED)
    assert index["config"]["name"] == "default"
    assert "LGPL" in index["provenance"]["licence"] and "SmartBody" in (ROOT / "NOTICE").read_text()
    card = (bundles.SHIPPED / CARD).read_text()
    assert index["provenance"]["fingerprint"] in card and "## Limits" in card


def test_the_example_is_gestured_in_speech_and_rests_in_its_pause(example: Performance) -> None:
    clip = measure(example.motion, example.speech)
    speech = clip.speech_speed
    # The long pause, between coming to rest, two seconds, and getting ready for the next phrase, two thirds of one.
    frames = np.flatnonzero(clip.silent)
    pause = max(np.split(frames, np.flatnonzero(np.diff(frames) > 1) + 1), key=len)
    rest = float(clip.hand_speed[pause[60:-20]].mean())
    assert len(pause) > 120, "the example has a pause of several seconds"
    assert speech > 0.15, "m/s"
    assert rest < 0.1, "m/s"
    assert rest < 0.4 * speech


def test_the_stored_figures_are_those_of_the_shipped_weights() -> None:
    tables, about = load_with_provenance(ROOT / "docs/results/quality.json")
    assert markdown(tables, about) == (ROOT / "docs/results/quality.md").read_text(), "what is read is what is kept"
    assert tables[0].facts["store"]["fingerprint"] == read_index(bundles.SHIPPED)["provenance"]["fingerprint"]
