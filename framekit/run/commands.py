"""Command blocks of one channel: words of memory become exchanges with the other side and end in a status word.

The application of commands names the frame by which words are read; `meaning_of` explains a block without an exchange.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from framekit.codec.codec import compile_protocol
from framekit.codec.plain import PlainValues
from framekit.codec.shown import explain
from framekit.definition.model.frames import fixed_size, parts_of
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Inner, Length
from framekit.definition.model.services import CommandRules
from framekit.definition.problems import plural
from framekit.definition.times import NEVER
from framekit.link.addresses import Address, AddressError
from framekit.link.arrivals import BadFrame, FrameArrived
from framekit.link.engine import Engine
from framekit.link.events import Command as LinkCommand
from framekit.link.frame_table import FrameTable, ProtocolCodec
from framekit.link.packing import cut_memory, values_of
from framekit.link.receiver import Receiver
from framekit.link.scope import CommandScope, Scope
from framekit.link.services.areas import DeviceAreas, Span, address_of, codes_of, span_of
from framekit.link.services.client import ServiceClient, Transfer, TransferResult
from framekit.link.services.server import MemoryServer
from framekit.link.services.work import (
    CompiledAfter,
    CompiledBlock,
    CompiledPlace,
    Work,
    assign,
    compile_afters,
)
from framekit.link.values import EVALUATION_ERRORS, FrameValue, Names, compile_expression
from framekit.link.variables import ParameterError
from framekit.memory.memory import DeviceMemory, DeviceMemoryError, UnknownAreaError, unit_bits
from framekit.run.block_state import Failure


class CommandFaultError(ValueError):
    """The words are not a command block, or its status word has no place, so no status word can report the fault.

    `segment` is the segment at fault, if a segment is at fault, `found` its content.
    """

    def __init__(self, message: str, segment: str = "", found: str = "") -> None:
        super().__init__(message)
        self.segment = segment
        self.found = found


class StatusPlaceError(CommandFaultError):
    """The status word of a command has no place."""


@dataclass(frozen=True, slots=True)
class CommandFrame:
    """A command block that was read: the whole record, the request inside it, and its bytes in memory's form.

    `request.refusal` is the code by which the frame itself refuses the request.
    """

    block: FrameValue
    request: FrameValue
    raw: bytes


class CommandWords:
    """Read and make the command blocks of one application. Raise ValueError if it has no command blocks."""

    def __init__(self, application: Protocol, codec: ProtocolCodec, table: FrameTable, names: Names) -> None:
        self.application = application
        self.rules = rules_of(application)
        self._codec = codec
        self._table = table
        self._names = names
        segments = application.frames[self.rules.frame].segments
        before = itertools.takewhile(lambda segment: segment.name != self.rules.request, segments)
        self.head_size = sum(fixed_size(segment) or 0 for segment in before)
        """Number of bytes of a block before the request."""
        counts = (one.name for one in segments if isinstance(one, Length) and self.rules.request in one.of)
        self.length = next(counts, "")

    def read(self, data: bytes) -> CommandFrame:
        """Return the command that begins at the first of these bytes; bytes after it are ignored.

        Raise CommandFaultError.
        """
        receiver = Receiver(self._codec, self.application, self._names, self._table)
        receiver.append(data, 0)
        found = receiver.next((self.rules.frame,))
        if isinstance(found, FrameArrived):
            request = found.value.fields.get(self.rules.request)
            if isinstance(request, FrameValue):
                return CommandFrame(found.value, request, found.raw)
            raise CommandFaultError("it holds no command that is known")
        if isinstance(found, BadFrame):
            text = f"'{found.segment}' is {found.found}, expected {found.expected}"
            raise CommandFaultError(text, found.segment, found.found)
        raise CommandFaultError("it has more words than there are")

    def head_mismatch(self, data: bytes) -> str:
        """Return the fault of a head in front of a known command, such as a wrong length; '' if the words have no head.

        Call it for words that are not a command by themselves: a command needs no head.
        """
        behind = data[self.head_size :]
        there = plural(len(behind) // 2, "word")
        try:
            said = len(self.read(data + bytes(2 * self.rules.most)).raw) - self.head_size
        except CommandFaultError as error:
            if error.segment != self.length:
                return str(error) if error.segment and self.is_known(behind) else ""
            is_head = self.is_known(behind) or (len(data) == self.head_size and error.found == "0")
            return f"{error} ({there} behind the head)" if is_head else ""
        return "" if said == len(behind) else f"the head says {plural(said // 2, 'word')}, and {there} stand behind it"

    def is_known(self, data: bytes) -> bool:
        """Return whether these bytes are a request of a frame that is not always refused."""
        try:
            name, _ = self.read_request(data)
        except CommandFaultError:
            return False
        return self.application.frames[name].refuse is None

    def make(self, request: str, fields: Mapping[str, Any], head: Mapping[str, Any]) -> bytes:
        """Return the bytes of a command with these plain values; missing values get their defaults.

        Raise ValueError (EncodeError) that names the unfit value.
        """
        known = PlainValues(self.application).from_plain(
            self.rules.frame, {**head, self.rules.request: {request: dict(fields)}}
        )
        return self._table.encode(FrameValue(self.rules.frame, known), self._names)

    def read_request(self, data: bytes) -> tuple[str, dict[str, Any]]:
        """Return the name and the fields of the request that exactly these bytes are. Raise CommandFaultError."""
        for name in self.requests:
            try:
                return name, self._table.infos[name].decode(data, self._names)
            except EVALUATION_ERRORS:
                continue
        raise CommandFaultError("these words are no command")

    @property
    def requests(self) -> tuple[str, ...]:
        """Return the frame names of all commands; frames that are always refused come last."""
        frame = self.application.frames[self.rules.frame]
        return tuple(
            name for inner in parts_of(frame, Inner) if inner.name == self.rules.request for name in inner.frames
        )

    def head(self) -> tuple[str, ...]:
        """Return the names of the fields of a block without the request."""
        return tuple(
            segment.name
            for segment in self.application.frames[self.rules.frame].segments
            if segment.name and segment.name != self.rules.request
        )


def rules_of(application: Protocol) -> CommandRules:
    """Return the section `commands` of an application. Raise ValueError if it has no command blocks."""
    if application.commands is None:
        raise ValueError(f"'{application.name}' has no command blocks")
    return application.commands


def words_of(data: bytes) -> list[int]:
    """Return bytes in memory's form as words of 16 bits."""
    return [int.from_bytes(data[at : at + 2], "little") for at in range(0, len(data), 2)]


def bytes_of(words: list[int]) -> bytes:
    """Return words of 16 bits, signed or unsigned, in memory's form. Raise ValueError for a number out of range."""
    for word in words:
        if not -0x8000 <= word <= 0xFFFF:
            raise ValueError(f"{word} is no word of 16 bits: 0 to 65535")
    return b"".join((word & 0xFFFF).to_bytes(2, "little") for word in words)


NO_PLACE, NO_OWN_PLACE = "no_such_place", "no_own_place"
"""Outcomes of places that the protocol of the other side, or the own memory, does not have."""

TIME_LIMIT = "time_limit"
"""The outcome of an exchange that reached the time limit of its command block."""

ParamsOf = Callable[[Any], Mapping[str, Any]]
"""The parameters that a channel has for a station."""

Later = Callable[[int, Callable[[int], list[LinkCommand]]], Callable[[], None]]
"""Call a function that acts on the engine after this number of nanoseconds; the result cancels the call."""


NO_REPLY = FrameValue("", {})
"""The value of `reply` without a reply: a frame without fields."""


@dataclass(slots=True, kw_only=True)
class OperationEnd:
    """The end of an operation: '' or the name of the failure, the code of the device, the results.

    `status` is the status word of a refusal, if the refusal has a status word.
    """

    outcome: str = ""
    cause: str = ""
    code: int | None = None
    status: int = 0
    result: dict[str, Any] = field(default_factory=dict)
    reply: FrameValue | None = None
    buffer: bytes = b""
    data: bytes = b""

    @property
    def ok(self) -> bool:
        return not self.outcome

    def names(self) -> dict[str, Any]:
        """Return the names that expressions use; `code` is 0 if the device gave no code."""
        return {
            "ok": int(self.ok), "outcome": self.outcome, "cause": self.cause, "code": self.code or 0,
            "refused": int(self.code is not None), "result": self.result,
            "reply": NO_REPLY if self.reply is None else self.reply, "buffer": self.buffer,
            "data": self.data,
        }  # fmt: skip


class Operation:
    """One exchange, or several in sequence; `on_end` is called exactly once."""

    def __init__(
        self, around: CommandBlocks, engine: Engine, client: ServiceClient, block: CompiledBlock, names: Names,
        on_end: Callable[[OperationEnd], None], params_of: ParamsOf | None = None,
    ) -> None:  # fmt: skip
        self.around = around
        self.engine = engine
        self.client = client
        self.block = block
        self.names = names
        self.on_end = on_end
        self.end = OperationEnd()
        self._params_of = params_of
        self._station: Any = None
        self._calls = list(block.calls)
        self._own: Span | None = None
        self._back: Callable[[], None] | None = None
        self._transfer: Transfer | None = None
        """The transfer under way."""
        self._stop_timer: Callable[[], None] | None = None
        self._is_over = self._is_late = False

    def begin(self, station: Any, now: int) -> list[LinkCommand]:
        """Start the exchange; `station` is the other side if the block names no station."""
        block = self.block
        try:
            given = None if block.station is None else block.station(self.names)
            self._station = station if given is None else given
            session = None if block.session is None else block.session(self.names)
            known = {} if self._params_of is None else self._params_of(self._station)
            params = {**known, **{name: compute(self.names) for name, compute in block.params.items()}}
            self._back = self.engine.scope.override(params) if params else None
        except (ParameterError, *EVALUATION_ERRORS) as error:
            return self._failed("cannot_send", explain(error))
        self._set_limit(self.around.limit(self.names))
        if not session:
            return self._act(now)
        commands: list[LinkCommand] = []
        commands += self.engine.close_session(now, lambda: commands.extend(self._act(self.engine.scope.now)))
        return commands

    def _set_limit(self, limit: int) -> None:
        """Start the timer of the block."""
        if limit < NEVER and self.around.later is not None:
            self._stop_timer = self.around.later(limit, self._time_over)

    def _time_over(self, now: int) -> list[LinkCommand]:
        """End the exchange at the time limit of the block."""
        if self._is_over:
            return []
        self._is_late = True
        if self._transfer is None:
            return self._failed(TIME_LIMIT, "")
        self._transfer.given_up = True
        return self.engine.cancel(self._transfer, now)

    def _act(self, now: int) -> list[LinkCommand]:
        """Start the transfer or the first call of the block; a block without either ends."""
        if self._is_over:
            return []
        try:
            if self.block.read is not None:
                return self._read(now)
            if self.block.write is not None:
                return self._write(now)
            if self._calls:
                return self._first_call(now)
        except UnknownAreaError as error:
            return self._failed(NO_PLACE, str(error))
        except DeviceMemoryError as error:
            return self._failed(NO_OWN_PLACE, str(error))
        except AddressError as error:
            return self._failed(NO_PLACE, str(error))
        except EVALUATION_ERRORS as error:
            return self._failed("cannot_send", explain(error))
        self._ended()
        return []

    # ---- services -----------------------------------------------------------------------------------------

    def _first_call(self, now: int) -> list[LinkCommand]:
        """Check the own places of the calls and read the data that go to the other side, then make the first call."""
        if self.block.into is not None:
            self._own = self._checked(self._own_place(self.block.into.where(self.names)))
        if self.block.source is not None:
            self.end.data = self._own_data(self._own_place(self.block.source.on(self.names)))[0]
        return self._call(now)

    def _call(self, now: int) -> list[LinkCommand]:
        service, arguments = self._calls.pop(0)
        known = Names(self.end.names(), self.names)
        given = {name: compute(known) for name, compute in arguments.items()}
        return self._begun(self.client.call(service, given, station=self._station, now=now, on_done=self._called))

    def _begun(self, transfer: Transfer) -> list[LinkCommand]:
        self._transfer = transfer
        return transfer.commands

    def _called(self, result: TransferResult) -> None:
        self._note(result)
        self.end.result = {**self.end.result, **result.gives}
        if result.ok and self._calls:
            self._proceed()
            return
        if result.ok and self._own is not None:
            self._store_called(self._own)
        self._ended()

    def _proceed(self) -> None:
        """Make the next call."""
        try:
            self._call(self.engine.scope.now)
        except (AddressError, *EVALUATION_ERRORS) as error:
            self._failed("cannot_send", explain(error))

    def _store_called(self, own: Span) -> None:
        """Write the data of the calls into the own place that was checked before them."""
        assert self.block.into is not None
        try:
            data = bytes(self.block.into.on(Names(self.end.names(), self.names))["data"])
            self.around.areas.write(own, fitted(data, own.count * unit_bits(own.unit)))
        except (DeviceMemoryError, *EVALUATION_ERRORS) as error:
            self.end.outcome, self.end.cause = "cannot_store", explain(error)

    def _note(self, result: TransferResult) -> None:
        end = self.end
        self._transfer = None
        if not result.ok and self._is_late:
            end.outcome, end.cause = TIME_LIMIT, ""
        elif not result.ok:
            end.outcome, end.cause, end.code = result.outcome or "failed", result.cause, result.code
        end.reply, end.buffer = result.reply, result.buffer

    # ---- transfers ----------------------------------------------------------------------------------------

    def _read(self, now: int) -> list[LinkCommand]:
        """Read elements of the other side into the own memory."""
        assert self.block.read is not None
        given = self.block.read.on(self.names)
        shared = self.client.shared
        own = {} if self.block.into is None else self._own_place(self.block.into.on(self.names))
        address = address_of(shared.grammar, codes_of(shared.protocol), given)
        bits = unit_bits(self.around.own_span(own).unit) * int(own["count"]) if "count" in own else 0
        count = int(given["count"]) if "count" in given else -(-bits // address.unit_bits)
        if own and "count" not in own:
            own["count"] = -(-count * address.unit_bits // unit_bits(self.around.own_span(own).unit))
        self._own = self._checked(own) if own else None
        return self._begun(
            self.client.read(address, station=self._station, count=count, now=now, on_done=self._was_read)
        )

    def _own_place(self, given: dict[str, Any]) -> dict[str, Any]:
        try:
            self.around.own_span(given)
        except UnknownAreaError as error:
            raise DeviceMemoryError(str(error)) from None
        return given

    def _checked(self, given: Mapping[str, Any]) -> Span:
        try:
            return self.around.checked_span(given)
        except UnknownAreaError as error:
            raise DeviceMemoryError(str(error)) from None

    def _was_read(self, result: TransferResult) -> None:
        self._note(result)
        self.end.data = result.data
        if result.ok and self._own is not None:
            try:
                self.around.areas.write(self._own, fitted(result.data, self._own.count * unit_bits(self._own.unit)))
            except DeviceMemoryError as error:
                self.end.outcome, self.end.cause = "cannot_store", str(error)
        self._ended()

    def _write(self, now: int) -> list[LinkCommand]:
        """Write elements of the own memory to the other side."""
        assert self.block.write is not None
        given, shared = self.block.write.on(self.names), self.client.shared
        address = address_of(shared.grammar, codes_of(shared.protocol), given)
        if self.block.source is None:
            data = bytes(given["data"])
            count = int(given["count"]) if "count" in given else -(-8 * len(data) // address.unit_bits)
        else:
            data, count = self._source(self.block.source.on(self.names), address, given)
        values = values_of(fitted(data, count * address.unit_bits), address.unit, count)
        return self._begun(
            self.client.write(address, values, station=self._station, now=now, on_done=self._was_written)
        )

    def _source(self, given_own: dict[str, Any], address: Address, given: Mapping[str, Any]) -> tuple[bytes, int]:
        """Return the data of the own place, and the number of elements of the other side that they fill."""
        own = self._own_place(given_own)
        width = unit_bits(self.around.own_span(own).unit)
        if "count" not in own:
            own["count"] = -(-int(given.get("count", 1)) * address.unit_bits // width)
        data, bits = self._own_data(own)
        return data, int(given["count"]) if "count" in given else -(-bits // address.unit_bits)

    def _own_data(self, own: Mapping[str, Any]) -> tuple[bytes, int]:
        """Return the bytes of an own place in memory's form, and the number of its bits."""
        span = self.around.own_span(own)
        try:
            data = self.around.areas.read(span, self.names)
        except UnknownAreaError as error:
            raise DeviceMemoryError(str(error)) from None
        bits = span.count * unit_bits(span.unit)
        return fitted(data, bits), bits

    def _was_written(self, result: TransferResult) -> None:
        self._note(result)
        self._ended()

    # ---- the end ------------------------------------------------------------------------------------------

    def _failed(self, outcome: str, cause: str) -> list[LinkCommand]:
        self.end.outcome, self.end.cause = outcome, cause
        self._ended()
        return []

    def _ended(self) -> None:
        self._is_over = True
        if self._stop_timer is not None:
            self._stop_timer()
        if self._back is not None:
            self._back()
        if self.end.ok:
            self.around.afterwards(self.block.then, self.end, self.names)
        self.on_end(self.end)


def fitted(data: bytes, bits: int) -> bytes:
    """Return exactly `bits` bits of data in memory's form, cut or padded with zeros."""
    return cut_memory(data.ljust(-(-bits // 8), b"\0"), 0, bits)


SUCCESS = 1
"""The status word of success if an application defines no other."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandEnd:
    """The end of a command block: its status word and the meaning of the word.

    `fault`: the reason of a block that was not executed and has no status word; then `status` is 0.
    """

    status: int = 0
    meaning: str = ""
    failure: Failure | None = None
    fault: str = ""


Ended = Callable[[CommandEnd], None]


class CommandBlocks:
    """Execute command blocks of `application` on one channel. Raise ValueError if it has no command blocks.

    `channel`: the names of the line; default: those of the application alone. `mapping` puts areas of the application
    elsewhere in the own memory (see `DeviceAreas`). Without `client` and `engine` blocks can only be read and planned.
    Without `later` no exchange has a time limit.
    """

    def __init__(
        self,
        application: Protocol,
        memory: DeviceMemory,
        *,
        channel: Scope | None = None,
        engine: Engine | None = None,
        client: ServiceClient | None = None,
        mapping: Mapping[str, tuple[str, int]] | None = None,
        later: Later | None = None,
    ) -> None:
        codec = compile_protocol(application)
        self.scope = CommandScope(application, channel or Scope(application, role=None))
        self.server = MemoryServer(application, codec, memory, mapping=mapping, on_block=self._take)
        self.words = CommandWords(application, codec, self.server.shared.table, self.scope)
        self.engine = engine
        self.client = client
        self.later = later
        rules = self.rules = self.words.rules
        values = self.server.shared.values
        part = Work.part_compiler(values, self.areas)
        self._status = CompiledPlace(rules.status, part)
        self._done = None if rules.done is None else compile_expression(rules.done)
        self._failed = compile_expression(rules.failed)
        self._meaning = None if rules.meaning is None else compile_expression(rules.meaning)
        self._waits = None if rules.waits is None else compile_expression(rules.waits)
        self._limit = None if rules.limit is None else compile_expression(rules.limit)
        self.then = compile_afters(rules.then, values.compile, part)
        self._taken: tuple[CompiledBlock, Names] | None = None

    @property
    def areas(self) -> DeviceAreas:
        """Return the own memory, accessed by the areas of the application."""
        return self.server.areas

    def own_span(self, given: Mapping[str, Any]) -> Span:
        """Return a place of the own memory from its words. Raise UnknownAreaError."""
        return span_of(self.areas, self.server.shared.grammar, self.server.codes, given)

    def _take(self, block: CompiledBlock, names: Names) -> int | None:
        self._taken = (block, names)
        return None

    # ---- understanding ------------------------------------------------------------------------------------

    def names_of(self, command: CommandFrame) -> Names:
        """Return the names that expressions of the application use for a command."""
        return Names({"block": command.block, "record": command.raw}, self.scope)

    def waits(self, command: CommandFrame) -> int:
        """Return the time (ns) after which a command is a fault; NEVER if no time limit applies."""
        try:
            names = Names({"request": command.request}, self.names_of(command))
            return NEVER if self._waits is None else int(self._waits(names))
        except EVALUATION_ERRORS:
            return NEVER

    def limit(self, names: Names) -> int:
        """Return the time (ns) after which the exchange of a command is ended; NEVER if no time limit applies."""
        try:
            return NEVER if self._limit is None else int(self._limit(names))
        except EVALUATION_ERRORS:
            return NEVER

    def waits_for(self, data: bytes) -> int:
        """Return `waits` of the command that begins with these bytes; NEVER if they are not a command."""
        try:
            return self.waits(self.words.read(data))
        except CommandFaultError:
            return NEVER

    def meaning(self, status: int) -> str:
        """Return the meaning of a status word; empty if it has no meaning."""
        if self._meaning is None:
            return ""
        try:
            return str(self._meaning(Names({"status": status}, self.scope)))
        except EVALUATION_ERRORS:
            return ""

    def plan(self, command: CommandFrame) -> tuple[int, CompiledBlock | None, Names]:
        """Serve the request; return the code of a refusal or 0, and the exchange that it asks for with its names."""
        names = self.names_of(command)
        self._taken = None
        served = self.server.serve(command.request, b"", None, False, names)
        taken, self._taken = self._taken, None
        if served.refusal or taken is None:
            return served.refusal, None, Names({"request": command.request}, names)
        return 0, *taken

    # ---- carrying out -------------------------------------------------------------------------------------

    def start(
        self, data: bytes, station: Any, now: int, ended: Ended, params_of: ParamsOf | None = None
    ) -> list[LinkCommand]:
        """Execute the command that begins with these bytes; `ended` is called once, possibly before the method returns.

        `params_of` returns the parameters of the station that the command names.
        """
        try:
            command = self.words.read(data)
            status = self.status_place(command)
        except (CommandFaultError, DeviceMemoryError, *EVALUATION_ERRORS) as error:
            ended(CommandEnd(fault=explain(error)))
            return []
        self.scope.now = now
        refusal, block, names = self.plan(command)

        def done(end: OperationEnd) -> None:
            ended(self._finish(status, names, end))

        if refusal:
            done(OperationEnd(outcome="refused", status=refusal))
            return []
        if block is None:
            done(OperationEnd())
            return []
        if block.job is not None:
            done(OperationEnd(outcome="no_sequence", cause="jobs are run by the run, not by a channel"))
            return []
        assert self.engine is not None and self.client is not None
        return Operation(self, self.engine, self.client, block, names, done, params_of).begin(station, now)

    def status_place(self, command: CommandFrame) -> Span:
        """Return the place of the status word. Raise DeviceMemoryError if the place cannot be written."""
        given = self.status_words(command)
        return self.checked_span({**given, "count": 16 // unit_bits(self.own_span(given).unit)})

    def status_words(self, command: CommandFrame) -> dict[str, Any]:
        """Return the words that name the place of the status word."""
        return self._status.on(Names({"request": command.request}, self.names_of(command)))

    def checked_span(self, given: Mapping[str, Any]) -> Span:
        """Return a place that can be written. Raise DeviceMemoryError."""
        span = self.own_span(given)
        self.areas.check(span, write=True)
        return span

    def afterwards(self, rows: Sequence[CompiledAfter], end: OperationEnd, names: Names) -> None:
        """Carry out the changes after an exchange; a change that fails turns a good end into a failure."""
        known = Names(end.names(), names)
        for row in rows:
            try:
                if row.when is not None and not row.when(known):
                    continue
                for target, key, value in row.set:
                    assign(self.scope, target, None if key is None else key(known), value(known))
                if row.store is not None:
                    self._store(row.store.on(known))
            except (DeviceMemoryError, *EVALUATION_ERRORS) as error:
                if end.ok:
                    end.outcome, end.cause = "cannot_store", explain(error)

    def _store(self, given: dict[str, Any]) -> None:
        data = bytes(given.pop("data"))
        width = unit_bits(self.own_span(given).unit)
        given.setdefault("count", -(-8 * len(data) // width))
        span = self.checked_span(given)
        self.areas.write(span, fitted(data, span.count * width))

    def _status_word(self, end: OperationEnd, names: Names) -> int:
        """Return the status word of an end; a formula that fails gives all ones."""
        known = Names(end.names(), names)
        try:
            if end.ok:
                return SUCCESS if self._done is None else int(self._done(known)) & 0xFFFF
            return end.status or int(self._failed(known)) & 0xFFFF
        except EVALUATION_ERRORS as error:
            end.cause = end.cause or f"the status word cannot be worked out: {explain(error)}"
            return 0xFFFF

    def _finish(self, place: Span, names: Names, end: OperationEnd) -> CommandEnd:
        """Carry out all changes after an exchange; write the status word last."""
        word = self._status_word(end, names)
        before = end.outcome
        self.afterwards(self.then, end, Names({"status": word}, names))
        if end.outcome != before:
            word = self._status_word(end, names)
        self.areas.write(place, word.to_bytes(2, "little"))
        if end.ok:
            return CommandEnd(status=word, meaning=self.meaning(word))
        failure = Failure(outcome=end.outcome, cause=end.cause, device_code=word, meaning=self.meaning(word))
        return CommandEnd(status=word, meaning=failure.meaning, failure=failure)
