"""Live Link: packets read by the rules of the receiver's source, and forward kinematics in Unreal's axes."""

from __future__ import annotations

import json
import socket
import threading
import time
import wave
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pipecat_gesticulator import Joint, Poses, Welcome, live_link
from pipecat_gesticulator.live_link import LiveLink
from streamed import places_of

ROWS = (("Hips", -1, (0, 0, 0)), ("Head", 0, (0, 0.6, 0.02)), ("LeftArm", 0, (0.18, 0.5, 0)),
        ("LeftHand", 2, (0.5, 0, 0)), ("RightArm", 0, (-0.18, 0.5, 0)), ("RightHand", 4, (-0.5, 0, 0)))
WELCOME = Welcome("", 60.0, "joints", 1.0, tuple(Joint(*row) for row in ROWS), {})


def refuse(value: str) -> None:
    raise ValueError(value)


def read_packet(packet: bytes) -> dict[str, list[dict[str, Any]]]:
    """What JSONLiveLinkSource.cpp takes: it makes a character of each byte, and lets go of a frame that lacks anything.
    macOS sends no datagram above 9,216 bytes."""
    assert len(packet) <= 9216
    subjects = json.loads("".join(map(chr, packet)), parse_constant=refuse)
    for bones in subjects.values():
        for place, bone in enumerate(bones):
            assert isinstance(bone["Name"], str) and isinstance(bone["Parent"], int) and -1 <= bone["Parent"] < place
            assert [len(bone[key]) for key in ("Location", "Rotation")] == [3, 4] and bone["Scale"] == [1, 1, 1]
        assert len({bone["Name"] for bone in bones}) == len(bones)
    return subjects


def unreal_places(bones: list[dict[str, Any]]) -> dict[str, np.ndarray]:
    """Where the bones of the receiver are, centimetres: an FTransform is turned and moved by its parent's."""
    turns, places = [], []
    for bone in bones:
        x, y, z, w = bone["Rotation"]
        turn = np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                         [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                         [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])
        above = bone["Parent"]
        places.append(np.array(bone["Location"]) if above < 0 else places[above] + turns[above] @ bone["Location"])
        turns.append(turn if above < 0 else turns[above] @ turn)
    return {bone["Name"]: place for bone, place in zip(bones, places, strict=True)}


def test_a_raised_left_hand_is_the_left_hand_of_the_receiver() -> None:
    turns = np.tile([1.0, 0, 0, 0], (len(ROWS), 1)).astype(np.float32)
    rest = unreal_places(read_packet(LiveLink(WELCOME).packet(turns, np.array([0, 0.9, 0])))["gesticulator"])
    assert rest["Head"] == pytest.approx([0, 2, 150]), "it faces +Y, and Z is up"
    assert rest["LeftHand"] == pytest.approx([68, 0, 140]) and rest["RightHand"] == pytest.approx([-68, 0, 140])
    turns[2] = [np.cos(np.pi / 4), 0, 0, np.sin(np.pi / 4)]  # a quarter about +Z: the arm points up
    raised = unreal_places(read_packet(LiveLink(WELCOME).packet(turns, np.array([0, 0.9, 0])))["gesticulator"])
    assert raised["LeftHand"] == pytest.approx([18, 0, 190], abs=1e-2)
    turns[2] = [np.cos(np.pi / 4), 0, -np.sin(np.pi / 4), 0]  # a quarter about -Y: it points ahead
    ahead = unreal_places(read_packet(LiveLink(WELCOME).packet(turns, np.array([0, 0.9, 0])))["gesticulator"])
    assert ahead["LeftHand"] == pytest.approx([18, 50, 140], abs=1e-2)
    assert ahead["RightHand"] == pytest.approx(rest["RightHand"])


def test_a_stream_is_played_to_a_receiver_in_time(url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each frame that comes has its bones where the poses have them; frames come in their order and in real time."""
    seconds = np.arange(3 * 16000) / 16000
    voice = 9000 * np.sin(2 * np.pi * 150 * seconds) * np.sin(2 * np.pi * 2 * seconds) ** 2
    with wave.open(str(tmp_path / "voice.wav"), "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(16000)
        file.writeframes(voice.astype("<i2").tobytes())
    receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    receiver.bind(("127.0.0.1", 0))
    receiver.settimeout(120)
    packets: list[bytes] = []
    thread = threading.Thread(target=lambda: packets.extend(iter(lambda: receiver.recv(65536), b"end")))
    thread.start()
    recorded: list[Poses] = []
    sent: list[tuple[float, Welcome, np.ndarray, np.ndarray]] = []

    class Recording(live_link.PosePlayer):
        def add(self, poses: Poses) -> None:
            recorded.append(poses)
            super().add(poses)

    class Link(LiveLink):
        def __init__(self, welcome: Welcome, *arguments: Any) -> None:
            self.welcome = welcome
            super().__init__(welcome, *arguments)

        def send(self, rotations: np.ndarray, root_position: np.ndarray) -> None:
            sent.append((time.monotonic(), self.welcome, rotations, root_position))
            super().send(rotations, root_position)

    monkeypatch.setattr(live_link, "PosePlayer", Recording)
    monkeypatch.setattr(live_link, "LiveLink", Link)
    host, port = receiver.getsockname()
    live_link.main([str(tmp_path / "voice.wav"), "--to", f"{host}:{port}", "--gestures", url])
    receiver.sendto(b"end", (host, port))
    thread.join(10)
    receiver.close()
    assert len(packets) == len(sent) > 30
    stream = np.concatenate([poses.rotations for poses in recorded])
    assert len(stream) == 180
    frames = [int(np.abs(stream - turns).sum((1, 2)).argmin()) for _, _, turns, _ in sent]
    assert (np.diff(frames) >= 0).all() and frames[-1] > 150, "in their order, to the end"
    assert sent[-1][0] - sent[0][0] > 2.5
    for packet, (_, welcome, turns, root) in list(zip(packets, sent, strict=True))[::9]:
        places = unreal_places(read_packet(packet)["gesticulator"])
        assert {"LeftHandPinky3", "RightFoot", "Head"} <= places.keys()
        ours = places_of(welcome.joints, turns[None].astype(np.float64), root[None])[0]
        for joint, place in zip(welcome.joints, ours, strict=True):
            assert places[joint.name] == pytest.approx(100 * place[[0, 2, 1]], abs=0.05), joint.name


@pytest.mark.parametrize("arguments", [["no.wav"], ["stereo.wav"], ["no.wav", "--to", "unreal"]])
def test_what_cannot_be_played_is_told_in_a_line(arguments: list[str], tmp_path: Path,
                                                 capsys: pytest.CaptureFixture[str],
                                                 monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("stereo.wav").write_bytes(b"RIFF\0\0\0\0WAVE")
    with pytest.raises(SystemExit) as stopped:
        live_link.main(arguments)
    assert stopped.value.code == 2 and "error:" in capsys.readouterr().err
