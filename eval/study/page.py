"""A page of a study: a template of `eval/assets`, its data, and the figure that plays on it."""

from __future__ import annotations

import base64
import json
import re
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

FPS = 30
STEPS_PER_METRE = 8192
"""Places travel as int16: an eighth of a millimetre, up to 4 m away."""
_SLOT = re.compile(r"\{\{([a-z_]+)\}\}")


def encoded_points(points: dict[str, NDArray[np.float64]]) -> str:
    """Places [T, 3] of points, metres, as the page reads them: int16 in base64, frame by frame."""
    steps = np.round(np.stack(list(points.values()), axis=1) * STEPS_PER_METRE)
    return base64.b64encode(np.clip(steps, -32768, 32767).astype("<i2").tobytes()).decode()


def page_of(template: str, data: dict[str, Any], media: str = "blob:") -> str:
    """A page of `eval/assets` with its data, the program that draws the figure, and where its media may come from."""
    text_of_data = json.dumps(data, separators=(",", ":"), allow_nan=False).replace("</", "<\\u002f")
    text, figure = ((resources.files("eval") / "assets" / name).read_text(encoding="utf-8")
                    for name in (template, "figure.js"))
    parts = {"data": text_of_data, "study": data["study"], "media": media, "figure": figure}
    return _SLOT.sub(lambda match: parts[match.group(1)], text)
