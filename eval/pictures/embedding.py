"""Latents of blocks in the plane, coloured by lexeme (RG Figs. 6, 8b, 15, 17). The plane is
that of t-SNE (van der Maaten and Hinton 2008).

What fools it: t-SNE tears and clumps. It keeps who is near whom, not distances or densities, so the share of nearest
neighbours with the same lexeme is told, in the picture and among the latents themselves (`neighbours_agree`). Colours
of one hue may be two lexemes, so the commonest have their numbers.
"""

from __future__ import annotations

import colorsys
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from data_module.types import Array
from eval.metrics.diversity import Labels
from eval.pictures.canvas import COLUMNS, WIDE, canvas
from gesticulator.export.figure import SOFT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PERPLEXITY, NEIGHBOURS = 30.0, 10
NUMBERED = 12
"""Lexemes that have a number in a panel: the commonest ones; more would cover the points."""


def embed(latents: Array, seed: int = 0) -> Array:
    """[n, 2] t-SNE of latents [n, D]."""
    from sklearn.manifold import TSNE

    # scikit-learn asks for fewer neighbours than points; the perplexity is a third of them.
    perplexity = min(PERPLEXITY, (len(latents) - 1) / 3)
    points = TSNE(perplexity=perplexity, init="pca", random_state=seed).fit_transform(latents)
    return np.asarray(points, dtype=np.float64)


def neighbours_agree(points: Array, labels: Labels) -> float:
    """Share of each point's nearest neighbours that have its label."""
    from sklearn.neighbors import NearestNeighbors

    near = NearestNeighbors(n_neighbors=min(NEIGHBOURS, len(points) - 1)).fit(points).kneighbors(return_distance=False)
    return float((labels[near] == labels[:, None]).mean())


def colours(size: int) -> list[str]:
    """`size` colours, neighbours in number far apart in hue."""
    shades = [colorsys.hls_to_rgb(i * 0.61803398875 % 1, (0.42, 0.56, 0.34)[i % 3], (0.65, 0.8, 0.5)[i % 3])
            for i in range(size)]
    return ["#" + "".join(f"{round(255 * part):02x}" for part in shade) for shade in shades]


def joint_embedding(latents: Mapping[str, Array], most: int) -> dict[str, tuple[Array, Labels]]:
    """The latents of several rows in one t-SNE: row -> its points [n, 2] and which of its latents they are [n].

    latents: row -> [N, D], the same D in all. At most `most` of each are taken, evenly spaced in their order, and
    embedded together, so that what lies near each other in two panels lies near each other.
    """
    # Multiples of n / m, rounded down, are all different where m <= n.
    taken = {name: np.arange(count := min(most, len(values)), dtype=np.int64) * len(values) // max(1, count)
             for name, values in latents.items()}
    # One t-SNE of all rows: two of them would lie in planes that do not compare.
    together = np.concatenate([values[taken[name]] for name, values in latents.items()])
    ends = np.cumsum([len(which) for which in taken.values()])
    points = np.split(embed(together), ends[:-1])
    return {name: (mine, which) for (name, which), mine in zip(taken.items(), points, strict=True)}


def embedding_panels(panels: Mapping[str, tuple[Array, Labels]], size: int, silent: Sequence[int] = ()) -> Figure:
    """One panel of points for each row, all on the same axes, coloured by lexeme.

    panels: row -> points [n, 2], such as of `joint_embedding`, and their lexemes [n], below `size`; silent: lexemes
    drawn as crosses.
    """
    everything = np.concatenate([points for points, _ in panels.values()])
    # The same axes in all panels, or a row that fills less of the plane would look as rich.
    low, high = everything.min(axis=0), everything.max(axis=0)
    margin = 0.04 * float((high - low).max()) or 1.0
    across = 2 if len(panels) == 4 else min(COLUMNS, len(panels))
    down = math.ceil(len(panels) / across)
    wide, tall = (high - low + 2 * margin).tolist()
    figure = canvas(down * (WIDE / across * min(max(tall / wide, 0.5), 1.5) + 0.5))
    axes = figure.subplots(down, across, squeeze=False).ravel()
    for axis, (name, (points, labels)) in zip(axes, panels.items(), strict=False):
        _draw_points(axis, points, labels, colours(size), silent)
        axis.set_title(f"{name}\n{len(points)} blocks, {len(np.unique(labels))} lexemes")
        axis.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin), aspect="equal",
                 xticks=[], yticks=[])
    for axis in axes[len(panels):]:
        axis.axis("off")
    return figure


def _draw_points(axis: Axes, points: Array, labels: Labels, palette: Sequence[str], silent: Sequence[int]) -> None:
    numbered = np.argsort(-np.bincount(labels), kind="stable")[:NUMBERED]
    for lexeme in np.unique(labels).tolist():
        mine = points[labels == lexeme]
        still = lexeme in silent
        axis.scatter(mine[:, 0], mine[:, 1], s=14 if still else 9, marker="x" if still else "o", color=palette[lexeme],
                     alpha=0.8, linewidths=0.8 if still else 0, rasterized=True, label=str(lexeme))
        if lexeme in numbered:
            # The point nearest to the median of its own: a mean may lie where none is.
            x, y = mine[np.linalg.norm(mine - np.median(mine, axis=0), axis=1).argmin()].tolist()
            axis.text(x, y, str(lexeme), ha="center", va="center",
                      bbox={"boxstyle": "round,pad=0.12", "fc": "white", "ec": SOFT, "alpha": 0.85})
