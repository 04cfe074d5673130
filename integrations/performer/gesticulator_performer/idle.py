"""People who stand and wait (ReActIdle): stretches of their takes, on the character.

The table clips.toml says which seconds of which files are used, and in which split each person is. Cameras tracked
these people 24 times a second, without their hands.
"""

from __future__ import annotations

import functools
import gzip
import re
import tempfile
import zlib
from pathlib import Path

from scipy.ndimage import gaussian_filter1d

from data_module.errors import InputError
from data_module.motion import kinematics, rotation, skeletons
from data_module.motion.bvh import read_bvh
from data_module.store import Split
from data_module.types import Motion
from gesticulator_performer.joints import FPS
from gesticulator_performer.tables import table

_TABLE = table("clips.toml")["idle"]
SPLITS: dict[str, Split] = {f"idle_{number}": split for number, split in _TABLE["splits"].items()}
"""Person -> the split that all the person's takes are in."""
_ADVICE = "take all files of ReActIdle, or remove the folder to do without"
# Standard deviation of the low pass, frames of the source: the tracking trembles, and frames are interpolated.
_SMOOTH = 0.8


def stretches_of(folder: Path) -> list[tuple[str, str, Path, tuple[float, float]]]:
    """Name, person, file and seconds of each stretch that is used; none without the folder."""
    listed = []
    for stem, spans in _TABLE["stretches"].items() if folder.is_dir() else ():
        file = folder / f"{stem}.bvh.gz"
        if not file.is_file():
            raise InputError(file, "does not exist", _ADVICE)
        listed += [(f"idle_{stem}_{k}", f"idle_{stem[:3]}", file, (first, last))
                   for k, (first, last) in enumerate(spans)]
    return listed


def stretch(file: Path, seconds: tuple[float, float]) -> Motion:
    """Part of a file on the character with fingers, at 60 fps."""
    whole = _on_character(file)
    part = kinematics.resample(whole.crop(*(round(second * whole.fps) for second in seconds)), FPS)
    smooth = gaussian_filter1d(rotation.continuous(part.rotations), _SMOOTH * FPS / whole.fps, axis=0, mode="nearest")
    return Motion(skeletons.FINGERED, rotation.normalise(smooth), part.root_positions, FPS, part.absent)


# The stretches of a file come one after the other.
@functools.lru_cache(maxsize=1)
def _on_character(file: Path) -> Motion:
    try:
        text = gzip.decompress(file.read_bytes()).decode()
    except (OSError, EOFError, zlib.error, UnicodeDecodeError):
        raise InputError(file, "is not a gzipped BVH file", _ADVICE) from None
    # The end of a forearm becomes a joint: the character's forearm ends in a hand.
    text = re.sub(r"(JOINT forearm\.([LR]).*?)End Site", r"\1JOINT hand.\2", text, flags=re.DOTALL)
    with tempfile.TemporaryDirectory() as room:
        plain = Path(room) / file.stem
        plain.write_text(text, encoding="utf-8")
        motion = read_bvh(plain, unit=1.0)
    joints = skeletons.find_table(motion.skeleton.names, _TABLE["joints"])
    return skeletons.to_character(motion, joints, skeletons.FINGERED)
