"""The figures for the eye of several clips together: means with intervals, and the distance of all windows at once."""

import math
from dataclasses import dataclass, field

import numpy as np

from data_module.types import Array, Motion
from eval import stats
from eval.metrics import EYE_METRICS, eye
from eval.metrics.eye import ReferenceSpace, VoiceActivity, arms, frechet
from eval.metrics.fgd import frechet_distance, gaussian
from eval.stats import Interval

POOLED, FIRST_SPREAD, ALIKE = "eye_frechet_pooled", "first_spread", "alike"
CORPUS = "corpus"


@dataclass
class EyeSample:
    """The measured clips of one system. values: figure -> one of each clip; windows: of each clip, [n, 40]; groups: of
    each clip, those of one group are alike; first: [2, 3] of each clip, where its hands begin; leans: of each clip,
    [T, 2]."""

    values: dict[str, list[float]] = field(default_factory=lambda: {name: [] for name in (*EYE_METRICS, POOLED)})
    windows: list[Array] = field(default_factory=list)
    groups: list[str] = field(default_factory=list)
    first: list[Array] = field(default_factory=list)
    leans: list[Array] = field(default_factory=list)

    def add(self, motion: Motion, voice: VoiceActivity | None = None, edges: Array | None = None, *,
            group: str = "") -> None:
        """Measure a clip. voice: of its own speech; edges: of its own blocks."""
        body = eye.common_body(motion)
        figures = eye.of_body(body, voice, edges)
        for name, values in self.values.items():
            values.append(figures.get(name, math.nan))
        self.windows.append(frechet.windows(body))
        self.first.append(body.hands[0])
        self.leans.append(arms.leans(body))
        self.groups.append(group or str(len(self.groups)))

    def figures(self, space: ReferenceSpace | None = None) -> dict[str, Interval]:
        """Every row: the mean of the clips with its interval (groups are drawn together), and the distance of all
        windows together."""
        # Renderings of one recording alone are the unit; of several recordings, the recordings are.
        groups = self.groups if len(set(self.groups)) > 1 else None
        out = {name: stats.mean_interval(values, groups=groups) if len(values) > 1 else Interval.exact(values[0], 1)
               for name, values in self.values.items()}
        out[FIRST_SPREAD] = Interval.exact(arms.first_spread(self.first), len(self.first))
        out[ALIKE] = Interval.exact(arms.alike(self.leans), len(self.leans))
        if space is not None:
            out[POOLED] = self.pooled(space)
        return out

    def pooled(self, space: ReferenceSpace) -> Interval:
        """Frechet distance of all windows together from real people's, with the basic bootstrap's interval over
        clips."""
        # Projected once: the bootstrap draws the same windows two hundred times.
        projected = [space.see(windows) for windows in self.windows]

        def distance(chosen: Array) -> float:
            seen = np.concatenate([projected[k] for k in chosen])
            return math.nan if len(seen) < frechet.FEWEST else frechet_distance(gaussian(seen), space.real)

        return stats.of_set(distance, len(projected), least=0.0)
