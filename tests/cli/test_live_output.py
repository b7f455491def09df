"""Output that is not read: no exchange stops, whole lines are lost and counted, and the loss is reported."""

from __future__ import annotations

import errno
import fcntl
import io
import json
import os
import pty
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
from cli.small_run import DEVICE, RUN
from spread import spread

from framekit.api.trouble import Troubles
from framekit.cli import live_output as live_output_module
from framekit.cli.common import VerbError
from framekit.cli.live_output import UNREAD, QueuedStream, live_output
from framekit.cli.main import main
from framekit.cli.terminal import guarded_terminals
from framekit.transport.pty_port import PtyPair

LONGEST = 180
"""Seconds after which a condition is given up."""
SET_PIPE_SIZE, SMALLEST_PIPE = 1031, 4096
"""The call of Linux that sets the size of a pipe, and the smallest size."""
UNTIL = "lines are lost until it is read: read it, or start with --quiet"
"""The effect of a full queue in a verb with this option."""
ROOM = 20_000
"""Size of the queue in these tests."""

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="sets the size of pipes")


def until(holds: Callable[[], bool]) -> None:
    """Wait until a condition holds."""
    end = time.monotonic() + LONGEST
    while not holds():
        assert time.monotonic() < end, "the condition does not hold"
        time.sleep(0.01)


class Pipe:
    """A pipe of 4 kB, and a text stream at its writing end."""

    def __init__(self) -> None:
        self.reader, writer = os.pipe()
        fcntl.fcntl(writer, SET_PIPE_SIZE, SMALLEST_PIPE)
        self.stream = io.TextIOWrapper(io.BufferedWriter(io.FileIO(writer, "wb")), encoding="utf-8")
        self._text = ""

    def line(self) -> str:
        """Read a line."""
        while "\n" not in self._text:
            data = os.read(self.reader, 1000).decode()
            assert data, "the pipe has ended"
            self._text += data
        line, _, self._text = self._text.partition("\n")
        return line

    def rest(self) -> list[str]:
        """Read to the end, with the stream closed."""
        data = b""
        while part := os.read(self.reader, 1 << 16):
            data += part
        return (self._text + data.decode(self.stream.encoding)).splitlines()


@pytest.fixture
def pipes(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], tuple[Pipe, Pipe]]]:
    """Make pipes standard output and standard error when the test calls it; queues are full at `ROOM` bytes."""
    output, errors = Pipe(), Pipe()

    def in_place() -> tuple[Pipe, Pipe]:
        monkeypatch.setattr(live_output_module, "MOST_WAITING", ROOM)
        monkeypatch.setattr(live_output_module, "RETRY", 0.01)
        monkeypatch.setattr(sys, "stdout", output.stream)
        monkeypatch.setattr(sys, "stderr", errors.stream)
        return output, errors

    yield in_place
    for pipe in (output, errors):
        os.close(pipe.reader)


class Reader:
    """Read a pipe to its end in a thread."""

    def __init__(self, pipe: Pipe) -> None:
        self.lines: list[str] = []
        self._pipe = pipe
        self._thread = threading.Thread(target=lambda: self.lines.extend(pipe.rest()))
        self._thread.start()

    def at_end(self) -> list[str]:
        """Return all lines, with the stream closed."""
        self._pipe.stream.close()
        self._thread.join()
        return self.lines


# ---- the streams --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("as_json", [False, True])
def test_a_full_queue_loses_whole_lines_and_reports_it(pipes: Callable[[], tuple[Pipe, Pipe]], as_json: bool) -> None:
    output, _ = pipes()
    troubles = Troubles(time.monotonic_ns)
    reports: list[str] = []
    troubles.listen(lambda report: reports.append(f"{report.event}: {report.text}"))
    printed = 0

    def show(text: str = "a line of text") -> None:
        nonlocal printed
        print(f"{printed} {text}")
        printed += 1

    with live_output(as_json) as live:
        with live.may_drop(troubles.source):
            while not reports:
                show()
            for _ in range(100):
                show()
            (trouble,) = troubles.present()
            assert (trouble.name, trouble.reason, trouble.lost) == ("standard output", UNREAD, 101)
            assert trouble.waiting > 500
            assert trouble.loss == "101 lines were lost"
            reader = Reader(output)
            until(lambda: len(reports) == 2)
            (trouble,) = troubles.present()
            assert (trouble.reason, trouble.lost) == ("", 101)
            show("the last of the run")
        show("the summary")
    lines = reader.at_end()
    assert reports[0] == "begins: standard output: its reader does not read – lines are lost until it is read: read it"
    assert reports[1].startswith("ends: standard output: works again after ")
    assert reports[1].endswith(", 101 lines were lost")
    place = printed - 101 - 2
    loss = {"event": "lost_lines", "count": 101, "reason": UNREAD}
    assert lines[place] == (json.dumps(loss) if as_json else "(101 lines were lost here: its reader does not read)")
    assert lines[:place] == [f"{number} a line of text" for number in range(place)]
    assert lines[place + 1 :] == [f"{printed - 2} the last of the run", f"{printed - 1} the summary"]


def test_a_queue_that_is_still_full_at_the_end_has_room_for_the_summary(pipes: Callable[[], tuple[Pipe, Pipe]]) -> None:
    output, errors = pipes()
    with live_output(False) as live:
        with live.may_drop():
            for number in range(2000):
                print(number, "x" * 100)
        print("the summary")
        status = live.report_losses(0)
        reader, error_reader = Reader(output), Reader(errors)
    lines, error_lines = reader.at_end(), error_reader.at_end()
    kept = len(lines) - 2
    assert lines[:kept] == [f"{number} {'x' * 100}" for number in range(kept)] and kept < 1000
    assert lines[kept:] == [f"({2000 - kept} lines were lost here: its reader does not read)", "the summary"]
    assert error_lines == [
        "standard output: its reader does not read – lines are lost until it is read: read it",
        f"standard output: its reader does not read, {2000 - kept} lines were lost",
    ]
    assert status == 1


def test_nothing_is_dropped_before_and_after(pipes: Callable[[], tuple[Pipe, Pipe]]) -> None:
    output, _ = pipes()
    with live_output(False):
        for number in range(20_000):
            print(number, "of many")
        reader = Reader(output)
    assert reader.at_end() == [f"{number} of many" for number in range(20_000)]


def test_standard_error_that_is_not_read_loses_lines_too(pipes: Callable[[], tuple[Pipe, Pipe]]) -> None:
    output, errors = pipes()
    with live_output(True) as live:
        with live.may_drop():
            for number in range(2000):
                print(number, "x" * 100, file=sys.stderr)
            print("goes on")
            assert output.line() == "goes on"
        assert live.report_losses(0) == 1
        reader = Reader(errors)
    lines = reader.at_end()
    assert lines[-2].endswith(" lines were lost here: its reader does not read)")
    assert lines[-1].startswith("standard error: its reader does not read, ")


def test_a_reader_that_has_gone_ends_the_verb_without_a_word(pipes: Callable[[], tuple[Pipe, Pipe]]) -> None:
    output, errors = pipes()
    gone = threading.Event()
    with pytest.raises(BrokenPipeError), live_output(False) as live, live.may_drop():
        live.on_gone(gone.set)
        print("one")
        assert output.line() == "one"
        os.close(output.reader)
        output.reader = os.open(os.devnull, os.O_RDONLY)
        print("two")
        assert gone.wait(LONGEST)
        for number in range(10_000):
            print(number)
    errors.stream.close()
    assert errors.rest() == []


def test_a_reader_that_has_gone_is_reported_and_the_work_goes_on(pipes: Callable[[], tuple[Pipe, Pipe]]) -> None:
    output, errors = pipes()
    with live_output(False, goes_on="the run") as live, live.may_drop():
        print("one")
        assert output.line() == "one"
        os.close(output.reader)
        output.reader = os.open(os.devnull, os.O_RDONLY)
        for number in range(10_000):
            print(number)
        until(lambda: live.gone)
        print("goes on", file=sys.stderr)
        assert live.report_losses(0) == 0
    errors.stream.close()
    assert errors.rest() == ["standard output: its reader has gone – the run goes on without it", "goes on"]


def test_a_stopped_verb_does_not_wait_for_its_reader_without_an_end(
    pipes: Callable[[], tuple[Pipe, Pipe]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("framekit.service.write_queue.LONGEST_STALL", 0.1)
    output, _ = pipes()
    with pytest.raises(VerbError) as failed, live_output(False) as live:
        for number in range(2000):
            print(number, "x" * 100)
        assert output.line().startswith("0 x")
        live.is_stopped = True
    number = int(str(failed.value).partition("the last ")[2].split()[0])
    assert str(failed.value) == (
        f"standard output: {UNREAD}, the last {number} lines were lost – read it, or send the output to another place"
    )
    assert 1000 < number <= 2000


def test_a_stopped_verb_ends_if_its_only_reader_does_not_read(
    pipes: Callable[[], tuple[Pipe, Pipe]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """With `2>&1`, the message about lost lines cannot be written either."""
    monkeypatch.setattr("framekit.service.write_queue.LONGEST_STALL", 0.1)
    pipes()
    monkeypatch.setattr(sys, "stderr", sys.stdout)
    with pytest.raises(SystemExit) as ended, live_output(False) as live:
        for number in range(2000):
            print(number, "x" * 100)
        live.is_stopped = True
    assert ended.value.code == 1


def test_the_log_may_lose_its_reader(pipes: Callable[[], tuple[Pipe, Pipe]]) -> None:
    output, errors = pipes()
    troubles = Troubles(time.monotonic_ns)
    with live_output(False) as live, live.may_drop(troubles.source):
        os.close(errors.reader)
        errors.reader = os.open(os.devnull, os.O_RDONLY)
        print("one", file=sys.stderr)
        until(lambda: bool(troubles.present()))
        print("two", file=sys.stderr)
        print("goes on")
        assert output.line() == "goes on"
        assert [str(trouble) for trouble in troubles.present()] == ["standard error: its reader has gone"]


class Disk(io.RawIOBase):
    """A file on a disk that is full after so many bytes."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.room = 10

    def writable(self) -> bool:
        return True

    def write(self, data: bytes) -> int:  # type: ignore[override]
        if not self.room:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        part = bytes(data)[: self.room]
        self.room -= len(part)
        self.data += part
        return len(part)


def test_a_full_disk_is_reported_and_lines_wait_for_room(
    pipes: Callable[[], tuple[Pipe, Pipe]], monkeypatch: pytest.MonkeyPatch
) -> None:
    pipes()
    disk, troubles = Disk(), Troubles(time.monotonic_ns)
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(io.BufferedWriter(disk), encoding="utf-8"))
    reports: list[str] = []
    troubles.listen(lambda report: reports.append(f"{report.event}: {report.text}"))
    with live_output(False) as live, live.may_drop(troubles.source):
        print("one\ntwo\nthree\nfour")
        until(lambda: bool(reports))
        assert reports == ["begins: standard output: No space left on device – make room there; lines wait"]
        disk.room = 1_000_000
        until(lambda: len(reports) == 2)
        assert reports[1].endswith(", no line was lost")
        print("five")
    assert bytes(disk.data).decode().split() == ["one", "two", "three", "four", "five"]


def test_a_disk_that_stays_full_ends_with_an_error(
    pipes: Callable[[], tuple[Pipe, Pipe]], monkeypatch: pytest.MonkeyPatch
) -> None:
    pipes()
    disk = Disk()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(io.BufferedWriter(disk), encoding="utf-8"))
    message = "standard output: No space left on device, the last 2 lines were lost – make room there, or send"
    with pytest.raises(VerbError, match=message) as failure, live_output(False):
        print("one\ntwo\nthree\nfour")
    assert failure.value.status == 1
    assert bytes(disk.data) == b"one\ntwo\nth"


def test_standard_error_on_a_full_disk_ends_with_an_error_too(
    pipes: Callable[[], tuple[Pipe, Pipe]], monkeypatch: pytest.MonkeyPatch
) -> None:
    pipes()
    disk = Disk()
    monkeypatch.setattr(sys, "stderr", io.TextIOWrapper(io.BufferedWriter(disk), encoding="utf-8"))
    message = "standard error: No space left on device, the last line was lost"
    with pytest.raises(VerbError, match=message) as failure, live_output(False):
        print("0123456789", file=sys.stderr)
    assert failure.value.status == 1
    assert bytes(disk.data) == b"0123456789"


def test_a_status_that_the_verb_has_reported_stays(
    pipes: Callable[[], tuple[Pipe, Pipe]], monkeypatch: pytest.MonkeyPatch
) -> None:
    pipes()
    disk = Disk()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(io.BufferedWriter(disk), encoding="utf-8"))
    with pytest.raises(VerbError) as failure, live_output(False) as live:
        with live.may_drop():
            print("one\ntwo\nthree\nfour")
        assert live.report_losses(3) == 3
    assert failure.value.status == 3


def test_lost_lines_change_the_status_0_only(pipes: Callable[[], tuple[Pipe, Pipe]]) -> None:
    output, errors = pipes()
    with live_output(False) as live:
        with live.may_drop():
            for number in range(2000):
                print(number, "x" * 100)
        assert (live.report_losses(0), live.report_losses(3)) == (1, 3)
        reader, error_reader = Reader(output), Reader(errors)
    reader.at_end()
    assert len([line for line in error_reader.at_end() if "lines were lost" in line]) == 2


class FirstLockAtTheEnd(threading.Condition):
    """A condition that lets another thread write between the last lines of a queue and its end."""

    def __init__(self, thread_name: str) -> None:
        super().__init__()
        self.write: Callable[[], object] | None = None
        """Writes as another thread would, when the writer thread next takes the lock without a line to write."""
        self.is_empty: Callable[[], bool] = lambda: False
        self._thread_name = thread_name

    def __enter__(self) -> bool:
        write = self.write
        if write is not None and threading.current_thread().name == self._thread_name and self.is_empty():
            self.write = None
            write()
        return super().__enter__()


def test_a_line_that_is_written_while_the_stream_closes_is_kept(pipes: Callable[[], tuple[Pipe, Pipe]]) -> None:
    output, _ = pipes()
    stream = QueuedStream(output.stream, "output", lambda number, reason: "", None)
    change = FirstLockAtTheEnd("writes output")
    stream._queue.change = change
    stream.write("one\n")
    assert output.line() == "one"
    change.is_empty = lambda: stream._queue.is_ending and not stream._queue._records
    change.write = lambda: stream.write("two\n")
    reader = Reader(output)
    stream.close()
    if change.write is not None:
        change.write()
    assert reader.at_end() == ["two"]


@pytest.fixture
def decoded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Write decoded text to the streams, as on Windows."""
    monkeypatch.setattr(live_output_module.sys, "platform", "win32")


@pytest.mark.parametrize("encoding", ["utf-8", "cp1252"])
@pytest.mark.parametrize("is_decoded", [False, True])
def test_characters_that_the_encoding_lacks_become_escapes(
    pipes: Callable[[], tuple[Pipe, Pipe]], request: pytest.FixtureRequest, encoding: str, is_decoded: bool
) -> None:
    output, _ = pipes()
    output.stream.reconfigure(encoding=encoding)
    if is_decoded:
        request.getfixturevalue("decoded")
    stream = QueuedStream(output.stream, "output", lambda number, reason: "", None)
    reader = Reader(output)
    stream.write("caf\udce9 \u20ac\n")
    stream.write("next\n")
    stream.close()
    assert not stream.gone
    data = reader.at_end()
    assert data[1] == "next" and data[0].startswith("caf\\udce9 ")


def test_a_text_longer_than_a_write_is_decoded_whole(pipes: Callable[[], tuple[Pipe, Pipe]], decoded: None) -> None:
    output, _ = pipes()
    stream = QueuedStream(output.stream, "output", lambda number, reason: "", None)
    reader = Reader(output)
    text = "x" + "\u20ac" * 100_000
    stream.write(f"{text}\n")
    stream.close()
    assert reader.at_end() == [text] and not stream.gone


def test_an_unfinished_line_is_bounded(pipes: Callable[[], tuple[Pipe, Pipe]]) -> None:
    output, _ = pipes()
    stream = QueuedStream(output.stream, "output", lambda number, reason: "", None)
    reader = Reader(output)
    for _ in range(100):
        stream.write("x" * 1000)
        assert sum(begun.tell() for begun in stream._begun.values()) <= ROOM
    stream.write("\nnext\n")
    stream.close()
    assert reader.at_end() == ["x" * 100_000, "next"]


def test_an_error_of_the_writer_thread_does_not_stop_the_end(
    pipes: Callable[[], tuple[Pipe, Pipe]], monkeypatch: pytest.MonkeyPatch
) -> None:
    output, _ = pipes()
    errors: list[object] = []
    monkeypatch.setattr(threading, "excepthook", lambda hook: errors.append(hook.exc_type))
    stream = QueuedStream(output.stream, "output", lambda number, reason: "", None)

    def fail(data: memoryview) -> int:
        raise ValueError("of another kind")

    stream._write = fail
    stream.write("one\n")
    stream.close()
    assert errors == [ValueError] and not stream.gone
    assert (stream.unwritten, stream.error) == (1, "of another kind")


def test_a_terminal_is_guarded_and_has_both_streams_in_order(monkeypatch: pytest.MonkeyPatch) -> None:
    control, terminal = pty.openpty()
    for name in ("stdout", "stderr"):
        file = io.BufferedWriter(io.FileIO(os.dup(terminal), "wb"))
        monkeypatch.setattr(sys, name, io.TextIOWrapper(file, encoding="utf-8"))
    with guarded_terminals(), live_output(False):
        for number in range(100):
            print(number, "\x1b[2Jé", file=sys.stderr if number % 2 else sys.stdout)
    text = b""
    while text.count(b"\n") < 100:
        text += os.read(control, 10_000)
    assert text.decode().splitlines() == [f"{number} \\x1b[2Jé" for number in range(100)]
    os.close(control)
    os.close(terminal)


def test_lines_of_several_threads_stay_whole(pipes: Callable[[], tuple[Pipe, Pipe]]) -> None:
    output, _ = pipes()

    def show(name: str) -> None:
        for number in range(500):
            print(name, number)

    with live_output(False):
        reader = Reader(output)
        threads = [threading.Thread(target=show, args=(name,)) for name in "ab"]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        print("without an end", end="")
    lines = reader.at_end()
    assert [line for line in lines if line[0] == "a"] == [f"a {number}" for number in range(500)]
    assert [line for line in lines if line[0] == "b"] == [f"b {number}" for number in range(500)]
    assert lines[-1] == "without an end" and len(lines) == 1001


# ---- verbs --------------------------------------------------------------------------------------------------------

WITH_SINK = (
    RUN
    + """points:
  level: {channel: 1, address: "40001", every: 20 ms}
sinks:
  - {csv: level.csv, every: 100 ms}
"""
)
START = (
    f"import sys, framekit.cli.live_output as output; output.MOST_WAITING = {ROOM}\n"
    "from framekit.cli.main import main; sys.exit(main())"
)


@contextmanager
def started(folder: Path, *words: str) -> Iterator[subprocess.Popen[str]]:
    """Start a verb in a process whose pipes have 4 kB and whose queues have `ROOM`."""
    (folder / "far.device.yaml").write_text(DEVICE, "utf-8")
    (folder / "unread.run.yaml").write_text(WITH_SINK, "utf-8")
    with subprocess.Popen(
        [sys.executable, "-c", START, *words],
        cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, bufsize=1,
    ) as process:  # fmt: skip
        try:
            for pipe in (process.stdout, process.stderr):
                assert pipe is not None
                fcntl.fcntl(pipe, SET_PIPE_SIZE, SMALLEST_PIPE)
            yield process
        finally:
            process.kill()


def size(file: Path) -> int:
    return file.stat().st_size if file.exists() else 0


def go_on(file: Path) -> None:
    """Wait until a file has grown twice."""
    for _ in range(2):
        before = size(file)
        until(lambda before=before: size(file) > before)  # type: ignore[misc]


def test_a_run_goes_on_while_its_output_is_not_read(tmp_path: Path) -> None:
    with started(tmp_path, "run", "unread.run.yaml", "--frames", "--json") as process:
        assert process.stdout is not None and process.stderr is not None
        errors = process.stderr.readline()
        assert errors == f"standard output: {UNREAD} – {UNTIL}\n"
        go_on(tmp_path / "level.csv")
        lines = []
        while not lines or lines[-1]["event"] != "lost_lines":
            lines.append(json.loads(process.stdout.readline()))
        times = [line["time"] for line in lines[:-1] if line["event"] == "frame"]
        assert times == sorted(times) and lines[-1]["reason"] == UNREAD
        lost = lines[-1]["count"]
        assert lost > 0
        process.send_signal(signal.SIGUSR1)
        status: dict[str, object] = {}
        while status.get("event") != "status":
            status = json.loads(process.stdout.readline())
        (trouble,) = status["troubles"]  # type: ignore[misc]
        assert (trouble["name"], trouble["reason"], trouble["lost"]) == ("standard output", "", lost)
        process.send_signal(signal.SIGTERM)
        ends = [json.loads(line) for line in process.stdout]
        assert process.wait(LONGEST) == 1
        assert ends[-1] == {"event": "warning", "reason": f"standard output: {lost} lines were lost"}
        (block,) = [line for line in ends if line["event"] == "block" and line["set"] == 1]
        assert block["failed"] == 0
        errors = process.stderr.read()
        assert errors.startswith("standard output: works again after ") and errors.count("\n") == 1


PACE = 0.5
"""Seconds between two signals. Python reports signals that come in the instant in which a loop is closed."""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_second_signal_ends_the_wait_for_the_reader(tmp_path: Path, number: signal.Signals) -> None:
    with started(tmp_path, "run", "unread.run.yaml", "--frames") as process:
        assert process.stderr is not None
        process.stderr.readline()

        sent_at = -PACE

        def has_ended() -> bool:
            nonlocal sent_at
            if time.monotonic() - sent_at >= PACE:
                sent_at = time.monotonic()
                process.send_signal(number)
            return process.poll() is not None

        until(has_ended)
        assert process.returncode in (-number, 130)
        assert "rror" not in process.stderr.read()


def test_readings_go_on_while_standard_error_is_not_read(tmp_path: Path) -> None:
    words = ["--port", "sim:far.device.yaml", "--station", "1", "40001", "--every", "1 ms", "--frames"]
    with started(tmp_path, "read", "modbus-tcp", *words) as process:
        assert process.stdout is not None and process.stderr is not None
        for _ in range(1000):
            assert process.stdout.readline().split() == ["40001", "1"]
        process.send_signal(signal.SIGTERM)
        reader = threading.Thread(target=process.stdout.read)
        reader.start()
        lines = process.stderr.read().splitlines()
        reader.join()
        assert len(lines) < 1000, "frames may follow the line of the loss: readings go on until the signal arrives"
        assert any(line.endswith(" lines were lost here: its reader does not read)") for line in lines)
        assert process.wait(LONGEST) == 1


def ask(place: socket.socket, number: int) -> None:
    """Read three registers of a device over Modbus TCP."""
    place.sendall(number.to_bytes(2, "big") + bytes.fromhex("0000 0006 01 03 0000 0003"))
    answer = b""
    while len(answer) < 15:
        data = place.recv(100)
        assert data, "the device has closed the connection"
        answer += data
    assert answer[:2] == number.to_bytes(2, "big")


def test_a_device_answers_while_its_output_is_not_read(tmp_path: Path) -> None:
    with started(tmp_path, "serve", "modbus-tcp", "--port", "tcp-listen://127.0.0.1:0", "--station", "1") as process:
        assert process.stdout is not None and process.stderr is not None
        port = int(process.stdout.readline().rpartition(":")[2])
        with closing(socket.create_connection(("127.0.0.1", port), LONGEST)) as place:
            for number in range(1000):
                ask(place, number)
            process.send_signal(signal.SIGTERM)
            lines = process.stdout.read().splitlines()
        (place_of_loss,) = [number for number, line in enumerate(lines) if "were lost here" in line]
        frames = len([line for line in lines if "_adu" in line])
        lost = int(lines[place_of_loss].removeprefix("(").split()[0])
        assert 2000 <= frames + lost <= 2002, "the connection has lines, too"
        assert any(line.startswith("station") for line in lines[place_of_loss:]), "the summary"
        assert process.wait(LONGEST) == 1
        errors = process.stderr.read().splitlines()
        assert errors[0] == f"standard output: {UNREAD} – {UNTIL}"
        assert f"{lost} lines were lost" in errors[-1]


@pytest.mark.parametrize(
    "words",
    spread(
        [
            ["monitor", "modbus-rtu", "--port", "{port}", "--capture", "heard.jsonl", "--json"],
            ["record", "{port}", "-o", "heard.jsonl"],
        ],
        2,
    ),
)
def test_a_line_is_heard_while_the_output_is_not_read(tmp_path: Path, words: Sequence[str]) -> None:
    with PtyPair() as pair, started(tmp_path, *(word.format(port=pair.first) for word in words)) as process:
        assert process.stdout is not None and process.stderr is not None
        until((tmp_path / "heard.jsonl").exists)
        line = os.open(pair.second, os.O_RDWR | os.O_NOCTTY)
        try:
            end = time.monotonic() + LONGEST
            while not size(tmp_path / "heard.jsonl") > 20 * ROOM:
                assert time.monotonic() < end and process.poll() is None, "the line is not heard"
                os.write(line, bytes.fromhex("01 03 00 00 00 0A C5 CD"))
                time.sleep(0.001)
        finally:
            os.close(line)
        process.send_signal(signal.SIGTERM)
        lines = process.stdout.read().splitlines()
        assert len([line for line in lines if "lost_lines" in line or "were lost here" in line]) == 1
        assert process.wait(LONGEST) == 1


def test_simulated_time_waits_for_the_reader_and_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["run", "unread.run.yaml", "--virtual", "--for", "5s", "--frames", "--json"]
    with started(tmp_path, *words) as process:
        assert process.stdout is not None
        lines = [process.stdout.readline()]
        assert process.poll() is None
        lines += process.stdout.readlines()
        assert process.wait(LONGEST) == 0
    (tmp_path / "level.csv").unlink()
    monkeypatch.chdir(tmp_path)
    assert main(words) == 0
    expected = capsys.readouterr().out.splitlines(keepends=True)
    frames = [line for line in lines if '"frame"' in line]
    assert len(frames) > 2000 and frames == [line for line in expected if '"frame"' in line]
    assert len(lines) == len(expected)
