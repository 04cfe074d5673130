"""The load generator: times that are known, since the server's look-ahead is, and clients as they should not be."""

from __future__ import annotations

import asyncio
import json
from typing import Any

import numpy as np
import pytest
from live_double import LOOK_AHEAD, served
from pipecat_gesticulator import Hello

from gesticulator.serve.settings import ServerLimits
from tests.benchmark_files import benchmark

pytest.importorskip("websockets")
LIMITS = ServerLimits(streams=6, stream_seconds=100.0, message_bytes=2**16, waiting_seconds=30.0, unread_bytes=2**16,
                      unread_seconds=1.0, hello_seconds=0.5, quiet_seconds=5.0, drain_seconds=0.5)


loading = benchmark("load")


def told(clients: int, seconds: float = 3.0, limits: ServerLimits = LIMITS, **plan: Any) -> dict[str, Any]:
    """The report of clients on a server without models."""
    sound = (np.sin(np.arange(int(seconds * loading.RATE)) * 0.1) * 8000).astype("<i2").tobytes()
    with served(limits, {}) as (_, port):
        asked = loading.LoadPlan(f"ws://127.0.0.1:{port}/stream", clients, **{"ramp": 0.2, **plan})
        report = asyncio.run(loading.load(asked, sound))
    assert json.loads(json.dumps(report)) == report
    return report


def test_an_answer_takes_the_look_ahead_at_the_pace_of_the_sound() -> None:
    report = told(3, pace=4.0)
    assert report["done"] == 3 and report["dropped"] == {} and report["missing_frames"] == 0
    assert report["frames"] == 3 * 180 and report["sent_bytes"] == 3 * 3 * 32_000
    assert report["received_bytes"] == 540 * 4 * (16 * 4 + 3)
    assert report["answer"]["p50"] > LOOK_AHEAD / 4 - 0.05, "no answer is there before its sound"
    assert report["answer"]["p50"] <= report["answer"]["p95"] <= report["answer"]["p99"] <= report["answer"]["longest"]
    assert report["wall_seconds"] > 3.0 / 4


def test_all_at_once_is_as_fast_as_the_server() -> None:
    report = told(2, seconds=25.0, pace=0.0)
    assert report["done"] == 2 and report["frames"] == 3000
    assert report["wall_seconds"] < 25.0, "not at the pace of the sound: it takes half a second"


def test_rude_clients_are_ended_by_the_server_and_not_felt_by_the_others() -> None:
    report = told(6, pace=4.0, rude={"garbage": 0.2, "silent": 0.2, "vanishing": 0.2})
    assert report["rude"] == {"garbage: 4400": 1, "silent: 4408": 1, "vanishing: went": 1}
    assert report["good"] == report["done"] == 3 and report["missing_frames"] == 0


def test_streams_that_are_too_many_are_counted_as_dropped() -> None:
    report = told(4, pace=2.0, limits=ServerLimits(streams=3, drain_seconds=0.5))
    assert report["done"] == 3 and report["dropped"] == {"refused": 1}
    assert report["reasons"] == {"the server has its 3 streams": 1}


def test_a_stream_that_the_server_closes_is_dropped_with_its_code() -> None:
    report = told(1, seconds=4.0, pace=0.0, limits=ServerLimits(stream_seconds=2.0, drain_seconds=0.5))
    assert report["done"] == 0 and report["dropped"] == {"4413": 1}


def test_no_server_is_a_refusal() -> None:
    plan = loading.LoadPlan("ws://127.0.0.1:1/stream", 2, 0.0, hello=Hello(loading.RATE))
    report = asyncio.run(loading.load(plan, b"\0" * 640))
    assert report["dropped"] == {"refused": 2} and report["answer"] == {}


@pytest.mark.parametrize(("share", "count"), [(0.0, 0), (0.1, 1), (0.5, 5), (1.0, 10)])
def test_rude_clients_are_that_share_and_spread(share: float, count: int) -> None:
    kinds = loading.LoadPlan("", 10, 0.0, rude={"stalled": share, "silent": 0.2}).kinds()
    assert kinds.count("stalled") == count and kinds.count("silent") == min(2, 10 - count)
    if count == 5:
        assert all("stalled" in (a, b) for a, b in zip(kinds[::2], kinds[1::2], strict=True))


def test_quantiles_are_numpys_and_nothing_of_nothing() -> None:
    times = np.random.default_rng(0).exponential(size=999).tolist()
    assert loading.quantiles(times)["p95"] == pytest.approx(np.percentile(times, 95), abs=1e-4)
    assert loading.quantiles([]) == {}
