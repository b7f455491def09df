"""Lines of InfluxDB over HTTP, sent to a small server that reads them by the rules of the protocol."""

from __future__ import annotations

import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from points.test_mqtt import boiler
from points.test_sinks import DEVICE, POINTS, point, run_file, sample

from framekit.api.run import VirtualRun, loaded
from framekit.definition.problems import NOWHERE, DefinitionError
from framekit.run.points import PointValue
from framekit.service.sinks import SinkFeeder
from framekit.sinks.base import Sampled
from framekit.sinks.influx import Influx, InfluxSink, ServerAddress
from framekit.sinks.secrets import Secret

_LINE = re.compile(
    r"(?P<key>(?:\\.|[^\\, ])+(?:,(?:\\.|[^\\,= ])+=(?:\\.|[^\\,= ])+)*)"
    r' (?P<fields>(?:[a-z]+=(?:"(?:\\.|[^"\\])*"|[^",\s]+),?)+) (?P<time>-?[0-9]+)'
)


class Database:
    """A server of lines; `answers` are the next status codes, then 204. `refuses`: lines with that text are refused."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.requests: list[tuple[str, str | None, int]] = []
        self.answers: list[int] = []
        self.refuses = "\0"
        self.port = 0

    def take(self, path: str, access: str | None, body: str) -> int:
        lines = body.split("\n")
        self.requests.append((path, access, len(lines)))
        if self.answers:
            return self.answers.pop(0)
        if any(_LINE.fullmatch(line) is None or self.refuses in line for line in lines):
            return 400
        self.lines += lines
        return 204


@contextmanager
def database() -> Iterator[Database]:
    found = Database()

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"])).decode()
            status = found.take(self.path, self.headers["Authorization"], body)
            self.send_response(status)
            if status != 204:
                self.send_header("Content-Length", "5")
            self.end_headers()
            if status != 204:
                self.wfile.write(b"never")

        def log_message(self, *_: object) -> None: ...

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    found.port = server.server_port
    thread = threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True)
    thread.start()
    try:
        yield found
    finally:
        server.shutdown()
        server.server_close()


def sink(port: int, **more: Any) -> Influx:
    return Influx(
        influx=ServerAddress(False, "127.0.0.1", port, ""), database="plant", measurement="m", at=NOWHERE, **more
    )


def test_a_run_writes_lines(tmp_path: Path) -> None:
    with database() as server:
        path = boiler(tmp_path, 1)
        (tmp_path / "token").write_text("abc\n")
        text, _, _ = path.read_text("utf-8").partition("sinks:")
        where = f'influx: "http://127.0.0.1:{server.port}/db", bucket: a b, org: o, token: file:token'
        path.write_text(f"{text}sinks:\n  - {{{where}}}\n", "utf-8")
        (tmp_path / "meter.device.yaml").write_text(DEVICE, "utf-8")
        with VirtualRun(path) as run:
            run.run_for("500 ms")
            run.enable_channel(1, False)
            run.run_for("10 s")
            assert run.problems == []
    assert sorted(line.rpartition(" ")[0] for line in server.lines[:3]) == [
        'boiler,point=mode value=2.0,text="heating",quality="good"',
        'boiler,point=setpoint value=0.0,quality="good"',
        'boiler,point=temperature,unit=°C value=21.7,quality="good"',
    ]
    assert server.lines[0].endswith(" 946684800000000000")
    assert re.fullmatch(r'boiler,point=\w+(,unit=°C)? quality="(failed|stale)",reason="[^"]+" [0-9]+', server.lines[-1])
    assert set(server.requests) == {("/db/api/v2/write?bucket=a+b&org=o&precision=ns", "Token abc", 1)}


def test_many_lines_come_in_one_request_and_those_refused_do_not_stop_the_others() -> None:
    with database() as server:
        made = InfluxSink(sink(server.port, user="u", password=Secret("env", "HOME")))
        made.open(POINTS)
        samples = [sample(at, value=float(at)) for at in range(100)]
        assert made.write(samples) == 100
        assert [number for _, _, number in server.requests] == [100]
        assert (server.requests[0][1] or "").startswith("Basic ")
        made.close()


def test_what_is_never_taken_is_dropped_and_counted(tmp_path: Path) -> None:
    with database() as server:
        server.refuses = "value=13.0"
        feeder = SinkFeeder(sink(server.port, store=str(tmp_path / "a.db")), POINTS, threaded=True)
        for at in range(40):
            feeder.put(numbered(at))
        feeder.start()
        feeder.stop()
        written = [int(line.partition("value=")[2].partition(".")[0]) for line in server.lines]
        assert sorted(set(written)) == [*range(13), *range(14, 40)]
        assert (feeder.status.written, feeder.status.dropped, feeder.status.waiting) == (39, 1, 0)


def numbered(at: int) -> Sampled:
    """Return a sample whose time equals its value."""
    return Sampled(at, (PointValue("level", at, "good", "", at, at),))


def test_a_server_that_is_busy_gets_the_same_again(tmp_path: Path) -> None:
    with database() as server:
        server.answers = [503, 429]
        feeder = SinkFeeder(sink(server.port, store=str(tmp_path / "a.db")), POINTS, threaded=False)
        feeder.start()
        for at in range(3):
            feeder.put(numbered(at))
        assert feeder.status.problem == ""
        feeder.stop()
        assert [line[-1] for line in server.lines] == ["0", "1", "2"]
        assert [number for _, _, number in server.requests] == [1, 2, 3]


def test_a_connection_that_the_server_closed_is_opened_once_more() -> None:
    with database() as server:
        made = InfluxSink(sink(server.port))
        made.open(POINTS)
        assert made.write([numbered(0)]) == 1
        assert made._connection is not None and made._connection.sock is not None
        made._connection.sock.shutdown(2)
        assert made.write([numbered(1)]) == 1
        made.close()


def test_texts_are_read_as_they_were() -> None:
    made = InfluxSink(sink(1))
    made._points = {"a": point("a", "m, = \\")}
    text = 'say "hi" \\ 5=5, so'
    line = made.line(7, PointValue("a", text, "good", "", 7, text))
    match = _LINE.fullmatch(line)
    assert match is not None and match["key"] == "m,point=a,unit=m\\,\\ \\=\\ "
    assert match["fields"] == 'text="say \\"hi\\" \\\\ 5=5, so",quality="good"' and match["time"] == "7"
    large = made.line(7, PointValue("a", 1 << 70, "good", "", 7, 1 << 70))
    assert f'text="{1 << 70}"' in large and "value=" not in large


@pytest.mark.parametrize(
    ("keys", "problem"),
    [
        ("influx: http://a:8086", "it does not say where values go"),
        ("influx: ftp://a, database: b", "'ftp://a' is no address of a server"),
        ('influx: "http://u:s3cret@a", database: b', "a secret does not stand in a run file"),
        ("influx: http://a, database: b, token: env:T", "'token' has no effect without bucket"),
        ("influx: http://a, database: b, bucket: c", "keep one"),
    ],
)
def test_what_is_wrong_with_it(tmp_path: Path, keys: str, problem: str) -> None:
    with pytest.raises(DefinitionError, match=problem) as error:
        loaded(run_file(tmp_path, f"{{{keys}}}"))
    assert "s3cret" not in str(error.value)
