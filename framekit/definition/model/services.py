"""Areas, addresses, services and errors: what READ and WRITE become; command blocks. Reference, sections 9 to 13."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from framekit.definition.expression.syntax import Expression
from framekit.definition.model.procedure import Target
from framekit.definition.model.values import Constant, FrameOf, Value
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


UNIT_BITS = {"bit": 1, "byte": 8, "word": 16, "dword": 32, "lword": 64}
NUMBER_BITS = {
    **{f"{kind}{bits}": bits for kind in ("int", "uint") for bits in (8, 16, 32, 64)}, "float32": 32, "float64": 64,
    "bcd16": 16, "bcd32": 32,
}  # fmt: skip
"""The types of numbers that elements may hold, and their widths."""
COUNTED_STRING = "counted_string"
"""The type of an element that is the number of characters in a word, and then these."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Area:
    """A memory area of a device. `codes`: unit → name on the wire, the first unit is the default one.

    `element_bits` is the width of the default unit; `columns` are the definition's own; `layout` makes a read-only area
    of that layout; `memory` is the area of the device's memory; `type` is what an element usually holds.
    """

    name: str
    unit: str
    element_bits: int
    size: int
    access: Literal["rw", "read"]
    codes: Mapping[str, Constant]
    memory: str
    layout: str | None
    columns: Mapping[str, Constant]
    at: Position
    type: str | None = None


@dataclass(frozen=True, slots=True)
class Literally:
    """Text of an address form that stands for itself."""

    text: str


@dataclass(frozen=True, slots=True)
class Part:
    """`{…}` of an address form.

    `what`: `area` (name), `column` (an area's column `name`), `unit` (a key of the units table), `number` or `word`.
    Numbers have `base` and places `least`..`most`; a text instead of a number of places is a column of the area.
    """

    what: Literal["area", "column", "unit", "number", "word"]
    name: str
    base: int = 10
    least: int | str | None = None
    most: int | str | None = None


@dataclass(frozen=True, slots=True)
class Maybe:
    """`[…]` of an address form: may be left out."""

    parts: tuple[Literally | Part, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class AddressForm:
    """One way to write an address; `results` are the row's other keys, `unit` a unit or the name of a units table.

    `type`: what a place that is written so usually holds. `any_case`: small letters stand for capitals and the reverse.
    """

    text: str
    parts: tuple[Literally | Part | Maybe, ...]
    area: Expression | str | None
    unit: str | None
    units_table: str | None
    results: Mapping[str, Expression]
    wire: bool
    at: Position
    type: str | None = None
    any_case: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Limit:
    """The most one request can carry."""

    count: Expression | None = None
    bytes: Expression | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Packing:
    """How elements stand in the data bytes: byte order of one unit (as of fields), and the form of bits."""

    order: Literal["big", "little", "BADC", "CDAB"] = "little"
    bits: Literal["packed", "aligned", "byte_each"] = "packed"


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplyRow:
    """One form of the reply: the frame (None: only bytes), the bytes beside it, and when a server uses it."""

    frame: FrameOf | None
    buffer: Value | None
    when: Expression | None
    at: Position


@dataclass(frozen=True, slots=True, kw_only=True)
class Refusal:
    """`{when, code}`: a server answers `code` when `when` holds."""

    when: Expression
    code: Expression
    at: Position


@dataclass(frozen=True, slots=True, kw_only=True)
class ServeWork:
    """What a server does for a row, in the language's order; each part is kept as name → value.

    `block` is an exchange with the other side that follows; `each`/`each_as` repeat span or read over a list.
    """

    let: Mapping[str, Value] = field(default_factory=dict)
    write: Mapping[str, Value] | None = None
    span: Mapping[str, Value] | None = None
    update: Expression | None = None
    set: tuple[tuple[Target, Value], ...] = ()
    drop: Mapping[str, Value] | None = None
    read: Mapping[str, Value] | Expression | None = None
    each: Expression | None = None
    each_as: str | None = None
    block: BlockWork | None = None
    at: Position


@dataclass(frozen=True, slots=True, kw_only=True)
class Argument:
    """An argument that a service other than read and write takes; also a parameter of a protocol (see `Parameter`)."""

    name: str
    type: str
    default: Expression | None
    limits: tuple[int, int] | None
    choices: tuple[str, ...] = ()
    items: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ServiceRow:
    """One row of a service. Empty `areas` and `units` mean: any. `back_each` reads the items of a request's list."""

    service: str
    name: str
    at: Position
    areas: tuple[str, ...]
    units: tuple[str, ...]
    when: Expression | None
    limit: Limit
    align_bits: int
    most_variables: int
    same: str | None
    takes: tuple[Argument, ...]
    request: FrameOf | None
    buffer: Value | None
    reply: tuple[ReplyRow, ...]
    packing: Packing
    gives: Mapping[str, Value]
    run: Expression | None
    back: Mapping[str, Expression]
    back_each: Mapping[str, Expression]
    refuse: tuple[Refusal, ...]
    serve: ServeWork | None
    client_only: bool
    server_only: bool
    outside_session: bool


@dataclass(frozen=True, slots=True)
class NameTable:
    """A table with names of codes, and when it counts: always without `when`."""

    table: str
    when: Expression | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Errors:
    """How a device says no, by any of `frames` (or groups). `memory`: unknown, range, access, no_service → code.

    `answer` builds the error frame. Where `unanswered` holds it says that nobody answered.
    """

    frames: tuple[str, ...]
    when: Expression | None
    code: Expression | None
    names: tuple[NameTable, ...]
    detail: Expression | None
    unanswered: Expression | None
    answer: FrameOf | None
    memory: Mapping[str, Expression]
    at: Position
