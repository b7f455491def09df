"""Soak test: 8 channels with every kind of sink on real ports, while broker and database are killed.

`python tests/points/test_soak.py --minutes 30` runs that long and prints figures. Each point counts in its device.
Every reported value must be in the history of each sink, in order, and only once if the sink can ensure that.
"""

from __future__ import annotations

import argparse
import csv
import json
import re
import socket
import sqlite3
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import pytest

if __name__ == "__main__":
    sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parents[2])]

from points.mosquitto import Broker, Listener, free_port, needs_mosquitto
from points.test_influx import Database, database
from points.test_mqtt_kills import Network
from points.test_opcua import with_client
from points.test_postgres import PROGRAMS
from points.test_postgres import Server as Postgres
from points.test_sparkplug import read

import framekit
from framekit.run.points import PointValue

CHANNELS, POINTS = 8, 5
Histories = dict[str, list[int]]
"""Values by point, in order of arrival."""

SINKS = """sinks:
  - {{csv: rows.csv, rotate: 1 MB}}
  - {{jsonl: rows.jsonl, rotate: day}}
  - {{sqlite: history.db}}
  - {{parquet: rows.parquet, rotate: hour}}
  - {{prometheus: "127.0.0.1:{prometheus}"}}
  - {{mqtt: "127.0.0.1:{broker}", topic: "m/{{point}}", payload: plain, most: 10000000}}
  - {{sparkplug: "127.0.0.1:{broker}", group: soak, most: 10000000}}
  - {{influx: "http://127.0.0.1:{influx}", database: soak, most: 10000000}}
  - {{postgres: "postgresql://127.0.0.1:{postgres}/postgres", user: framekit, password: "file:{secret}", most: 9999999}}
  - {{opcua: "127.0.0.1:{opcua}"}}
"""


def serve(folder: Path, number: int) -> framekit.Server:
    """Serve a device that counts: over TCP, every second device on a serial port (a pseudo-terminal)."""
    protocol, port = ("modbus-tcp", "tcp://127.0.0.1:0") if number % 2 else ("modbus-rtu", "pty:")
    lines = [f"device: d{number}", f"protocol: {protocol}", "station: 1", "behave:"]
    lines += [f'  "{40001 + 2 * point}": {{counter: 1, type: uint32, every: 200 ms}}' for point in range(POINTS)]
    path = folder / f"d{number}.device.yaml"
    path.write_text("".join(f"{line}\n" for line in lines), "utf-8")
    return framekit.serve(path, port)


def write_run(folder: Path, ports: dict[int, str], **places: object) -> Path:
    """Write a run file with points read from servers on these ports, and sinks at these places."""
    lines = ["run: soak", "channels:"]
    for number, port in ports.items():
        protocol = "modbus-tcp" if number % 2 else "modbus-rtu"
        lines.append(f'  {number}: {{port: "{port}", protocol: {protocol}, station: 1}}')
    lines.append("points:")
    for number in ports:
        lines += [
            f'  c{number}.p{at}: {{channel: {number}, address: "{40001 + 2 * at}", type: uint32, every: 200 ms}}'
            for at in range(POINTS)
        ]
    path = folder / "soak.run.yaml"
    path.write_text("".join(f"{line}\n" for line in lines) + SINKS.format(**places), "utf-8")
    return path


def kept(rows: Iterable[tuple[str, object]]) -> Histories:
    """Return the values of each point."""
    found: Histories = defaultdict(list)
    for name, value in rows:
        found[name].append(int(str(value)))
    return dict(found)


def once(histories: Histories) -> Histories:
    """Return the first occurrence of each value."""
    return {name: list(dict.fromkeys(values)) for name, values in histories.items()}


def in_files(folder: Path) -> dict[str, Histories]:
    """Return the histories in the files of the sinks; the files of a sink are read in the order of their names."""
    from pyarrow import parquet

    rows = [
        row
        for path in [*sorted(folder.glob("rows.*.csv")), folder / "rows.csv"]
        for row in csv.DictReader(path.open(encoding="utf-8"))
    ]
    objects = [json.loads(line) for line in (folder / "rows.jsonl").open(encoding="utf-8")]
    tables = [parquet.read_table(path).to_pylist() for path in sorted(folder.glob("rows*.parquet"))]
    rows_of = (row for table in tables for row in table)
    cells = ((name, value) for row in rows_of for name, value in row.items() if name != "time" and value is not None)
    with sqlite3.connect(folder / "history.db") as database:
        stored = database.execute(
            "select name, value from history join points on id = point where quality = 'good' order by history.rowid"
        ).fetchall()
    return {
        "csv": kept((row["point"], row["value"]) for row in rows if row["quality"] == "good"),
        "jsonl": kept((record["point"], record["value"]) for record in objects if record["quality"] == "good"),
        "sqlite": kept(stored),
        "parquet": once(kept(cells)),  # a row has the values of all points at that time
    }


def in_lines(server: Database) -> Histories:
    """Return the histories on the line protocol server, ordered by time, since a batch may be sent twice."""
    found: dict[str, dict[int, object]] = defaultdict(dict)
    for line in server.lines:
        match = re.fullmatch(r"soak,.*\bpoint=([^, ]+)\S* (?:.*,)?value=(\d+)\.0(?:,.*)? (\d+)", line)
        if match is not None and 'quality="good"' in line:
            found[match[1]][int(match[3])] = match[2]
    return kept((name, value) for name, rows in found.items() for _, value in sorted(rows.items()))


def in_metrics(listener: Listener) -> Histories:
    """Return the histories in Sparkplug metrics, with the first time of each value.

    A birth reports the current value before older values arrive, so only names are taken from it.
    """
    names: dict[int, str] = {}
    rows = []
    for topic, payload, _ in listener.heard:
        if topic.startswith("spBv1.0/soak/N") and "DEATH" not in topic:
            for metric in read(payload)[1]:
                if "name" in metric and "alias" in metric:
                    names[metric["alias"]] = metric["name"]
                name = metric.get("name") or names.get(metric.get("alias", -1), "")
                if (
                    "NDATA" in topic
                    and name.startswith("c")
                    and metric.get("long") is not None
                    and metric.get("Quality", 192) == 192
                ):
                    rows.append((name, metric["long"]))
    return once(kept(rows))


def shown_by_metrics(port: int) -> dict[str, float]:
    """Return the values that Prometheus would fetch now."""
    text = urlopen(f"http://127.0.0.1:{port}/metrics").read().decode()
    rows = re.findall(r'^framekit_point_value\{point="([^"]+)".*\} (\S+)$', text, re.MULTILINE)
    return {name: float(value) for name, value in rows}


def shown_by_nodes(port: int, names: list[str]) -> dict[str, float]:
    """Return the values of the variables of an OPC UA server."""
    found: dict[str, float] = {}

    async def read_all(client: Any) -> None:
        for name in names:
            found[name] = await client.get_node(f"ns=2;s={name}").read_value()

    with_client(port, read_all)
    return found


def soak(folder: Path, seconds: float, pause: float) -> Counter[str]:
    """Run for `seconds`, kill broker and database in turn after pauses, and return figures. Raises AssertionError."""
    figures: Counter[str] = Counter()
    with ExitStack() as stack:
        servers = {number: stack.enter_context(serve(folder, number)) for number in range(1, CHANNELS + 1)}
        broker, postgres = stack.enter_context(Broker(folder)), Postgres()
        stack.callback(postgres.end)
        network = Network(broker.port)
        stack.callback(network.close)
        lines = stack.enter_context(database())
        listener = stack.enter_context(Listener(broker.port, "#", qos=0))
        places = {"prometheus": free_port(), "opcua": free_port(), "postgres": postgres.port, "influx": lines.port}
        ports = {number: server.port for number, server in servers.items()}
        path = write_run(folder, ports, broker=network.port, secret=postgres.password_file, **places)
        reported: Histories = defaultdict(list)

        def changed(value: PointValue) -> None:
            if value.quality == "good":
                reported[value.name].append(value.value)

        run = framekit.Run(path)
        run.points.watch(changed)
        with run:
            _until(lambda: _listens(places["opcua"]), "the server starts")
            until, number = time.monotonic() + seconds, 0
            while time.monotonic() < until:
                time.sleep(min(pause, max(0.0, until - time.monotonic())))
                number += 1
                if number % 2:
                    figures["brokers killed"] += 1
                    network.cut()
                    broker.kill()
                    listener.listens = False
                    time.sleep(pause / 6)
                    broker.start()
                    listener.wait(lambda: listener.listens)  # values published before that are lost to this listener
                    network.mend()
                else:
                    figures["databases killed"] += 1
                    postgres.kill()
                    time.sleep(pause / 6)
                    postgres.start()
            shown = shown_by_metrics(places["prometheus"]), shown_by_nodes(places["opcua"], list(reported))
            for channel in servers:
                run.enable_channel(channel, False)
            _until(lambda: not any(sink.waiting for sink in run.status().sinks), f"{run.status().sinks}")
            status, served = run.status(), {number: server.done for number, server in servers.items()}
        listener.say("end", "")
        listener.wait(lambda: listener.of("end"))
        topics = [
            (topic[2:], payload.decode()) for topic, payload, _ in listener.heard if topic[:3] == "m/c" and payload
        ]
        found = in_files(folder) | {"influx": in_lines(lines), "sparkplug": in_metrics(listener)}
        found["mqtt"] = once(kept(topics))
        found["postgres"] = kept(
            postgres.rows("select point, value from history where quality = 'good' order by point, time")
        )
    assert len(reported) == CHANNELS * POINTS
    for sink, histories in found.items():
        for name, values in reported.items():
            assert values == sorted(set(values)), f"{name} goes back"
            had = histories.get(name, [])
            assert had == values, f"{sink}: {name}: {len(had)} of {len(values)}, {_first_difference(had, values)}"
        figures[f"values in {sink}"] = sum(map(len, histories.values()))
    for of_sink in shown:
        assert of_sink.keys() == reported.keys()
        assert all(of_sink[name] in values[len(values) // 2 :] for name, values in reported.items())
    assert not any(sink.dropped for sink in status.sinks)
    taken = {
        f"{sink.kind} has taken": sink.written for sink in status.sinks if sink.kind not in ("prometheus", "opcua")
    }
    assert len(set(taken.values())) == 1, taken
    figures["samples"] = next(iter(taken.values()))
    for channel in status.channels:
        ended = sum(block.done + block.failed for block in status.blocks if block.channel == channel.number)
        assert ended == served[channel.number], f"{ended} exchanges of channel {channel.number}, {served}"
        figures["exchanges"] += ended
    figures["changes"] = sum(map(len, reported.values()))
    return figures


def _first_difference(had: list[int], values: list[int]) -> str:
    for at, (one, other) in enumerate(zip(had, values, strict=False)):
        if one != other:
            return f"at {at} {had[max(0, at - 2) : at + 9]} for {values[max(0, at - 2) : at + 9]}"
    return f"behind {had[-2:]}: {values[-2:]}"


def _listens(port: int) -> bool:
    with closing(socket.socket()) as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def _until(is_so: Callable[[], bool], description: str, within: float = 60) -> None:
    end = time.monotonic() + within
    while not is_so():
        assert time.monotonic() < end, description
        time.sleep(0.1)


@needs_mosquitto
@pytest.mark.long
@pytest.mark.skipif(not (PROGRAMS / "initdb").exists(), reason="postgresql is not installed")
def test_all_histories_add_up(tmp_path: Path) -> None:
    figures = soak(tmp_path, 8, 3)
    assert figures["changes"] > 40 and figures["brokers killed"] and figures["databases killed"]


if __name__ == "__main__":
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--minutes", type=float, default=30)
    words.add_argument("--pause", type=float, default=25, help="seconds between one killing and the next")
    given = words.parse_args()
    with tempfile.TemporaryDirectory() as place:
        began = time.monotonic()
        for name, figure in soak(Path(place), given.minutes * 60, given.pause).items():
            print(f"{name:20} {figure:10,}")
        print(f"{'seconds':20} {time.monotonic() - began:10,.0f}")
