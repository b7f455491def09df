"""The exchange that a command block asks for, carried out: session, services, reads and writes between two memories.

Two sides of a transfer may count in different units: as much of the other side is moved as fills the own elements,
from the least significant bit on, and what is written beyond them is 0. Sans-I/O; everything goes through the
channel's client, as blocks of a run do.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from framekit.codec.shown import explain
from framekit.link.addresses import Address, AddressError
from framekit.link.engine import Engine
from framekit.link.evaluate import EVALUATION_ERRORS, Names
from framekit.link.events import Command
from framekit.link.packing import cut_memory, values_of
from framekit.link.parameters import ParameterError
from framekit.link.services.areas import DeviceAreas, Span, address_of, codes_of
from framekit.link.services.client import Client, TransferResult
from framekit.link.services.work import CompiledAfter, CompiledBlock
from framekit.link.values import FrameValue
from framekit.memory.memory import DeviceMemoryError, UnknownAreaError, unit_bits

NO_PLACE, NO_OWN_PLACE = "no_such_place", "no_own_place"
"""Outcomes of places that the other side's protocol, or the own memory, does not have."""


ParamsOf = Callable[[Any], Mapping[str, Any]]
"""The parameters that a channel has for a station."""


class Around(Protocol):
    """What an operation needs of the command blocks it belongs to."""

    @property
    def areas(self) -> DeviceAreas: ...
    def own_span(self, given: Mapping[str, Any]) -> Span: ...
    def checked_span(self, given: Mapping[str, Any]) -> Span: ...
    def afterwards(self, rows: Sequence[CompiledAfter], end: OperationEnd, names: Names) -> None: ...


NO_REPLY = FrameValue("", {})
"""What `reply` is where there was none: a frame without fields."""


@dataclass(slots=True, kw_only=True)
class OperationEnd:
    """How an operation ended: '' or the name of the failure, the device's code, what it brought.

    `status` is the status word of a refusal that has one already.
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
        """As expressions see it; `code` is 0 where the device gave none."""
        return {
            "ok": int(self.ok), "outcome": self.outcome, "cause": self.cause, "code": self.code or 0,
            "refused": int(self.code is not None), "result": self.result,
            "reply": NO_REPLY if self.reply is None else self.reply, "buffer": self.buffer,
            "data": self.data,
        }  # fmt: skip


class Operation:
    """One exchange, or several one after the other; `on_end` is called exactly once."""

    def __init__(
        self, around: Around, engine: Engine, client: Client, block: CompiledBlock, names: Names,
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

    def begin(self, station: Any, now: int) -> list[Command]:
        """Starts it; `station` is the other side where the block names none."""
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
        if not session:
            return self._act(now)
        commands: list[Command] = []
        commands += self.engine.close_session(now, lambda: commands.extend(self._act(self.engine.scope.now)))
        return commands

    def _act(self, now: int) -> list[Command]:
        """The next thing that goes over the line; the end when there is nothing more."""
        try:
            if self.block.read is not None:
                return self._read(now)
            if self.block.write is not None:
                return self._write(now)
            if self._calls:
                return self._call(now)
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

    def _call(self, now: int) -> list[Command]:
        service, arguments = self._calls.pop(0)
        known = Names(self.end.names(), self.names)
        given = {name: compute(known) for name, compute in arguments.items()}
        return self.client.call(service, given, station=self._station, now=now, on_done=self._called)

    def _called(self, result: TransferResult) -> None:
        self._note(result)
        self.end.result = {**self.end.result, **result.gives}
        if not result.ok or not self._calls:
            self._ended()
        else:
            self._act(self.engine.scope.now)

    def _note(self, result: TransferResult) -> None:
        end = self.end
        if not result.ok:
            end.outcome, end.cause, end.code = result.outcome or "failed", result.cause, result.code
        end.reply, end.buffer = result.reply, result.buffer

    # ---- transfers ----------------------------------------------------------------------------------------

    def _read(self, now: int) -> list[Command]:
        """Elements of the other side into the own memory."""
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
        return self.client.read(address, station=self._station, count=count, now=now, on_done=self._was_read)

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

    def _write(self, now: int) -> list[Command]:
        """Elements of the own memory to the other side."""
        assert self.block.write is not None
        given, shared = self.block.write.on(self.names), self.client.shared
        address = address_of(shared.grammar, codes_of(shared.protocol), given)
        if self.block.source is None:
            data = bytes(given["data"])
            count = int(given["count"]) if "count" in given else -(-8 * len(data) // address.unit_bits)
        else:
            data, count = self._source(self.block.source.on(self.names), address, given)
        values = values_of(fitted(data, count * address.unit_bits), address.unit, count)
        return self.client.write(address, values, station=self._station, now=now, on_done=self._was_written)

    def _source(self, given_own: dict[str, Any], address: Address, given: Mapping[str, Any]) -> tuple[bytes, int]:
        """What the own place gives, and how many elements of the other side that is."""
        own = self._own_place(given_own)
        width = unit_bits(self.around.own_span(own).unit)
        if "count" not in own:
            own["count"] = -(-int(given.get("count", 1)) * address.unit_bits // width)
        span = self.around.own_span(own)
        try:
            data = self.around.areas.read(span, self.names)
        except UnknownAreaError as error:
            raise DeviceMemoryError(str(error)) from None
        bits = span.count * width
        count = int(given["count"]) if "count" in given else -(-bits // address.unit_bits)
        return fitted(data, bits), count

    def _was_written(self, result: TransferResult) -> None:
        self._note(result)
        self._ended()

    # ---- the end ------------------------------------------------------------------------------------------

    def _failed(self, outcome: str, cause: str) -> list[Command]:
        self.end.outcome, self.end.cause = outcome, cause
        self._ended()
        return []

    def _ended(self) -> None:
        if self._back is not None:
            self._back()
        if self.end.ok:
            self.around.afterwards(self.block.then, self.end, self.names)
        self.on_end(self.end)


def fitted(data: bytes, bits: int) -> bytes:
    """Exactly `bits` bits of data in memory's form: the first ones, then zeros."""
    return cut_memory(data.ljust(-(-bits // 8), b"\0"), 0, bits)
