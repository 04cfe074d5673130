"""The contact sheet and the film of docs/gestures.md: every named gesture, drawn from the shipped scripts.

    python docs/pictures/make_gestures.py [FOLDER] [NAME ...]

FOLDER is docs/pictures unless another is given; with names, only the sheet is drawn, of those. Each figure is at the
apex of its gesture, over the rest pose, with the paths of the hands from the stroke to the end of the hold; a pale
figure shows where the stroke began. Needs the extras `figures` (matplotlib) and, for the film, `video`.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from PIL import Image, ImageDraw, ImageFont

from data_module.motion import rotation
from data_module.motion.skeletons import CHARACTERS
from data_module.types import Array, Motion, Speech
from eval.pictures.strips import save_strip
from gesticulator.bundle.bundle import SHIPPED, load
from gesticulator.directing.gesture_phases import longest
from gesticulator.directing.gestures_command import gesture_rows
from gesticulator.directing.named_gestures import laid_over
from gesticulator.export.figure import HANDS, INK, SOFT, View, figure_points, seen
from gesticulator.export.film import PAPER, bt709, encode_pictures, pictures
from gesticulator.plan.gestures import REPERTOIRE
from gesticulator.plan.plan import GestureCue

HERE = Path(__file__).resolve().parent
FPS, COLUMNS = 60.0, 10
WIDE, LOW, HIGH = 1.2, 0.86, 1.98
"""Metres of a cell: its width, and the heights over the floor that it shows."""
INCH = 0.98
"""Inches for a metre."""
WHOLE, CROP, PANE, NAME, ACROSS = (150, 200), (15, 16, 135, 104), (120, 88), 16, 10
"""Of the film: pixels of a whole figure, of its upper part in it, of that part's size, and of its name; figures in a
row."""
FILM_FPS, FILM_FRAMES, APEX = 20, 62, 1.2
"""Frames a second, frames, and seconds to the apex."""
_TURN = np.radians(14.0)
"""By which the camera stands to the character's left."""


def look(points: Array) -> tuple[Array, Array, Array]:
    """A view from the front and a little from the character's left, in metres."""
    x = points[..., 0] * np.cos(_TURN) - points[..., 2] * np.sin(_TURN)
    depth = points[..., 0] * np.sin(_TURN) + points[..., 2] * np.cos(_TURN)
    return np.stack([x, points[..., 1]], axis=-1), np.ones(points.shape[:-1]), depth


def rest_pose() -> Array:
    """[3 J] the shipped character's pose at rest."""
    pose: Array = load(SHIPPED).statistics.rest_pose[0]
    return pose


def motion_of(name: str, rest: Array) -> tuple[Motion, float]:
    """A gesture over the rest pose, and the second of its apex."""
    phases = longest(name)
    times = np.arange(round((phases.before + phases.after + 0.4) * FPS)) / FPS
    at = phases.before + 0.2
    poses = laid_over(np.repeat(rest[None], len(times), axis=0), times, [(GestureCue(name), at)])
    turns = rotation.from_exponential_map(poses.reshape(len(poses), -1, 3))
    return Motion(CHARACTERS[turns.shape[1]], turns, np.zeros((len(poses), 3)), FPS), at


def sheet(names: Sequence[str], rest: Array, columns: int = COLUMNS) -> Figure:
    """All gestures in rows of cells."""
    rows = -(-len(names) // columns)
    tall = HIGH - LOW + 0.14
    figure = Figure(figsize=(columns * WIDE * INCH, rows * tall * INCH), facecolor="white")
    axis = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    for number, name in enumerate(names):
        row, column = divmod(number, columns)
        corner = np.array([(column + 0.5) * WIDE, (rows - row) * tall - HIGH - 0.02])
        draw_cell(axis, name, rest, corner)
    axis.set(xlim=(0.0, columns * WIDE), ylim=(0.0, rows * tall))
    axis.axis("off")
    return figure


def draw_cell(axis: Axes, name: str, rest: Array, corner: Array) -> None:
    """One gesture: the figure at its apex, and the ways of its hands."""
    motion, at = motion_of(name, rest)
    entry, phases = REPERTOIRE[name], longest(name)
    head_alone = entry.hands == "head"
    begin = figure_points(motion, np.array([at + 0.3 if head_alone else at - 0.9 * phases.stroke]), fingers=True)
    points = figure_points(motion, np.array([at]), fingers=True)
    clip = (corner[0] - WIDE / 2, corner[0] + WIDE / 2, corner[1] + LOW, corner[1] + HIGH)
    for now, pale in ((begin, True), (points, False)):
        for part in seen(now, View(look, 1.0)):
            if not pale or part.hand or head_alone:
                for corners, colour in part.polygons("white"):
                    axis.add_patch(Polygon(np.clip(corners[0] + corner, clip[::2], clip[1::2]), facecolor=colour,
                                           edgecolor="none", alpha=0.22 if pale else 1.0))
    moments = np.linspace(at - phases.stroke, at + phases.hold, 60)
    ways = figure_points(motion, moments, fingers=True)
    traced = {f"{side}HandMiddle1": colour for side, colour in HANDS.items()} | ({"Nose": INK} if head_alone else {})
    for point, colour in traced.items():
        way = look(ways[point])[0] + corner
        if np.ptp(way, axis=0).max() > 0.02:
            axis.plot(way[:, 0], way[:, 1], color=colour, linewidth=1.0, alpha=0.75)
    axis.text(corner[0], clip[2] - 0.055, name, fontsize=6.6, ha="center", va="center",
              color=INK if entry.core else SOFT, weight="bold" if entry.core else "normal")


def small(path: Path) -> None:
    """Reduce a picture to 48 colours: half the bytes."""
    whole = Image.open(path).convert("RGB")
    whole.quantize(48, dither=Image.Dither.NONE).save(path, optimize=True)


def frames(names: Sequence[str], rest: Array) -> Iterator[Image.Image]:
    """The pictures of the film: a pane for each gesture, all with their apex at the same time."""
    across, down = ACROSS, -(-len(names) // ACROSS)
    page = Image.new("RGB", (across * PANE[0], down * (PANE[1] + NAME)), bt709(PAPER))
    pen, font = ImageDraw.Draw(page), ImageFont.load_default(10)
    panes = []
    for number, name in enumerate(names):
        row, column = divmod(number, across)
        corner = column * PANE[0], row * (PANE[1] + NAME)
        pen.text((corner[0] + PANE[0] / 2, corner[1] + PANE[1] + NAME / 2 - 2), name, bt709(INK), font, "mm")
        motion, at = motion_of(name, rest)
        points = figure_points(motion, at + np.arange(FILM_FRAMES) / FILM_FPS - APEX, fingers=True)
        panes.append((pictures(points, WHOLE, bt709), corner))
    for _ in range(FILM_FRAMES):
        for drawn, corner in panes:
            page.paste(next(drawn).crop(CROP), corner)
        yield page.copy()


def film(path: Path, rest: Array) -> None:
    """Write the film of all gestures; its sound is silence."""
    names = list(REPERTOIRE)
    size = ACROSS * PANE[0], -(-len(names) // ACROSS) * (PANE[1] + NAME)
    silence = Speech(np.zeros(round(FILM_FRAMES / FILM_FPS * 16000), np.float32), 16000)
    path.write_bytes(encode_pictures(frames(names, rest), FILM_FRAMES, silence, path.suffix, size=size, fps=FILM_FPS))


def table() -> str:
    """The table of docs/gestures.md."""
    lines = ["| gesture | meaning | hands | | seconds before the apex, held, retracted |", "|---|---|---|---|---|"]
    for row in gesture_rows():
        names = ", ".join(f"`{name}`" for name in (row["name"], *row["also"]))
        notes = ", ".join(kind for kind in ("core", "weak", "offensive") if row[kind])
        lines.append(f"| {names} | {row['meaning']} | {row['hands']} | {notes} | "
                     f"{row['preparation'] + row['stroke']:.2f}, {row['hold']:.2f}, {row['retraction']:.2f} |")
    return "\n".join(lines)


def main(folder: str = str(HERE), *names: str) -> None:
    """Draw the sheet and, of all gestures, the film; print the table."""
    rest = rest_pose()
    save_strip(sheet(names or list(REPERTOIRE), rest), Path(folder) / "gestures.png", 150)
    small(Path(folder) / "gestures.png")
    if not names:
        film(Path(folder) / "gestures.mp4", rest)
        print(table())


if __name__ == "__main__":
    main(*sys.argv[1:])
