"""Values to InfluxDB, and to servers of its line protocol over HTTP: many lines in one request.

The server stores a repeated value once, so that repetitions after a failure create no duplicates.
"""

from __future__ import annotations

import base64
import http.client
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple
from urllib.parse import urlencode, urlsplit

from framekit.definition.keys import TEXT, Form, KeyReading, key, ref
from framekit.definition.tree import Node
from framekit.run.model import Point
from framekit.run.points import PointValue
from framekit.sinks.base import Host, NeverTakenError, Sampled, Sink
from framekit.sinks.secrets import SECRET, Secret
from framekit.sinks.store import NetworkSink

MOST_LINES = 5_000
"""Largest number of lines in a request, unless one sample has more."""

LONGEST_ANSWER = 10.0
"""Time limit for the answer of a server (s)."""

REFUSED = (400, 413, 422)
"""Statuses for wrong lines or too many; after every other status except 2xx the same lines are tried again."""

EXACT = 1 << 53
"""Largest whole number up to which a float represents every whole number."""
LARGEST = 1 << 64
"""Least absolute value of whole numbers that are sent as text only."""


class ServerAddress(NamedTuple):
    """Address of a server."""

    is_encrypted: bool
    host: str
    port: int | None
    path: str
    """Path before the server's own paths."""

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        port = "" if self.port is None else f":{self.port}"
        return f"http{'s' if self.is_encrypted else ''}://{host}{port}{self.path}"


def read_server(reading: KeyReading, node: Node) -> ServerAddress:
    """Parse `http://HOST:PORT` or `https://…`. Raises Broken."""
    text = reading.reader.text(node).strip()
    try:
        found = urlsplit(text)
        port = found.port
    except ValueError:
        found, port = urlsplit(""), None
    if found.username is not None or found.password is not None:
        raise reading.reader.broken(node.at, "a secret does not stand in a run file", "use user: and password:")
    if found.scheme not in ("http", "https") or not found.hostname or found.query or found.fragment:
        raise reading.reader.broken(node.at, f"'{text}' is no address of a server", "write it like http://HOST:8086")
    return ServerAddress(found.scheme == "https", found.hostname, port, found.path.rstrip("/"))


@dataclass(frozen=True, slots=True, kw_only=True)
class Influx(NetworkSink):
    """InfluxDB, or a server of its line protocol: `bucket` for version 2 and later, `database` for version 1."""

    word: ClassVar[str] = "influx"
    influx: ServerAddress = key("influx", Form(ref("text"), read_server), "The server: http://HOST:8086, or https.")
    bucket: str = key("bucket", TEXT, "Where values go (version 2 and later).", default="")
    org: str = key("org", TEXT, "The organization of the bucket.", default="")
    token: Secret | None = key(
        "token", SECRET, "Where the token stands: env:NAME, a variable of the environment, or file:NAME.", default=None
    )
    database: str = key("database", TEXT, "Where values go (version 1).", default="")
    user: str = key("user", TEXT, "The user's name (version 1).", default="")
    password: Secret | None = key("password", SECRET, "Where the password stands: env:NAME or file:NAME.", default=None)
    measurement: str = key("measurement", TEXT, "What the lines begin with; default: the run's name.", default="")

    def mistakes(self) -> Iterator[tuple[str, str, str]]:
        if not self.bucket and not self.database:
            yield "", "it does not say where values go", "add bucket: (version 2 and later) or database: (version 1)"
        for name, other in (("org", "bucket"), ("token", "bucket"), ("user", "database"), ("password", "user")):
            if getattr(self, name) and not getattr(self, other):
                yield name, f"'{name}' has no effect without {other}", f"add {other}:, or remove it"
        if self.bucket and self.database:
            yield "database", "values go to a bucket or to a database", "keep one"

    def make(self) -> Sink:
        return InfluxSink(self)


class InfluxSink(Sink):
    """Writes lines. Raises OSError, http.client.HTTPException, ValueError."""

    def __init__(self, kind: Influx) -> None:
        self.kind = kind
        self._run = ""
        self._points: Mapping[str, Point] = {}
        self._connection: http.client.HTTPConnection | None = None
        self._headers: dict[str, str] = {}
        self._most = MOST_LINES

    def meet(self, host: Host) -> None:
        self._run = host.run

    def open(self, points: Sequence[Point]) -> None:
        self._points = {point.name: point for point in points}
        kind = self.kind
        self._headers = {"Content-Type": "text/plain; charset=utf-8"}
        if kind.token is not None:
            self._headers["Authorization"] = f"Token {kind.token.read()}"
        elif kind.user:
            password = "" if kind.password is None else kind.password.read()
            basic = base64.b64encode(f"{kind.user}:{password}".encode()).decode()
            self._headers["Authorization"] = f"Basic {basic}"
        make = http.client.HTTPSConnection if kind.influx.is_encrypted else http.client.HTTPConnection
        self._connection = make(kind.influx.host, kind.influx.port, timeout=LONGEST_ANSWER)

    def write(self, samples: Sequence[Sampled]) -> int:
        lines: list[str] = []
        count = 0
        for sample in samples:
            if count and len(lines) + len(sample.values) > self._most:
                break
            lines += [self.line(sample.time, one) for one in sample.values]
            count += 1
        if not lines:
            return count
        status, answer = self._post("\n".join(lines).encode())
        if 200 <= status < 300:
            self._most = min(MOST_LINES, 2 * self._most)
            return count
        if status in REFUSED and count == 1:
            raise NeverTakenError(f"{status} {answer}")
        if status in REFUSED:  # one of them is wrong, or all are too many: fewer at once find it
            self._most = max(1, len(lines) // 2)
            return self.write(samples[: max(1, count // 2)])
        raise ConnectionError(f"the server answers {status} {answer}")

    def _post(self, body: bytes) -> tuple[int, str]:
        """Send a request and return status and text of the answer.

        A connection closed by the server meanwhile is opened once more.
        """
        connection, kind = self._connection, self.kind
        assert connection is not None
        query = {"bucket": kind.bucket, "org": kind.org} if kind.bucket else {"db": kind.database}
        path = "/api/v2/write" if kind.bucket else "/write"
        query = {name: value for name, value in query.items() if value} | {"precision": "ns"}
        for is_last in (connection.sock is None, True):
            try:
                connection.request("POST", f"{kind.influx.path}{path}?{urlencode(query)}", body, self._headers)
                with connection.getresponse() as reply:
                    return reply.status, " ".join(reply.read(2000).decode("utf-8", "replace").split())[:200]
            except (http.client.RemoteDisconnected, BrokenPipeError, ConnectionResetError):
                connection.close()
                if is_last:
                    raise
        raise AssertionError("the second try is the last")

    def line(self, time: int, value: PointValue) -> str:
        """Return a line: the measurement, point and unit as tags, then value, text, quality and reason."""
        unit = self._points[value.name].unit
        tags = f",point={_tag(value.name)}" + (f",unit={_tag(unit)}" if unit else "")
        fields = [*_value(self._points[value.name], value), f'quality="{value.quality}"']
        if value.reason:
            fields.append(f"reason={_text(value.reason)}")
        return f"{_tag(self.kind.measurement or self._run, equals='=')}{tags} {','.join(fields)} {time}"

    def close(self) -> None:
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.close()


def _value(point: Point, value: PointValue) -> Iterator[str]:
    """Yield the fields of a value: `value`, always a float, because a field has one type for all points of a
    measurement; `text` for words, and for numbers that a float cannot represent exactly. Yield no field if the quality
    is not good.
    """
    if value.quality != "good":
        return
    number: Any = value.number
    is_exact = isinstance(number, float) or (isinstance(number, int) and abs(number) <= EXACT)
    if isinstance(number, float) or (isinstance(number, int) and abs(number) < LARGEST):
        yield f"value={float(number)!r}"
    if isinstance(value.value, str) or not is_exact:
        yield f"text={_text(str(value.value))}"


def _tag(text: str, equals: str = "") -> str:
    """Return a name or a tag without invalid characters: line ends, a last backslash. `equals` stays unchanged."""
    plain = " ".join(text.split("\n")).rstrip("\\").replace("\r", "")
    return "".join(f"\\{sign}" if sign in ", =" and sign != equals else sign for sign in plain)


def _text(text: str) -> str:
    """Return a text in quotes, with escapes."""
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'
