"""Metrics of a server, in the text format of Prometheus."""

from functools import partial

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, disable_created_metrics

BUCKETS = (0.005, 0.01, 0.02, 0.03, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 60.0)
"""Upper bounds of the histograms' buckets, seconds: from a third of a block's computing time to what waits after a
minute of overload."""

disable_created_metrics()  # a second time series for each counter, which nothing here reads


class ServerMetrics:
    """The metrics of one server, in a registry of its own so that a process may have several servers."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        gauge = partial(Gauge, namespace="gesticulator", registry=self.registry)
        counter = partial(Counter, namespace="gesticulator", registry=self.registry)
        histogram = partial(Histogram, namespace="gesticulator", registry=self.registry, buckets=BUCKETS)
        # These three are read from the connections when they are asked for (`LiveServer`).
        self.streams = gauge("streams", "Open streams.")
        self.waiting_seconds = gauge("waiting_seconds", "Seconds of audio waiting to be processed.")
        self.unread_bytes = gauge("unread_bytes", "Bytes of poses waiting to be read by clients.")
        self.sound_seconds = counter("sound_seconds", "Seconds of audio received.")
        self.frames = counter("frames", "Frames of motion generated.")
        self.sent_bytes = counter("sent_bytes", "Bytes of poses and events sent.")
        self.closed = counter("closed", "Closed connections, by code.", ["code"])
        self.compute_seconds = histogram("compute_seconds", "Time of a turn of a stream.")
        self.answer_seconds = histogram("answer_seconds", "Time from the arrival of audio to its last pose.")
