"""What a server counts, and the same in Prometheus' text format (version 0.0.4)."""

from __future__ import annotations

import os
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from data_module.errors import InputError
from data_module.json_files import read_object

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"
BUCKETS = (0.005, 0.01, 0.02, 0.03, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
"""Upper ends of a histogram's buckets, seconds: from a block's compute to what nobody would wait for."""
_KINDS = {
    "streams": ("gauge", "Streams that are open."),
    "streams_total": ("counter", "Streams that were opened."),
    "sound_seconds_total": ("counter", "Seconds of sound that were taken in."),
    "frames_total": ("counter", "Frames of motion that were made."),
    "sent_bytes_total": ("counter", "Bytes of poses and events that were sent."),
    "hurried_seconds_total": ("counter", "Seconds of sound that came late and were gestured to at less cost."),
    "passed_seconds_total": ("counter", "Seconds of sound that came too late and were passed over."),
    "waiting_seconds": ("gauge", "Seconds of sound that wait to be worked on."),
    "unread_bytes": ("gauge", "Bytes of poses that wait to be read by clients."),
    "draining": ("gauge", "1 while the server is stopping."),
    "closed_total": ("counter", "Connections that were closed, by code."),
    "refused_total": ("counter", "Requests that were refused before they were a stream, by HTTP status."),
    "compute_seconds": ("histogram", "Time of one piece of work on a stream (half a second of sound at most)."),
    "late_seconds": ("histogram", "Sound that must have been played already, when the next piece of it was taken up."),
    "answer_seconds": ("histogram", "Time from the arrival of sound to the end of the work on it."),
}


@dataclass
class Histogram:
    """Counts of values by bucket. counts: of each of `BUCKETS` and, last, of those beyond; total: their sum."""

    counts: list[int] = field(default_factory=lambda: [0] * (len(BUCKETS) + 1))
    total: float = 0.0

    def add(self, seconds: float) -> None:
        """Count a value."""
        self.counts[bisect_left(BUCKETS, seconds)] += 1
        self.total += seconds


class ServerMetrics:
    """The figures of one process."""

    def __init__(self, worker: int = 0) -> None:
        self.worker = worker
        self.numbers = {name: 0.0 for name, (kind, _) in _KINDS.items()
                        if kind != "histogram" and name not in ("closed_total", "refused_total")}
        self.coded: dict[str, dict[str, int]] = {"closed_total": {}, "refused_total": {}}
        self.histograms = {name: Histogram() for name, (kind, _) in _KINDS.items() if kind == "histogram"}

    def add(self, name: str, amount: float = 1.0) -> None:
        """Add to a counter or a gauge."""
        self.numbers[name] += amount

    def count(self, name: str, code: int) -> None:
        """Count one of a code."""
        self.coded[name][str(int(code))] = self.coded[name].get(str(int(code)), 0) + 1

    def time(self, name: str, seconds: float) -> None:
        """Count a time in a histogram."""
        self.histograms[name].add(seconds)

    def figures(self) -> dict[str, Any]:
        """Everything, as plain values."""
        return {"worker": self.worker, "numbers": self.numbers, "coded": self.coded,
                "histograms": {name: [own.counts, own.total] for name, own in self.histograms.items()}}


def write_figures(folder: Path, worker: int, text: str) -> None:
    """Write a worker's figures, as JSON, where the others read them: whole, and not synced. They are of no use after
    the system's end, and to sync takes seconds on a busy disk."""
    temporary = folder / f".{worker}.{os.getpid()}"
    temporary.write_text(text, encoding="utf-8")
    temporary.replace(figures_file(folder, worker))


def figures_file(folder: Path, worker: int) -> Path:
    """Where a worker's figures are."""
    return folder / f"{worker}.json"


def read_figures(folder: Path, but: int) -> list[dict[str, Any]]:
    """The figures of the workers other than `but`, as they wrote them last."""
    found = []
    for file in folder.glob("[0-9]*.json"):
        try:
            told = read_object(file, "delete it")
        except InputError:  # its worker died meanwhile
            continue
        if told["worker"] != but:
            found.append(told)
    return found


def exposition(workers: Sequence[dict[str, Any]]) -> str:
    """Figures of one or more workers as Prometheus reads them."""
    lines, workers = [], sorted(workers, key=lambda told: int(told["worker"]))
    for name, (kind, about) in _KINDS.items():
        full = f"gesticulator_{name}"
        lines += [f"# HELP {full} {about}", f"# TYPE {full} {kind}"]
        for told in workers:
            label = f'worker="{told["worker"]}"'
            if kind == "histogram":
                lines += _histogram(full, label, *told["histograms"][name])
            elif name in told["coded"]:
                lines += [f'{full}{{{label},code="{code}"}} {count}' for code, count in
                          sorted(told["coded"][name].items())]
            else:
                lines.append(f"{full}{{{label}}} {told['numbers'][name]:.12g}")
    return "\n".join(lines) + "\n"


def _histogram(name: str, label: str, counts: Sequence[int], total: float) -> list[str]:
    lines, so_far = [], 0
    for end, count in zip((*map(str, BUCKETS), "+Inf"), counts, strict=True):
        so_far += count
        lines.append(f'{name}_bucket{{{label},le="{end}"}} {so_far}')
    return [*lines, f"{name}_sum{{{label}}} {total:.12g}", f"{name}_count{{{label}}} {so_far}"]
