"""The link procedure: sequences, steps, rows, roles and sessions. Guide: sequences, roles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from framekit.definition.expression import Expression
from framekit.definition.keys import (
    CONDITION,
    COUNT,
    EXPRESSION,
    FLAG,
    IDENTIFIER,
    LABEL,
    LABELS,
    OCTETS,
    TIME,
    Form,
    Key,
    KeyReading,
    here,
    key,
    keys,
    mapping_of,
    mapping_schema,
    read_part,
    ref,
    words,
)
from framekit.definition.load.reader import Broken
from framekit.definition.model.values import FrameOf, Value
from framekit.definition.problems import Position, did_you_mean
from framekit.definition.times import parse_format
from framekit.definition.tree import Entry, Node, Scalar
from framekit.definition.tree import Mapping as Keys
from framekit.definition.tree import Sequence as Items

HANDLERS = {
    "on_timeout": "When a time limit has run out; default: fail.",
    "on_bad": "When a frame is damaged (cause, frame); default: wait on.",
    "on_other": "When a good frame comes that fits no row.",
    "on_noise": "When unusable bytes have come.",
    "on_break": "When the line was in break state.",
    "on_closed": "When the connection is closed; default: fail.",
    "on_held": "When clear-to-send was off longer than clear_time of the line, so a frame was not sent; default: fail.",
    "on_exhausted": "When resend has used up the retries; default: fail.",
    "on_fail": "When the called sequence or the service fails; default: fail too.",
    "on_byte": "Any byte ends the wait this way.",
}
DELIVERED = "Offers a frame to all lanes as if it had arrived."
SENDS = "Sends a frame: its name, a variable, or {frame: {field: expression}}."


@dataclass(frozen=True, slots=True)
class Target:
    """Target of `set`: a variable, an entry of a table (`name[key]`), or a field of a frame or record (`….field`)."""

    name: str
    key: Expression | None = None
    field: str | None = None


SETTINGS = Form(here("settings"), lambda r, node: r.loader.values.settings(node))
SENT = Form(here("sent"), lambda r, node: r.loader.sent(node))
PUTS = Form(here("put"), lambda r, node: r.loader.puts(node))
ROWS = Form(here("rows"), lambda r, node: r.loader.rows(node))
ACTION = Form(here("action"), lambda r, node: r.loader.action(node))


def _actions(reading: KeyReading, node: Node) -> tuple[Action, ...]:
    """Read a list of actions; raise Broken if it is none, which the schema reports."""
    if not isinstance(node, Items):
        raise Broken("the schema has reported it")
    return reading.loader.actions(node)  # type: ignore[no-any-return]


ACTIONS = Form({"type": "array", "minItems": 1, "items": here("action")}, _actions)
STORES = Form({"type": "object", "additionalProperties": ref("address")}, lambda r, node: r.loader.stores(node))


@dataclass(frozen=True, slots=True, kw_only=True)
class Action:
    """An action; its parts run in this order: when → at_most/otherwise → take → set → store → put → deliver → send →
    then or fail.
    """

    at: Position
    places: Mapping[str, Position] = field(default_factory=dict, compare=False)
    """Places of the values of keys, for messages."""
    when: Expression | None = key("when", CONDITION, "Only if this is true.", default=None)
    at_most: Expression | None = key("at_most", COUNT, "So often since the step was entered; then else.", default=None)
    otherwise: Action | None = key("else", ACTION, "What is done when at_most is used up.", default=None)
    take: str | None = key("take", IDENTIFIER, "Takes an item from this queue; it is `it`.", default=None)
    set: tuple[tuple[Target, Value], ...] = key("set", SETTINGS, default=())
    store: tuple[tuple[Expression, str], ...] = key(
        "store", STORES, "Puts bytes into memory, expression: address.", default=()
    )
    put: tuple[tuple[str, Mapping[str, Value]], ...] = key("put", PUTS, default=())
    deliver: Value | None = key("deliver", SENT, DELIVERED, default=None)
    send: Value | None = key("send", SENT, SENDS, default=None)
    then: str | None = key("then", LABEL, "Where to go: next, end, again, restart, resend, or a step.", default=None)
    """`next`, `end`, `again`, `restart`, `resend` or a step; None without `fail` stands for the default of the
    place.
    """
    fail: str | None = key("fail", LABEL, "Ends the sequence with this outcome.", default=None)
    because: Expression | None = key(
        "because",
        EXPRESSION,
        "The reason of that failure, in words: such as the cause an earlier on_fail had.",
        default=None,
    )


ARRIVALS: dict[str, Any] = {
    "frame": {
        **ref("labels"),
        "description": "Frames or groups, or expected (the replies the service named, and the error frame).",
    }
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Row(Action):
    """A row of a receive matrix."""

    frames: tuple[str, ...] = keys(ARRIVALS, lambda r: r.loader.arrivals(r.keys), default=())
    """Names of frames, in the order tried."""
    expected: bool = keys({}, lambda r: r.loader.expects(r.keys), default=False)
    """Whether it also takes the expected replies of the exchange."""
    station: Expression | None = key(
        "station", EXPRESSION, "Only frames of this station, and frames without a station.", default=None
    )
    """Condition that is part of `when` already (`load/resolve.py`); kept to show that the row does not take all of its
    frames.
    """
    queue: str | None = key("queue", IDENTIFIER, "As soon as this queue has an item.", default=None)
    room: str | None = key("room", IDENTIFIER, "As soon as this queue is not full.", default=None)


@dataclass(frozen=True, slots=True)
class Parts:
    """`parts: {of, size}`: the step is repeated for each piece."""

    of: Expression = key("of", OCTETS, "The bytes.")
    size: Expression = key("size", COUNT, "Size of a piece.")


@dataclass(frozen=True, slots=True)
class Serve:
    """`serve:`: the frame to serve, its additional bytes, its station, and whether it is only validated."""

    request: Expression = key("request", EXPRESSION, "The request frame.")
    buffer: Expression | None = key("buffer", OCTETS, "Bytes that came beside it.", default=None)
    station: Expression | None = key("station", EXPRESSION, "The station that was asked.", default=None)
    check_only: bool = key("check", FLAG, "yes: the request is only validated.", default=False)


def _format(reading: KeyReading, node: Node) -> Expression:
    """Read a literal format (`7E1`), or an expression for such a text."""
    scalar = reading.reader.scalar(node)
    try:
        parse_format(scalar.text, 1)
    except ValueError:
        return reading.reader.expression(node)
    return reading.reader.expression_text(f"'{scalar.text.strip()}'", scalar.at)


@dataclass(frozen=True, slots=True, kw_only=True)
class LineChange:
    """`line: {speed, format}`: the settings of the line from now on; None leaves a setting unchanged. Without both the
    line's own settings apply.
    """

    at: Position
    speed: Expression | None = key("speed", COUNT, "Bits a second; without it the speed stays as it is.", default=None)
    format: Expression | None = key(
        "format",
        Form(EXPRESSION.schema, _format, "text"),
        "Data bits, parity and stop bits, such as 7E1; without it the format stays as it is.",
        default=None,
    )


def _line_change(reading: KeyReading, node: Node) -> LineChange:
    if isinstance(node, Scalar):
        return LineChange(at=node.at)
    return read_part(LineChange, reading.loader, node)


@dataclass(frozen=True, slots=True, kw_only=True)
class Decode:
    """`decode: {of, frame, into}`: collected bytes are decoded as one of `frames`."""

    at: Position
    of: Expression = key("of", OCTETS, "The bytes, all of one frame.")
    frames: tuple[str, ...] = keys(
        {"frame": {**ref("labels"), "description": "The frames or groups that it may be, in the order tried."}},
        lambda r: r.loader.arrivals(r.keys),
    )
    into: str = key("into", IDENTIFIER, "The variable that holds the frame.")


@dataclass(frozen=True, slots=True)
class CallOf:
    """`call: SEQUENCE, with: {…}, into: {variable: result}`."""

    sequence: str
    arguments: Mapping[str, Value]
    into: Mapping[str, str]


def handler_keys(*events: str) -> Mapping[str, tuple[Action, ...]]:
    """Declare the attribute of the handlers: event → actions."""
    schemas = {
        event: {**here("action" if event == "on_byte" else "handler"), "description": HANDLERS[event]}
        for event in events
    }
    declared: Mapping[str, tuple[Action, ...]] = keys(schemas, lambda r: r.loader.handlers(r.keys), factory=dict)
    return declared


CALLS: dict[str, Any] = {
    "call": {**ref("label"), "description": "Runs this sequence here."},
    "with": {**here("values"), "description": "Arguments of the call, name: value."},
    "into": {
        "description": "Where results of the call, or of the service asked, go: variable: result.",
        "type": "object",
        "additionalProperties": ref("identifier"),
    },
}
_SESSION_WORDS = "new opens the session, end closes it; session variables return to their start values."
ONE_SERVICE = {
    "type": "object",
    "minProperties": 1,
    "maxProperties": 1,
    "x-write": "write the name of one service with its arguments, {NAME: {argument: value}}",
}
_URGENT = "The frame of the step is sent also while late replies may still come, because the other side waits for it."
PARTS = mapping_of(
    Parts,
    mapping_schema(Parts, "the parts", description="Does the rest of the step once for each piece of some bytes."),
)
DECODE = mapping_of(
    Decode,
    mapping_schema(
        Decode,
        "the decode section",
        required=["of", "frame", "into"],
        description="Reads bytes as a frame. A wrong one is counted and shown as a bad frame; then on_bad is done, or "
        "the sequence fails with the outcome damaged_frame.",
    ),
)
LINE = Form(
    mapping_schema(
        LineChange,
        "the line step",
        type=["string", "object"],
        minProperties=1,
        pattern="^\\s*own\\s*$",
        **{"x-expected": "own, or {speed: 9600, format: 8N1}"},
        description="Changes speed and format when all that was sent has left; own: back to those of the line.",
    ),
    _line_change,
)
SERVE = mapping_of(
    Serve,
    mapping_schema(Serve, "the serve section", description="Lets the server do what a request asks for."),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """A step; keys it does not have are None or empty."""

    name: str = key("step", LABEL, "Name of the step.")
    at: Position
    places: Mapping[str, Position] = field(default_factory=dict, compare=False)
    """Places of the values of keys, for messages."""
    when: Expression | None = key("when", CONDITION, "The step is skipped unless this is true.", default=None)
    session: str | None = key(
        "session", LABEL._replace(schema=words("a session word", "new", "end")), _SESSION_WORDS, default=None
    )
    parts: Parts | None = key("parts", PARTS, default=None)
    wait: Expression | None = key("wait", TIME, "Waits so long.", default=None)
    hold_break: Expression | None = key("break", TIME, "Holds the line in break state so long.", default=None)
    flush: bool = key("flush", FLAG, "Forgets what has come and is not a frame yet.", default=False)
    urgent: bool = key("urgent", FLAG, _URGENT, default=False)
    """Whether its frame is sent without waiting for replies that are due."""
    set: tuple[tuple[Target, Value], ...] = key("set", SETTINGS, default=())
    decode: Decode | None = key("decode", DECODE, default=None)
    serve: Serve | None = key("serve", SERVE, default=None)
    call: CallOf | None = keys(CALLS, lambda r: r.loader.call(r.keys), default=None)
    ask: FrameOf | None = key(
        "ask",
        Form(ONE_SERVICE, lambda r, node: r.loader.ask(node)),
        "Runs a service of this protocol here, {service: {argument: value}}.",
        default=None,
    )
    ask_into: Mapping[str, str] = keys({}, lambda r: r.loader.into(r.keys) if "ask" in r.keys else {}, factory=dict)
    put: tuple[tuple[str, Mapping[str, Value]], ...] = key("put", PUTS, default=())
    deliver: Value | None = key("deliver", SENT, DELIVERED, default=None)
    send: Value | None = key("send", SENT, SENDS, default=None)
    line: LineChange | None = key("line", LINE, default=None)
    receive: tuple[Row, ...] | None = key("receive", ROWS, "Waits; the first row that fits is done.", default=None)
    branch: tuple[Action, ...] | None = key(
        "branch", ACTIONS, "The first action whose when is true is done.", default=None
    )
    then: str = key("then", LABEL, "Where to go: next (the default), end, or a step.", default="next")
    within: Expression | None = key(
        "within", TIME, "Longest time to the first byte of a frame that fits.", default=None
    )
    complete: Expression | None = key("complete", TIME, "Longest time from that byte to the last.", default=None)
    gap: Expression | None = key("gap", TIME, "Longest time between two bytes.", default=None)
    retries: Expression | None = key("retries", COUNT, "How often resend may send again.", default=None)
    handlers: Mapping[str, tuple[Action, ...]] = handler_keys(*HANDLERS)
    more: Mapping[str, Any] = keys(
        {}, lambda r: {name: one.read(r) for name, one in ADDED_KEYS.items() if name in r.keys}, factory=dict
    )


ADDED_KEYS: dict[str, Key] = {}
"""Keys of steps that programs register."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sequence:
    """A named list of steps with arguments, results, local variables (name → type) and handlers for every step."""

    name: str
    at: Position
    takes: tuple[str, ...]
    gives: Mapping[str, Expression]
    local: Mapping[str, str]
    always: tuple[Row, ...]
    handlers: Mapping[str, tuple[Action, ...]]
    steps: tuple[Step, ...]


# ---- roles and sessions -------------------------------------------------------------------------------------


def _sequence(reading: KeyReading, node: Node) -> str:
    """Return the name of a sequence; an unknown name is noted."""
    name, known = reading.reader.text(node), reading.space.section("sequences")
    if name not in known:
        reading.reader.note(node.at, f"there is no sequence '{name}'", did_you_mean(name, known))
    return name


SEQUENCE = Form(LABEL.schema, _sequence)
SEQUENCES = Form(LABELS.schema, lambda r, node: tuple(_sequence(r, item) for item in r.reader.items(node)))


def places_of(keys_: Keys) -> dict[str, Position]:
    """Return the place of the value of each key."""
    return {entry.key.text: entry.value.at for entry in keys_.entries}


@dataclass(frozen=True, slots=True, kw_only=True)
class Lane:
    """A lane of a role: exchanges (up to `at_once` together), and the sequence that runs between them."""

    name: str
    at: Position
    places: Mapping[str, Position] = field(default_factory=dict, compare=False)
    exchange: tuple[str, ...] = key("exchange", SEQUENCES, default=())
    listen: str | None = key("listen", SEQUENCE, default=None)
    at_once: Expression | None = key("at_once", COUNT, default=None)


def _lanes(reading: KeyReading, node: Node) -> tuple[Lane, ...]:
    def lane(entry: Entry) -> Lane:
        keys_ = reading.reader.mapping(entry.value)
        return read_part(Lane, reading.loader, keys_, name=entry.key.text, at=entry.key.at, places=places_of(keys_))

    return reading.reader.each(reading.reader.entries(node), lane)


@dataclass(frozen=True, slots=True, kw_only=True)
class Role:
    """A side of the line: its lanes in the order in which frames are offered to them.

    `other_side`: the role that answers it.
    """

    name: str
    at: Position
    lanes: tuple[Lane, ...] = key("lanes", Form({}, _lanes), default=())
    session: str | None = key("session", LABEL, default=None)
    other_side: str | None = key("other_side", LABEL, default=None)

    @property
    def exchanges(self) -> bool:
        """Return whether services can be called in this role."""
        return any(lane.exchange for lane in self.lanes)

    @property
    def listens(self) -> tuple[str, ...]:
        """Return the sequences that run while a lane has no exchange."""
        return tuple(lane.listen for lane in self.lanes if lane.listen is not None)


def _flag(reading: KeyReading, node: Node) -> Expression:
    """Read `yes`, `no` or an expression."""
    scalar = reading.reader.scalar(node)
    return reading.reader.expression_text({"yes": "true", "no": "false"}.get(scalar.text, scalar.text), scalar.at)


def _keep_alive_after(reading: KeyReading, node: Node) -> Expression:
    return reading.reader.expression(reading.reader.mapping(node).get("after"))


def _keep_alive_run(reading: KeyReading) -> str | None:
    node = reading.keys.get("keep_alive")
    run = None if node is None else reading.reader.mapping(node).get("run")
    return None if run is None else _sequence(reading, run)


def _lost_by(reading: KeyReading, node: Node) -> tuple[str, ...] | None:
    outcomes = reading.reader.texts(node)
    return None if outcomes == ("any",) else outcomes


@dataclass(frozen=True, slots=True, kw_only=True)
class Session:
    """A session that must be open before an exchange runs."""

    name: str
    at: Position
    open: tuple[str, ...] = key("open", SEQUENCES, default=())
    close: tuple[str, ...] = key("close", SEQUENCES, default=())
    one_station: Expression | None = key("one_station", Form(EXPRESSION.schema, _flag), default=None)
    keep_alive_after: Expression | None = key("keep_alive", Form({}, _keep_alive_after, "time"), default=None)
    keep_alive_run: str | None = keys({}, _keep_alive_run, default=None)
    lost_by: tuple[str, ...] | None = key("lost_by", Form(LABELS.schema, _lost_by), default=None)
    """Outcomes that end the session; None for any failure."""
    reconnect: bool = key("reconnect", FLAG, default=False)
    """Whether a connection whose session is lost, or cannot be opened, is closed and opened again."""
