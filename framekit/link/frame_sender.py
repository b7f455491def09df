"""Frames that are sent by themselves, again and again: what stays the same of them is worked out once.

A frame in which nothing has to be worked out but its bytes, and that nobody is shown, goes out without becoming a
value; every other one takes the usual way. It knows no sequences.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from framekit.definition.expression.syntax import names_in
from framekit.definition.model.walk import expressions_of

if TYPE_CHECKING:
    from framekit.link.engine import Engine
    from framekit.link.events import Command


class FrameSender:
    """Sends frames of one name; `constants` are fields that never change. Raises KeyError for an unknown name.

    `is_plain`: such a frame is nothing but its bytes, and while the engine `is_quiet`, those that `encode` makes of all
    its fields may be given to the port first, and `handed_over` be told afterwards.
    """

    def __init__(self, engine: Engine, name: str) -> None:
        self.engine = engine
        self._name = name
        self._info = info = engine.machine.table.infos[name]
        self.constants = dict(info.known)
        self.encode, self.scope = info.encode, engine.scope
        worked_out = (engine.scope.formulas or {}).keys() - {"station"}  # now and clock among them: the engine sets it
        timed = any(names_in(one.root) & worked_out for one in expressions_of(info.frame.segments))
        self.is_plain = info.flat and not (info.numbers or info.computed or info.announces or timed)

    def handed_over(self, data: bytes, now: int, on_sent: Callable[[], None]) -> None:
        """A frame is on its way."""
        self.engine.has_put(self._info, data, now, on_sent)

    def send(self, fields: dict[str, Any], now: int, on_sent: Callable[[], None]) -> list[Command]:
        """As `Engine.send_frame`."""
        engine = self.engine
        if not self.is_plain or engine.machine.monitor is not None:
            return engine.send_frame(self._name, now, fields, on_sent)
        data = self._info.encode({**self.constants, **fields}, engine.scope)
        return engine.put_frame(self._info, data, now, on_sent)
