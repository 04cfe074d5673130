"""Metrics of a server, in the formats of Prometheus."""

from __future__ import annotations

import os
from functools import partial

from prometheus_client import (
    CONTENT_TYPE_LATEST,
    CollectorRegistry,
    Counter,
    Gauge,
    Histogram,
    disable_created_metrics,
    generate_latest,
)
from prometheus_client.multiprocess import MultiProcessCollector

CONTENT_TYPE = CONTENT_TYPE_LATEST
SHARED_FOLDER = "PROMETHEUS_MULTIPROC_DIR"
"""Environment variable with the folder in which the workers of a server share their metrics. The library reads it when
it is imported, so it is set before a worker starts."""
BUCKETS = (0.005, 0.01, 0.02, 0.03, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 60.0)
"""Upper bounds of the histograms' buckets, seconds: from a third of a block's computing time to what waits after a
minute of overload."""

disable_created_metrics()  # a second time series for each counter, which nothing here reads


class ServerMetrics:
    """The metrics of a process; `text` is for all workers of the server together."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        # Gauges of workers that ended do not count.
        gauge = partial(Gauge, namespace="gesticulator", registry=self.registry, multiprocess_mode="livesum")
        counter = partial(Counter, namespace="gesticulator", registry=self.registry)
        histogram = partial(Histogram, namespace="gesticulator", registry=self.registry, buckets=BUCKETS)
        self.streams = gauge("streams", "Open streams.")
        self.waiting_seconds = gauge("waiting_seconds", "Seconds of audio waiting to be processed.")
        self.unread_bytes = gauge("unread_bytes", "Bytes of poses waiting to be read by clients.")
        self.opened = counter("streams_opened", "Streams opened so far.")
        self.sound_seconds = counter("sound_seconds", "Seconds of audio received.")
        self.frames = counter("frames", "Frames of motion generated.")
        self.sent_bytes = counter("sent_bytes", "Bytes of poses and events sent.")
        self.hurried_seconds = counter("hurried_seconds", "Seconds of late audio processed at lower cost.")
        self.passed_seconds = counter("passed_seconds", "Seconds of audio skipped because it came too late.")
        self.closed = counter("closed", "Closed connections, by code.", ["code"])
        self.refused = counter("refused", "Requests refused before becoming a stream, by HTTP status.", ["code"])
        self.compute_seconds = histogram("compute_seconds", "Time of a turn of a stream.")
        self.late_seconds = histogram("late_seconds", "Delay behind playback of a piece that is taken up.")
        self.answer_seconds = histogram("answer_seconds", "Time from the arrival of audio to its last pose.")

    def text(self) -> bytes:
        """All metrics in Prometheus' text format."""
        registry = self.registry
        # Any worker may answer the request, so each reads the files of all.
        if SHARED_FOLDER in os.environ:
            registry = CollectorRegistry()
            MultiProcessCollector(registry)
        return generate_latest(registry)
