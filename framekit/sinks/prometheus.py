"""Values and counters of a run for Prometheus, which fetches them: `http://127.0.0.1:PORT/metrics`."""

from __future__ import annotations

import logging
import platform
import socket
import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, ClassVar

from framekit.definition.keys import key
from framekit.definition.problems import error_text
from framekit.run.model import Point
from framekit.run.points import PointValue
from framekit.run.status import RunStatus
from framekit.sinks.base import LISTENING, Host, Sampled, Sink, SinkKind, not_installed
from framekit.transport.network import bracketed

if TYPE_CHECKING:
    from prometheus_client import Metric

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class Prometheus(SinkKind):
    """Metrics of points, blocks, channels and sinks, for Prometheus to fetch."""

    word: ClassVar[str] = "prometheus"
    prometheus: tuple[str, int] = key(
        "prometheus", LISTENING,
        "The port on which /metrics is given, on 127.0.0.1 unless ADDRESS:PORT says another address; 0: a free one.",
    )  # fmt: skip

    @property
    def target(self) -> str:
        host, port = self.prometheus
        return f"{bracketed(host)}:{port}"

    @property
    def listens(self) -> tuple[str, int]:
        return self.prometheus

    def mistakes(self) -> Iterator[tuple[str, str, str]]:
        yield from not_installed("prometheus-client", "prometheus_client")
        if self.every is not None:
            yield "every", "'every' has no effect: Prometheus fetches the values when it wants to", "remove it"

    def make(self) -> Sink:
        return PrometheusServer(*self.prometheus)


class PrometheusServer(Sink):
    """Serves the present metrics. Raises OSError for a port that cannot be opened."""

    def __init__(self, host: str, port: int) -> None:
        self.host, self.port = host, port
        self._run: Host | None = None
        self._points: Mapping[str, Point] = {}
        self._values: dict[str, PointValue] = {}
        self._server: Any = None
        self._thread: threading.Thread | None = None

    def meet(self, host: Host) -> None:
        self._run = host

    def open(self, points: Sequence[Point]) -> None:
        from prometheus_client import CollectorRegistry, ProcessCollector, start_http_server

        self._points = {point.name: point for point in points}
        registry = CollectorRegistry(auto_describe=False)
        registry.register(self)
        ProcessCollector(registry=registry)  # processor time, memory, files, start; it knows them on Linux
        try:
            self._server, self._thread = start_http_server(self.port, self.host, registry)
        except socket.gaierror as error:
            raise OSError(error.errno, f"nothing can listen on {self.host}: {error_text(error)}") from None
        self.port = self._server.server_port  # a free one, where the file says 0
        log.info("sink prometheus: http://%s:%d/metrics", self.host, self.port)

    def write(self, samples: Sequence[Sampled]) -> int:
        self._values |= {value.name: value for sample in samples for value in sample.values}
        return len(samples)

    def close(self) -> None:
        server, self._server = self._server, None
        if server is not None:
            server.shutdown()
            server.server_close()

    def describe(self) -> Iterator[Metric]:
        """Return no descriptions: the metrics depend on the run."""
        return iter(())

    def collect(self) -> Iterator[Metric]:
        """Yield the present metrics; the library calls this in the thread of a request."""
        yield _of_program()
        if self._run is None:
            return
        status = self._run.status()
        yield from self._of_points(status.run)
        yield from _of_blocks(status)
        yield from _of_channels(status)
        yield from _of_sinks(status)
        yield from _of_troubles(status)

    def _of_points(self, run: str) -> Iterator[Metric]:
        from prometheus_client.core import GaugeMetricFamily

        names = ("run", "point", "unit")
        value = GaugeMetricFamily("framekit_point_value", "A point's value, while it is good.", labels=names)
        good = GaugeMetricFamily("framekit_point_good", "1 while a point's value is good, else 0.", labels=names)
        time = GaugeMetricFamily(
            "framekit_point_time_seconds", "When a point changed or failed, since 1970.", labels=names
        )
        for name, point in self._points.items():
            labels = (run, name, point.unit)
            now = self._values.get(name)
            is_good = now is not None and now.quality == "good"
            good.add_metric(labels, float(is_good))
            if now is None:
                continue
            if now.time:
                time.add_metric(labels, now.time / 1e9)
            if is_good and isinstance(now.number, (int, float)):  # words stand for numbers; a text is none
                value.add_metric(labels, float(now.number))
        yield from (value, good, time)


def _of_program() -> Metric:
    from prometheus_client.core import GaugeMetricFamily

    rows = [((version("framekit"), platform.python_version()), 1.0)]
    return _family(GaugeMetricFamily, "framekit_info", "What carries the run out.", ("version", "python"), rows)


Rows = Sequence[tuple[Sequence[str], float | None]]


def _family(kind: Any, name: str, about: str, labels: Sequence[str], rows: Rows) -> Metric:
    """Return a metric; rows without a value are left out."""
    found: Metric = kind(name, about, labels=labels)
    for values, number in rows:
        if number is not None:
            found.add_metric(values, number)  # type: ignore[attr-defined]
    return found


def _of_blocks(status: RunStatus) -> Iterator[Metric]:
    from prometheus_client.core import CounterMetricFamily

    labels = ("run", "block", "name", "channel")
    found = [((status.run, one.label, one.name, str(one.channel)), one) for one in status.blocks]
    for name, about, rows in (
        ("done", "Times that a block has ended well.", [(at, one.done) for at, one in found]),
        ("failed", "Times that a block has failed.", [(at, one.failed) for at, one in found]),
    ):
        yield _family(CounterMetricFamily, f"framekit_block_{name}", about, labels, rows)


def _of_channels(status: RunStatus) -> Iterator[Metric]:
    from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

    labels = ("run", "channel", "port")
    found = [((status.run, str(one.number), one.port), one) for one in status.channels]
    for name, about, attribute in (
        ("services", "Exchanges that have ended.", "services"),
        ("frames_in", "Good frames that came.", "frames_in"),
        ("bad_frames", "Frames that came damaged.", "bad"),
        ("noise_bytes", "Bytes that were no frame.", "noise_bytes"),
        ("late_replies", "Replies that came after the time limit.", "late"),
        ("repeated_requests", "Requests that were sent once more.", "repeated"),
        ("bytes_in", "Bytes that came.", "bytes_in"),
        ("bytes_out", "Bytes that were sent.", "bytes_out"),
        ("reopenings", "Times that the port was opened anew.", "reopenings"),
    ):
        rows = [(at, getattr(one, attribute)) for at, one in found]
        yield _family(CounterMetricFamily, f"framekit_channel_{name}", about, labels, rows)
    failed = [((*at, outcome), number) for at, one in found for outcome, number in one.reasons.items()]
    about = "Exchanges that have failed, by outcome."
    yield _family(CounterMetricFamily, "framekit_channel_errors", about, (*labels, "outcome"), failed)
    is_open = [(at, float(one.state == "open")) for at, one in found]
    yield _family(GaugeMetricFamily, "framekit_channel_open", "1 while the port is open, else 0.", labels, is_open)
    load = [(at, one.load) for at, one in found]
    about = "The part of the time (0 to 1) that the line was busy."
    yield _family(GaugeMetricFamily, "framekit_line_load", about, labels, load)


def _of_sinks(status: RunStatus) -> Iterator[Metric]:
    from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

    labels = ("run", "sink", "kind", "target")  # two sinks may have one kind and target
    found = [((status.run, str(number), one.kind, one.target), one) for number, one in enumerate(status.sinks, 1)]
    for kind, name, about, attribute in (
        (CounterMetricFamily, "taken", "Samples that a sink has taken.", "written"),
        (CounterMetricFamily, "dropped", "Samples that were too many.", "dropped"),
        (GaugeMetricFamily, "waiting", "Samples that wait for a sink.", "waiting"),
    ):
        rows = [(at, getattr(one, attribute)) for at, one in found]
        yield _family(kind, f"framekit_sink_{name}", about, labels, rows)


def _of_troubles(status: RunStatus) -> Iterator[Metric]:
    from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

    labels = ("run", "name")
    failing = [((status.run, one.name), float(bool(one.reason))) for one in status.troubles]
    about = "1 while a sink, a store, the state file or a capture fails, else 0."
    yield _family(GaugeMetricFamily, "framekit_trouble", about, labels, failing)
    lost = [((status.run, one.name), float(one.lost)) for one in status.troubles]
    yield _family(CounterMetricFamily, "framekit_trouble_lost", "Samples that are lost.", labels, lost)
