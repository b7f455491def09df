"""The log `framekit.written`: the sender of every write into a memory that others reach, one line for every write.

It costs no work if that log is off when a device or a run begins.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

from framekit.definition.model.protocol import Protocol
from framekit.link.addresses import Address, AddressError, AddressGrammar
from framekit.link.events import MemoryAccess, RequestHandler, Served
from framekit.link.packing import PackingError, numbers_of, values_of
from framekit.link.services.areas import AreaUnit
from framekit.link.values import FrameValue, Names
from framekit.transport.port import AcceptedPort, Port

log = logging.getLogger("framekit.written")

MOST_VALUES = 16
"""Largest number of values of a write that are shown; the rest is counted."""


MOST_OF_A_VALUE = 100
"""Largest number of characters of a variable's value that are shown."""

MOST_OF_A_NAME = 64
"""Largest number of characters of the name in a certificate that are shown."""


class WriteLog:
    """Log of the writes to the object `name`. `client`: the present client."""

    def __init__(self, name: str, protocol: Protocol) -> None:
        self.name = name
        self.client = ""
        self._grammar = AddressGrammar(protocol.addresses, protocol.areas, protocol.tables)

    def note(self, unit: AreaUnit, start: int, count: int, before: bytes, after: bytes) -> None:
        """Log the write of elements of an area."""
        self._tell(self._place(unit, start), _shown(unit, before, count), _shown(unit, after, count))

    def note_bytes(self, address: str, before: bytes, after: bytes) -> None:
        """Log bytes stored by a sequence."""
        self._tell(address, before.hex(" ").upper(), after.hex(" ").upper())

    def note_kept(self, name: str, before: Any, after: Any) -> None:
        """Log a new value of a variable of the device; None is a missing value."""
        self._tell(name, _value(before), _value(after))

    def _tell(self, place: str, before: str, after: str) -> None:
        log.info("%s: %s: %s → %s, written by %s", self.name, place, before, after, self.client)

    def _place(self, unit: AreaUnit, start: int) -> str:
        if unit.name is None:
            return f"{unit.unit} {start} of {unit.memory}"
        place = Address(unit.name, unit.unit, start, shift=unit.shift)
        try:
            return self._grammar.print(place)
        except AddressError:
            return str(place)


def _shown(unit: AreaUnit, data: bytes, count: int) -> str:
    """Return the values as numbers."""
    try:
        values: list[Any] = numbers_of(data, unit.unit, unit.type, count)
    except PackingError:
        values = values_of(data, unit.unit, count)
    more = f" and {len(values) - MOST_VALUES} more" if len(values) > MOST_VALUES else ""
    return ", ".join(map(str, values[:MOST_VALUES])) + more


def _value(value: Any) -> str:
    """Return a value of a variable as text, limited to a line."""
    if value is None:
        return "nothing"
    if isinstance(value, bytes):
        return value[:MOST_VALUES].hex(" ").upper() + (
            f" and {len(value) - MOST_VALUES} more" * (len(value) > MOST_VALUES)
        )
    if isinstance(value, int | float):
        return str(value)
    shown = repr(value[:MOST_OF_A_VALUE] if isinstance(value, str) else value)
    return shown if len(shown) <= MOST_OF_A_VALUE else f"{shown[:MOST_OF_A_VALUE]}…"


def begun_log(name: str, protocol: Protocol) -> WriteLog | None:
    """Return the log; None if it is off."""
    return WriteLog(name, protocol) if log.isEnabledFor(logging.INFO) else None


def client_of(port: Port) -> str:
    """Return the other side of a port for the log; the name in a certificate is quoted.

    So no name can look like words of the log.
    """
    name = port.identity if isinstance(port, AcceptedPort) else ""
    shown = repr(name[:MOST_OF_A_NAME]) + ("…" if len(name) > MOST_OF_A_NAME else "")
    return f"{port.sender or port.name}{f' ({shown})' if name else ''}"


class NamedServer:
    """A server as used by one client: its writes are logged with the client's name."""

    def __init__(self, server: RequestHandler, writes: WriteLog, who: Callable[[], str]) -> None:
        self._server, self._writes, self._who = server, writes, who

    def serve(self, request: FrameValue, buffer: bytes, station: Any, check_only: bool, names: Names) -> Served:
        self._writes.client = self._who()
        return self._server.serve(request, buffer, station, check_only, names)

    def unanswered(self) -> None:
        self._server.unanswered()


class NamedMemory:
    """The memory as used by sequences that one client begins: stored bytes are logged with the client's name."""

    def __init__(self, memory: MemoryAccess, writes: WriteLog, who: Callable[[], str]) -> None:
        self._memory, self._writes, self._who = memory, writes, who

    def read(self, address: str, size: int) -> bytes:
        return self._memory.read(address, size)

    def write(self, address: str, data: bytes) -> None:
        before = self._memory.read(address, len(data))
        self._memory.write(address, data)
        self._writes.client = self._who()
        self._writes.note_bytes(address, before, data)
