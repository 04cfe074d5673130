"""The folder of takes of named gestures: `takes.csv` and its clips, which one package draws and another one plays."""

from __future__ import annotations

from collections.abc import Mapping

TAKES = "takes.csv"
COLUMNS = ("file", "label", "size", "hand", "touches", "licence", "start", "stroke", "apex", "hold_end", "end")
"""file: a BVH file in the folder, metres, joints of the character; label: of the gesture ("thumbs_up"); size: of
`SIZES`; hand: "left", "right", "both" or "none"; touches: whether a hand touches the body or the other hand, yes or no;
the rest: seconds in the clip at which preparation and stroke begin, the stroke ends, and hold and retraction end."""
SIZES: Mapping[str, float] = {"small": 0.65, "medium": 1.0, "large": 1.4}
"""The sizes of takes, as factors on the medium one."""
