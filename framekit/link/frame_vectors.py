"""Runs frame vectors: values to bytes and back, and bytes that are bad, refused or noise.

Language reference, section 15. It uses the codec for frames that fit and the receiver for what becomes of others.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from framekit.codec.plain import PlainValues
from framekit.codec.shown import code_text, explain
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.vectors import FrameVector
from framekit.definition.times import NEVER, LineFormat, parse_format
from framekit.link.arrivals import Arrival, BadFrame, FrameArrived
from framekit.link.evaluate import EVALUATION_ERRORS, Names
from framekit.link.frame_table import ProtocolCodec, table_of
from framekit.link.receiver import Receiver
from framekit.link.scope import Scope
from framekit.link.values import FrameValue


def run_frame_vector(vector: FrameVector, protocol: Protocol, codec: ProtocolCodec) -> list[str]:
    """What does not agree, one sentence each; nothing when the case holds."""
    try:
        return _Case(vector, protocol, codec).run()
    except EVALUATION_ERRORS as error:
        return [f"{_title(vector)}: {explain(error)}"]


def _title(vector: FrameVector) -> str:
    return f"{vector.at}: {vector.name or str(vector.wire)[:23]}"


def default_line(protocol: Protocol) -> LineFormat | None:
    """The line a definition has when nobody says otherwise; a stream has none."""
    return None if protocol.line.kind == "stream" else parse_format(protocol.line.format, protocol.line.speed)


class _Case:
    def __init__(self, vector: FrameVector, protocol: Protocol, codec: ProtocolCodec) -> None:
        self.vector = vector
        self.protocol = protocol
        self.codec = codec
        self.table = table_of(protocol, codec)
        self.plain = PlainValues(protocol)
        scope = Scope(protocol, params=vector.params, line=default_line(protocol))
        set_state(scope, vector.state)
        self.names = Names({"request": None, "buffer": b""}, scope)
        if vector.request:
            ((frame, fields),) = vector.request.items()
            made = self.table.made(frame, self.plain.from_plain(frame, fields), scope)
            self.table.encode(made, self.names)
            self.names["request"] = made

    def run(self) -> list[str]:
        problems = self._both_ways() if self.vector.expect is None else self._what_becomes()
        return [f"{_title(self.vector)}: {problem}" for problem in problems]

    # ---- both ways ----------------------------------------------------------------------------------------

    def _both_ways(self) -> list[str]:
        vector = self.vector
        name = vector.frame
        if name is None or name not in self.protocol.frames:
            return [f"there is no frame '{name}'"]
        values = self.plain.from_plain(name, vector.values or {})
        try:
            built = self._built(name, values)
        except ValueError as error:
            return [f"it cannot be built: {error}"]
        problems = []
        if not vector.wire.matches(built):
            problems.append(f"built as {built.hex(' ').upper()}, not {vector.wire}")
        data = vector.wire.exact
        for source, found in (("the bytes", data), ("what was built", built)):
            if found is not None:
                problems += self._read(name, found, values, source)
        return problems

    def _built(self, name: str, values: dict[str, Any]) -> bytes:
        """Building a reply copies what it echoes of the request."""
        value = FrameValue(name, dict(values))
        self.table.fill_echo(value, self.names["request"])
        return self.table.encode(value, self.names)

    def _read(self, name: str, data: bytes, values: Mapping[str, Any], source: str) -> list[str]:
        try:
            fields = self.codec.frames[name].decode(data, self.names)
        except ValueError as error:
            return [f"{source} cannot be read: {error}"]
        numbers = self.table.infos[name].numbers
        problems = []
        for field, wanted in values.items():
            if isinstance(wanted, str) and field in numbers:
                wanted = numbers[field].get(wanted, wanted)
            if field not in fields:
                problems.append(f"{source} have no '{field}'")
            elif not agrees(fields[field], wanted):
                problems.append(f"{source} read as {field} = {fields[field]!r}, not {wanted!r}")
        return problems

    # ---- what becomes of bytes ----------------------------------------------------------------------------

    def _what_becomes(self) -> list[str]:
        vector = self.vector
        data = vector.wire.exact
        assert vector.expect is not None
        if data is None:
            return ["bytes that are received have to be written out"]
        kind, wanted = vector.expect
        arrivals = self._arrivals(data)
        if kind == "noise":
            count = sum(len(item.data) for item in arrivals if not isinstance(item, (FrameArrived, BadFrame)))
            return [] if count == wanted else [f"{count} bytes are noise, not {wanted}: {_told(arrivals)}"]
        first = next((item for item in arrivals if isinstance(item, (FrameArrived, BadFrame))), None)
        if kind == "bad":
            if isinstance(first, BadFrame) and first.cause == wanted:
                return []
        elif isinstance(first, FrameArrived) and first.value.refusal == wanted:
            return []
        return [f"expected {kind} {wanted}, found {_told(arrivals)}"]

    def _arrivals(self, data: bytes) -> list[Arrival]:
        """Everything that the bytes, and the silence behind them, bring."""
        receiver = Receiver(self.codec, self.protocol, self.names, self.table)
        wanted = (self.vector.frame,) if self.vector.frame else self._looked_for()
        found: list[Arrival] = []
        receiver.append(data, 0)
        for now in (0, NEVER - 1):
            receiver.tick(now)
            while (event := receiver.next(wanted)) is not None:
                found.append(event)
        receiver.cut()
        while (event := receiver.next(wanted)) is not None:
            found.append(event)
        return found

    def _looked_for(self) -> tuple[str, ...]:
        side = self.vector.side
        frames = self.protocol.frames
        return tuple(name for name in self.table.on_line if side is None or frames[name].side in (side, "both"))


def _told(arrivals: list[Arrival]) -> str:
    words = []
    for item in arrivals:
        if isinstance(item, FrameArrived):
            refusal = "" if item.value.refusal is None else f" refused with {code_text(item.value.refusal)}"
            words.append(f"frame {item.value.frame}{refusal}")
        elif isinstance(item, BadFrame):
            words.append(f"bad {item.frame} ({item.cause} at byte {item.place})")
        else:
            words.append(f"{len(item.data)} bytes of noise")
    return ", ".join(words) or "nothing"


def agrees(found: Any, wanted: Any) -> bool:
    """Whether a value read has everything that was given; names of numbers deeper inside are not compared."""
    if isinstance(wanted, Mapping):
        return isinstance(found, Mapping) and all(key in found and agrees(found[key], wanted[key]) for key in wanted)
    if isinstance(wanted, list):
        return (
            isinstance(found, list)
            and len(found) == len(wanted)
            and all(agrees(one, other) for one, other in zip(found, wanted, strict=True))
        )
    if isinstance(wanted, str) and isinstance(found, int):
        return True
    return bool(found == wanted)


def set_state(scope: Scope, state: Mapping[str, Any]) -> None:
    """Sets state variables from plain values. Raises ValueError for an unknown one or a value that does not fit."""
    for name, value in state.items():
        variable = scope.protocol.state.get(name)
        if variable is None:
            raise ValueError(f"there is no state variable '{name}'")
        if isinstance(value, Mapping) and variable.keys is not None:
            for key, item in value.items():
                scope.set_entry(name, int(state_value("number", key)), state_value(variable.type, item))
            continue
        if isinstance(value, Mapping) and isinstance(record := scope.get(name), Mapping):
            unknown = [key for key in value if key not in record]
            if unknown:
                raise ValueError(f"state variable '{name}' has no field '{unknown[0]}'")
            value = dict(record) | {key: state_value(_kind_of(record[key]), item) for key, item in value.items()}
        scope.set(name, state_value(variable.type, value))


def state_value(type_: str, value: Any) -> Any:
    """A plain value as a variable of this type holds it."""
    from framekit.definition.load.reader import FLAGS, parse_bytes, parse_number
    from framekit.definition.times import parse_time

    if not isinstance(value, str):
        return value
    if type_ == "flag":
        return FLAGS.get(value.lower(), 1)
    if type_ == "time":
        return parse_time(value)
    if type_ == "bytes":
        return parse_bytes(value) if value.strip() else b""
    return value if type_ in ("text", "record", "frame", "list") else parse_number(value)


def result_agrees(found: Any, wanted: Any) -> bool:
    """Whether a value is what a case says in plain text; of a record only the fields that the case names."""
    if isinstance(wanted, Mapping):
        return isinstance(found, Mapping) and all(
            name in found and result_agrees(found[name], value) for name, value in wanted.items()
        )
    if isinstance(wanted, (list, tuple)):
        return len(found) == len(wanted) and all(result_agrees(*pair) for pair in zip(found, wanted, strict=True))
    return bool(found == state_value(_kind_of(found), wanted))


def _kind_of(value: Any) -> str:
    """The type of variable that holds a value like this one."""
    return "bytes" if isinstance(value, (bytes, bytearray)) else "text" if isinstance(value, str) else "number"
