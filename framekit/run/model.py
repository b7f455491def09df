"""The content of run files and job profiles as frozen values: channels, memory, blocks, jobs.

Block instructions and their terms follow the P2P service (Snet module guide, chapter 6): READ, WRITE, SEND, RECEIVE
with trigger conditions. Addresses of the own memory are resolved; addresses of the other side stay text, for the
protocol of the channel to parse. A job profile is the content of a file `NAME.jobs.yaml`: the number of job slots of a
family of devices, its limits, its status bits and its codes.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from decimal import Decimal
from enum import Enum
from typing import Any, Literal

from framekit.codec.shown import code_text
from framekit.definition.expression import Expression
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.services import Packing
from framekit.definition.problems import NOWHERE, Position, Problem
from framekit.definition.times import NEVER, PLAIN, LineFormat, LineSettings
from framekit.link.addresses import Address
from framekit.link.packing import Typed
from framekit.memory.memory import Area, DeviceMemory
from framekit.memory.profile import MemoryProfile
from framekit.run.triggers import Trigger
from framekit.transport.schemes import host_of as port_host
from framekit.transport.schemes import scheme_of


class CodeClass(Enum):
    """The effect of an end code of a transfer on its job."""

    GOOD = "good"
    TRANSIENT = "transient"
    """The job continues."""
    RESOURCE = "resource"
    """The job continues; a status bit reports a shortage of resources for a while."""
    SYNTAX = "syntax"
    """The job never began."""
    FATAL = "fatal"
    """The job ends."""


class AfterLate(Enum):
    """When the next transfer starts after a transfer that took longer than its period."""

    NEXT_PERIOD = "next_period"
    AT_ONCE = "at_once"


@dataclass(frozen=True, slots=True)
class Minor:
    """A code in the high byte of a word, which details the code in its low byte."""

    text: str
    kind: CodeClass | None = None
    """None: the class of the low byte."""


@dataclass(frozen=True, slots=True)
class Major:
    """A code in the low byte of a word, with its minor codes by number."""

    text: str
    kind: CodeClass
    minors: Mapping[int, Minor] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class TimeUnit:
    """A unit for counting periods."""

    time: int
    """The length of the unit (ns)."""
    most: int
    """The maximum number of units in a period."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StatusBits:
    """The bits of the status area. Bits count from 1; 0 means no bit.

    `done` and `error`: bit of the first slot, and step.
    """

    size: int
    any_error: int
    network: int
    resource: int
    ready: int
    done: tuple[int, int]
    error: tuple[int, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class JobOutcome:
    """The report of a transfer that ends badly."""

    word: Expression
    """The word, as an expression over `code`, the code of the device."""
    completed: bool
    """Whether the transfer counts as a completed exchange."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EventCode:
    """The number of an event in the log, and its additional entries."""

    number: int
    entries: tuple[int, ...] = ()


WORDS = (
    "good", "late", "period", "replaced", "no_slot", "unknown_host", "no_resolver", "no_channel", "not_connected",
    "connect_timeout", "closed", "no_word", "no_place", "unsupported",
)  # fmt: skip
"""The words that a profile defines: answers to commands, in addition to the outcomes of transfers."""

OTHERWISE = "otherwise"
"""The outcome for all outcomes that a profile does not name."""


@dataclass(frozen=True, slots=True, kw_only=True)
class JobProfile:
    """The content of a job profile. Times are in nanoseconds."""

    name: str
    about: str
    source: str
    first: int
    """The number of the first slot."""
    last: int
    commands: int
    """Maximum number of commands per scan."""
    scan: int
    log: int
    connect: int
    """Time limit of the first connection."""
    pause: int
    """Minimum delay of the next transfer after a word in `pause_after`."""
    pause_after: frozenset[int]
    """Low bytes of the words that cause `pause`."""
    units: Mapping[int, TimeUnit]
    late_unit: int
    """The unit of a time-out."""
    late_most: int
    """Maximum number of units in a time-out."""
    lengths: Mapping[str, int]
    """Maximum number of elements of a transfer, by unit."""
    after_late: AfterLate
    late_again: bool
    """Whether a late transfer is reported again with every further period."""
    bits: StatusBits
    words: Mapping[str, int]
    outcomes: Mapping[str, JobOutcome]
    codes: Mapping[int, Major]
    events: Mapping[str, EventCode]
    at: Position

    @property
    def slots(self) -> range:
        """Return the numbers of the slots."""
        return range(self.first, self.last + 1)

    def kind_of(self, word: int) -> CodeClass:
        """Return the effect of a word on its job; an unknown word ends the job."""
        major = self.codes.get(word & 0xFF)
        if major is None:
            return CodeClass.FATAL
        minor = major.minors.get(word >> 8)
        return major.kind if minor is None or minor.kind is None else minor.kind

    def text_of(self, word: int) -> str:
        """Return a word as text; empty for 0, which is never an answer."""
        if word == 0:
            return ""
        major = self.codes.get(word & 0xFF)
        if major is None:
            return "unknown code"
        minor = major.minors.get(word >> 8)
        if minor is not None:
            return f"{major.text}: {minor.text}"
        return major.text if word < 0x100 else f"{major.text}, {code_text(word >> 8, 2)}"

    def mismatch_period(self, period: int) -> str | None:
        """Return why a period cannot be counted in any unit, or None if it can."""
        if period == 0 or any(
            period % unit.time == 0 and period // unit.time <= unit.most for unit in self.units.values()
        ):
            return None
        least = min(unit.time for unit in self.units.values())
        return "is no multiple" if period % least else "is too long"


# ---- runs: channels, blocks, the run itself ------------------------------------------------------------------


FaultKind = Literal[
    "delay", "jitter", "no_reply", "wrong_check", "wrong_station", "error_reply", "truncate", "extra", "glue", "split",
    "echo", "noise", "stray", "disconnect",
]  # fmt: skip
Side = Literal["replies", "requests"]

LINE_KINDS: frozenset[FaultKind] = frozenset(("noise", "stray"))
"""Faults of a line, not of a single frame."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultRule:
    """One fault. Times are in ns.

    A rule without `rate` and `every` applies to every frame. `time`, `size`, `data` and `code` are settings of the kind
    of fault; None selects the default of the kind.
    """

    kind: FaultKind
    of: Side | None = None
    """The side whose frames are affected; None if the file does not say."""
    rate: float | None = None
    """The probability per frame (for noise: per bit)."""
    every: int | None = None
    """The rule affects every n-th frame."""
    times: int | None = None
    """Maximum number of occurrences."""
    begin: int = 0
    """Start of the window in ns since the port was first opened."""
    end: int = NEVER
    """End of the window, in the same form."""
    frame: str | None = None
    time: int | None = None
    size: int | None = None
    """A number of bytes."""
    data: bytes | None = None
    before: bool = False
    code: int | None = None
    is_on: bool = True
    """Whether the rule is switched on at the start; users of the page switch rules."""
    at: Position = NOWHERE

    @property
    def is_window(self) -> bool:
        """Return whether it is a disconnection that begins and ends at fixed times, independent of frames."""
        return self.kind == "disconnect" and self.every is None and self.rate is None and self.end < NEVER


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultPlan:
    """Rules in the order of the file. A rule without `of` is about replies."""

    name: str = "faults"
    seed: int = 0
    rules: tuple[FaultRule, ...] = ()
    at: Position = NOWHERE

    def rules_of(self, side: Side) -> tuple[FaultRule, ...]:
        """Return the rules about the frames that one side sends."""
        return tuple(rule for rule in self.rules if (rule.of or "replies") == side)

    def of_line(self) -> FaultPlan:
        """Return the plan for a whole line: the echo of a request goes to the side that sent it.

        A single device can only simulate that echo by sending back its requests.
        """
        usual: dict[FaultKind, Side] = {"echo": "requests"}
        return replace(self, rules=tuple(replace(one, of=one.of or usual.get(one.kind)) for one in self.rules))

    def joined(self, other: FaultPlan | None) -> FaultPlan:
        """Return the rules of this plan, followed by those of another."""
        return self if other is None else replace(self, rules=self.rules + other.rules)


STATIONED = ("read", "write", "call")
"""Instructions of blocks with a station; blocks with other instructions have none."""

BLOCKS_IN_SET = 64
"""Number of blocks in a parameter set of a module (Snet module guide, chapter 6)."""

POINTS_SET = 0
"""The set of the blocks that read points: not available in files, with any number of blocks."""

POINTS_AREA = "(points)"
"""The memory area of the points that are read from channels; no address can name it."""


def block_label(set_: int, number: int) -> str:
    """Return a block as in messages: `5`, `2.5` for block 5 of set 2, `p5` for a block that reads points."""
    if set_ == POINTS_SET:
        return f"p{number}"
    return str(number) if set_ == 1 else f"{set_}.{number}"


def block_id(set_number: int, number: int) -> int:
    """Return one number for set and block: the number of a block in set 1, plus 64 for each further set.

    Blocks of points count down from -1.
    """
    return -1 - number if set_number == POINTS_SET else BLOCKS_IN_SET * (set_number - 1) + number


Instruction = Literal["read", "write", "send", "receive", "call", "command", "job", "abort", "inspect"]


@dataclass(frozen=True, slots=True, kw_only=True)
class OwnPlace:
    """A place in the own memory for a variable or a field."""

    address: Address
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class ArgumentPlace:
    """The source of an argument of a call: `size` elements or bytes from a place of the own memory."""

    place: OwnPlace
    type: str
    size: int = 1
    signed: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class ResultPlace:
    """The destination of a result of a call."""

    result: Expression
    place: OwnPlace
    bits: int
    """The size of the destination in bits."""
    size: int | None = None
    """The size of a list in elements, or of data in bytes."""
    scale: int = 1
    """Nanoseconds per count of a stored time; 1 for other numbers."""
    float_bits: int = 0
    """Numbers are stored as floating-point numbers with this many bits; 0: as they are."""
    is_required: bool = False
    """Whether a reply without the result fails, instead of leaving the place as it is."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """One exchange of a run, or one command to its jobs."""

    number: int
    set: int
    name: str
    instruction: Instruction
    channel: int
    """The number of the channel; 0 for a command to jobs, which uses no channel."""
    targets: tuple[str, ...] = ()
    """Addresses on the other side as text (READ, WRITE)."""
    units: tuple[str, ...] = ()
    """The unit of the elements at each target."""
    places: tuple[OwnPlace, ...] = ()
    """Places of the own memory: one for each target, or a single place for `count` elements."""
    unit: str | None = None
    """The type given in the block, if any."""
    count: int = 1
    station: Any = None
    """The station of the other side, if it is a constant."""
    station_from: OwnPlace | None = None
    """The place from which the station is read at each start."""
    frame: str | None = None
    """The frame (SEND, RECEIVE)."""
    data: Mapping[str, OwnPlace] = field(default_factory=dict)
    """Places of the own memory by field (SEND, RECEIVE)."""
    sizes: Mapping[str, int] = field(default_factory=dict)
    """Bytes of the fields whose size the frame leaves open (SEND, RECEIVE)."""
    sized_by: Mapping[str, str] = field(default_factory=dict)
    """Parameters of the protocol that give the size of a field, by field; set for the exchange (SEND)."""
    values: Any = None
    """Constants to write or send."""
    job: JobCommand | JobRecord | None = None
    """The command to the job table."""
    service: str | None = None
    """The service (CALL)."""
    arguments: Mapping[str, Any] = field(default_factory=dict)
    """Constant arguments (CALL)."""
    argument_places: Mapping[str, ArgumentPlace] = field(default_factory=dict)
    """Places of the own memory by argument (CALL)."""
    addresses: tuple[str, ...] = ()
    """The addresses on the other side that a call refers to."""
    results: tuple[ResultPlace, ...] = ()
    """The destinations of results (CALL)."""
    packing: Packing | None = None
    """How elements are packed into data of results."""
    commands: Protocol | None = None
    """The application that decodes the words at the place of the block (COMMAND)."""
    fault: OwnPlace | None = None
    """The bit that reports words which are no valid command."""
    triggers: tuple[Trigger, ...] = ()
    unless: Expression | None = None
    repeat: int | None = None
    priority: int = 0
    params: Mapping[str, Any] = field(default_factory=dict)
    merge: bool = True
    enabled: bool = True
    at: Position

    @property
    def id(self) -> int:
        """Return one number for set and block; see `block_id`."""
        return block_id(self.set, self.number)

    @property
    def lane(self) -> int:
        """Return the queue of the block: its channel, or a separate number for a command to jobs."""
        return self.channel if self.job is None else -1 - self.id

    @property
    def label(self) -> str:
        """Return the block as in messages; see `block_label`."""
        return block_label(self.set, self.number)

    @property
    def what(self) -> str:
        """Return a description: `READ M0100, M0110`, `SEND WR.REQ`."""
        if isinstance(self.job, JobCommand):
            slot = "ALL" if self.job.slot is None else str(self.job.slot)
            order = self.job.order
            return f"{self.instruction.upper()} {slot}" + (f" {order.kind} {order.remote}".rstrip() if order else "")
        return f"{self.instruction.upper()} {self.frame or self.service or ', '.join(self.targets)}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Silence:
    """Minimum silence on a channel (ns): between exchanges, after opening the port, before another station's turn."""

    between: int = 0
    connect: int = 0
    station: int = 0


DEAD_EVERY = 60_000_000_000
"""Time between two requests to a dead station that shares its channel, if the run file gives none (ns)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DeadRule:
    """A station without an answer in `failures` attempts, over `after` ns or more, is dead, and asked now and then."""

    failures: int = 3
    after: int = 10_000_000_000
    every: int | None = None
    """Time between two requests to a dead station (ns).

    None: `DEAD_EVERY` for a station that shares its channel; a station alone on its channel is asked as often as its
    blocks come due, but the line rests for as long as the request took.
    """

    @property
    def longest_pause(self) -> int:
        """Return the time between two requests to a dead station that shares its channel (ns)."""
        return DEAD_EVERY if self.every is None else self.every


@dataclass(frozen=True, slots=True, kw_only=True)
class Merge:
    """Joins neighbouring reads: at most `most` elements (None: limit of the protocol), with gaps of up to `gap`."""

    gap: int = 0
    most: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class StationRules:
    """The settings of a channel for one station: parameters of the protocol, and when it counts as dead."""

    params: Mapping[str, Any] = field(default_factory=dict)
    dead: DeadRule | None = None
    own_dead: bool = False
    """Whether `dead` replaces the rule of the channel."""


Network = ipaddress.IPv4Network | ipaddress.IPv6Network


def network_of(text: str) -> Network:
    """Return the network of an address, or of a text such as `192.168.1.0/24`. Raise ValueError."""
    try:
        return ipaddress.ip_network(text.strip())
    except ValueError:
        pass
    try:
        whole = ipaddress.ip_network(text.strip(), strict=False)
    except ValueError:
        raise ValueError(f"'{text}' is no address of clients – write one like 192.168.1.20 or 192.168.1.0/24") from None
    raise ValueError(f"'{text}' names one address and a whole network – write {whole}, or the address alone")


def in_both(some: Sequence[Network], others: Sequence[Network]) -> tuple[Network, ...]:
    """Return the addresses in both lists; an empty list means all addresses.

    Raise ValueError if they have none in common.
    """
    if not some or not others:
        return (*some, *others)
    found = [
        min(one, other, key=lambda network: network.num_addresses)
        for one in some
        for other in others
        if one.overlaps(other)
    ]
    if not found:
        raise ValueError("no client may use all devices of this line – let their 'clients' have an address in common")
    return tuple(dict.fromkeys(found))


@dataclass(frozen=True, slots=True)
class ConnectionLimits:
    """Limits that keep clients from locking each other out, and unwanted clients from connecting.

    Raise ValueError for limits that admit no client.
    """

    idle: int = 600_000_000_000
    """A connection is closed after this time without a good frame (ns)."""
    per_address: int = 64
    """Maximum number of simultaneous connections per client address."""
    allowed: tuple[Network, ...] = ()
    """The addresses of permitted clients; all clients if empty."""

    def __post_init__(self) -> None:
        if self.idle <= 0:
            raise ValueError("the idle time-out is above 0 – write a time such as 10 min, or never")
        if self.per_address <= 0:
            raise ValueError("an address may have 1 connection at least")

    def lets_in(self, host: str) -> bool:
        """Return whether a client with this address may connect."""
        if not self.allowed:
            return True
        try:
            address = ipaddress.ip_address(host)
        except ValueError:
            return False
        plain = getattr(address, "ipv4_mapped", None) or address
        return any(plain in network for network in self.allowed)


DEFAULT_LIMITS = ConnectionLimits()


@dataclass(frozen=True, slots=True, kw_only=True)
class Channel:
    """A port with a line, a protocol and a role."""

    number: int
    port: str
    protocol: Protocol
    role: str | None
    line: LineFormat | None
    own: Any
    """The own station."""
    station: Any
    """The default station of the other side."""
    params: Mapping[str, Any]
    """Parameters in their YAML form."""
    silence: Silence = Silence()
    dead: DeadRule | None = None
    merge: Merge | None = None
    stations: Mapping[Any, StationRules] = field(default_factory=dict)
    enabled: bool = True
    command_queue: int | None = None
    """Most command blocks that may wait for the channel; None: no limit."""
    command_start: int = 0
    """Time after the start of the run before which a command block is a fault (ns)."""
    answer: int = 0
    """Assumed response time of devices (ns), for estimates of the load only."""
    mapping: Mapping[str, tuple[str, int]] = field(default_factory=dict)
    """Areas of the protocol at other places of the own memory: area → memory area and number of its first element."""
    faults: FaultPlan | None = None
    wiring: LineSettings = PLAIN
    host: str = ""
    """The name by which jobs refer to the other side."""
    limits: ConnectionLimits = DEFAULT_LIMITS
    read_only: bool = False
    """Whether clients of the channel may only read."""
    at: Position
    port_at: Position
    """The position of the port in the file."""

    @property
    def asks(self) -> bool:
        """Return whether its role begins exchanges; a protocol without roles may."""
        return self.role is None or any(lane.exchange for lane in self.protocol.roles[self.role].lanes)

    @property
    def listens(self) -> bool:
        """Return whether it accepts connections, each of which it serves separately."""
        kind = scheme_of(self.port)
        return kind is not None and kind.listen is not None and (kind.open is None or not self.asks)


@dataclass(frozen=True, slots=True, kw_only=True)
class KeptState:
    """The saved state of a run: its file, the saved memory areas, and the interval of saving (ns)."""

    file: str
    areas: tuple[str, ...]
    every: int
    at: Position


@dataclass(frozen=True, slots=True)
class Scaling:
    """A value is the number in memory times `factor`, plus `offset`; both are exact."""

    factor: Decimal = Decimal(1)
    offset: Decimal = Decimal(0)

    @property
    def is_whole(self) -> bool:
        """Return whether whole numbers stay whole."""
        return self.factor == self.factor.to_integral_value() and self.offset == self.offset.to_integral_value()


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """A named value of a run: the memory at `place`, read as `form`, then scaled and named."""

    name: str
    form: Typed
    place: OwnPlace
    address: str
    """The address on `station` of `channel`, or of the own memory."""
    channel: int | None = None
    """None for a place of the own memory."""
    station: Any = None
    blocks: tuple[int, ...] = ()
    """The ids of the blocks that store the value."""
    scaling: Scaling | None = None
    order: str | None = None
    """The order of the bytes of its number as the file gives it; None without `order:`."""
    unit: str = ""
    decimals: int | None = None
    names: Mapping[int, str] = field(default_factory=dict)
    """Words for numbers."""
    deadband: float = 0.0
    """Changes up to this size are not reported."""
    stale: int = NEVER
    """The age at which the value is stale (ns)."""
    limits: tuple[float, float] | None = None
    """The range of written values, scaled."""
    writer: int | None = None
    """The id of the block that writes the value, from a place in memory of its own."""
    is_writable: bool = False
    about: str = ""
    at: Position

    @property
    def bits(self) -> int:
        """Return its size in memory in bits."""
        return self.form.bits


@dataclass(frozen=True, slots=True, kw_only=True)
class RunModel:
    """A whole run, as `framekit run` executes it."""

    name: str
    about: str
    memory: MemoryProfile
    initial: tuple[tuple[OwnPlace, tuple[int, ...]], ...]
    channels: Mapping[int, Channel]
    blocks: tuple[Block, ...]
    sets: Mapping[int, bool] = field(default_factory=lambda: {1: True})
    folder: str
    status: bool = True
    """Whether blocks have status words in memory, if the memory profile has places for them."""
    state: KeptState | None = None
    jobs: JobsSection | None = None
    points: tuple[Point, ...] = ()
    points_words: int = 0
    """The memory of the points that are read from channels, in words."""
    sinks: tuple[Any, ...] = ()
    """The destinations of values, each a `SinkKind` of the layer above."""
    files: tuple[str, ...] = ()
    """Absolute paths of the files of the sinks and of the saved state."""
    fleet: Any = None
    """The fleet that the run belongs to, if any."""
    only_reads: bool = False
    """Whether the run writes to no device and its clients may only read."""
    warnings: tuple[Problem, ...]
    at: Position

    def create_memory(self) -> DeviceMemory:
        """Return the own memory, all 0: the areas of the profile, then the area of points read from channels."""
        memory = self.memory.create()
        if self.points_words:
            memory.add(Area(POINTS_AREA, size=self.points_words))
        return memory

    @property
    def triggers(self) -> Iterator[Trigger]:
        """Return the triggers of all blocks."""
        return (trigger for block in self.blocks for trigger in block.triggers)


OrderKind = Literal["read", "write", "report"]
CommandKind = Literal["job", "abort", "inspect"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Order:
    """A repeated transfer: `remote` is read into `place` or written from it; a report has no `remote`.

    The other side is `host`, by number or name, or a `channel` of the run.
    """

    slot: int
    kind: OrderKind
    place: OwnPlace
    remote: str = ""
    unit: str | None = None
    """None: the unit of the address."""
    count: int = 1
    host: str = ""
    channel: int | None = None
    station: Any = None
    params: Mapping[str, Any] = field(default_factory=dict)
    """Values that take precedence over the parameters of the protocol."""
    period: int = 0
    """The period (ns); 0: transfers without a pause."""
    late: int = 0
    """The time-out (ns); 0: none."""
    times: int = 0
    """The number of transfers; 0: until the job is aborted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class JobCommand:
    """Starts a job (`order`), aborts one or all (`slot` None), or stores the two detail words of a job (`into`)."""

    kind: CommandKind
    slot: int | None
    order: Order | None = None
    into: OwnPlace | None = None
    status: OwnPlace | None = None
    """The place of the answer."""
    id: int | None = None
    """The id of the block that waits for the answer."""


@dataclass(frozen=True, slots=True, kw_only=True)
class JobRecord:
    """A command whose words are in the own memory at `place`; `application` decodes them when the block starts."""

    place: OwnPlace
    application: Protocol
    fault: OwnPlace | None = None
    """The own bit that reports words which are no valid command."""
    id: int | None = None
    """As in `JobCommand`."""


HOST = "{host}"
"""Placeholder of the host address in the port of channels that are opened on demand."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Opening:
    """The template of channels for hosts without a channel: the address replaces `{host}` in its port."""

    channel: Channel
    connections: int
    """Maximum number of these channels at the same time."""

    @property
    def leads_anywhere(self) -> bool:
        """Return whether the port is the same for every host, so that no address has to be resolved."""
        return HOST not in self.channel.port

    def port_to(self, address: str) -> str:
        """Return the port for an address."""
        port = self.channel.port
        return port.replace(HOST, f"[{address}]" if ":" in address and "://" in port else address)


@dataclass(frozen=True, slots=True, kw_only=True)
class JobsSection:
    """The jobs of a run: its profile with the changes of the run, the place of the status bits, and hosts by name."""

    profile: JobProfile
    status: OwnPlace | None = None
    hosts: Mapping[str, str] = field(default_factory=dict)
    waits: bool = True
    """Whether surplus commands of a scan wait for the next scan; otherwise they are dropped."""
    commands: Protocol | None = None
    """The application that decodes commands in memory."""
    opening: Opening | None = None
    """The template of channels for hosts without a channel; None: no such channels."""
    at: Position


def host_of(channel: Channel) -> str:
    """Return the name by which jobs refer to the other side of a channel; empty if it has none."""
    return channel.host or port_host(channel.port)


def channel_to(host: str, channels: Mapping[int, Channel]) -> int | None:
    """Return the first channel whose other side has this name."""
    return next((number for number, channel in channels.items() if host_of(channel) == host), None)


def is_address(host: str) -> bool:
    """Return whether a host is given by its address, without a need for a name service."""
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True
