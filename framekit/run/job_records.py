"""Commands to jobs whose words stand in the own memory: copied, understood, and given to the table as any other.

What the words mean is the application's. Nothing is carried out here.
"""

from __future__ import annotations

from typing import Any

from framekit.codec.codec import compile_protocol
from framekit.codec.shown import explain
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.walk import expressions_of
from framekit.link.addresses import Address
from framekit.link.evaluate import EVALUATION_ERRORS, Names
from framekit.link.scope import Scope
from framekit.link.services.work import CompiledBlock, CompiledJob, CompiledPlace
from framekit.memory.memory import DeviceMemory, DeviceMemoryError, unit_bits
from framekit.run.commands import CommandBlocks, CommandFaultError, StatusPlaceError
from framekit.run.commands import CommandFrame as CommandWords
from framekit.run.model import CommandKind, JobCommand, Order, OrderKind, OwnPlace

KINDS: dict[str, CommandKind] = {"job": "job", "abort": "abort", "inspect": "inspect"}
ALL = "all"


class RecordReader:
    """Reads the commands of one application from `memory`."""

    def __init__(self, application: Protocol, memory: DeviceMemory) -> None:
        self.memory = memory
        self.blocks = CommandBlocks(
            application, compile_protocol(application), memory, channel=Scope(application, role=None)
        )
        says = "".join(str(one) for one in expressions_of(self.blocks.rules.status))
        self._status_fields = {name for name in self.blocks.words.head() if name in says}

    def words_at(self, place: OwnPlace) -> bytes:
        """The words that stand at a place, as many as a command can have."""
        area, first = self.memory.area(place.address.area), place.address.first_bit // 8
        return area.read_bytes(first, min(2 * self.blocks.rules.most, area.size_bytes - first))

    def read(self, data: bytes, number: int | None) -> tuple[JobCommand, int]:
        """The command that begins with these bytes, given by `number`, and the code of its refusal or 0.

        Raises CommandFaultError for words that are none, StatusPlaceError for those whose status word has no place.
        """
        words = self._words(data)
        try:
            status = self._place(self.blocks.status_words(words), 16)
        except (DeviceMemoryError, *EVALUATION_ERRORS) as error:
            raise StatusPlaceError(explain(error)) from None
        try:
            refusal, block, names = self.blocks.plan(words)
            if refusal or block is None or block.job is None:
                return JobCommand(kind="job", slot=None, status=status, id=number), refusal
            return self._command(block, block.job, names, status, number), 0
        except (DeviceMemoryError, *EVALUATION_ERRORS) as error:
            raise CommandFaultError(explain(error)) from None

    def _words(self, data: bytes) -> CommandWords:
        try:
            return self.blocks.words.read(data)
        except CommandFaultError as error:
            if error.segment in self._status_fields:
                raise StatusPlaceError(str(error), error.segment, error.found) from None
            raise

    def _command(
        self, block: CompiledBlock, job: CompiledJob, names: Names, status: OwnPlace, number: int | None
    ) -> JobCommand:
        slot = job.slot(names)
        kind = KINDS[job.kind]
        into = self._place(block.into.on(names), 32) if kind == "inspect" and block.into is not None else None
        return JobCommand(
            kind=kind,
            slot=None if slot == ALL else int(slot),
            order=self._order(block, job, names, int(slot)) if kind == "job" else None,
            into=into,
            status=status,
            id=number,
        )

    def _order(self, block: CompiledBlock, job: CompiledJob, names: Names, slot: int) -> Order:
        kind: OrderKind = "report"
        moved, own = job.report, job.report
        if block.read is not None:
            kind, moved, own = "read", block.read, block.into
        elif block.write is not None:
            kind, moved, own = "write", block.write, block.source
        assert moved is not None and own is not None
        there = moved.on(names)
        every, late, times = (0 if one is None else int(one(names)) for one in (job.every, job.late, job.times))
        return Order(
            slot=slot,
            kind=kind,
            place=self._own(own, names),
            remote="" if kind == "report" else str(there["text"]),
            unit=there.get("unit"),
            count=int(there.get("count", 1)),
            host="" if job.host is None else str(job.host(names)),
            params={name: value(names) for name, value in block.params.items()},
            period=every,
            late=late,
            times=times,
        )

    def _own(self, place: CompiledPlace, names: Names) -> OwnPlace:
        given = place.on(names)
        return self._place({name: value for name, value in given.items() if name not in ("unit", "count")}, 1)

    def _place(self, given: dict[str, Any], bits: int) -> OwnPlace:
        """A place of the own memory with room for so many bits. Raises DeviceMemoryError."""
        span = self.blocks.own_span(given)
        span = self.blocks.own_span({**given, "count": -(-bits // unit_bits(span.unit))})
        self.blocks.areas.check(span, write=False)
        return OwnPlace(address=Address(span.memory, span.unit, span.start), text=str(given.get("text", span.memory)))
