"""How a port is wired and switched, beside its speed and format: kind of interface, direction, echo, modem.

Plain values; times are ns. Who carries them out is not known here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Interface = Literal["rs232", "rs422", "rs485"]
Handshake = Literal["none", "rtscts", "xonxoff"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Direction:
    """What switches the transmitter: RTS, set by this program (`rts`) or by the port's driver.

    `high`: the level while sending. `before`, `after`: how long the level is there before the first and behind the last
    bit (ns).
    """

    by: Literal["rts", "driver"] = "rts"
    high: bool = True
    before: int = 0
    after: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Modem:
    """A modem on the line. `init` is sent first; `answer`: None for a dedicated line, else the ring it answers at."""

    init: str = "ATZ"
    answer: int | None = 1
    reply_within: int = 5_000_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class LineSettings:
    """Everything about a port but speed and format; the defaults are a plain port.

    `listen_only`: a serial port is opened with RTS and DTR off, for a line that others use.

    `connect_within` and `reconnect`: how long making a connection may take, and the longest pause before a lost port is
    opened again (ns); None for the usual ones.
    """

    type: Interface | None = None
    half_duplex: bool = False
    echo: bool = False
    direction: Direction | None = None
    handshake: Handshake = "none"
    connect_within: int | None = None
    reconnect: int | None = None
    modem: Modem | None = None
    listen_only: bool = False


PLAIN = LineSettings()

SPEEDS = (300, 600, 1200, 1800, 2400, 3600, 4800, 7200, 9600, 19200, 38400, 57600, 64000, 115200)
"""Speeds of every interface (Snet module guide, Table 14)."""

FAST = (230400, 460800, 500000, 921600, 1000000)
"""Speeds that only balanced lines reach."""

MOST_STATIONS = {"rs232": 1, "rs422": 10, "rs485": 32}
"""Devices on one line: RS-232 joins two, RS-422 has ten receivers (TIA-422), RS-485 32 unit loads (Snet guide, 2)."""
