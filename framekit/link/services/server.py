"""A server: requests that arrive, served from a device's memory by the same rows that clients send them by.

Order: the request's own refusal, the server's, the first row that matches, its refusals, area, range and access, the
work, the reply. Plain transfers are served by one function a row (see `matching`), all other rows by `work`. No bytes
from the wire raise an exception out of this module. Guide: serving, errors.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Protocol, TypeVar

from framekit.codec.shown import explain, refusal_text
from framekit.definition.model import protocol as model
from framekit.definition.model.frames import names_read
from framekit.definition.model.services import AS_NUMBERS
from framekit.definition.model.values import Value
from framekit.link.events import Served
from framekit.link.frame_table import ProtocolCodec
from framekit.link.packing import numbers_of
from framekit.link.services.areas import Codes, DeviceAreas, Kept, Written, codes_of
from framekit.link.services.matching import (
    DamagedBufferError,
    DataError,
    ElsewhereError,
    MatchedRow,
    Matching,
    MismatchError,
    RefusedMatchError,
    Serve,
)
from framekit.link.services.rows import RowFacts, Rule, rows_of
from framekit.link.services.work import BlockRefusedError, CompiledBlock, StartBlock, Work
from framekit.link.values import (
    EACH,
    EVALUATION_ERRORS,
    FrameValue,
    Names,
    compile_expression,
    compile_optional,
)
from framekit.memory.memory import AccessError, DeviceMemory, DeviceMemoryError, MemoryRangeError, UnknownAreaError

NOTHING_SAID = 1
"""The code of a refusal for which the definition has no code."""


@dataclass(slots=True)
class ServiceCounters:
    """`done`: requests carried out; `refused`: how many were refused, by the code they were refused with.

    `unanswered`: requests whose reply could not be built.
    """

    done: int = 0
    refused: Counter[int] = field(default_factory=Counter)
    unanswered: int = 0

    def count(self) -> None:
        """Count a request that was carried out."""
        self.done += 1

    @property
    def errors(self) -> int:
        return self.refused.total() + self.unanswered

    def reasons(self, protocol: model.Protocol) -> Counter[str]:
        """Return how often each error occurred, by its description."""
        found = Counter({refusal_text(protocol, code): count for code, count in sorted(self.refused.items())})
        if self.unanswered:
            found["expression"] = self.unanswered
        return found

    def add(self, other: ServiceCounters) -> None:
        """Add the counts of other counters."""
        self.done += other.done
        self.refused.update(other.refused)
        self.unanswered += other.unanswered

    def clear(self) -> None:
        """Reset all counts."""
        self.done = self.unanswered = 0
        self.refused.clear()


Found = TypeVar("Found")


class Planned(Protocol):
    """A refusal that a plan of faults wants: its code; None: the code of an address out of range."""

    @property
    def code(self) -> int | None: ...


Refuses = Callable[[FrameValue, bool], Planned | None]
"""Returns the planned refusal of a request, if any; the second argument: the request is only checked."""


class ServedRow:
    """A row as a server uses it."""

    def __init__(
        self, facts: RowFacts, areas: DeviceAreas, codes: Codes, start_block: Callable[[CompiledBlock, Names], None]
    ) -> None:
        row, shared = facts.row, facts.shared

        def compiled(value: Value | None) -> Callable[[Names], Any] | None:
            return None if value is None else shared.values.compile(value)

        self.facts = facts
        self.areas = areas
        self.service = row.service
        self.matching = Matching(facts, areas, codes, partial(self.go_on, check_only=False))
        self.refuse = facts.refuse
        self.work = None if row.serve is None else Work(row.serve, facts, areas, codes)
        self.start_block = start_block
        self.transfers = row.service in ("read", "write") and (self.work is None or not self.work.moves_data)
        self.tells_numbers = self.transfers and not names_read(row.reply).isdisjoint(AS_NUMBERS)
        self.replies = [
            (
                compile_optional(reply.when),
                compiled(reply.frame),
                compiled(reply.buffer),
            )
            for reply in row.reply
        ]

    def check(self, request: FrameValue, buffer: bytes, station: Any, names: Names) -> Served | None:
        """Check a request without its buffer: return the refusal, if any. None: the row does not fit."""
        reading = self.matching.read(request, buffer, station, names, False)
        return None if reading is None else self.go_on(request, reading, check_only=True)

    def asked(
        self, request: FrameValue, buffer: bytes, station: Any, names: Names
    ) -> tuple[CompiledBlock | None, Names] | None:
        """Return the block that a request asks for, and the names of the request. None: the row does not fit."""
        reading = self.matching.read(request, buffer, station, names, True)
        return None if reading is None else (None if self.work is None else self.work.block, reading.names)

    def go_on(self, request: FrameValue, reading: MatchedRow, *, check_only: bool) -> Served:
        """Serve a matched request whose row is not served by one function."""
        validate(self.refuse, reading.names, check_only)
        if reading.problem is not None:
            raise reading.problem
        for target in reading.targets:
            target.unit.check(target.start, target.count, self.service == "write")
        return Served(None) if check_only else self._reply(request, reading, self._do(reading))

    def _do(self, reading: MatchedRow) -> list[bytes] | None:
        """Do the work of the row; return the data for the reply in wire form, None if there are no data."""
        data = None if self.work is None else self.work.do(reading, self.start_block)
        if not self.transfers:
            return data
        if self.service == "write":
            for target in reading.targets:
                if target.memory is None:
                    raise MemoryRangeError("the request brings no data to write")
                target.unit.write(target.start, target.count, target.memory)
            return data
        found = []
        for target in reading.targets:
            memory = target.unit.read(target.start, target.count, reading.names)
            if self.tells_numbers:
                numbers = numbers_of(memory, target.unit.unit, target.type, target.count)
                target.names.update(values=numbers, value=numbers[0])
            found.append(self.facts.packers[target.unit.unit].to_data(memory, target.start, target.count))
        return found

    def _reply(self, request: FrameValue, reading: MatchedRow, data: Sequence[bytes] | None) -> Served:
        names = reading.names
        if data is not None:
            names["data"] = b"".join(data)
            names["bytes"] = len(names["data"])
            variables = [target.names for target in reading.targets]
            if len(variables) != len(data):
                variables = [Names(parent=names) for _ in data]
            names[EACH] = [{**own, "data": part} for part, own in zip(data, variables, strict=True)]
        for when, frame, buffer in self.replies:
            if when is None or when(names):
                reply = None if frame is None else frame(names)
                if reply is not None:
                    self.facts.shared.table.fill_echo(reply, request)
                return Served(reply, b"" if buffer is None else buffer(names))
        return Served(None)


class MemoryServer:
    """Serves a device's memory. `mapping` puts areas of the protocol elsewhere in it (see `DeviceAreas`).

    `on_block` starts blocks of a run for requests that ask for a block. `refresh` updates the memory before each
    request, `refuses` refuses requests that the device would serve, `counters` count served and refused requests. With
    `read_only` every write is refused. `written` is called for every write, `kept` for every variable of the device
    that a request changes.
    """

    def __init__(
        self,
        protocol: model.Protocol,
        codec: ProtocolCodec,
        memory: DeviceMemory,
        *,
        mapping: Mapping[str, tuple[str, int]] | None = None,
        on_block: StartBlock | None = None,
        refresh: Callable[[], None] | None = None,
        refuses: Refuses | None = None,
        counters: ServiceCounters | None = None,
        read_only: bool = False,
        written: Written | None = None,
        kept: Kept | None = None,
    ) -> None:
        self.on_block = on_block
        self.refresh = refresh
        self.refuses = refuses
        self.counters = ServiceCounters() if counters is None else counters
        self.areas = DeviceAreas(protocol, codec, memory, mapping, read_only=read_only, written=written, kept=kept)
        self.shared = rows_of(protocol, codec)
        self._refuse = self.shared.refuse
        self._rows: dict[str, list[ServedRow]] = {}
        self._serving: dict[str, list[tuple[Serve, str]]] = {}
        self.codes = codes = codes_of(protocol)
        for facts in self.shared.served:
            row = ServedRow(facts, self.areas, codes, self._start_block)
            self._rows.setdefault(row.matching.frame, []).append(row)
        errors = protocol.errors
        self._memory_codes = {} if errors is None else {n: compile_expression(e) for n, e in errors.memory.items()}
        self._answers = [
            (
                None if row.when is None else compile_expression(row.when),
                self.shared.values.compile(row.frame),
            )
            for row in (() if errors is None else errors.answer)
            if row.frame is not None
        ]

    def serve(self, request: FrameValue, buffer: bytes, station: Any, check_only: bool, names: Names) -> Served:
        """Serve a request; with `check_only`, only return whether it would be refused.

        `check_only` does not validate conditions that depend on the buffer, since its bytes come later.
        """
        if self.refresh is not None:
            self.refresh()
        planned = None if self.refuses is None else self.refuses(request, check_only)
        try:
            if planned is not None:
                served = self.refuse(request, planned.code, buffer, station, names)
            elif check_only or self._refuse or request.refusal is not None:
                served = self._with_care(request, buffer, station, check_only, names)
            else:
                serving = self._serving.get(request.frame) or self._serving_of(request.frame)
                served = self._first(serving, request, buffer, station, names)
        except (RefusedMatchError, DeviceMemoryError, BlockRefusedError, *EVALUATION_ERRORS) as error:
            known = Names({"request": request, "buffer": buffer, "station": station}, names)
            served = self._failed(request, error, known)
        if served.refusal:
            self.counters.refused[served.refusal] += 1
        elif not check_only:
            self.counters.done += 1
        return served

    def unanswered(self) -> None:
        """Count the last request as unanswered, because its reply could not be built."""
        self.counters.done -= 1
        self.counters.unanswered += 1

    def asked(self, request: FrameValue, names: Names) -> tuple[CompiledBlock | None, Names]:
        """Return the block that a request asks for, and the names of the request, without serving it.

        Raise RefusedMatchError for a request that no row is for, and EVALUATION_ERRORS.
        """
        rows = self._rows.get(request.frame, ())
        return self._first([(row.asked, row.service) for row in rows], request, b"", None, names)

    def refuse(self, request: FrameValue, code: int | None, buffer: bytes, station: Any, names: Names) -> Served:
        """Refuse a request; without a code as for an address that is out of range."""
        known = Names({"request": request, "buffer": buffer, "station": station}, names)
        return self._refused(request, self._code_or(code, "range", known), known)

    def _with_care(self, request: FrameValue, buffer: bytes, station: Any, check_only: bool, names: Names) -> Served:
        """Serve a request that its frame or a rule of the protocol may refuse, or that is only checked."""
        if request.refusal is not None:
            raise RefusedMatchError(request.refusal)
        if self._refuse:
            validate(self._refuse, Names({"request": request, "buffer": buffer, "station": station}, names), check_only)
        if check_only:
            checks = [(row.check, row.service) for row in self._rows.get(request.frame, ())]
            return self._first(checks, request, buffer, station, names)
        return self._first(self._serving_of(request.frame), request, buffer, station, names)

    def _serving_of(self, frame: str) -> Sequence[tuple[Serve, str]]:
        """Return the functions that serve requests of a frame, with their services; each is compiled once."""
        if frame not in self._serving:
            rows = self._rows.get(frame, ())
            self._serving[frame] = [(row.matching.serving(), row.service) for row in rows]
        return self._serving[frame]

    def _first(
        self, functions: Sequence[tuple[Callable[[FrameValue, bytes, Any, Names], Found | None], str]],
        request: FrameValue, buffer: bytes, station: Any, names: Names,
    ) -> Found:  # fmt: skip
        """Return the result of the first row that fits; `functions` are pairs of a row's function and service.

        Raise RefusedMatchError with the best reason if no row fits.
        """
        reason, damaged = "no_service", None
        for function, service in functions:
            try:
                found = function(request, buffer, station, names)
            except MismatchError:
                continue
            except ElsewhereError as error:
                if error.known and service == "write":
                    reason = "access"
                elif reason != "access":
                    reason = "unknown"
                continue
            except DamagedBufferError as error:
                damaged = damaged or error
                continue
            if found is not None:
                return found
        known = Names({"request": request, "buffer": buffer, "station": station}, names)
        if damaged is not None:
            raise RefusedMatchError(self._code_or(damaged.refuse, "range", known))
        raise RefusedMatchError(self._memory_code(reason, known))

    def _start_block(self, block: CompiledBlock, names: Names) -> None:
        code = None if self.on_block is None else self.on_block(block, names)
        if self.on_block is None or code is not None:
            raise BlockRefusedError(code)

    # ---- refusals -----------------------------------------------------------------------------------------

    def _failed(self, request: FrameValue, error: Exception, names: Names) -> Served:
        """Return the refusal of a request that raised an error."""
        if isinstance(error, RefusedMatchError):
            return self._refused(request, error.code, names)
        if isinstance(error, DeviceMemoryError):
            return self._refused(request, self._memory_code(kind_of(error), names), names)
        if isinstance(error, BlockRefusedError):
            return self._refused(request, self._code_or(error.code, "no_service", names), names)
        return self._refused(request, self._memory_code("range", names), names, _trouble(request, error))

    def _refused(self, request: FrameValue, code: int, names: Names, trouble: str = "") -> Served:
        known = Names({"code": code}, names)
        try:
            answers = (build for when, build in self._answers if when is None or when(known))
            build = next(answers, None)
            if build is None:
                return Served(None, b"", code, trouble)
            reply = build(known)
        except EVALUATION_ERRORS as error:
            return Served(None, b"", code, trouble or _trouble(request, error))
        self.shared.table.fill_echo(reply, request)
        return Served(reply, b"", code, trouble)

    def _code_or(self, code: int | None, kind: str, names: Names) -> int:
        return self._memory_code(kind, names) if code is None else code

    def _memory_code(self, kind: str, names: Names) -> int:
        """Return the code of a kind of refusal, or of the nearest kind for which the definition has a code."""
        for name in (kind, *(("range",) if kind == "value" else ()), "unknown", "range", "access", "no_service"):
            if name in self._memory_codes:
                return int(self._memory_codes[name](names))
        return NOTHING_SAID


def validate(refuse: Sequence[Rule], names: Names, check_only: bool) -> None:
    """Raise RefusedMatchError for the first rule whose condition holds."""
    for when, code, needs_buffer in refuse:
        if not (check_only and needs_buffer) and when(names):
            raise RefusedMatchError(int(code(names)))


def kind_of(error: DeviceMemoryError) -> str:
    """Return the word of the definition for this refusal of the memory."""
    if isinstance(error, UnknownAreaError):
        return "unknown"
    if isinstance(error, DataError):
        return "value"
    return "access" if isinstance(error, AccessError) else "range"


def _trouble(request: FrameValue, error: Exception) -> str:
    return f"serving '{request.frame}': {explain(error)}"
