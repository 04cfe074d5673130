"""The pictures of docs/knobs.md, drawn from the example recording and the shipped weights.

    python docs/pictures/make_knobs.py [FOLDER]

FOLDER is docs/pictures unless another is given. `knobs.png` shows docs/results/earlier/knobs.json. Needs the
extra `figures` (matplotlib).
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from data_module.speech.audio import load_speech
from eval.metrics.eye import RANGES
from eval.pictures.strips import PAGE, Source, draw_page, save_strip
from eval.stats import Interval
from eval.table import load
from gesticulator import Gesticulator

HERE = Path(__file__).resolve().parent
SOUND = HERE.parent.parent / "examples" / "speech.flac"
SECONDS = 10.0
"""Of the example."""
KNOBS = ("intensity", "activity")
FIGURES = {"eye_speed_50": "hand speed, median, m/s", "eye_speed_95": "hand speed, 95 %, m/s",
           "eye_stroke_amplitude": "stroke amplitude, cm", "moving": "a hand moves, % of time"}


def main(folder: str = str(HERE)) -> None:
    """Draw them all."""
    system, speech = Gesticulator.from_pretrained(), load_speech(SOUND)
    speech = replace(speech, samples=speech.samples[:round(SECONDS * speech.sample_rate)])
    layout = replace(PAGE, line=9, spacing=1.25)
    sizes = [Source(f"intensity {size:g}", system(speech, fps=30, intensity=size).motion) for size in (0.5, 1.0, 1.5)]
    save_strip(draw_page(sizes, np.arange(2.0, 6.1, 0.5), layout=layout), Path(folder) / "intensity.png",
               60)
    save_strip(curves(), Path(folder) / "knobs.png", 80)


def curves() -> Figure:
    """What intensity and activity do to four figures, with the range of real people where there is one."""
    table = load(HERE.parent / "results" / "earlier" / "knobs.json")[0]
    figure = Figure(figsize=(12.0, 5.2), facecolor="white", layout="constrained")
    for row, knob in enumerate(KNOBS):
        for column, (name, title) in enumerate(FIGURES.items()):
            axis = figure.add_subplot(len(KNOBS), len(FIGURES), row * len(FIGURES) + column + 1)
            points = [(float(key.split()[1]), cells[name]) for key, cells in table.rows.items()
                      if key.startswith(knob + " ")]
            points.append((1.0, table.rows["neutral"][name]))
            points = sorted((point for point in points if isinstance(point[1], Interval)), key=lambda point: point[0])
            x, y = [point[0] for point in points], [point[1].mean for point in points]
            axis.fill_between(x, [point[1].low for point in points], [point[1].high for point in points], alpha=0.3,
                              color="#33767a")
            axis.plot(x, y, "o-", color="#33767a", markersize=3)
            if name in RANGES:
                axis.axhspan(*RANGES[name], color="#e8e2d4", zorder=-1)
                axis.set_ylim(0.0, max(*y, min(RANGES[name][1], 2.5 * max(y))) * 1.1)
            axis.set_xlabel(knob, fontsize=8)
            axis.set_title(title, fontsize=8)
            axis.tick_params(labelsize=7)
    return figure


if __name__ == "__main__":
    main(*sys.argv[1:])
