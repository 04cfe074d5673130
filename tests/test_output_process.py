"""Poses are sent from a process of their own: at their pace whatever the server computes, and again after it died."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

import numpy as np
import pytest
from live_double import TURN
from test_vmc import receive

from data_module.motion import rotation
from data_module.motion.skeletons import CHARACTER
from gesticulator.serve import output_process
from gesticulator.serve.output_process import OutputProcess
from gesticulator.serve.vmc import PoseOutput, VmcOutput
from gesticulator.stream import StreamFrames

FPS = 60


class Receiver:
    """Takes datagrams and tells of each frame the sender's time and its number, by the hips' turn."""

    def __init__(self) -> None:
        self.frames: list[tuple[float, int]] = []
        self.alive = 0
        """Messages that there is no character yet."""
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(0.2)
        self._ended = False
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    @property
    def target(self) -> str:
        return f"127.0.0.1:{self._socket.getsockname()[1]}"

    def _run(self) -> None:
        while not self._ended:
            try:
                one = receive(self._socket.recv(65536))
            except TimeoutError:
                continue
            self.alive += one.loaded == 0
            if one.loaded == 1 and "Hips" in one.bones:
                turn = 2 * np.arctan2(one.bones["Hips"][4], one.bones["Hips"][6])
                self.frames.append((one.time, round(-turn / TURN)))

    def await_(self, holds: Callable[[], bool]) -> None:
        end = time.monotonic() + 120
        while not holds():
            assert time.monotonic() < end, (self.alive, self.frames[-3:])
            time.sleep(0.01)

    def close(self) -> None:
        self._ended = True
        self._thread.join()
        self._socket.close()


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    one = Receiver()
    yield one
    one.close()


def turning(first: int, count: int) -> StreamFrames:
    """Frame k turns the hips by k * TURN."""
    numbers = np.arange(first, first + count)
    turns = np.zeros((count, len(CHARACTER), 4))
    turns[..., 0] = 1.0
    turns[:, 0] = rotation.from_exponential_map(np.stack([0 * numbers, numbers * TURN, 0 * numbers], -1))
    return StreamFrames(first, FPS, CHARACTER, turns, np.tile([0.0, 0.95, 0.0], (count, 1)))


@contextmanager
def computing() -> Iterator[None]:
    """Three threads that hold Python's lock as much as they can, as models do between their calls."""
    ended = threading.Event()

    def spin() -> None:
        while not ended.is_set():
            sum(range(1000))

    threads = [threading.Thread(target=spin) for _ in range(3)]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        ended.set()
        for thread in threads:
            thread.join()


def sent_meanwhile(output: PoseOutput, receiver: Receiver) -> int:
    """Frames of 1.5 s that are sent while this process computes."""
    receiver.frames.clear()
    output.take("a", turning(0, 90))
    with computing():
        time.sleep(1.6)
    receiver.await_(lambda: bool(receiver.frames) and receiver.frames[-1][1] == 89)
    output.leave("a")
    return len({frame for _, frame in receiver.frames})


def test_frames_keep_their_pace_while_the_server_computes(receiver: Receiver) -> None:
    """A thread in the server would wait for Python's lock with each datagram."""
    here = VmcOutput(receiver.target)
    here.start()
    slow = sent_meanwhile(here, receiver)
    here.stop()
    elsewhere = OutputProcess(partial(VmcOutput, receiver.target))
    elsewhere.start()
    try:
        receiver.alive = 0
        receiver.await_(lambda: receiver.alive > 0)
        kept = sent_meanwhile(elsewhere, receiver)
    finally:
        elsewhere.stop()
    print(f"{slow} frames of 90 from a thread, {kept} from a process")
    assert kept > 1.5 * slow


def test_every_frame_is_sent_once_and_in_order_and_the_process_ends(receiver: Receiver) -> None:
    output = OutputProcess(partial(VmcOutput, receiver.target))
    output.start()
    receiver.await_(lambda: receiver.alive > 0)
    for first in range(0, 60, 20):
        output.take("a", turning(first, 20))
    receiver.await_(lambda: bool(receiver.frames) and receiver.frames[-1][1] == 59)
    numbers = [number for _, number in receiver.frames]
    assert numbers == sorted(numbers) and numbers[0] < 20
    times = np.array([at for at, _ in receiver.frames])
    assert (times[-1] - times[0]) > (numbers[-1] - numbers[0] - 1) / FPS, "never ahead of its time"
    output.leave("a")
    output.take("b", turning(0, 30))
    receiver.await_(lambda: receiver.frames[-1][1] == 29)
    process = output._process
    assert process is not None and process.is_alive()
    output.stop()
    assert process.exitcode == 0


def test_a_process_that_died_is_replaced(receiver: Receiver, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(output_process, "_AGAIN_SECONDS", 0.0)
    output = OutputProcess(partial(VmcOutput, receiver.target))
    output.start()
    receiver.await_(lambda: receiver.alive > 0)
    first = output._process
    assert first is not None
    first.kill()
    first.join()
    output.take("a", turning(0, 10))
    receiver.await_(lambda: output._process is not first)
    output.take("a", turning(10, 20))
    receiver.await_(lambda: bool(receiver.frames) and receiver.frames[-1][1] == 29)
    output.stop()
