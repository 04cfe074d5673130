"""Server metrics, and their export in Prometheus' text format (version 0.0.4)."""

from __future__ import annotations

import os
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from data_module.errors import InputError
from data_module.files import read_object

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"
BUCKETS = (0.005, 0.01, 0.02, 0.03, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 60.0)
"""Upper bounds of histogram buckets, seconds."""
_KINDS = {
    "streams": ("gauge", "Open streams."),
    "streams_total": ("counter", "Streams opened so far."),
    "sound_seconds_total": ("counter", "Seconds of audio received."),
    "frames_total": ("counter", "Frames of motion generated."),
    "sent_bytes_total": ("counter", "Bytes of poses and events sent."),
    "shortened_seconds_total": ("counter", "Seconds of late audio processed with low look-ahead in place of full."),
    "hurried_seconds_total": ("counter", "Seconds of late audio processed at lower cost."),
    "passed_seconds_total": ("counter", "Seconds of audio skipped because it came too late."),
    "waiting_seconds": ("gauge", "Seconds of audio waiting to be processed."),
    "unread_bytes": ("gauge", "Bytes of poses waiting to be read by clients."),
    "draining": ("gauge", "1 while the server is stopping."),
    "capacity_streams": ("gauge", "Streams that fit, by the measured cost of a stream."),
    "promised_load": ("gauge", "Computing time per second that open streams may need, by the measured cost."),
    "downgraded_steps": ("gauge", "Steps by which streams are downgraded while compute is short."),
    "parked": ("gauge", "Lost streams whose state is kept for their clients."),
    "resumed_total": ("counter", "Streams that a client came back to."),
    "relayed_total": ("counter", "Connections passed on to the worker that has their stream."),
    "guests": ("gauge", "Connections that have not sent a valid hello."),
    "guests_cut_total": ("counter", "Connections cut off before a hello because there were too many."),
    "wrong_tokens_total": ("counter", "Hellos with a wrong token."),
    "stuck_seconds": ("gauge", "Time since the turn that is computed began."),
    "closed_total": ("counter", "Closed connections, by code."),
    "refused_total": ("counter", "Requests refused before becoming a stream, by HTTP status."),
    "compute_seconds": ("histogram", "Time of a turn of a stream: at most a block, or 30 ms."),
    "late_seconds": ("histogram", "Delay of processing behind playback when a piece is taken up."),
    "answer_seconds": ("histogram", "Time from the arrival of audio to the end of its processing."),
}


@dataclass
class Histogram:
    """A histogram. counts: values in each of `BUCKETS`, and last those beyond; total: their sum."""

    counts: list[int] = field(default_factory=lambda: [0] * (len(BUCKETS) + 1))
    total: float = 0.0

    def add(self, seconds: float) -> None:
        self.counts[bisect_left(BUCKETS, seconds)] += 1
        self.total += seconds


class ServerMetrics:
    """The metrics of one process."""

    def __init__(self, worker: int = 0) -> None:
        self.worker = worker
        self.numbers = {name: 0.0 for name, (kind, _) in _KINDS.items()
                        if kind != "histogram" and name not in ("closed_total", "refused_total")}
        self.coded: dict[str, dict[str, int]] = {"closed_total": {}, "refused_total": {}}
        self.histograms = {name: Histogram() for name, (kind, _) in _KINDS.items() if kind == "histogram"}

    def add(self, name: str, amount: float = 1.0) -> None:
        """Add to a counter or a gauge."""
        self.numbers[name] += amount
        if _KINDS[name][0] == "gauge" and self.numbers[name] < 1e-9:
            self.numbers[name] = 0.0  # sums of floats end a little above or below it

    def set(self, name: str, value: float) -> None:
        """Set a gauge."""
        self.numbers[name] = max(0.0, value)

    def count(self, name: str, code: int) -> None:
        """Count an event with a code."""
        self.coded[name][str(int(code))] = self.coded[name].get(str(int(code)), 0) + 1

    def time(self, name: str, seconds: float) -> None:
        """Add a time to a histogram."""
        self.histograms[name].add(seconds)

    def figures(self) -> dict[str, Any]:
        """All metrics as plain values."""
        return {"worker": self.worker, "numbers": self.numbers, "coded": self.coded,
                "histograms": {name: [values.counts, values.total] for name, values in self.histograms.items()}}


def write_figures(folder: Path, worker: int, text: str) -> None:
    """Write a worker's metrics as JSON where the others read them: atomically, but not synced, since they are useless
    after a crash and syncing takes seconds on a busy disk."""
    temporary = folder / f".{worker}.{os.getpid()}"
    temporary.write_text(text, encoding="utf-8")
    temporary.replace(figures_file(folder, worker))


def figures_file(folder: Path, worker: int) -> Path:
    """The metrics file of a worker."""
    return folder / f"{worker}.json"


def read_figures(folder: Path, but: int) -> list[dict[str, Any]]:
    """The last metrics written by workers other than `but`."""
    others = []
    for file in folder.glob("[0-9]*.json"):
        try:
            figures = read_object(file, "delete it")
        except InputError:  # its worker died in the meantime
            continue
        if figures["worker"] != but:
            others.append(figures)
    return others


def exposition(workers: Sequence[dict[str, Any]]) -> str:
    """Metrics of one or more workers in Prometheus' text format."""
    lines, workers = [], sorted(workers, key=lambda figures: int(figures["worker"]))
    for name, (kind, about) in _KINDS.items():
        full = f"gesticulator_{name}"
        lines += [f"# HELP {full} {about}", f"# TYPE {full} {kind}"]
        for figures in workers:
            label = f'worker="{figures["worker"]}"'
            if kind == "histogram":
                lines += _histogram(full, label, *figures["histograms"][name])
            elif name in figures["coded"]:
                lines += [f'{full}{{{label},code="{code}"}} {count}' for code, count in
                          sorted(figures["coded"][name].items())]
            else:
                lines.append(f"{full}{{{label}}} {figures['numbers'][name]:.12g}")
    return "\n".join(lines) + "\n"


def _histogram(name: str, label: str, counts: Sequence[int], total: float) -> list[str]:
    lines, so_far = [], 0
    for end, count in zip((*map(str, BUCKETS), "+Inf"), counts, strict=True):
        so_far += count
        lines.append(f'{name}_bucket{{{label},le="{end}"}} {so_far}')
    return [*lines, f"{name}_sum{{{label}}} {total:.12g}", f"{name}_count{{{label}}} {so_far}"]
