"""Measure a fleet on this machine: 200 gateways of 50 points each at one mosquitto, which is stopped and restarted.

`python -m benchmarks.fleet` starts the gateways in a few processes, waits until all are listed and healthy, stops the
broker for some seconds while all points change, and prints the time until the list is complete, the time until all
gateways are back, the CPU share of the gateways, and whether a value was lost. Each point counts up by one; every count
that a gateway has reported must be among the messages of a subscriber with a session of its own.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import multiprocessing
import resource
import shutil
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion

from framekit.extras.fleet.fleet import Fleet
from framekit.sinks.broker import BrokerAccess, Place

DEVICE = """device: meter
protocol: modbus-tcp
station: 1
behave:
"""
PROCESSES = 4
EVERY = 5
"""Seconds between two readings of a point."""


def write_gateway(folder: Path, number: int, port: int, points: int) -> Path:
    """Write the run file of a gateway: points of one simulated device, read together, published with QoS 1."""
    name = f"gw{number:03}"
    here = folder / name
    here.mkdir()
    behaves = [f'  "{40001 + at}": {{counter: 1, every: {EVERY} s}}\n' for at in range(points)]
    (here / "meter.device.yaml").write_text(DEVICE + "".join(behaves), "utf-8")
    lines = [
        f"run: {name}",
        "channels:", '  1: {port: "sim:meter.device.yaml", protocol: modbus-tcp, station: 1}',
        "points:",
        *(f'  p{at}: {{channel: 1, address: "{40001 + at}", every: {EVERY} s}}' for at in range(points)),
        "sinks:", f'  - {{mqtt: "127.0.0.1:{port}", topic: "values/{name}/{{point}}", payload: plain}}',
        f'fleet: {{broker: "127.0.0.1:{port}", name: {name}}}',
    ]  # fmt: skip
    path = here / "meter.run.yaml"
    path.write_text("".join(f"{line}\n" for line in lines), "utf-8")
    return path


def work(paths: list[Path], ended: Any, results: Any) -> None:
    """Run several gateways in one process until the event is set; send the counters of their sinks."""
    asyncio.run(_work(paths, ended, results))


async def _work(paths: list[Path], ended: Any, results: Any) -> None:
    from framekit.api.run import AsyncRun, loaded
    from framekit.extras.fleet.gateway import Gateway

    gateways, runs = [], []
    for path in paths:
        model = loaded(path)
        gateway, run = Gateway(path, model, path.read_bytes()).__enter__(), AsyncRun(model)
        gateway.begins(run)
        run.start()
        gateway.has_begun()
        gateways.append(gateway)
        runs.append(run)
        await asyncio.sleep(0)
    while not ended.is_set():
        await asyncio.sleep(0.2)
    for run in runs:
        run.enable_channel(1, False)
    until = time.monotonic() + 60
    while time.monotonic() < until and any(sink.waiting for run in runs for sink in run.status().sinks):
        await asyncio.sleep(0.2)
    sinks = [sink for run in runs for sink in run.status().sinks]
    used = resource.getrusage(resource.RUSAGE_SELF)
    results.put(
        (sum(sink.written for sink in sinks), sum(sink.waiting + sink.dropped for sink in sinks), used.ru_utime)
    )
    for run in runs:
        await run.finish()
    for gateway in gateways:
        gateway.__exit__(None, None, None)


class Broker:
    """A mosquitto on a free port that keeps its messages over an orderly restart."""

    def __init__(self, folder: Path) -> None:
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.port: int = free.getsockname()[1]
        self._file = folder / "mosquitto.conf"
        self._file.write_text(
            f"listener {self.port} 127.0.0.1\nallow_anonymous true\nmax_queued_messages 0\n"
            f"persistence true\npersistence_location {folder}/\n"
        )
        self.start()

    def start(self) -> None:
        program = shutil.which("mosquitto", path="/usr/sbin:/usr/local/sbin:/usr/bin:/usr/local/bin")
        assert program is not None, "mosquitto is not installed"
        self._process = subprocess.Popen([program, "-c", str(self._file)], stderr=subprocess.DEVNULL)
        while True:
            try:
                socket.create_connection(("127.0.0.1", self.port), 1).close()
                return
            except OSError:
                time.sleep(0.01)

    def end(self) -> None:
        self._process.terminate()
        self._process.wait()


class Subscriber:
    """A subscriber of all values, including those during its disconnection: the broker keeps its session."""

    def __init__(self, port: int) -> None:
        self.got: dict[str, list[int]] = {}
        self.count = 0
        self._client = Client(CallbackAPIVersion.VERSION2, "values", clean_session=False)
        self._client.on_connect = lambda client, *_: client.subscribe("values/#", 1)
        self._client.on_message = self._heard
        self._client.reconnect_delay_set(1, 1)
        self._client.connect("127.0.0.1", port)
        self._client.loop_start()

    def _heard(self, client: Any, data: Any, message: Any) -> None:
        self.count += 1
        if message.payload:  # an empty payload is a value that is not good
            self.got.setdefault(message.topic, []).append(int(message.payload))

    def missing(self) -> int:
        """Return the counts between the first and the last of a point that never arrived."""
        return sum(len(set(range(some[0], some[-1] + 1)) - set(some)) for some in self.got.values())

    def out_of_order(self) -> int:
        """Return the counts that first arrived after a greater count."""
        found = 0
        for some in self.got.values():
            seen: set[int] = set()
            for one in some:
                found += one not in seen and bool(seen) and one < max(seen)
                seen.add(one)
        return found

    def close(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()


def until_all(fleet: Fleet, count: int, holds: Callable[[Any], object]) -> float:
    """Return the seconds until this number of gateways is online and fulfils a condition."""
    began = time.monotonic()
    while sum(1 for member in list(fleet.members.values()) if member.online and holds(member)) < count:
        assert time.monotonic() < began + 300, "they are not all there"
        time.sleep(0.02)
    return time.monotonic() - began


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gateways", type=int, default=200)
    parser.add_argument("--points", type=int, default=50)
    parser.add_argument(
        "--seconds", type=float, default=30, help="how long all of them go on before the broker is killed"
    )
    words = parser.parse_args()
    figures: dict[str, Any] = {"gateways": words.gateways, "points": words.gateways * words.points}
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        broker = Broker(folder)
        access = BrokerAccess(Place("127.0.0.1", broker.port))
        subscriber = Subscriber(broker.port)
        fleet = Fleet(access, "framekit")
        context = multiprocessing.get_context("spawn")
        ended, results = context.Event(), context.Queue()
        paths = [write_gateway(folder, number, broker.port, words.points) for number in range(words.gateways)]
        began = time.monotonic()
        processes = [
            context.Process(target=work, args=(paths[at::PROCESSES], ended, results)) for at in range(PROCESSES)
        ]
        for process in processes:
            process.start()
        is_well = lambda one: one.health.get("bad") == []  # noqa: E731
        until_all(fleet, words.gateways, is_well)
        figures["all well after (s)"] = round(time.monotonic() - began, 1)
        began = time.monotonic()
        with Fleet(access, "framekit") as another:
            assert len(another.members) == words.gateways
            figures["list of all (ms)"] = round((time.monotonic() - began) * 1e3, 1)
        time.sleep(words.seconds)
        broker.end()
        time.sleep(5)
        fleet.members.clear()
        broker.start()
        figures["all again after a restart of the broker (s)"] = round(until_all(fleet, words.gateways, is_well), 1)
        ended.set()
        found = [results.get() for _ in processes]
        seconds = time.monotonic() - began
        for process in processes:
            process.join()
        fleet.close()
        until = time.monotonic() + 60
        published = sum(result[0] for result in found)
        while subscriber.count < published and time.monotonic() < until:
            time.sleep(0.2)
        subscriber.close()
        broker.end()
    figures["values published"] = published
    figures["values that the subscriber got"] = subscriber.count
    figures["counts missing"] = subscriber.missing() + sum(result[1] for result in found)
    figures["counts out of order"] = subscriber.out_of_order()
    figures["of a core"] = f"{sum(result[2] for result in found) / seconds:.0%}, the start included"
    print(json.dumps(figures, indent=1))


if __name__ == "__main__":
    main()
