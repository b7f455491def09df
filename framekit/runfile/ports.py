"""Find ports that several parts of a run name, although only one of them can have the port open."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

from framekit.definition.problems import Position, Problem
from framekit.run.model import Channel
from framekit.sinks import SinkKind
from framekit.transport.schemes import line_of, scheme_name, scheme_of

ALL_HOSTS = ("0.0.0.0", "::", "")
"""Addresses that listen on all networks of the machine."""


class _Taken(NamedTuple):
    """A port, and the part of the run that names it."""

    part: str
    shown: str
    at: Position
    line: str
    """The device; empty for a port that listens."""
    host: str = ""
    number: int = 0
    is_udp: bool = False


def doubled_ports(channels: Iterable[Channel], sinks: Sequence[SinkKind]) -> Iterator[Problem]:
    """Yield a problem for each port that a second part of the run names, with the places of both.

    Simulated lines and connections to a host may be shared. Channels that are not enabled do not count.
    """
    taken = [one for channel in channels if channel.enabled and (one := _of_channel(channel)) is not None]
    for sink in sinks:
        if sink.listens is not None:
            host, number = sink.listens
            taken.append(_Taken(f"sink {sink.word}", f"{host}:{number}", sink.at, "", host, number))
    reported: set[Position] = set()
    for first, second in combinations(taken, 2):
        if second.at not in reported and _is_same(first, second):
            reported.add(second.at)
            place = first.at._replace(file=Path(first.at.file).name)
            what = f"'{second.shown}' is the port of {first.part} at {place} already"
            todo = "ask its stations on that channel" if second.line else "give another port number"
            yield Problem(second.at, what, f"{todo}, or name another port" if second.line else todo)


def _of_channel(channel: Channel) -> _Taken | None:
    """Return the port of a channel; None if it may be shared."""
    kind, part = scheme_of(channel.port), f"channel {channel.number}"
    if kind is not None and channel.listens:
        host, _, number = line_of(channel.port).rpartition(":")
        if not number.isdecimal() or not int(number):  # wrong, or a free port
            return None
        is_udp = scheme_name(channel.port).startswith("udp")
        return _Taken(part, channel.port, channel.port_at, "", host.strip("[]"), int(number), is_udp)
    if kind is None or not kind.exclusive or not channel.port.strip():
        return None
    return _Taken(part, channel.port, channel.port_at, line_of(channel.port))


def _is_same(first: _Taken, second: _Taken) -> bool:
    """Return whether only one of two ports can be open."""
    if first.line or second.line:
        return first.line == second.line
    if (first.number, first.is_udp) != (second.number, second.is_udp):
        return False
    return first.host == second.host or first.host in ALL_HOSTS or second.host in ALL_HOSTS
