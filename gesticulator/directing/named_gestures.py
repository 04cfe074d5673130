"""Named gestures, such as a wave, a shrug or a nod: scripts that are blended over the generated motion.

The lexicon has movements without meanings; no lexeme is a wave. So each gesture of the repertoire
(`gesticulator.plan.gestures`) is a script of key poses (`gesticulator.directing.gesture_scripts`), which inverse
kinematics turns into poses of arms and fingers. The hand is prepared before its stroke and waits in a hold after it, in
which repeated movements take place; then it is retracted. The apex, the end of the stroke, is at the cue's time;
seconds are relative to it. An envelope blends the poses in and out along the shortest rotation, so that there is no
jump, and hands that would pass through the trunk are led around it.
"""

import functools
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from data_module.motion import rotation
from data_module.motion.skeletons import CHARACTERS, FINGERS, SIDES
from data_module.types import Array, Motion
from gesticulator.body.clips import exchanged_joints
from gesticulator.body.life import eased
from gesticulator.contacts.columns import HEAD, TRUNK
from gesticulator.contacts.limbs import MARGIN, pose_of
from gesticulator.directing.gesture_scripts import SCRIPTS, GestureScript, HandPart, Repeat
from gesticulator.directing.hands import BONE, arm_turns, best_swing, finger_turns, hand_rotation
from gesticulator.plan.plan import GestureCue

_HOME = np.array([0.03, -0.28, 0.26])
"""Where a hand is when it rests in front of the body, metres from its shoulder: larger gestures go further from it."""
_FADE = 0.18
"""Seconds in which a repeated movement begins and ends."""
_SINKS = np.array([0.0, -0.012, -0.006])
"""Way of a free hand during its hold, metres."""
_OVERLAP = 0.22
"""Seconds of a stroke in which its preparation still ends, at most."""
_SHORTER = 0.85
"""Least factor on the seconds of a phase: phases vary from here to 1, so that no gesture is longer than it says."""
_HANGING = np.array([0.16, -0.48, 0.07])
"""Where the wrist of a hanging hand is, metres from its shoulder."""
_FASTEST = 1.9
"""Metres a second at which a hand would be led along a straight way; it goes in an arc, and reaches 2.6 at most."""
_LARGEST = 1.6
"""Largest intensity of a gesture; its ways must be possible there, too."""
_PEAK, _GENTLE_PEAK = 1.875, 2.1875
"""Greatest speed of `eased` and of `_gentle`, in relation to the mean one."""
_STRAYS, _TURNS = 0.014, np.radians(5.0)
"""Standard deviation of a hand's place, metres, and of its direction, radians, from one time to the next."""
_FLIP = np.array([1.0, -1.0, -1.0])
"""A reflection keeps the x component of an exponential map and negates y and z."""
_ARM = ("Arm", "ForeArm", "Hand")
_HEAD = ("Neck", "Neck1", "Head")
_TOUCH = 0.012
"""Metres from the trunk at which a hand that lies on it stays."""
_WHOLE = 0.5
"""Intensity from which on a gesture is made whole; below, it is blended in by so much less, and not at all at 0."""


class Phases(NamedTuple):
    """Seconds of a gesture's phases. The apex is at the end of the stroke."""

    preparation: float
    stroke: float
    hold: float
    retraction: float

    @property
    def before(self) -> float:
        """Seconds from the start to the apex."""
        return self.preparation + self.stroke

    @property
    def after(self) -> float:
        """Seconds from the apex to the end."""
        return self.hold + self.retraction

    def weight(self, seconds: Array) -> Array:
        """[M] share of the gesture in the motion at seconds [M]. It becomes whole during the stroke, so that the hand
        does not stop between preparation and stroke."""
        rises = _gentle((seconds + self.before) / (self.preparation + min(0.9 * self.stroke, _OVERLAP)))
        falls: Array = rises * _gentle((self.after - seconds) / self.retraction)
        return falls


@dataclass(frozen=True)
class GestureDraw:
    """How a gesture is made this time. size: 1 for intensity 1; place: [2, 3] metres and turn: [2, 3] radians added to
    the main and the other hand; pace: factor on repeated movements' rate; turns: factor on head and trunk."""

    script: GestureScript
    phases: Phases
    size: float
    place: Array
    turn: Array
    pace: float
    turns: float


@functools.cache
def longest(name: str) -> Phases:
    """The longest phases of a gesture; what is drawn is at most so long."""
    rows = [_at_least(script, (1.0, 1.0, 1.0), _hold(script)) for script in SCRIPTS[name]]
    return Phases(*map(max, zip(*rows, strict=True)))


def _hold(script: GestureScript) -> float:
    # Seconds of a script's hold: its keys and repeated movements take place in it.
    ends = [part.repeat.count / part.repeat.rate for part in script.hands if part.repeat is not None]
    return max([script.hold, *ends, *(part.keys[-1].time + 0.1 for part in script.hands)])


def _at_least(script: GestureScript, shares: Sequence[float], hold: float) -> Phases:
    """The phases of a script, preparation, stroke and retraction at a share of their seconds, but not shorter than the
    ways of its hands take, in its largest size and from hands that hang, at `_FASTEST`."""
    up, across, down = (max(ways, default=0.0) / _FASTEST for ways in zip(
        *map(_ways, script.hands), strict=True)) if script.hands else (0.0, 0.0, 0.0)
    preparation = max(_GENTLE_PEAK * up - min(0.9 * script.stroke, _OVERLAP), 0.0)
    return Phases(max(script.preparation * shares[0], preparation), max(script.stroke * shares[1], _PEAK * across),
                  hold, max(script.retraction * shares[2], _GENTLE_PEAK * down))


@functools.cache
def _ways(part: HandPart) -> tuple[float, float, float]:
    """Metres of the wrist's way, in the largest size: from where it hangs to its stroke, of the stroke, and back."""
    wrists = _points(part, _LARGEST) - part.point * rotation.rotate(_directions(part), BONE)
    up, across, down = (float(np.linalg.norm(way)) for way in (
        wrists[0] - _HANGING, wrists[1] - wrists[0], wrists[-1] - _HANGING))
    return up, across, down


def drawn_gesture(cue: GestureCue, at: float, seed: int) -> GestureDraw:
    """How the gesture of a cue is made at a time, seconds. The same cue, time and seed give the same gesture."""
    takes = SCRIPTS[cue.gesture]
    # The order of the draws is part of the result: plans replay gestures from their seed.
    random = np.random.default_rng([zlib.crc32(cue.gesture.encode()), round(at * 1000.0), seed])
    script = takes[int(random.integers(len(takes)))]
    preparation, stroke, _, retraction = random.uniform(_SHORTER, 1.0, 4).tolist()
    size = float(np.clip(cue.intensity, 0.5, _LARGEST)) * random.uniform(0.94, 1.06)
    place, turn = random.normal(0.0, _STRAYS, (2, 3)), random.normal(0.0, _TURNS, (2, 3))
    pace, turns = random.uniform(1.0, 1.12), random.uniform(0.85, 1.15) * (0.45 + 0.55 * size)
    # Two standard deviations at most: a hand that strays further would be another gesture.
    place, turn = np.clip(place, -2 * _STRAYS, 2 * _STRAYS), np.clip(turn, -2 * _TURNS, 2 * _TURNS)
    phases = _at_least(script, (preparation, stroke, retraction), max(_hold(script) / pace, 0.2))
    return GestureDraw(script, phases, size, place, turn, pace, turns)


def _gentle(s: Array) -> Array:
    """A step like `eased` whose change of acceleration begins and ends at zero, too, so that the seam is invisible."""
    u: Array = np.clip(s, 0.0, 1.0)
    return u ** 4 * (35.0 - u * (84.0 - u * (70.0 - 20.0 * u)))


# ---------------------------------------------------------------------------------------------------- a hand

def hand_turns(draw: GestureDraw, which: int, seconds: Array) -> tuple[Array, Array]:
    """[M, 3, 3] exponential maps of upper arm, forearm and hand, and [M, 15, 3] of the finger joints, of a left hand.
    which: 0 for the main hand, 1 for the other; seconds: [M] from the apex."""
    part = draw.script.main if which == 0 else draw.script.other
    assert part is not None
    # Keys before the apex are shares of the stroke; those after it run at the pace of repeated movements.
    times = np.array([key.time * (draw.phases.stroke if key.time < 0 else 1.0 / draw.pace) for key in part.keys])
    begin = np.clip(np.searchsorted(times, seconds, side="right") - 1, 0, len(times) - 2)
    end = begin + 1
    share = eased((seconds - times[begin]) / (times[end] - times[begin]))

    def mixed(values: Array) -> Array:
        between: Array = values[begin] + share.reshape(-1, *[1] * (values.ndim - 1)) * (values[end] - values[begin])
        return between

    hands = _directions(part)
    turned = rotation.partway(hands[begin], hands[end], share[:, None])
    places = mixed(_points(part, draw.size))
    fingers = mixed(np.array([finger_turns(key.shape) for key in part.keys]))
    if part.repeat is not None:
        places, turned, fingers = _repeated(part.repeat, draw, seconds, (places, turned, fingers))
    if not part.touches:
        places = places + draw.place[which]
        turned = rotation.multiply(rotation.from_exponential_map(draw.turn[which]), turned)
        # A hand that is held up sinks a little: people do not hold it still.
        places = places + eased(seconds / draw.phases.hold)[:, None] * (_SINKS - 0.5 * draw.place[which])
    # A key fixes the point of the hand that the script names (palm, tips); the arm is solved for the wrist.
    wrists = places - part.point * rotation.rotate(turned, BONE)
    return np.stack(arm_turns(wrists, turned, mixed(_swings(part))), axis=1), fingers


@functools.cache
def _directions(part: HandPart) -> Array:
    """[K, 4] the rotations of a hand at its keys."""
    return np.stack([hand_rotation(np.array(key.fingers), np.array(key.palm)) for key in part.keys])


@functools.cache
def _swings(part: HandPart) -> Array:
    """[K] swings of the elbow at the keys, radians."""
    hands = _directions(part)
    wrists = np.array([key.place for key in part.keys]) - part.point * rotation.rotate(hands, BONE)
    return np.array([best_swing(wrist, hand, float(np.radians(part.lift)))
                     for wrist, hand in zip(wrists, hands, strict=True)])


def _points(part: HandPart, size: float) -> Array:
    """[K, 3] places of the keys in a size."""
    apex = np.array(part.keys[1].place)
    scaled = apex if part.touches else _HOME + (apex - _HOME) * (0.7 + 0.3 * size)
    return np.array([scaled + (np.array(key.place) - apex) * (0.5 + 0.5 * size) for key in part.keys])


def _repeated(repeat: Repeat, draw: GestureDraw, seconds: Array,
              pose: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
    """Places [M, 3], rotations [M, 4] and fingers [M, 15, 3] with a repeated movement."""
    places, turned, fingers = pose
    rate = repeat.rate * draw.pace
    end = repeat.count / rate
    # Both ends fade, and the circle starts at the apex: there is no step in place or speed.
    level = eased(seconds / _FADE) * eased((end - seconds) / _FADE)
    angle = 2.0 * np.pi * (rate * seconds + repeat.phase)
    size = level * (0.4 + 0.6 * draw.size)
    sine, cosine = (size * np.sin(angle))[:, None], (size * (1.0 - np.cos(angle)) / 2.0)[:, None]
    places = places + sine * np.array(repeat.way) + cosine * np.array(repeat.circle)
    turned = rotation.multiply(rotation.from_exponential_map(sine * np.radians(repeat.tilt)), turned)
    turned = rotation.multiply(turned, rotation.from_exponential_map(sine * np.radians([repeat.roll, 0.0, 0.0])))
    if repeat.shape:
        share = (level * (1.0 - np.cos(angle)) / 2.0)[:, None, None]
        fingers = fingers + share * (finger_turns(repeat.shape) - fingers)
    return places, turned, fingers


# ------------------------------------------------------------------------------------------------------- the body

def span_of_gesture(name: str) -> tuple[float, float]:
    """Seconds from the start of a gesture to its apex, and from its apex to its end, at most."""
    phases = longest(name)
    return phases.before, phases.after


def laid_over(poses: Array, times: Array, cues: Sequence[tuple[GestureCue, float]], seed: int = 0) -> Array:
    """Poses [M, 3 J] (exponential maps, radians) at seconds [M], with each gesture blended in at its time; all other
    poses stay the same bit for bit. seed: with another one, each gesture varies in another way."""
    # One after the other: a gesture that begins while another ends is blended over what that one left.
    out = poses.copy()
    for cue, at in cues:
        before, after = span_of_gesture(cue.gesture)
        near = np.flatnonzero((times > at - before) & (times < at + after))
        if len(near):
            out[near] = _with_gesture(out[near], times[near] - at, cue, drawn_gesture(cue, at, seed))
    return out


def _with_gesture(poses: Array, seconds: Array, cue: GestureCue, draw: GestureDraw) -> Array:
    """Poses [M, 3 J] with one gesture blended in; seconds: [M] relative to its apex."""
    weight = min(cue.intensity / _WHOLE, 1.0) * draw.phases.weight(seconds)
    script, flipped = draw.script, (draw.script.side == "Left") != cue.mirror
    names = CHARACTERS[poses.shape[1] // 3].names
    swapped = exchanged_joints(names)
    vectors = poses.reshape(len(poses), -1, 3).copy()
    targets = _targets(draw, seconds)
    # Scripts are right-handed: a flipped gesture goes to the joints of the other side, as its mirror image.
    for name, turns in (_added(draw, seconds, weight) | targets).items():
        if name in names:
            joint, turns = names.index(name), turns * _FLIP if flipped else turns
            joint = int(swapped[joint]) if flipped else joint
            vectors[:, joint] = _blended(vectors[:, joint], turns, weight) if name in targets \
                else vectors[:, joint] + turns
    moved = [side for side, part in zip(SIDES if flipped else SIDES[::-1], (script.main, script.other), strict=True)
             if part is not None]
    return _led_around(vectors.reshape(poses.shape), poses, weight, moved, script)


def _targets(draw: GestureDraw, seconds: Array) -> dict[str, Array]:
    """Joint -> [M, 3] exponential maps that a right-handed gesture leads to: arms, fingers, a head that is touched."""
    def held(name: str, factor: float) -> Array:
        return np.repeat(factor * np.radians(script.adds.get(name, (0.0, 0.0, 0.0)))[None], len(seconds), axis=0)

    out: dict[str, Array] = {}
    script = draw.script
    for which, (side, part) in enumerate((("Right", script.main), ("Left", script.other))):
        if part is None:
            continue
        arm, fingers = hand_turns(draw, which, seconds)
        if side == "Right":
            arm, fingers = arm * _FLIP, fingers * _FLIP
        out[side + "Shoulder"] = shoulder = held(side + "Shoulder", draw.turns)
        # The hand is placed in the frame of the chest, whatever the shoulder does.
        arm[:, 0] = rotation.to_exponential_map(rotation.multiply(
            rotation.from_exponential_map(-shoulder), rotation.from_exponential_map(arm[:, 0])))
        out |= {side + name: arm[:, at] for at, name in enumerate(_ARM)}
        out |= {f"{side}Hand{finger}{place + 1}": fingers[:, 3 * at + place]
                for at, finger in enumerate(FINGERS) for place in range(3)}
    return out | ({name: held(name, 1.0) for name in _HEAD} if script.faces else {})


def _added(draw: GestureDraw, seconds: Array, weight: Array) -> dict[str, Array]:
    """Joint -> [M, 3] what is added to its exponential maps."""
    script = draw.script
    # At its far end at the apex, whatever the rate.
    wave = weight * np.cos(2.0 * np.pi * script.rate * draw.pace * seconds)
    out: dict[str, Array] = {}
    for turns, level in ((script.adds, weight), (script.nods, wave)):
        for name, degrees in turns.items():
            out[name] = out.get(name, np.zeros((len(seconds), 3))) + draw.turns * level[:, None] * np.radians(degrees)
    return out


def _blended(now: Array, target: Array, share: Array) -> Array:
    """[M, 3] rotations a share [M] of the way from `now` to `target`, as the exponential maps nearest to `now`."""
    mixed = rotation.partway(rotation.from_exponential_map(now), rotation.from_exponential_map(target), share[:, None])
    return nearest_turn(rotation.to_exponential_map(mixed), now)


def nearest_turn(vectors: Array, reference: Array) -> Array:
    """Exponential maps [..., 3] of the same rotations that are nearest to a reference [..., 3], by full turns."""
    return rotation.unroll(np.stack([reference, vectors]))[1]


def _led_around(poses: Array, before: Array, weight: Array, moved: Sequence[str], script: GestureScript
                ) -> Array:
    """Poses [M, 3 J] with the hands of the sides `moved` kept as far from trunk and head as in the poses `before`, and
    in a gesture at `MARGIN`, or on the body if it touches it. Where nothing has to move, nothing changes."""
    if not moved:
        return poses
    freed, first = _motion_of(poses), pose_of(_motion_of(before))
    rotations, touches = freed.rotations, any(part.touches for part in script.hands)
    for part, gap in ((TRUNK, _TOUCH if touches else MARGIN), (HEAD, 0.0 if script.faces else MARGIN)):
        now = part.distances(first)
        freed = part.kept_out(freed, {side: (1.0 - weight) * np.minimum(now[side], MARGIN) + weight * gap
                                      if side in moved else np.full(len(poses), -np.inf) for side in SIDES})
    # Joints that did not have to move keep their bits: exponential maps of the same rotation may differ.
    changed = (freed.rotations != rotations).any(axis=-1, keepdims=True)
    reference = poses.reshape(len(poses), -1, 3)
    turned = nearest_turn(rotation.to_exponential_map(freed.rotations), reference)
    out: Array = np.where(changed, turned, reference).reshape(poses.shape)
    return out


def _motion_of(poses: Array) -> Motion:
    rotations = rotation.from_exponential_map(poses.reshape(len(poses), -1, 3))
    return Motion(CHARACTERS[rotations.shape[1]], rotations, np.zeros((len(poses), 3)), 60.0)
