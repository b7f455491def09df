"""A server: requests that arrive, served from a device's memory by the same rows that clients send them by.

Order: the request's own refusal, the server's, the first row that reads backwards, its refusals, area, range and
access, the work, the reply. Nothing from the wire raises out of here. Language reference, sections 12 and 13.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from framekit.codec.shown import explain
from framekit.definition.expression.syntax import names_in
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.services import Refusal
from framekit.definition.model.values import Value
from framekit.link.backwards import BackwardRow, Codes, ElsewhereError, Reading
from framekit.link.block_work import CompiledBlock
from framekit.link.construct_values import EACH, compile_value
from framekit.link.device_areas import DeviceAreas
from framekit.link.evaluate import EVALUATION_ERRORS, Evaluate, Names, compile_expression
from framekit.link.exchange import Served
from framekit.link.frame_table import Codec
from framekit.link.leaves import DamagedBufferError, MismatchError
from framekit.link.places import codes_of
from framekit.link.scope import Scope
from framekit.link.service_rows import RowFacts, ServiceRows
from framekit.link.values import FrameValue
from framekit.link.work import BlockRefusedError, StartBlock, Work
from framekit.memory.memory import AccessError, DeviceMemory, DeviceMemoryError, MemoryRangeError, UnknownAreaError

NOTHING_SAID = 1
"""The code of a refusal for which the definition has none."""

Rule = tuple[Evaluate, Evaluate, bool]
"""When, code, and whether it looks at the bytes beside the request."""


class RefusedError(Exception):
    """The request is refused with `code`."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


class ServingRow:
    """A row as a server uses it."""

    def __init__(self, facts: RowFacts, areas: DeviceAreas, codes: Codes) -> None:
        row, shared = facts.row, facts.shared

        def compiled(value: Value | None) -> Callable[[Names], Any] | None:
            return None if value is None else compile_value(value, shared.protocol, shared.codec, shared.table)

        self.facts = facts
        self.service = row.service
        self.back = BackwardRow(facts, areas, codes)
        self.refuse = rules(row.refuse)
        self.work = None if row.serve is None else Work(row.serve, facts, areas, codes)
        self.transfers = row.service in ("read", "write") and (self.work is None or not self.work.moves_data)
        self.replies = [
            (
                None if reply.when is None else compile_expression(reply.when),
                compiled(reply.frame),
                compiled(reply.buffer),
            )
            for reply in row.reply
        ]


class MemoryServer:
    """Serves a device's memory. `mapping` puts areas of the protocol elsewhere in it (see `DeviceAreas`).

    `on_block` starts blocks of a run for requests that ask for one.
    """

    def __init__(
        self,
        protocol: Protocol,
        codec: Codec,
        memory: DeviceMemory,
        *,
        mapping: Mapping[str, tuple[str, int]] | None = None,
        on_block: StartBlock | None = None,
    ) -> None:
        self.on_block = on_block
        self.areas = DeviceAreas(protocol, codec, memory, mapping)
        self.shared = ServiceRows(protocol, codec)
        self._refuse = rules(protocol.server_refusals)
        self._rows: dict[str, list[ServingRow]] = {}
        self.codes = codes = codes_of(protocol)
        for facts in self.shared.served:
            row = ServingRow(facts, self.areas, codes)
            self._rows.setdefault(row.back.frame, []).append(row)
        errors = protocol.errors
        self._memory_codes = {} if errors is None else {n: compile_expression(e) for n, e in errors.memory.items()}
        answer = None if errors is None else errors.answer
        self._answer = None if answer is None else compile_value(answer, protocol, codec, self.shared.table)

    def serve(self, request: FrameValue, buffer: bytes, station: Any, check_only: bool, names: Names) -> Served:
        """Does what a request asks for, or, with `check_only`, only says whether it would be refused.

        What depends on the bytes beside the request is not judged by `check_only`: they come later.
        """
        known = Names({"request": request, "buffer": buffer, "station": station}, names)
        trouble = ""
        try:
            try:
                return self._serve(request, buffer, check_only, known)
            except DeviceMemoryError as error:
                raise RefusedError(self._memory_code(kind_of(error), known)) from None
            except BlockRefusedError as error:
                raise RefusedError(self._code_or(error.code, "no_service", known)) from None
            except EVALUATION_ERRORS as error:
                trouble = _trouble(request, error)
                raise RefusedError(self._memory_code("range", known)) from None
        except RefusedError as refused:
            return self._refused(request, refused.code, known, trouble)

    def asked(self, request: FrameValue, names: Names) -> tuple[CompiledBlock | None, Names]:
        """The exchange that a request asks for, whether it would be refused or not; nothing is done.

        Raises RefusedError for a request that no row is for, and EVALUATION_ERRORS.
        """
        known = Names({"request": request, "buffer": b"", "station": None}, names)
        row, reading = self._row_for(request, b"", False, known)
        return (None if row.work is None else row.work.block), reading.names

    def refuse(self, request: FrameValue, code: int | None, buffer: bytes, station: Any, names: Names) -> Served:
        """Refuses a request whatever it asks for; without a code as for an address that is out of range."""
        known = Names({"request": request, "buffer": buffer, "station": station}, names)
        return self._refused(request, self._code_or(code, "range", known), known)

    def _serve(self, request: FrameValue, buffer: bytes, check_only: bool, names: Names) -> Served:
        if request.refusal is not None:
            raise RefusedError(request.refusal)
        judge(self._refuse, names, check_only)
        row, reading = self._row_for(request, buffer, check_only, names)
        judge(row.refuse, reading.names, check_only)
        if reading.problem is not None:
            raise reading.problem
        for target in reading.targets:
            self.areas.check(target.span, write=row.service == "write")
        if check_only:
            return Served(None)
        return self._reply(row, reading, request, self._do(row, reading, names))

    def _row_for(
        self, request: FrameValue, buffer: bytes, check_only: bool, names: Names
    ) -> tuple[ServingRow, Reading]:
        """The first row that fits. Raises RefusedError with the best reason why none does."""
        reason, damaged = "no_service", None
        for row in self._rows.get(request.frame, ()):
            try:
                return row, row.back.read(request, buffer, names, check_only)
            except MismatchError:
                continue
            except ElsewhereError as error:
                if error.known and row.service == "write":
                    reason = "access"
                elif reason != "access":
                    reason = "unknown"
            except DamagedBufferError as error:
                damaged = damaged or error
        if damaged is not None:
            raise RefusedError(self._code_or(damaged.refuse, "range", names)) from None
        raise RefusedError(self._memory_code(reason, names))

    # ---- work and reply -----------------------------------------------------------------------------------

    def _do(self, row: ServingRow, reading: Reading, names: Names) -> list[bytes] | None:
        """The row's work; the data for the reply as they stand in the frame, None if there are none."""
        data = None if row.work is None else row.work.do(reading, _scope_of(names), self.on_block)
        if not row.transfers:
            return data
        if row.service == "write":
            for target in reading.targets:
                if target.memory is None:
                    raise MemoryRangeError("the request brings no data to write")
                self.areas.write(target.span, target.memory)
            return data
        found = []
        for target in reading.targets:
            span = target.span
            memory = self.areas.read(span, reading.names)
            found.append(row.facts.packer(span.unit).to_data(memory, span.start, span.count))
        return found

    def _reply(self, row: ServingRow, reading: Reading, request: FrameValue, data: Sequence[bytes] | None) -> Served:
        names = reading.names
        if data is not None:
            names["data"] = b"".join(data)
            names["bytes"] = len(names["data"])
            variables = [target.names for target in reading.targets]
            if len(variables) != len(data):
                variables = [Names(parent=names) for _ in data]
            names[EACH] = [{**own, "data": part} for part, own in zip(data, variables, strict=True)]
        for when, frame, buffer in row.replies:
            if when is None or when(names):
                reply = None if frame is None else frame(names)
                if reply is not None:
                    self.shared.table.fill_echo(reply, request)
                return Served(reply, b"" if buffer is None else buffer(names))
        return Served(None)

    # ---- refusals -----------------------------------------------------------------------------------------

    def _refused(self, request: FrameValue, code: int, names: Names, trouble: str = "") -> Served:
        if self._answer is None:
            return Served(None, b"", code, trouble)
        try:
            reply = self._answer(Names({"code": code}, names))
        except EVALUATION_ERRORS as error:
            return Served(None, b"", code, trouble or _trouble(request, error))
        self.shared.table.fill_echo(reply, request)
        return Served(reply, b"", code, trouble)

    def _code_or(self, code: int | None, kind: str, names: Names) -> int:
        return self._memory_code(kind, names) if code is None else code

    def _memory_code(self, kind: str, names: Names) -> int:
        """The code for `unknown`, `range`, `access` or `no_service`; the nearest one where the definition has none."""
        for name in (kind, "unknown", "range", "access", "no_service"):
            if name in self._memory_codes:
                return int(self._memory_codes[name](names))
        return NOTHING_SAID


def rules(refusals: Sequence[Refusal]) -> list[Rule]:
    """Refusals of a definition, compiled."""
    return [
        (compile_expression(rule.when), compile_expression(rule.code), "buffer" in names_in(rule.when.root))
        for rule in refusals
    ]


def judge(refuse: Sequence[Rule], names: Names, check_only: bool) -> None:
    """Raises RefusedError for the first rule whose condition holds."""
    for when, code, needs_buffer in refuse:
        if not (check_only and needs_buffer) and when(names):
            raise RefusedError(int(code(names)))


def kind_of(error: DeviceMemoryError) -> str:
    """What the definition calls this refusal of the memory."""
    if isinstance(error, UnknownAreaError):
        return "unknown"
    return "access" if isinstance(error, AccessError) else "range"


def _trouble(request: FrameValue, error: Exception) -> str:
    return f"serving '{request.frame}': {explain(error)}"


def _scope_of(names: Names) -> Scope:
    """The engine's own names, which hold the state. Raises TypeError when there is no engine behind these names."""
    level: Names | None = names
    while level is not None:
        if isinstance(level, Scope):
            return level
        level = level.parent
    raise TypeError("a server needs the names of an engine")
