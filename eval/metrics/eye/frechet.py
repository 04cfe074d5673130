"""Window Frechet distance: everything at once, in a space that no system was trained in.

Theory: each window of 2 s (15 Hz, every 0.4 s) is told in 40 numbers of the places of both wrists, both elbows and the
head as seen from the waist: their means (15), log(sd + 3 mm) (15), log(mean speed + 1 cm/s) (5), log(peak speed
+ 1 cm/s) (5). In units of the reference's deviations, on its first ten principal axes, the figure is the squared
Frechet distance of the two sets taken for Gaussians,

    |m_1 - m_2|^2 + tr(C_1 + C_2 - 2 (C_1 C_2)^(1/2)).

The space is frozen in a file: mean, sd, axes and the moments of two real takes, no motion.

Unit: squared deviations of the reference. Good: low. Anchors: the halves of one real take against both takes together
8 and 13; a peer's system 26 to 28; unit selection over a tenth of a corpus 22; frozen motion 240. A take of one minute
has some 150 windows, far fewer of them independent: a difference of 2 is noise. The windows of all clips
are pooled: single clips are farther off on average.

What fools it: a motion played backwards has the same value (13.0 for one real take both ways), as the order of speeds
in a window is not seen; and so has a mirrored copy (12.7), as the space keeps no tie between the hands. Both belong
beside it in every table, with the figures of `hands`, which see the mirror. It does not hear the speech. Jitter (131),
bobbing (299) and a frozen pose (687) are far. The reference is two people: who gestures as well but otherwise is "far".

    >>> from eval.metrics.fgd import frechet_distance
    >>> standard = Gaussian(np.zeros(2), np.eye(2))
    >>> round(frechet_distance(standard, Gaussian(np.array([3.0, 0.0]), 4.0 * np.eye(2))), 6)
    11.0
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data_module.arrays import as_floats, read_npz
from data_module.errors import InputError
from data_module.types import Array
from eval.metrics.eye.body import CommonBody
from eval.metrics.fgd import Gaussian

POINTS = ("RightHand", "LeftHand", "RightForeArm", "LeftForeArm", "Head")
WIDTH = 40
REFERENCE = "eye_reference.npz"
"""The file's name in GESTICULATOR_DATA."""
_THIN, _WINDOW, _STEP = 4, 30, 6
"""60 Hz to 15 Hz; frames in a window (2 s) and from one to the next (0.4 s)."""
_LEAST_SPREAD, _LEAST_SPEED = 0.003, 0.01
"""Metres and m/s under the logarithms: what is smaller is still."""
FEWEST = 3
"""Windows from which on a set has moments."""


def windows(body: CommonBody) -> Array:
    """[n, 40] descriptors of a motion's windows; n is 0 where it lasts less than 2 s."""
    places = (np.stack([body.points[name] for name in POINTS], axis=1) - body.points["Waist"][:, None])[::_THIN]
    descriptors = []
    for start in range(0, len(places) - _WINDOW, _STEP):
        piece = places[start:start + _WINDOW]
        speed = np.linalg.norm(np.diff(piece, axis=0), axis=-1) * 15.0
        # Logarithms of spreads and speeds, as these are skewed and the distance takes them for Gaussian.
        descriptors.append(np.concatenate([piece.mean(0).ravel(), np.log(piece.std(0).ravel() + _LEAST_SPREAD),
                                    np.log(speed.mean(0) + _LEAST_SPEED), np.log(speed.max(0) + _LEAST_SPEED)]))
    return np.array(descriptors, dtype=np.float64).reshape(-1, WIDTH)


@dataclass(frozen=True)
class ReferenceSpace:
    """The frozen space: mean, sd: [40]; axes: [10, 40]; real: the moments of the real takes in it."""

    mean: Array
    sd: Array
    axes: Array
    real: Gaussian

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> ReferenceSpace:
        """Read a file of statistics (.npz: mean, sd, axes, own_mean, own_root); InputError where it is none."""
        wanted = ("mean", "sd", "axes", "own_mean", "own_root")
        arrays = read_npz(path, wanted, f"give {REFERENCE}")
        numbers = [as_floats(array) for array in arrays.values() if array.dtype.kind in "fiu"]
        if arrays.keys() != set(wanted) or len(numbers) < len(wanted) or not all(np.isfinite(n).all() for n in numbers):
            raise InputError(path, f"lacks finite numbers called {', '.join(wanted)}", f"give {REFERENCE}")
        mean, sd, axes, center, root = (as_floats(arrays[name]) for name in wanted)
        k = len(axes) if axes.ndim else 0
        # Files of statistics come from outside, so every shape is looked at before anything is divided.
        shapes = (mean.shape, sd.shape, axes.shape, center.shape, root.shape)
        if shapes != ((WIDTH,), (WIDTH,), (k, WIDTH), (k,), (k, k)) or (sd <= 0).any():
            raise InputError(path, "holds statistics of another shape", f"give {REFERENCE}")
        return cls(mean, sd, axes, Gaussian(center, root @ root.T))

    @classmethod
    def found(cls) -> ReferenceSpace | None:
        """The one in GESTICULATOR_DATA; None where there is none."""
        place = os.environ.get("GESTICULATOR_DATA")
        file = Path(place).expanduser() / REFERENCE if place else None
        return cls.load(file) if file is not None and file.is_file() else None

    def see(self, descriptors: Array) -> Array:
        """Windows [n, 40] in the space, [n, 10]."""
        return ((descriptors - self.mean) / self.sd) @ self.axes.T
