"""Command blocks of one channel: words of memory become exchanges with the other side, and a status word in the end.

A block is served like any request – refusals, work on the own memory and on the channel's variables are rows of its
application – and may ask for an exchange, which goes through the channel's client. The status word is written exactly
once, after the data. Sans-I/O.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from framekit.blocks.block_status import Failure
from framekit.blocks.command_words import Command, CommandFaultError, CommandWords
from framekit.blocks.operations import Operation, OperationEnd, ParamsOf, fitted
from framekit.codec.shown import explain
from framekit.definition.model.protocol import Protocol
from framekit.definition.times import NEVER
from framekit.link.command_scope import CommandScope
from framekit.link.construct_values import ValueCompiler
from framekit.link.engine import Engine
from framekit.link.evaluate import EVALUATION_ERRORS, Names, compile_expression
from framekit.link.events import Command as LinkCommand
from framekit.link.frame_table import Codec
from framekit.link.scope import Scope
from framekit.link.services.areas import DeviceAreas, Span, span_of
from framekit.link.services.client import Client
from framekit.link.services.server import MemoryServer
from framekit.link.services.work import CompiledAfter, CompiledBlock, CompiledPlace, Work, assign, compile_afters
from framekit.memory.memory import DeviceMemory, DeviceMemoryError, unit_bits

SUCCESS = 1
"""The status word of success where an application does not say one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandEnd:
    """How a command block ended. `status` is its status word and `meaning` the name of that.

    `fault`: why it was not carried out although no status word tells of it; then `status` is 0.
    """

    status: int = 0
    meaning: str = ""
    failure: Failure | None = None
    fault: str = ""


Ended = Callable[[CommandEnd], None]


class CommandBlocks:
    """Carries out command blocks of `application` on one channel. Raises ValueError when that has none.

    `mapping` puts areas of the application elsewhere in the own memory (see `DeviceAreas`). Without `client` and
    `engine` blocks can only be read and planned.
    """

    def __init__(
        self,
        application: Protocol,
        codec: Codec,
        memory: DeviceMemory,
        *,
        channel: Scope,
        engine: Engine | None = None,
        client: Client | None = None,
        mapping: Mapping[str, tuple[str, int]] | None = None,
    ) -> None:
        self.scope = CommandScope(application, channel)
        self.server = MemoryServer(application, codec, memory, mapping=mapping, on_block=self._take)
        self.words = CommandWords(application, codec, self.server.shared.table, self.scope)
        self.engine = engine
        self.client = client
        rules = self.rules = self.words.rules
        values = ValueCompiler(codec, self.server.shared.table.made)
        part = Work.part_compiler(values, self.areas)
        self._status = CompiledPlace(rules.status, part)
        self._done = None if rules.done is None else compile_expression(rules.done)
        self._failed = compile_expression(rules.failed)
        self._meaning = None if rules.meaning is None else compile_expression(rules.meaning)
        self._waits = None if rules.waits is None else compile_expression(rules.waits)
        self.then = compile_afters(rules.then, values.compile, part)
        self._taken: tuple[CompiledBlock, Names] | None = None

    @property
    def areas(self) -> DeviceAreas:
        """The own memory, by the areas of the application."""
        return self.server.areas

    def own_span(self, given: Mapping[str, Any]) -> Span:
        """A place of the own memory by its words. Raises UnknownAreaError."""
        return span_of(self.areas, self.server.shared.grammar, self.server.codes, given)

    def _take(self, block: CompiledBlock, names: Names) -> int | None:
        self._taken = (block, names)
        return None

    # ---- understanding ------------------------------------------------------------------------------------

    def names_of(self, command: Command) -> Names:
        """What the expressions of the application see of a command."""
        return Names({"block": command.block, "record": command.raw}, self.scope)

    def waits(self, command: Command) -> int:
        """How long (ns) a command may take before that is a fault; NEVER where nobody waits."""
        try:
            names = Names({"request": command.request}, self.names_of(command))
            return NEVER if self._waits is None else int(self._waits(names))
        except EVALUATION_ERRORS:
            return NEVER

    def waits_for(self, data: bytes) -> int:
        """As `waits`, for the command that begins with these bytes; NEVER when they are none."""
        try:
            return self.waits(self.words.read(data))
        except CommandFaultError:
            return NEVER

    def meaning(self, status: int) -> str:
        """The name of a status word; empty when it has none."""
        if self._meaning is None:
            return ""
        try:
            return str(self._meaning(Names({"status": status}, self.scope)))
        except EVALUATION_ERRORS:
            return ""

    def plan(self, command: Command) -> tuple[int, CompiledBlock | None, Names]:
        """Serves the request: the code of a refusal or 0, and the exchange it asks for with its names, if any."""
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
        """Carries out the command that begins with these bytes; `ended` is called once, perhaps before it returns.

        `params_of`: parameters for the station that it turns out to be for.
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

    def status_place(self, command: Command) -> Span:
        """Where the status word goes. Raises DeviceMemoryError when nothing can be written there."""
        given = self.status_words(command)
        return self.checked_span({**given, "count": 16 // unit_bits(self.own_span(given).unit)})

    def status_words(self, command: Command) -> dict[str, Any]:
        """The words that say where the status word goes."""
        return self._status.on(Names({"request": command.request}, self.names_of(command)))

    def checked_span(self, given: Mapping[str, Any]) -> Span:
        """A place that can be written. Raises DeviceMemoryError."""
        span = self.own_span(given)
        self.areas.check(span, write=True)
        return span

    def afterwards(self, rows: Sequence[CompiledAfter], end: OperationEnd, names: Names) -> None:
        """What is done when an exchange has ended; a row that cannot be done makes a failure of a good end."""
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
        """The status word of an end; a formula that cannot be worked out gives all ones."""
        known = Names(end.names(), names)
        try:
            if end.ok:
                return SUCCESS if self._done is None else int(self._done(known)) & 0xFFFF
            return end.status or int(self._failed(known)) & 0xFFFF
        except EVALUATION_ERRORS as error:
            end.cause = end.cause or f"the status word cannot be worked out: {explain(error)}"
            return 0xFFFF

    def _finish(self, place: Span, names: Names, end: OperationEnd) -> CommandEnd:
        """Everything that follows an exchange; the status word comes last."""
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
