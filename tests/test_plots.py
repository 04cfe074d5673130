"""The papers' figures: what is drawn are the numbers that were given."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from data_module.motion.motion_beats import beats_of_speed
from data_module.speech.onsets import merged
from data_module.types import BeatFlag, Beats, Speech, Word
from eval.metrics import pmb
from eval.pictures import embedding, plots
from eval.pictures.embedding import colours
from eval.pictures.strips import BEAT_COLOURS, BEAT_NAMES, save_strip

pytest.importorskip("matplotlib", reason="matplotlib is not installed")
from matplotlib.colors import to_hex

DELTAS = (0.05, 0.1, 0.2)


def lines_of(axis: Any) -> dict[str, Any]:
    return {line.get_label(): line for line in axis.get_lines()}


def collections_of(axis: Any, label: str) -> list[Any]:
    return [own for own in axis.collections if own.get_label() == label]


def places_of(axis: Any, label: str) -> np.ndarray:
    """The x of the vertical lines of a collection."""
    return np.array([segment[0, 0] for own in collections_of(axis, label) for segment in own.get_segments()])


def legend_of(figure: Any) -> list[str]:
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


# --------------------------------------------------------------------------------------------------------- Fig. 11

def test_delta_curves_are_the_curves_given() -> None:
    curves = {"ours": [20.0, 60.0, 90.0], "no-style": [10.0, math.nan, 80.0], "performer": [30.0, 70.0, 95.0]}
    figure = plots.delta_curves(curves, DELTAS, dashed=["performer"])
    drawn = lines_of(figure.axes[0])
    for name, values in curves.items():
        np.testing.assert_array_equal(drawn[name].get_ydata(), values)
        np.testing.assert_array_equal(drawn[name].get_xdata(), DELTAS)
        assert drawn[name].is_dashed() == (name == "performer")
    assert {*curves} <= {*legend_of(figure)} and not any(name.startswith("_") for name in legend_of(figure))


# ---------------------------------------------------------------------------------------------------- Figs. 15, 17

def test_joint_embedding_takes_rows_evenly_and_keeps_neighbours() -> None:
    rng = np.random.default_rng(0)
    # Two heaps, one of which both rows have: their points must lie together in one plane.
    near, far = rng.standard_normal((61, 6)), rng.standard_normal((40, 6)) + 40.0
    found = embedding.joint_embedding({"a": near, "b": np.concatenate([rng.standard_normal((40, 6)), far])}, most=40)
    (first, taken), (second, others) = found["a"], found["b"]
    np.testing.assert_array_equal(taken, np.arange(40) * 61 // 40)
    np.testing.assert_array_equal(others, np.arange(40) * 2)
    assert len(set(taken.tolist())) == 40 and first.shape == second.shape == (40, 2)
    middle = [np.median(part, axis=0) for part in (first, second[others < 40], second[others >= 40])]
    assert np.linalg.norm(middle[0] - middle[1]) < 0.25 * np.linalg.norm(middle[0] - middle[2])
    all_of = embedding.joint_embedding({"a": near[:12]}, most=100)["a"]
    np.testing.assert_array_equal(all_of[1], np.arange(12))
    again = embedding.joint_embedding({"a": near[:12]}, most=100)["a"]
    np.testing.assert_array_equal(all_of[0], again[0])


def test_panels_hold_every_point_in_its_lexemes_colour() -> None:
    rng = np.random.default_rng(1)
    panels = {"performer": (rng.standard_normal((50, 2)), rng.integers(0, 5, 50)),
              "ours": (3 * rng.standard_normal((30, 2)), rng.integers(2, 6, 30))}
    figure = embedding.embedding_panels(panels, 6, silent=[3])
    assert len(figure.axes) == 2
    for axis, (name, (points, labels)) in zip(figure.axes, panels.items(), strict=True):
        assert axis.get_title().startswith(f"{name}\n{len(points)} blocks, {len(np.unique(labels))} lexemes")
        for lexeme in range(6):
            mine = collections_of(axis, str(lexeme))
            assert len(mine) == (lexeme in labels)
            for own in mine:
                np.testing.assert_array_equal(own.get_offsets(), points[labels == lexeme])
                assert to_hex(own.get_facecolor()[0] if lexeme != 3 else own.get_edgecolor()[0]) == colours(6)[lexeme]
    first, second = figure.axes
    assert first.get_xlim() == second.get_xlim() and first.get_ylim() == second.get_ylim()
    low, high = np.array([first.get_xlim(), first.get_ylim()]).T
    everything = np.concatenate([points for points, _ in panels.values()])
    assert (everything > low).all() and (everything < high).all()


# --------------------------------------------------------------------------------------------------------- Fig. 16

def test_strips_join_the_pairs_that_the_metric_counts() -> None:
    rng = np.random.default_rng(3)
    onsets = np.sort(rng.uniform(0, 20, 60))
    beats = np.sort(rng.uniform(0, 20, 40))
    edges = np.arange(0, 20, 0.4)
    start, seconds, delta = 5.0, 8.0, 0.1
    axis = plots.beat_strips({"0.2-0.5": (beats, onsets, edges)}, start, seconds, delta).axes[0]
    heard = merged(onsets, pmb.MERGE)
    pairs = pmb.matched(beats, heard, delta)
    seen = (beats >= start) & (beats <= start + seconds)
    told = {(round(top[0], 9), round(foot[0], 9)) for own in collections_of(axis, "_pairs")
            for top, foot in own.get_segments()}
    assert told == {(round(heard[k], 9), round(b, 9)) for b, k in zip(beats[seen], pairs[seen], strict=True) if k >= 0}
    assert told and (seen & (pairs < 0)).any()
    full, hollow = (collections_of(axis, f"motion beat, {how}")[0] for how in ("matched", "not matched"))
    np.testing.assert_array_equal(full.get_offsets()[:, 0], beats[seen & (pairs >= 0)])
    np.testing.assert_array_equal(hollow.get_offsets()[:, 0], beats[seen & (pairs < 0)])
    assert to_hex(hollow.get_facecolor()[0]) == "#ffffff" != to_hex(full.get_facecolor()[0])
    np.testing.assert_array_equal(places_of(axis, "onset"), heard)
    np.testing.assert_array_equal(places_of(axis, "block edge"), edges)
    assert axis.get_xlim() == (5, 13)
    count = int((pairs[seen] >= 0).sum())
    assert axis.texts[0].get_text() == f"PMB {100 * count / seen.sum():.0f} %\n{count} of {seen.sum()}"


# --------------------------------------------------------------------------------------------------------- Fig. 10

def test_editing_panels_show_what_was_asked_beside_what_was_measured() -> None:
    rng = np.random.default_rng(2)
    panels = {title: {level: (asked, asked + 0.1 * rng.standard_normal(81))
                      for level, asked in {"low": 0.1, "mid": 0.3, "high": 0.6}.items()}
              for title in ("height, m", "speed, m/s")}
    figure = plots.editing_panels(panels, fps=20)
    rows = zip(figure.axes[::2], figure.axes[1::2], panels.items(), strict=True)
    for curves, boxes, (title, levels) in rows:
        assert curves.get_ylabel() == title and curves.get_ylim() == boxes.get_ylim()
        drawn = lines_of(curves)
        for level, (_, values) in levels.items():
            np.testing.assert_allclose(drawn[level].get_xdata(), np.arange(81) / 20)
            np.testing.assert_array_equal(drawn[level].get_ydata(), values)
        for axis in (curves, boxes):
            flat = {line.get_ydata()[0] for line in axis.lines
                    if len(line.get_ydata()) == 2 and list(line.get_xdata()) == [0, 1]}
            assert flat == {0.1, 0.3, 0.6}, "what was asked for crosses both panels"
        medians = [line.get_ydata()[0] for line in boxes.lines if len(set(line.get_ydata())) == 1]
        assert {float(np.median(values)) for _, values in levels.values()} <= set(medians)


# --------------------------------------------------------------------------------------------------------- Fig. 18

def test_sweep_shows_means_intervals_and_sizes() -> None:
    nan = math.nan
    figures = {"FGD": [(9.0, 8.0, 10.0), (7.0, 6.5, 9.0), (nan, nan, nan)],
               "PMB": [(80.0, 79.0, 82.0), (81.0, 80.0, 82.0), (82.0, 80.0, 84.0)]}
    figure = plots.size_sweep((10, 100, 400), figures, {"PMB": 95.0}, chosen=100)
    for axis, (title, own) in zip(figure.axes, figures.items(), strict=True):
        drawn = lines_of(axis)
        (bars,) = axis.containers
        np.testing.assert_array_equal(bars[0].get_xdata(), [10, 100, 400])
        np.testing.assert_array_equal(bars[0].get_ydata(), [value[0] for value in own])
        spans = [segment[:, 1] for segment in bars[2][0].get_segments() if segment.ndim == 2]
        np.testing.assert_allclose(spans, [value[1:] for value in own if math.isfinite(value[0])])
        assert axis.get_title() == title and axis.get_xscale() == "log"
        assert [label.get_text() for label in axis.get_xticklabels()] == ["10", "100", "400"]
        assert set(drawn["size in use"].get_xdata()) == {100}
        assert ("performer" in drawn) == (title == "PMB")
    assert set(lines_of(figure.axes[1])["performer"].get_ydata()) == {95.0}


# ---------------------------------------------------------------------------------------------------------- Fig. 2

def performance(seconds: float = 8.0, rate: int = 16000) -> dict[str, Any]:
    rng = np.random.default_rng(6)
    samples = (0.4 * np.sin(np.arange(round(seconds * rate)) * 0.06) * rng.uniform(0, 1, round(seconds * rate)))
    times = np.array([0.0, 0.5, 1.1, 1.9, 2.4, 3.3, 4.0, 5.2, 6.0, 7.0, seconds])
    flags = np.array([0, 1, 1, 2, 3, 1, 1, 3, 2, 1, 0], np.int8)
    speed = 1 + np.sin(np.arange(round(seconds * 60)) / 60 * 7) ** 3
    return {"speech": Speech(samples.astype(np.float32), rate), "beats": Beats(times, flags), "edges": times,
            "lexemes": np.array([1, 4, 4, 2, 0, 3, 1, 2, 2, 0]), "hand_speed": speed, "fps": 60.0,
            "motion_beats": beats_of_speed(speed, 60.0)}


def test_overview_shows_its_stretch() -> None:
    own = performance()
    words = (Word("before", 0.1, 0.4), Word("well", 1.2, 1.6), Word("", 1.6, 2.0), Word("yes", 4.0, 4.4))
    figure = plots.overview(plots.Overview(**own, words=words, silent=[2]), 1.0, 4.0)
    spoken, sound, cells, hands = figure.axes
    assert [text.get_text() for text in spoken.texts] == ["well", "yes"]
    assert [text.get_position()[0] for text in spoken.texts] == pytest.approx([1.4, 4.2])
    times, flags = own["beats"].times, own["beats"].flags
    drawn = {line.get_label(): line for line in sound.get_lines()}
    for flag in BeatFlag:
        mine = times[(flags == flag) & (times >= 1) & (times <= 5)]
        name = f"beat: {BEAT_NAMES[flag]}"
        assert (name in drawn) == bool(len(mine))
        if len(mine):
            np.testing.assert_array_equal(drawn[name].get_xdata(), mine)
            assert drawn[name].get_color() == BEAT_COLOURS[flag]
    shown = [(float(patch.get_x()), float(patch.get_width()), patch.get_hatch()) for patch in cells.patches]
    blocks = [i for i in range(10) if times[i] < 5 and times[i + 1] > 1]
    assert shown == [(times[i], pytest.approx(times[i + 1] - times[i]), "////" if own["lexemes"][i] == 2 else None)
                     for i in blocks]
    assert [text.get_text() for text in cells.texts] == [str(own["lexemes"][i]) for i in blocks]
    np.testing.assert_array_equal(lines_of(hands)["_speed"].get_ydata(), own["hand_speed"])
    found = own["motion_beats"]
    expected = found[(found >= 1) & (found <= 5)]
    assert len(expected) > 2
    np.testing.assert_array_equal(lines_of(hands)["motion beat"].get_xdata(), expected)
    assert hands.get_xlim() == (1.0, 5.0)


# ---------------------------------------------------------------------------------------------------------- saving

def test_the_same_input_gives_the_same_bytes(tmp_path: Path) -> None:
    def saved(name: str) -> bytes:
        save_strip(plots.overview(plots.Overview(**performance(), silent=[2]), 0.0, 8.0), tmp_path / name)
        return (tmp_path / name).read_bytes()

    for suffix in ("svg", "png"):
        first = saved(f"first.{suffix}")
        assert first == saved(f"second.{suffix}") and len(first) > 1000
        assert b"matplotlib.org" not in first and b"<dc:date>" not in first
    assert saved("a.pdf").startswith(b"%PDF")
