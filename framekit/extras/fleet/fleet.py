"""Fleets: gateways that publish their health at a broker, and run files rolled out to them.

Each gateway has five topics `GROUP/GATEWAY/…`. `online` (1 or 0, the latter also as the broker's last will), `birth`
and `health` are retained; `roll` takes a run file, `rolled` gives the answer. A rolled file is signed: HMAC-SHA256 with
the token over all its parts and a number from the gateway's birth that is valid once. So the token never crosses the
network, and a recorded file cannot be sent again.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import secrets
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from framekit.api.errors import RequestError
from framekit.definition.problems import error_text, library_missing
from framekit.extras.fleet.section import GROUP as GROUP
from framekit.extras.fleet.section import name_of as name_of
from framekit.sinks.broker import KEEPALIVE, LONGEST_CONNECT, BrokerAccess

if TYPE_CHECKING:
    from paho.mqtt.client import Client

LARGEST_FILE = 1 << 20
"""Largest size of a run file that is rolled out (bytes)."""
LARGEST_MESSAGE = 3 * LARGEST_FILE
"""Largest size of a message (bytes): JSON writes some characters as several."""
ONLINE, BIRTH, HEALTH, ROLL, ROLLED = "online", "birth", "health", "roll", "rolled"
YES, NO = b"1", b"0"
SIGN_OF_LIFE = 30
"""Period (s) in which a gateway publishes its health even if it is unchanged."""
STALE_AFTER = 100
"""Age of the last sign of life (s) from which a gateway counts as missing."""


def topic(group: str, name: str, what: str) -> str:
    """Return a topic of a gateway."""
    return f"{group}/{name}/{what}"


def signature(token: str, group: str, name: str, number: str, identity: str, file: bytes) -> str:
    """Return the signature of a rolled file, made with the token."""
    parts = (group.encode(), name.encode(), number.encode(), identity.encode(), hashlib.sha256(file).digest())
    signed = b"".join(len(part).to_bytes(4, "big") + part for part in parts)
    return hmac.new(token.encode(errors="surrogateescape"), signed, hashlib.sha256).hexdigest()


def as_message(data: Mapping[str, Any]) -> bytes:
    """Return data as a published message."""
    return json.dumps(data, ensure_ascii=False, allow_nan=False).encode(errors="backslashreplace")


def _no_number(text: str) -> None:
    raise ValueError(f"{text} is no number")


def from_message(payload: bytes) -> dict[str, Any]:
    """Return the object of a received message; empty if the message is no JSON object."""
    try:
        found = json.loads(payload, parse_constant=_no_number) if len(payload) <= LARGEST_MESSAGE else None
    except (ValueError, RecursionError):
        found = None
    return found if isinstance(found, dict) else {}


@dataclass(slots=True)
class Member:
    """A gateway as its messages show it. `birth` and `health` are the last messages, also when it is offline."""

    name: str
    online: bool = False
    birth: dict[str, Any] = field(default_factory=dict)
    health: dict[str, Any] = field(default_factory=dict)

    def said(self, key: str) -> str:
        """Return a text from its birth; '' if it is missing."""
        found = self.birth.get(key)
        return found if isinstance(found, str) else ""

    @property
    def is_silent(self) -> bool:
        """Return whether it counts as online without a sign of life for `STALE_AFTER` seconds, by the clocks of both
        sides.
        """
        at = self.health.get("at")
        try:
            age = time.time() - datetime.fromisoformat(at if isinstance(at, str) else "").timestamp()
        except (ValueError, OverflowError):
            return False
        return self.online and age > STALE_AFTER

    @property
    def takes_files(self) -> bool:
        """Return whether it accepts run files."""
        return bool(self.said("number"))

    @property
    def troubles(self) -> list[str]:
        """Return the troubles of its health as phrases; the names in them come from the gateway."""
        found = []
        for key, words in TROUBLES:
            some = self.health.get(key)
            if isinstance(some, list) and some:
                found.append(f"{words} {', '.join(str(one) for one in some[:MOST_NAMED])}" + _others(some))
        waiting = self.health.get("waiting")
        if isinstance(waiting, int) and waiting >= MANY_WAITING:
            found.append(f"{waiting} samples wait for a server")
        return found


TROUBLES = (
    ("down", "not open: channel"),
    ("failing", "failing: block"),
    ("bad", "not good: point"),
    ("sinks", "sink"),
    ("problems", "problem:"),
)
"""The lists of troubles in a health message, and the phrase for each list."""
MOST_NAMED = 3
MANY_WAITING = 1000
"""Number of waiting samples from which a server counts as unavailable or slow."""


def _others(some: list[Any]) -> str:
    return f" and {len(some) - MOST_NAMED} more" if len(some) > MOST_NAMED else ""


@dataclass(frozen=True, slots=True)
class GatewayAnswer:
    """The answer of a gateway to a file that was rolled out."""

    gateway: str
    ok: bool
    how: str = ""
    """How the file was applied."""
    problems: tuple[str, ...] = ()
    """Problems of the file."""
    answered: bool = True
    """Whether the gateway itself has answered."""


class Fleet:
    """The gateways of a group at a broker; `with` or `close` ends it. Threads may share it.

    `changed(name)` is called in a thread of its own for each message of a gateway. Raises RequestError where the
    broker cannot be reached or refuses, and without the library.
    """

    def __init__(self, access: BrokerAccess, group: str, changed: Callable[[str], None] = lambda name: None) -> None:
        self.access, self.group = access, group
        self.members: dict[str, Member] = {}
        self._changed = changed
        self._state = threading.Condition()
        self._reason = ""
        self._echoed = self.connected = False
        self._answers: dict[tuple[str, str], dict[str, Any] | None] = {}
        """Awaited answers by gateway and id of the request; None until the answer arrives."""
        self._own = f"{group}/-{secrets.token_hex(8)}"  # no gateway has a topic of two parts
        self._client = self._open()

    def _open(self) -> Client:
        try:
            client = self.access.client(f"framekit-fleet-{secrets.token_hex(8)}", reconnects=True)
        except ModuleNotFoundError:
            raise RequestError(library_missing("a fleet", "paho-mqtt")) from None
        except (OSError, ValueError) as error:
            raise RequestError(f"the broker {self.access}: {error}") from None
        client.on_connect = self._opened
        client.on_disconnect = self._closed
        client.on_message = self._heard
        client.on_subscribe = lambda client, *_: client.publish(self._own, b"", 1)
        try:
            client.connect(*self.access.at, KEEPALIVE)
        except (OSError, ValueError) as error:
            raise RequestError(f"the broker {self.access} cannot be reached: {error_text(error)}") from None
        client.loop_start()
        with self._state:
            self._state.wait_for(lambda: self._echoed or self._reason, 2 * LONGEST_CONNECT)
            reason = self._reason or ("" if self._echoed else "it does not answer")
        if reason:
            client.disconnect()
            client.loop_stop()
            raise RequestError(f"the broker {self.access} cannot be used: {reason}")
        return client

    def close(self) -> None:
        """Disconnect from the broker."""
        self._client.disconnect()
        self._client.loop_stop()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # ---- run files ----------------------------------------------------------------------------------------

    def roll(self, names: Iterable[str], file: bytes, token: str, within: float = 60.0) -> list[GatewayAnswer]:
        """Roll a run file out to gateways, all at once, and return their answers within `within` seconds.

        Raises RequestError for a file that is too large or no text, before sending it.
        """
        text = _text_of(file)
        asked: dict[str, str] = {}
        found: dict[str, GatewayAnswer] = {}
        for name in dict.fromkeys(names):
            member = self.members.get(name)
            if member is None or not member.online:
                found[name] = GatewayAnswer(name, False, problems=("it is not there",), answered=False)
            elif not member.takes_files:
                found[name] = GatewayAnswer(
                    name, False, problems=("it takes no files: its run file has no fleet: token:",), answered=False
                )
            else:
                number, identity = member.said("number"), secrets.token_hex(8)
                signed = signature(token, self.group, name, number, identity, file)
                instance = member.birth.get("instance")
                data = {"id": identity, "instance": instance, "number": number, "file": text, "signature": signed}
                asked[name] = identity
                with self._state:
                    self._answers[name, identity] = None
                self._client.publish(topic(self.group, name, ROLL), as_message(data), 1)
        until = time.monotonic() + within
        for name, identity in asked.items():
            key = (name, identity)
            with self._state:
                self._state.wait_for(partial(self._is_answered, key), max(0.0, until - time.monotonic()))
                reply = self._answers.pop(key)
            found[name] = _answer(name, reply, within)
        return [found[name] for name in dict.fromkeys(names)]

    def _is_answered(self, key: tuple[str, str]) -> bool:
        return self._answers[key] is not None

    # ---- in the library's thread --------------------------------------------------------------------------

    def _opened(self, client: Client, data: Any, flags: Any, reason: Any, properties: Any) -> None:
        with self._state:
            self._reason = str(reason) if reason.is_failure else ""
            self.connected = not reason.is_failure
            self._state.notify_all()
        if not reason.is_failure:
            topics = [topic(self.group, "+", what) for what in (ONLINE, BIRTH, HEALTH, ROLLED)]
            client.subscribe([(one, 1) for one in (*topics, self._own)])

    def _closed(self, client: Client, data: Any, flags: Any, reason: Any, properties: Any) -> None:
        with self._state:
            self.connected = False
            members = list(self.members.values())
            for member in members:  # their state is unknown until the broker sends it again
                member.online = False
        for member in members:
            self._changed(member.name)

    def _heard(self, client: Client, data: Any, message: Any) -> None:
        """Handle a message. The echo of the own message arrives after all retained ones."""
        if message.topic == self._own:
            with self._state:
                self._echoed = True
                self._state.notify_all()
            return
        name, _, what = message.topic.removeprefix(f"{self.group}/").partition("/")
        with self._state:
            if what == ROLLED:
                answer = from_message(message.payload)
                key = name, str(answer.get("id"))
                if key in self._answers:
                    self._answers[key] = answer
                    self._state.notify_all()
                return
            member = self.members.setdefault(name, Member(name))
            if what == ONLINE:
                member.online = message.payload == YES
            elif what == BIRTH:
                member.birth = from_message(message.payload)
            else:
                member.health = from_message(message.payload)
        self._changed(name)


def _answer(name: str, said: Mapping[str, Any] | None, within: float) -> GatewayAnswer:
    if said is None:
        what = f"it has not answered within {within:g} s; it may have applied the file, as the list shows"
        return GatewayAnswer(name, False, problems=(what,), answered=False)
    problems = said.get("problems")
    sentences = tuple(str(one) for one in problems) if isinstance(problems, list) else ()
    return GatewayAnswer(name, said.get("ok") is True, str(said.get("how", "")), sentences)


def file_of(path: Path) -> bytes:
    """Return the content of a run file to roll out. Raises RequestError if it cannot be read or sent."""
    try:
        with path.open("rb") as stream:
            content = stream.read(LARGEST_FILE + 1)
    except OSError as error:
        raise RequestError(f"{path}: {error_text(error)}") from None
    try:
        _text_of(content)
    except RequestError as error:
        raise RequestError(f"{path}: {error}") from None
    return content


def _text_of(file: bytes) -> str:
    """Return a run file as text. Raises RequestError if it is too large or no text."""
    if len(file) > LARGEST_FILE:
        raise RequestError(f"the file has more than {LARGEST_FILE} bytes, the most that is rolled out")
    try:
        return file.decode()
    except UnicodeDecodeError:
        raise RequestError("the file is no text in UTF-8") from None
