"""Vectors files: nodes to test cases. Values stay plain; bytes and times get their meaning here."""

from __future__ import annotations

import re
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal, cast

from framekit.definition.load.documents import Documents
from framekit.definition.load.reader import Broken, Reader, parse_bytes
from framekit.definition.model.vectors import Conversation, FrameVector, Result, ScriptLine, Vectors, Wire
from framekit.definition.nodes import Mapping, Node, Scalar
from framekit.definition.problems import DefinitionError, Position, Problem

KINDS = ("send", "receive", "break", "silence", "wait", "line", "connection")
WORDS = {
    "line": ({word: word for word in ("parity", "framing", "overrun")}, "a fault of the line"),
    "connection": ({word: word for word in ("lost", "closed", "opened")}, "what becomes of a connection"),
}
_WORD = re.compile(r"(?P<what>[0-9A-Za-z]+)(?:\*(?P<times>\d+))?")
_MOST_REPEATED = 65_536


def load_vectors(path: str | Path) -> Vectors:
    """The cases of a file. Raises DefinitionError with every problem of it."""
    vectors, problems = read_vectors(path)
    if vectors is None or any(not problem.warning for problem in problems):
        raise DefinitionError(problems)
    return vectors


def read_vectors(path: str | Path) -> tuple[Vectors | None, list[Problem]]:
    """The cases of a file that can be read, and every problem of it; None for what is no vectors file at all."""
    reader = Reader()
    documents = Documents(reader)
    vectors = None
    with suppress(Broken):
        vectors = _VectorsLoader(reader).load(documents.root(Path(path), "vectors"))
    return vectors, documents.first_words(reader.problems, Path(path))


def parse_wire(text: str) -> Wire:
    """`1B 41`, `xx`, `00*32`, `check`, names of control characters. Raises ValueError with a sentence."""
    parts: list[list[int | None]] = [[]]
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
        piece: list[int | None] = [None] if match["what"] == "xx" else list(parse_bytes(match["what"]))
        parts[-1].extend(piece * times)
    return Wire(tuple(parts[0]), tuple(parts[1]) if len(parts) > 1 else None)


def plain_of(node: Node | None) -> Any:
    """A node as text, lists and mappings."""
    if node is None:
        return None
    if isinstance(node, Scalar):
        return node.text
    if isinstance(node, Mapping):
        return {entry.key.text: plain_of(entry.value) for entry in node.entries}
    return [plain_of(item) for item in node.items]


def _places_of(keys: Mapping) -> dict[str, Position]:
    """Where every value stands, and every name in one that is a mapping."""
    places = {entry.key.text: entry.value.at for entry in keys.entries}
    for entry in keys.entries:
        if isinstance(entry.value, Mapping):
            places |= {f"{entry.key.text}.{inner.key.text}": inner.key.at for inner in entry.value.entries}
    return places


class _VectorsLoader:
    def __init__(self, reader: Reader) -> None:
        self.reader = reader

    def load(self, root: Mapping) -> Vectors:
        reader = self.reader
        frames, conversations = [], []
        for node in reader.items(root.get("frames")):
            with reader.going_on():
                frames.append(self._frame(reader.mapping(node)))
        for node in reader.items(root.get("conversations")):
            with reader.going_on():
                conversations.append(self._conversation(reader.mapping(node)))
        return Vectors(
            protocol=reader.text(root.get("vectors")),
            about=self._text(root, "about"),
            frames=tuple(frames),
            conversations=tuple(conversations),
            at=root.at,
            protocol_at=reader.scalar(root.get("vectors")).at,
        )

    def _text(self, keys: Mapping, key: str) -> str:
        return self.reader.maybe(self.reader.text, keys.get(key)) or ""

    def _mapping(self, keys: Mapping, key: str) -> dict[str, Any]:
        return {entry.key.text: plain_of(entry.value) for entry in self.reader.entries(keys.get(key))}

    def _wire(self, node: Node | None) -> Wire:
        scalar = self.reader.scalar(node)
        try:
            return parse_wire(scalar.text)
        except ValueError as error:
            what, _, todo = str(error).partition(" – ")
            raise self.reader.broken(scalar.at, what, todo) from None

    def _frame(self, keys: Mapping) -> FrameVector:
        reader = self.reader
        frame = reader.maybe(reader.text, keys.get("frame"))
        expect = keys.get("expect")
        if frame is None and expect is None:
            raise reader.broken(keys.at, "a case needs a frame, or what becomes of its bytes", "add frame: or expect:")
        return FrameVector(
            at=keys.at,
            name=self._text(keys, "name") or frame or "",
            frame=frame,
            values=self._mapping(keys, "values") if frame is not None and expect is None else None,
            wire=self._wire(keys.get("bytes")),
            side=reader.maybe(reader.text, keys.get("from")),
            params=self._mapping(keys, "params"),
            state=self._mapping(keys, "state"),
            request=self._mapping(keys, "request") or None,
            expect=None if expect is None else self._expectation(reader.mapping(expect)),
            source=self._text(keys, "source"),
            second_source=self._text(keys, "second_source"),
            places=_places_of(keys),
        )

    def _expectation(self, keys: Mapping) -> tuple[Literal["bad", "refused", "noise"], str | int]:
        reader = self.reader
        kinds: tuple[Literal["refused", "noise"], ...] = ("refused", "noise")
        for kind in kinds:
            if (node := keys.get(kind)) is not None:
                return kind, reader.number(node)
        return "bad", reader.text(keys.get("bad"))

    def _conversation(self, keys: Mapping) -> Conversation:
        reader = self.reader
        script = []
        for node in reader.items(keys.get("script")):
            with reader.going_on():
                script.append(self._line(reader.mapping(node)))
        result = keys.get("result")
        return Conversation(
            at=keys.at,
            name=self._text(keys, "name"),
            role=reader.maybe(reader.text, keys.get("role")),
            own=plain_of(keys.get("own")),
            station=plain_of(keys.get("station")),
            params=self._mapping(keys, "params"),
            memory=self._mapping(keys, "memory"),
            state=self._mapping(keys, "state"),
            do=self._mapping(keys, "do") or None,
            script=tuple(script),
            result=Result() if result is None else self._result(reader.mapping(result)),
            source=self._text(keys, "source"),
            second_source=self._text(keys, "second_source"),
            places=_places_of(keys),
        )

    def _line(self, keys: Mapping) -> ScriptLine:
        reader = self.reader
        kind = next((word for word in KINDS if word in keys), None)
        if kind is None:
            raise Broken("the schema has told what is wrong with the line")
        node = keys.get(kind)
        return ScriptLine(
            at=keys.at,
            kind=cast(Any, kind),
            wire=self._wire(node) if kind in ("send", "receive") else None,
            time=reader.expression(node) if kind in ("break", "silence", "wait") else None,
            word=reader.one_of(node, *WORDS[kind]) if kind in WORDS else "",
            not_before=reader.maybe(reader.expression, keys.get("not_before")),
            within=reader.maybe(reader.expression, keys.get("within")),
        )

    def _result(self, keys: Mapping) -> Result:
        reader = self.reader
        return Result(
            values=plain_of(keys.get("values")),
            error=reader.maybe(reader.number, keys.get("error")),
            outcome=reader.maybe(reader.text, keys.get("outcome")),
            state=self._mapping(keys, "state"),
            memory=self._mapping(keys, "memory"),
        )
