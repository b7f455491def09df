"""A history in PostgreSQL: with a separate server (Debian's `postgresql`), started and killed by the test."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from points.test_sinks import START, point, sample, taken

from framekit.api.run import Run, loaded
from framekit.definition.problems import NOWHERE, DefinitionError
from framekit.run.points import PointValue
from framekit.service.sinks import SinkFeeder
from framekit.sinks import Sink
from framekit.sinks.base import Sampled
from framekit.sinks.postgres import Postgres
from framekit.sinks.secrets import Secret

psycopg = pytest.importorskip("psycopg", reason="psycopg is not installed")
PROGRAMS = max(Path("/usr/lib/postgresql").glob("*/bin"), default=Path(os.path.dirname(shutil.which("initdb") or "/")))
AS_OTHER = ["runuser", "-u", "postgres", "--"] if os.geteuid() == 0 else []
"""Command prefix, since a server refuses to run as root."""
MS = 1_000_000

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(not (PROGRAMS / "initdb").exists(), reason="postgresql is not installed"),
]


class Server:
    """A server on a free port; `password_file` has the password of its user `framekit`."""

    def __init__(self) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="framekit-postgres-"))
        self.password_file = self.folder / "password"
        self.password_file.write_text("much secret\n")
        if AS_OTHER:
            shutil.chown(self.folder, "postgres")
        self.data = self.folder / "data"
        self._do("initdb", "-U", "framekit", "-A", "scram-sha-256", f"--pwfile={self.password_file}", "--no-sync")
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.port = free.getsockname()[1]
        self.start()

    def _do(self, program: str, *words: str) -> None:
        command = [*AS_OTHER, str(PROGRAMS / program), "-D", str(self.data), *words]
        subprocess.run(command, check=True, capture_output=True, cwd="/")

    def start(self) -> None:
        options = f"-p {self.port} -k {self.folder} -h 127.0.0.1 -c fsync=off"
        self._do("pg_ctl", "-w", "-l", str(self.folder / "log"), "-o", options, "start")

    def kill(self) -> None:
        self._do("pg_ctl", "-m", "immediate", "stop")

    def end(self) -> None:
        with suppress(FileNotFoundError):
            os.kill(int((self.data / "postmaster.pid").read_text().splitlines()[0]), signal.SIGQUIT)
        shutil.rmtree(self.folder, ignore_errors=True)

    @property
    def address(self) -> str:
        return f"postgresql://127.0.0.1:{self.port}/postgres"

    def rows(self, query: str) -> list[tuple[Any, ...]]:
        with psycopg.connect(self.address, user="framekit", password="much secret") as connection:
            return connection.execute(query).fetchall()

    def kind(self, **keys: Any) -> Postgres:
        secret = Secret("file", str(self.password_file))
        return Postgres(postgres=self.address, user="framekit", password=secret, at=NOWHERE, **keys)


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    found = Server()
    yield found
    found.end()


class Named:
    """A run as a sink sees it."""

    run = "plant"


def sink_of(kind: Postgres) -> Sink:
    sink = kind.make()
    sink.meet(Named())  # type: ignore[arg-type]
    return sink


def test_rows_are_exact_and_come_once(server: Server) -> None:
    kind = server.kind(table="exact")
    many = [
        sample(0, value=0.1),
        sample(1, value=(1 << 64) - 1),
        sample(2, "state", 'a\t"b"\n\\N'),
        Sampled(START + 3 * MS, (PointValue("state", "heating", "good", "", START, 2),)),
        sample(4, value=5, quality="failed", reason="no_reply"),
    ]
    for _ in range(2):  # the second time is like a start after a kill
        taken(sink_of(kind), many)
    found = server.rows("SELECT run, point, value, words, unit, quality, reason FROM exact ORDER BY time")
    assert [(row[0], *map(str, row[1:])) for row in found] == [
        ("plant", "level", "0.1", "None", "m", "good", ""),
        ("plant", "state", "2", "heating", "", "good", ""),
        ("plant", "level", "18446744073709551615", "None", "m", "good", ""),
        ("plant", "state", "None", 'a\t"b"\n\\N', "", "good", ""),
        ("plant", "level", "None", "None", "m", "failed", "no_reply"),
    ]
    (when,) = server.rows("SELECT to_char(min(time) AT TIME ZONE 'UTC', 'YYYY-MM-DD HH24:MI:SS') FROM exact")
    assert when == ("2026-03-01 12:00:00",)


def test_names_of_tables_are_names_only(server: Server) -> None:
    taken(sink_of(server.kind(table='od"d; DROP')), [sample(0)])
    assert server.rows('SELECT point FROM "od""d; DROP"') == [("level",)]


def test_what_a_dead_server_could_not_take_comes_in_order(server: Server, tmp_path: Path) -> None:
    feeder = SinkFeeder(server.kind(table="kept", store=str(tmp_path / "waiting.db")), [point("level", "m")], False)
    feeder.start()
    feeder.put(sample(0, value=0))
    server.kill()
    for number in range(1, 30):
        feeder.put(sample(number, value=number))
    status = feeder.status
    assert (status.written, status.waiting, status.dropped) == (1, 29, 0) and status.problem
    server.start()
    feeder.put(sample(30, value=30))
    feeder.stop()
    assert server.rows("SELECT value FROM kept ORDER BY time") == [(number,) for number in range(31)]


RUN = """
run: plant
channels: {1: {port: "sim:meter.device.yaml", protocol: modbus-tcp, station: 1}}
points: {level: {channel: 1, address: "40001", every: 100 ms}}
sinks: [{postgres: "ADDRESS", user: framekit, password: "file:PASSWORD", store: waiting.db, every: 200 ms}]
"""


def test_a_run_fills_a_table(server: Server, tmp_path: Path) -> None:
    device = 'device: meter\nprotocol: modbus-tcp\nstation: 1\nmemory: {set: {"40001": [217]}}\n'
    (tmp_path / "meter.device.yaml").write_text(device)
    text = RUN.replace("ADDRESS", server.address).replace("PASSWORD", str(server.password_file))
    (tmp_path / "plant.run.yaml").write_text(text)
    with Run(tmp_path / "plant.run.yaml") as run:
        ends = time.monotonic() + 30
        while run.status().sinks[0].written < 2 and time.monotonic() < ends:
            threading.Event().wait(0.02)
    assert ("plant", "level", 217, "good") in server.rows("SELECT run, point, value, quality FROM history")


@pytest.mark.parametrize(
    ("sink", "problem"),
    [
        ("{postgres: localhost}", "'localhost' names no database – write it like postgresql://HOST/DATABASE"),
        ("{postgres: 'postgresql://me@h/d'}", "the user's name has a key of its own – use user:"),
        ("{postgres: postgres://h/d?Password=x}", "a secret does not stand in a run file – use user: and password:"),
        ("{postgres: 'postgresql://me:pw@h/d'}", "a secret does not stand in a run file – use user: and password:"),
        ("{postgres: postgresql://h/d, table: a.b.c}", "'a.b.c' is no name of a table – write table, or schema.table"),
        ("{postgres: postgres://h/d, password: env:P}",
         "'password' has no effect without user – add user:, or remove it"),
    ],
)  # fmt: skip
def test_what_is_wrong(tmp_path: Path, sink: str, problem: str) -> None:
    (tmp_path / "meter.device.yaml").write_text("device: meter\nprotocol: modbus-tcp\nstation: 1\n")
    (tmp_path / "plant.run.yaml").write_text(f"{RUN.partition('sinks')[0]}sinks: [{sink}]\n")
    with pytest.raises(DefinitionError) as error:
        loaded(tmp_path / "plant.run.yaml")
    assert [str(problem).partition(": ")[2] for problem in error.value.problems] == [problem]
