"""A port from what a run file or a command line calls it. Simulated lines are made above this layer."""

from __future__ import annotations

from framekit.definition.times import LineFormat
from framekit.transport.clock import AsyncioClock, Clock
from framekit.transport.port import Port

SERIAL_SCHEMES = ("loop", "socket", "rfc2217", "spy", "hwgrep", "alt")


def open_port(url: str, line: LineFormat | None, clock: Clock) -> Port:
    """`/dev/ttyUSB0`, `COM3`, `tcp://HOST:PORT`, any pyserial URL. Raises ValueError for anything else."""
    if not isinstance(clock, AsyncioClock):
        raise ValueError(f"'{url}' is a real port and needs real time – use sim: on a virtual clock")
    scheme, found, rest = url.partition("://")
    if not found:
        from framekit.transport.serial_port import SerialPort

        return SerialPort(url, line, clock)
    if scheme == "tcp":
        from framekit.transport.tcp_port import TcpPort

        host, number = host_and_port(rest)
        return TcpPort(host, number, clock)
    if scheme in SERIAL_SCHEMES:
        from framekit.transport.serial_port import SerialPort

        return SerialPort(url, line, clock)
    known = ", ".join(["a device such as /dev/ttyUSB0", "tcp://HOST:PORT", *(f"{name}://" for name in SERIAL_SCHEMES)])
    raise ValueError(f"'{url}' is no port – known are {known}")


def host_and_port(text: str) -> tuple[str, int]:
    """`HOST:PORT`, with brackets around an IPv6 address. Raises ValueError."""
    host, colon, number = text.rpartition(":")
    if not colon or not number.isdigit() or not 0 <= int(number) <= 65535:
        raise ValueError(f"'{text}' is not HOST:PORT")
    return host.strip("[]") or "127.0.0.1", int(number)
