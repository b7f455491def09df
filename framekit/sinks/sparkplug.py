"""Values to an MQTT broker as Sparkplug B: a run is an edge node that publishes its birth, its data by alias and its
death.

After the specification 3.0.0: births and data have QoS 0. To lose no data with a connection, data count as sent when
the broker has answered a later request. The messages are encoded with protobuf: numbers of fields, types and qualities
are those of the specification, chapter 6 (payloads) and its section on quality codes.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar, NamedTuple

from framekit.definition.keys import FLAG, Form, KeyReading, key, ref
from framekit.definition.tree import Node
from framekit.run.model import Point
from framekit.run.points import PointValue
from framekit.sinks.base import Host, Sampled, Sink, good_value, not_installed
from framekit.sinks.broker import (
    PLACE,
    BrokerConnection,
    BrokerSink,
    Command,
    Message,
    Place,
    lost_of,
    mistakes_of_access,
)

INT64, DOUBLE, BOOLEAN, STRING = 4, 10, 11, 12
INT32 = 3
GOOD, BAD, STALE = 192, 0, 500

_SIGNED = {1: 8, 2: 16, INT32: 32, INT64: 64}
"""Types of signed numbers, with their bits; they are transmitted as unsigned numbers."""

_VALUES = (
    ("int_value", "uint32"), ("long_value", "uint64"), ("float_value", "float"), ("double_value", "double"),
    ("boolean_value", "bool"), ("string_value", "string"),
)  # fmt: skip
_MESSAGES: dict[str, tuple[tuple[int, str, str], ...]] = {
    "PropertyValue": ((1, "type", "uint32"), (2, "is_null", "bool")),
    "PropertySet": ((1, "keys", "string*"), (2, "values", "PropertyValue*")),
    "Metric": (
        (1, "name", "string"), (2, "alias", "uint64"), (3, "timestamp", "uint64"), (4, "datatype", "uint32"),
        (5, "is_historical", "bool"), (7, "is_null", "bool"), (9, "properties", "PropertySet"),
    ),
    "Payload": ((1, "timestamp", "uint64"), (2, "metrics", "Metric*"), (3, "seq", "uint64")),
}  # fmt: skip
_FIRST_VALUE = {"PropertyValue": 3, "Metric": 10}
_PACKAGE = "framekit.sparkplug"


@cache
def payload_class() -> Any:
    """Return the class of payloads. It skips unknown parts of received payloads."""
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

    kinds = descriptor_pb2.FieldDescriptorProto
    file = descriptor_pb2.FileDescriptorProto(name="sparkplug_b.proto", package=_PACKAGE, syntax="proto2")
    for name, fields in _MESSAGES.items():
        message = file.message_type.add(name=name)
        first = _FIRST_VALUE.get(name)
        values = () if first is None else tuple((first + at, *value) for at, value in enumerate(_VALUES))
        if values:
            message.oneof_decl.add(name="value")
        for number, field, type_ in (*fields, *values):
            plain = type_.removesuffix("*")
            made = message.field.add(name=field, number=number)
            made.label = kinds.LABEL_REPEATED if plain != type_ else kinds.LABEL_OPTIONAL
            if plain in _MESSAGES:
                made.type, made.type_name = kinds.TYPE_MESSAGE, f".{_PACKAGE}.{plain}"
            else:
                made.type = kinds.Type.Value(f"TYPE_{plain.upper()}")
            if (number, field, type_) in values:
                made.oneof_index = 0
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(f"{_PACKAGE}.Payload"))


class Metric(NamedTuple):
    """A value of a payload. Births contain the name and the type, data only the alias."""

    value: int | float | bool | str | None
    """The value; None if it is missing."""
    time: int
    """Time in ms since 1970."""
    name: str = ""
    alias: int | None = None
    type: int | None = None
    is_historical: bool = False
    quality: int | None = None
    """Quality code; None if not transmitted, which means good."""
    unit: str = ""


def encoded(metrics: list[Metric], time: int, seq: int | None = None) -> bytes:
    """Return a payload of these metrics; deaths have no `seq`."""
    payload = payload_class()(timestamp=time)
    if seq is not None:
        payload.seq = seq
    for one in metrics:
        metric = payload.metrics.add(timestamp=one.time)
        if one.name:
            metric.name = one.name
        if one.alias is not None:
            metric.alias = one.alias
        if one.type is not None:
            metric.datatype = one.type
        if one.is_historical:
            metric.is_historical = True
        _set_value(metric, one.value)
        if one.quality is not None:
            metric.properties.keys.append("Quality")
            metric.properties.values.add(type=INT32, int_value=one.quality)
        if one.unit:
            metric.properties.keys.append("engUnit")
            metric.properties.values.add(type=STRING, string_value=one.unit)
    data: bytes = payload.SerializeToString()
    return data


def _set_value(metric: Any, value: int | float | bool | str | None) -> None:
    match value:
        case None:
            metric.is_null = True
        case bool():
            metric.boolean_value = value
        case int():
            metric.long_value = value & (1 << 64) - 1
        case float():
            metric.double_value = value
        case str():
            metric.string_value = value


class CommandMetric(NamedTuple):
    """A metric of a command: by name or alias."""

    name: str
    alias: int | None
    value: int | float | bool | str | None


def decoded(data: bytes) -> Iterator[CommandMetric]:
    """Yield the metrics of a command. Raises ValueError for an invalid payload."""
    from google.protobuf.message import DecodeError

    try:
        payload = payload_class().FromString(data)
    except DecodeError:
        raise ValueError("this is no payload of Sparkplug B") from None
    for metric in payload.metrics:
        which = metric.WhichOneof("value")
        value = None if which is None or metric.is_null else getattr(metric, which)
        if which in ("int_value", "long_value") and value is not None:
            bits = _SIGNED.get(metric.datatype, 0 if metric.datatype else 32 if which == "int_value" else 64)
            value &= (1 << bits) - 1 if bits else -1
            if bits and value >> (bits - 1):
                value -= 1 << bits
        yield CommandMetric(metric.name, metric.alias if metric.HasField("alias") else None, value)


log = logging.getLogger(__name__)

REBIRTH = "Node Control/Rebirth"
BIRTHS = "bdSeq"
MOST_METRICS = 500
"""Largest number of metrics in a message, unless one sample has more."""

_QUALITY = {"good": GOOD, "failed": BAD, "stale": STALE}
_WHOLE = range(-(1 << 63), 1 << 63)


def read_name(reading: KeyReading, node: Node) -> str:
    """Return a name of a group or a node. Raises Broken."""
    text = reading.reader.text(node).strip()
    if not text or set(text) & set("/+#\0"):
        raise reading.reader.broken(node.at, f"'{text}' is no name in Sparkplug", "leave / + and # out")
    return text


NAME = Form(ref("text"), read_name)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sparkplug(BrokerSink):
    """An MQTT broker with Sparkplug B: birth, data by alias, death; rebirth and values by commands."""

    word: ClassVar[str] = "sparkplug"
    sparkplug: Place = key("sparkplug", PLACE, "The broker: HOST or HOST:PORT; default: port 1883, with tls 8883.")
    group: str = key("group", NAME, "The group that the edge node belongs to.")
    node: str = key("node", NAME, "The name of the edge node; default: the run's name.", default="")
    commands: bool = key(
        "commands", FLAG._replace(read=lambda r, node: r.reader.flag(node, default=False)),
        "yes: node commands write points that have access: rw. Default: no.", default=False,
    )  # fmt: skip

    def mistakes(self) -> Iterator[tuple[str, str, str]]:
        yield from mistakes_of_access(self.access)
        yield from not_installed("protobuf", "google.protobuf")

    def mistakes_with(self, points: Sequence[Point]) -> Iterator[tuple[str, str, str]]:
        if self.commands and not any(point.is_writable for point in points):
            yield "commands", "'commands' has no effect: no point can be written", "give one access: rw, or remove it"

    def make(self) -> Sink:
        return SparkplugSink(self)


class SparkplugSink(Sink):
    """An edge node. Raises OSError, ValueError."""

    def __init__(self, kind: Sparkplug) -> None:
        self.kind = kind
        self._host: Host | None = None
        self._points: Mapping[str, Point] = {}
        self._aliases: Mapping[str, int] = {}
        self._connection: BrokerConnection | None = None
        self._lock = threading.Lock()
        self._seq = 0
        self._births = time.time_ns() // 1_000_000_000 % 256
        """Number of the birth, 0 to 255, different from the number of the previous run."""
        self._born = 0

    def meet(self, host: Host) -> None:
        self._host = host

    def _topic(self, kind: str) -> str:
        node = self.kind.node or ("" if self._host is None else self._host.run)
        return f"spBv1.0/{self.kind.group}/{kind}/{node}"

    def _death(self) -> Message:
        births = Metric(self._births, _now(), BIRTHS, type=INT64)
        return Message(self._topic("NDEATH"), encoded([births], _now()), retain=False)

    def open(self, points: Sequence[Point]) -> None:
        self._points = {point.name: point for point in points}
        self._aliases = {name: number for number, name in enumerate(self._points, 1)}
        self._births = (self._births + 1) % 256
        self._connection = connection = BrokerConnection(self.kind, lost_of(self._host), self._heard)
        connection.open("" if self._host is None else self._host.run, self._death())
        connection.subscribe([self._topic("NCMD")])
        self._bear(connection)
        connection.answered(self._topic("NCMD"))

    def _bear(self, connection: BrokerConnection) -> None:
        """Publish the birth: all metrics with their names, types and present values."""
        born = time.time_ns()
        values = () if self._host is None else self._host.values()
        now = {one.name: one for one in values if one.name in self._points}
        metrics = [Metric(self._births, _now(), BIRTHS, type=INT64), Metric(False, _now(), REBIRTH, type=BOOLEAN)]
        for name, point in self._points.items():
            value = now.get(name, PointValue(name))
            metric = self._metric(value, value.time // 1_000_000 or _now())
            metrics.append(
                metric._replace(name=name, type=_type(point), quality=_QUALITY[value.quality], unit=point.unit)
            )
        with self._lock:
            self._seq = 0
            self._born = born
            connection.post([Message(self._topic("NBIRTH"), encoded(metrics, _now(), 0), retain=False, qos=0)])

    def _metric(self, value: PointValue, time: int) -> Metric:
        point, good = self._points[value.name], good_value(value)
        quality = None if value.quality == "good" else _QUALITY[value.quality]
        if good is not None and _type(point) == STRING:
            good = str(good)
        elif good is not None:
            good = float(good) if _type(point) == DOUBLE else int(good) if int(good) in _WHOLE else None
            quality = BAD if good is None else quality
        return Metric(good, time, alias=self._aliases[value.name], quality=quality)

    def write(self, samples: Sequence[Sampled]) -> int:
        connection = self._connection
        if connection is None:
            raise ConnectionError("there is no connection")
        with self._lock:
            metrics: list[Metric] = []
            count = 0
            for sample in samples:
                if count and len(metrics) + len(sample.values) > MOST_METRICS:
                    break
                at = sample.time // 1_000_000
                is_old = sample.time <= self._born  # the birth has published the resulting value
                metrics += [self._metric(one, at)._replace(is_historical=is_old) for one in sample.values]
                count += 1
            if not metrics:
                return count
            self._seq = (self._seq + 1) % 256
            data = encoded(metrics, _now(), self._seq)
            connection.post([Message(self._topic("NDATA"), data, retain=False, qos=0)])
        connection.answered(self._topic("NCMD"))
        return count

    def close(self) -> None:
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.close(self._death())

    # ---- commands -----------------------------------------------------------------------------------------

    def _heard(self, command: Command) -> None:
        """Execute a command of a host: publish a new birth, or write points. The only answer is the new value."""
        connection, host = self._connection, self._host
        if connection is None or host is None:
            return
        names = {number: name for name, number in self._aliases.items()}
        who = f"a client by {command.topic} of {self.kind.place}"
        try:
            for asked in decoded(command.payload):
                name = asked.name or names.get(asked.alias or 0, "")
                if name == REBIRTH:
                    if asked.value is True:
                        self._bear(connection)
                elif self.kind.commands and name in self._points and asked.value is not None:
                    host.write(name, asked.value, who, lambda why: None)
                else:
                    log.warning("sink sparkplug: %s is not written for %s", name or "an alias", who)
        except (ValueError, TimeoutError) as error:
            log.warning("sink sparkplug: a command of %s is left out: %s", command.topic, error)


def _now() -> int:
    return time.time_ns() // 1_000_000


def _type(point: Point) -> int:
    """Return the type of a point's metric, which never changes."""
    if point.names or point.form.type == "string":
        return STRING
    is_whole = not point.form.is_float and (point.scaling is None or point.scaling.is_whole)
    return INT64 if is_whole else DOUBLE
