"""Values to an MQTT broker, a topic for each point, and values from it to writable points.

Values are published at least once (QoS 1), in order for each point; the broker retains the last value. With
`discovery`, Home Assistant finds the points by itself.
"""

from __future__ import annotations

import json
import math
import re
import string
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from framekit.definition.keys import FLAG, Form, KeyReading, key, ref, words
from framekit.definition.tree import Node
from framekit.run.model import Point
from framekit.run.points import PointValue, iso_time, value_text
from framekit.sinks.base import Host, Sampled, Sink, as_record, fits, good_value
from framekit.sinks.broker import (
    LARGEST_COMMAND,
    PLACE,
    BrokerConnection,
    BrokerSink,
    Command,
    Message,
    Place,
    lost_of,
    mistakes_of_access,
)

MOST_MESSAGES = 1_000
"""Maximum number of unconfirmed messages, unless a single sample has more."""

WIDE = (-1e9, 1e9)
SMALLEST_STEP = 0.001
"""The range and the smallest step that Home Assistant gets for a number without limits."""

_PLAIN = string.ascii_letters + string.digits
_PART = re.compile(r"\{([^{}]*)\}")


def read_topic(reading: KeyReading, node: Node) -> str:
    """Return a topic in which {run} and {point} are placeholders for names. Raise Broken."""
    text = reading.reader.text(node).strip()
    wrong = next((part for part in _PART.findall(text) if part not in ("run", "point")), None)
    if wrong is not None:
        raise reading.reader.broken(node.at, f"'{{{wrong}}}' is no part of a topic", "known: {run}, {point}")
    if not text or set(text) & set("+#\0") or set(_PART.sub("", text)) & set("{}") or text.startswith(("/", "$")):
        raise reading.reader.broken(node.at, f"'{text}' is no topic", "write it like plant/{run}/{point}")
    return text


TOPIC = Form(ref("text"), read_topic)


@dataclass(frozen=True, slots=True, kw_only=True)
class Mqtt(BrokerSink):
    """An MQTT broker: a topic for each point, the last value retained, QoS 1."""

    word: ClassVar[str] = "mqtt"
    mqtt: Place = key("mqtt", PLACE, "The broker: HOST or HOST:PORT; default: port 1883, with tls 8883.")
    topic: str = key(
        "topic", TOPIC, "Where values are published; {run} and {point} are names. Default: framekit/{run}/{point}.",
        default="framekit/{run}/{point}",
    )  # fmt: skip
    status: str = key(
        "status", TOPIC, "Where online and offline are published. Default: framekit/{run}/status.",
        default="framekit/{run}/status",
    )  # fmt: skip
    payload: str = key(
        "payload", Form(words("a form", "json", "plain"), lambda r, node: r.reader.text(node)),
        "json: an object with time, value, unit and quality; plain: the value, and nothing where it is not good. "
        "Default: json.", default="json",
    )  # fmt: skip
    retain: bool = key(
        "retain", FLAG._replace(read=lambda r, node: r.reader.flag(node, default=True)),
        "no: the broker keeps no last values. Default: yes.", default=True,
    )  # fmt: skip
    commands: bool = key(
        "commands", FLAG._replace(read=lambda r, node: r.reader.flag(node, default=False)),
        "yes: what is published to a point's topic with /set behind it is written, where the point has access: rw; "
        "the answer comes to /set/answer. Default: no.", default=False,
    )  # fmt: skip
    discovery: str = key(
        "discovery", TOPIC, "Tells Home Assistant of the points, below this topic: homeassistant, unless "
        "it was changed there.", default="",
    )  # fmt: skip

    def mistakes(self) -> Iterator[tuple[str, str, str]]:
        yield from mistakes_of_access(self.access)
        if "{point}" not in self.topic:
            yield "topic", "all points would have one topic", "write {point} into it"
        if "{point}" in self.status:
            yield "status", "the status is that of the run, not of a point", "leave {point} out"

    def mistakes_with(self, points: Sequence[Point]) -> Iterator[tuple[str, str, str]]:
        if "{point}" in self.topic and "{point}" not in self.status:
            selected = [point for point in points if any(fits(pattern, point.name) for pattern in self.points)]
            problem = self.one_topic_for_two(selected)
            if problem:
                yield "topic", problem, "write another topic or status, or give the point another name"
        if self.commands and not any(point.is_writable for point in points):
            yield "commands", "'commands' has no effect: no point can be written", "give one access: rw, or remove it"

    def one_topic_for_two(self, points: Iterable[Point], run: str = "{run}") -> str:
        """Return which two topics of these points and of the status are the same; '' if all are different."""
        taken = {named(self.status, run): "the status of the run"}
        for point in points:
            topic, about = named(self.topic, run, point.name), f"point {point.name}"
            own = {topic: f"the {about}"}
            if self.commands and point.is_writable:
                own |= {f"{topic}/set": f"what is to be written to {about}"}
                own |= {f"{topic}/set/answer": f"the answers of {about}"}
            for one, what in own.items():
                if one in taken:
                    return f"{taken[one]} and {what} would have one topic, {one}"
            taken |= own
        return ""

    def make(self) -> Sink:
        return MqttSink(self)


def named(template: str, run: str, point: str = "") -> str:
    """Return a topic with its placeholders replaced."""
    return template.replace("{run}", run).replace("{point}", point)


class MqttSink(Sink):
    """Publishes values. Raises OSError, ValueError."""

    def __init__(self, kind: Mqtt) -> None:
        self.kind = kind
        self._host: Host | None = None
        self._run = ""
        self._points: Mapping[str, Point] = {}
        self._commands: Mapping[str, str] = {}
        self._connection: BrokerConnection | None = None

    def meet(self, host: Host) -> None:
        self._host, self._run = host, host.run

    def topic(self, point: str) -> str:
        """Return the topic for the values of a point."""
        return self._named(self.kind.topic, point)

    def _named(self, template: str, point: str = "") -> str:
        return named(template, self._run, point)

    def _status(self, word: str) -> Message:
        return Message(self._named(self.kind.status), word.encode())

    def open(self, points: Sequence[Point]) -> None:
        problem = self.kind.one_topic_for_two(points, self._run)  # topics may coincide once {run} is replaced
        if problem:
            raise ValueError(problem)
        self._points = {point.name: point for point in points}
        writable = [point.name for point in points if point.is_writable] if self.kind.commands else []
        self._commands = {f"{self.topic(name)}/set": name for name in writable}
        self._connection = connection = BrokerConnection(self.kind, lost_of(self._host), self._heard)
        connection.open(self._run, self._status("offline"))
        connection.subscribe(list(self._commands))
        first = [self._status("online")]
        if self.kind.discovery:
            first += [self._discovered(point) for point in points]
        connection.send([first])

    def write(self, samples: Sequence[Sampled]) -> int:
        if self._connection is None:
            raise ConnectionError("there is no connection")
        groups: list[list[Message]] = []
        count = 0
        for sample in samples:
            time = iso_time(sample.time)
            groups.append([self._message(time, one) for one in sample.values])
            count += len(sample.values)
            if count >= MOST_MESSAGES:
                break
        return self._connection.send(groups)

    def _message(self, time: str, value: PointValue) -> Message:
        if self.kind.payload == "plain":
            good = good_value(value)
            payload = "" if good is None else value_text(self._points[value.name], good)
        else:
            payload = json.dumps(as_record(time, value, self._points[value.name].unit), ensure_ascii=False)
        return Message(self.topic(value.name), payload.encode(), self.kind.retain)

    def close(self) -> None:
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.close(self._status("offline"))

    # ---- writing back -------------------------------------------------------------------------------------

    def _heard(self, command: Command) -> None:
        """Write a point for a client; the answer goes to the topic of the command with /answer appended."""
        name, connection, host = self._commands.get(command.topic), self._connection, self._host
        if name is None or connection is None or host is None:
            return
        answer: dict[str, Any] = {"point": name}

        def told(why: str) -> None:
            data = answer | {"ok": not why} | ({"reason": why} if why else {})
            text = json.dumps(data, ensure_ascii=False, allow_nan=False)
            payload = text.encode(errors="backslashreplace")  # half a character, as JSON writes it
            connection.say(Message(f"{command.topic}/answer", payload, False))

        try:
            value, message = parsed(command.payload)
        except ValueError as error:
            told(str(error))
            return
        answer |= {"value": value, **({"id": message["id"]} if message.get("id") is not None else {})}
        told_who = message.get("who")
        sender = told_who[:100] if isinstance(told_who, str) and told_who else "a client"
        who = f"{sender!r} by {command.topic} of {self.kind.place}"
        host.write(name, value, who, told)

    # ---- Home Assistant -----------------------------------------------------------------------------------

    def _discovered(self, point: Point) -> Message:
        """Return the description of a point for Home Assistant (its documentation, MQTT discovery)."""
        name = f"{_as_id(self._run, '')}_{_as_id(point.name, '_')}"  # the first _ ends the run's name
        state = self.topic(point.name)
        data: dict[str, Any] = {
            "name": point.name,
            "unique_id": f"framekit_{name}",
            "state_topic": state,
            "availability_topic": self._named(self.kind.status),
            "device": {"identifiers": [f"framekit_{self._run}"], "name": self._run, "manufacturer": "framekit"},
        }
        if self.kind.payload == "json":
            data["value_template"] = "{{ value_json.value }}"
        if point.unit:
            data["unit_of_measurement"] = point.unit
        component = "sensor"
        if f"{state}/set" in self._commands:
            data["command_topic"] = f"{state}/set"
            if point.names:
                component, data["options"] = "select", list(point.names.values())
            elif point.form.type == "string":
                component = "text"
            else:
                component = "number"
                low, high = point.limits or WIDE  # the default range would be 1 to 100
                factor = abs(float(point.scaling.factor)) if point.scaling is not None else 1
                step = SMALLEST_STEP if point.form.is_float else max(SMALLEST_STEP, factor)
                data |= {"mode": "box", "min": low, "max": high, "step": step}
        topic = f"{self._named(self.kind.discovery)}/{component}/framekit_{name}/config"
        return Message(topic, json.dumps(data, ensure_ascii=False).encode())


def _as_id(name: str, also: str) -> str:
    """Return a unique name of ASCII letters, digits, `also` and -.

    Other characters become UTF-8 in hex, for example -2e for a full stop.
    """
    plain = frozenset(_PLAIN + also)
    return "".join(one if one in plain else "".join(f"-{byte:02x}" for byte in one.encode()) for one in name)


def _is_number(value: Any) -> bool:
    """Return whether a value is a finite number."""
    return isinstance(value, int) or (isinstance(value, float) and math.isfinite(value))


def _no_number(text: str) -> None:
    raise ValueError(f"{text} is no number")


def parsed(payload: bytes) -> tuple[Any, dict[str, Any]]:
    """Return the value of a command, and its other keys: a bare value, or `{"value": …, "who": …, "id": …}`.

    Raise ValueError.
    """
    if len(payload) > LARGEST_COMMAND:
        raise ValueError("this is too long for a value")
    text = payload.decode()
    try:
        found = json.loads(text, parse_constant=_no_number)
    except RecursionError:
        raise ValueError("this is no value") from None
    except ValueError:
        found = text.strip()
    message = found if isinstance(found, dict) else {"value": found}
    value = message.get("value")
    if not isinstance(value, str) and not _is_number(value):
        raise ValueError('this is no value – send it by itself, or as {"value": 5}')
    key = message.get("id")
    if key is not None and (isinstance(key, bool) or not (isinstance(key, str) or _is_number(key))):
        raise ValueError("the id is neither a text nor a number")
    return value, message
