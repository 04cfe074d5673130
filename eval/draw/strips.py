"""Strips: a motion as a row of still figures, seen from the front and from the side, for papers and README.

A strip shows what a number hides: a soldier's return to rest, an elbow behind the back, a hand in the face, the same
clip twice. Each figure is drawn at its own time on one shared floor, with the path of both hands since the figure
before it; underneath, where they are given, the waveform and its beats on the same time axis.

    gesticulator draw strip MOTION.bvh [--out strip.png] [--start 2] [--seconds 4] [--frames 8] [--sound speech.wav]
"""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from data_module.errors import InputError
from data_module.files import write_bytes
from data_module.motion import kinematics, rotation, skeletons
from data_module.types import Array, BeatFlag, Beats, Motion, Speech

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, SOFT, FLOOR = "#262a31", "#8d8578", "#d9d0c2"
SHIRT, TROUSERS, SKIN, HAIR, NOSE = "#3d7a85", "#4a4f5c", "#dcb999", "#5b493d", "#c79d7a"
HANDS = {"Left": "#1f8a8a", "Right": "#c8553d"}
BEAT_COLOURS = {BeatFlag.ONSET: "#c8553d", BeatFlag.LOUD_PSEUDO: "#d08c10", BeatFlag.EVEN_PSEUDO: "#5b7fa6",
                BeatFlag.BOUNDARY: INK}
VIEWS = {"front": (0, 2), "side": (2, 0)}
"""View -> (horizontal axis, axis towards the viewer). From the front the character's left is on the right; from the
side she is seen from her left and faces left."""

_UNSAID: dict[str, dict[str, Any]] = {
    "png": {"Software": None}, "svg": {"Date": None, "Creator": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None}}
_TRAIL_STEPS = 40
_HALO = 0.009
_Limb = tuple[Array, Array, tuple[float, float], str]
"""Start [2], end [2], the diameters there, colour."""
# Metres: between two figures, beside the first and the last, from the row's foot to its top, and the sound's height.
_FIGURE_SPACING, _MARGIN, _FLOOR_TO_TOP, _SOUND_HIGH = 1.12, 0.72, 2.12, 0.5
_HEAD_RADIUS = 0.108
_NOSE = np.array([0.0, 0.075, 0.125])


@dataclass(frozen=True)
class _Bone:
    """A drawn limb between two joints: its thickness in metres at both ends and its colour."""

    start: str
    end: str
    width: tuple[float, float]
    colour: str


_TORSO = ("Hips", "Spine", "Spine1", "Spine2", "Spine3", "Collar")
_ARMS = tuple(bone for side in ("Left", "Right") for bone in (
    _Bone(f"{side}Arm", f"{side}ForeArm", (0.112, 0.086), SHIRT),
    _Bone(f"{side}ForeArm", f"{side}Hand", (0.080, 0.052), SKIN),
    _Bone(f"{side}Hand", f"{side}HandTip", (0.066, 0.044), SKIN),
))


def frame_times(motion: Motion, start: float = 0.0, seconds: float | None = None, count: int = 8) -> Array:
    """[count] seconds, evenly spread over the stretch and clamped to the motion; InputError when it holds none."""
    last = (len(motion) - 1) / motion.fps
    end = last if seconds is None else min(start + seconds, last)
    if count < 1:
        raise InputError("--frames", f"must be 1 or more, not {count}")
    if not (math.isfinite(start) and 0 <= start <= last and end >= start):
        raise InputError("strip", f"{start:g} s is outside the motion, which lasts {motion.duration:.2f} s",
                         "give another --start or --seconds")
    return np.linspace(start, end, count) if count > 1 else np.array([start])


def figure_points(motion: Motion, times: Array) -> dict[str, Array]:
    """Where everything that is drawn lies: joint (or "LeftHandTip", "HeadTip") -> [len(times), 3] metres.

    Any upper body is brought onto the 16-joint character, faces +Z, and stands at `skeletons.HIP_HEIGHT`.
    """
    frames = np.clip(np.asarray(times) * motion.fps, 0, len(motion) - 1)
    first = int(frames.min())
    # Only the frames around these moments: a take may last an hour.
    near = skeletons.facing(skeletons.to_character(motion.crop(first, int(np.ceil(frames.max())) + 1)))
    rotations = rotation.interpolate(near.rotations, frames - first)
    root = np.tile([0.0, skeletons.HIP_HEIGHT, 0.0], (len(frames), 1))
    skeleton = near.skeleton
    places = kinematics.joint_positions(skeleton, rotations, root)
    world = kinematics.global_rotations(skeleton, rotations)
    points = {name: places[:, joint] for joint, name in enumerate(skeleton.names)}
    for joint, tip in skeleton.end_sites.items():
        points[skeleton.names[joint] + "Tip"] = places[:, joint] + rotation.rotate(world[:, joint], tip)
    head = skeleton.index("Head")
    points["Nose"] = places[:, head] + rotation.rotate(world[:, head], _NOSE)
    return points


def draw_strip(motion: Motion, times: Array, views: Sequence[str] = ("front", "side"), speech: Speech | None = None,
               beats: Beats | None = None, title: str = "") -> Figure:
    """The strip as a matplotlib figure: one row per view, one figure per time; the sound below when it is given.

    `beats` are marked below the sound with the colours of their flags. Save it with `save_strip`.
    """
    from matplotlib.figure import Figure as NewFigure

    across = (len(times) - 1) * _FIGURE_SPACING + 2 * _MARGIN
    high = [_FLOOR_TO_TOP] * len(views) + ([_SOUND_HIGH] if speech is not None else [])
    over = 0.22 if title else 0.0
    # Metres to inches: every row has the same scale, so the sound's time axis lies under the figures.
    scale = min(1.2, 21.0 / across)
    canvas = NewFigure(figsize=(across * scale, (sum(high) + over) * scale), facecolor="white")
    top = 1.0 - over / (sum(high) + over)
    for row, tall in enumerate(high):
        share = tall / (sum(high) + over)
        axis = canvas.add_axes((0.0, top - share, 1.0, share))
        top -= share
        if row < len(views):
            draw_row(axis, motion, np.asarray(times), views[row])
        elif speech is not None:
            draw_sound(axis, speech, beats, np.asarray(times))
    if title:
        canvas.text(0.5, 1.0 - 0.5 * over / (sum(high) + over), title, fontsize=11, color=INK, ha="center", va="center")
    return canvas


def save_strip(figure: Figure, path: str | Path, dpi: int = 150) -> None:
    """Write a picture whole or not at all, the same bytes for the same figure; the suffix picks png, svg or pdf.

    It leaves out the date, the version and matplotlib's random names. The names within an SVG are hashes of what they
    name, so several may stand in one page.
    """
    from matplotlib import rc_context

    target, out = Path(path), io.BytesIO()
    kind = target.suffix.lstrip(".").lower()
    if kind not in _UNSAID:
        raise InputError(target, f"'{target.suffix}' is no picture format", "use .png, .svg or .pdf")
    with rc_context({"svg.hashsalt": "eval.draw.plots", "svg.fonttype": "path"}):
        figure.savefig(out, format=kind, dpi=dpi, metadata=_UNSAID[kind])
    write_bytes(target, out.getvalue())


@dataclass(frozen=True)
class RowStyle:
    """How a row of figures is drawn. spacing: metres between figures; low, high: metres over the floor that are shown;
    clock: whether each figure bears its time; margin: metres beside the first and the last figure."""

    spacing: float = _FIGURE_SPACING
    low: float = 1.93 - _FLOOR_TO_TOP
    high: float = 1.93
    clock: bool = True
    margin: float = _MARGIN


def draw_row(axis: Axes, motion: Motion, times: Array, view: str, style: RowStyle | None = None) -> None:
    """One view of a motion: a figure for each of `times` (seconds), with the path of both hands since the last one."""
    style = style or RowStyle()
    across, depth = VIEWS[view]
    # Seen from the left, +Z points to the left of the picture.
    sign = -1.0 if view == "side" else 1.0
    # A figure's trail starts where the figure before it stood; the first has none.
    gap = float(times[1] - times[0]) if len(times) > 1 else 0.5
    for k, time in enumerate(times):
        centre = k * style.spacing
        moments = np.linspace(max(time - gap, 0.0), time, _TRAIL_STEPS) if k else np.array([time])
        points = figure_points(motion, moments)
        flat = {name: np.stack([sign * p[:, across] + centre, p[:, 1]], axis=1) for name, p in points.items()}
        near = {name: float(p[-1, depth]) for name, p in points.items()}
        _draw_figure(axis, flat, near, view, order=10 * k)
        if style.clock:
            axis.text(centre, -0.07, f"{time:.2f} s", ha="center", va="top", fontsize=8, color=SOFT)
    if style.low < 0:
        axis.axhline(0.0, color=FLOOR, linewidth=1.5, zorder=-10)
    axis.text(0.1 - style.margin, style.high - 0.07, view, fontsize=9, color=SOFT, style="italic", va="top")
    axis.set_xlim(-style.margin, (len(times) - 1) * style.spacing + style.margin)
    axis.set_ylim(style.low, style.high)
    axis.axis("off")


def _draw_figure(axis: Axes, flat: dict[str, Array], near: dict[str, float], view: str, order: float) -> None:
    """One figure of a row: far limbs first, then legs, torso and head, then the near limbs and the hands' trails."""
    now = {name: path[-1] for name, path in flat.items()}
    middle = near["Spine3"]
    _draw_legs(axis, now["Hips"], view, order)
    sides = sorted(("Left", "Right"), key=lambda side: near[f"{side}Hand"])
    for side in sides:
        # An arm whose hand lies behind the chest is drawn behind the body.
        level = order + (5 if near[f"{side}Hand"] >= middle - 0.05 else 1)
        _limbs(axis, [(now[bone.start], now[bone.end], bone.width, bone.colour)
                      for bone in _ARMS if bone.start.startswith(side)], level)
        _draw_trail(axis, flat[f"{side}HandTip"], HANDS[side], level + 1)
    _draw_body(axis, now, view, order + 3)
    _draw_head(axis, now, near["Nose"] - near["Head"], order + 4)


def _draw_body(axis: Axes, now: dict[str, Array], view: str, order: float) -> None:
    widths = (0.33, 0.30, 0.29, 0.32, 0.33, 0.14) if view == "front" else (0.23, 0.21, 0.21, 0.23, 0.21, 0.13)
    # The collar ends below the neck's joint.
    now = {**now, "Collar": now["Spine3"] * 0.35 + now["Neck"] * 0.65}
    shirt = [(now[_TORSO[k]], now[_TORSO[k + 1]], (widths[k], widths[k + 1]), SHIRT) for k in range(len(_TORSO) - 1)]
    shirt += [(now["Spine3"] * 0.35 + now[f"{side}Arm"] * 0.65, now[f"{side}Arm"], (0.15, 0.115), SHIRT)
              for side in ("Left", "Right")]
    _limbs(axis, [(now["Neck"], now["Head"], (0.105, 0.10), SKIN)], order)
    _limbs(axis, shirt, order + 0.2)


def _draw_head(axis: Axes, now: dict[str, Array], towards_viewer: float, order: float) -> None:
    """Hair is a disc, and the face a smaller one that lies where the nose points, so the gaze can be read."""
    from matplotlib.patches import Circle

    # The character's Head joint is the skull's base; its tip is the crown.
    up = now["HeadTip"] - now["Head"]
    centre = now["Head"] + 0.52 * up
    axis.add_patch(Circle(tuple(centre), _HEAD_RADIUS + _HALO, facecolor="white", zorder=order))
    axis.add_patch(Circle(tuple(centre), _HEAD_RADIUS, facecolor=HAIR, zorder=order + 0.1))
    if towards_viewer > -0.06:
        gaze = now["Nose"] - centre
        face = centre + 0.22 * gaze - 0.15 * up
        face_patch = Circle(tuple(face), _HEAD_RADIUS * 0.93, facecolor=SKIN, zorder=order + 0.2)
        axis.add_patch(face_patch)
        nose = Circle(tuple(now["Nose"]), 0.017, facecolor=NOSE, zorder=order + 0.3)
        axis.add_patch(nose)


def _draw_legs(axis: Axes, hips: Array, view: str, order: float) -> None:
    """Legs that stand still under the hips; the data knows nothing below them."""
    x = float(hips[0])
    legs, shoes = [], []
    for shift in (-0.095, 0.095) if view == "front" else (0.0,):
        foot = np.array([x + shift * 1.15, 0.05])
        toe = np.array([0.0, -0.008]) if view == "front" else np.array([-0.13, -0.008])
        legs.append((np.array([x + shift * 0.85, 0.90]), foot, (0.16, 0.09), TROUSERS))
        shoes.append((foot - [0.0, 0.008], foot + toe, (0.085, 0.07), INK))
    for leg in legs:
        _limbs(axis, [leg], order + 2)
    _limbs(axis, shoes, order + 2.5)


def _draw_trail(axis: Axes, path: Array, colour: str, order: float) -> None:
    """The way of a hand, faint where it is old."""
    from matplotlib.collections import LineCollection
    from matplotlib.colors import to_rgba

    if len(path) < 2:
        return
    age = np.linspace(0.0, 1.0, len(path) - 1)
    colours = [(*to_rgba(colour)[:3], 0.75 * share ** 1.5) for share in age]
    axis.add_collection(LineCollection(list(np.stack([path[:-1], path[1:]], axis=1)), colors=colours,
                                       linewidths=0.5 + 1.5 * age, capstyle="butt", zorder=order))


def _limbs(axis: Axes, limbs: Sequence[_Limb], order: float) -> None:
    """Limbs that belong together, with one thin white line around them all."""
    from matplotlib.patches import Polygon

    for start, end, (wide, narrow), _ in limbs:
        halo = capsule_outline(start, end, (wide + 2 * _HALO, narrow + 2 * _HALO))
        axis.add_patch(Polygon(halo, closed=True, facecolor="white", edgecolor="none", zorder=order))
    for start, end, width, colour in limbs:
        outline = capsule_outline(start, end, width)
        axis.add_patch(Polygon(outline, closed=True, facecolor=colour, edgecolor="none", zorder=order + 0.05))


def capsule_outline(start: Array, end: Array, width: tuple[float, float], steps: int = 14) -> Array:
    """[2 * steps, 2] the outline around two circles of diameters `width` at `start` and `end`, both [2].

    The sides touch both circles: they lean by asin((r0 - r1) / distance) against the axis. Where one circle lies in the
    other there is no such side, and the larger circle is the outline.
    """
    r0, r1 = width[0] / 2, width[1] / 2
    way = np.asarray(end) - np.asarray(start)
    distance = float(np.hypot(*way))
    if distance <= abs(r0 - r1) + 1e-9:
        centre, radius = (start, r0) if r0 >= r1 else (end, r1)
        angles = np.linspace(0.0, 2 * np.pi, 2 * steps, endpoint=False)
        return np.asarray(centre) + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    heading = math.atan2(way[1], way[0])
    touch = math.acos((r0 - r1) / distance)
    far = np.linspace(heading - touch, heading + touch, steps)
    back = np.linspace(heading + touch, heading + 2 * np.pi - touch, steps)
    return np.concatenate([np.asarray(end) + r1 * np.stack([np.cos(far), np.sin(far)], axis=1),
                           np.asarray(start) + r0 * np.stack([np.cos(back), np.sin(back)], axis=1)])


def draw_sound(axis: Axes, speech: Speech, beats: Beats | None, times: Array,
               style: RowStyle | None = None) -> None:
    """The waveform under the figures: time runs as they do, so that each stands above its own moment."""
    start, end = float(times[0]), float(times[-1])
    gap = (end - start) / max(len(times) - 1, 1) or 1.0
    # The same share of a spacing beyond the first and the last figure as in the rows above.
    style = style or RowStyle()
    margin = style.margin / style.spacing * gap
    low, high = max(start - margin, 0.0), min(end + margin, speech.duration)
    bins = np.linspace(low, high, 1200)
    places = np.clip((bins * speech.sample_rate).astype(int), 0, len(speech.samples) - 1)
    top = np.maximum.reduceat(np.abs(speech.samples), places)
    axis.fill_between(bins, -top, top, color=SOFT, linewidth=0)
    limit = float(top.max()) or 1.0
    if beats is not None:
        inside = (beats.times >= low) & (beats.times <= high)
        for time, flag in zip(beats.times[inside], beats.flags[inside], strict=True):
            colour = BEAT_COLOURS[BeatFlag(int(flag))]
            axis.plot([time, time], [-limit, limit], color=colour, linewidth=0.9, alpha=0.8)
            axis.plot([time], [limit * 1.18], marker="o", markersize=3, color=colour)
    for time in times:
        axis.axvline(time, color=FLOOR, linewidth=0.8, zorder=-5)
    axis.set_xlim(start - margin, end + margin)
    axis.set_ylim(-limit * 1.05, limit * 1.35)
    axis.axis("off")
