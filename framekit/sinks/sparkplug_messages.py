"""Messages of Sparkplug B over protobuf: payloads of metrics, as births and deaths tell them and commands bring them.

The numbers of fields, types and qualities are those of the Sparkplug specification 3.0.0, chapter 6 (payloads) and
its section on quality codes.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any, NamedTuple

INT64, DOUBLE, BOOLEAN, STRING = 4, 10, 11, 12
INT32 = 3
GOOD, BAD, STALE = 192, 0, 500

_SIGNED = {1: 8, 2: 16, INT32: 32, INT64: 64}
"""Types of numbers with a sign, and their bits; they travel as numbers without one."""

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
    """The class of payloads. What it does not know of others' payloads it passes over."""
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
    """A value of a payload; `time` in ms since 1970. Births name it, with its type; data have its alias alone.

    `value` None: there is none. `quality` None: nothing is said of it, which means good.
    """

    value: int | float | bool | str | None
    time: int
    name: str = ""
    alias: int | None = None
    type: int | None = None
    is_historical: bool = False
    quality: int | None = None
    unit: str = ""


def encoded(metrics: list[Metric], time: int, seq: int | None = None) -> bytes:
    """A payload of these metrics; deaths have no `seq`."""
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
    """The metrics of a command. Raises ValueError for what is no payload."""
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
