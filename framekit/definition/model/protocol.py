"""A whole definition: the protocol joined with its application, and all imports resolved."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

from framekit.definition.model.checks import CheckMethod
from framekit.definition.model.frames import Frame, Group, Layout, PartlyRead, parts_of
from framekit.definition.model.procedure import Action, Lane, Role, Sequence, Session, Step
from framekit.definition.model.sections import Line, Parameter, Probe, Queue, Receiver, StateVariable, StationType
from framekit.definition.model.segments import Inner
from framekit.definition.model.services import AddressForm, AreaModel, CommandRules, Errors, Refusal, ServiceRow
from framekit.definition.model.values import Table
from framekit.definition.problems import NOWHERE, Position, Problem


@dataclass(frozen=True, slots=True)
class Rest:
    """What could be read of the parts of a definition with errors."""

    frames: tuple[PartlyRead, ...] = ()
    rows: tuple[tuple[ServiceRow, frozenset[str]], ...] = ()
    """Rows of services without their broken keys, each with the words that may be names of its own."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Protocol:
    """The whole content of a definition, ready to be compiled and run."""

    name: str
    family: str
    """Family of the protocol, '' if unknown; a definition that extends another inherits its family."""
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
    """Frames in the order of the file, those of the application after those of the protocol."""
    receiver: Receiver
    sequences: Mapping[str, Sequence]
    roles: Mapping[str, Role]
    sessions: Mapping[str, Session]
    areas: Mapping[str, AreaModel]
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
    probe: Probe | None = None
    """The request that finds devices; None: a read of the first readable address."""

    @property
    def frames_alone(self) -> bool:
        return not self.roles

    @property
    def service_rows(self) -> tuple[ServiceRow, ...]:
        """Return the rows of all services, in the order of the file."""
        return tuple(row for rows in self.services.values() for row in rows)

    @property
    def lanes(self) -> tuple[Lane, ...]:
        """Return the lanes of all roles."""
        return tuple(lane for role in self.roles.values() for lane in role.lanes)

    @property
    def exchanged(self) -> dict[str, None]:
        """Return the sequences that exchanges of any role run."""
        return dict.fromkeys(name for lane in self.lanes for name in lane.exchange)

    @property
    def carried(self) -> frozenset[str]:
        """Return the names of the frames that may be inner frames of others."""
        return frozenset(name for one in parts_of(dict(self.frames), Inner) for name in one.frames)

    @property
    def delivers(self) -> bool:
        """Return whether a sequence delivers frames to all lanes without the line."""
        sequences = dict(self.sequences)
        held: list[Step | Action] = [*parts_of(sequences, Step), *parts_of(sequences, Action)]
        return any(one.deliver is not None for one in held)

    @property
    def asking_role(self) -> str | None:
        """Return the role of a client: the first with exchanges, or the only role."""
        asking = [role.name for role in self.roles.values() if role.exchanges]
        return next(iter(asking or (self.roles if len(self.roles) == 1 else ())), None)

    @property
    def serving_role(self) -> str | None:
        """Return the role of a server: the other side of the client's role, or the first that listens; None if no role
        does.
        """
        asking = next((role.name for role in self.roles.values() if role.exchanges), None)
        return self._first_listening() if asking is None else self.other_side(asking)

    def other_side(self, role: str) -> str | None:
        """Return the role that answers a role: the configured role; the role itself if it serves; else the first that
        listens.
        """
        own = self.roles[role]
        if own.other_side is not None:
            return own.other_side
        called = self.called_from(own.listens) if own.exchanges else ()
        if any(step.serve is not None for one in called for step in one.steps):
            return role
        return self._first_listening(role) or (role if own.listens else None)

    def _first_listening(self, but: str = "") -> str | None:
        """Return the first role that listens; roles without exchanges take precedence."""
        found = [one for one in self.roles.values() if one.listens and one.name != but]
        return min(found, key=lambda one: one.exchanges).name if found else None

    def called_from(self, names: Iterable[str]) -> tuple[Sequence, ...]:
        """Return these sequences, and those that they call."""
        waiting, found = list(names), dict[str, Sequence]()
        while waiting:
            sequence = self.sequences.get(name := waiting.pop())
            if sequence is not None and name not in found:
                found[name] = sequence
                waiting += [step.call.sequence for step in sequence.steps if step.call is not None]
        return tuple(found.values())

    def set_by_sequences(self, role: str | None) -> list[str]:
        """Return the variables of the device that the listening sequences of the role set, apart from services."""
        found = self.called_from(self.roles[role].listens) if role is not None and role in self.roles else ()
        parts: list[Step | Action] = [*parts_of(found, Step), *parts_of(found, Action)]
        names = {target.name for part in parts for target, _ in part.set}
        return [name for name, variable in self.state.items() if variable.scope == "device" and name in names]

    def frames_of(self, name: str) -> tuple[str, ...]:
        """Return the frames that the name of a frame or group in a row refers to; refused frames come last."""
        if name in self.frames:
            return (name,)
        return self.groups[name].frames
