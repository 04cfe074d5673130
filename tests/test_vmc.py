"""VMC: python-osc reads the pose back, and forward kinematics in Unity's axes put every bone where ours do."""

import asyncio
import socket
from contextlib import suppress
from dataclasses import dataclass, field
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import pytest
from live_double import TURN, served
from performances import RATE, example, turned
from pipecat_gesticulator import Hello, connect
from pythonosc.osc_bundle import OscBundle

from data_module.errors import InputError
from data_module.motion import kinematics
from data_module.motion.skeletons import FINGERED, standing
from data_module.types import Motion
from gesticulator import Gesticulator
from gesticulator.export.vrma import BONES
from gesticulator.live import vmc
from gesticulator.live.limits import ServerLimits
from gesticulator.stream import StreamFrames

# HumanBodyBones of Unity, each with the bone above it that a character of ours has.
_ABOVE = {"Hips": None, "Spine": "Hips", "Chest": "Spine", "Neck": "Chest", "Head": "Neck"}
for _side in ("Left", "Right"):
    _ABOVE |= {f"{_side}Shoulder": "Chest", f"{_side}UpperArm": f"{_side}Shoulder",
               f"{_side}LowerArm": f"{_side}UpperArm", f"{_side}Hand": f"{_side}LowerArm"}
    for _finger in ("Thumb", "Index", "Middle", "Ring", "Little"):
        _ABOVE |= {f"{_side}{_finger}Proximal": f"{_side}Hand",
                   f"{_side}{_finger}Intermediate": f"{_side}{_finger}Proximal",
                   f"{_side}{_finger}Distal": f"{_side}{_finger}Intermediate"}


@dataclass
class Received:
    """What one bundle said."""

    loaded: int = -1
    time: float = -1.0
    root: tuple[float, ...] = ()
    bones: dict[str, np.ndarray] = field(default_factory=dict)


def receive_all(packets: list[bytes]) -> Received:
    """A frame of several bundles."""
    out = Received()
    for packet in packets:
        assert len(packet) <= vmc.DATAGRAM
        one = receive(packet)
        assert not out.bones.keys() & one.bones.keys()
        out = Received(max(out.loaded, one.loaded), max(out.time, one.time), out.root or one.root,
                       {**out.bones, **one.bones})
    return out


def receive(packet: bytes) -> Received:
    """What python-osc reads in a bundle."""
    out = Received()
    for message in OscBundle(packet):
        values = message.params
        if message.address == "/VMC/Ext/OK":
            (out.loaded,) = values
        elif message.address == "/VMC/Ext/T":
            (out.time,) = values
        elif message.address == "/VMC/Ext/Root/Pos":
            assert values[0] == "root"
            out.root = tuple(values[1:])
        else:
            assert message.address == "/VMC/Ext/Bone/Pos" and values[0] not in out.bones
            out.bones[values[0]] = np.array(values[1:])
    return out


def unity_places(bones: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Where a receiver's bones are, in its own left-handed axes: each by matrices of what was sent."""
    worlds: dict[str, np.ndarray] = {}
    for name, above in _ABOVE.items():
        x, y, z, w = bones[name][3:]
        local = np.eye(4)
        local[:3, :3] = [[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                         [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                         [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]]
        local[:3, 3] = bones[name][:3]
        worlds[name] = local if above is None else worlds[above] @ local
    return {name: world[:3, 3] for name, world in worlds.items()}


@pytest.fixture(scope="module")
def motion(system: Gesticulator) -> Motion:
    """Two seconds of a stream of ours."""
    return standing(system.stream(sample_rate=RATE, fps=25).feed(example(6.0).samples).motion()).crop(50, 100)


def frames_of(motion: Motion, first: int = 0) -> StreamFrames:
    return StreamFrames(first, motion.fps, motion.skeleton, motion.rotations, motion.root_positions)


def test_a_receiver_reads_the_pose_back(motion: Motion) -> None:
    made = vmc.VmcFrames(motion)
    got = receive_all(made.bundles(25, 1.5))
    assert (got.loaded, got.time, got.root) == (1, 1.5, (0, 0, 0, 0, 0, 0, 1))
    assert set(got.bones) == set(_ABOVE)
    ours = kinematics.positions_of(motion)[25]
    joints = {vmc.unity_bone(bone): row[2] for bone, row in BONES.items()}
    truth = {name: ours[motion.skeleton.index(joints[name])] * [-1, 1, 1] for name in _ABOVE}
    places = unity_places(got.bones)
    for name, place in places.items():
        # Our four joints of the spine and two of the neck are three bones of the humanoid: what hangs on them lies
        # a little aside, and from there on nothing is lost.
        side = "Left" if name.startswith("Left") else "Right"
        origin = "Hips" if name in ("Spine", "Chest", "Neck", "Head", "Hips") else f"{side}Shoulder"
        loose = 0.06 if name in ("Chest", "Neck", "Head") else 1e-5
        assert np.linalg.norm((place - places[origin]) - (truth[name] - truth[origin])) < loose, name
        assert np.linalg.norm(place - truth[name]) < 0.1


def test_a_raised_left_hand_is_the_left_hand_of_the_receiver() -> None:
    """Unity's Y is up, the character faces +Z, and its left is -X. The left arm is 0.53 m long."""
    for axis, way in ((0, (-0.53, 0, 0)), (2, (0, 0.53, 0)), (1, (0, 0, 0.53))):  # at rest, raised, pointing ahead
        turn = np.eye(3)[axis] * [0, -1, 1] * np.pi / 2
        pose = vmc.VmcFrames(standing(turned(FINGERED, 1, LeftArm=turn)))
        places = unity_places(receive_all(pose.bundles(0, 0.0)).bones)
        np.testing.assert_allclose(places["LeftHand"] - places["LeftUpperArm"], way, atol=1e-6)
        np.testing.assert_allclose(places["RightHand"] - places["RightUpperArm"], (0.53, 0, 0), atol=1e-6)


def test_frames_are_sent_when_they_are_due(motion: Motion, monkeypatch: pytest.MonkeyPatch) -> None:
    """Frames that come at once are played in their time, each once, by a clock that passes only in the output's waits,
    each a millisecond longer than it should be."""
    clock = SimpleNamespace(now=100.0, end=100.01)

    async def sleep(seconds: float) -> None:
        clock.now += seconds + 0.001
        if clock.now >= clock.end:
            raise asyncio.CancelledError

    def play_until(end: float) -> None:
        clock.end = end
        with suppress(asyncio.CancelledError):
            asyncio.run(output.play())

    monkeypatch.setattr(vmc, "time", SimpleNamespace(monotonic=lambda: clock.now))
    monkeypatch.setattr(vmc, "asyncio", SimpleNamespace(sleep=sleep))
    output = vmc.VmcOutput("127.0.0.1:39539")
    sent: list[tuple[float, bytes]] = []
    output._socket.close()
    output._socket = MagicMock()
    output._socket.sendto = lambda data, address: sent.append((clock.now, data))
    play_until(100.01)
    assert len(sent) == 1 and receive(sent[0][1]).loaded == 0, "no model before there are poses"
    output.take("a", frames_of(motion))
    output.take("another", frames_of(motion))  # the output is taken
    begin = clock.now
    play_until(101.6)
    moments = sorted({at for at, _ in sent[1:]})
    played = [(at - begin, receive_all([data for when, data in sent[1:] if when == at])) for at in moments]
    truth = vmc.VmcFrames(motion)
    hands = np.array([receive_all(truth.bundles(k, 0.0)).bones["RightLowerArm"] for k in range(len(motion))])
    frames = [int(np.abs(hands - one.bones["RightLowerArm"]).sum(1).argmin()) for _, one in played]
    assert frames == list(range(len(frames))) and abs(len(frames) - 1.6 * motion.fps) <= 2, "each of them once"
    late = np.array([at for at, _ in played]) - np.array(frames) / motion.fps
    assert (late >= 0.0).all() and (late < 0.0015).all()


def test_a_stream_on_the_server_is_sent_as_it_plays() -> None:
    """Sound that a synthesiser delivers at once: frame k comes k / fps seconds after the first."""
    receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    receiver.bind(("127.0.0.1", 0))
    receiver.settimeout(5)

    async def talk(port: int) -> None:
        async with connect(f"ws://127.0.0.1:{port}/stream", Hello(16000, fps=30)) as stream:
            await stream.send(bytes(2 * 16000 * 3))
            await stream.finish()
            assert [message async for message in stream]

    got: list[tuple[float, Received]] = []
    with served(ServerLimits(), {}, f"127.0.0.1:{receiver.getsockname()[1]}") as (_, port):
        asyncio.run(talk(port))
        while len(got) < 60:
            one = receive(receiver.recv(65536))
            if one.loaded == 1 and one.bones:  # the first bundle of a frame, with the hips
                got.append((one.time, one))
    receiver.close()
    times = np.array([at for at, _ in got])
    # The double turns the hips by TURN a frame; mirrored in X, a turn about Y goes the other way.
    frames = np.array([-2 * np.arctan2(one.bones["Hips"][4], one.bones["Hips"][6]) / TURN for _, one in got])
    np.testing.assert_allclose(frames, np.round(frames), atol=0.01)
    frames = np.round(frames)
    assert (np.diff(frames) >= 0).all() and frames[-1] - frames[0] > 45
    # Never ahead of its time, however late a busy machine is; a frame is sent up to a frame's time after it is due.
    assert times[-1] - times[0] > (frames[-1] - frames[0] - 1) / 30


def test_an_interruption_replaces_what_was_not_played(motion: Motion) -> None:
    output = vmc.VmcOutput("127.0.0.1:39539")
    output.take("a", frames_of(motion))
    turned = Motion(motion.skeleton, motion.rotations[::-1].copy(), motion.root_positions, motion.fps)
    output.take("a", frames_of(turned, first=10))
    zero = output._zero
    at_five, at_twelve = (output.due(zero + (frame + 0.5) / motion.fps) for frame in (5, 12))
    assert at_five is not None and at_twelve is not None
    for got, truth, frame in ((at_five, motion, 5), (at_twelve, turned, 2)):
        expected = receive_all(vmc.VmcFrames(truth).bundles(frame, 0)).bones
        np.testing.assert_array_equal(receive_all(got).bones["LeftHand"], expected["LeftHand"])
    output._socket.close()


@pytest.mark.parametrize("target", ["nonsense", "host:", ":39539", "host:0", "host:99999", "host:-1", "host:\u00b2",
                                    "host:" + "9" * 5000])
def test_a_target_that_is_none_is_told_of(target: str) -> None:
    with pytest.raises(InputError, match="HOST:PORT"):
        vmc.read_target(target)
