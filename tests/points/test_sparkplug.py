"""An edge node of Sparkplug B, with Debian's mosquitto; the test has a protobuf reader of its own for payloads."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from points.mosquitto import Broker, Listener, needs_mosquitto
from points.test_mqtt import boiler
from points.test_sinks import run_file

from framekit.api.run import Run, VirtualRun, loaded
from framekit.definition.problems import DefinitionError

pytest.importorskip("google.protobuf", reason="protobuf is not installed")

from framekit.sinks.sparkplug import Metric, decoded, encoded


def fields(data: bytes) -> Iterator[tuple[int, Any]]:
    """Return the fields of an encoded message (by protobuf's description of its encoding)."""
    at = 0

    def varint() -> int:
        nonlocal at
        value = shift = 0
        while True:
            byte = data[at]
            at += 1
            value |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                return value

    while at < len(data):
        tag = varint()
        if tag & 7 == 0:
            yield tag >> 3, varint()
        elif tag & 7 == 1:
            yield tag >> 3, struct.unpack("<d", data[at : at + 8])[0]
            at += 8
        else:
            assert tag & 7 == 2, tag
            size = varint()
            yield tag >> 3, data[at : at + size]
            at += size


VALUES = {11: "long", 13: "double", 14: "boolean", 15: "string"}


def read(payload: bytes) -> tuple[int | None, list[dict[str, Any]]]:
    """Return the sequence number of a payload, and its metrics."""
    seq, metrics = None, []
    for number, value in fields(payload):
        if number == 3:
            seq = value
        elif number == 2:
            metric: dict[str, Any] = {}
            for key, content in fields(value):
                names = {1: "name", 2: "alias", 4: "type", 5: "historical", 7: "null"}
                if key in names or key in VALUES:
                    text = content.decode() if isinstance(content, bytes) else content
                    metric[names.get(key) or VALUES[key]] = text
                elif key == 9:
                    keys = [one.decode() for at, one in fields(content) if at == 1]
                    values = [dict(fields(one)) for at, one in fields(content) if at == 2]
                    metric |= {
                        name: one.get(3, one.get(8, b"")) if name == "Quality" else one[8].decode()
                        for name, one in zip(keys, values, strict=True)
                    }
            metrics.append(metric)
    return seq, metrics


def node(folder: Path, port: int, more: str = "") -> Path:
    path = boiler(folder, port)
    text = path.read_text("utf-8")
    path.write_text(
        text.replace(f'{{mqtt: "127.0.0.1:{port}"', f'{{sparkplug: "127.0.0.1:{port}", group: works{more}'), "utf-8"
    )
    return path


BIRTH, DATA, DEATH = (f"spBv1.0/works/{word}/boiler" for word in ("NBIRTH", "NDATA", "NDEATH"))
COMMAND = "spBv1.0/works/NCMD/boiler"


@needs_mosquitto
def test_birth_data_by_alias_and_death(tmp_path: Path) -> None:
    with Broker(tmp_path) as broker, Listener(broker.port, "spBv1.0/#") as listener:
        with VirtualRun(node(tmp_path, broker.port)) as run:
            run.run_for("1500 ms")
            run.enable_channel(1, False)
            run.run_for("10 s")
        listener.wait(lambda: listener.of(DEATH))
        assert not any(retained for _, _, retained in listener.heard)
        seq, metrics = read(listener.of(BIRTH)[0])
        births = metrics[0]["long"]
        assert seq == 0 and metrics == [
            {"name": "bdSeq", "type": 4, "long": births},
            {"name": "Node Control/Rebirth", "type": 11, "boolean": 0},
            {"name": "temperature", "alias": 1, "type": 10, "null": 1, "Quality": 500, "engUnit": "°C"},
            {"name": "mode", "alias": 2, "type": 12, "null": 1, "Quality": 500},
            {"name": "setpoint", "alias": 3, "type": 10, "null": 1, "Quality": 500},
        ]
        data = [read(payload) for payload in listener.of(DATA)]
        assert [number for number, _ in data] == list(range(1, len(data) + 1))
        told = [metric for _, found in data for metric in found]
        old = {"historical": 1}  # simulated time began in the year 2000, before the birth
        assert sorted(told[:3], key=lambda one: one["alias"]) == [
            {**old, "alias": 1, "double": 21.7}, {**old, "alias": 2, "string": "heating"},
            {**old, "alias": 3, "double": 0.0},
        ]  # fmt: skip
        assert {metric["alias"]: metric for metric in told}[1] == {
            **old,
            "alias": 1,
            "null": 1,
            "Quality": told[-1]["Quality"],
        }
        assert told[-1]["Quality"] in (0, 500)
        assert read(listener.of(DEATH)[0]) == (None, [{"name": "bdSeq", "type": 4, "long": births}])


@needs_mosquitto
def test_rebirth_and_values_by_commands(tmp_path: Path) -> None:
    with Broker(tmp_path) as broker, Listener(broker.port, "spBv1.0/#") as listener:
        with Run(node(tmp_path, broker.port, ", commands: yes")) as run:
            listener.wait(lambda: listener.of(DATA))
            listener.client.publish(COMMAND, encoded([Metric(True, 5, "Node Control/Rebirth", type=11)], 5), 1)
            listener.wait(lambda: len(listener.of(BIRTH)) == 2)
            seq, metrics = read(listener.of(BIRTH)[1])
            assert seq == 0 and metrics[2]["double"] == 21.7 and metrics[2]["Quality"] == 192
            for value in (99.0, 45.5):
                listener.client.publish(COMMAND, encoded([Metric(value, 5, alias=3, type=10)], 5), 1)
            listener.client.publish(COMMAND, b"\xff\xff", 1)
            before = len(listener.of(DATA))
            listener.wait(lambda: any(b"\x10\x03" in message for message in listener.of(DATA)[before:]))
            assert run.device("meter")["40005"] == 455
        listener.wait(lambda: listener.of(DEATH))
        last = read([message for message in listener.of(DATA) if b"\x10\x03" in message][-1])
        assert last[1][-1]["double"] == 45.5


@needs_mosquitto
def test_what_waited_is_history_and_a_cut_tells_the_death(tmp_path: Path) -> None:
    path = node(tmp_path, 1)
    with VirtualRun(path) as run:
        run.run_for("1500 ms")
        run.device("meter").write("40001", 230)
        run.run_for("1 s")
        assert run.status().sinks[0].waiting == 4
    with Broker(tmp_path) as broker, Listener(broker.port, "spBv1.0/#") as listener:
        path.write_text(path.read_text("utf-8").replace('127.0.0.1:1"', f'127.0.0.1:{broker.port}"'), "utf-8")
        with Run(path) as run:
            listener.wait(lambda: sum(len(read(message)[1]) for message in listener.of(DATA)) >= 7)
            run.device("meter").write("40001", 240)
            listener.wait(lambda: sum(len(read(message)[1]) for message in listener.of(DATA)) >= 8)
            sink: Any = run._service.sinks.feeders[0]._sink
            sink._connection._client.socket().shutdown(2)  # as a cut line does
            listener.wait(lambda: len(listener.of(BIRTH)) == 2)
        listener.wait(lambda: len(listener.of(DEATH)) == 2)
        births = [read(message)[1][0]["long"] for message in listener.of(BIRTH)]
        assert [read(message)[1][0]["long"] for message in listener.of(DEATH)] == births
        assert births[1] == (births[0] + 1) % 256
        metrics = [metric for message in listener.of(DATA) for metric in read(message)[1]]
        values = [(metric["double"], "historical" in metric) for metric in metrics if metric["alias"] == 1]
        assert values[:2] == [(21.7, True), (23.0, True)] and values[3] == (24.0, False)


@pytest.mark.parametrize(
    ("type_", "which", "raw", "value"),
    [
        (3, "int_value", 0xFFFFFFFE, -2), (2, "int_value", 0xFFFE, -2), (7, "int_value", 0xFFFFFFFE, 0xFFFFFFFE),
        (4, "long_value", (1 << 64) - 2, -2), (8, "long_value", (1 << 64) - 2, (1 << 64) - 2),
        (0, "int_value", 0xFFFFFFFE, -2), (11, "boolean_value", True, True), (12, "string_value", "a", "a"),
    ],
)  # fmt: skip
def test_values_of_all_types_are_read(type_: int, which: str, raw: Any, value: Any) -> None:
    from framekit.sinks.sparkplug import payload_class

    payload = payload_class()()
    metric = payload.metrics.add(name="a")
    if type_:
        metric.datatype = type_
    setattr(metric, which, raw)
    assert [(metric.name, metric.alias, metric.value) for metric in decoded(payload.SerializeToString())] == [
        ("a", None, value)
    ]


def test_names_are_those_of_topics(tmp_path: Path) -> None:
    with pytest.raises(DefinitionError, match="'a/b' is no name in Sparkplug"):
        loaded(run_file(tmp_path, "{sparkplug: there, group: a/b}"))
    with pytest.raises(DefinitionError, match="missing key 'group'"):
        loaded(run_file(tmp_path, "{sparkplug: there}"))
