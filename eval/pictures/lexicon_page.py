"""The page of a lexicon: a card for each lexeme, with a sample gesture beside what the decoder makes of it."""

from __future__ import annotations

import html
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources

import numpy as np

from data_module.types import Array, Motion
from eval.pictures.embedding import colours
from gesticulator.export.figure import HANDS, VIEWS, figure_points, seen

_SLOT = re.compile(r"\{\{([a-z]+)\}\}")
_CROP = {"front": (-0.72, 1.44), "side": (-0.78, 1.14)}
"""View -> left edge and width of the picture in metres."""
_TOP, _TALL = 1.8, 1.06
"""Metres: how high over the floor the upper edge of a picture lies, and its height."""
_GHOSTS = ((0.0, 0.16), (0.5, 0.34), (1.0, 1.0))
"""Share of the gesture, and how strongly its pose is drawn."""
_KNOTS = 11


@dataclass(frozen=True)
class LexemeWord:
    """A word on the blocks of a lexeme: how often, and how many standard errors more often than elsewhere."""

    text: str
    count: int
    z: float


@dataclass(frozen=True)
class LexemeEntry:
    """One lexeme. share: of all blocks; shares: of each performer's; hand_speed: m/s on its blocks as performed (NaN
    where none was read); decoded_speed: m/s of the decoded lexeme in normalised time; in_silence: share of its blocks
    that lie in a pause; strokes: shares of its blocks; sample: where its sample gesture is from; does: what the hands
    do in it as decoded, in words."""

    lexeme: int
    silent: bool
    blocks: int
    share: float
    shares: dict[str, float]
    hand_speed: float
    decoded_speed: float
    in_silence: float
    words: tuple[LexemeWord, ...]
    strokes: dict[str, float]
    sample: str
    does: str = ""


def picture(motion: Motion, views: Sequence[str] = tuple(VIEWS)) -> str:
    """A short motion as inline SVG, one per view: first, middle and last pose, and the hands' ways.

    Dots mark a hand's way at eleven even moments, so wide gaps are speed; the ring is its end.
    """
    points = figure_points(motion, np.linspace(0, (len(motion) - 1) / motion.fps, _KNOTS))
    return "".join(_view(points, view) for view in views)


def _view(points: Mapping[str, Array], view: str) -> str:
    left, wide = _CROP[view]
    parts = []
    for share, strength in _GHOSTS:
        frame = round(share * (_KNOTS - 1))
        # The first part is the legs.
        limbs = [limb for part in seen({name: own[frame:frame + 1] for name, own in points.items()}, VIEWS[view])[1:]
                 for limb in part.limbs]
        lines = "".join(f'<path d="M{x:.3f},{_TOP - y:.3f}L{u:.3f},{_TOP - v:.3f}" stroke="{limb.colour}" '
                        f'stroke-width="{limb.r0[0] + limb.r1[0]:.3f}"/>'
                        for limb in limbs for (x, y), (u, v) in [(limb.start[0], limb.end[0])])
        parts.append(f'<g opacity="{strength}" stroke-linecap="round">{lines}</g>')
    for side, colour in HANDS.items():
        way = VIEWS[view].look(points[f"{side}HandTip"])[0] * [1.0, -1.0] + [0.0, _TOP]
        dots = "".join(f'<circle cx="{x:.3f}" cy="{y:.3f}" r=".009"/>' for x, y in way)
        line = " ".join(f"{x:.3f},{y:.3f}" for x, y in way)
        parts.append(f'<g fill="{colour}"><polyline points="{line}" fill="none" stroke="{colour}" stroke-width=".008"/>'
                     f'{dots}<circle cx="{way[-1, 0]:.3f}" cy="{way[-1, 1]:.3f}" r=".022" fill="none" '
                     f'stroke="{colour}" stroke-width=".009"/></g>')
    return (f'<svg class="{view}" viewBox="{left} 0 {wide} {_TALL}" role="img" aria-label="{view} view">'
            f'{"".join(parts)}</svg>')


def pictures(entry: LexemeEntry, sample: Motion | None, own: Motion) -> str:
    """The sample gesture of a lexeme beside the lexeme as decoded."""
    drawn, said = (picture(sample), entry.sample) if sample is not None else ("", "on no block that was read")
    return (f'<figure class="sample">{drawn}<figcaption>{html.escape(said)}</figcaption></figure>'
            f'<figure>{picture(own, ("front",))}<figcaption>as decoded</figcaption></figure>')


def card(entry: LexemeEntry, drawing: str, colour: str, widest: float) -> str:
    """One lexeme of the page. widest: the share that fills a bar."""
    who = "".join(f'<span>{html.escape(name)}</span><span><span class="bar" style="width:'
                  f'{min(100.0, 80 * share / max(widest, 1e-9)):.0f}px"></span>{100 * share:.1f} %</span>'
                  for name, share in entry.shares.items())
    words = ", ".join(f'<b title="{w.count} times, z = {w.z:.1f}">{html.escape(w.text)}</b>' for w in entry.words)
    speed = f"{entry.hand_speed:.2f} m/s as performed, " if math.isfinite(entry.hand_speed) else ""
    strokes = ", ".join(f"{html.escape(kind)} {100 * share:.0f} %" for kind, share in entry.strokes.items())
    return (f'<article data-lexeme="{entry.lexeme}" data-share="{entry.share}" data-speed="{_plain(entry.hand_speed)}" '
            f'data-pause="{entry.in_silence}"><h2><i style="background:{colour}"></i>{entry.lexeme}<label>'
            f'<input type="checkbox"{" checked" if entry.silent else ""}> silent</label></h2>'
            f'<div class="pictures">{drawing}</div><dl><dt>does</dt><dd>{html.escape(entry.does) or "-"}</dd>'
            f'<dt>blocks</dt><dd>{entry.blocks} ({100 * entry.share:.1f} %), '
            f'{100 * entry.in_silence:.0f} % of them in pauses</dd>'
            f'<dt>hands</dt><dd>{speed}{entry.decoded_speed:.2f} as decoded</dd>'
            f'<dt>words</dt><dd>{words or "-"}</dd><dt>strokes</dt><dd>{strokes or "-"}</dd>'
            f'<dt>performers</dt><dd class="who">{who}</dd></dl></article>')


def _plain(value: float) -> float:
    return value if math.isfinite(value) else -1.0


def page(entries: Sequence[LexemeEntry], drawings: Sequence[str], command: tuple[str, str], title: str, note: str
         ) -> str:
    """The contact sheet, nothing outside it. command: what stands before and after the list of ticked lexemes."""
    widest = max((share for own in entries for share in own.shares.values()), default=1.0)
    cards = "\n".join(card(own, drawing, colour, widest)
                      for own, drawing, colour in zip(entries, drawings, colours(len(entries)), strict=True))
    head, tail = (html.escape(part, quote=True) for part in command)
    parts = {"title": html.escape(title), "note": html.escape(note), "head": head, "tail": tail, "cards": cards}
    text = (resources.files("eval") / "assets" / "lexicon.html").read_text(encoding="utf-8")
    return _SLOT.sub(lambda found: parts[found[1]], text)
