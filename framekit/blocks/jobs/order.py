"""What is asked of jobs: commands, and in those that establish one the order to be carried out again and again.

Places of the own memory are resolved; those of the other side are kept as text, for the protocol that is spoken there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from framekit.blocks.model import Place
    from framekit.definition.model.protocol import Protocol

Kind = Literal["read", "write", "report"]
CommandKind = Literal["job", "abort", "inspect"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Order:
    """A transfer that is repeated. `remote` is read into `place`, or written from it; a report has no `remote`.

    `count` elements of `unit` (None: what the address says). The other side is `host`, by number or name, or `channel`
    of the run. `period` 0: back to back. `late` (ns) 0: no time-out is told. `times` 0: until it is aborted.
    `params` go before the protocol's parameters.
    """

    slot: int
    kind: Kind
    place: Place
    remote: str = ""
    unit: str | None = None
    count: int = 1
    host: str = ""
    channel: int | None = None
    station: Any = None
    params: Mapping[str, Any] = field(default_factory=dict)
    period: int = 0
    late: int = 0
    times: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Command:
    """Establishes a job (`order`), aborts one, or all (`slot` None), or stores the two detail words of one (`into`).

    `status`: where the answer is written; `id`: for whoever wants to hear of it. Two commands are never the same.
    """

    kind: CommandKind
    slot: int | None
    order: Order | None = None
    into: Place | None = None
    status: Place | None = None
    id: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Record:
    """A command whose words stand in the own memory at `place`, as `application` reads them when it is given.

    `fault`: the own bit that shows words that are no command; `id` as for commands.
    """

    place: Place
    application: Protocol
    fault: Place | None = None
    id: int | None = None
