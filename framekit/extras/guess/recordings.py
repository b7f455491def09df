"""Unknown lines from Python: bytes of files, and statements about them.

`heard` reads captures, hex text and pcap files of TCP or UDP; `guess` returns statements; `reading_of` decodes with a
definition. `known_lines` tries the shipped definitions. `draft` writes the result as YAML.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, NamedTuple

from framekit.api.errors import RequestError
from framekit.codec.codec import compile_protocol
from framekit.definition.load.protocol import load_protocol
from framekit.definition.model.protocol import Protocol
from framekit.definition.problems import error_text, library_missing, plural
from framekit.extras.archive.archive import captured_values
from framekit.extras.guess.guess import guess as guess
from framekit.extras.guess.model import Direction
from framekit.extras.guess.model import Evidence as Evidence
from framekit.extras.guess.model import Guess as Guess
from framekit.extras.guess.model import HeardBytes as HeardBytes
from framekit.extras.guess.model import Statement as Statement
from framekit.extras.guess.times import GuessedTimes as GuessedTimes
from framekit.extras.guess.times import TimeSpread as TimeSpread
from framekit.link.events import Seen
from framekit.link.listener import Listener
from framekit.service.capture import CaptureError, CaptureReader

LARGEST = 16 << 20
"""Number of bytes of one file that are read."""
NEARLY_ALL = 0.9
LEAST_FRAMES = 3

_HEX_LINE = re.compile(
    r"\s*(?:(?P<time>[0-9]+(?:\.[0-9]+)?)\s+(?=[<>→←-]|out\b|in\b|tx\b|rx\b))?"
    r"(?:(?P<way>>|<|->|<-|→|←|out|in|tx|rx)\s*:?\s+)?(?P<bytes>(?:[0-9a-f]{2}[\s,:]*)+)",
    re.IGNORECASE,
)
_LIKE_HEX = re.compile(r"[0-9a-fxh\s,:;.<>→←\\-]+|(?:out|in|tx|rx).*", re.IGNORECASE)
_WAYS: dict[str, Direction] = {
    ">": "out", "->": "out", "→": "out", "out": "out", "tx": "out",
    "<": "in", "<-": "in", "←": "in", "in": "in", "rx": "in",
}  # fmt: skip


class HeardError(ValueError):
    """Raised for a file without bytes of a line, or an unreadable file."""


def heard(path: Path) -> list[HeardBytes]:
    """Return the bytes of a file, in order. Raises HeardError.

    Captures of framekit (pcap and JSON lines), pcap files of TCP and UDP (needs dpkt), else hex text: a line for the
    bytes that arrived together, preceded by a time in seconds, if known, and by `>` or `<` for the direction. Any other
    file holds the bytes themselves, without times and directions.
    """
    try:
        with path.open("rb") as file:
            head = file.read(LARGEST + 1)
    except OSError as error:
        raise HeardError(f"{path}: {error_text(error)}") from None
    if len(head) > LARGEST:
        raise HeardError(f"{path} has more than {LARGEST >> 20} MiB – cut a part out")
    if head[:1] == b"{" or head[:4] in _PCAPS:
        return _of_capture(path, head)
    text = _hex_text(head)
    return [HeardBytes(None, "", head)] if text is None else _of_text(path, text)


def _hex_text(head: bytes) -> str | None:
    """Return the content of a file if it is meant as hex text: one line is, or it has no other characters."""
    try:
        text = head.decode("utf-8")
    except UnicodeDecodeError:
        return None
    lines = [line for part in text.splitlines() if (line := part.partition("#")[0].strip())]
    if not lines or any(map(_HEX_LINE.fullmatch, lines)) or all(map(_LIKE_HEX.fullmatch, lines)):
        return text
    return None


_PCAPS = {bytes.fromhex(magic) for magic in ("a1b2c3d4", "d4c3b2a1", "a1b23c4d", "4d3cb2a1", "0a0d0d0a")}


def _of_capture(path: Path, head: bytes) -> list[HeardBytes]:
    try:
        with CaptureReader(path) as reader:
            return [
                HeardBytes(event.at, event.direction or "", event.data)
                for _, event in reader.events()
                if event.kind == "data" and event.data
            ]
    except CaptureError as error:
        if head[:1] == b"{":
            raise HeardError(str(error)) from None
    return chunks_of_pcap(path)


def _of_text(path: Path, text: str) -> list[HeardBytes]:
    found = []
    for number, line in enumerate(text.splitlines(), 1):
        line = line.partition("#")[0].strip()
        if not line:
            continue
        match = _HEX_LINE.fullmatch(line)
        if match is None:
            what = "this is no line of hex digits"
            raise HeardError(f"{path}:{number}:1: {what} – write 01 03 00 00, > 01 03, or with a time 0.500 > 01 03")
        time = None if match["time"] is None else round(float(match["time"]) * 1e9)
        way = _WAYS[match["way"].lower()] if match["way"] else ""
        found.append(HeardBytes(time, way, bytes.fromhex(re.sub(r"[\s,:]", "", match["bytes"]))))
    return found


# ---- definitions -------------------------------------------------------------------------------------------------


def seen_by(protocol: Protocol, chunks: Sequence[HeardBytes]) -> list[Seen]:
    """Return the frames, bad frames and noise that a definition finds in the bytes, in order.

    With two directions, the client's bytes are the sent ones; or the received ones, if the definition then reads more
    of them.
    """
    both = len({chunk.direction for chunk in chunks}) > 1
    whole = sum(len(chunk.data) for chunk in chunks)
    ways: tuple[Literal["in", "out"] | None, ...] = ("out", "in") if both else (None,)
    best: list[Seen] = []
    most = -1
    for way in ways:
        seen: list[Seen] = []
        listen(protocol, chunks, way, seen.append)
        covered = sum(len(one.raw) for one in seen if one.kind == "frame")
        if covered > most:
            best, most = seen, covered
        if covered >= NEARLY_ALL * whole:
            break
    return best


def listen(
    protocol: Protocol,
    chunks: Sequence[HeardBytes],
    client: Literal["in", "out"] | None,
    monitor: Callable[[Seen], None],
) -> None:
    """Pass the bytes to a listener of a definition; bytes without a time are spaced by one second."""
    listener = Listener(protocol, compile_protocol(protocol), monitor, client=client)
    now = 0
    for number, chunk in enumerate(chunks):
        at = chunk.time if chunk.time is not None else number * 1_000_000_000
        now = max(now, at + listener.scope.line.chars(len(chunk.data)))
        listener.receive(chunk.data, now, (), chunk.direction)
    listener.ended(now + 1_000_000_000)


# ---- going on ---------------------------------------------------------------------------------------------------


class HeardPoint(NamedTuple):
    """An element of a device's memory as seen on a line: its address after its station, and its values in order."""

    name: str
    values: list[Any]

    @property
    def told(self) -> str:
        """Return the values as text: the only value, or the number and range of the values."""
        numbers = sorted(one for one in self.values if isinstance(one, (int, float)))
        if len(self.values) == 1 or len(numbers) < len(self.values):
            return str(self.values[-1])
        return f"{numbers[0]} to {numbers[-1]}, {len(numbers)} values"


def heard_points(name: str | Path, chunks: Sequence[HeardBytes]) -> list[HeardPoint]:
    """Return the values in devices that requests and replies of a definition carry; an empty list if they carry
    none.
    """
    protocol = load_protocol(name)
    found: dict[str, list[Any]] = {}
    with suppress(RequestError):
        for one in captured_values(((1, seen) for seen in seen_by(protocol, chunks)), protocol, str(name), {}):
            found.setdefault(one.point, []).append(one.value)
    return [HeardPoint(point, values) for point, values in sorted(found.items())]


class DefinitionReading(NamedTuple):
    """The bytes of recordings read by a definition: in words, and for programs."""

    text: str
    data: dict[str, Any]


def reading_of(name: str | Path, chunks: Sequence[HeardBytes]) -> DefinitionReading:
    """Return frames, noise and bad frames of a line read by a definition, and the behaviour of fields.

    Raises DefinitionError.
    """
    seen = seen_by(load_protocol(name), chunks)
    counts = Counter(one.kind for one in seen)
    fields: dict[str, dict[str, list[Any]]] = defaultdict(lambda: defaultdict(list))
    for one in seen:
        if one.kind == "frame":
            for key, value in one.fields.items():
                fields[one.frame][key].append(value)
    noise = sum(len(one.raw) for one in seen if one.kind == "noise")
    lines = [
        f"{plural(counts['frame'], 'frame')}, {counts['bad']} bad, {noise} bytes of noise"
        f" of {sum(len(chunk.data) for chunk in chunks)}"
    ]
    data: dict[str, Any] = {"frames": counts["frame"], "bad": counts["bad"], "noise": noise, "fields": {}}
    for frame, columns in fields.items():
        for key, values in columns.items():
            behaviour = _behaviour(key, values, columns)
            if behaviour:
                lines.append(f"{frame}.{key}: {behaviour}")
                data["fields"][f"{frame}.{key}"] = behaviour
    points = heard_points(name, chunks)
    lines += [f"{point.name}: {point.told}" for point in points]
    data["values"] = {point.name: point.values for point in points}
    return DefinitionReading("\n".join(lines), data)


def _behaviour(key: str, values: list[Any], columns: dict[str, list[Any]]) -> str:
    """Return the common property of all values of a field, in words; '' if none."""
    if len(values) < LEAST_FRAMES:
        return ""
    shown = {repr(value) for value in values}
    if len(shown) == 1:
        return f"always {shown.pop()}"
    for other, beside in columns.items():
        if other < key and beside == values:
            return f"the same as {other}"
    numbers = [value for value in values if isinstance(value, int)]
    if len(numbers) == len(values) and len(values) > 3:
        steps = {after - before for before, after in pairwise(numbers)}
        if len(steps) == 1:
            return f"goes up by {steps.pop()} from frame to frame"
    return f"{len(shown)} values"


# ---- pcap files of TCP and UDP, as programs such as tcpdump keep them; they need dpkt -------------------------


SECOND = 1_000_000_000


class NetworkCaptureError(ValueError):
    """Raised for a file that holds no TCP or UDP, or cannot be read; the text contains the remedy."""


class _Packet(NamedTuple):
    time: int
    place: tuple[Any, ...]
    sequence: int | None
    data: bytes


def chunks_of_pcap(path: Path) -> list[HeardBytes]:
    """Return the bytes of the connections in order, without repetitions; the side that sends first is `out`.

    Raises NetworkCaptureError.
    """
    try:
        import dpkt
    except ModuleNotFoundError:
        raise NetworkCaptureError(f"{path}: " + library_missing("a capture of TCP or UDP", "dpkt")) from None
    try:
        with path.open("rb") as file:
            packets = list(_packets(dpkt, dpkt.pcap.UniversalReader(file)))
    except (OSError, ValueError, dpkt.dpkt.Error) as error:
        raise NetworkCaptureError(f"{path}: {error}") from None
    found: list[HeardBytes] = []
    ways: dict[frozenset[Any], Any] = {}
    next_byte: dict[Any, int] = {}
    for packet in packets:
        source = packet.place[0]
        first = ways.setdefault(frozenset(packet.place), source)
        way: Direction = "out" if source == first else "in"
        data = packet.data
        if packet.sequence is not None:
            wanted = next_byte.get(packet.place, packet.sequence)
            again = (wanted - packet.sequence) % (1 << 32)
            if again < 1 << 31:
                data = data[again:]
            next_byte[packet.place] = (packet.sequence + len(packet.data)) % (1 << 32)
        if data:
            found.append(HeardBytes(packet.time, way, data))
    if not found:
        raise NetworkCaptureError(f"{path} has no bytes of TCP or UDP")
    return found


def _packets(dpkt: Any, reader: Any) -> Iterator[_Packet]:
    links = {
        dpkt.pcap.DLT_EN10MB: dpkt.ethernet.Ethernet, dpkt.pcap.DLT_LINUX_SLL: dpkt.sll.SLL,
        dpkt.pcap.DLT_LINUX_SLL2: dpkt.sll2.SLL2, dpkt.pcap.DLT_RAW: dpkt.ip.IP, 101: dpkt.ip.IP,
        dpkt.pcap.DLT_NULL: dpkt.loopback.Loopback,
    }  # fmt: skip
    read = links.get(reader.datalink())
    if read is None:
        raise NetworkCaptureError(f"the link type {reader.datalink()} is not read – record with tcpdump")
    for time, raw in reader:
        try:
            packet = read(raw)
        except dpkt.dpkt.Error:
            continue
        ip = packet if isinstance(packet, dpkt.ip.IP) else packet.data
        inner = getattr(ip, "data", None)
        if isinstance(inner, (dpkt.tcp.TCP, dpkt.udp.UDP)) and inner.data:
            place = ((ip.src, inner.sport), (ip.dst, inner.dport))
            yield _Packet(round(time * SECOND), place, getattr(inner, "seq", None), bytes(inner.data))
