"""Times and lines: how long things take, in whole nanoseconds; how a port is wired and switched."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

from framekit.definition.numbers import whole_number

NEVER = 1 << 62
"""Infinite time: larger than every other, so that it may be compared, added and minimised."""

UNITS = {
    "ns": 1,
    "us": 1_000,
    "ms": 1_000_000,
    "s": 1_000_000_000,
    "min": 60_000_000_000,
    "h": 3_600_000_000_000,
    "d": 86_400_000_000_000,
}
LINE_UNITS = ("chars", "bits")

_TIME = re.compile(r"\s*(\d+(?:\.\d+)?)\s*(ns|us|ms|s|min|h|d)")


@dataclass(frozen=True, slots=True)
class LineFormat:
    """Speed in bits a second and the shape of a character; `parity` is one of N, E, O, M, S.

    With nine `data_bits` the ninth is a mark of the character: bytes are handed over, and which of them are marked.
    """

    speed: int
    data_bits: int = 8
    parity: str = "N"
    stop_bits: float = 1

    @property
    def has_marks(self) -> bool:
        """Return whether each character has a ninth bit, which marks it."""
        return self.data_bits == 9

    @property
    def character_bits(self) -> float:
        return 1 + self.data_bits + (self.parity != "N") + self.stop_bits

    @property
    def character_time(self) -> int:
        return round(1_000_000_000 * self.character_bits / self.speed)

    def __str__(self) -> str:
        return f"{self.speed} {self.data_bits}{self.parity}{self.stop_bits:g}"


MOST_SPEED = 1_000_000_000
"""The highest speed of a line (bits a second): a bit takes a nanosecond then, the unit of all times."""


_FORMAT = re.compile(r"([5-9])([NEOMSneoms])(1|1\.5|2)")


def is_format(text: str) -> bool:
    """Return whether a text is written like the format of a line: `8E1`."""
    return _FORMAT.fullmatch(text.strip()) is not None


def parse_format(text: str, speed: int) -> LineFormat:
    """Parse `8E1`, `7O2`, `8N1.5` at `speed` bits a second. Raises ValueError with a sentence for other texts."""
    match = _FORMAT.fullmatch(text.strip())
    if match is None:
        raise ValueError(f"'{text}' is not a line format – write data bits, parity and stop bits, such as 8N1 or 7E1")
    if match[1] == "9" and match[2] not in "Nn":
        raise ValueError(f"'{text}' has a parity besides the ninth bit – write 9N{match[3]}")
    if not 1 <= speed <= MOST_SPEED:
        raise ValueError(f"{speed} is not a line speed – write 1 to {MOST_SPEED} bits a second")
    return LineFormat(speed, int(match[1]), match[2].upper(), float(match[3]))


def parse_time(text: str) -> int:
    """Parse `50 ms`, `1.5 s`, `never`; return nanoseconds. Several parts add up (`1 h 30 min`). Raises ValueError."""
    text = text.strip()
    if text == "never":
        return NEVER
    total, end = 0, 0
    while match := _TIME.match(text, end):
        total += _scaled(match[1], UNITS[match[2]])
        end = match.end()
    if end == 0 or text[end:].strip():
        raise ValueError(f"'{text}' is not a time – write a number and a unit (ms, s, min, h, d), such as 50 ms or 3 s")
    return total


def _scaled(number: str, unit: int) -> int:
    whole, _, fraction = number.partition(".")
    value = whole_number(whole) * unit
    return value + whole_number(fraction) * unit // 10 ** len(fraction) if fraction else value


def readable_time(time: int) -> str:
    """Return a time (ns) for users: to the microsecond, from one second on in seconds: `12.5 ms`, `0.002 ms`, `1.25 s`,
    `never`.
    """
    if time >= NEVER:
        return "never"
    return f"{round(time / 1e9, 6):.10g} s" if time >= UNITS["s"] else f"{round(time / 1e6, 3):.10g} ms"


def format_time(time: int) -> str:
    """Return the shortest exact form in one unit: `50 ms`, `1500 ms`, `3 s`, `never`."""
    if time >= NEVER:
        return "never"
    for unit in ("h", "min", "s", "ms", "us"):
        if time and time % UNITS[unit] == 0:
            return f"{time // UNITS[unit]} {unit}"
    return f"{time} ns" if time else "0 ms"


Interface = Literal["rs232", "rs422", "rs485"]
Handshake = Literal["none", "rtscts", "xonxoff"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Direction:
    """Switching of the transmitter."""

    by: Literal["rts", "driver"] = "rts"
    """`rts`: this program sets RTS; `driver`: the port's driver switches."""
    high: bool = True
    """Level while sending."""
    before: int = 0
    """Duration of the level before the first bit (ns)."""
    after: int = 0
    """Duration of the level after the last bit (ns)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Dialling:
    """The call that a modem makes when its port opens."""

    number: str
    """Dial string without separators: digits, `*#`, letters of V.250, an optional `T` or `P` first."""
    extension: str = ""
    """Digits dialled after the number and a pause."""
    connect_within: int = 60_000_000_000
    """Time limit from the dial command to the connection (ns)."""
    retries: int = 3
    """Number of further calls, each after `pause`, before the port waits for `rest`."""
    pause: int = 10_000_000_000
    """Shortest time between the end of a call and the next call (ns)."""
    rest: int = 600_000_000_000
    """Time without calls after the last of the `retries` has failed (ns)."""

    @property
    def command(self) -> str:
        """Return the dial command; a number without `T` or `P` is dialled by tones."""
        mode = "" if self.number[:1] in ("T", "P") else "T"
        return f"ATD{mode}{self.number}" + (f",{self.extension}" if self.extension else "")


HangUp = Literal["escape", "dtr"]
"""How a connection ends: by the escape sequence and `ATH`, or by DTR off."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Modem:
    """A modem on the line: it dials, answers calls, or is on a dedicated line."""

    init: str = "ATZ"
    """Commands sent first, separated by `;`."""
    answer: int | None = 1
    """The ring at which it answers; None: it answers no calls."""
    dialling: Dialling | None = None
    """The call that it makes; None: it makes no calls."""
    reply_within: int = 5_000_000_000
    """Time limit for the reply to a command (ns)."""
    hang_up: HangUp = "escape"
    guard: int = 1_000_000_000
    """Silence before and after the escape sequence (ns)."""

    @property
    def is_switched(self) -> bool:
        """Whether it has calls, which can end; False on a dedicated line."""
        return self.answer is not None or self.dialling is not None


@dataclass(frozen=True, slots=True, kw_only=True)
class LineSettings:
    """Settings of a port apart from speed and format; the defaults are a plain port.

    `listen_only`: a serial port is opened with RTS and DTR off, for a line that others use. `connect_within` and
    `reconnect`: the time limit for a connection, and the longest pause before a lost port is opened again (ns); None
    for the defaults.
    """

    type: Interface | None = None
    half_duplex: bool = False
    echo: bool | None = None
    """Whether the port hears what it sends, and the echo has to be removed; None: unknown."""
    direction: Direction | None = None
    handshake: Handshake = "none"
    connect_within: int | None = None
    reconnect: int | None = None
    modem: Modem | None = None
    listen_only: bool = False

    @property
    def may_hear_itself(self) -> bool:
        """Whether the client may hear an echo of its frames: the settings do not exclude it."""
        return self.echo is None and self.type not in ("rs232", "rs422")


PLAIN = LineSettings()

SPEEDS = (300, 600, 1200, 1800, 2400, 3600, 4800, 7200, 9600, 19200, 38400, 57600, 64000, 115200)
"""Speeds of every interface (Snet module guide, Table 14)."""

FAST = (230400, 460800, 500000, 921600, 1000000)
"""Speeds that only balanced lines reach."""

MOST_STATIONS = {"rs232": 1, "rs422": 10, "rs485": 32}
"""Devices on one line: RS-232 joins two, RS-422 has ten receivers (TIA-422), RS-485 32 unit loads (Snet guide, 2)."""


def milliseconds(time: float) -> str:
    """Return a time (ns) with three digits: `34 ms`, `2.5 ms`."""
    return f"{float(f'{time / 1e6:.3g}'):g} ms"
