"""Open ports by URL: a table of the kinds of ports by scheme, the word before the colon of a port.

A new kind is one module and one row: `SCHEMES["can"] = Scheme(form="can:NAME", open=…, listen=…)`, or an entry point of
the group `framekit.ports` with the scheme as its name and the row as its value. A local serial device has no scheme.
Simulated lines (`sim:`) are created above this layer.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING

from framekit.definition.problems import did_you_mean
from framekit.definition.times import PLAIN, LineSettings

if TYPE_CHECKING:
    from pathlib import Path

    from framekit.definition.times import LineFormat
    from framekit.transport.clock import AsyncioClock, Clock
    from framekit.transport.port import Accepted, Port, PortListener

ENTRY_POINTS = "framekit.ports"
SIMULATED = "sim"
"""The scheme of simulated lines."""

Open = Callable[[str, "LineFormat | None", "AsyncioClock", LineSettings], "Port"]
"""Create a port from a whole URL, not yet opened. Raise ValueError with a full message for an invalid URL."""

Listen = Callable[[str, "AsyncioClock", "Accepted"], "PortListener"]
"""Create a listener from a whole URL, not yet listening. Raise ValueError with a full message for an invalid URL."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Scheme:
    """A kind of port."""

    form: str
    """The form of its URLs, for messages and help."""
    open: Open | None = None
    """Creates a port; None if the kind only listens."""
    listen: Listen | None = None
    """Creates a listener, which makes a port of each incoming connection; None if the kind does not listen."""
    wires: bool = False
    """Whether the line has wires, and thus a type, duplex, direction, echo and handshake."""
    names_host: bool = False
    """Whether the URL contains the host to connect to."""
    exclusive: bool = False
    """Whether only one channel can have it open, such as a serial device; connections to a host may be several."""
    served: bool = False
    """Whether only servers can open it, since other programs learn the path of the port from the server."""
    check: Callable[[str], object] | None = None
    """Raises ValueError with a full message for an invalid URL, without opening it; None if only `open` checks it."""
    placed: Callable[[str, Path], str] | None = None
    """Resolves the files in the URL relative to a folder; None if the URL has no files. Raises ValueError."""


# ---- built-in kinds --------------------------------------------------------------------------------------------


def _open_serial(url: str, settings: LineFormat | None, clock: AsyncioClock, wiring: LineSettings) -> Port:
    from framekit.transport.serial_port import SerialPort

    return SerialPort(url.rstrip(":") if _WINDOWS_DEVICE.fullmatch(url) else url, settings, clock, wiring)


def _check_place(url: str) -> None:
    """Raise ValueError if a URL does not name a host and a valid number; a path and options may follow."""
    from framekit.transport.network import host_and_port

    host_and_port(url[: url.index("://") + 3] + re.split("[/?]", url.partition("://")[2], maxsplit=1)[0])


def _open_tcp(url: str, settings: LineFormat | None, clock: AsyncioClock, wiring: LineSettings) -> Port:
    from framekit.transport.network import TcpPort, host_and_port

    return TcpPort(*host_and_port(url), clock, wiring.connect_within)


def _listen_tcp(url: str, clock: AsyncioClock, accepted: Accepted) -> PortListener:
    from framekit.transport.network import TcpListener, host_and_port

    return TcpListener(*host_and_port(url), clock, accepted)


def _open_tls(url: str, settings: LineFormat | None, clock: AsyncioClock, wiring: LineSettings) -> Port:
    from framekit.transport.network import host_and_port
    from framekit.transport.tls_port import TlsPort, parted

    place, given = parted(url)
    return TlsPort(*host_and_port(place), given, clock, wiring.connect_within)


def _listen_tls(url: str, clock: AsyncioClock, accepted: Accepted) -> PortListener:
    from framekit.transport.network import host_and_port
    from framekit.transport.tls_port import TlsListener, parted

    place, given = parted(url)
    return TlsListener(*host_and_port(place), given, clock, accepted)


def _tls_in(url: str, folder: Path) -> str:
    from framekit.transport.tls_port import placed

    return placed(url, folder)


def _open_udp(url: str, settings: LineFormat | None, clock: AsyncioClock, wiring: LineSettings) -> Port:
    from framekit.transport.network import UdpPort, host_and_port

    return UdpPort(*host_and_port(url), clock, listens=scheme_name(url) == "udp-listen")


def _listen_udp(url: str, clock: AsyncioClock, accepted: Accepted) -> PortListener:
    from framekit.transport.network import UdpListener, host_and_port

    return UdpListener(*host_and_port(url), clock, accepted)


def _open_pty(url: str, settings: LineFormat | None, clock: AsyncioClock, wiring: LineSettings) -> Port:
    if sys.platform == "win32":
        raise ValueError("Windows has no pseudo-terminals – name a port such as COM3, or listen at tcp://HOST:PORT")
    from framekit.transport.pty_port import PtyPort

    return PtyPort(settings, clock, wiring, os.path.expanduser(url.partition(":")[2]))


SCHEMES: dict[str, Scheme] = {
    "": Scheme(form="a device such as /dev/ttyUSB0 or COM3", open=_open_serial, wires=True, exclusive=True),
    "tcp": Scheme(form="tcp://HOST:PORT", open=_open_tcp, listen=_listen_tcp, names_host=True, check=_check_place),
    "tcp-listen": Scheme(form="tcp-listen://HOST:PORT", listen=_listen_tcp, check=_check_place),
    "tls": Scheme(
        form="tls://HOST:PORT", open=_open_tls, listen=_listen_tls, names_host=True, check=_check_place, placed=_tls_in
    ),
    "udp": Scheme(form="udp://HOST:PORT", open=_open_udp, names_host=True, check=_check_place),
    "udp-listen": Scheme(form="udp-listen://HOST:PORT", open=_open_udp, listen=_listen_udp, check=_check_place),
    "pty": Scheme(form="pty:[PATH]", open=_open_pty, wires=True, served=True),
}
PYSERIAL = ("loop", "socket", "rfc2217", "spy", "hwgrep", "alt")
for _name in PYSERIAL:
    SCHEMES[_name] = Scheme(form=f"{_name}://", open=_open_serial, wires=True, exclusive=_name in ("spy", "alt"))
for _name in ("socket", "rfc2217"):
    SCHEMES[_name] = replace(SCHEMES[_name], check=_check_place)


# ---- finding and using ports -----------------------------------------------------------------------------------


_WINDOWS_DEVICE = re.compile(r"(?:\\\\\.\\)?COM\d+:?", re.IGNORECASE)
"""Serial device names of Windows: `COM3`, `COM3:`, `\\\\.\\COM12`."""


def scheme_name(url: str) -> str:
    """Return the word before the colon in lower case; empty for a local serial device."""
    if _WINDOWS_DEVICE.fullmatch(url):
        return ""
    found = re.match(r"([A-Za-z][A-Za-z0-9+.-]*):", url)
    return found[1].lower() if found else ""


def writes_files(url: str) -> bool:
    """Return whether a port logs its traffic to a file given in its URL."""
    return scheme_name(url) == "spy" or "file=" in url.lower()


def scheme_of(url: str) -> Scheme | None:
    """Return the kind of a port; None for a simulated line and for an unknown scheme."""
    name = scheme_name(url)
    return None if name == SIMULATED else SCHEMES.get(name) or _installed(name)


@cache
def _installed(name: str) -> Scheme | None:
    """Return the kind that an installed package registers under this name, and add it to the table."""
    from importlib.metadata import entry_points
    from traceback import format_exception_only

    for point in entry_points(group=ENTRY_POINTS, name=name):
        what = f"the ports '{name}:' of {point.value} can't be used"
        try:
            found = point.load()
        except Exception as error:  # code of another package: any error disables its ports only
            return _unusable(name, f"{what}: {format_exception_only(error)[-1].strip()}")
        if not isinstance(found, Scheme):
            return _unusable(name, f"{what}: it is no Scheme but {type(found).__name__}")
        SCHEMES[name] = found
        return found
    return None


def _unusable(name: str, why: str) -> Scheme:
    def open_one(url: str, settings: LineFormat | None, clock: AsyncioClock, wiring: LineSettings) -> Port:
        raise ValueError(why)

    return Scheme(form=f"{name}:…", open=open_one)


def forms(*, opened: bool = False, listening: bool = False, served: bool = False) -> list[str]:
    """Return the forms of the URLs of ports: those to open, those that listen, those for servers."""
    return [kind.form for name, kind in SCHEMES.items() if name and _is_one(kind, opened, listening, served)]


def _is_one(kind: Scheme, opened: bool, listening: bool, served: bool) -> bool:
    if kind.served:
        return served
    return (opened and kind.open is not None) or (listening and kind.listen is not None)


def help_on_ports(*others: str, serves: bool = False) -> str:
    """Return the help text for `--port` on a command line."""
    hidden = {SCHEMES[name].form for name in PYSERIAL}
    known = [form for form in forms(opened=not serves, listening=serves, served=serves) if form not in hidden]
    listed = ["/dev/ttyUSB0, COM3, any pyserial URL", *known, *others]
    return f"{', '.join(listed[:-1])} or {listed[-1]}"


def open_port(
    url: str,
    settings: LineFormat | None,
    clock: Clock,
    wiring: LineSettings = PLAIN,
    *,
    listen_only: bool = False,
    serves: bool = False,
) -> Port:
    """Return a port, not yet opened, inside the ports that implement its wiring.

    `listen_only`: open a serial port with RTS and DTR off. `serves`: the caller is a server.

    Raise ValueError with a full message for an invalid port, and for a real port on a virtual clock.
    """
    kind = scheme_of(url) if url.strip() else None
    if kind is None or kind.open is None or (kind.served and not serves) or not _is_written_so(url, kind):
        raise ValueError(" – ".join(no_port(url)))
    clock = real(url, clock)
    if listen_only:
        wiring = replace(wiring, listen_only=True)
    port = kind.open(url, settings, clock, wiring)
    if wiring.direction is None and wiring.modem is None and not wiring.echo:
        return port
    from framekit.transport.wiring import wired

    return wired(port, wiring, clock)


def make_listener(url: str, clock: Clock, accepted: Accepted) -> PortListener:
    """Return a listener, not yet listening. Raise ValueError as `open_port` does."""
    kind = scheme_of(url)
    if kind is None or kind.listen is None:
        raise ValueError(f"'{url}' does not listen – known are {', '.join(forms(listening=True))}")
    if not _is_written_so(url, kind):
        raise ValueError(f"'{url}' is no port – write {kind.form}")
    return kind.listen(url, real(url, clock), accepted)


def real(url: str, clock: Clock) -> AsyncioClock:
    """Return the clock for a real port. Raise ValueError for a virtual clock."""
    from framekit.transport.clock import AsyncioClock

    if not isinstance(clock, AsyncioClock):
        raise ValueError(f"'{url}' is a real port and needs real time – use sim: on a virtual clock")
    return clock


def without_files(url: str) -> str:
    """Return the URL of a port without its files, for display."""
    kind = scheme_of(url)
    return url if kind is None or kind.placed is None else url.partition("?")[0]


def line_of(url: str) -> str:
    """Return the name of the line that a port leads to: the device, or host and port, however they are written.

    The kind of the port, its options and links to a device do not count; two names of one host are two lines.
    """
    place = url.partition("://")[2].partition("?")[0]
    if not place and scheme_name(url):
        return url
    place = place or url
    if _WINDOWS_DEVICE.fullmatch(place):
        return place.rstrip(":").rpartition("\\")[2].upper()
    if "://" in url and not os.path.isabs(place):
        return place.rstrip("/").lower()
    return os.path.realpath(place)


def host_of(url: str) -> str:
    """Return the host that a port connects to; empty if the URL contains no host."""
    kind = scheme_of(url)
    found = re.match(r"(?:\[([^\]]+)\]|([^:/]+))(?::\d+)?", url.partition("://")[2])
    return "" if kind is None or not kind.names_host or found is None else found[1] or found[2]


_HOST_AND_PORT = re.compile(r"[A-Za-z0-9.-]+:\d+")


def _is_written_so(url: str, kind: Scheme) -> bool:
    """Return whether a URL matches its form after the scheme; `192.168.0.5:502` has no scheme."""
    if _HOST_AND_PORT.fullmatch(url):
        return False
    return "://" not in kind.form or "://" in url


def is_known(url: str) -> bool:
    """Return whether a channel can use this port: a simulated line, or a known kind in its form."""
    kind = scheme_of(url)
    return scheme_name(url) == SIMULATED or (kind is not None and not kind.served and _is_written_so(url, kind))


def no_port(url: str) -> tuple[str, str]:
    """Return the problem of an invalid port, and the remedy: a similar scheme, or the known forms."""
    if _HOST_AND_PORT.fullmatch(url):
        return f"'{url}' is no port", f"write tcp://{url} for a connection to that host"
    name, known = scheme_name(url), [name for name in SCHEMES if name]
    if name == SIMULATED:
        return f"'{url}' is no port here", "simulated lines are for runs and for clients"
    made = SCHEMES.get(name)
    if made is not None and made.served and url.partition(":")[2]:
        todo = f"name the terminal itself: {url.partition(':')[2]}; a server makes it with --port {url}"
        return f"'{url}' is no port here", todo
    if made is not None and made.open is None and made.listen is not None and _is_written_so(url, made):
        return f"'{url}' listens for clients, and here a line is asked for", f"name a device, or {SCHEMES['tcp'].form}"
    near = did_you_mean(name, [*known, SIMULATED]) if name not in known else ""
    ports = [SCHEMES[""].form, *forms(opened=True, listening=True), "sim:FILE"]
    listed = f"known are {', '.join(ports)}; a server can open {', '.join(forms(served=True))} too"
    return f"'{url}' is no port", near or listed
