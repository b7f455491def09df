"""Reads `fleet:` of a run file: the broker to which a run reports its state, and from which it may receive run
files.
"""

from __future__ import annotations

import re
import socket
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from framekit.definition.keys import TEXT, Form, KeyReading, key, kind_schema, read_keys, ref
from framekit.definition.load.documents import without_effect
from framekit.definition.load.reader import Reader
from framekit.definition.nodes import Node, unread
from framekit.definition.problems import Position
from framekit.sinks.broker import PASSWORD_DOC, PLACE, TLS, TLS_DOC, USER_DOC, BrokerAccess, Place, mistakes_of_access
from framekit.sinks.secrets import SECRET, Secret

GROUP = "framekit"
"""Default group of gateways."""
_NAME = re.compile(r"[^\s/+#$][^/+#]{0,63}")


def name_of(text: str) -> str:
    """Return a name that is valid in a topic. Raises ValueError."""
    if _NAME.fullmatch(text) is None:
        raise ValueError(f"'{text}' is no name here – write up to 64 characters without / + #")
    return text


def _name(reading: KeyReading, node: Node) -> str:
    with reading.reader.refusing(node.at):
        found = name_of(reading.reader.text(node).strip())
    return found


NAME = Form(ref("text"), _name)


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetSection:
    """The membership of a run in a fleet.

    The required key is read last, so that all other keys are checked even if it is wrong.
    """

    name: str = key(
        "name", NAME, "What this gateway is called, which no other one may be; default: the name of the machine.",
        default="",
    )  # fmt: skip
    group: str = key("group", NAME, f"The fleet; default: {GROUP}.", default=GROUP)
    user: str = key("user", TEXT, USER_DOC, default="")
    password: Secret | None = key("password", SECRET, PASSWORD_DOC, default=None)
    tls: str | None = key("tls", TLS, TLS_DOC, default=None)
    token: Secret | None = key(
        "token", SECRET,
        "Where the token stands with which run files are rolled out to this gateway: env:NAME, or file:NAME, a file "
        "beside the run; default: none are taken.", default=None,
    )  # fmt: skip
    broker: Place = key("broker", PLACE, "The MQTT broker: HOST or HOST:PORT; default: port 1883, with tls 8883.")
    at: Position

    @property
    def access(self) -> BrokerAccess:
        """Return the access to the broker."""
        return BrokerAccess(self.broker, self.user, self.password, self.tls)

    @property
    def gateway(self) -> str:
        """Return the name of this gateway."""
        return self.name or socket.gethostname()

    def mistakes(self) -> Iterator[tuple[str, str, str]]:
        """Yield the mistakes of the section: key ('' for the whole section), fault, remedy."""
        yield from mistakes_of_access(self.access)


class _FleetLoader:
    """The context of the readers of the keys."""

    def __init__(self, reader: Reader, folder: Path) -> None:
        self.reader, self.folder = reader, folder


def read_fleet(reader: Reader, node: Node, folder: Path) -> FleetSection:
    """Return the section `fleet`. Raises Broken; other problems are noted."""
    mapping = reader.mapping(node)
    loader = _FleetLoader(reader, folder)
    fleet = FleetSection(at=mapping.at, **read_keys(FleetSection, loader, mapping, broken=lambda: None))
    reader.problems.extend(without_effect(entry, "in a fleet") for _, entry in unread(mapping))
    for name, what, todo in fleet.mistakes():
        reader.note((mapping.value(name) or mapping).at, what, todo)
    return fleet


def fleet_schema() -> dict[str, object]:
    """Return the schema of `fleet:`."""
    return kind_schema(FleetSection, "fleet")
