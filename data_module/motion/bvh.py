"""Reader and writer of BVH, the animation format that every tool opens.

In the file angles are degrees and lengths are in the unit of the file (by default we write centimetres). In memory
everything is radians and metres.
"""

import contextlib
import os
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from data_module.errors import InputError, shown
from data_module.files import new_file, read_text
from data_module.motion import rotation, skeletons
from data_module.types import Array, Motion, Skeleton

__all__ = ["BvhWarning", "read_bvh", "write_bvh"]

_AXES = {"Xrotation": "X", "Yrotation": "Y", "Zrotation": "Z"}
_PLACES = {"Xposition": 0, "Yposition": 1, "Zposition": 2}
_WRITTEN_ORDER = "ZXY"
# Orders of the joints of an arm, which lies along X at rest. The middle angle of an order must stay away from 90
# degrees: around there, a small detour lets the other two angles turn by 360 degrees. A palm turns about X by more than
# that, so X is the last axis of hand and forearm. In takes of nine speakers with random poses laid over 540 stretches,
# the hands' angles ended 360 degrees off three times; with `_WRITTEN_ORDER` it was twenty times.
_ORDERS_OF_ARMS = {"Arm": "YXZ", "ForeArm": "YZX", "Hand": "YZX"}
CENTIMETRES = 0.01
"""Metres."""
# Largest plausible number of degrees or units of length, of at least a millimetre.
_LARGEST = 1e9
# Bytes (1 GiB): an hour of a body with fingers at 120 frames a second.
_LARGEST_FILE = 1 << 30
# Frames that are written at once.
_SLICE = 1024
FRAME_RATE_ADVICE = "give the frame rate"
"""Advice for a file of doubtful frame rate, which commands replace by their option."""


class BvhWarning(UserWarning):
    """A file contradicts itself, and was read with the values of the caller."""


@dataclass(frozen=True)
class _Header:
    skeleton: Skeleton
    channels: tuple[tuple[str, ...], ...]
    frames: int
    fps: float


class _Tokens:
    """The words of the header, with a clear error for missing and wrong ones."""

    def __init__(self, text: str, path: str) -> None:
        self._words, self._at, self.path = text.split(), 0, path

    def peek(self) -> str:
        return self._words[self._at] if self._at < len(self._words) else ""

    def take(self, expected: str | None = None) -> str:
        word = self.peek()
        if not word or (expected is not None and word.lower() != expected.lower()):
            wanted = f"'{expected}'" if expected else "more"
            raise InputError(self.path, f"is not a BVH file ({wanted} expected, found '{shown(word) or 'the end'}')",
                             "export it again")
        self._at += 1
        return word

    def number(self) -> float:
        word = self.take()
        with contextlib.suppress(ValueError):
            if abs(value := float(word)) <= _LARGEST:
                return value
        raise InputError(self.path, f"has '{shown(word)}' where a finite number belongs", "export it again")

    def offset(self) -> list[float]:
        self.take("OFFSET")
        return [self.number() for _ in range(3)]


def _parse_header(text: str, path: str) -> _Header:
    tokens = _Tokens(text, path)
    tokens.take("HIERARCHY")
    names: list[str] = []
    parents: list[int] = []
    offsets: list[list[float]] = []
    channels: list[tuple[str, ...]] = []
    tips: dict[int, Array] = {}
    stack: list[int] = []
    while stack or not names:
        word = tokens.take().upper()
        if word == ("JOINT" if names else "ROOT"):
            names.append(tokens.take())
            while tokens.peek() not in ("{", ""):  # bones of other programs have names of several words
                names[-1] += f" {tokens.take()}"
            parents.append(stack[-1] if stack else -1)
            stack.append(len(names) - 1)
            tokens.take("{")
            offsets.append(tokens.offset())
            channels.append(())
            if tokens.peek().upper() == "CHANNELS":
                tokens.take()
                channels[-1] = tuple(tokens.take() for _ in range(int(tokens.number())))
            unknown = [channel for channel in channels[-1] if channel not in _AXES and channel not in _PLACES]
            if unknown:
                raise InputError(path, f"has unknown channels {shown(', '.join(unknown), 100)}", "export it again")
        elif word == "END" and stack:
            tokens.take("Site")
            tokens.take("{")
            tips[stack[-1]] = np.array(tokens.offset())
            tokens.take("}")
        elif word == "}" and stack:
            stack.pop()
        else:
            raise InputError(path, f"is not a BVH file ('{shown(word)}' in its hierarchy)", "export it again")
    tokens.take("MOTION")
    tokens.take("Frames:")
    frames = int(tokens.number())
    tokens.take("Frame")
    tokens.take("Time:")
    frame_time = tokens.number()
    if frame_time < 1e-6:
        raise InputError(path, "has a frame time that is not positive", "export it again or give the frame rate")
    try:
        skeleton = Skeleton(tuple(names), tuple(parents), np.array(offsets), tips)
    except ValueError as error:
        raise InputError(path, f"has a broken skeleton ({error})", "export it again") from None
    return _Header(skeleton, tuple(channels), frames, _frame_rate(frame_time))


def _frame_rate(frame_time: float) -> float:
    """Frames per second; a frame time written with few digits (0.033333) means the whole rate next to it (30). The
    margin is less than what parts 30 from 29.97; without it an hour of motion would drift by frames."""
    fps = 1.0 / frame_time
    whole = round(fps)
    return float(whole) if abs(fps - whole) < 3e-4 * fps else fps


def _rows(body: str, width: int, path: str) -> Array:
    try:
        # Line by line: io.StringIO holds four bytes for each character, a gigabyte for an hour.
        lines = (line[0] for line in re.finditer(r"[^\n]+", body))
        values = (np.loadtxt(lines, dtype=np.float64, ndmin=2, comments=None) if body and not body.isspace()
                  else np.zeros((0, width)))
    except ValueError:
        raise InputError(path, "has a motion row that is not all numbers or not as long as the others",
                         "export it again") from None
    if values.shape[1] != width or len(values) == 0:
        raise InputError(path, f"has {len(values)} motion rows of {values.shape[1]} values where its skeleton needs "
                         f"{width}", "export it again")
    if not (values.max() <= _LARGEST and values.min() >= -_LARGEST):
        raise InputError(path, "has motion values that are not numbers, or far too large", "export it again")
    return values


def read_bvh(path: str | os.PathLike[str], *, fps: float | None = None, unit: float | None = None) -> Motion:
    """Read a BVH file: any channel order, any joint names.

    fps: the frame rate, if that of the header is wrong. A frame count in the header other than the number of rows is an
    InputError without it, and a `BvhWarning` with it. unit: metres per unit of the file; by default guessed from the
    distance of hips and head (else centimetres). Positions of joints other than the root are read as constant offsets
    (their mean), as in most rigs; where the root only carries the hips, their way is added to that of the root.
    """
    where = str(path)
    for name, value in (("frame rate", fps), ("unit", unit)):
        if value is not None and not (np.isfinite(value) and value > 0):
            raise InputError(where, f"cannot be read with a {name} of {value}", "give a positive number")
    header, frames = _opened(path, where)
    rows = _rows(frames, sum(map(len, header.channels)), where)
    if len(rows) != header.frames:
        conflict = (f"its header says {header.frames} frames at {header.fps:g} fps but {len(rows)} rows follow "
                f"({len(rows) * header.fps / max(header.frames, 1):.4g} fps would keep the header's duration)")
        if fps is None:
            raise InputError(where, conflict, FRAME_RATE_ADVICE)
        warnings.warn(f"{where}: {conflict}; read at {fps:g} fps", BvhWarning, stacklevel=2)
    motion = _assemble(header, rows, header.fps if fps is None else float(fps))
    if unit is None:
        try:
            unit = skeletons.guess_unit(header.skeleton, skeletons.find_table(header.skeleton.names))
        except InputError:
            unit = CENTIMETRES
    return skeletons.scaled(motion, unit)


def read_hierarchy(path: str | os.PathLike[str]) -> tuple[Motion, tuple[tuple[str, ...], ...]]:
    """The skeleton of a BVH file in its units and axes, and the channels of each joint. The motion is the first frame,
    or one of zeros without any. Nothing is scaled; the root has its offset, and other joints have the positions of
    their offsets."""
    where = str(path)
    header, frames = _opened(path, where)
    width = sum(map(len, header.channels))
    first = next((line for line in frames.splitlines() if line.strip()), "")
    rows = _rows(first, width, where) if first else np.zeros((1, width))
    motion = _assemble(header, rows, header.fps)
    return replace(motion, skeleton=header.skeleton), header.channels


def _opened(path: str | os.PathLike[str], where: str) -> tuple[_Header, str]:
    text = read_text(path, "give a .bvh file", _LARGEST_FILE)
    at = text.find("Frame Time:")
    if at < 0:
        raise InputError(where, "is not a BVH file (no 'Frame Time:')", "give a .bvh file")
    end = text.find("\n", at)
    header = _parse_header(text[:end if end >= 0 else len(text)], where)
    return header, text[end:] if end >= 0 else ""


def _assemble(header: _Header, rows: Array, fps: float) -> Motion:
    skeleton = header.skeleton
    rotations = np.zeros((len(rows), len(skeleton), 4))
    rotations[..., 0] = 1.0
    offsets = skeleton.offsets.copy()
    root = np.tile(offsets[0], (len(rows), 1))
    carried = np.zeros_like(root)
    column = 0
    for joint, joint_channels in enumerate(header.channels):
        order, angles = "", []
        for channel in joint_channels:
            values = rows[:, column]
            column += 1
            if channel in _AXES:
                order += _AXES[channel]
                angles.append(np.radians(values))
            elif joint == 0:
                root[:, _PLACES[channel]] = values
            else:
                offsets[joint, _PLACES[channel]] = values.mean()
                # Below a root that only carries them, the hips (of spine and legs) may make the way through the room.
                if joint == 1 and skeleton.parents.count(0) == 1 and skeleton.parents.count(1) > 2:
                    carried[:, _PLACES[channel]] = values - offsets[joint, _PLACES[channel]]
        if order:
            rotations[:, joint] = rotation.continuous(rotation.from_euler(np.stack(angles, axis=-1), order))
    if carried.any():
        root += rotation.rotate(rotations[:, 0], carried)
    # The root's positions contain its offset, or replace it.
    offsets[0] = 0.0
    fixed = Skeleton(skeleton.names, skeleton.parents, offsets, skeleton.end_sites)
    return Motion(fixed, rotations, root, fps)


def write_bvh(path: str | os.PathLike[str], motion: Motion, unit: float = CENTIMETRES) -> None:
    """Write a motion as BVH, atomically; rotations in the order ZXY, those of the arms in `_ORDERS_OF_ARMS`. unit:
    metres per unit of the file; its numbers have six decimals."""
    skeleton = motion.skeleton if unit == 1.0 else skeletons.scaled_skeleton(motion.skeleton, 1.0 / unit)
    orders = [_order_of(name) for name in skeleton.names]
    turns = [tuple(f"{axis}rotation" for axis in order) for order in orders]
    channels = [("Xposition", "Yposition", "Zposition", *turns[0]), *turns[1:]]
    # An end site belongs to a leaf: the bone of another joint ends in its child.
    tips = {joint: tip for joint, tip in skeleton.end_sites.items() if joint not in skeleton.parents}
    lines, written_order = hierarchy(skeleton.names, skeleton.parents, skeleton.offsets, tips, channels)
    head = "\n".join([*lines, "MOTION", f"Frames: {len(motion)}", f"Frame Time: {1.0 / motion.fps:.10f}", ""])
    with new_file(path) as out:
        out.write(head.encode())
        before, added = np.zeros((2, 1, len(orders), 3))
        # Straight into the file and in slices: the angles of an hour are 280 MB, and their text 300.
        for first in range(0, len(motion), _SLICE):
            part = motion.crop(first, first + _SLICE)
            euler = np.empty((len(part), len(orders), 3))
            for order in set(orders):
                at = [joint for joint, each in enumerate(orders) if each == order]
                euler[:, at] = rotation.to_euler(part.rotations[:, at], order)
            # Unwrapped angles are smooth in tools that interpolate the channels separately.
            unwrapped, added = _unwrapped(euler, before if first else euler[:1], added)
            before = euler[-1:]
            angles = np.degrees(unwrapped)[:, written_order].reshape(len(part), -1)
            places = part.root_positions if unit == 1.0 else part.root_positions * (1.0 / unit)
            # Adding 0 turns -0 into 0.
            np.savetxt(out, np.concatenate([places, angles], axis=1) + 0.0, fmt="%.6f")


def _unwrapped(angles: Array, before: Array, turns: Array) -> tuple[Array, Array]:
    """As `np.unwrap` along time, bit for bit, for a slice of it. angles: [T, J, 3] radians; before: [1, J, 3] those of
    the frame before; turns: [1, J, 3] what was added to that. The unwrapped angles, and what was added to the last."""
    steps = np.diff(angles, axis=0, prepend=before)
    short = np.mod(steps + np.pi, 2.0 * np.pi) - np.pi
    # Half a turn keeps its sign.
    short[(short == -np.pi) & (steps > 0)] = np.pi
    change = np.where(np.abs(steps) < np.pi, 0.0, short - steps)
    added = np.cumsum(np.concatenate([turns, change]), axis=0)[1:]
    return angles + added, added[-1:]


def _order_of(joint: str) -> str:
    """The order of rotations of a joint, the first axis outermost."""
    side = next((side for side in skeletons.SIDES if joint.startswith(side)), None)
    return _WRITTEN_ORDER if side is None else _ORDERS_OF_ARMS.get(joint.removeprefix(side), _WRITTEN_ORDER)


def hierarchy(names: Sequence[str], parents: Sequence[int], offsets: Array, tips: Mapping[int, Array],
              channels: Sequence[Sequence[str]]) -> tuple[list[str], list[int]]:
    """The lines of HIERARCHY and the order of the joints in it, without recursion, for trees of any depth.

    offsets: [J, 3]; tips: joint -> [3] its end site, 0 for a leaf without one; channels: those of each joint.
    """
    below: list[list[int]] = [[] for _ in names]
    for joint, parent in enumerate(parents):
        if parent >= 0:
            below[parent].append(joint)
    lines, order, todo = ["HIERARCHY"], list[int](), [(0, 0, False)]
    while todo:
        joint, depth, done = todo.pop()
        pad = "  " * depth
        if done:
            lines.append(pad + "}")
            continue
        order.append(joint)
        lines += [f"{pad}{'JOINT' if depth else 'ROOT'} {names[joint]}", pad + "{",
                  f"{pad}  OFFSET {_triple(offsets[joint])}",
                  f"{pad}  CHANNELS {len(channels[joint])} {' '.join(channels[joint])}"]
        if not below[joint] or joint in tips:
            tip = tips.get(joint, np.zeros(3))
            lines += [f"{pad}  End Site", pad + "  {", f"{pad}    OFFSET {_triple(tip)}", pad + "  }"]
        todo += [(joint, depth, True), *((child, depth + 1, False) for child in reversed(below[joint]))]
    return lines, order


def _triple(lengths: Array) -> str:
    return " ".join(f"{value:.6f}" for value in np.asarray(lengths) + 0.0)
