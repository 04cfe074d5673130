"""The repertoire of named gestures: apex at the cue, phases, sizes, mirror images, no seam, poses of a body."""

import functools
from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from data_module.motion import rotation
from data_module.motion.kinematics import positions_of
from data_module.motion.skeletons import CHARACTERS, FINGERED, FINGERS
from data_module.types import Array, Motion
from gesticulator.body.clips import mirrored_motion
from gesticulator.cli import main
from gesticulator.contacts.columns import HEAD, TRUNK
from gesticulator.contacts.limbs import MARGIN, pose_of
from gesticulator.directing.gesture_scripts import SCRIPTS
from gesticulator.directing.hands import arm_turns, finger_turns, hand_rotation
from gesticulator.directing.named_gestures import drawn_gesture, laid_over, longest, span_of_gesture
from gesticulator.plan.gestures import ALIASES, GESTURES, REPERTOIRE, mark_of, near_gestures
from gesticulator.plan.plan import GestureCue

FPS, AT = 60.0, 2.0
NAMES = list(REPERTOIRE)
TEN = ("wave", "point left", "point right", "point ahead", "me", "stop", "shrug", "open palms", "nod", "shake head")
"""Names that plans used before the repertoire was there."""
INSULTS = {"ok ring", "shoo", "fingers crossed", "victory v", "zero ring", "purse hand", "tap temple", "crazy circle"}
"""What insults somewhere, or is feared to."""
_HANGING = {"RightArm": (0.16, 0.0, 1.18), "RightForeArm": (0.05, 0.5, 0.06), "LeftArm": (0.16, 0.0, -1.18),
            "LeftForeArm": (0.05, -0.5, -0.06), "Neck": (0.1, 0.0, 0.0)}


@functools.cache
def times() -> Array:
    return np.arange(round(6.0 * FPS)) / FPS


@functools.cache
def moving() -> Array:
    """[M, 3 J] a body whose lowered arms, head and trunk move all the time, a little, and never the same."""
    skeleton, t = FINGERED, times()
    poses = np.zeros((len(t), len(skeleton), 3))
    for name, turn in _HANGING.items():
        poses[:, skeleton.index(name)] = turn
    for number, name in enumerate(("Spine1", "Head", "RightArm", "LeftArm", "RightForeArm", "LeftForeArm")):
        wave = 0.06 * np.sin(2.0 * np.pi * (0.4 + 0.11 * number) * t + number)
        poses[:, skeleton.index(name), number % 3] += wave
    return poses.reshape(len(t), -1)


def motion_of(poses: Array) -> Motion:
    turns = rotation.from_exponential_map(poses.reshape(len(poses), -1, 3))
    return Motion(CHARACTERS[turns.shape[1]], turns, np.zeros((len(poses), 3)), FPS)


@functools.cache
def played(name: str, intensity: float = 1.0, mirror: bool = False, seed: int = 0) -> Motion:
    cue = GestureCue(name, time=AT, intensity=intensity, mirror=mirror)
    return motion_of(laid_over(moving(), times(), [(cue, AT)], seed))


def hands_of(name: str) -> list[str]:
    """The sides whose hands a draw moves."""
    script = drawn_gesture(GestureCue(name), AT, 0).script
    other = "Left" if script.side == "Right" else "Right"
    return [side for side, part in ((script.side, script.main), (other, script.other)) if part is not None]


def in_chest(motion: Motion, joint: str, origin: str) -> Array:
    """[M, 3] place of a joint from another one, in the frame of the chest."""
    pose = pose_of(motion)
    return np.einsum("tji,tj->ti", pose.turns["Spine3"], pose.places[joint] - pose.places[origin])


def speeds(places: Array) -> Array:
    return np.linalg.norm(np.gradient(places, 1.0 / FPS, axis=0), axis=-1)


def accelerations(places: Array) -> Array:
    return np.gradient(np.gradient(places, 1.0 / FPS, axis=0), 1.0 / FPS, axis=0)


# ------------------------------------------------------------------------------------------------------ the table

def test_the_table_is_that_of_the_scripts() -> None:
    assert set(SCRIPTS) == set(GESTURES) and set(GESTURES) >= set(TEN)
    assert len(REPERTOIRE) >= 60 and 38 <= sum(one.core for one in REPERTOIRE.values()) <= 46
    for name, gesture in REPERTOIRE.items():
        two = {script.other is not None for script in SCRIPTS[name]}
        hands = {(False,): "one", (True,): "two", (False, True): "one or two"}[tuple(sorted(two))]
        assert gesture.hands == ("head" if SCRIPTS[name][0].main is None else hands), name
        assert gesture.meaning.startswith("A speaker ") and gesture.meaning.endswith(".")
    assert {f"count {number}" for number in range(1, 6)} | {"size big", "size small"} <= set(ALIASES)


def test_what_insults_is_never_core() -> None:
    assert {name for name, one in REPERTOIRE.items() if one.offensive} == INSULTS
    assert not any(one.core and one.offensive for one in REPERTOIRE.values())
    assert not {"middle finger", "throat cut", "forearm jerk"} & set(GESTURES), "not even by an explicit cue"


def test_an_unknown_name_is_answered_with_the_nearest() -> None:
    assert near_gestures("shrugg").startswith("did you mean shrug?")
    assert "left hand up" in near_gestures("left hand upp", ["left hand up"])
    assert near_gestures("xyzzy").startswith("choose a name")


# ------------------------------------------------------------------------------------------------ apex and phases

@pytest.mark.parametrize("name", NAMES)
def test_the_apex_is_at_the_time_of_the_cue(name: str) -> None:
    """The wrist is where the script puts it, for which the joints of the finished motion are asked; without repeated
    movements it has come to rest there."""
    draw, motion, at = drawn_gesture(GestureCue(name), AT, 0), played(name), round(AT * FPS)
    for which, side in enumerate(hands_of(name)):
        part = draw.script.main if which == 0 else draw.script.other
        assert part is not None
        wrist = in_chest(motion, f"{side}Hand", f"{side}Arm")
        key = part.keys[1]
        along = np.array(key.fingers) / np.linalg.norm(key.fingers)
        wanted = (np.array(key.place) - part.point * along) * [1.0 if side == "Left" else -1.0, 1.0, 1.0]
        # Gestures that touch nothing are drawn a little elsewhere each time.
        assert np.linalg.norm(wrist[at] - wanted) < (0.02 if part.touches else 0.075), side
        reached = speeds(wrist)
        stroke = slice(at - round(longest(name).before * FPS), at)
        assert reached[at] < 0.22 * reached[stroke].max(), "the stroke has ended"


@pytest.mark.parametrize("name", NAMES)
def test_phases_follow_each_other_and_frames_beyond_them_stay(name: str) -> None:
    phases = longest(name)
    assert min(phases.preparation, phases.stroke, phases.hold, phases.retraction) > 0.05
    assert span_of_gesture(name) == pytest.approx((phases.preparation + phases.stroke, phases.hold + phases.retraction))
    assert 0.2 < sum(span_of_gesture(name)) < 3.6
    out = laid_over(moving(), times(), [(GestureCue(name), AT)])
    changed = np.flatnonzero((out != moving()).any(axis=1)) / FPS - AT
    assert -phases.before <= changed[0] < -0.6 * phases.before, "it is prepared before the cue"
    assert 0.6 * phases.after < changed[-1] <= phases.after


@pytest.mark.parametrize("name", NAMES)
def test_there_is_no_seam(name: str) -> None:
    """Where a gesture begins and ends, the hands and the head accelerate little more than in the motion around it, and
    nowhere as much as people cannot."""
    before, after = span_of_gesture(name)
    t, motion, plain = times(), played(name), motion_of(moving())
    near = (np.abs(t - AT + before) < 0.04) | (np.abs(t - AT - after) < 0.04)
    for joint in ("LeftHand", "RightHand", "Head"):
        moved, still = (accelerations(in_chest(one, joint, "Hips")) for one in (motion, plain))
        sizes = np.linalg.norm(moved, axis=-1)
        assert sizes[near].max() < np.linalg.norm(still, axis=-1).max() + 2.0, "it begins and ends gently"
        assert sizes.max() < 36.0, "no faster than people"
        jerks = np.linalg.norm(np.diff(moved, axis=0), axis=-1)
        if joint != "Head" and np.ptp(sizes) > 5.0:
            assert jerks[near[1:]].max() < 0.5 * jerks.max(), "a seam would be the worst of it"


@pytest.mark.parametrize("name", NAMES)
def test_poses_are_those_of_a_body(name: str) -> None:
    for intensity in (0.6, 1.5):
        motion = played(name, intensity)
        names, places = motion.skeleton.names, positions_of(motion)
        turns = rotation.to_exponential_map(motion.rotations)
        for side in hands_of(name):
            shoulder, elbow, wrist = (places[:, names.index(side + part)] for part in ("Arm", "ForeArm", "Hand"))
            upper, fore = elbow - shoulder, wrist - elbow
            cosine = np.sum(upper * fore, axis=-1) / np.linalg.norm(upper, axis=-1) / np.linalg.norm(fore, axis=-1)
            assert np.degrees(np.arccos(cosine)).max() < 150.0, "an elbow closes by 150 degrees at most"
            bend = np.linalg.norm(turns[:, names.index(side + "Hand"), 1:], axis=-1)
            assert np.degrees(bend).max() < 70.0, "a wrist"
            assert speeds(wrist).max() < 4.5
        assert min(gap.min() for gap in TRUNK.distances(pose_of(motion)).values()) > 0.0, "no hand in the trunk"


# -------------------------------------------------------------------------------------------------- size, variation

@pytest.mark.parametrize("name", NAMES)
def test_sizes_are_in_order(name: str) -> None:
    """The way of the hands (or of the head, if no hand moves) from the stroke to the end of the hold."""
    phases, ways = longest(name), []
    window = (times() > AT - phases.stroke) & (times() < AT + phases.hold)
    for intensity in (0.6, 1.0, 1.5):
        motion = played(name, intensity)
        tracks = [in_chest(motion, f"{side}HandMiddle1", f"{side}Arm") for side in hands_of(name)]
        tracks = tracks or [rotation.to_exponential_map(motion.rotations)[:, FINGERED.index("Head")]]
        ways.append(sum(float(np.linalg.norm(np.diff(track[window], axis=0), axis=-1).sum()) for track in tracks))
    assert ways[0] < ways[1] < ways[2]


@pytest.mark.parametrize("name", NAMES)
def test_a_mirrored_gesture_is_the_mirror_image(name: str) -> None:
    plain = mirrored_motion(motion_of(moving()))
    poses = rotation.to_exponential_map(plain.rotations).reshape(len(plain.rotations), -1)
    out = motion_of(laid_over(poses, times(), [(GestureCue(name, mirror=True), AT)]))
    np.testing.assert_allclose(positions_of(out), positions_of(mirrored_motion(played(name))), atol=1e-7)


@pytest.mark.parametrize("name", NAMES)
def test_no_gesture_is_made_twice_in_the_same_way_unless_it_is_asked_for(name: str) -> None:
    frames = np.repeat(moving()[:1], 2 * len(times()), axis=0)
    twice = laid_over(frames, np.arange(len(frames)) / FPS, [(GestureCue(name), AT), (GestureCue(name), AT + 6.0)])
    assert np.abs(twice[:len(times())] - twice[len(times()):]).max() > 0.002
    assert not np.allclose(played(name).rotations, played(name, seed=1).rotations, atol=1e-3)
    cue = GestureCue(name, time=AT)
    once = laid_over(moving(), times(), [(cue, AT)])
    np.testing.assert_array_equal(once, laid_over(moving(), times(), [(cue, AT)]))
    parts = [laid_over(moving()[at:at + 37], times()[at:at + 37], [(cue, AT)]) for at in range(0, len(times()), 37)]
    np.testing.assert_array_equal(once, np.concatenate(parts), err_msg="a stream gets the frames of a file")


def test_intensity_0_makes_no_gesture() -> None:
    np.testing.assert_allclose(played("wave", 0.0).rotations, motion_of(moving()).rotations, atol=1e-9)


# --------------------------------------------------------------------------------------------------------- hands

def straight_fingers(motion: Motion, side: str, frame: int) -> list[str]:
    """The fingers whose tip is as far from their knuckle as a straight finger's, and a thumb that is away from the
    knuckle of the forefinger."""
    places, skeleton = positions_of(motion)[frame], motion.skeleton
    turns = pose_of(motion).turns
    out = []
    for finger in FINGERS:
        joints = [skeleton.index(f"{side}Hand{finger}{place}") for place in (1, 2, 3)]
        tip = places[joints[2]] + turns[skeleton.names[joints[2]]][frame] @ skeleton.end_sites[joints[2]]
        bones = [skeleton.offsets[joints[1]], skeleton.offsets[joints[2]], skeleton.end_sites[joints[2]]]
        if finger == "Thumb":
            stands_out = np.linalg.norm(tip - places[skeleton.index(f"{side}HandIndex1")]) > 0.055
        else:
            stands_out = np.linalg.norm(tip - places[joints[0]]) > 0.9 * sum(float(np.linalg.norm(b)) for b in bones)
        if stands_out:
            out.append(finger)
    return out


@pytest.mark.parametrize(("name", "fingers"), [
    ("thumbs up", ["Thumb"]), ("fist resolve", []), ("point right", ["Index"]), ("victory v", ["Index", "Middle"]),
    ("phone hand", ["Thumb", "Pinky"]), ("count 5", list(FINGERS)),
    *((f"count {count}", list(FINGERS[1:count + 1])) for count in range(1, 5))])
def test_hands_have_the_shapes_of_their_signs(name: str, fingers: list[str]) -> None:
    assert straight_fingers(played(name), "Right", round(AT * FPS)) == fingers


@pytest.mark.parametrize(("shape", "nearest", "farthest"), [("pinch", 0.0, 0.022), ("ring", 0.0, 0.022),
                                                            ("gap", 0.022, 0.05)])
def test_a_pinch_closes_and_a_small_gap_stays_open(shape: str, nearest: float, farthest: float) -> None:
    turns = np.zeros((1, len(FINGERED), 3))
    for number, (finger, place) in enumerate((finger, place) for finger in FINGERS for place in (1, 2, 3)):
        turns[0, FINGERED.index(f"LeftHand{finger}{place}")] = finger_turns(shape)[number]
    pose, ends = pose_of(motion_of(turns.reshape(1, -1))), []
    for finger in ("Thumb", "Index"):
        name = f"LeftHand{finger}3"
        ends.append(pose.places[name][0] + pose.turns[name][0] @ FINGERED.end_sites[FINGERED.index(name)])
    assert nearest <= np.linalg.norm(ends[0] - ends[1]) < farthest


def test_inverse_kinematics_is_undone_by_forward_kinematics() -> None:
    random = np.random.default_rng(3)
    places = np.array([0.1, -0.15, 0.3]) + random.uniform(-0.06, 0.06, (50, 3))
    ahead = np.array([0.1, 0.1, 1.0]) + random.uniform(-0.2, 0.2, (50, 3))
    hand = hand_rotation(ahead, np.tile([-1.0, 0.0, 0.0], (50, 1)))
    arm, forearm, wrist = arm_turns(places, hand, random.uniform(-0.2, 0.6, 50))
    upper, fore = (Rotation.from_rotvec(turn) for turn in (arm, forearm))
    lengths = [FINGERED.offsets[FINGERED.index(f"Left{part}")] for part in ("ForeArm", "Hand")]
    np.testing.assert_allclose(upper.apply(lengths[0]) + (upper * fore).apply(lengths[1]), places, atol=1e-9)
    off = ((upper * fore * Rotation.from_rotvec(wrist)).inv() * Rotation.from_quat(hand, scalar_first=True)).magnitude()
    assert np.degrees(off.max()) < 6.0, "a wrist near its limit gives way"


# ---------------------------------------------------------------------------------------------------------- verb

def test_the_verb_lists_all_gestures(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["gestures"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.partition(":")[0].partition(" (or")[0] for line in lines] == NAMES
    assert mark_of("count 3") == "[count:3]" and mark_of("shrug") == "[shrug]"


# ------------------------------------------------------------------------------------------- head and speed

@functools.cache
def raised() -> Array:
    """[M, 3 J] the same body with both hands before the chest."""
    poses = moving().reshape(len(times()), -1, 3).copy()
    for name, turn in {"RightArm": (0.2, 0.8, 0.5), "RightForeArm": (0.1, 1.9, 0.3)}.items():
        for side, flip in (("Right", (1.0, 1.0, 1.0)), ("Left", (1.0, -1.0, -1.0))):
            joint = name.replace("Right", side)
            poses[:, FINGERED.index(joint)] += np.multiply(flip, turn) - _HANGING[joint]
    return poses.reshape(len(times()), -1)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("start", [moving, raised])
def test_no_hand_enters_the_head_or_is_thrown(name: str, start: Callable[[], Array]) -> None:
    """In all sizes, from hands that hang and from raised ones. People reach 2.5 m/s in the largest gestures."""
    head_is_touched = any(script.faces for script in SCRIPTS[name])
    for size in (0.6, 1.0, 1.5):
        motion = motion_of(laid_over(start(), times(), [(GestureCue(name, time=AT, intensity=size), AT)]))
        gaps = HEAD.distances(pose_of(motion))
        for side in hands_of(name):
            assert gaps[side].min() > (-0.012 if head_is_touched else MARGIN - 0.015)
            assert speeds(in_chest(motion, f"{side}Hand", "Spine3")).max() < 2.6
