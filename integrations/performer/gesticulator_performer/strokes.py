"""The strokes that a performer plays, with the times of start, beat, end of hold and end.

A stroke is stored as log rotations of the two arms (fingers included) against the performer's rest pose, so that it can
be scaled, joined to another one and mirrored. Its times are measured on the motion, not read from a label.
"""

from __future__ import annotations

import hashlib
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from data_module.errors import InputError, shown
from data_module.motion import kinematics, rotation
from data_module.motion.bvh import read_bvh
from data_module.types import Array, Motion, Skeleton
from gesticulator_performer.cues import Cues, mirrored
from gesticulator_performer.joints import MIRROR, SIDES, with_rhythm
from gesticulator_performer.tables import read_clips, table

SCRIPTED = "script_"
"""Beginning of the name of a clip that was drawn from a script; all others were captured from people."""
ENOUGH = 3
"""Captured strokes of a label, mirror images apart, from which on its scripted takes are not played."""
SCRIPT_BODY = "script"
"""The name of the body of scripted takes."""
# Lent takes in memory, about 70 kB each.
_REMEMBERED = 300
_NONE = np.array([1.0, 0.0, 0.0, 0.0])
LEFT, RIGHT = 0, 1
ACTING_SIDES: dict[str, tuple[int, ...]] = {"left": (LEFT,), "right": (RIGHT,), "both": (LEFT, RIGHT), "none": ()}
HELD_OUT_SHARE = 0.15
"""Share of each person's clips that are held out for test."""

_CLIPS = table("clips.toml")["strokes"]
_COLUMNS = frozenset({"file", "speaker", "posture", "lexeme", "hand", "emphasis"})
# Least travel of a hand in a stroke, metres; anything smaller is a fidget.
_MIN_REACH = 0.05
# Frames per second at which a clip's times are measured: four per frame of the clips.
_FINE_FPS = 120.0
# Smoothing of the speed, seconds, as for motion beats.
_SMOOTH = 0.05
# Least deceleration at the beat, as a share of the clip's hardest.
_BEAT_DEPTH = 0.35
# Seconds by which the beat may follow the emphasis mark of the clip's author.
_AFTER_EMPHASIS = 0.12


@dataclass(frozen=True)
class PerformerBody:
    """A performer's body.

    rest: [J, 4] local rotations of the pose with hanging arms. root: [3] position of the hips at rest, metres.
    arms: joint indices of the left and the right arm, shoulder first, fingers last, in the same order on both sides.
    trunk: indices of the joints from the hips to the head, in order. home: [2, A, 3] log rotations against rest of the
    pose in front of the body that an arm returns to between strokes.
    """

    name: str
    skeleton: Skeleton
    rest: Array
    root: Array
    arms: tuple[tuple[int, ...], tuple[int, ...]]
    trunk: tuple[int, ...]
    home: Array


@dataclass(frozen=True)
class Stroke:
    """One gesture of one performer.

    clip: name of the recording; base: the same for a clip and its mirror image. arms: [2, T, A, 3] log rotations of
    the left and the right arm against the rest pose; trunk: [T, B, 3] likewise, B joints of `PerformerBody.trunk`.
    start, beat, hold_end, end: seconds in the clip. held_out: for the test
    split only. steady: must not be played faster than recorded. meaning: label of the gesture ("point_there"), "" for
    none. faithful: a hand touches the head or the other hand, so the stroke is played at its recorded size. size: of a
    take that was drawn from a script, which keeps its shape and tempo, 1 for medium; 0 for a captured stroke.
    """

    clip: str
    base: str
    speaker: str
    lexeme: str
    hand: str
    fps: float
    arms: Array
    trunk: Array
    start: float
    beat: float
    hold_end: float
    end: float
    held_out: bool = False
    steady: bool = False
    meaning: str = ""
    faithful: bool = False
    size: float = 0.0
    _splines: dict[tuple[int, int | None], CubicSpline] = field(default_factory=dict, compare=False, repr=False)

    @property
    def sides(self) -> tuple[int, ...]:
        return ACTING_SIDES[self.hand]

    @property
    def scripted(self) -> bool:
        """Whether it was drawn from a script."""
        return self.size > 0.0

    def arm_at(self, side: int, seconds: Array, joints: int | None = None) -> Array:
        """Log rotations [M, joints * 3] of an arm, from the shoulder on, at times in the clip; constant beyond its
        ends."""
        return self._at((side, joints), self.arms[side][:, :joints], seconds)

    def trunk_at(self, seconds: Array) -> Array:
        """Log rotations [M, B * 3] of the trunk at times in the clip, constant beyond its ends."""
        return self._at((2, None), self.trunk, seconds)

    def _at(self, key: tuple[int, int | None], track: Array, seconds: Array) -> Array:
        if key not in self._splines:
            times = np.arange(len(track)) / self.fps
            self._splines[key] = CubicSpline(times, track.reshape(len(track), -1))
        return self._splines[key](np.clip(seconds, 0.0, (len(track) - 1) / self.fps))


def lent(stroke: Stroke, lender: PerformerBody, borrower: PerformerBody, head: bool = False, trunk: bool = False
         ) -> Stroke:
    """The stroke of a lender for a borrower: the arms' joints of the same name point where the lender's do. Joints that
    the lender lacks and the trunk stay at rest; with `head` the neck and the head move as the lender's, with `trunk`
    the spine, too.

    Skeletons of different makers differ in the pose that identity rotations mean: some hold the arms level, some half
    down. A bone of the borrower is turned so that it points where the lender's does. With B the rotation of the bind
    pose of a joint from borrower to lender and p its parent, the local rotation q becomes B_p^-1 q B.
    """
    arms = np.stack([_arm(stroke.arms[side], side, lender, borrower) for side in (0, 1)])
    turns = np.zeros((stroke.trunk.shape[0], len(borrower.trunk), 3))
    theirs = [lender.skeleton.names[j] for j in lender.trunk]
    for place, joint in enumerate(borrower.trunk):
        name = borrower.skeleton.names[joint]
        if name in theirs and (trunk or (head and name.startswith(("Neck", "Head")))):
            turns[:, place] = stroke.trunk[:, theirs.index(name)]
    return replace(stroke, speaker=borrower.name, arms=arms, trunk=turns, _splines={})


def _arm(logs: Array, side: int, lender: PerformerBody, borrower: PerformerBody) -> Array:
    """Log rotations [T, A, 3] against the borrower's rest from the lender's [T, B, 3] against theirs."""
    theirs = [lender.skeleton.names[j] for j in lender.arms[side]]
    joints = [j for j in borrower.arms[side] if borrower.skeleton.names[j] in theirs]
    of = [theirs.index(borrower.skeleton.names[j]) for j in joints]
    binds = bind_differences(lender.skeleton, borrower.skeleton, SIDES[side])
    own = np.stack([binds.get(j, _NONE) for j in joints])
    parents = np.stack([binds.get(borrower.skeleton.parents[j], _NONE) for j in joints])
    before = rotation.multiply(rotation.conjugate(borrower.rest[joints]), rotation.conjugate(parents))
    before = rotation.multiply(before, lender.rest[[lender.arms[side][k] for k in of]])
    local = rotation.multiply(rotation.multiply(before[None], rotation.from_exponential_map(logs[:, of])), own[None])
    out = np.zeros((len(logs), len(borrower.arms[side]), 3))
    out[:, [borrower.arms[side].index(j) for j in joints]] = rotation.unroll(rotation.to_exponential_map(local))
    return out


def bind_differences(lender: Skeleton, borrower: Skeleton, side: str) -> dict[int, Array]:
    """Joint of the borrower -> quaternion that turns its bone in the bind pose to the lender's, for one arm. The hand's
    holds for its fingers; a clavicle and joints without the needed children have none."""
    there = {side + name for name in ("Arm", "ForeArm", "Hand", "HandMiddle1", "HandIndex1")}
    there &= set(lender.names) & set(borrower.names)
    out: dict[int, Array] = {}
    for name, end in (("Arm", "ForeArm"), ("ForeArm", "Hand"), ("Hand", "HandMiddle1")):
        if side + end in there:
            ours, theirs = (skeleton.offsets[skeleton.index(side + end)] for skeleton in (borrower, lender))
            out[borrower.index(side + name)] = rotation.between(ours, theirs)
    if {f"{side}HandMiddle1", f"{side}HandIndex1"} <= there:
        out |= dict.fromkeys([j for j, name in enumerate(borrower.names) if name.startswith(f"{side}Hand")],
                             _hand(lender, borrower, side, out[borrower.index(f"{side}Hand")]))
    return out


def _hand(lender: Skeleton, borrower: Skeleton, side: str, turn: Array) -> Array:
    """`turn` of the middle finger, and then about it, so that the index fingers are on the same side of it."""
    axis = lender.offsets[lender.index(f"{side}HandMiddle1")]
    axis = axis / np.linalg.norm(axis)
    ours = rotation.rotate(turn, borrower.offsets[borrower.index(f"{side}HandIndex1")])
    theirs = lender.offsets[lender.index(f"{side}HandIndex1")]
    across = [vector - float(vector @ axis) * axis for vector in (ours, theirs)]
    return rotation.multiply(rotation.between(*across), turn)


@dataclass(frozen=True)
class Repertoire:
    """The takes of a folder. outlines: strokes without their motion, each with its mirror image; licences: of the
    takes, in order."""

    folder: Path
    outlines: tuple[Stroke, ...]
    licences: tuple[str, ...]
    _bodies: dict[str, PerformerBody] = field(default_factory=dict, repr=False)
    _played: dict[tuple[str, str], Stroke] = field(default_factory=dict, repr=False)

    @property
    def labels(self) -> frozenset[str]:
        """The labels of the takes and of their mirror images."""
        return frozenset(outline.meaning for outline in self.outlines)

    def usable(self, strokes: Sequence[Stroke], split: str) -> tuple[Stroke, ...]:
        """The outlines of the labels of which a performer has fewer than `ENOUGH` captured strokes (given)."""
        captured = Counter(label for label, _ in {(stroke.meaning, stroke.base) for stroke in strokes})
        return tuple(outline for outline in self.outlines if captured[outline.meaning] < ENOUGH
                     and (split == "test" or not outline.held_out))

    def played(self, outline: Stroke, body: PerformerBody) -> Stroke:
        """The stroke of an outline with its motion, on the body of a performer. InputError for a broken clip."""
        key = outline.clip, body.name
        if key not in self._played:
            if len(self._played) >= _REMEMBERED:
                self._played.clear()
            self._played[key] = self._lent(outline, body)
        return self._played[key]

    def _lent(self, outline: Stroke, body: PerformerBody) -> Stroke:
        file = self.folder / f"{outline.base.removeprefix(SCRIPTED)}.bvh"
        motion = read_bvh(file, unit=1.0)
        if SCRIPT_BODY not in self._bodies:
            self._bodies[SCRIPT_BODY] = standing_body(SCRIPT_BODY, [motion])
        figure = self._bodies[SCRIPT_BODY]
        arms = np.stack([logs_against(figure.rest, motion.rotations, joints) for joints in figure.arms])
        trunk = logs_against(figure.rest, motion.rotations, figure.trunk)
        stroke = replace(outline, clip=outline.base, fps=motion.fps, arms=arms, trunk=trunk)
        if outline.clip != outline.base:
            stroke = replace(mirror(stroke), lexeme=outline.lexeme, hand=outline.hand, meaning=outline.meaning)
        return lent(stroke, figure, body, trunk=True)


@dataclass(frozen=True)
class StrokeSet:
    """Strokes, the bodies of the performers by name, the cues that call for the strokes that have a meaning, and takes
    of gestures that were drawn from scripts."""

    strokes: tuple[Stroke, ...]
    figures: Mapping[str, PerformerBody]
    cues: Cues | None = None
    repertoire: Repertoire | None = None

    @property
    def performers(self) -> tuple[str, ...]:
        return tuple(sorted(self.figures))

    def of(self, performer: str, split: str = "train") -> tuple[Stroke, ...]:
        captured = tuple(s for s in self.strokes if s.speaker == performer and (split == "test" or not s.held_out))
        return (*captured, *self.repertoire.usable(captured, split)) if self.repertoire else captured

    def played(self, stroke: Stroke, performer: str) -> Stroke:
        """A stroke of `of` with its motion, which takes from scripts get when they are played."""
        if self.repertoire is None or not stroke.scripted:
            return stroke
        return self.repertoire.played(stroke, self.figures[performer])


def arrivals(speed: Array, fps: float) -> tuple[Array, Array]:
    """Strong decelerations of a speed [T]: times in seconds (between frames, by a parabola) and depths, m/s^2. A motion
    beat is a minimum of the derivative of the speed, smoothed over 50 ms (`motion_beats`, mode A)."""
    smooth = gaussian_filter1d(speed, _SMOOTH * fps / 2.0, mode="nearest")
    slope = np.gradient(smooth) * fps
    middle = slope[1:-1]
    at = np.flatnonzero((middle < slope[:-2]) & (middle <= slope[2:]) & (middle < 0.0)) + 1
    a, b, c = slope[at - 1], slope[at], slope[at + 1]
    bend = a - 2.0 * b + c
    shift = np.where(bend > 0, 0.5 * (a - c) / np.where(bend > 0, bend, 1.0), 0.0)
    return (at + shift) / fps, -slope[at]


def _speed(track: Array, fps: float) -> tuple[Array, Array]:
    """Resample positions [T, 3] at `fps` to positions and smoothed speed at `_FINE_FPS`."""
    times = np.arange(len(track)) / fps
    fine = np.arange(int(times[-1] * _FINE_FPS) + 1) / _FINE_FPS
    spline = CubicSpline(times, track)
    speed = np.linalg.norm(spline(fine, 1), axis=-1)
    return spline(fine), gaussian_filter1d(speed, _SMOOTH * _FINE_FPS / 2.0, mode="nearest")


def acting_hands(hands: Array) -> tuple[str, float]:
    """The acting hand ("left", "right" or "both") and its travel in metres, from the hand paths [T, 2, 3]. Both act if
    the hand that travels less goes at least 45 % as far as the other."""
    reach = np.linalg.norm(hands - hands[:1], axis=-1).max(axis=0)
    greater = int(reach.argmax())
    if reach.min() > 0.45 * reach.max():
        return "both", float(reach.max())
    return ("left", "right")[greater], float(reach.max())


def stroke_times(hands: Array, sides: Iterable[int], fps: float, emphasis: float) -> tuple[float, float, float, float]:
    """Start, beat, end of hold and end in seconds, measured on the paths [T, 2, 3] of the hands. The beat is the last
    deceleration before `emphasis` + 0.12 s that has at least 35 % of the strongest one: `emphasis` is the arrival, and
    the strongest deceleration is often that of the preparation."""
    speed = np.sum([_speed(hands[:, side], fps)[1] for side in sides], axis=0)
    duration = (len(speed) - 1) / _FINE_FPS
    times, depths = arrivals(speed, _FINE_FPS)
    before = times <= emphasis + _AFTER_EMPHASIS
    if not before.any():
        raise ValueError("no deceleration before the emphasis")
    strong = before & (depths >= _BEAT_DEPTH * depths[before].max())
    beat = float(times[strong][-1])
    at = int(beat * _FINE_FPS)
    rising = np.flatnonzero(speed[:at + 1] < 0.08 * speed[:at + 1].max())
    start = float(rising[0] / _FINE_FPS) if len(rising) else 0.0
    fast = np.flatnonzero(speed[:at + 1] > 0.25 * speed[:at + 1].max())
    quiet = rising[rising < fast[0]] if len(fast) else rising
    if len(quiet):
        start = float(quiet[-1] / _FINE_FPS)
    away = np.sum([_distance_home(hands[:, side], fps) for side in sides], axis=0)
    hold_end, end = _retraction(speed, away, at)
    return min(start, beat - 0.1), beat, max(hold_end, beat + 0.08), min(max(end, beat + 0.3), duration)


def _distance_home(track: Array, fps: float) -> Array:
    path = _speed(track, fps)[0]
    return np.linalg.norm(path - path[-1], axis=-1)


def _retraction(speed: Array, away: Array, beat: int) -> tuple[float, float]:
    """Start and end of the retraction, seconds; away: [T] distance from the position at the end of the clip."""
    arrived = min(beat + int(0.1 * _FINE_FPS), len(speed) - 2)
    crossing = arrived + int(np.flatnonzero(away[arrived:] >= 0.55 * away[arrived])[-1])
    low, high = max(arrived, crossing - int(0.2 * _FINE_FPS)), crossing + int(0.2 * _FINE_FPS) + 1
    peak = low + int(np.argmax(speed[low:high]))
    slow = np.flatnonzero(speed[arrived:peak + 1] < 0.2 * speed[peak])
    hold_end = arrived + (int(slow[-1]) if len(slow) else int(np.argmin(speed[arrived:peak + 1])))
    still = np.flatnonzero(speed[peak:] < 0.1 * speed[peak])
    end = peak + (int(still[0]) if len(still) else len(speed) - 1 - peak)
    return hold_end / _FINE_FPS, end / _FINE_FPS


def arm_joints(skeleton: Skeleton) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Joint indices of the left and the right arm, shoulder first, in the same order on both sides."""
    left = [j for j, name in enumerate(skeleton.names) if name.startswith("Left")
            and not any(part in name for part in ("Leg", "Foot", "Toe"))]
    return tuple(left), tuple(skeleton.index("Right" + skeleton.names[j][4:]) for j in left)


def trunk_joints(skeleton: Skeleton) -> tuple[int, ...]:
    chain = [skeleton.index("Head")]
    while chain[-1] > 0:
        chain.append(skeleton.parents[chain[-1]])
    return tuple(reversed(chain))


def logs_against(rest: Array, rotations: Array, joints: tuple[int, ...]) -> Array:
    """Log rotations [T, joints, 3] of local rotations [T, J, 4] against a rest pose [J, 4], without jumps by 2 pi."""
    relative = rotation.multiply(rotation.conjugate(rest[list(joints)]), rotations[:, list(joints)])
    return rotation.unroll(rotation.to_exponential_map(relative))


def mirror(stroke: Stroke) -> Stroke:
    """The mirror image of a stroke: left and right are swapped, in its hand, its meaning and the name of its lexeme
    too."""
    other = {"left": "right", "right": "left", "both": "both", "none": "none"}
    lexeme = stroke.lexeme
    for a, b in (("Left", "Right"), ("Right", "Left")):
        if a in stroke.lexeme:
            lexeme = stroke.lexeme.replace(a, b)
    return replace(stroke, clip=stroke.base + "-mirrored", lexeme=lexeme, hand=other[stroke.hand],
                   meaning=mirrored(stroke.meaning), arms=stroke.arms[::-1] * MIRROR, trunk=stroke.trunk * MIRROR,
                   _splines={})


def home_pose(strokes: Iterable[Stroke], share: float = 0.9) -> Array:
    """[2, A, 3]: `share` of the way from rest to the mean pose in the holds of the strokes that each arm acts in. A
    stroke and its mirror image both count, so that an arm that rarely acts has a home pose too."""
    holds: dict[int, list[Array]] = defaultdict(list)
    for stroke in strokes:
        times = np.linspace(stroke.beat, stroke.hold_end, 5)
        for side in stroke.sides:
            holds[side].append(stroke.arm_at(side, times).mean(axis=0))
    joints = stroke.arms.shape[2]
    return share * np.stack([np.mean(holds[side], axis=0).reshape(joints, 3) for side in (LEFT, RIGHT)])


def held_out_keys(keys: Iterable[tuple[str, str]], share: float = HELD_OUT_SHARE) -> frozenset[tuple[str, str]]:
    """The held-out (person, clip) keys: of each person the `share` with the smallest hashes, so always the same."""
    people: dict[str, set[str]] = defaultdict(set)
    for person, clip in keys:
        people[person].add(clip)
    held_out: set[tuple[str, str]] = set()
    for person, clips in people.items():
        order = sorted(clips, key=lambda clip: hashlib.sha256(f"{person}/{clip}".encode()).hexdigest())
        held_out.update((person, clip) for clip in order[:round(share * len(order))])
    return frozenset(held_out)


def load_strokes(folder: str | Path) -> StrokeSet:
    """Read `manifest.csv` and the BVH clips beside it (metres) into strokes, each with its mirror image. InputError if
    the manifest or a clip is missing or broken."""
    rows = [row for row in read_clips(folder, _COLUMNS)
            if Path(row["file"]).stem not in _CLIPS["dropped"] and row["lexeme"] not in _CLIPS["no_stroke"]]
    strokes: list[Stroke] = []
    figures: dict[str, PerformerBody] = {}
    for speaker in sorted({row["speaker"] for row in rows}):
        figures[speaker], measured = speaker_strokes(Path(folder), speaker,
                                                     [row for row in rows if row["speaker"] == speaker])
        strokes += measured
    held_out = held_out_keys(map(_key, strokes))
    return StrokeSet(tuple(replace(s, held_out=_key(s) in held_out) for s in strokes), figures)


def _key(stroke: Stroke) -> tuple[str, str]:
    return _CLIPS["person"].get(stroke.speaker, stroke.speaker), stroke.base.removeprefix(stroke.speaker + "_")


def speaker_strokes(folder: Path, speaker: str, rows: list[dict[str, str]]) -> tuple[PerformerBody, list[Stroke]]:
    """The body of a speaker and the strokes of the clips (rows of the manifest), each with its mirror image."""
    motions = [read_bvh(folder / row["file"], unit=1.0) for row in rows]
    skeleton = motions[0].skeleton
    for row, motion in zip(rows, motions, strict=True):
        if not motion.skeleton.same_joints(skeleton):
            raise InputError(folder / row["file"], f"has other joints than {rows[0]['file']}",
                             "take the clips that came with the manifest")
    if speaker in _CLIPS["outward"]:
        motions = [replace(motion, rotations=_turned_in(skeleton, motion.rotations, _CLIPS["outward"][speaker]))
                   for motion in motions]
    if speaker in _CLIPS["rigid"]:
        share = _CLIPS["rigid"][speaker]
        motions = [replace(motion, rotations=with_rhythm(skeleton, motion.rotations, motion.fps, share))
                   for motion in motions]
    standing = [m for m, row in zip(motions, rows, strict=True) if row["posture"] == _CLIPS["posture"].get(speaker, "")]
    figure = standing_body(speaker, standing or motions)
    measured = [measured_stroke(figure, row, motion.rotations, motion.fps)
                for row, motion in zip(rows, motions, strict=True)]
    strokes = [one for stroke in measured if stroke is not None for one in (stroke, mirror(stroke))]
    if {side for stroke in strokes for side in stroke.sides} != {LEFT, RIGHT}:
        raise InputError(folder / rows[0]["file"], f"and the other clips of {shown(speaker)} move one arm alone",
                         "take the clips that came with the manifest")
    return replace(figure, home=home_pose(strokes)), strokes


def _turned_in(skeleton: Skeleton, rotations: Array, degrees: float) -> Array:
    """Local rotations [T, J, 4] with both upper arms turned inward about their length."""
    out = rotations.copy()
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        along = skeleton.offsets[skeleton.index(side + "ForeArm")]
        turn = rotation.from_exponential_map(sign * np.radians(degrees) * along / np.linalg.norm(along))
        joint = skeleton.index(side + "Arm")
        out[:, joint] = rotation.multiply(out[:, joint], turn)
    return out


def standing_body(speaker: str, motions: Sequence[Motion]) -> PerformerBody:
    """The body of a speaker, at rest as in the first frames of clips on one skeleton, without a home pose yet."""
    skeleton = motions[0].skeleton
    first = np.stack([m.rotations[0] for m in motions])
    signs = np.where(np.sum(first * first[:1], axis=-1, keepdims=True) < 0, -1.0, 1.0)
    rest = rotation.normalise(np.median(first * signs, axis=0))
    root = np.array([0.0, np.median([m.root_positions[0, 1] for m in motions]), 0.0])
    arms = arm_joints(skeleton)
    return PerformerBody(speaker, skeleton, rest, root, arms, trunk_joints(skeleton), np.zeros((2, len(arms[0]), 3)))


def measured_stroke(figure: PerformerBody, row: Mapping[str, str], rotations: Array, fps: float,
                    listed: tuple[float, float, float, float] | None = None) -> Stroke | None:
    """The stroke of one clip (its row of the manifest, and its rotations [T, J, 4]); None if no hand leaves its place.
    listed: its times, used where they cannot be measured."""
    positions = kinematics.joint_positions(figure.skeleton, rotations)
    hands = positions[:, [figure.skeleton.index(side + "Hand") for side in SIDES]]
    hand, reach = acting_hands(hands)
    if reach < _MIN_REACH:
        return None
    try:
        start, beat, hold_end, end = stroke_times(hands, ACTING_SIDES[hand], fps, float(row["emphasis"]))
    except ValueError:
        if listed is None:
            return None
        start, beat, hold_end, end = listed
    stem = Path(row["file"]).stem
    logs = np.stack([logs_against(figure.rest, rotations, joints) for joints in figure.arms])
    return Stroke(stem, stem, row["speaker"], row["lexeme"], hand, fps, logs,
                  logs_against(figure.rest, rotations, figure.trunk), start, beat, hold_end, end,
                  steady=stem in _CLIPS["not_faster"])
