"""How a motion is laid out as a clip for animation tools: its name, its keys, its loop, its layer."""

from collections.abc import Iterable
from dataclasses import dataclass

from data_module.errors import InputError, shown

NAME = "gesture"
"""Default name of a clip."""
KEYS = 0.1
"""Default bound on the error of reduced keys, degrees: a tenth of the smallest turn of a limb that is noticed."""
MOST_KEYS = 5.0
"""Largest bound, degrees: beyond, gestures lose their shape."""
CLIPS = (".bvh", ".csv", ".fbx", ".glb", ".usda", ".usdc", ".vrma")
"""Suffixes of formats for which loop, mask and layer have a meaning."""
_LONGEST_NAME = 100


@dataclass(frozen=True)
class ClipLayout:
    """The options of a clip.

    name: of the animation in the file. keys: largest error of a rotation in degrees that leaving out keys may cause, 0
    to write every frame. loop: the end passes into the beginning without a seam. upper: the upper body alone; hips and
    legs have no tracks and stay at rest. additive: rotations are written relative to the resting pose, to be added to
    another clip; of the upper body alone.
    """

    name: str = NAME
    keys: float = KEYS
    loop: bool = False
    upper: bool = False
    additive: bool = False

    def __post_init__(self) -> None:
        if not self.name or len(self.name) > _LONGEST_NAME or not self.name.isprintable():
            raise InputError(f"--clip-name {shown(self.name)}", "is not a name",
                             f"give 1 to {_LONGEST_NAME} printable characters")
        if not 0.0 <= self.keys <= MOST_KEYS:
            raise InputError(f"--keys {self.keys:g}", "is out of range",
                             f"give all, or up to {MOST_KEYS:g} degrees (default {KEYS:g})")

    @property
    def bare(self) -> bool:
        """Whether hips and legs have no tracks."""
        return self.upper or self.additive

    @property
    def changes_motion(self) -> bool:
        """Whether more than names and keys is other than in the plain motion."""
        return self.loop or self.bare


def check_clip_outputs(clip: ClipLayout, suffixes: Iterable[str]) -> None:
    """`InputError` for a clip that one of the outputs cannot follow."""
    # A plan (.json) may accompany any clip: it holds no motion.
    other = [suffix for suffix in suffixes if suffix not in (*CLIPS, ".json")]
    if clip.additive and other:
        raise InputError("--layer additive", f"makes no sense in {other[0]}", f"write {', '.join(CLIPS)}")


def parse_keys(text: str) -> float:
    """The value of --keys: degrees, or 0 for "all". `InputError` for anything else."""
    if text == "all":
        return 0.0
    try:
        degrees = float(text)
    except ValueError:
        degrees = -1.0
    if not 0.0 < degrees <= MOST_KEYS:
        raise InputError(f"--keys {shown(text)}", "is neither all nor a number of degrees",
                         f"give all, or up to {MOST_KEYS:g} degrees (default {KEYS:g})")
    return degrees
