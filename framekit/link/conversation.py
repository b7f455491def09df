"""Run test vectors on virtual time: frames to bytes and back, and conversations of one engine with a script."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from decimal import Decimal
from typing import Any

from framekit.codec.errors import FrameError
from framekit.codec.plain import PlainValues
from framekit.codec.shown import code_text, explain
from framekit.definition.load.reader import parse_number
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.services import COUNTED_STRING
from framekit.definition.problems import plural
from framekit.definition.times import NEVER, LineFormat, parse_format, readable_time
from framekit.definition.vectors import Conversation, FrameVector, ScriptLine, Wire, nine_bits, role_of
from framekit.link.addresses import AddressGrammar
from framekit.link.arrivals import Arrival, BadFrame, FrameArrived
from framekit.link.engine import Engine
from framekit.link.events import (
    Ask,
    Break,
    CharacterFault,
    Command,
    Exchange,
    LineFault,
    MemoryAccess,
    Monitor,
    Outcome,
    Reopen,
    RequestHandler,
    Seen,
    Send,
)
from framekit.link.frame_table import ProtocolCodec, table_of
from framekit.link.packing import Typed, memory_of, typed_at
from framekit.link.receiver import Receiver
from framekit.link.scope import Scope
from framekit.link.services.client import ServiceClient, TransferResult
from framekit.link.values import EVALUATION_ERRORS, FrameValue, Names, compile_expression
from framekit.link.variables import same_number


def run_frame_vector(vector: FrameVector, protocol: Protocol, codec: ProtocolCodec) -> list[str]:
    """Return the differences, a sentence each; empty if the case holds."""
    try:
        return _Case(vector, protocol, codec).run()
    except EVALUATION_ERRORS as error:
        return [f"{_title(vector)}: {explain(error)}"]


def _title(vector: FrameVector) -> str:
    return f"{vector.at}: {vector.name or str(vector.wire)[:23]}"


def default_line(protocol: Protocol) -> LineFormat | None:
    """Return the default line of a definition; None for a stream, which has no line settings."""
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
        """Return the bytes of a frame; fields of a reply that repeat the request are filled in."""
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
        for path, wanted in values.items():
            if isinstance(wanted, str) and path in numbers:
                wanted = numbers[path].get(wanted, wanted)
            if path not in fields:
                problems.append(f"{source} have no '{path}'")
            elif not agrees(fields[path], wanted):
                problems.append(f"{source} read as {path} = {fields[path]!r}, not {wanted!r}")
        return problems

    # ---- results of received bytes ---------------------------------------------------------------------------

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
        """Return all arrivals of the bytes, and of the silence after them."""
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
            words.append(f"bad {item.frame} ({item.message or f'{item.cause} at byte {item.place}'})")
        else:
            words.append(f"{len(item.data)} bytes of noise")
    return ", ".join(words) or "nothing"


def agrees(found: Any, wanted: Any) -> bool:
    """Return whether a parsed value contains all expected parts.

    Words for numbers in nested values are not compared.
    """
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
    """Set state variables from plain values. Raise ValueError for an unknown variable or a value that does not fit."""
    for name, value in state.items():
        variable = scope.protocol.state.get(name)
        if variable is None:
            raise ValueError(f"there is no state variable '{name}'")
        if isinstance(value, Mapping) and variable.keys is not None:
            for key, item in value.items():
                scope.set_entry(
                    name, int(state_value("number", key)), state_value(variable.type, variable.number_of(item))
                )
            continue
        if isinstance(value, Mapping) and isinstance(record := scope.get(name), Mapping):
            unknown = [key for key in value if key not in record]
            if unknown:
                raise ValueError(f"state variable '{name}' has no field '{unknown[0]}'")
            value = dict(record) | {key: state_value(_kind_of(record[key]), item) for key, item in value.items()}
        scope.set(name, state_value(variable.type, variable.number_of(value)))


def state_value(type_: str, value: Any) -> Any:
    """Return a plain value as a variable of this type holds it."""
    from framekit.definition.load.reader import FLAGS, parse_bytes, parse_number
    from framekit.definition.times import parse_time

    if not isinstance(value, str):
        return value
    if type_ == "flag":
        return FLAGS[value.lower()] if value.lower() in FLAGS else parse_number(value)
    if type_ == "time":
        return parse_time(value)
    if type_ == "bytes":
        return parse_bytes(value) if value.strip() else b""
    if type_ in ("text", "record", "frame", "list"):
        return value
    return Decimal(value) if re.fullmatch(r"\s*-?[0-9]+\.[0-9]+\s*", value) else parse_number(value)


def result_agrees(found: Any, wanted: Any) -> bool:
    """Return whether a value equals the plain value of the case.

    Only the fields of a record that the case names count.
    """
    if isinstance(wanted, Mapping):
        return isinstance(found, Mapping) and all(
            name in found and result_agrees(found[name], value) for name, value in wanted.items()
        )
    if isinstance(wanted, (list, tuple)):
        return len(found) == len(wanted) and all(result_agrees(*pair) for pair in zip(found, wanted, strict=True))
    return same_number(found, state_value(_kind_of(found), wanted))


def _kind_of(value: Any) -> str:
    """Return the type of variable that holds a value of this kind."""
    return "bytes" if isinstance(value, (bytes, bytearray)) else "text" if isinstance(value, str) else "number"


PATIENCE = 3_600_000_000_000
"""Time limit for a script to wait for a transmission, and for a service to end (ns)."""

LONGEST_CHECK = 8
"""Maximum number of bytes of a check code that is computed for `receive`."""

Asked = Callable[[Any], None]


@dataclass(slots=True)
class SideUnderTest:
    """The parts of the tested side besides its engine."""

    server: RequestHandler | None = None
    memory: MemoryAccess | None = None
    ask: Callable[[Engine], Ask] | None = None
    start: Callable[[Engine, Mapping[str, Any], Any, int, Asked], list[Command]] | None = None
    """Begins the call of the case and returns commands.

    Takes the engine, `do` of the case, its station, the time, and the callback for the result, which has `ok`,
    `values`, `outcome` and `code`.
    """
    read_memory: Callable[[str, int], list[int]] | None = None
    """Returns elements from an address on."""
    typed: Callable[[str, int], Typed] | None = None
    """Returns the default type of the elements from an address on."""
    monitor: Monitor | None = None
    """Receives the events."""
    troubles: list[str] = field(default_factory=list)
    """Collects failed expressions."""


MakeSide = Callable[[Conversation, Protocol, ProtocolCodec], SideUnderTest]


@dataclass(slots=True)
class _Sent:
    data: bytes
    started: int
    ended: int
    marked: int | None = None


@dataclass(slots=True)
class _Line:
    """The state of the wire."""

    sent: deque[_Sent] = field(default_factory=deque)
    """Transmissions that have not been compared yet."""
    waiting: deque[Command] = field(default_factory=deque)
    """Commands that wait for the wire."""
    outgoing: _Sent | None = None
    closed_at: int | None = None
    """When the tested side closed its connection, until the script mentions it."""


def run_conversation(
    case: Conversation, protocol: Protocol, codec: ProtocolCodec, make_side: MakeSide, line: LineFormat | None = None
) -> list[str]:
    """Return the differences, a sentence each with its place in the file; empty if the case holds."""
    try:
        return Player(case, protocol, codec, make_side, line or default_line(protocol)).run()
    except EVALUATION_ERRORS as error:
        return [f"{case.at}: {case.name}: {explain(error)}"]


class _Random:
    """Returns the bytes of `random:` of a case in order; `short` is set when they run out."""

    def __init__(self, data: bytes) -> None:
        self.left = data
        self.short = ""

    def take(self, size: int) -> bytes:
        """Return the next bytes. Raise ValueError if fewer are left."""
        if size > len(self.left):
            self.short = f"random({size}) wants {plural(size, 'byte')}, random: of the case has {len(self.left)} left"
            raise ValueError(self.short)
        found, self.left = self.left[:size], self.left[size:]
        return found


class Player:
    def __init__(
        self, case: Conversation, protocol: Protocol, codec: ProtocolCodec, make_side: MakeSide, line: LineFormat | None
    ) -> None:
        self.case = case
        self.codec = codec
        self.table = table_of(protocol, codec)
        self.now = 0
        self.side = make_side(case, protocol, codec)
        self.engine = Engine(
            protocol, codec, role_of(case, protocol), params=case.params, line=line, own=station_of(protocol, case.own),
            server=self.side.server, memory=self.side.memory, monitor=self.side.monitor,
        )  # fmt: skip
        self.engine.machine.on_fault = self._seen
        self.random = _Random(case.random)
        self.engine.scope["functions"].make_random = self.random.take
        if self.side.ask is not None:
            self.engine.machine.ask_service = self.side.ask(self.engine)
        set_state(self.engine.scope, case.state)
        self.station = station_of(protocol, case.station)
        self.line = _Line()
        self.before = 0
        self.fault: LineFault | None = None
        self.results: list[Any] = []
        self.problems: list[str] = []

    def _seen(self, seen: Seen) -> None:
        if seen.kind == "trouble":
            self.side.troubles.append(seen.reason)

    def run(self) -> list[str]:
        if self.engine.protocol.line.has_marks:
            self.engine.hear_marks()
        self._do(self.engine.opened(0))
        if self.case.do is not None:
            if self.side.start is None:
                return [f"{self.case.at}: {self.case.name}: no role of this case runs services"]
            self._do(self.side.start(self.engine, self.case.do, self.station, self.now, self.results.append))
        for script in self.case.script:
            getattr(self, f"_{script.kind}")(script)
            if self.problems:
                break
        else:
            self._finish()
        if self.random.short:
            self._note(None, self.random.short)
        elif self.random.left and not self.problems:
            self._note(None, f"random: has {plural(len(self.random.left), 'byte')} more than are asked for")
        for trouble in self.side.troubles if self.problems else ():
            self._note(None, trouble)
        return self.problems

    def _note(self, script: ScriptLine | None, what: str) -> None:
        at = self.case.at if script is None else script.at
        self.problems.append(f"{at}: {self.case.name}: {what}")

    # ---- the line -----------------------------------------------------------------------------------------

    def _do(self, commands: list[Command]) -> None:
        self.line.waiting.extend(commands)
        self._begin_sending()

    def _begin_sending(self) -> None:
        """Pass the next command to the line when it is due."""
        line = self.line
        while line.waiting and line.outgoing is None:
            command = line.waiting[0]
            if isinstance(command, (Send, Break)) and command.not_before > self.now:
                return
            line.waiting.popleft()
            if isinstance(command, Send):
                end = self.now + self.engine.scope.line.chars(len(command.data))
                line.outgoing = _Sent(command.data, self.now, end, command.marked)
                line.sent.append(line.outgoing)
            elif isinstance(command, Break):
                line.outgoing = _Sent(b"", self.now, self.now + command.duration)
            elif isinstance(command, Reopen):
                line.closed_at = self.now
                self._disconnected(command.reason)

    def _disconnected(self, reason: str) -> None:
        """Drop transmissions under way, and report to the engine that the connection is closed."""
        self.line.waiting.clear()
        self.line.outgoing = None
        self._do(self.engine.closed(self.now, reason))

    def _next_time(self) -> int:
        line = self.line
        times = [self.engine.deadline]
        if line.outgoing is not None:
            times.append(line.outgoing.ended)
        elif line.waiting:
            times.append(getattr(line.waiting[0], "not_before", self.now))
        return max(self.now, min(times))

    def _go_to(self, end: int, stop: Callable[[], bool] = lambda: False) -> None:
        """Let time pass to `end`, with all events before it (not at it), or until `stop` returns true."""
        while not stop():
            at = self._next_time()
            if at >= end:
                break
            self._reach(at)
        else:
            return
        self.now = max(self.now, end)

    def _reach(self, at: int) -> None:
        """Process one event: the end of a transmission, the start of the next, or a deadline of the engine."""
        self.now = at
        line = self.line
        if line.outgoing is not None and line.outgoing.ended <= at:
            line.outgoing = None
            self._do(self.engine.sent(at))
        elif line.outgoing is None and line.waiting and getattr(line.waiting[0], "not_before", 0) <= at:
            self._begin_sending()
        else:
            self._do(self.engine.tick(at))

    def _time(self, expression: Any) -> int:
        return int(compile_expression(expression)(self.engine.scope))

    # ---- lines of a script --------------------------------------------------------------------------------

    def _send(self, script: ScriptLine) -> None:
        assert script.wire is not None
        self._go_to(self.now + PATIENCE, lambda: bool(self.line.sent))
        if not self.line.sent:
            self._note(script, f"nothing was sent, expected {script.wire}")
            return
        sent = self.line.sent.popleft()
        if not (script.wire.matches(sent.data) and script.wire.marks_match(sent.marked, len(sent.data))):
            self._note(script, f"sent {nine_bits(sent.data, sent.marked)}, expected {script.wire}")
        self._check_times(script, "sent", sent.started)
        self._go_to(sent.ended)
        self._go_to(NEVER, lambda: self.line.outgoing is not sent)
        self.before = self.now

    def _check_times(self, script: ScriptLine, what: str, at: int) -> None:
        after = at - self.before
        if script.not_before is not None and after < (least := self._time(script.not_before)):
            self._note(script, f"{what} after {readable_time(after)}, not before {readable_time(least)}")
        if script.within is not None and after > (most := self._time(script.within)):
            self._note(script, f"{what} after {readable_time(after)}, not within {readable_time(most)}")

    def _receive(self, script: ScriptLine) -> None:
        """Let bytes arrive singly, as on a wire; on a stream all at once."""
        assert script.wire is not None
        data = self.with_check(script.wire)
        if data is None:
            what = "bytes that are received have to be written out"
            if script.wire.tail is not None and None not in (*script.wire.head, *script.wire.tail):
                what = f"no frame of the line is {script.wire} with a check code in that place – write its bytes"
            self._note(script, what)
            return
        if self._something_sent(script):
            return
        step = self.engine.scope.line.chars(1)
        pieces = [data] if step == 0 else [data[index : index + 1] for index in range(len(data))]
        for place, piece in enumerate(pieces):
            self._go_to(self.now + step)
            faults: tuple[CharacterFault, ...] = () if self.fault is None else (CharacterFault(0, self.fault),)
            if place in script.wire.marks:
                faults += (CharacterFault(0, LineFault.MARK),)
            self.fault = None
            self._do(self.engine.receive(piece, self.now, faults))
        self.before = self.now

    def with_check(self, wire: Wire) -> bytes | None:
        """Return the bytes with the check code of the first frame that they fit.

        Return None if no frame has a code at this place.
        """
        if wire.tail is None:
            return wire.exact
        head, tail = (bytes(byte for byte in part if byte is not None) for part in (wire.head, wire.tail))
        if (len(head), len(tail)) != (len(wire.head), len(wire.tail)):
            return None
        for name in self.table.on_line:
            for size in range(1, LONGEST_CHECK + 1):
                for digit in (b"\0", b"0"):  # codes in binary, and in digits
                    data = self._corrected(name, head, digit * size, tail)
                    if data is not None:
                        return data
        return None

    def _corrected(self, name: str, head: bytes, code: bytes, tail: bytes) -> bytes | None:
        """Return a frame with its correct code, as shown by the error for a wrong code; None if the frame stays bad."""
        frame, names = self.codec.frames[name], Names({"request": None, "buffer": b""}, self.engine.scope)
        try:
            frame.decode(head + code + tail, names)
            return None  # the code is right by chance (the other digit finds it), or not compared
        except FrameError as error:
            if error.cause != "check" or error.offset != len(head):
                return None
            expected = error.expected
        except EVALUATION_ERRORS:
            return None
        digits = expected.replace(" ", "")
        for right in (bytes.fromhex(digits), digits.upper().encode(), digits.lower().encode()):
            with suppress(*EVALUATION_ERRORS):
                frame.decode(head + right + tail, names)
                return head + right + tail
        return None

    def _break(self, script: ScriptLine) -> None:
        self._go_to(self.now + self._time(script.time))
        self._do(self.engine.line_break(self.now))
        self.before = self.now

    def _silence(self, script: ScriptLine) -> None:
        end = self.now + self._time(script.time)
        self._go_to(end)
        self._something_sent(script)
        self.before = self.now

    def _wait(self, script: ScriptLine) -> None:
        self._go_to(self.now + self._time(script.time))
        self.before = self.now

    def _line(self, script: ScriptLine) -> None:
        self.fault = LineFault(script.word)

    def _connection(self, script: ScriptLine) -> None:
        """Let the other side close the connection, expect the tested side to close it, or open it again."""
        line = self.line
        if script.word == "opened":
            self._do(self.engine.opened(self.now))
        elif script.word == "closed":
            self._go_to(self.now + PATIENCE, lambda: line.closed_at is not None)
            if line.closed_at is None:
                self._note(script, "the connection was not closed")
                return
            self._check_times(script, "closed", line.closed_at)
            line.closed_at = None
        elif not self._something_sent(script):
            self._disconnected("the other side has closed the connection")
        self.before = self.now

    def _something_sent(self, script: ScriptLine | None) -> bool:
        """Note transmissions that the script does not mention."""
        for sent in self.line.sent:
            data = sent.data.hex(" ").upper()
            self._note(script, f"sent {data} at {readable_time(sent.started)}, which was not expected")
        return bool(self.line.sent)

    # ---- the end ------------------------------------------------------------------------------------------

    def _finish(self) -> None:
        if self.case.do is not None:
            self._go_to(self.now + PATIENCE, lambda: bool(self.results))
            if not self.results:
                self._note(None, "what was asked for has not ended")
        self._something_sent(None)
        if self.line.closed_at is not None:
            self._note(
                None, f"the connection was closed at {readable_time(self.line.closed_at)}, which was not expected"
            )
        if self.results:
            self._validate(self.results[0])
        self._compare_afterwards()

    def _validate(self, result: Any) -> None:
        """Compare values, error and outcome with the case; a case that names none of them requires success."""
        wanted = self.case.result
        told = f"outcome '{result.outcome}', {getattr(result, 'cause', '')}"
        if wanted.outcome is None and wanted.error is None and not result.ok:
            self._note(None, f"it failed: {told}")
        if wanted.outcome is not None and result.outcome != wanted.outcome:
            self._note(None, f"{told}, expected '{wanted.outcome}'")
        if wanted.error is not None and getattr(result, "code", None) != wanted.error:
            self._note(None, f"error {getattr(result, 'code', None)}, expected {wanted.error}")
        if isinstance(wanted.values, Mapping) and result.ok:
            if not result_agrees(result.gives, wanted.values):
                self._note(None, f"results {result.gives}, expected {wanted.values}")
        elif wanted.values is not None and result.ok:
            numbers = self._elements_read(wanted.values if isinstance(wanted.values, list) else [wanted.values])
            if list(result.values) != numbers:
                self._note(None, f"values {list(result.values)}, expected {numbers}")

    def _elements_read(self, values: list[Any]) -> list[int]:
        """Return the expected values of a read: in the unit of the addresses, unless the case reads another unit."""
        do = self.case.do or {}
        read = do.get("read")
        if read is None or "unit" in do:
            return [state_value("number", value) for value in values]
        return elements_at(self.engine.scope.protocol, read, values)

    def _compare_afterwards(self) -> None:
        wanted = self.case.result
        scope = self.engine.scope
        for name, value in wanted.state.items():
            variable = scope.protocol.state.get(name)
            expected = value if variable is None else state_value(variable.type, variable.number_of(value))
            if not same_number(scope.get(name), expected):
                shown = str(expected) if isinstance(expected, Decimal) else repr(expected)
                self._note(None, f"{name} is {scope.get(name)!r} afterwards, expected {shown}")
        for address, value in wanted.memory.items():
            values = value if isinstance(value, list) else [value]
            if self.side.read_memory is None or self.side.typed is None:
                self._note(None, "there is no memory to compare")
                continue
            how, found = self.side.typed(address, len(values)), self.side.read_memory(address, len(values))
            wanted_elements = elements_of(how, values)
            if found != wanted_elements:
                typed = [how.values(memory_of(one, how.carrier), one) for one in (found, wanted_elements)]
                self._note(None, f"{address} holds {typed[0]} afterwards, expected {typed[1]}")


def elements_at(protocol: Protocol, where: str | Sequence[str], values: Sequence[Any]) -> list[int]:
    """Return the elements of plain values that a client reads or writes: from one address on, or at each address.

    Raise ValueError for a value that does not fit.
    """
    grammar = AddressGrammar(protocol.addresses, protocol.areas, protocol.tables)
    if isinstance(where, str):
        return elements_of(typed_at(grammar, where, None, None, len(values)), values)
    if len(where) != len(values):
        raise ValueError(f"{len(values)} values stand for {len(where)} addresses – give one for each")
    hows = [typed_at(grammar, one, None, None, 1) for one in where]
    return [_element(how, value) for how, value in zip(hows, values, strict=True)]


def elements_of(how: Typed, values: Sequence[Any]) -> list[int]:
    """Return the elements of plain values of a type; a hexadecimal number is the element itself. Raise ValueError."""
    return [_element(how, value) for value in values]


def _element(how: Typed, value: Any) -> int:
    if how.type == COUNTED_STRING:
        return how.numbers([value])[0]
    number = state_value("number", value)
    if isinstance(value, str) and "x" in value.lower():
        return int(number)
    return how.numbers([float(number) if isinstance(number, Decimal) else number])[0]


def station_of(protocol: Protocol, value: Any) -> Any:
    """Return a station given as text in the form that the protocol uses."""
    return value if value is None else state_value(protocol.station.type, value)


class CaseStarter:
    """Begins the call of a case: `read`, `write`, another service, or `send: {FRAME: {…}}` for a frame by itself."""

    def __init__(self, protocol: Protocol, codec: ProtocolCodec) -> None:
        self.protocol = protocol
        self.codec = codec

    def start(self, engine: Engine, do: Mapping[str, Any], station: Any, now: int, on_done: Asked) -> list[Command]:
        """Begin the call and return its commands. Raise ValueError for an invalid call."""
        given = dict(do)
        unit, count = given.pop("unit", None), parse_number(given.pop("count", "1"))
        if "station" in given:
            station = station_of(self.protocol, given.pop("station"))
        if "send" in given:
            return self._send(engine, given["send"], now, on_done)
        if "exchange" in given:
            return self._exchange(engine, given, station, now, on_done)
        client = ServiceClient(self.protocol, self.codec, engine)
        if "read" in given:
            address = given["read"]
            if isinstance(address, list):
                return client.read_variables(address, station=station, unit=unit, now=now, on_done=on_done).commands
            return client.read(address, station=station, unit=unit, count=count, now=now, on_done=on_done).commands
        if "write" in given:
            return self._write(client, given["write"], given.get("values"), station, unit, now, on_done)
        ((service, arguments),) = given.items()
        plain = dict(arguments) if isinstance(arguments, Mapping) else {}
        addresses = plain.pop("addresses", [])
        return client.call(
            service, plain, station=station, unit=unit, count=count, now=now, on_done=on_done,
            addresses=addresses if isinstance(addresses, list) else [addresses],
        ).commands  # fmt: skip

    def _write(
        self, client: ServiceClient, where: Any, values: Any, station: Any, unit: str | None, now: int, on_done: Asked
    ) -> list[Command]:
        """Write `values: [...]` to consecutive places (`write: ADDRESS`), or one to each of `write: [ADDRESSES]`."""
        if isinstance(where, Mapping):
            where, values = list(where), list(where.values())
            if len(where) == 1:
                where, values = where[0], values[0]
        if values is None:
            raise ValueError("write needs values: write: ADDRESS, values: [...]")
        given = values if isinstance(values, list) else [values]
        numbers = [parse_number(item) for item in given] if unit else elements_at(self.protocol, where, given)
        if isinstance(where, list):
            return client.write_variables(where, numbers, station=station, unit=unit, now=now, on_done=on_done).commands
        return client.write(where, numbers, station=station, unit=unit, now=now, on_done=on_done).commands

    def _send(self, engine: Engine, what: Any, now: int, on_done: Asked) -> list[Command]:
        """Send a frame by itself; it is done when the frame has been sent."""
        ((frame, fields),) = what.items()
        values = PlainValues(self.protocol).from_plain(frame, fields or {})
        return engine.send_frame(frame, now, values, on_sent=lambda: on_done(TransferResult(True)))

    def _exchange(
        self, engine: Engine, given: Mapping[str, Any], station: Any, now: int, on_done: Asked
    ) -> list[Command]:
        """Run a procedure without a service: `exchange: {FRAME: {…}}`, `expected: [FRAMES]`, `run: SEQUENCE`."""
        ((frame, fields),) = given["exchange"].items()
        values = PlainValues(self.protocol).from_plain(frame, fields or {})
        expected = given.get("expected", [])

        def ended(outcome: Outcome) -> None:
            on_done(TransferResult(outcome.ok, outcome=outcome.outcome, cause=outcome.cause, raw=outcome.raw))

        exchange = Exchange(
            run=given.get("run"),
            station=station,
            request=engine.table.made(frame, values, engine.scope),
            expected=tuple(expected if isinstance(expected, list) else [expected]),
            on_done=ended,
        )
        return engine.start(exchange, now)
