"""Plain OSC: an independent reader, written from the description of OSC 1.0, reads the pose back; forward kinematics in
the receiver's axes put every bone where the same motion has it by VMC, whose receiver has other axes."""

from __future__ import annotations

import asyncio
import socket
import struct
from collections.abc import Callable

import numpy as np
import pytest
from live_double import TURN, opener
from performances import perform
from pipecat_gesticulator import Hello, connect
from pythonosc.osc_bundle import OscBundle
from scipy.spatial.transform import Rotation

from data_module.errors import InputError
from data_module.face import VISEMES, FaceMotion
from data_module.motion.skeletons import FINGERED, standing
from data_module.types import Array, Motion
from gesticulator.export.vrma import BONES, humanoid
from gesticulator.serve import osc, vmc
from gesticulator.serve.server import LiveServer, ServerAddress
from gesticulator.serve.settings import ServerLimits

PREFIX = "/gesticulator"


def read(packets: list[bytes]) -> dict[str, list[float]]:
    """OSC 1.0: a bundle is "#bundle", a time tag, and sized messages; an address and the types are strings padded to
    four bytes; floats are big endian. Only floats are allowed here, and no address twice."""
    found: dict[str, list[float]] = {}
    for packet in packets:
        assert packet[:8] == b"#bundle\0" and len(packet) <= 1400 and len(packet) % 4 == 0
        at = 16
        while at < len(packet):
            (size,) = struct.unpack_from(">i", packet, at)
            data, at = packet[at + 4:at + 4 + size], at + 4 + size
            end = data.index(b"\0")
            address, kinds_at = data[:end].decode("ascii"), end + 4 - end % 4
            kinds = data[kinds_at:data.index(b"\0", kinds_at)].decode("ascii")
            assert kinds == "," + "f" * (len(kinds) - 1) and address not in found
            numbers_at = kinds_at + len(kinds) + 4 - len(kinds) % 4
            assert len(data) == numbers_at + 4 * (len(kinds) - 1)
            found[address] = list(struct.unpack_from(f">{len(kinds) - 1}f", data, numbers_at))
    return found


@pytest.fixture(scope="module")
def motion() -> Motion:
    return standing(perform(seconds=2.0, skeleton=FINGERED).motion)


def places(turns: dict[str, Rotation], hips: Array, offsets: dict[str, Array]) -> dict[str, Array]:
    """Where the bones are, from what a receiver gets and the character that it has: forward kinematics."""
    worlds: dict[str, tuple[Rotation, Array]] = {}
    for name, turn in turns.items():
        above = BONES[name][0]
        if above is None:
            worlds[name] = turn, hips
        else:
            world, place = worlds[above]
            worlds[name] = world * turn, place + world.apply(offsets[name])
    return {name: place for name, (_, place) in worlds.items()}


def unreal(places_of_ours: Array) -> Array:
    """By Unreal's documentation: X forward, Y right, Z up, centimetres. Ours: X left, Y up, Z forward, metres."""
    left, up, forward = np.moveaxis(places_of_ours, -1, 0)
    return 100 * np.stack([forward, -left, up], axis=-1)


@pytest.mark.parametrize(("axes", "theirs"), [("y-up", lambda ours: ours), ("unreal", unreal)])
def test_a_receiver_puts_every_bone_where_it_is(motion: Motion, axes: str, theirs: Callable[[Array], Array]) -> None:
    got, nodes, frame = read(osc.OscFrames(motion, axes=axes).bundles(25, 1.5)), humanoid(motion), 25
    assert got[f"{PREFIX}/time"] == [1.5]
    names = {address.removeprefix(f"{PREFIX}/bone/") for address in got if address.startswith(f"{PREFIX}/bone/")}
    assert names == set(nodes.names) and len(names) > 40
    offsets = {name: nodes.translations[number] for number, name in enumerate(nodes.names)}
    ours = places({name: Rotation.from_quat(nodes.turns[frame, number][[1, 2, 3, 0]])
                   for number, name in enumerate(nodes.names)}, nodes.shifts[nodes.names.index("hips")][frame], offsets)
    shown = places({name: Rotation.from_quat(got[f"{PREFIX}/bone/{name}"]) for name in nodes.names},
                   np.array(got[f"{PREFIX}/hips"]), {name: theirs(offset) for name, offset in offsets.items()})
    for name in nodes.names:
        np.testing.assert_allclose(shown[name], theirs(ours[name]), atol=1e-4 * (100 if axes == "unreal" else 1))
    resting = places(dict.fromkeys(nodes.names, Rotation.identity()), np.array(got[f"{PREFIX}/hips"]),
                     {name: theirs(offset) for name, offset in offsets.items()})
    left, right, hips, head = (resting[name] for name in ("leftUpperArm", "rightUpperArm", "hips", "head"))
    if axes == "unreal":
        assert left[1] < -5 < 5 < right[1] and head[2] > hips[2] + 40, "the left is -Y, up is +Z, in centimetres"
        assert not any(address.startswith(f"{PREFIX}/angles/") for address in got)
    else:
        assert left[0] > 0.05 > -0.05 > right[0] and head[1] > hips[1] + 0.4


def test_angles_are_the_same_rotation_about_fixed_axes(motion: Motion) -> None:
    got = read(osc.OscFrames(motion).bundles(7, 0.0))
    for address, numbers in got.items():
        if address.startswith(f"{PREFIX}/angles/"):
            turn = Rotation.from_quat(got[address.replace("/angles/", "/bone/")])
            apart = Rotation.from_euler("xyz", numbers, degrees=True) * turn.inv()
            assert np.degrees(apart.magnitude()) < 1e-2, address
    truth = Rotation.from_euler("xyz", [[10, 20, 30], [-170, 5, 179], [0, 90, 0]], degrees=True)
    again = osc.angles(truth.as_quat()[:, [3, 0, 1, 2]])
    apart = (Rotation.from_euler("xyz", again, degrees=True) * truth.inv()).magnitude()
    np.testing.assert_allclose(apart, 0, atol=1e-7)


def test_another_implementation_reads_the_same_and_addresses_are_the_documented_ones(motion: Motion) -> None:
    count = len(motion)
    face = FaceMotion(np.eye(len(VISEMES))[np.arange(count) % len(VISEMES)], np.linspace(0, 1, count), np.zeros(count),
                      np.zeros(count), np.zeros((count, 2)), motion.fps)
    packets = osc.OscFrames(motion, face).bundles(3, 2.0)
    ours = read(packets)
    assert {message.address: message.params for one in packets for message in OscBundle(one)} == ours
    assert ours[f"{PREFIX}/face/blink"] == pytest.approx([3 / (count - 1)])
    kinds = {address if address.count("/") == 2 else address.rpartition("/")[0] + "/NAME" for address in ours}
    assert kinds == set(osc.ADDRESSES)


def test_a_stream_on_the_server_is_sent_to_both_receivers() -> None:
    """By VMC and by OSC at once, through the options of the server's launch."""
    sockets = []
    for _ in range(2):
        one = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        one.bind(("127.0.0.1", 0))
        one.settimeout(10)
        sockets.append(one)
    targets = [f"127.0.0.1:{one.getsockname()[1]}" for one in sockets]
    outputs = [vmc.VmcOutput(targets[0]), osc.OscOutput(targets[1])]

    async def talk() -> None:
        address, limits = ServerAddress(port=0), ServerLimits()
        listening = address.listen()
        server = LiveServer(address, limits, opener(limits), vmc.SeveralOutputs(outputs))
        running = asyncio.create_task(server.run(listening))
        async with connect(f"ws://127.0.0.1:{listening.getsockname()[1]}/stream", Hello(16000, fps=30)) as stream:
            await stream.send(bytes(2 * 16000 * 2))
            await stream.finish()
            assert [message async for message in stream]
        server.stop()
        await running

    try:
        for output in outputs:
            output.start()
        asyncio.run(talk())
        assert sockets[0].recv(65536).startswith(b"#bundle\0")
        numbers: list[float] = []
        while len(numbers) < 20:
            got = read([sockets[1].recv(65536)])
            if f"{PREFIX}/bone/hips" in got:
                _, y, _, w = got[f"{PREFIX}/bone/hips"]
                numbers.append(2 * np.arctan2(y, w) / TURN)
        np.testing.assert_allclose(numbers, np.round(numbers), atol=0.01)
        assert (np.diff(numbers) > -0.01).all() and numbers[-1] > numbers[0]
    finally:
        for output in outputs:
            output.stop()
        for one in sockets:
            one.close()


def test_what_is_no_target_and_no_axes_are_refused_in_a_line() -> None:
    with pytest.raises(InputError, match=r"--osc nowhere: is not HOST:PORT; such as 127.0.0.1:9000"):
        osc.OscOutput("nowhere")
    with pytest.raises(InputError, match="--osc-axes sideways: is unknown"):
        osc.OscOutput("127.0.0.1:9000", "sideways")
