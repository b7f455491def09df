"""Values waiting for a server: stored in a file, in order, bounded, sent when possible – also by the next process."""

from __future__ import annotations

import os
import signal
import sqlite3
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import Any, ClassVar, NoReturn

import pytest
from points.test_sinks import POINTS, sample

from framekit.definition.keys import TEXT, key
from framekit.definition.problems import NOWHERE
from framekit.run.model import Point
from framekit.service.sinks import SinkFeeder
from framekit.sinks import Sink
from framekit.sinks.base import Sampled
from framekit.sinks.store import NetworkSink, Store, StoreError


def opened(path: Path, most: int = 100) -> Store:
    store = Store(path, most)
    store.open()
    return store


def test_samples_come_back_as_they_were(tmp_path: Path) -> None:
    store = opened(tmp_path / "a.db")
    samples = [sample(0, value=1 << 70), sample(1, "state", "°C", "failed", "no"), sample(2, value=0.1), sample(3)]
    store.add(samples[:3])
    store.add(samples[3:])
    assert store.first(2) == (0, samples[:2])
    store.done(0, 2)
    store.close()
    again = opened(tmp_path / "a.db")
    number, found = again.first(10)
    assert found == samples[2:] and len(again) == 2
    again.done(number, 2)
    assert len(again) == 0 and again.first(10)[1] == [] and again.dropped.samples == 0
    again.close()


def test_the_oldest_go_and_those_under_way_are_not_lost(tmp_path: Path) -> None:
    store = opened(tmp_path / "a.db", most=4)
    samples = [sample(at, value=at) for at in range(9)]
    store.add(samples[:4])
    start, under_way = store.first(3)
    store.add(samples[4:6])
    assert (len(store), store.dropped.samples) == (4, 2)
    store.done(start, len(under_way))
    assert store.first(9)[1] == samples[3:6] and store.dropped.samples == 0
    store.add(samples[6:])
    assert store.first(9)[1] == samples[5:] and store.dropped.samples == 2
    store.close()


def test_a_file_of_something_else_and_one_that_is_taken(tmp_path: Path) -> None:
    text, other = tmp_path / "text.db", tmp_path / "other.db"
    text.write_text("no database, but long enough to be looked at\n" * 40)
    with sqlite3.connect(other) as database:
        database.execute("CREATE TABLE mine (a)")
    for path, why in ((text, "is no database"), (other, "is a database of something else")):
        with pytest.raises(StoreError, match=why):
            opened(path)
    one = opened(tmp_path / "a.db")
    with pytest.raises(BlockingIOError, match="another process writes there"):
        opened(tmp_path / "a.db")
    one.close()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
def test_what_was_added_outlasts_a_kill(tmp_path: Path) -> None:
    """A process adds samples and reports their number until it is killed; the reported samples are in the file."""
    path = tmp_path / "a.db"
    reported = 0
    for most in (30, 400):
        reading, writing = os.pipe()
        child = os.fork()
        if not child:
            _add_for_ever(path, writing)
        os.close(writing)
        with os.fdopen(reading, "rb") as answers:
            for _ in range(most):
                reported = int(answers.readline())
            os.kill(child, signal.SIGKILL)
            reported = max([reported, *map(int, answers.read().splitlines(keepends=True)[:-1])])
        os.waitpid(child, 0)
    store = opened(path, most=10_000_000)
    values = [sample.values[0].value for sample in store.first(10_000_000)[1]]
    assert values == list(range(len(values))) and len(values) >= reported
    store.close()


def _add_for_ever(path: Path, reported: int) -> NoReturn:
    try:
        store = opened(path, most=10_000_000)
        at = len(store)
        while True:
            store.add([sample(at + number, value=at + number) for number in range(3)])
            at += 3
            os.write(reported, b"%d\n" % at)
    finally:
        os._exit(1)


# ---- a sink with a store ------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Sent(NetworkSink):
    """A sink whose server is the test."""

    word: ClassVar[str] = "sent"
    sent: str = key("sent", TEXT, "Where they would go.")
    servers: ClassVar[list[Sending]] = []

    def make(self) -> Sink:
        self.servers.append(Sending())
        return self.servers[-1]


class Sending(Sink):
    def __init__(self) -> None:
        self.taken: list[Any] = []
        self.on_write: Callable[[], None] = lambda: None
        self.opened = threading.Semaphore(0)

    def open(self, points: Sequence[Point]) -> None:
        self.opened.release()

    def write(self, samples: Sequence[Sampled]) -> int:
        self.on_write()
        self.taken += [value.value for sample in samples for value in sample.values]
        return len(samples)

    def close(self) -> None: ...


def feeder(path: Path, threaded: bool, most: int = 100) -> tuple[SinkFeeder, Sending]:
    found = SinkFeeder(Sent(sent="there", store=str(path), most=most, at=NOWHERE), POINTS, threaded)
    return found, Sent.servers[-1]


def gone() -> None:
    raise ConnectionError("the server is away")


@pytest.mark.parametrize("threaded", [False, True])
def test_the_next_run_sends_what_waits_first(tmp_path: Path, threaded: bool) -> None:
    one, server = feeder(tmp_path / "a.db", threaded)
    server.on_write = gone
    one.start()
    for at in range(5):
        one.put(sample(at, value=at))
    one.put(sample(5, "gone", 5))
    one.stop()
    assert (one.status.written, one.status.dropped, one.status.problem) == (0, 0, "the server is away")
    again, server = feeder(tmp_path / "a.db", threaded)
    again.start()
    again.put(sample(6, value=6))
    again.stop()
    assert server.taken == [0, 1, 2, 3, 4, 6]  # the point 'gone' does not exist any more
    assert (again.status.written, again.status.waiting, again.status.dropped) == (7, 0, 0)


def test_what_waits_is_in_the_file_while_the_server_hangs(tmp_path: Path) -> None:
    one, server = feeder(tmp_path / "a.db", threaded=True, most=50)
    hangs, goes_on = threading.Event(), threading.Event()

    def hang() -> None:
        hangs.set()
        assert goes_on.wait(10)

    server.on_write = hang
    one.start()
    one.put(sample(0, value=0))
    assert hangs.wait(10)
    for at in range(1, 60):
        one.put(sample(at, value=at))
    one.end()
    one._waiting.join(monotonic() + 10)  # everything has gone to the file now
    with sqlite3.connect(tmp_path / "a.db") as database:
        assert database.execute("SELECT count(*) FROM waiting").fetchone() == (50,)
    goes_on.set()
    one.stop()
    assert server.taken == [0, *range(10, 60)] and one.status.dropped == 9


def test_a_sink_that_has_lost_its_server_is_opened_anew(tmp_path: Path) -> None:
    one, server = feeder(tmp_path / "a.db", threaded=True)
    one.start()
    assert server.opened.acquire(timeout=10)
    one.lost("the line was cut")
    assert server.opened.acquire(timeout=10)
    one.stop()


def test_a_store_that_cannot_be_opened_does_not_stop_the_server(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("")
    one, server = feeder(tmp_path / "taken" / "a.db", threaded=False)
    one.start()
    one.put(sample(0))
    one.stop()
    assert one.store_trouble is not None and one.store_trouble.reason
    assert one.status.problem == one.store_trouble.reason
    assert (server.taken, one.status.dropped) == ([1.5], 0)


def refusing(store: Store, monkeypatch: pytest.MonkeyPatch, first_word: str) -> Callable[[], None]:
    """Let each statement that begins with this word fail, as on a full disk; the result ends that."""
    database = store._database
    assert database is not None

    class Full:
        in_transaction = property(lambda self: database.in_transaction)

        def execute(self, statement: str, *values: Any) -> sqlite3.Cursor:
            if statement.startswith(first_word):
                raise sqlite3.OperationalError("database or disk is full")
            return database.execute(statement, *values)

        def executemany(self, statement: str, rows: Any) -> sqlite3.Cursor:
            if statement.startswith(first_word):
                raise sqlite3.OperationalError("database or disk is full")
            return database.executemany(statement, rows)

        def close(self) -> None:
            database.close()

    monkeypatch.setattr(store, "_database", Full())
    return lambda: monkeypatch.setattr(store, "_database", database)


def test_a_full_disk_does_not_stop_the_server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Samples go from memory to the server while the store cannot be written; each comes once, in order."""
    one, server = feeder(tmp_path / "a.db", threaded=False)
    reports: list[str] = []
    one._troubles.listen(lambda report: reports.append(report.text))
    one.open()
    one.start()
    store = one._waiting._store
    assert store is not None
    one.put(sample(0, value=0))
    has_room = refusing(store, monkeypatch, "INSERT")
    for at in range(1, 4):
        one.put(sample(at, value=at))
    assert server.taken == [0, 1, 2, 3]
    server.on_write = gone
    for at in range(4, 6):
        one.put(sample(at, value=at))
    has_room()
    one.put(sample(6, value=6))
    server.on_write = lambda: None
    one.put(sample(7, value=7))
    assert server.taken == list(range(8)) and len(one._waiting) == 0
    one.stop()
    name = f"store {tmp_path}/a.db"
    assert [text for text in reports if text.startswith("store")] == [
        f"{name}: database or disk is full – make room there; 1 sample waits in memory only, "
        "the oldest are dropped from 100,000 on",
        f"{name}: works again after 0.0 s, no sample was lost",
    ]


def test_a_sample_is_sent_once_although_it_cannot_be_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:  # fmt: skip
    one, server = feeder(tmp_path / "a.db", threaded=False)
    one.open()
    one.start()
    store = one._waiting._store
    assert store is not None
    has_room = refusing(store, monkeypatch, "DELETE")
    for at in range(5):
        one.put(sample(at, value=at))
    assert server.taken == list(range(5))
    assert one.store_trouble is not None and one.store_trouble.reason == "database or disk is full"
    has_room()
    one.put(sample(5, value=5))
    assert (server.taken, one.store_trouble.reason) == (list(range(6)), "")
    with sqlite3.connect(tmp_path / "a.db") as database:
        assert database.execute("SELECT count(*) FROM waiting").fetchone() == (0,)
    one.stop()


def test_a_damaged_sample_is_counted_and_holds_nothing_up(tmp_path: Path) -> None:
    store = opened(tmp_path / "a.db")
    store.add([sample(at, value=at) for at in range(3)])
    store.close()
    with sqlite3.connect(tmp_path / "a.db") as database:
        database.execute("UPDATE waiting SET points = '[[1, 2' WHERE number = 1")
    one, server = feeder(tmp_path / "a.db", threaded=False)
    one.open()
    one.start()
    one.put(sample(3, value=3))
    one.stop()
    assert (server.taken, one.status.dropped, one.status.waiting) == ([0, 2, 3], 1, 0)


def test_the_status_names_the_troubles_of_server_and_store(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("")
    one, server = feeder(tmp_path / "taken" / "a.db", threaded=False)
    server.on_write = gone
    one.start()
    one.put(sample(0))
    assert one.status.problem == f"the server is away; {tmp_path}/taken is no folder"
    one.stop()


def test_a_store_that_cannot_be_read_does_not_stop_the_server(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:  # fmt: skip
    one, server = feeder(tmp_path / "a.db", threaded=False)
    one.open()
    store = one._waiting._store
    assert store is not None
    one.start()
    is_readable = refusing(store, monkeypatch, "SELECT")
    for at in range(4):
        one.put(sample(at, value=at))
    assert server.taken == [1, 2, 3] and one.status.problem == "database or disk is full"
    is_readable()
    one.put(sample(4, value=4))
    one.stop()
    assert (server.taken, one.status.problem) == ([1, 2, 3, 0, 4], "")


def test_the_log_of_a_store_stays_small(tmp_path: Path) -> None:
    store = opened(tmp_path / "a.db", most=1_000_000)
    for at in range(300):
        store.add([sample(at * 40 + number, value="x" * 100) for number in range(40)])
    assert (tmp_path / "a.db").stat().st_size > 2_000_000
    assert (tmp_path / "a.db-wal").stat().st_size < 1_000_000
    store.close()
