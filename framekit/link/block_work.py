"""The exchange that a request asks for, compiled: a template of values, worked out on the names of that request.

Who carries it out, and on which channel, is not known here. Language reference, section 12.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from framekit.definition.model.commands import After, BlockWork, PlaceOf
from framekit.definition.model.procedure import Target
from framekit.definition.model.values import Value
from framekit.link.construct_values import Compute
from framekit.link.evaluate import Evaluate, Names, compile_expression

CompilePart = Callable[[str, Value], Compute]
"""Compiles one word of a place, such as area or start."""


class CompiledPlace:
    """A place of memory: the words that are given, worked out on names."""

    def __init__(self, place: PlaceOf, compile_part: CompilePart) -> None:
        self._parts = [(name, compile_part(name, value)) for name, value in place.items()]

    def on(self, names: Names) -> dict[str, Any]:
        """The words with their values. Raises EVALUATION_ERRORS."""
        return {name: compute(names) for name, compute in self._parts}

    def where(self, names: Names) -> dict[str, Any]:
        """The same without the data that go there."""
        return {name: compute(names) for name, compute in self._parts if name != "data"}


@dataclass(frozen=True, slots=True)
class CompiledAfter:
    """What is done when an exchange has ended, if `when` holds."""

    when: Evaluate | None
    set: Sequence[tuple[Target, Compute | None, Compute]]
    store: CompiledPlace | None


@dataclass(frozen=True, slots=True)
class CompiledJob:
    """A `JobWork` ready to be worked out; what it does not say is None."""

    kind: str
    slot: Compute
    report: CompiledPlace | None
    host: Compute | None
    every: Compute | None
    late: Compute | None
    times: Compute | None


@dataclass(frozen=True, slots=True)
class CompiledBlock:
    """A `BlockWork` ready to be worked out. `calls` are services of the channel's protocol with their arguments."""

    work: BlockWork
    station: Compute | None
    params: Mapping[str, Compute]
    session: Evaluate | None
    read: CompiledPlace | None
    write: CompiledPlace | None
    into: CompiledPlace | None
    source: CompiledPlace | None
    calls: Sequence[tuple[str, Mapping[str, Compute]]]
    then: Sequence[CompiledAfter]
    job: CompiledJob | None = None


def compile_block(work: BlockWork, compile_value: Callable[[Value], Compute], part: CompilePart) -> CompiledBlock:
    """Compiles a block; `part` compiles the words of places, in which areas may stand by their names."""

    def place(found: PlaceOf | None) -> CompiledPlace | None:
        return None if found is None else CompiledPlace(found, part)

    def values(fields: Mapping[str, Value]) -> dict[str, Compute]:
        return {name: compile_value(value) for name, value in fields.items()}

    def one(value: Value | None) -> Compute | None:
        return None if value is None else compile_value(value)

    job = work.job
    return CompiledBlock(
        job=None
        if job is None
        else CompiledJob(
            kind=job.kind,
            slot=compile_value(job.slot),
            report=place(job.report),
            host=one(job.host),
            every=one(job.every),
            late=one(job.late),
            times=one(job.times),
        ),
        work=work,
        station=None if work.station is None else compile_value(work.station),
        params=values(work.params),
        session=None if work.session is None else compile_expression(work.session),
        read=place(work.read),
        write=place(work.write),
        into=place(work.into),
        source=place(work.source),
        calls=[(call.service, values(call.arguments)) for call in work.calls],
        then=compile_afters(work.then, compile_value, part),
    )


def compile_afters(
    rows: Sequence[After], compile_value: Callable[[Value], Compute], part: CompilePart
) -> list[CompiledAfter]:
    """Compiles what is done afterwards."""
    return [
        CompiledAfter(
            when=None if row.when is None else compile_expression(row.when),
            set=[
                (target, None if target.key is None else compile_expression(target.key), compile_value(value))
                for target, value in row.set
            ],
            store=None if row.store is None else CompiledPlace(row.store, part),
        )
        for row in rows
    ]
