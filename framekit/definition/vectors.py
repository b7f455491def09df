"""Test cases next to a definition: frames with their bytes, and conversations on virtual time; read, and checked.

Guide: vectors. The content of a case stays plain (text, lists, mappings) until a runner gives it a meaning.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator
from collections.abc import Mapping as MappingOf
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from framekit.definition.check.typed import KindChecker
from framekit.definition.expression import Expression
from framekit.definition.keys import BYTES, NUMBER, TEXT, TIME, Form, KeyReading, key, keys, mapping_of, read_part
from framekit.definition.load.documents import Documents
from framekit.definition.load.reader import Broken, Reader, parse_bytes
from framekit.definition.model.frames import field_names
from framekit.definition.model.protocol import Protocol
from framekit.definition.nodes import Mapping, Node, Scalar
from framekit.definition.problems import Position, Problem, did_you_mean


@dataclass(frozen=True, slots=True)
class Wire:
    """Bytes of a case; None is a byte that is not compared."""

    head: tuple[int | None, ...]
    tail: tuple[int | None, ...] | None = None
    """Bytes after a computed check code; None without a check code."""
    marks: frozenset[int] = frozenset()
    """Indices of the bytes with a ninth bit, those in the tail counted from the end (-1: the last)."""

    @property
    def exact(self) -> bytes | None:
        """Return the bytes if all of them are known; else None."""
        if self.tail is not None or None in self.head:
            return None
        return bytes(byte for byte in self.head if byte is not None)

    def matches(self, data: bytes) -> bool:
        """Return whether `data` matches; a check code takes the remaining bytes at its place, at least one."""
        if self.tail is None:
            return len(data) == len(self.head) and _fit(self.head, data)
        free = len(data) - len(self.head) - len(self.tail)
        return free > 0 and _fit(self.head, data) and _fit(self.tail, data[len(self.head) + free :])

    def marks_match(self, marked: int | None, size: int) -> bool:
        """Return whether `marked`, of `size` bytes, is the marked byte; marks in a check code are not compared."""
        free = range(0) if self.tail is None else range(len(self.head), size - len(self.tail))
        wanted = {place % size for place in self.marks}
        return wanted == (set() if marked is None or marked in free else {marked})

    def __str__(self) -> str:
        words = _words(self.head, self.marks)
        if self.tail is None:
            return " ".join(words)
        size = len(self.tail)
        return " ".join([*words, "check", *_words(self.tail, {place + size for place in self.marks if place < 0})])


def _fit(wanted: tuple[int | None, ...], data: bytes) -> bool:
    return all(byte is None or byte == found for byte, found in zip(wanted, data, strict=False))


def _words(wanted: tuple[int | None, ...], marks: Collection[int]) -> list[str]:
    return ["xx" if byte is None else f"{byte | (place in marks) << 8:02X}" for place, byte in enumerate(wanted)]


def nine_bits(data: bytes, marked: int | None) -> str:
    """Return bytes in the form of a case: `10B 0B`, with the ninth bit before the marked byte."""
    return " ".join(_words(tuple(data), () if marked is None else (marked,)))


KINDS = ("send", "receive", "break", "silence", "wait", "line", "connection")
WORDS = {
    "line": ({word: word for word in ("parity", "framing", "overrun")}, "a fault of the line"),
    "connection": ({word: word for word in ("lost", "closed", "opened")}, "what becomes of a connection"),
}
_WORD = re.compile(r"(?P<what>[0-9A-Za-z]+)(?:\*(?P<times>\d+))?")
_NINE_BITS = re.compile("1[0-9A-Fa-f]{2}")
_MOST_REPEATED = 65_536


def parse_wire(text: str) -> Wire:
    """Parse `1B 41`, `10B` with a ninth bit, `xx`, `00*32`, `check`, names of control characters.

    Raises ValueError with a sentence.
    """
    parts: list[list[int | None]] = [[]]
    marks: list[tuple[int, int]] = []
    for word in text.split():
        match = _WORD.fullmatch(word)
        if match is None:
            raise ValueError(f"'{word}' is no byte of a case – write hex pairs, xx, 00*32 or check")
        if match["what"] == "check" and not match["times"]:
            if len(parts) > 1:
                raise ValueError("there are two check codes – write the bytes of one of them")
            parts.append([])
            continue
        times = int(match["times"] or 1)
        if times > _MOST_REPEATED:
            raise ValueError(f"{times} is too often – a case has at most {_MOST_REPEATED} bytes")
        what = match["what"]
        if is_marked := _NINE_BITS.fullmatch(what) is not None:
            marks += [(len(parts) - 1, len(parts[-1]) + place) for place in range(times)]
        piece: list[int | None] = [None] if what == "xx" else list(parse_bytes(what[is_marked:]))
        parts[-1].extend(piece * times)
    places = frozenset(place if part == 0 else place - len(parts[1]) for part, place in marks)
    return Wire(tuple(parts[0]), tuple(parts[1]) if len(parts) > 1 else None, places)


def plain_of(node: Node | None) -> Any:
    """Return a node as text, lists and mappings."""
    if node is None:
        return None
    if isinstance(node, Scalar):
        return node.text
    if isinstance(node, Mapping):
        return {entry.key.text: plain_of(entry.value) for entry in node.entries}
    return [plain_of(item) for item in node.items]


def _places_of(keys: Mapping) -> dict[str, Position]:
    """Return the place of every value, and of every name in a value that is a mapping."""
    places = {entry.key.text: entry.value.at for entry in keys.entries}
    for entry in keys.entries:
        if isinstance(entry.value, Mapping):
            places |= {f"{entry.key.text}.{inner.key.text}": inner.key.at for inner in entry.value.entries}
    return places


# ---- values of keys ------------------------------------------------------------------------------------------


def _wire(reading: KeyReading, node: Node | None) -> Wire:
    scalar = reading.reader.scalar(node)
    with reading.reader.refusing(scalar.at):
        return parse_wire(scalar.text)


def _plain_entries(reading: KeyReading, node: Node) -> dict[str, Any]:
    return {entry.key.text: plain_of(entry.value) for entry in reading.reader.entries(node)}


Expectation = tuple[Literal["bad", "refused", "noise"], str | int]


def _expectation(reading: KeyReading, node: Node) -> Expectation:
    reader, keys_ = reading.reader, reading.reader.mapping(node)
    kinds: tuple[Literal["refused", "noise"], ...] = ("refused", "noise")
    for kind in kinds:
        if (number := keys_.get(kind)) is not None:
            return kind, reader.number(number)
    return "bad", reader.text(keys_.get("bad"))


PLAIN = Form({}, lambda r, node: plain_of(node))
ENTRIES = Form({}, _plain_entries)
SOME_ENTRIES = Form({}, lambda r, node: _plain_entries(r, node) or None)


def _frame_name(reading: KeyReading) -> str | None:
    frame = reading.reader.maybe(reading.reader.text, reading.keys.get("frame"))
    if frame is None and "expect" not in reading.keys:
        what = "a case needs a frame, or what becomes of its bytes"
        raise reading.reader.broken(reading.keys.at, what, "add frame: or expect:")
    return frame


def _values(reading: KeyReading) -> dict[str, Any] | None:
    """Return the values of a good frame."""
    if reading.found["frame"] is None or "expect" in reading.keys:
        return None
    node = reading.keys.get("values")
    return {} if node is None else _plain_entries(reading, node)


def _kind(reading: KeyReading) -> str:
    kind = next((word for word in KINDS if word in reading.keys), None)
    if kind is None:
        raise Broken("the schema has told what is wrong with the line")
    return kind


def _of_kinds(kinds: Collection[str], read: Callable[[KeyReading, Node | None], Any]) -> Callable[[KeyReading], Any]:
    """Return a reader of an attribute for lines of these kinds; None for other lines."""
    return lambda r: read(r, r.keys.get(r.found["kind"])) if r.found["kind"] in kinds else None


def _script(reading: KeyReading, node: Node) -> tuple[ScriptLine, ...]:
    found = []
    for item in reading.reader.items(node):
        with reading.reader.going_on():
            found.append(read_part(ScriptLine, reading.loader, item))
    return tuple(found)


# ---- the cases -----------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameVector:
    """A frame in both directions, or bytes with their expected fault (`expect`: bad, refused or noise; the cause or
    number).
    """

    at: Position
    places: MappingOf[str, Position] = keys({}, lambda r: _places_of(r.keys), factory=dict)
    """Places of the values of keys, and of entries as `KEY.NAME`; for messages."""
    frame: str | None = keys({"frame": {}}, _frame_name, default=None)
    name: str = keys(
        {"name": {}}, lambda r: r.reader.maybe(r.reader.text, r.keys.get("name")) or r.found["frame"] or ""
    )
    values: MappingOf[str, Any] | None = keys({"values": {}}, _values, default=None)
    wire: Wire = key("bytes", Form({}, _wire))
    side: str | None = key("from", TEXT, default=None)
    params: MappingOf[str, Any] = key("params", ENTRIES, factory=dict)
    state: MappingOf[str, Any] = key("state", ENTRIES, factory=dict)
    request: MappingOf[str, Any] | None = key("request", SOME_ENTRIES, default=None)
    expect: Expectation | None = key("expect", Form({}, _expectation), default=None)
    source: str = key("source", TEXT, default="")


@dataclass(frozen=True, slots=True, kw_only=True)
class ScriptLine:
    """One line of a script. `wire` is for send and receive, `time` for break, silence and wait, else `word`."""

    at: Position
    kind: Literal["send", "receive", "break", "silence", "wait", "line", "connection"] = keys({}, _kind)
    wire: Wire | None = keys({}, _of_kinds(("send", "receive"), _wire), default=None)
    time: Expression | None = keys(
        {}, _of_kinds(("break", "silence", "wait"), lambda r, node: r.reader.expression(node)), default=None
    )
    word: str | None = keys(
        {}, _of_kinds(WORDS, lambda r, node: r.reader.one_of(node, *WORDS[r.found["kind"]])), default=None
    )
    not_before: Expression | None = key("not_before", TIME, default=None)
    within: Expression | None = key("within", TIME, default=None)


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """Expected result; None is not compared. `state` and `memory` are compared afterwards."""

    values: Any = key("values", PLAIN, default=None)
    error: int | None = key("error", NUMBER, default=None)
    outcome: str | None = key("outcome", TEXT, default=None)
    state: MappingOf[str, Any] = key("state", ENTRIES, factory=dict)
    memory: MappingOf[str, Any] = key("memory", ENTRIES, factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Conversation:
    """A conversation of one side: its initial state, the service it is asked to run, and the bytes on the line."""

    at: Position
    places: MappingOf[str, Position] = keys({}, lambda r: _places_of(r.keys), factory=dict)
    script: tuple[ScriptLine, ...] = key("script", Form({}, _script), default=())
    name: str = key("name", TEXT, default="")
    role: str | None = key("role", TEXT, default=None)
    own: Any = key("own", PLAIN, default=None)
    station: Any = key("station", PLAIN, default=None)
    params: MappingOf[str, Any] = key("params", ENTRIES, factory=dict)
    memory: MappingOf[str, Any] = key("memory", ENTRIES, factory=dict)
    state: MappingOf[str, Any] = key("state", ENTRIES, factory=dict)
    random: bytes = key("random", BYTES, default=b"")
    do: MappingOf[str, Any] | None = key("do", SOME_ENTRIES, default=None)
    result: Result = key("result", mapping_of(Result, {}), default=Result())
    source: str = key("source", TEXT, default="")


@dataclass(frozen=True, slots=True, kw_only=True)
class Vectors:
    """The cases of a file; `protocol`: their definition."""

    protocol: str
    about: str
    frames: tuple[FrameVector, ...]
    conversations: tuple[Conversation, ...]
    at: Position
    protocol_at: Position


def read_vectors(path: str | Path) -> tuple[Vectors | None, list[Problem]]:
    """Read the cases of a file and all its problems; None for a file that is no vectors file."""
    reader = Reader()
    documents = Documents(reader)
    vectors = None
    with suppress(Broken):
        vectors = _load(documents, documents.root(Path(path), "vectors"))
    return vectors, documents.first_words(reader.problems, Path(path))


def _load(documents: Documents, root: Mapping) -> Vectors:
    reader = documents.reader
    frames, conversations = [], []
    for node in reader.items(root.get("frames")):
        with reader.going_on():
            frames.append(read_part(FrameVector, documents, node))
    for node in reader.items(root.get("conversations")):
        with reader.going_on():
            conversations.append(read_part(Conversation, documents, node))
    return Vectors(
        protocol=reader.text(root.get("vectors")),
        about=reader.maybe(reader.text, root.get("about")) or "",
        frames=tuple(frames),
        conversations=tuple(conversations),
        at=root.at,
        protocol_at=reader.scalar(root.get("vectors")).at,
    )


BESIDE_SERVICES = (
    "station", "unit", "count", "value", "values", "send", "exchange", "expected", "run",
)  # fmt: skip
"""Keys of `do` that are no service: parameters of a service, and alternatives to a service."""


def role_of(conversation: Conversation, protocol: Protocol) -> str | None:
    """Return the tested role. Without `role:` that is a client's with `do:`, else a server's."""
    if conversation.role is not None:
        return conversation.role
    return protocol.serving_role if conversation.do is None else protocol.asking_role


def check_vectors(vectors: Vectors, protocol: Protocol) -> list[Problem]:
    """Return a problem for each name in the cases that the protocol does not have."""
    found: list[Problem] = []
    for case in vectors.frames:
        found += _frame(case, protocol)
    for conversation in vectors.conversations:
        found += _conversation(conversation, protocol)
    return found


class _CaseCheck:
    """Context of a case: the places of its keys."""

    def __init__(self, at: Position, places: MappingOf[str, Position]) -> None:
        self.at = at
        self.places = places

    def unknown(
        self, key: str, names: Collection[str], known: Collection[str], kind: str, whose: str = "there is"
    ) -> Iterator[Problem]:
        for name in names:
            if name not in known:
                at = self.places.get(f"{key}.{name}") or self.places.get(key) or self.places.get("do", self.at)
                yield Problem(at, f"{whose} no {kind} '{name}'", did_you_mean(name, known))

    def made(self, key: str, frames: Any, protocol: Protocol) -> Iterator[Problem]:
        """Check the names in `{FRAME: {field: value}}`."""
        for frame, fields in frames.items() if isinstance(frames, MappingOf) else ():
            yield from self.unknown(key, [frame], protocol.frames, "frame")
            if frame in protocol.frames and isinstance(fields, MappingOf):
                known = field_names(protocol.frames[frame].segments)
                yield from self.unknown(key, fields, known, "field", f"frame '{frame}' has")


def _frame(vector: FrameVector, protocol: Protocol) -> Iterator[Problem]:
    case = _CaseCheck(vector.at, vector.places)
    yield from case.unknown("params", vector.params, protocol.params, "parameter")
    yield from case.unknown("state", vector.state, protocol.state, "variable")
    yield from case.made("request", vector.request, protocol)
    if vector.wire.marks:
        what = f"{vector.wire} has a ninth bit, and a frame alone has only its bytes"
        yield Problem(vector.places.get("bytes", vector.at), what, "write two digits a byte; a conversation has marks")
    if vector.frame is None:
        return
    if vector.frame not in protocol.frames:
        yield from case.unknown("frame", [vector.frame], protocol.frames, "frame")
        return
    known = field_names(protocol.frames[vector.frame].segments)
    yield from case.unknown("values", vector.values or {}, known, "field", f"frame '{vector.frame}' has")


def _conversation(conversation: Conversation, protocol: Protocol) -> Iterator[Problem]:
    case = _CaseCheck(conversation.at, conversation.places)
    yield from case.unknown("params", conversation.params, protocol.params, "parameter")
    yield from case.unknown("state", conversation.state, protocol.state, "variable")
    if conversation.role is not None:
        yield from case.unknown("role", [conversation.role], protocol.roles, "role")
    checker = KindChecker({})
    for line in conversation.script:
        for time in (line.time, line.not_before, line.within):
            checker.wants(time, "time")
        if line.wire is not None and line.wire.marks and not protocol.line.has_marks:
            what = f"{line.wire} has a ninth bit, and characters of '{protocol.name}' have none"
            yield Problem(line.at, what, "write two digits a byte")
    yield from checker.problems
    yield from case.unknown("result", conversation.result.state, {*protocol.state, *protocol.params}, "variable")
    if conversation.do is not None:
        yield from _asked(case, conversation.do, protocol)
        yield from _cannot_ask(case, conversation, protocol)


def _cannot_ask(case: _CaseCheck, conversation: Conversation, protocol: Protocol) -> Iterator[Problem]:
    """Report `do` for a role that begins no exchanges; every role can send a single frame."""
    role = protocol.roles.get(role_of(conversation, protocol) or "")
    if role is None or role.exchanges or "send" in (conversation.do or {}):
        return
    asking = protocol.asking_role
    what = f"role '{role.name}' begins no exchanges, and 'do' asks it to"
    able = asking is not None and bool(protocol.roles[asking].exchanges)
    todo = f"write role: {asking}" if able else "leave 'do' out, and write what this role receives and sends"
    yield Problem(case.places.get("role") or case.places.get("do", case.at), what, todo)


def _asked(case: _CaseCheck, do: MappingOf[str, Any], protocol: Protocol) -> Iterator[Problem]:
    """Report unknown names in the task of the tested side."""
    for made in ("send", "exchange"):
        yield from case.made(f"do.{made}", do.get(made), protocol)
    expected = do.get("expected", [])
    groups = {group for frame in protocol.frames.values() for group in frame.groups}
    wanted = expected if isinstance(expected, list) else [expected]
    yield from case.unknown("do.expected", wanted, {*protocol.frames, *groups}, "frame")
    yield from case.unknown("do.run", [do["run"]] if "run" in do else [], protocol.sequences, "sequence")
    services = [name for name in do if name not in BESIDE_SERVICES]
    yield from case.unknown("do", services, protocol.services, "service")
    for name in services:
        arguments = do[name]
        if name in protocol.services and name not in ("read", "write") and isinstance(arguments, MappingOf):
            known = {"addresses", *(argument.name for row in protocol.services[name] for argument in row.takes)}
            yield from case.unknown(f"do.{name}", arguments, known, "argument", f"'{name}' takes")
