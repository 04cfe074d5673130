"""Small moving figures of all lexemes and named gestures, to choose from by eye: the joints of head, trunk and arms."""

import base64
from typing import Any

import numpy as np
from numpy.typing import NDArray

from data_module.motion.kinematics import positions_of
from data_module.types import Array, Motion
from gesticulator.bundle.bundle import Bundle
from gesticulator.bundle.features import representation_of
from gesticulator.directing.lexeme_names import FAR, LIFTED, MOVES, hand_ways
from gesticulator.plan.gestures import ALIASES, GESTURES, REPERTOIRE
from gesticulator.plan.plan import GestureCue

JOINTS = ("Head", "Neck", "Hips", "LeftArm", "LeftForeArm", "LeftHand", "RightArm", "RightForeArm", "RightHand")
BONES = ((0, 1), (1, 2), (1, 3), (3, 4), (4, 5), (1, 6), (6, 7), (7, 8))
"""Lines of a figure, pairs of `JOINTS`."""
_HANDS = {"one": "one hand", "two": "both hands", "one or two": "one hand, both hands", "head": "head"}
"""How to search for the hands of a gesture."""
FRAMES = 12
"""Pictures of a gesture."""
FPS = 16.0
"""Pictures per second of a lexeme."""


def moving_figures(bundle: Bundle, speaker: int) -> dict[str, Any]:
    """All figures in plain values: `lexemes` and `gestures`, each with `points`, base64 of int8 [T, joints, 2]: metres
    in hundredths, to the right and up as seen from the front, from the hips."""
    return {"joints": list(JOINTS), "bones": [list(bone) for bone in BONES], "fps": FPS,
            "lexemes": _lexemes(bundle), "gestures": _gestures(bundle, speaker)}


def _lexemes(bundle: Bundle) -> list[dict[str, Any]]:
    ways = hand_ways(bundle)
    if ways is None:
        return []
    count = len(bundle.vectors)
    points = _points(ways.motion).reshape(count, -1, len(JOINTS), 2)
    silent = set(bundle.silent.tolist())
    out = []
    for lexeme in range(count):
        moves, way = ways.paths[lexeme] > MOVES, ways.ways[lexeme]
        phase = "rest" if lexeme in silent else "stroke" if moves.any() else "hold"
        apart = way[:, 0]
        words = "open" if (apart > MOVES).all() else "close" if (apart < -MOVES).all() else ""
        out.append({"lexeme": lexeme, **_described(moves, np.linalg.norm(way, axis=-1), ways.heights[lexeme]),
                    "phase": phase, "words": words, "points": _text(points[lexeme])})
    return out


def _described(moves: NDArray[np.bool_], ways: Array, heights: Array) -> dict[str, str]:
    """The words by which the palette is searched: which hands move (left, right), how far and how high. ways, heights:
    metres."""
    hand = "both" if moves.all() else "right" if moves[0] else "left" if moves[1] else "none"
    # The bounds are those of the names of lexemes.
    return {"hand": hand, "size": "far" if ways.max() > FAR else "near",
            "height": "up" if heights.max() > LIFTED else "down"}


def _gestures(bundle: Bundle, speaker: int) -> list[dict[str, Any]]:
    from gesticulator.directing.named_gestures import laid_over, span_of_gesture

    representation = representation_of(bundle.config)
    if representation.name != "rotations":
        return []
    rest = bundle.statistics.rest_pose[speaker]
    out = []
    for name in GESTURES:
        before, after = span_of_gesture(name)
        # Without the two ends, at which every gesture is at rest.
        times = np.linspace(-before, after, FRAMES + 2)[1:-1]
        poses = laid_over(np.repeat(rest[None], FRAMES, axis=0), times, [(GestureCue(name, time=0.0), 0.0)])
        motion = representation.motion(poses, FRAMES / (before + after))
        hands = REPERTOIRE[ALIASES.get(name, name)].hands
        out.append({"name": name, "seconds": round(before + after, 2), **_ways(motion), "phase": "stroke",
                    "words": _HANDS[hands], "points": _text(_points(motion))})
    return out


def _ways(motion: Motion) -> dict[str, str]:
    """Which hand a gesture takes, how far and how high, in the words of lexemes."""
    names, places = motion.skeleton.names, positions_of(motion)
    hands = np.stack([places[:, names.index(side)] - places[:, names.index("Hips")] for side in JOINTS[8:4:-3]])
    away = np.linalg.norm(hands - hands[:, :1], axis=-1).max(axis=1)
    moves = np.linalg.norm(np.diff(hands, axis=1), axis=-1).sum(axis=1) > MOVES
    return _described(moves, away, hands[..., 1])


def _points(motion: Motion) -> Array:
    """[T, joints, 2] hundredths of a metre to the right and up, as seen from the front, from the hips."""
    names = motion.skeleton.names
    # Seen from the front, the character's left is to the right, where +X is.
    places = positions_of(motion)
    chosen = places[:, [names.index(name) for name in JOINTS]] - places[:, :1]
    return chosen[..., :2] * 100.0


def _text(points: Array) -> str:
    # As bytes, because hundreds of figures are sent when the palette opens.
    return base64.b64encode(np.clip(np.round(points), -127, 127).astype(np.int8).tobytes()).decode("ascii")
