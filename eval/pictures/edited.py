"""Style editing as a picture (RG Fig. 10), of the figures of `eval.ablate.style_editing`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from data_module.controls import FEATURES, LEVELS

COLOURS = dict(zip(LEVELS, ("tab:blue", "tab:green", "tab:red"), strict=True))


def figure_10(result: Mapping[str, Any]) -> Figure:
    """For each feature the first clip over time beside what was asked, and box plots of all clips.

    result: of `eval.ablate.style_editing.figures`. Whiskers reach the extremes; dashes are what was asked for.
    """
    figure = Figure(figsize=(10, 3 * len(FEATURES)), layout="constrained")
    for index, (feature, axes) in enumerate(zip(FEATURES, figure.subplots(
            len(FEATURES), 2, width_ratios=(2, 1), sharey="row"), strict=True)):
        over_time, boxes = axes
        rows, requested = {level: f"{feature} {level}" for level in LEVELS} | result["beside"], result["asked"][feature]
        drawn = boxes.boxplot([result["values"][row][feature] for row in rows.values()], whis=(0, 100))
        boxes.set_xticks(range(1, len(rows) + 1), list(rows))
        for place, (level, colour) in enumerate(COLOURS.items(), 1):
            series = result["series"][rows[level]]
            curve = series["values"][index]
            over_time.plot(np.arange(len(curve)) / series["fps"], curve, color=colour, label=level)
            over_time.axhline(requested[level], color=colour, linestyle="--", linewidth=0.8)
            boxes.hlines(requested[level], place - 0.4, place + 0.4, color=colour, linestyle="--")
            drawn["boxes"][place - 1].set_color(colour)
        over_time.set_ylabel(result["titles"][feature])
        if index == 0:
            over_time.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=len(LEVELS), frameon=False)
    over_time.set_xlabel(f"seconds of {result['clips'][0]['name']} (mean over 4 s)")
    boxes.set_xlabel(f"means over {len(result['clips'])} clips")
    return figure
