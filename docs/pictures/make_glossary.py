"""The pictures of docs/glossary.md, drawn from the example recording and the shipped weights.

    python docs/pictures/make_glossary.py [FOLDER [NAME ...]]

Every picture shows what the program computed for examples/speech.flac; FOLDER is docs/pictures/glossary unless another
is given, and NAME one of `PICTURES` (all of them). Needs the extra `figures` (matplotlib).
"""

from __future__ import annotations

import io
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from sklearn.manifold import TSNE

from data_module.blocks import stretch_speech
from data_module.files import write_bytes
from data_module.motion import kinematics
from data_module.motion.motion_beats import acting_positions, acting_speed, motion_beats
from data_module.speech.audio import load_speech, resample
from data_module.speech.onsets import RiseTracker, detect_onsets
from data_module.speech.silence import frame_levels, loudness
from data_module.types import Array, BeatFlag, Samples, Speech
from eval.pictures.lexicon_sheet import decoded, sheet
from eval.pictures.plots import beat_strips
from gesticulator import Gesticulator, Performance

ROOT = Path(__file__).resolve().parent.parent.parent
SAMPLE_RATE = 16000
"""Hz: what the models take."""
START, STOP = 0.0, 4.5
"""Seconds of the recording that are shown: a pause at the start, then a phrase with long and short blocks."""
WIDTH, DPI = 7.2, 100
"""Inches and dots per inch: pictures 720 pixels wide fit the text column of the site."""
MATCH = 0.1
"""Seconds between an onset and a motion beat that count as matched, as in PMB at 0.1 s."""

INK, SOFT, PALE, PAPER = "#262a31", "#8d8578", "#e4ded3", "#f5f2ec"
RED, BLUE, AMBER, TEAL = "#c8553d", "#5b7fa6", "#d08c10", "#1f8a8a"
FLAGS = {BeatFlag.ONSET: (RED, "on an onset"), BeatFlag.LOUD_PSEUDO: (AMBER, "pseudo-beat, first loud frame"),
         BeatFlag.EVEN_PSEUDO: (BLUE, "pseudo-beat, nothing loud"), BeatFlag.BOUNDARY: (INK, "start or end")}


@dataclass(frozen=True)
class Scene:
    """What the pictures are drawn from. onsets: seconds; sound: the recording at `SAMPLE_RATE`."""

    system: Gesticulator
    sound: Speech
    onsets: Array
    made: Performance


def scene() -> Scene:
    """The example recording and what the shipped weights make of it."""
    sound = resample(load_speech(ROOT / "examples" / "speech.flac"), SAMPLE_RATE)
    system = Gesticulator.from_pretrained()
    return Scene(system, sound, detect_onsets(sound.samples, SAMPLE_RATE), system(sound))


def canvas(heights: Sequence[float], shared: bool = True) -> tuple[Figure, list[Axes]]:
    """A picture of rows of these heights in inches, one under the other."""
    figure = Figure(figsize=(WIDTH, sum(heights)), facecolor="white", layout="constrained")
    axes = figure.subplots(len(heights), 1, squeeze=False, sharex=shared, height_ratios=list(heights))[:, 0]
    return figure, list(axes)


def plain(axis: Axes, *, time: bool = True) -> None:
    """No frame and no numbers but those of the time axis."""
    for side in ("left", "right", "top", "bottom"):
        axis.spines[side].set_visible(False)
    axis.tick_params(length=0, labelsize=8, labelcolor=SOFT, labelbottom=time)
    axis.set_yticks([])
    if time:
        axis.set_xlim(START, STOP)
        axis.xaxis.set_major_formatter(lambda value, _: f"{value:g} s")


def label(axis: Axes, text: str) -> None:
    """What a row shows, over its upper left corner."""
    axis.set_title(text, loc="left", fontsize=9, color=INK, pad=4)


def curve(axis: Axes, times: Array, values: Array, colour: str) -> None:
    """A curve over time; the axis takes in what is shown of it."""
    axis.plot(times, values, color=colour, linewidth=1.4)
    here = values[(times >= START) & (times <= STOP)]
    margin = 0.12 * float(np.ptp(here))
    axis.set_ylim(here.min() - margin, here.max() + margin)


def envelope(axis: Axes, samples: Samples, start: float, stop: float, colour: str = SOFT, scale: float = 1.0) -> None:
    """A waveform between two times of the axis as a filled outline."""
    count = min(900, len(samples))
    places = np.linspace(0, len(samples), count, endpoint=False).astype(int)
    high = np.maximum.reduceat(np.abs(samples), places) * scale
    axis.fill_between(np.linspace(start, stop, count), -high, high, color=colour, linewidth=0)


def waveform(axis: Axes, sound: Speech, colour: str = SOFT) -> float:
    """The stretch of the recording that is shown; its largest value."""
    piece = sound.samples[round(START * SAMPLE_RATE):round(STOP * SAMPLE_RATE)]
    envelope(axis, piece, START, STOP, colour)
    top = float(np.abs(piece).max())
    axis.set_ylim(-1.1 * top, 1.1 * top)
    plain(axis)
    return top


def onset(s: Scene) -> Figure:
    """The waveform, the onset strength under it and the onsets."""
    figure, (upper, lower) = canvas((0.8, 0.8))
    top = waveform(upper, s.sound)
    label(upper, "waveform, onsets marked")
    upper.vlines(s.onsets, -top, top, color=RED, linewidth=1.2)
    rise, ground = RiseTracker(SAMPLE_RATE), loudness(frame_levels(s.sound.samples, SAMPLE_RATE)).ground
    strength = np.concatenate([rise.step(s.sound.samples, ground), rise.finish()])
    lower.vlines(s.onsets, 0, strength.max(), color=RED, linewidth=0.8, alpha=0.5)
    curve(lower, np.arange(len(strength)) / 100, strength, INK)
    plain(lower)
    upper.tick_params(labelbottom=False)
    label(lower, "onset strength")
    return figure


def beat(s: Scene) -> Figure:
    """The beats, coloured by the reason that each has."""
    figure, (axis,) = canvas((1.35,))
    top = waveform(axis, s.sound, PALE)
    axis.vlines(s.onsets, -0.5 * top, 0.5 * top, color=SOFT, linewidth=0.8, label="onset")
    ends = s.made.blocks.edges[1:]
    for flag, (colour, text) in FLAGS.items():
        times = ends[s.made.blocks.flags == flag]
        if ((times > START) & (times < STOP)).any():
            axis.vlines(times, -top, top, color=colour, linewidth=1.8, label=text)
    figure.legend(loc="outside upper left", ncols=4, fontsize=8, frameon=False, labelcolor=INK, handlelength=1)
    return figure


def shown(s: Scene) -> list[tuple[int, float, float]]:
    """The blocks that begin in the stretch that is shown: number, start and end in seconds."""
    edges = s.made.blocks.edges
    return [(i, float(edges[i]), float(edges[i + 1])) for i in range(len(edges) - 1) if START <= edges[i] < STOP]


def block(s: Scene) -> Figure:
    """Blocks as shaded stretches of the waveform; silent ones hatched."""
    figure, (axis,) = canvas((1.25,))
    top = waveform(axis, s.sound, INK)
    axis.set_ylim(-1.1 * top, 1.45 * top)
    for i, start, stop in shown(s):
        silent = bool(s.made.blocks.silent[i])
        axis.axvspan(start, stop, facecolor="white" if silent else (PALE if i % 2 else PAPER), edgecolor=PALE,
                     hatch="////" if silent else None, linewidth=0, zorder=-5)
        if stop < STOP:
            axis.text((start + stop) / 2, 1.25 * top, f"{stop - start:.2f}", ha="center", va="center", fontsize=7,
                      color=INK)
    label(axis, "blocks and their lengths in seconds; hatched: silent")
    return figure


def stretching(s: Scene) -> Figure:
    """Three neighbouring blocks as spoken, and the same three at equal length."""
    figure, (upper, lower) = canvas((0.95, 0.95), shared=False)
    blocks = s.made.blocks
    spoken = [i for i, _, _ in shown(s) if not blocks.silent[i:i + 3].any()]
    first = max(spoken, key=lambda i: float(np.ptp(blocks.durations[i:i + 3])))
    stretched = stretch_speech(s.sound, blocks)
    length = blocks.frames / blocks.fps
    colours = (TEAL, RED, BLUE)
    for k, i in enumerate(range(first, first + 3)):
        start, stop = float(blocks.edges[i]), float(blocks.edges[i + 1])
        piece = s.sound.samples[round(start * SAMPLE_RATE):round(stop * SAMPLE_RATE)]
        begin = start - float(blocks.edges[first])
        envelope(upper, piece, begin, begin + stop - start, colours[k])
        envelope(lower, stretched[i], k * length, (k + 1) * length, colours[k])
    for axis, text in ((upper, "as spoken"), (lower, f"brought to {length:g} s each, the pitch kept")):
        plain(axis, time=False)
        axis.set_xlim(-0.02, 3 * length + 0.02)
        axis.tick_params(labelbottom=True)
        axis.xaxis.set_major_formatter(lambda value, _: f"{value:g} s")
        label(axis, text)
    return figure


def lexeme(s: Scene) -> Figure:
    """Three lexemes that the example plays, those that move most, each as three poses."""
    motions = decoded(s.system.bundle)
    speaking = np.unique(s.made.lexemes[~s.made.blocks.silent]).tolist()
    widest = sorted(speaking, key=lambda k: -np.ptp(acting_positions(motions[k]), axis=0).sum())[:3]
    return sheet([motions[k] for k in widest], [f"lexeme {k}" for k in widest])


def lexicon(s: Scene) -> Figure:
    """The codebook as t-SNE lays it out: neighbours are alike; the silent lexemes are marked."""
    vectors = s.system.bundle.vectors
    flat = TSNE(perplexity=12, init="pca", random_state=0).fit_transform(vectors)
    figure, (axis,) = canvas((3.2,))
    area = min(210.0, 21_000 / len(flat))  # square points: two hundred lexemes have half the room of one hundred
    silent = np.isin(np.arange(len(flat)), s.system.bundle.silent)
    for mask, colour, text in ((~silent, TEAL, "lexeme"), (silent, AMBER, "silent lexeme")):
        axis.scatter(*flat[mask].T, s=area, color=colour, alpha=0.25, linewidth=0, label=text)
    for number, (x, y) in enumerate(flat):
        axis.text(x, y, str(number), ha="center", va="center", fontsize=0.45 * area**0.5, color=INK)
    plain(axis, time=False)
    axis.set_xticks([])
    figure.legend(loc="outside upper left", ncols=2, fontsize=8, frameon=False, labelcolor=INK)
    return figure


def silent_lexeme(s: Scene) -> Figure:
    """Speed of the hands in the example, its silent blocks shaded."""
    figure, (upper, lower) = canvas((0.6, 0.9))
    waveform(upper, s.sound)
    label(upper, "waveform; shaded: silent blocks")
    motion = s.made.motion
    curve(lower, np.arange(len(motion)) / motion.fps, acting_speed(acting_positions(motion), motion.fps), INK)
    for axis in (upper, lower):
        for i, start, stop in shown(s):
            if s.made.blocks.silent[i]:
                axis.axvspan(start, stop, color=AMBER, alpha=0.25, linewidth=0, zorder=-5)
    plain(lower)
    upper.tick_params(labelbottom=False)
    label(lower, "speed of hands and elbows")
    return figure


def control(s: Scene) -> Figure:
    """The height of the right hand when the same speech is asked for low, mid and high hands."""
    figure, (axis,) = canvas((1.5,))
    for level, colour in (("low", BLUE), ("mid", SOFT), ("high", RED)):
        motion = s.system(s.sound, hand_height=level).motion
        hand, hips = (kinematics.positions_of(motion)[:, motion.skeleton.index(joint), 1]
                      for joint in ("RightHand", "Hips"))
        axis.plot(np.arange(len(motion)) / motion.fps, hand - hips, color=colour, linewidth=1.6, label=level)
    plain(axis)
    axis.set_xlim(START, 3 * STOP)
    axis.set_yticks([0.0, 0.2, 0.4], ["0", "0.2 m", "0.4 m"])
    axis.grid(axis="y", color=PALE, linewidth=0.8)
    label(axis, "height of the right hand over the hips")
    axis.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=3, fontsize=8, frameon=False, labelcolor=INK)
    return figure


def interpreter(s: Scene) -> Figure:
    """The five likeliest lexemes of each block, darker where likelier, over the one that was sampled."""
    figure, (upper, lower) = canvas((0.5, 1.5))
    waveform(upper, s.sound)
    upper.tick_params(labelbottom=False)
    for i, start, end in shown(s):
        stop = min(end, STOP)
        choices = s.made.decided.blocks[i].alternatives
        cells = [*((choice.lexeme, np.exp(choice.score)) for choice in choices), (s.made.lexemes[i], None)]
        for row, (number, share) in enumerate(cells):
            low = -row - (1.3 if share is None else 1.0)
            tint, depth = (RED, 0.45) if share is None else (TEAL, 0.1 + 0.9 * float(share))
            lower.fill_between([start, stop], low, low + 1, color=tint, alpha=depth, linewidth=0)
            lower.text((start + stop) / 2, low + 0.48, str(number), ha="center", va="center", fontsize=7.5, color=INK)
        lower.vlines(start, -6.4, 0, color="white", linewidth=2)
    plain(lower)
    label(lower, "the five likeliest lexemes of each block (darker: likelier) and, in red, the one that was sampled")
    return figure


def matched_beats(s: Scene) -> Figure:
    """Onsets over motion beats; those matched within `MATCH` seconds are joined."""
    made = s.made
    return beat_strips({"": (motion_beats(made.motion), s.onsets, made.blocks.edges)}, START, STOP - START, MATCH)


PICTURES: dict[str, Callable[[Scene], Figure]] = {
    "onset": onset, "beat": beat, "block": block, "stretching": stretching, "lexeme": lexeme, "lexicon": lexicon,
    "silent-lexeme": silent_lexeme, "interpreter": interpreter, "control": control,
    "matched-beats": matched_beats}
"""Name of the file, without .png -> what draws it."""


def main(folder: Path, names: Sequence[str]) -> None:
    """Draw pictures into a folder."""
    drawn_from = scene()
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        out = io.BytesIO()
        PICTURES[name](drawn_from).savefig(out, format="png", dpi=DPI, metadata={"Software": None})
        write_bytes(folder / f"{name}.png", out.getvalue())
        print(f"{folder / name}.png: {len(out.getvalue()) / 1000:.0f} kB")


main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parent / "glossary",
     sys.argv[2:] or list(PICTURES))
