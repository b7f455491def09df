"""Addresses of hosts by their names: the system's resolver, asked beside everything else, or none at all.

Which hosts a run knows by itself is not known here.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable

from framekit.transport.clock import AsyncioClock, Clock

Found = Callable[[list[str] | None], None]
"""Told the addresses of a name: none when nobody knows it, None when it could not be asked."""

Resolve = Callable[[str, Found], None]


def resolver_for(clock: Clock) -> Resolve:
    """The system's resolver on a real clock; on any other one no name is known."""
    return SystemResolver(clock) if isinstance(clock, AsyncioClock) else nobody


def nobody(name: str, found: Found) -> None:
    """Knows no name."""
    found([])


class SystemResolver:
    """Asks the system in a thread of the loop; answers come in callbacks of the clock."""

    def __init__(self, clock: AsyncioClock) -> None:
        self._clock = clock
        self._asking: set[asyncio.Task[None]] = set()

    def __call__(self, name: str, found: Found) -> None:
        task = asyncio.ensure_future(self._ask(name, found))
        self._asking.add(task)
        task.add_done_callback(self._asking.discard)

    async def _ask(self, name: str, found: Found) -> None:
        try:
            rows = await asyncio.get_running_loop().getaddrinfo(name, None, type=socket.SOCK_STREAM)
        except socket.gaierror as error:
            unknown = error.errno in (socket.EAI_NONAME, getattr(socket, "EAI_NODATA", None))  # not every system has it
            found([] if unknown else None)
        except (OSError, UnicodeError):
            found(None)
        else:
            found(list(dict.fromkeys(str(row[4][0]) for row in rows)))
