"""Frames that are sent by themselves, again and again: what stays the same of them is worked out once.

A frame in which nothing has to be worked out but its bytes, and that nobody is shown, goes out without becoming a
value; every other one takes the usual way. It knows no sequences.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from framekit.link.engine import Engine
    from framekit.link.events import Command


class Fields(Protocol):
    """What reads the fields of a frame as they are now."""

    def read(self) -> dict[str, Any]: ...


class FrameSender:
    """Sends frames of one name. Raises KeyError for one that the protocol does not have."""

    def __init__(self, engine: Engine, name: str) -> None:
        self._engine = engine
        self._name = name
        self._info = info = engine.machine.table.infos[name]
        self._constants = dict(info.known)
        self._plain = info.flat and not (info.numbers or info.computed or info.announces)

    def at_once(self, fields: Fields) -> bytes | None:
        """The bytes of a frame with the fields that are read, if they may leave right now; `handed_over` follows then.

        None: it has to be sent by `send`. Raises what reading raises, ValueError for values that it cannot carry.
        """
        engine = self._engine
        if not self._plain or engine.machine.monitor is not None or not engine.is_quiet:
            return None
        found = fields.read()
        return self._info.encode({**self._constants, **found} if self._constants else found, engine.scope)

    def handed_over(self, data: bytes, now: int, on_sent: Callable[[], None]) -> None:
        """What `at_once` gave is on its way."""
        self._engine.has_put(self._info, data, now, on_sent)

    def send(self, fields: dict[str, Any], now: int, on_sent: Callable[[], None]) -> list[Command]:
        """As `Engine.send_frame`."""
        engine = self._engine
        if not self._plain or engine.machine.monitor is not None:
            return engine.send_frame(self._name, now, fields, on_sent)
        data = self._info.encode({**self._constants, **fields}, engine.scope)
        return engine.put_frame(self._info, data, now, on_sent)
