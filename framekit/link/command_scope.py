"""The names that command blocks of a channel are worked out on: those of their application over the channel's own.

A variable or parameter that the channel's protocol has too is the channel's, so that commands can look at its counters
and change its times; all others are the application's own, one for each channel.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any
from weakref import ref

from framekit.definition.model.protocol import Protocol
from framekit.link.evaluate import Formula, Names
from framekit.link.scope import Scope


class CommandScope(Scope):
    """Names of an application of commands on one channel, whose names are `channel`; sessions end with its."""

    __slots__ = ("channel", "shared")

    def __init__(self, application: Protocol, channel: Scope) -> None:
        super().__init__(application, role=channel["role"], own=channel["own"], now=channel.now)
        self.channel = channel
        theirs = channel.protocol.state.keys() | channel.protocol.params.keys()
        self.shared = frozenset((application.state.keys() | application.params.keys()) & theirs)
        assert self.formulas is not None
        formulas: dict[str, Formula] = dict(self.formulas)
        for name in (*self.shared, "now", "clock", "line", "station"):
            self.pop(name, None)
            self.device.pop(name, None)
            formulas[name] = _of(channel, name)
        self.formulas = formulas
        channel.followers.append(ref(self))

    def reset_session(self, but: Collection[str] = ()) -> None:
        """The application's own session variables return to their start values; the channel's are the channel's."""
        super().reset_session(self.shared)

    def set(self, name: str, value: Any) -> None:
        """As for every scope; what belongs to the channel is set there."""
        if name in self.shared or name == "clock":
            self.channel.set(name, value)
        else:
            super().set(name, value)

    def set_entry(self, name: str, key: Any, value: Any) -> None:
        """As for every scope."""
        if name in self.shared:
            self.channel.set_entry(name, key, value)
        else:
            super().set_entry(name, key, value)

    def drop_entry(self, name: str, key: Any) -> None:
        """As for every scope."""
        if name in self.shared:
            self.channel.drop_entry(name, key)
        else:
            super().drop_entry(name, key)


def _of(channel: Scope, name: str) -> Callable[[Names], Any]:
    return lambda names: channel[name]
