"""Broker, network and framekit are killed at random while points change: no value is lost or out of order.

`python tests/points/test_mqtt_kills.py` tries 200 kills in 20,000 changes, and prints figures.
"""

from __future__ import annotations

import multiprocessing
import multiprocessing.context
import os
import random
import socket
import sys
import tempfile
import threading
import time
from collections import Counter
from contextlib import suppress
from itertools import pairwise
from multiprocessing import forkserver
from pathlib import Path

import pytest

if __name__ == "__main__":
    sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parents[2])]

from points import killed_run
from points.mosquitto import Broker, Listener, needs_mosquitto

TESTS = Path(__file__).parents[1]
pytestmark = needs_mosquitto


class Network:
    """A proxy between a client and the server at `port` that can be cut."""

    def __init__(self, port: int) -> None:
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._server.getsockname()[1]
        self._to = port
        self._open: set[socket.socket] = set()
        self._lock = threading.Lock()
        self.is_up = True
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            try:
                here, _ = self._server.accept()
            except OSError:
                return
            try:
                server = socket.create_connection(("127.0.0.1", self._to), 1)
            except OSError:
                here.close()
                continue
            with self._lock:
                is_up = self.is_up
                if is_up:
                    self._open |= {here, server}
            if not is_up:
                here.close()
                server.close()
                continue
            for one, other in ((here, server), (server, here)):
                threading.Thread(target=self._pass, args=(one, other), daemon=True).start()

    def _pass(self, source: socket.socket, target: socket.socket) -> None:
        try:
            while data := source.recv(random.choice((7, 100, 65536))):
                target.sendall(data)
        except OSError:
            pass
        for end in (source, target):
            with self._lock:
                self._open.discard(end)
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def cut(self) -> None:
        """Drop all connections with the data in transit, and accept no new connections."""
        with self._lock:
            self.is_up = False
            ends = list(self._open)
        for end in ends:
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def mend(self) -> None:
        with self._lock:
            self.is_up = True

    def close(self) -> None:
        self._server.close()
        self.cut()


def kill_at_random(folder: Path, changes: int, kills: int, pause: float, seed: int) -> Counter[str]:
    """Kill at random while points change; return counts of kills, messages and repeated messages.

    Raises AssertionError.
    """
    chance = random.Random(seed)
    context = _forks()
    log = folder / "log"
    log.write_text("")
    figures: Counter[str] = Counter()
    with Broker(folder) as broker:
        network = Network(broker.port)
        path = killed_run.write_files(folder, network.port)
        arguments = (str(path), str(log), changes, pause)

        def started() -> multiprocessing.process.BaseProcess:
            process = context.Process(target=killed_run.change, args=arguments, daemon=True)
            process.start()
            return process

        with Listener(broker.port, "#", qos=0) as listener:
            process = started()
            for number in range(kills):
                _wait_for_changes(log, changes * (number + chance.random()) / (kills + 1), process)
                what = chance.choice(("framekit", "broker", "network"))
                figures[what] += 1
                if what == "framekit":
                    process.kill()
                    process.join()
                    process = started()
                    continue
                network.cut()
                if what == "broker":
                    broker.kill()
                    listener.listens = False
                    time.sleep(chance.random() / 5)
                    broker.start()
                    listener.wait(lambda: listener.listens)  # messages without a subscriber would be lost
                else:
                    time.sleep(chance.random() / 5)
                network.mend()
            process.join(120)
            assert process.exitcode == 0, "the run has not come to its end"
            listener.say("end", "")
            listener.wait(lambda: listener.of("end"))
            heard = [(topic, int(payload)) for topic, payload, _ in listener.heard if payload.isdigit()]
        network.close()
    kept = _kept(log)
    for point in range(killed_run.POINTS):
        came = [number for topic, number in heard if topic == f"p{point}" and number]
        wanted = {number for number in kept if number % killed_run.POINTS == point}
        assert not wanted - set(came), f"lost: {sorted(wanted - set(came))}"
        figures["came"] += len(came)
        figures["twice"] += len(came) - len(set(came))
        # A repetition restarts at an earlier place; without the repeated values, the sequence is in order.
        first = list(dict.fromkeys(came))
        assert first == sorted(first), f"out of order: {first}"
        assert _repeats(came) <= kills, "more is repeated than connections were lost"
    figures["kept"] = len(kept)
    return figures


def _forks() -> multiprocessing.context.ForkServerContext:
    """Return a context of processes that start at once: they are forked from a process that has loaded the run."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["points.killed_run_loaded"])
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (str(TESTS), str(TESTS.parent), before)))
    try:
        forkserver.ensure_running()  # takes the path from the environment alone
    finally:
        os.environ.pop("PYTHONPATH")
        os.environ |= {} if before is None else {"PYTHONPATH": before}
    return context


def _repeats(came: list[int]) -> int:
    """Return the number of times a sequence goes back; assert that it continues without a gap after each."""
    back = 0
    order = {number: at for at, number in enumerate(sorted(set(came)))}
    for before, number in pairwise(came):
        if number <= before:
            back += 1
        else:
            assert order[number] == order[before] + 1, f"{number} came after {before}"
    return back


def _wait_for_changes(log: Path, number: float, process: multiprocessing.process.BaseProcess) -> None:
    """Wait until the change to this number has begun."""
    until = time.monotonic() + 30
    while time.monotonic() < until and process.is_alive():
        with log.open("rb") as file:
            file.seek(max(0, log.stat().st_size - 60))
            lines = file.read().split(b"\n")[1:-1]
        if any(int(line[2:]) >= number for line in lines if line[:2] == b"b "):
            return
        time.sleep(0.005)
    assert process.is_alive(), "the run has ended"
    raise AssertionError("nothing changes any more")


def _kept(log: Path) -> set[int]:
    """Return the numbers that were reported as stored by the process that had begun them."""
    kept: set[int] = set()
    begun: set[int] = set()
    for line in log.read_text().splitlines():
        number = int(line[2:])
        if line[0] == "b":
            begun.add(number)
        else:
            kept |= begun if line[0] == "k" else set()
            begun.clear()
    return kept


def test_nothing_is_lost_by_a_few_kills(tmp_path: Path) -> None:
    figures = kill_at_random(tmp_path, changes=90, kills=3, pause=0.0005, seed=3)
    assert figures["kept"] > 40 and figures["framekit"] and figures["broker"] and figures["network"]


@pytest.mark.long
def test_nothing_is_lost_by_30_kills(tmp_path: Path) -> None:
    figures = kill_at_random(tmp_path, changes=3_000, kills=30, pause=0.002, seed=int(time.time()))
    assert figures["kept"] > 2_400


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        began = time.monotonic()
        print(
            dict(kill_at_random(Path(place), 20_000, 200, 0.002, seed=int(began))), f"{time.monotonic() - began:.0f} s"
        )
