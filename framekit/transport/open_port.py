"""A port from what a run file or a command line calls it. Simulated lines are made above this layer.

Whoever knows other kinds of ports hands in how they are opened, by scheme.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import replace

from framekit.definition.line_settings import PLAIN, LineSettings
from framekit.definition.times import LineFormat
from framekit.transport.clock import AsyncioClock, Clock
from framekit.transport.port import Port

UDP_SCHEMES = ("udp", "udp-listen")
SERIAL_SCHEMES = ("loop", "socket", "rfc2217", "spy", "hwgrep", "alt")
"""The URLs of pyserial."""

Opener = Callable[[str, LineFormat | None, Clock], Port]
"""Makes a port of a whole URL, such as `sim:pump.device.yaml`. Raises ValueError."""


def open_port(
    url: str,
    settings: LineFormat | None,
    clock: Clock,
    openers: Mapping[str, Opener] | None = None,
    wiring: LineSettings = PLAIN,
    *,
    listen_only: bool = False,
) -> Port:
    """`/dev/ttyUSB0`, `COM3`, `tcp://HOST:PORT`, `udp://HOST:PORT`, any pyserial URL, the schemes of `openers`.

    It is not yet opened. `udp-listen://HOST:PORT` answers whoever asked last. `wiring` is carried out on it.

    `listen_only`: a serial port is opened with RTS and DTR off.

    Raises ValueError, with a sentence, for anything else and for a real port on a clock that is not real.
    """
    found = re.match(r"([A-Za-z][A-Za-z0-9+.-]*):", url)
    scheme = found[1].lower() if found else None
    if scheme is not None and openers is not None and scheme in openers:
        return openers[scheme](url, settings, clock)
    if not url.strip() or (scheme not in (None, "tcp", *UDP_SCHEMES, *SERIAL_SCHEMES)) or (scheme and "://" not in url):
        raise ValueError(_unknown(url, openers or ()))
    if not isinstance(clock, AsyncioClock):
        raise ValueError(f"'{url}' is a real port and needs real time – use sim: on a virtual clock")
    if scheme == "tcp":
        from framekit.transport.tcp_port import TcpPort

        host, number = host_and_port(url.partition("://")[2])
        return wired(TcpPort(host, number, clock, wiring.connect_within), wiring, clock)
    if scheme in UDP_SCHEMES:
        from framekit.transport.udp_port import UdpPort

        host, number = host_and_port(url.partition("://")[2])
        return wired(UdpPort(host, number, clock, listens=scheme == "udp-listen"), wiring, clock)
    from framekit.transport.serial_port import SerialPort

    if listen_only:
        wiring = replace(wiring, listen_only=True)
    return wired(SerialPort(url, settings, clock, wiring), wiring, clock)


def wired(port: Port, wiring: LineSettings, clock: Clock) -> Port:
    """What a port's wiring needs around it: direction, echo, modem; the port itself where it needs nothing."""
    if wiring.direction is not None and wiring.direction.by == "rts":
        from framekit.transport.direction_port import DirectionPort

        port = DirectionPort(port, wiring.direction, clock)
    if wiring.echo:
        from framekit.transport.echo_port import EchoFreePort

        port = EchoFreePort(port, clock)
    if wiring.modem is not None:
        from framekit.transport.modem_port import ModemPort

        port = ModemPort(port, wiring.modem, clock)
    return port


def _unknown(url: str, others: Mapping[str, Opener] | tuple[()]) -> str:
    if re.fullmatch(r"[A-Za-z0-9.-]+:\d+", url):
        return f"'{url}' is no port – write tcp://{url} for a connection to that host"
    known = ["a device such as /dev/ttyUSB0", "tcp://HOST:PORT", "udp://HOST:PORT", "udp-listen://HOST:PORT"]
    known += [f"{name}://" for name in SERIAL_SCHEMES] + [f"{name}:" for name in others]
    return f"'{url}' is no port – known are {', '.join(known)}"


def host_and_port(text: str) -> tuple[str, int]:
    """`HOST:PORT`, with brackets around an IPv6 address. Raises ValueError."""
    host, colon, number = text.rstrip("/").rpartition(":")
    if not colon or not number.isdigit() or not 0 <= int(number) <= 65535:
        raise ValueError(f"'{text}' is not HOST:PORT")
    return host.strip("[]") or "127.0.0.1", int(number)
