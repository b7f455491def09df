"""A connection to an MQTT broker for sinks: publications in order, and their confirmations.

A lost connection is not restored here: the sink is opened again and repeats unconfirmed messages. Its name at the
broker stays the same, so that the broker closes the old connection before it accepts a message of the new one.
"""

from __future__ import annotations

import os
import re
import socket
import threading
import time
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from ipaddress import ip_address
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from framekit.definition.keys import TEXT, Form, KeyReading, key, ref
from framekit.definition.tree import Node
from framekit.sinks.base import Host, not_installed
from framekit.sinks.secrets import SECRET, Secret
from framekit.sinks.store import NetworkSink

if TYPE_CHECKING:
    from paho.mqtt.client import Client

LONGEST_CONNECT = 5.0
LONGEST_CONFIRM = 10.0
"""Time limits (s) for the answer of a broker, and for the next confirmation."""

KEEPALIVE = 15
"""Silence after which the connection is tested (s)."""

LONGEST_END = 1.0
LARGEST_COMMAND = 65536
_BROKER = re.compile(r"(?:\[(?P<six>[0-9A-Fa-f:.]+)\]|(?P<host>[^\s:/@\[\]]+))(?::(?P<port>[0-9]{1,5}))?")

PORT, TLS_PORT = 1883, 8883


@dataclass(frozen=True, slots=True)
class Place:
    """Address of a broker; `port` None: the usual port."""

    host: str
    port: int | None = None

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return host if self.port is None else f"{host}:{self.port}"


def place_of(text: str) -> Place:
    """Parse `HOST`, `HOST:PORT` or `[IPv6]:PORT`. Raises ValueError."""
    match = _BROKER.fullmatch(text.strip())
    if match is None or (match["port"] is not None and not 0 < int(match["port"]) < 65536):
        raise ValueError(f"'{text.strip()}' is no address of a broker")
    with suppress(ValueError):
        ip_address(match["six"] or match["host"])
        return Place(match["six"] or match["host"], None if match["port"] is None else int(match["port"]))
    try:
        match["host"].encode("idna")
    except UnicodeError:
        raise ValueError(f"'{text.strip()}' is no address of a broker") from None
    return Place(match["host"], None if match["port"] is None else int(match["port"]))


def read_place(reading: KeyReading, node: Node) -> Place:
    """Return the address of a broker from a node. Raises Broken."""
    try:
        return place_of(reading.reader.text(node))
    except ValueError as error:
        raise reading.reader.broken(node.at, str(error), "write HOST or HOST:PORT") from None


PLACE = Form(ref("text"), read_place)


def read_tls(reading: KeyReading, node: Node) -> str | None:
    """Return '' for the certificates of the system, or a file of certificates; None for no TLS. Raises Broken."""
    text = reading.reader.text(node).strip()
    if text in ("no", "false", "off"):
        return None
    if text in ("yes", "true", "on"):
        return ""
    path: Path = reading.loader.folder / text
    if not os.path.isfile(path):
        raise reading.reader.broken(node.at, f"there is no file '{text}'", "write yes, or a file of certificates (PEM)")
    return str(path)


class BrokerAccess(NamedTuple):
    """Address and credentials of a broker."""

    place: Place
    user: str = ""
    password: Secret | None = None
    tls: str | None = None
    """'' for the certificates of the system, a file of certificates, or None for no TLS."""

    def __str__(self) -> str:
        return str(self.place)

    def client(self, name: str, *, reconnects: bool = False) -> Client:
        """Return a client of this name, not connected yet. Raises OSError, ValueError."""
        from paho.mqtt.client import Client
        from paho.mqtt.enums import CallbackAPIVersion

        client = Client(
            CallbackAPIVersion.VERSION2, client_id=name, clean_session=True, reconnect_on_failure=reconnects
        )
        client.connect_timeout = LONGEST_CONNECT
        client.max_inflight_messages_set(0)  # no limit
        if self.user:
            client.username_pw_set(self.user, None if self.password is None else self.password.read())
        if self.tls is not None:
            client.tls_set(ca_certs=self.tls or None)
        return client

    @property
    def at(self) -> tuple[str, int]:
        """Return host and port."""
        return self.place.host, self.place.port or (PORT if self.tls is None else TLS_PORT)


TLS = Form(ref("text"), read_tls)
USER_DOC = "The user's name at the broker."
PASSWORD_DOC = (
    "Where the password stands: env:NAME, a variable of the environment, or file:NAME, a file beside the run."
)
TLS_DOC = (
    "yes: encrypted, and the broker's certificate is checked against those of the system; or a file of certificates "
    "(PEM) to check it against."
)
"""Descriptions of the keys common to all clients of a broker."""


def mistakes_of_access(access: BrokerAccess) -> Iterator[tuple[str, str, str]]:
    """Yield the mistakes in the keys of a broker."""
    yield from not_installed("paho-mqtt", "paho.mqtt.client")
    if access.password is not None and not access.user:
        yield "password", "a password without a user has no effect", "add user:"


@dataclass(frozen=True, slots=True, kw_only=True)
class BrokerSink(NetworkSink):
    """Keys common to all sinks that send to an MQTT broker."""

    user: str = key("user", TEXT, USER_DOC, default="")
    password: Secret | None = key("password", SECRET, PASSWORD_DOC, default=None)
    tls: str | None = key("tls", TLS, TLS_DOC, default=None)
    client: str = key(
        "client", TEXT, "The name of the client at the broker, which no other client may have; default: one made of "
        "the names of the run, the machine and the store.", default="",
    )  # fmt: skip

    @property
    def access(self) -> BrokerAccess:
        """Return the access to the broker."""
        return BrokerAccess(self.place, self.user, self.password, self.tls)

    @property
    def place(self) -> Place:
        """Return the address of the broker, with its port."""
        place: Place = getattr(self, self.word)
        return place if place.port is not None else replace(place, port=PORT if self.tls is None else TLS_PORT)

    def client_name(self, run: str) -> str:
        """Return the name of the client: constant between starts, and different for every sink."""
        own = zlib.crc32(f"{socket.gethostname()} {os.path.abspath(self.store)}".encode())
        return self.client or f"framekit-{run}-{own:08x}"


class Message(NamedTuple):
    """A message to publish."""

    topic: str
    payload: bytes
    retain: bool = True
    """Whether the broker keeps it for later subscribers."""
    qos: int = 1


class Command(NamedTuple):
    """A message that another client has published now; messages retained by the broker are not included."""

    topic: str
    payload: bytes


class BrokerConnection:
    """A connection, from `open` to `close`. `lost` and `heard` are called in a thread of its own."""

    def __init__(self, kind: BrokerSink, lost: Callable[[str], None], heard: Callable[[Command], None]) -> None:
        self.kind = kind
        self._lost, self._heard = lost, heard
        self._client: Client | None = None
        self._change = threading.Condition()
        self._state = ""
        self._problem = ""
        self._confirmed: set[int] = set()
        self._subscribed: set[int] = set()

    def open(self, run: str, will: Message | None) -> None:
        """Connect; `will` is published by the broker if the connection is cut off. Raises OSError, ValueError."""
        kind, place = self.kind, self.kind.place
        client = kind.access.client(kind.client_name(run))
        client.on_connect = self._connected
        client.on_disconnect = self._disconnected
        client.on_publish = self._published
        client.on_subscribe = self._has_subscribed
        client.on_message = self._message
        if will is not None:
            client.will_set(will.topic, will.payload, qos=will.qos, retain=will.retain)
        self._client, self._state, self._problem = client, "connecting", ""
        assert place.port is not None
        client.connect(place.host, place.port, KEEPALIVE)
        client.loop_start()
        with self._change:
            if not self._change.wait_for(lambda: self._state != "connecting", LONGEST_CONNECT):
                raise TimeoutError(f"the broker {place} does not answer")
            if self._state != "connected":
                raise ConnectionError(self._problem)

    def subscribe(self, topics: Sequence[str]) -> None:
        """Subscribe to topics."""
        if self._client is not None and topics:
            self._client.subscribe([(topic, 1) for topic in topics])

    def say(self, message: Message) -> None:
        """Publish at least once while the connection lasts; may be called by any thread."""
        client = self._client
        if client is not None:
            client.publish(message.topic, message.payload, qos=message.qos, retain=message.retain)

    def post(self, messages: Sequence[Message]) -> set[int]:
        """Publish in order; return the numbers by which messages are confirmed (without QoS, when they have left)."""
        client = self._client
        if client is None:
            return set()
        return {
            client.publish(one.topic, one.payload, qos=one.qos, retain=one.retain).mid for one in messages
        }  # fmt: skip

    def answered(self, topic: str) -> None:
        """Wait until the broker has accepted all published messages: it answers a repeated subscription.

        Raises ConnectionError.
        """
        client = self._client
        if client is None:
            raise ConnectionError("there is no connection")
        _, number = client.subscribe(topic, 1)
        with self._change:
            self._change.wait_for(lambda: number in self._subscribed or self._state != "connected", LONGEST_CONFIRM)
            if number not in self._subscribed:
                raise ConnectionError(self._problem or "the broker does not answer")
            self._subscribed.clear()

    def send(self, groups: Sequence[Sequence[Message]]) -> int:
        """Publish in order and wait for the confirmations; return the number of groups confirmed completely.

        Raises ConnectionError.
        """
        client = self._client
        if client is None:
            raise ConnectionError("there is no connection")
        with self._change:
            self._confirmed.clear()
        numbers = []
        for group in groups:
            if self._state != "connected":
                break
            numbers.append(self.post(group))
        done = self._wait(numbers)
        if not done and groups:
            raise ConnectionError(self._problem or "the broker does not confirm what it gets")
        return done

    def _wait(self, numbers: Sequence[set[int]]) -> int:
        """Return the number of leading groups that are confirmed, at the end or when confirmations stop."""
        done = 0
        until = time.monotonic() + LONGEST_CONFIRM
        with self._change:
            seen = 0
            while done < len(numbers):
                if numbers[done] <= self._confirmed:
                    done += 1
                    continue
                left = until - time.monotonic()
                if self._state != "connected" or left <= 0:
                    break
                self._change.wait(left)
                if len(self._confirmed) > seen:
                    seen, until = len(self._confirmed), time.monotonic() + LONGEST_CONFIRM
        return done

    def close(self, last: Message | None = None) -> None:
        """Close the connection, after publishing `last`."""
        client = self._client
        if client is None:
            return
        if last is not None and self._state == "connected":
            with self._change:
                self._confirmed.clear()
            number = client.publish(last.topic, last.payload, qos=last.qos, retain=last.retain).mid
            with self._change:
                self._change.wait_for(lambda: number in self._confirmed or self._state != "connected", LONGEST_END)
        with self._change:
            self._state = "closed"
        self._client = None
        client.disconnect()
        client.loop_stop()

    # ---- in the library's thread --------------------------------------------------------------------------

    def _connected(self, client: Client, data: Any, flags: Any, reason: Any, properties: Any) -> None:
        with self._change:
            self._state = "refused" if reason.is_failure else "connected"
            self._problem = f"the broker {self.kind.place} refuses: {reason}" if reason.is_failure else ""
            self._change.notify_all()

    def _disconnected(self, client: Client, data: Any, flags: Any, reason: Any, properties: Any) -> None:
        with self._change:
            before, place = self._state, self.kind.place
            if before in ("connecting", "connected"):
                self._state = "lost"
                self._problem = f"the broker {place} has gone" if before == "connected" else f"{place} is no broker"
            self._change.notify_all()
        if before == "connected":
            self._lost(self._problem)

    def _published(self, client: Client, data: Any, number: int, reason: Any, properties: Any) -> None:
        with self._change:
            self._confirmed.add(number)
            self._change.notify_all()

    def _has_subscribed(self, client: Client, data: Any, number: int, reasons: Any, properties: Any) -> None:
        with self._change:
            self._subscribed.add(number)
            self._change.notify_all()

    def _message(self, client: Client, data: Any, message: Any) -> None:
        if not message.retain:  # an old command, kept by the broker, would come at every start
            self._heard(Command(message.topic, bytes(message.payload[: LARGEST_COMMAND + 1])))


def lost_of(host: Host | None) -> Callable[[str], None]:
    """Return the function to report a lost connection to."""
    return (lambda problem: None) if host is None else host.lost
