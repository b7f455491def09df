"""Programs of the fault test: each uses files in a folder while one system call after the other fails.

`test_faults_of_calls` starts them with the library of `tests/system_faults.c` preloaded: `python fault_scenarios.py
SCENARIO FOLDER` prints, as JSON, the number of failed calls, and each violation of a rule.
"""

from __future__ import annotations

import ctypes
import errno
import json
import logging
import os
import re
import shutil
import sqlite3
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

from framekit.api.replaced_file import ReplacedFile
from framekit.codec.cache import keep, read_entry
from framekit.definition.keys import TEXT, key
from framekit.definition.problems import NOWHERE
from framekit.link.addresses import Address
from framekit.link.packing import Typed
from framekit.run.model import OwnPlace, Point
from framekit.run.points import PointValue
from framekit.service.capture import Capture, CaptureReader
from framekit.service.sinks import OpenError, SinkFeeder
from framekit.service.state import KeptRun, StateError, StateFile
from framekit.sinks import Sink, SinkKind
from framekit.sinks.base import Sampled
from framekit.sinks.files import CsvFile, JsonLines
from framekit.sinks.parquet import ParquetFiles
from framekit.sinks.sqlite import SqliteHistory, read_history
from framekit.sinks.store import NetworkSink, Store
from framekit.transport.clock import VirtualClock
from framekit.transport.port import LineEvent

SECOND = 1_000_000_000
START = 1_772_366_400 * SECOND
ERRORS = (errno.ENOSPC, errno.EIO, errno.EROFS)
MOST = 400
"""Largest number of calls of a scenario."""


@cache
def library() -> ctypes.CDLL:
    """Return the preloaded library."""
    found = ctypes.CDLL(None)
    found.faults_disarm.restype = ctypes.c_long
    return found


class Faults:
    """Make system calls on a folder fail with `error`: the call number `number`, and with `lasts` all later calls."""

    def __init__(self, folder: Path, number: int, error: int, lasts: bool) -> None:
        self.folder, self.number, self.error, self.lasts = folder, number, error, lasts

    def __enter__(self) -> None:
        library().faults_arm(os.fsencode(self.folder), ctypes.c_long(self.number), self.error, int(self.lasts))

    def __exit__(self, *_: object) -> None:
        library().faults_disarm()


def point(name: str) -> Point:
    place = OwnPlace(address=Address("M", "word", 0, "M0", {}), text="M0")
    return Point(
        name=name, form=Typed("word", None, None, 1, 1, "word"), place=place, address="M0", unit="", at=NOWHERE
    )


POINTS = [point("level")]


def sample(number: int) -> Sampled:
    time = START + number * 60 * SECOND
    return Sampled(time, (PointValue("level", number, "good", "", time),))


class BrokenRuleError(Exception):
    """A violation of a rule."""


def rule(holds: bool, description: str) -> None:
    if not holds:
        raise BrokenRuleError(description)


Scenario = Callable[[Path, Faults], None]

# ---- sinks that write files --------------------------------------------------------------------------------------


def fed(kind: SinkKind, numbers: Sequence[int], faults: Faults | None) -> tuple[SinkFeeder, list[str]]:
    """Feed samples to a sink; return its feeder and the reports. Raises OpenError."""
    feeder = SinkFeeder(kind, POINTS, threaded=False)
    reports: list[str] = []
    feeder._troubles.listen(lambda report: reports.append(report.event))

    def feed() -> None:
        feeder.open()
        feeder.start()
        for number in numbers:
            feeder.put(sample(number))
        feeder.stop()

    if faults is None:
        feed()
    else:
        with faults:
            feed()
    return feeder, reports


def sink_scenario(kind: SinkKind, found: Callable[[], list[int]], faults: Faults, keeps_all: bool = True) -> None:
    fed(kind, range(3), None)
    before = found()
    try:
        feeder, reports = fed(kind, range(3, 9), faults)
    except OpenError as error:
        rule(found() == before, f"the run did not start, and the file has changed to {found()}")
        rule(bool(str(error)), "the refusal gives no reason")
        feeder, reports = fed(kind, range(3, 9), None)
    now = found()
    rule(now == sorted(set(now)), f"samples come twice or out of order: {now}")
    missing = set(range(now[0], 9)) - set(now)
    rule(feeder.status.dropped == len(missing), f"{missing} are missing, {feeder.status.dropped} are reported as lost")
    if keeps_all:
        rule(now[:3] == [0, 1, 2], f"old samples are lost: {now}")
    rule(bool(reports) or not missing, "samples are missing, and it was not reported")
    rule(faults.lasts or not missing, f"a fault that is over has cost {missing}")
    rule(reports[:2] in ([], ["begins"], ["begins", "ends"]) or "note" in reports, f"reports are {reports}")
    fed(kind, [9], None)
    rule(found()[-1] == 9, "a later run cannot write")


def files_scenario(make: Callable[[str], SinkKind], suffix: str, keeps_all: bool) -> Scenario:
    def scenario(folder: Path, faults: Faults) -> None:
        path = folder / f"values{suffix}"

        def found() -> list[int]:
            names = sorted(folder.glob(f"values.*{suffix}"))
            text = "".join(name.read_text() for name in [*names, path] if name.exists())
            rule(text.rstrip(" ").endswith("\n"), "a line is cut")  # the next start takes spaces away
            return [int(line) for line in re.findall(r"T(?:12):(\d\d):00.000Z", text)]

        sink_scenario(make(str(path)), found, faults, keeps_all)

    return scenario


def history(folder: Path, faults: Faults) -> None:
    path = folder / "values.db"

    def found() -> list[int]:
        with closing(sqlite3.connect(path)) as database:
            rule(database.execute("PRAGMA integrity_check").fetchone() == ("ok",), "the database is damaged")
        return [row.value for row in read_history(path)]

    sink_scenario(SqliteHistory(sqlite=str(path), at=NOWHERE), found, faults)


def parquet(folder: Path, faults: Faults) -> None:
    from pyarrow.parquet import read_table

    def found() -> list[int]:
        rule(not list(folder.glob("*.damaged")), "rows were not converted")
        numbers = []
        for name in sorted(folder.glob("values.*.parquet")):
            numbers += [time.minute for time in read_table(name)["time"].to_pylist()]
        for name in [*sorted(folder.glob("*.rows")), *folder.glob("*.part")]:
            if not name.with_suffix("").exists() or name.suffix == ".part":
                numbers += [int(minute) for minute in re.findall(r"T12:(\d\d):00.000Z", name.read_text())]
        return numbers

    sink_scenario(ParquetFiles(parquet=str(folder / "values.parquet"), at=NOWHERE), found, faults)


# ---- the store of a server ---------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Sent(NetworkSink):
    """A server that accepts values unless it is unreachable."""

    word: ClassVar[str] = "sent"
    sent: str = key("sent", TEXT, "Where they would go.")
    taken: ClassVar[list[int]] = []
    is_away: ClassVar[list[bool]] = []

    def make(self) -> Sink:
        return Sending()


class Sending(Sink):
    def open(self, points: Sequence[Point]) -> None: ...

    def write(self, samples: Sequence[Sampled]) -> int:
        if Sent.is_away:
            raise ConnectionError("the server is away")
        Sent.taken.extend(value.value for sample in samples for value in sample.values)
        return len(samples)

    def close(self) -> None: ...


def store(folder: Path, faults: Faults) -> None:
    """Make the server unreachable, reachable and unreachable again while calls fail."""
    kind = Sent(sent="there", store=str(folder / "values.mqtt.db"), most=100, at=NOWHERE)
    Sent.taken.clear()
    Sent.is_away[:] = [True]
    fed(kind, range(3), None)
    feeder = SinkFeeder(kind, POINTS, threaded=False)
    reports: list[str] = []
    feeder._troubles.listen(lambda report: reports.append(report.text))
    try:
        with faults:
            feeder.open()
            feeder.start()
            for number in range(3, 12):
                Sent.is_away[:] = [] if 5 <= number < 9 else [True]
                feeder.put(sample(number))
            feeder.stop()
    except OpenError:
        rule(Sent.taken == [], "a run that did not start has sent samples")
    else:
        rule(Sent.taken == sorted(set(Sent.taken)), f"samples came twice or out of order: {Sent.taken}")
        rule(set(range(3, 9)) <= set(Sent.taken), f"a fault of the disk has stopped the server: {Sent.taken}")
    taken = list(Sent.taken)
    again = Store(folder / "values.mqtt.db", 100)
    again.open()
    left = [sample.values[0].value for sample in again.first(100)[1]]
    again.close()
    end = 12 if feeder._has_started else 3
    missing = set(range(end)) - set(taken) - set(left)
    rule(left == sorted(set(left)), f"the store holds samples twice or out of order: {left}")
    rule(feeder.status.dropped == len(missing), f"{missing} are missing, {feeder.status.dropped} reported as lost")
    rule(faults.lasts or not missing, f"a fault that is over has cost {missing}")
    rule(not missing or any(text.startswith("store") for text in reports), "the fault of the store was not reported")


# ---- the state, captures, rolled files, the cache ----------------------------------------------------------------

SHAPE = (("M", "word", 4096),)


def kept(word: int) -> KeptRun:
    return KeptRun({"M": word.to_bytes(2, "little") * 4096}, {})


def word_of(path: Path) -> int:
    with closing(StateFile(path, "plant", SHAPE)) as file:
        areas = file.kept.areas
        words = {areas["M"][at : at + 2] for at in range(0, 8192, 2)} if areas else {b"\0\0"}
    rule(len(words) == 1, "the state is of two moments")
    return int.from_bytes(words.pop(), "little")


def state_scenario(is_new: bool) -> Scenario:
    def scenario(folder: Path, faults: Faults) -> None:
        path = folder / "plant.state"
        if not is_new:
            with closing(StateFile(path, "plant", SHAPE)) as file:
                file.save(kept(1))
        allowed = {0} if is_new else {1}
        with faults:
            try:
                file = StateFile(path, "plant", SHAPE)
            except StateError as error:
                rule("Traceback" not in str(error), "a refusal is a sentence")
            else:
                for word in (2, 3, 4):
                    try:
                        file.save(kept(word))
                        allowed = {word}
                    except StateError:
                        allowed.add(word)
                file.close()
        word = word_of(path)
        rule(word in allowed, f"the state is {word}, expected one of {allowed}")
        beside = [path.name for path in folder.iterdir() if path.name.startswith(".")]
        rule(len(beside) <= (4 if faults.lasts else 1), f"files are left: {beside}")

    return scenario


def capture_scenario(suffix: str) -> Scenario:
    def scenario(folder: Path, faults: Faults) -> None:
        path = folder / f"line{suffix}"
        events = [LineEvent("data", at, "in", bytes([at] * 20)) for at in range(1, 9)]
        with faults:
            try:
                capture = Capture(path, (1,), VirtualClock())
            except OSError:
                return
            for event in events:
                capture.write(1, event)
            capture.close()
        with CaptureReader(path) as reader:
            found = [event for _, event in reader.events()]
        count = len(found)
        rule(found == events[:count], f"{count} events were read, and they are not the first ones")
        rule(count == len(events) or bool(capture.problems), "events are missing, and it was not reported")
        lost = sum(trouble.lost for trouble in capture.troubles.present())
        rule(
            len(events) - count <= lost <= len(events) - count + 1, f"{count} events are there, {lost} reported as lost"
        )

    return scenario


def rolled(folder: Path, faults: Faults) -> None:
    """Replace a run file permanently, and replace it and roll it back."""
    path = folder / "plant.run.yaml"
    path.write_text("old")
    contents = {"old"}
    try:
        with faults:
            file = ReplacedFile(path)
            file.hold()
            try:
                file.put(b"new")
                contents = {"new"}
            except OSError:
                rule(path.read_text() == "old", "a refused file has changed the content")
            else:
                try:
                    file.keep()
                except OSError:
                    contents = {"new", "old"}
                try:
                    file.put(b"newer")
                    contents |= {"newer"}
                    file.put_back()
                    contents -= {"newer"}
                except OSError:
                    pass
            file.let_go()
    except OSError:
        pass
    rule(path.read_text() in contents | {"old", "new"}, f"the file holds {path.read_text()}")
    ReplacedFile(path).settle()
    rule(path.read_text() in {"old", "new"}, f"after the next start the file holds {path.read_text()}")


def kept_code(folder: Path, faults: Faults) -> None:
    os.chmod(folder, 0o700)
    keep(folder, "a", b"old" * 5000)
    with faults:
        keep(folder, "a", b"new" * 5000)
    rule(read_entry(folder, "a") in (b"old" * 5000, b"new" * 5000), "the cache holds something else")


SCENARIOS: dict[str, Scenario] = {
    "csv": files_scenario(lambda path: CsvFile(csv=path, at=NOWHERE), ".csv", True),
    "csv-rotate": files_scenario(lambda path: CsvFile(csv=path, rotate=130, keep=2, at=NOWHERE), ".csv", False),
    "jsonl": files_scenario(lambda path: JsonLines(jsonl=path, at=NOWHERE), ".jsonl", True),
    "sqlite": history,
    "parquet": parquet,
    "store": store,
    "state": state_scenario(is_new=False),
    "new-state": state_scenario(is_new=True),
    "capture-pcap": capture_scenario(".pcap"),
    "capture-jsonl": capture_scenario(".jsonl"),
    "rolled": rolled,
    "cache": kept_code,
}


def trials(scenario: Scenario, folder: Path) -> Iterator[dict[str, Any]]:
    """Make each call of a scenario fail, once and from then on: by each error in turn, with FRAMEKIT_WHOLE by all."""
    for shift in range(len(ERRORS) if "FRAMEKIT_WHOLE" in os.environ else 1):
        for lasts in (False, True):
            for number in range(1, MOST):
                error = ERRORS[(number + shift + lasts) % len(ERRORS)]
                shutil.rmtree(folder, ignore_errors=True)
                folder.mkdir()
                problem = ""
                try:
                    scenario(folder, Faults(folder, number, error, lasts))
                except BrokenRuleError as broken:
                    problem = str(broken)
                except Exception:
                    problem = traceback.format_exc()
                finally:
                    failed = library().faults_disarm()
                yield {"error": errno.errorcode[error], "lasts": lasts, "number": number, "problem": problem}
                if not failed:
                    break


if __name__ == "__main__":
    logging.disable()
    found = list(trials(SCENARIOS[sys.argv[1]], Path(sys.argv[2]) / "files"))
    print(json.dumps({"trials": len(found), "problems": [trial for trial in found if trial["problem"]]}))
