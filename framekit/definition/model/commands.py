"""Command blocks: records of memory that ask for exchanges. What a row's `block` means, and the section `commands`.

They are the same for every protocol; the codes and places stand in the definition. Language reference, section 12.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from framekit.definition.expression.syntax import Expression
from framekit.definition.model.procedure import Target
from framekit.definition.model.values import Value
from framekit.definition.problems import Position

PlaceOf = Mapping[str, Value]
"""A place of memory, by the words area, memory, code, text, unit, start, count; data for what goes there."""


@dataclass(frozen=True, slots=True, kw_only=True)
class After:
    """One row of what is done when an exchange has ended: variables to set, bytes to store."""

    when: Expression | None
    set: tuple[tuple[Target, Value], ...]
    store: PlaceOf | None
    at: Position


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandCall:
    """A service of the channel's protocol, with its arguments."""

    service: str
    arguments: Mapping[str, Value]
    at: Position


@dataclass(frozen=True, slots=True, kw_only=True)
class JobWork:
    """A command to the jobs of a run: `kind` is job, abort or inspect, `slot` its number, or 'all'.

    A job says beside the transfer where its `host` is, how often (`every`, ns), after which time it is `late`, how many
    `times`; `report` is the own place that a report sends.
    """

    kind: str
    slot: Value
    report: PlaceOf | None = None
    host: Value | None = None
    every: Value | None = None
    late: Value | None = None
    times: Value | None = None
    at: Position


@dataclass(frozen=True, slots=True, kw_only=True)
class BlockWork:
    """The exchange that a request asks for: a template of values over the request.

    One of `read` (with `into`), `write` (with `source`) and `calls`; with none of them only the session changes.
    `session` gives 'new', 'end' or ''. `read` and `write` are places of the other side, `into` and `source` of the
    own memory. With `job` it is a command to the run's jobs.
    """

    station: Value | None = None
    params: Mapping[str, Value] = field(default_factory=dict)
    session: Expression | None = None
    read: PlaceOf | None = None
    write: PlaceOf | None = None
    into: PlaceOf | None = None
    source: PlaceOf | None = None
    calls: tuple[CommandCall, ...] = ()
    then: tuple[After, ...] = ()
    job: JobWork | None = None
    at: Position


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandRules:
    """How records in memory are command blocks: which frame they are, where their status word goes, what it says.

    `request` is the field with the inner frame that services serve; `most`: the most words of a block. `done` and
    `failed` give the status word, `meaning` its name. `waits`: how long (ns) a block may take before it is a fault.
    """

    frame: str
    request: str
    most: int
    status: PlaceOf
    done: Expression | None
    failed: Expression
    meaning: Expression | None
    waits: Expression | None
    then: tuple[After, ...]
    at: Position
