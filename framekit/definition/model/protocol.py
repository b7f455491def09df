"""A whole definition: the protocol with its application joined, and everything it imports in place."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

from framekit.definition.expression.syntax import Expression
from framekit.definition.model.checks import CheckMethod
from framekit.definition.model.frames import Frame, Group, Layout
from framekit.definition.model.procedure import Role, Sequence, Session
from framekit.definition.model.services import AddressForm, Area, CommandRules, Errors, Refusal, ServiceRow
from framekit.definition.model.values import Table
from framekit.definition.problems import NOWHERE, Position, Problem

WITHOUT_NUMBER = re.compile(r"tcp(-listen)?://(\[[^\]]+\]|[^:/\[\]]+)/?")
"""A connection to a host, or a listener there, whose port number is not given."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """What the protocol says about its line. Speeds in bits a second; `tcp`: the port number of `tcp://HOST`.

    `late`: how long after its time limit a reply may still come; None: as long again.
    """

    kind: Literal["serial", "stream"] = "serial"
    speed: int = 9600
    speeds: tuple[int, ...] = ()
    format: str = "8N1"
    formats: tuple[str, ...] = ()
    turnaround: Expression | None = None
    key_delay: Expression | None = None
    late: Expression | None = None
    tcp: int | None = None
    at: Position = NOWHERE

    def port_of(self, url: str) -> str:
        """A port as users name it: `tcp://HOST` gets the protocol's own port number."""
        if self.tcp is None or not WITHOUT_NUMBER.fullmatch(url):
            return url
        return f"{url.rstrip('/')}:{self.tcp}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """A named setting. `is_` is a formula that nobody sets. `items`: what a list holds, None for anything.

    `limits` of a list are those of each item; `size`: bytes are that many, no others.
    """

    name: str
    type: Literal["time", "number", "flag", "choice", "text", "bytes", "list"]
    default: Expression | None
    is_: Expression | None
    limits: tuple[int, int] | None
    choices: tuple[str, ...]
    doc: str
    at: Position
    items: Literal["time", "number", "flag", "text", "bytes"] | None = None
    size: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class StateVariable:
    """A variable of the link. `keys` makes it a table with that range of keys; `layout` gives its records their shape.

    `type` is one of u8…u64, i8…i64, flag, text, bytes, time, list, record, frame; `size`: that many bytes, no others.
    """

    name: str
    scope: Literal["line", "session", "device"]
    type: str
    initial: Expression | None
    keys: tuple[int, int] | None
    layout: str | None
    most: int | None
    size: int | None
    publish: bool
    values: Mapping[int, str] | None
    announced: bool
    at: Position


@dataclass(frozen=True, slots=True, kw_only=True)
class Queue:
    """A queue between lanes: fields of an item (name → type) and how many fit."""

    name: str
    holds: Mapping[str, str]
    size: int
    at: Position


@dataclass(frozen=True, slots=True, kw_only=True)
class Receiver:
    """How frames are found. `symbols`: an escape byte and its follower are skipped together."""

    gap: Expression | None = None
    quiet: Expression | None = None
    symbols: int | None = None
    resync: Literal["next_start", "after_frame", "after_quiet", "never"] = "next_start"


@dataclass(frozen=True, slots=True, kw_only=True)
class StationType:
    """What names the other side.

    `pad`: bytes of a known `size` may be given as text too, which this byte fills up.
    """

    type: Literal["number", "text", "bytes", "none"] = "number"
    limits: tuple[int, int] | None = None
    size: int | None = None
    pad: int | None = None
    default: Expression | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Protocol:
    """Everything a definition says, ready to be compiled and run.

    `frames` are in the order of the file, those of the application after those of the protocol. `frames_alone` says
    that there are no roles: blocks send and receive its frames directly. `sources`: the files it was read from.
    `commands`: this is an application of command blocks; `commands_file`: the one a protocol names for its channels.
    """

    name: str
    about: str
    source: str
    kind: Literal["protocol", "application"]
    profile: str | None
    order: Literal["big", "little"]
    station: StationType
    line: Line
    params: Mapping[str, Parameter]
    state: Mapping[str, StateVariable]
    queues: Mapping[str, Queue]
    tables: Mapping[str, Table]
    checks: Mapping[str, CheckMethod]
    layouts: Mapping[str, Layout]
    groups: Mapping[str, Group]
    frames: Mapping[str, Frame]
    receiver: Receiver
    sequences: Mapping[str, Sequence]
    roles: Mapping[str, Role]
    sessions: Mapping[str, Session]
    areas: Mapping[str, Area]
    addresses: tuple[AddressForm, ...]
    errors: Errors | None
    server_refusals: tuple[Refusal, ...]
    services: Mapping[str, tuple[ServiceRow, ...]]
    commands: CommandRules | None
    commands_file: str
    sources: tuple[str, ...]
    warnings: tuple[Problem, ...]
    at: Position
    profile_at: Position = NOWHERE

    @property
    def frames_alone(self) -> bool:
        return not self.roles

    @property
    def asking_role(self) -> str | None:
        """The role of a client: the first that can exchange, or the only one there is."""
        asking = [role.name for role in self.roles.values() if role.exchanges]
        return next(iter(asking or (self.roles if len(self.roles) == 1 else ())), None)

    @property
    def serving_role(self) -> str | None:
        """The role of a server: the other side of a client's, or the first that listens; None where no role does."""
        asking = next((role.name for role in self.roles.values() if role.exchanges), None)
        return self._first_listening() if asking is None else self.other_side(asking)

    def other_side(self, role: str) -> str | None:
        """The role that answers a role: what it says itself; its own, if it serves; else the first that listens."""
        own = self.roles[role]
        if own.other_side is not None:
            return own.other_side
        if own.exchanges and self._serves(own):
            return role
        return self._first_listening(role) or (role if own.listens else None)

    def _first_listening(self, but: str = "") -> str | None:
        """The first role that listens; those that only do that go before others."""
        found = [one for one in self.roles.values() if one.listens and one.name != but]
        return min(found, key=lambda one: one.exchanges).name if found else None

    def _serves(self, role: Role) -> bool:
        """Whether what a role listens with, and what that calls, has a step that serves."""
        return any(step.serve is not None for one in self.called_from(role.listens) for step in one.steps)

    def called_from(self, names: Iterable[str]) -> tuple[Sequence, ...]:
        """These sequences, and those that they call."""
        waiting, found = list(names), dict[str, Sequence]()
        while waiting:
            sequence = self.sequences.get(name := waiting.pop())
            if sequence is not None and name not in found:
                found[name] = sequence
                waiting += [step.call.sequence for step in sequence.steps if step.call is not None]
        return tuple(found.values())

    def frames_of(self, name: str) -> tuple[str, ...]:
        """The frames a row means by a frame's or a group's name; frames that exist to be refused come last."""
        if name in self.frames:
            return (name,)
        return self.groups[name].frames
