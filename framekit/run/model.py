"""What run files and job profiles say, as frozen values: channels, memory, blocks, jobs.

Block instructions and their words are those of the P2P service (Snet module guide, chapter 6): READ, WRITE, SEND,
RECEIVE with trigger conditions. Addresses of the own memory are resolved; those of the other side are kept as text,
for the protocol of the block's channel to read. A job profile is the content of a file `NAME.jobs.yaml`: how many slots
a family of devices has, its limits, where its status bits stand and what its codes are.
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
    """What becomes of a job whose transfer ends with a code."""

    GOOD = "good"
    TRANSIENT = "transient"
    """It goes on."""
    RESOURCE = "resource"
    """It goes on, and something was short: shown for a while by a bit of its own."""
    SYNTAX = "syntax"
    """It never began."""
    FATAL = "fatal"
    """It ends."""


class AfterLate(Enum):
    """When the next transfer starts after one that took longer than its period."""

    NEXT_PERIOD = "next_period"
    AT_ONCE = "at_once"


@dataclass(frozen=True, slots=True)
class Minor:
    """What the high byte of a word adds to its low byte; `kind` None: as the low byte says."""

    text: str
    kind: CodeClass | None = None


@dataclass(frozen=True, slots=True)
class Major:
    """What the low byte of a word says, and its minor codes by their numbers."""

    text: str
    kind: CodeClass
    minors: Mapping[int, Minor] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class TimeUnit:
    """A unit in which periods are counted: how long one is (ns), and how many there may be."""

    time: int
    most: int


@dataclass(frozen=True, slots=True, kw_only=True)
class StatusBits:
    """Which bit of the status area shows what; bits count from 1, 0 is none. `done` and `error`: first and step."""

    size: int
    any_error: int
    network: int
    resource: int
    ready: int
    done: tuple[int, int]
    error: tuple[int, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class JobOutcome:
    """How a transfer can end badly: its word, and whether an exchange was completed all the same.

    `word` is an expression over `code`, the device's own code.
    """

    word: Expression
    completed: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class EventCode:
    """The number of an event in the log and what stands beside it."""

    number: int
    entries: tuple[int, ...] = ()


WORDS = (
    "good", "late", "period", "replaced", "no_slot", "unknown_host", "no_resolver", "no_channel", "not_connected",
    "connect_timeout", "closed", "no_word", "no_place", "unsupported",
)  # fmt: skip
"""The words a profile gives: what a command is answered with, beside the outcomes of transfers."""

OTHERWISE = "otherwise"
"""The outcome that stands for those a profile does not name."""


@dataclass(frozen=True, slots=True, kw_only=True)
class JobProfile:
    """Everything a profile says. Times in nanoseconds.

    `commands` may come in a scan. `connect`: how long the first connection may take. `pause`: after a word whose low
    byte is in `pause_after` the next transfer waits at least so long. `late_unit` and `late_most` limit how a time-out
    is given. `late_again`: a late transfer is told again with every further period.
    """

    name: str
    about: str
    source: str
    first: int
    last: int
    commands: int
    scan: int
    log: int
    connect: int
    pause: int
    pause_after: frozenset[int]
    units: Mapping[int, TimeUnit]
    late_unit: int
    late_most: int
    lengths: Mapping[str, int]
    after_late: AfterLate
    late_again: bool
    bits: StatusBits
    words: Mapping[str, int]
    outcomes: Mapping[str, JobOutcome]
    codes: Mapping[int, Major]
    events: Mapping[str, EventCode]
    at: Position

    @property
    def slots(self) -> range:
        """The numbers of the slots."""
        return range(self.first, self.last + 1)

    def kind_of(self, word: int) -> CodeClass:
        """What becomes of a job with this word; what no code says ends it."""
        major = self.codes.get(word & 0xFF)
        if major is None:
            return CodeClass.FATAL
        minor = major.minors.get(word >> 8)
        return major.kind if minor is None or minor.kind is None else minor.kind

    def text_of(self, word: int) -> str:
        """A word by name; empty for 0, which nothing ever answers."""
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
        """Why a period cannot be counted in any of the units; None when it can."""
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
"""Faults that happen to a line and not to a single frame."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultRule:
    """One fault. Times are ns; `begin` and `end` count from the first opening of the port.

    `rate` is the probability for each frame (of noise: for each bit), `every` hits each so many frames; with neither it
    always happens, at most `times` times. `of` is None where the file does not say. What `time`, `size` (bytes), `data`
    and `code` mean is the kind's business; None: its usual value.
    """

    kind: FaultKind
    of: Side | None = None
    rate: float | None = None
    every: int | None = None
    times: int | None = None
    begin: int = 0
    end: int = NEVER
    frame: str | None = None
    time: int | None = None
    size: int | None = None
    data: bytes | None = None
    before: bool = False
    code: int | None = None
    at: Position = NOWHERE

    @property
    def is_window(self) -> bool:
        """Whether it is a disconnection that begins and ends by itself, whatever is sent."""
        return self.kind == "disconnect" and self.every is None and self.rate is None and self.end < NEVER


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultPlan:
    """Rules in the order of the file. One that does not say `of` is about replies."""

    name: str = "faults"
    seed: int = 0
    rules: tuple[FaultRule, ...] = ()
    at: Position = NOWHERE

    def rules_of(self, side: Side) -> tuple[FaultRule, ...]:
        """The rules about what one side sends."""
        return tuple(rule for rule in self.rules if (rule.of or "replies") == side)

    def of_line(self) -> FaultPlan:
        """The plan of a whole line: the side that asks hears itself.

        A device alone can only give it that by sending back what it hears.
        """
        usual: dict[FaultKind, Side] = {"echo": "requests"}
        return replace(self, rules=tuple(replace(one, of=one.of or usual.get(one.kind)) for one in self.rules))

    def joined(self, other: FaultPlan | None) -> FaultPlan:
        """Its own rules, then those of another plan."""
        return self if other is None else replace(self, rules=self.rules + other.rules)


STATIONED = ("read", "write", "call")
"""Instructions of blocks that talk to one station; the others have none."""

BLOCKS_IN_SET = 64
"""A parameter set of a module has so many blocks (Snet module guide, chapter 6)."""

POINTS_SET = 0
"""The set of the blocks that read points; no file can name it, and there may be any number of blocks."""

POINTS_AREA = "(points)"
"""The area of memory in which points stand that are read from a channel; no address names it."""


def block_label(set_: int, number: int) -> str:
    """A block as people write it: `5`, `2.5` for block 5 of set 2, `p5` for one that reads points."""
    if set_ == POINTS_SET:
        return f"p{number}"
    return str(number) if set_ == 1 else f"{set_}.{number}"


def block_id(set_number: int, number: int) -> int:
    """One number for set and block: that of the block in set 1, and 64 more for each further set.

    Blocks of points count down from -1.
    """
    return -1 - number if set_number == POINTS_SET else BLOCKS_IN_SET * (set_number - 1) + number


Instruction = Literal["read", "write", "send", "receive", "call", "command", "job", "abort", "inspect"]


@dataclass(frozen=True, slots=True, kw_only=True)
class OwnPlace:
    """A piece of the own memory that a variable or a field is read from or written to."""

    address: Address
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class ArgumentPlace:
    """Where an argument of a call comes from: a place of the own memory, and `size` elements or bytes from there on."""

    place: OwnPlace
    type: str
    size: int = 1
    signed: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class ResultPlace:
    """Where a result of a call goes. `size`: the elements of a list, or bytes, that there is room for.

    `scale`: a number that is a time goes as so many nanoseconds each. `bits`: how much of the memory is its.
    `float_bits`: each number goes as a floating-point number of so many bits; 0: as it is.
    """

    result: Expression
    place: OwnPlace
    bits: int
    size: int | None = None
    scale: int = 1
    float_bits: int = 0
    is_required: bool = False
    """Whether a reply without the result fails, instead of leaving the place as it is."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """One exchange of a run.

    `targets`: addresses on the other side as text (READ, WRITE), `units`: what an element of each is, `unit`: the
    block's own type, if it gives one. `places`: own memory, one for each target; a single one for `count` elements.
    `frame`, `data` (field → own memory) and `sizes` (bytes of a field whose frame leaves that open): SEND and RECEIVE;
    `sized_by`: fields whose size is a parameter of the protocol, which gets it for the exchange.
    `service` and `arguments`: CALL, with `argument_places` (argument → own memory), the `addresses` on the other side
    that it is about, and where its `results` go; data among them are packed as `packing` says. `station`: a constant,
    or the place it is read from at each start. `values`: constants to write or send. `commands`: the application that
    reads the words at the block's place (COMMAND), and `fault` the bit that shows words it cannot carry out. `job`: the
    command that it gives to the job table; such a block has no channel of its own, and the number 0 there.
    """

    number: int
    set: int
    name: str
    instruction: Instruction
    channel: int
    targets: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    places: tuple[OwnPlace, ...] = ()
    unit: str | None = None
    count: int = 1
    station: Any = None
    station_from: OwnPlace | None = None
    frame: str | None = None
    data: Mapping[str, OwnPlace] = field(default_factory=dict)
    sizes: Mapping[str, int] = field(default_factory=dict)
    sized_by: Mapping[str, str] = field(default_factory=dict)
    values: Any = None
    job: JobCommand | JobRecord | None = None
    service: str | None = None
    arguments: Mapping[str, Any] = field(default_factory=dict)
    argument_places: Mapping[str, ArgumentPlace] = field(default_factory=dict)
    addresses: tuple[str, ...] = ()
    results: tuple[ResultPlace, ...] = ()
    packing: Packing | None = None
    commands: Protocol | None = None
    fault: OwnPlace | None = None
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
        """One number for set and block; see `block_id`."""
        return block_id(self.set, self.number)

    @property
    def lane(self) -> int:
        """What it waits for: its channel; a command waits only for itself."""
        return self.channel if self.job is None else -1 - self.id

    @property
    def label(self) -> str:
        """As people write it."""
        return block_label(self.set, self.number)

    @property
    def what(self) -> str:
        """What it does: `READ M0100, M0110`, `SEND WR.REQ`."""
        if isinstance(self.job, JobCommand):
            slot = "ALL" if self.job.slot is None else str(self.job.slot)
            order = self.job.order
            return f"{self.instruction.upper()} {slot}" + (f" {order.kind} {order.remote}".rstrip() if order else "")
        return f"{self.instruction.upper()} {self.frame or self.service or ', '.join(self.targets)}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Silence:
    """Least silence on a channel (ns): between two exchanges, after opening the port, before another station's turn."""

    between: int = 0
    connect: int = 0
    station: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class DeadRule:
    """A station that has not answered `failures` times in a row, for `after` ns at least, is asked every `every` ns."""

    failures: int = 3
    after: int = 10_000_000_000
    every: int = 60_000_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Merge:
    """Neighbouring reads become one: at most `most` elements (None: as the protocol can), `gap` of them in vain."""

    gap: int = 0
    most: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class StationRules:
    """What a channel does otherwise with one station: parameters of the protocol, and when it counts as dead."""

    params: Mapping[str, Any] = field(default_factory=dict)
    dead: DeadRule | None = None
    own_dead: bool = False


Network = ipaddress.IPv4Network | ipaddress.IPv6Network


def network_of(text: str) -> Network:
    """An address, or a network such as `192.168.1.0/24`. Raises ValueError."""
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
    """The addresses that are in both; no networks at all are all addresses. Raises ValueError where none is."""
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
    """What keeps a few clients from locking the others out, and strangers outside.

    `idle`: a connection over which no good frame went for so long (ns) is closed. `per_address`: connections that one
    client address may have at once. `allowed`: where clients may come from; from everywhere, if it is empty. Raises
    ValueError for limits that let no client in.
    """

    idle: int = 600_000_000_000
    per_address: int = 64
    allowed: tuple[Network, ...] = ()

    def __post_init__(self) -> None:
        if self.idle <= 0:
            raise ValueError("the idle time-out is above 0 – write a time such as 10 min, or never")
        if self.per_address <= 0:
            raise ValueError("an address may have 1 connection at least")

    def lets_in(self, host: str) -> bool:
        """Whether a client with this address may come in."""
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
    """A port with a line, a protocol and a role. `own`: the own station; `params` as written, in their YAML form.

    `port_at`: where the port is named. `mapping`: areas of the protocol that stand elsewhere in the own memory when
    others are answered (area → memory area and the number of its first element there). `answer`: how long devices are
    taken to need for an answer (ns) when the load is worked out; nothing at work depends on it. `host`: how jobs call
    the other side. `read_only`: those that it answers may write nothing.
    """

    number: int
    port: str
    protocol: Protocol
    role: str | None
    line: LineFormat | None
    own: Any
    station: Any
    params: Mapping[str, Any]
    silence: Silence = Silence()
    dead: DeadRule | None = None
    merge: Merge | None = None
    stations: Mapping[Any, StationRules] = field(default_factory=dict)
    enabled: bool = True
    answer: int = 0
    mapping: Mapping[str, tuple[str, int]] = field(default_factory=dict)
    faults: FaultPlan | None = None
    wiring: LineSettings = PLAIN
    host: str = ""
    limits: ConnectionLimits = DEFAULT_LIMITS
    read_only: bool = False
    at: Position
    port_at: Position

    @property
    def asks(self) -> bool:
        """Whether its role begins exchanges; a protocol without roles may."""
        return self.role is None or any(lane.exchange for lane in self.protocol.roles[self.role].lanes)

    @property
    def listens(self) -> bool:
        """Whether others make connections to it, each of which is answered by itself."""
        kind = scheme_of(self.port)
        return kind is not None and kind.listen is not None and (kind.open is None or not self.asks)


@dataclass(frozen=True, slots=True, kw_only=True)
class KeptState:
    """Where a run keeps its state: the file, the areas of the memory that are kept, how often it is written (ns)."""

    file: str
    areas: tuple[str, ...]
    every: int
    at: Position


@dataclass(frozen=True, slots=True)
class Scaling:
    """A value is what stands in memory times `factor`, and `offset` more; both are exact."""

    factor: Decimal = Decimal(1)
    offset: Decimal = Decimal(0)

    @property
    def is_whole(self) -> bool:
        """Whether whole numbers stay whole."""
        return self.factor == self.factor.to_integral_value() and self.offset == self.offset.to_integral_value()


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """A named value of a run: `bits` bits of its memory at `place`, read as `form`, then scaled and named.

    `address` on `station` of `channel`; without a channel it is a place of the run's own memory. `blocks`: the ids of
    those whose good end brings it. `names`: words for numbers. `deadband`: what changes by no more is not told. `stale`
    (ns): a value that is older is stale. `limits`: what may be written, in the value's own scale; `writer`: the block
    that writes it, whose place in memory takes the value first.
    """

    name: str
    form: Typed
    place: OwnPlace
    address: str
    channel: int | None = None
    station: Any = None
    blocks: tuple[int, ...] = ()
    scaling: Scaling | None = None
    unit: str = ""
    decimals: int | None = None
    names: Mapping[int, str] = field(default_factory=dict)
    deadband: float = 0.0
    stale: int = NEVER
    limits: tuple[float, float] | None = None
    writer: int | None = None
    is_writable: bool = False
    about: str = ""
    at: Position

    @property
    def bits(self) -> int:
        """How much of the memory it takes."""
        return self.form.bits


@dataclass(frozen=True, slots=True, kw_only=True)
class RunModel:
    """A whole run: what `framekit run` carries out.

    `status`: whether blocks have their words in memory, where the memory profile has places for them. `points_words`:
    how much memory the points of channels take. `sinks`: where values go, each a `SinkKind` of the layer above.
    `files`: those that sinks and the state have (absolute paths). `fleet`: which one it is of, if any. `only_reads`: it
    writes into no device, and others write nothing into it.
    """

    name: str
    about: str
    memory: MemoryProfile
    initial: tuple[tuple[OwnPlace, tuple[int, ...]], ...]
    channels: Mapping[int, Channel]
    blocks: tuple[Block, ...]
    sets: Mapping[int, bool] = field(default_factory=lambda: {1: True})
    folder: str
    status: bool = True
    state: KeptState | None = None
    jobs: JobsSection | None = None
    points: tuple[Point, ...] = ()
    points_words: int = 0
    sinks: tuple[Any, ...] = ()
    files: tuple[str, ...] = ()
    fleet: Any = None
    only_reads: bool = False
    warnings: tuple[Problem, ...]
    at: Position

    def create_memory(self) -> DeviceMemory:
        """The own memory, all 0; behind the areas of the profile one for the points that are read from channels."""
        memory = self.memory.create()
        if self.points_words:
            memory.add(Area(POINTS_AREA, size=self.points_words))
        return memory

    @property
    def triggers(self) -> Iterator[Trigger]:
        """Those of all blocks."""
        return (trigger for block in self.blocks for trigger in block.triggers)


OrderKind = Literal["read", "write", "report"]
CommandKind = Literal["job", "abort", "inspect"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Order:
    """A transfer that is repeated. `remote` is read into `place`, or written from it; a report has no `remote`.

    `count` elements of `unit` (None: what the address says). The other side is `host`, by number or name, or `channel`
    of the run. `period` 0: back to back. `late` (ns) 0: no time-out is told. `times` 0: until it is aborted.
    `params` go before the protocol's parameters.
    """

    slot: int
    kind: OrderKind
    place: OwnPlace
    remote: str = ""
    unit: str | None = None
    count: int = 1
    host: str = ""
    channel: int | None = None
    station: Any = None
    params: Mapping[str, Any] = field(default_factory=dict)
    period: int = 0
    late: int = 0
    times: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class JobCommand:
    """Establishes a job (`order`), aborts one, or all (`slot` None), or stores the two detail words of one (`into`).

    `status`: where the answer is written; `id`: for what wants to hear of it. Two commands are never the same.
    """

    kind: CommandKind
    slot: int | None
    order: Order | None = None
    into: OwnPlace | None = None
    status: OwnPlace | None = None
    id: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class JobRecord:
    """A command whose words stand in the own memory at `place`, as `application` reads them when it is given.

    `fault`: the own bit that shows words that are no command; `id` as for commands.
    """

    place: OwnPlace
    application: Protocol
    fault: OwnPlace | None = None
    id: int | None = None


HOST = "{host}"
"""Stands for a host's address in the port of channels that are opened when they are wanted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Opening:
    """The channel that is opened for a host to which none leads: `{host}` in its port stands for the address.

    `connections`: so many of these at once.
    """

    channel: Channel
    connections: int

    @property
    def leads_anywhere(self) -> bool:
        """Whether the port is the same for every host: then it is not asked where one is."""
        return HOST not in self.channel.port

    def port_to(self, address: str) -> str:
        """The port that leads to an address."""
        port = self.channel.port
        return port.replace(HOST, f"[{address}]" if ":" in address and "://" in port else address)


@dataclass(frozen=True, slots=True, kw_only=True)
class JobsSection:
    """The profile with what the run changes of it, where status bits stand, and addresses of hosts by name.

    `waits`: commands of blocks that are too many for a scan wait for the next one; else they are lost. `commands` reads
    commands whose words stand in memory. `opening`: what is done for hosts without a channel; None: nothing.
    """

    profile: JobProfile
    status: OwnPlace | None = None
    hosts: Mapping[str, str] = field(default_factory=dict)
    waits: bool = True
    commands: Protocol | None = None
    opening: Opening | None = None
    at: Position


def host_of(channel: Channel) -> str:
    """How jobs call the other side of a channel; empty where nothing says it."""
    return channel.host or port_host(channel.port)


def channel_to(host: str, channels: Mapping[int, Channel]) -> int | None:
    """The first channel that leads to a host, by what it is called there."""
    return next((number for number, channel in channels.items() if host_of(channel) == host), None)


def is_address(host: str) -> bool:
    """Whether a host is given by its address, and needs no name service."""
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True
