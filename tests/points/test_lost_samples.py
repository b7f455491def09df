"""The end of a run whose sinks have lost samples: an exit status other than 0, their number, and their points.

A table of all kinds of sinks and their faults.
"""

from __future__ import annotations

import errno
import logging
import os
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from points.test_parquet import COUNT, rows_of
from points.test_parquet import sample as typed_sample
from points.test_sinks import SECOND, START, run_file

from framekit.cli.main import main
from framekit.definition.problems import NOWHERE
from framekit.run.points import PointValue
from framekit.run.trouble import Troubles
from framekit.service.sinks import SinkFeeder, SinkHost
from framekit.sinks import SINKS
from framekit.sinks.opcua import Opcua, OpcuaSink
from framekit.sinks.parquet import ParquetFiles, write_parquet
from framekit.transport.clock import VirtualClock

FILES = {
    "csv": "csv: values.csv",
    "jsonl": "jsonl: values.jsonl",
    "sqlite": "sqlite: values.db",
    "parquet": "parquet: values.parquet",
}
SERVERS = {
    "mqtt": 'mqtt: "127.0.0.1:{port}"',
    "sparkplug": 'sparkplug: "127.0.0.1:{port}", group: g',
    "influx": 'influx: "http://127.0.0.1:{port}", bucket: b, org: o',
    "postgres": 'postgres: "postgresql://127.0.0.1:{port}/b", table: t',
}
LISTENERS = {"opcua": "opcua: {port}", "prometheus": "prometheus: {port}"}
"""The keys of each kind; `port` is a number at which no server listens, or at which another program does."""

LOST = "2 samples were lost (temperature 2, state 2)"
"""The message for two of four samples."""


@pytest.fixture
def closed_port() -> Iterator[int]:
    """A port at which no server can listen: it is bound, and refuses connections."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        yield taken.getsockname()[1]


def end_of(folder: Path, keys: str, capsys: pytest.CaptureFixture[str]) -> tuple[int, list[str]]:
    """Run for four samples; return the exit status and the lines of standard error."""
    run = run_file(folder, f"{{{keys}}}" if "prometheus" in keys else f"{{{keys}, every: 1 s}}")
    status = main(["run", str(run), "--virtual", "--for", "4500ms", "--quiet"])
    return status, capsys.readouterr().err.splitlines()


def test_every_kind_stands_in_the_table() -> None:
    assert set(SINKS) == {*FILES, *SERVERS, *LISTENERS}


@pytest.mark.usefixtures("small_heap")
@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EIO, errno.EROFS])
@pytest.mark.parametrize("word", FILES)
def test_a_file_that_cannot_be_written_any_more(
    tmp_path: Path, word: str, code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("pyarrow") if word == "parquet" else None
    kind = SINKS[word](**{word: "probe"}, every=SECOND, at=NOWHERE).make()  # type: ignore[call-arg]
    write, writes = type(kind).write, list[int]()

    def failing(sink: object, samples: object) -> int:
        writes.append(1)
        if len(writes) > 2:
            raise OSError(code, os.strerror(code))
        return write(sink, samples)  # type: ignore[arg-type]

    monkeypatch.setattr(type(kind), "write", failing)
    status, lines = end_of(tmp_path, FILES[word], capsys)
    name = f"sink {word} {tmp_path}/{FILES[word].partition(': ')[2]}"
    assert status == 1
    assert lines[0].startswith(f"{name}: {os.strerror(code)} – ") and "1 sample waits" in lines[0]
    assert lines[-1] == f"{name}: {os.strerror(code)}, {LOST}"


@pytest.mark.usefixtures("small_heap")
@pytest.mark.parametrize("word", SERVERS)
def test_a_server_that_is_away_until_too_many_samples_wait(
    tmp_path: Path, word: str, closed_port: int, capsys: pytest.CaptureFixture[str]
) -> None:
    keys = SERVERS[word].format(port=closed_port)
    status, lines = end_of(tmp_path, f"{keys}, most: 2", capsys)
    assert status == 1
    (begun, overflow, end) = lines
    assert begun.startswith(f"sink {word} ") and "the oldest are dropped from 2 on" in begun
    assert overflow.endswith(": 2 samples wait, from now on the oldest are dropped")
    assert end.endswith(f", {LOST}")
    status, lines = end_of(tmp_path, keys.replace("most: 2", "most: 100"), capsys)
    assert status == 1 and "lost" not in lines[-1], "the samples are in the store"


@pytest.mark.usefixtures("small_heap")
@pytest.mark.parametrize("word", SERVERS)
def test_a_server_that_is_away_and_a_store_that_cannot_be_written(
    tmp_path: Path, word: str, closed_port: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from framekit.sinks.store import Store

    add, adds = Store.add, list[int]()

    def failing(store: Store, samples: list[object]) -> None:
        adds.append(1)
        if len(adds) > 2:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        add(store, samples)  # type: ignore[arg-type]

    monkeypatch.setattr(Store, "add", failing)
    status, lines = end_of(tmp_path, SERVERS[word].format(port=closed_port), capsys)
    assert status == 1
    assert any(line.startswith("store ") and " in memory only" in line for line in lines)
    assert any(line.startswith(f"sink {word} ") and line.endswith(LOST) for line in lines), lines


@pytest.mark.usefixtures("small_heap")
@pytest.mark.parametrize("word", LISTENERS)
def test_a_port_that_another_program_has(
    tmp_path: Path, word: str, closed_port: int, capsys: pytest.CaptureFixture[str]
) -> None:
    """Values wait for the port; a server of current values needs none of them afterwards."""
    status, lines = end_of(tmp_path, LISTENERS[word].format(port=closed_port), capsys)
    assert status == 1
    assert "address already in use" in lines[0].lower()
    lost = "4 samples were lost (temperature 4, state 4)"
    assert lines[-1].endswith(lost if word == "opcua" else "2 samples were lost (temperature 1, state 1)")


class HostWithoutValues(SinkHost):
    def values(self) -> list[PointValue]:
        return []


def test_a_taken_port_is_found_before_the_library_starts(closed_port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its start takes seconds of work, and a run tries again and again."""
    server = pytest.importorskip("framekit.sinks.opcua_server")
    monkeypatch.setattr(server, "PointServer", None)
    with pytest.raises(OSError, match="in use"):
        sink = OpcuaSink(Opcua(opcua=("127.0.0.1", closed_port), at=NOWHERE))
        sink.meet(HostWithoutValues("run", VirtualClock()))
        sink.open([])


def test_a_library_prints_no_traceback(closed_port: int, capsys: pytest.CaptureFixture[str]) -> None:
    """Another program takes the port while the library starts. Python prints the log of a library without handlers."""
    pytest.importorskip("asyncua")
    sink = OpcuaSink(Opcua(opcua=("127.0.0.1", closed_port), at=NOWHERE))
    sink.meet(HostWithoutValues("run", VirtualClock()))
    with pytest.MonkeyPatch.context() as patch, pytest.raises(OSError, match="address already in use"):
        patch.setattr("framekit.sinks.opcua.require_free", lambda address: None)
        patch.setattr(logging.getLogger(), "handlers", [])
        sink.open([])
    sink.close()
    assert capsys.readouterr().err == ""


@pytest.mark.usefixtures("small_heap")
def test_a_parquet_file_that_cannot_be_completed_at_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("pyarrow")

    def full(lines: object, target: Path) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("framekit.sinks.parquet.write_parquet", full)
    status, lines = end_of(tmp_path, FILES["parquet"], capsys)
    text = f"sink parquet {tmp_path}/values.parquet: the last rows wait for the next run: No space left on device"
    assert (status, lines) == (1, [f"{text} – make room there", text])
    monkeypatch.undo()
    assert end_of(tmp_path, FILES["parquet"], capsys) == (0, []), "the next run converts them"
    assert [len(rows_of(made)) for made in tmp_path.glob("values.*.parquet")] == [4, 4]
    assert not [*tmp_path.glob("*.rows"), *tmp_path.glob("*.part")]


class Rows:
    """A parquet sink at work, and the lines of its trouble."""

    def __init__(self, path: Path) -> None:
        pytest.importorskip("pyarrow")
        clock = VirtualClock()
        troubles = Troubles(clock.now)
        self.lines: list[str] = []
        troubles.listen(lambda report: self.lines.append(report.text))
        kind = ParquetFiles(parquet=str(path), at=NOWHERE)
        self.feeder = SinkFeeder(kind, [COUNT], False, SinkHost("run", clock), troubles)
        self.feeder.open()
        self.feeder.start()

    def put(self, *numbers: int) -> None:
        for number in numbers:
            self.feeder.put(typed_sample(START + number * SECOND, {"count": number}))


def _to_nothing(part: Path) -> None:
    os.truncate(part, 0)


def _in_a_line(part: Path) -> None:
    os.truncate(part, part.stat().st_size - 60)


def _moved_and_cut(part: Path) -> None:
    part.rename(moved := part.with_name("moved"))
    os.truncate(moved, moved.stat().st_size - 60)


@pytest.mark.parametrize(("cut", "lost"), [(_to_nothing, {1, 2, 3, 4}), (_in_a_line, {3, 4}), (_moved_and_cut, {3, 4})])
def test_rows_that_another_program_cuts_off_are_counted(
    tmp_path: Path, cut: Callable[[Path], None], lost: set[int]
) -> None:
    path = tmp_path / "values.parquet"
    part = tmp_path / "values.parquet.part"
    rows = Rows(path)
    rows.put(1, 2, 3, 4)
    cut(part)
    rows.put(5)
    reason = f"sink parquet {path}: another program has cut {len(lost)} rows off {part}"
    assert rows.lines[0] == reason and len(rows.lines) == 2, "and what becomes of the file"
    rows.feeder.stop()
    found = sorted(row[1] for name in tmp_path.glob("values.*.parquet") for row in rows_of(name))
    assert found == sorted({1, 2, 3, 4, 5} - lost)
    trouble = rows.feeder.trouble.trouble
    assert (trouble.lost, trouble.points) == (len(lost), {"count": len(lost)}) and trouble.loss


def test_rows_of_two_cuts_are_counted_once(tmp_path: Path) -> None:
    path, part = tmp_path / "values.parquet", tmp_path / "values.parquet.part"
    rows = Rows(path)
    rows.put(1)
    rows.feeder._sink._let_go()  # type: ignore[attr-defined]  # as a kill does
    rows = Rows(path)
    rows.put(2, 3, 4, 5)
    for number in (6, 7):
        os.truncate(part, part.stat().st_size - 5)
        rows.put(number)
    rows.feeder.stop()
    (made,) = tmp_path.glob("values.*.parquet")
    assert [row[1] for row in rows_of(made)] == [1, 2, 3, 4, 7]
    assert rows.feeder.trouble.trouble.lost == 2


def test_rows_of_an_interrupted_conversion_come_once(tmp_path: Path) -> None:
    """Two runs ended during a conversion: before the Parquet file was complete, and after that. A third is damaged."""
    path = tmp_path / "values.parquet"
    for stamp in ("20260301T100000", "20260301T110000"):
        rows = Rows(path)
        rows.put(1)
        rows.feeder._sink._let_go()  # type: ignore[attr-defined]  # as a kill does
        (tmp_path / "values.parquet.part").rename(part := tmp_path / f"values.{stamp}.parquet.rows")
    write_parquet(part, part.with_suffix(""))
    (tmp_path / "values.20260301T120000.parquet.rows").write_text("no rows\n")
    rows = Rows(path)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "values.20260301T100000.parquet", "values.20260301T110000.parquet", "values.20260301T120000.parquet.damaged",
        "values.parquet.part",
    ]  # fmt: skip
    assert [len(rows_of(made)) for made in tmp_path.glob("values.*.parquet")] == [1, 1]
    assert len(rows.lines) == 1 and "values.20260301T120000.parquet.damaged cannot be converted" in rows.lines[0]


@pytest.mark.parametrize("place", [0, -20])
def test_rows_that_another_program_changes_are_kept_aside(tmp_path: Path, place: int) -> None:
    path, part = tmp_path / "values.parquet", tmp_path / "values.parquet.part"
    rows = Rows(path)
    rows.put(1, 2)
    data = bytearray(part.read_bytes())
    data[place] = 0xFF
    part.write_bytes(data)
    rows.feeder.stop()
    aside = tmp_path / "values.20260301T120001.parquet.damaged"
    assert aside.read_bytes() == data and not part.exists()
    (line,) = rows.lines
    assert line.startswith(f"sink parquet {path}: the rows in {aside} cannot be converted: ")
    assert rows.feeder.trouble.trouble.loss == "2 samples were lost (count 2)"
