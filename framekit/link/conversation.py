"""Runs conversation vectors on virtual time: one engine, and a script in place of the other side and the line.

Bytes take the time they take on the line. What is sent is held against the script, with its times (language reference,
section 15). It knows how a client is asked and a server is made only by what `SideUnderTest` has.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from framekit.codec.shown import explain
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.vectors import Conversation, ScriptLine
from framekit.definition.times import NEVER, LineFormat, readable_time
from framekit.link.engine import Engine
from framekit.link.evaluate import EVALUATION_ERRORS, compile_expression
from framekit.link.events import Break, CharacterFault, Command, LineFault, Reopen, Send
from framekit.link.exchange import Ask, MemoryAccess, Server
from framekit.link.frame_table import ProtocolCodec
from framekit.link.frame_vectors import default_line, result_agrees, set_state, state_value
from framekit.link.observe import Monitor, Seen

PATIENCE = 3_600_000_000_000
"""So long a script waits for something to be sent, and a service for its end (ns)."""

Asked = Callable[[Any], None]


@dataclass(slots=True)
class SideUnderTest:
    """What the tested side consists of besides its engine.

    `start` begins what the case asks for: engine, the case's `do`, its station, the time, what to call with the result;
    it returns commands. The result has `ok`, `values`, `outcome`, `code`. `read_memory` gives values at an address.
    `monitor` is shown what happens; `troubles` collects what could not be worked out.
    """

    server: Server | None = None
    memory: MemoryAccess | None = None
    ask: Callable[[Engine], Ask] | None = None
    start: Callable[[Engine, Mapping[str, Any], Any, int, Asked], list[Command]] | None = None
    read_memory: Callable[[str, int], list[int]] | None = None
    monitor: Monitor | None = None
    troubles: list[str] = field(default_factory=list)


MakeSide = Callable[[Conversation, Protocol, ProtocolCodec], SideUnderTest]


@dataclass(slots=True)
class _Sent:
    data: bytes
    started: int
    ended: int


@dataclass(slots=True)
class _Line:
    """What is on the wire: what has been sent and not yet compared, and what waits to be sent.

    `closed_at`: when the tested side has closed its connection, until the script says so.
    """

    sent: deque[_Sent] = field(default_factory=deque)
    waiting: deque[Command] = field(default_factory=deque)
    outgoing: _Sent | None = None
    closed_at: int | None = None


def run_conversation(
    case: Conversation, protocol: Protocol, codec: ProtocolCodec, make_side: MakeSide, line: LineFormat | None = None
) -> list[str]:
    """What does not agree, one sentence each with its place in the file; nothing when the case holds."""
    try:
        return _Player(case, protocol, codec, make_side, line or default_line(protocol)).run()
    except EVALUATION_ERRORS as error:
        return [f"{case.at}: {case.name}: {explain(error)}"]


class _Player:
    def __init__(
        self, case: Conversation, protocol: Protocol, codec: ProtocolCodec, make_side: MakeSide, line: LineFormat | None
    ) -> None:
        self.case = case
        self.now = 0
        self.side = make_side(case, protocol, codec)
        self.engine = Engine(
            protocol, codec, case.role, params=case.params, line=line, own=station_of(protocol, case.own),
            server=self.side.server, memory=self.side.memory, monitor=self.side.monitor,
        )  # fmt: skip
        self.engine.machine.on_fault = self._seen
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
        self._do(self.engine.opened(0))
        if self.case.do is not None:
            if self.side.start is None:
                return [f"{self.case.at}: {self.case.name}: nobody runs services here"]
            self._do(self.side.start(self.engine, self.case.do, self.station, self.now, self.results.append))
        for script in self.case.script:
            getattr(self, f"_{script.kind}")(script)
            if self.problems:
                break
        else:
            self._finish()
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
        """Hands the next command to the line when its time has come."""
        line = self.line
        while line.waiting and line.outgoing is None:
            command = line.waiting[0]
            if isinstance(command, (Send, Break)) and command.not_before > self.now:
                return
            line.waiting.popleft()
            if isinstance(command, Send):
                end = self.now + self.engine.scope.line.chars(len(command.data))
                line.outgoing = _Sent(command.data, self.now, end)
                line.sent.append(line.outgoing)
            elif isinstance(command, Break):
                line.outgoing = _Sent(b"", self.now, self.now + command.duration)
            elif isinstance(command, Reopen):
                line.closed_at = self.now
                self._disconnected(command.reason)

    def _disconnected(self, reason: str) -> None:
        """What was on its way is gone, and the engine is told."""
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
        """Lets time pass to `end`, with everything due before that (not what is due then), or until `stop` says so."""
        while not stop():
            at = self._next_time()
            if at >= end:
                break
            self._reach(at)
        else:
            return
        self.now = max(self.now, end)

    def _reach(self, at: int) -> None:
        """One thing that is due: something has left, may leave, or the engine's time has come."""
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
        if not script.wire.matches(sent.data):
            self._note(script, f"sent {sent.data.hex(' ').upper()}, expected {script.wire}")
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
        """The bytes arrive one by one, as on a wire; on a stream all at once."""
        assert script.wire is not None
        data = script.wire.exact
        if data is None:
            self._note(script, "bytes that are received have to be written out")
            return
        if self._something_sent(script):
            return
        step = self.engine.scope.line.chars(1)
        pieces = [data] if step == 0 else [data[index : index + 1] for index in range(len(data))]
        for piece in pieces:
            self._go_to(self.now + step)
            faults = () if self.fault is None else (CharacterFault(0, self.fault),)
            self.fault = None
            self._do(self.engine.receive(piece, self.now, faults))
        self.before = self.now

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
        """The other side closes it, the tested side has to, or it is open again."""
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
        """Notes what was sent although the script says nothing of it."""
        for sent in self.line.sent:
            data = sent.data.hex(" ").upper()
            self._note(script, f"sent {data} at {readable_time(sent.started)}, which nobody expected")
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
                None, f"the connection was closed at {readable_time(self.line.closed_at)}, which nobody expected"
            )
        if self.results:
            self._judge(self.results[0])
        self._compare_afterwards()

    def _judge(self, result: Any) -> None:
        """Values, error and outcome as far as the case names them; without any of them it has to have gone well."""
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
            values = wanted.values if isinstance(wanted.values, list) else [wanted.values]
            numbers = [state_value("number", value) for value in values]
            if list(result.values) != numbers:
                self._note(None, f"values {list(result.values)}, expected {numbers}")

    def _compare_afterwards(self) -> None:
        wanted = self.case.result
        scope = self.engine.scope
        for name, value in wanted.state.items():
            variable = scope.protocol.state.get(name)
            expected = value if variable is None else state_value(variable.type, value)
            if scope.get(name) != expected:
                self._note(None, f"{name} is {scope.get(name)!r} afterwards, expected {expected!r}")
        for address, value in wanted.memory.items():
            numbers = [state_value("number", item) for item in (value if isinstance(value, list) else [value])]
            if self.side.read_memory is None:
                self._note(None, "there is no memory to compare")
            elif (found := self.side.read_memory(address, len(numbers))) != numbers:
                self._note(None, f"{address} holds {found} afterwards, expected {numbers}")


def station_of(protocol: Protocol, value: Any) -> Any:
    """A station as text to the kind of value that names stations here."""
    return value if value is None else state_value(protocol.station.type, value)
