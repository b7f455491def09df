"""Captures as tables: an archive of their frames, and the values in devices.

An archive is a folder of many captures decoded side by side, each to a Parquet file of one table, as pandas, DuckDB,
Polars and Spark read it. It gets its name when it is complete. Each capture is decoded separately, by the processes of
this machine or by the workers of a cluster, with the same rows.

The values are a table like that of the sink csv, which a simulated device can replay.
"""

from __future__ import annotations

import csv
import json
import os
import shutil
import signal
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from framekit.api.errors import RequestError
from framekit.api.monitor import FrameFilter, decoder, result_of
from framekit.codec.codec import compile_protocol
from framekit.codec.contents import Requests, contents_of
from framekit.definition.load.protocol import load_protocol
from framekit.definition.model.protocol import Protocol
from framekit.definition.problems import DefinitionError, library_missing
from framekit.definition.times import LineFormat
from framekit.extras.archive.overheard import KnownValue, Overheard
from framekit.link.events import Seen
from framekit.link.frame_table import table_of
from framekit.link.scope import Scope
from framekit.link.values import CODEC_ERRORS, Names
from framekit.run.points import iso_time
from framekit.runfile.devices import load_devices

if TYPE_CHECKING:
    import pyarrow as pa

ROWS_AT_ONCE = 50_000
"""Largest number of rows of a capture in memory at once."""

CLUSTER = "dask://"
LONGEST_CONNECT = 10.0
"""Time limit for the answer of a cluster (s)."""


@dataclass(frozen=True, slots=True)
class CaptureWork:
    """A capture to be decoded, in the form sent to another process: `protocol` by name or file, `target` its Parquet
    file.
    """

    protocol: str
    folder: str
    capture: str
    target: str
    params: Mapping[str, Any]
    line: LineFormat | None
    client: Literal["in", "out"]
    wanted: FrameFilter


@dataclass(frozen=True, slots=True)
class Decoded:
    """Result of decoding a capture."""

    capture: str
    rows: int = 0
    counts: Mapping[str, int] = field(default_factory=dict)
    """Numbers of `frame`, `bad`, `noise`."""
    is_cut: bool = False
    """Whether the last record of the capture is incomplete."""
    problem: str = ""
    """Reason why the capture was not read to its end; '' if it was."""


def archive(
    captures: Sequence[Path],
    protocol: str,
    target: Path,
    *,
    params: Mapping[str, Any] | None = None,
    line: LineFormat | None = None,
    client: Literal["in", "out"] = "out",
    wanted: FrameFilter | None = None,
    jobs: int | None = None,
    engine: str = "",
) -> Generator[Decoded, None, None]:
    """Decode captures with a protocol (name or file) to the folder `target`; yield the result of each when it is
    finished.

    `jobs`: number of processes; default: one for each core. `engine`: `dask://HOST:PORT`, a cluster whose workers see
    the same files. After the last result, `target` has the rows of all readable captures, including incomplete ones.
    Raises RequestError if decoding cannot begin, OSError for files.
    """
    _ready(captures, target)
    part = target.with_name(f"{target.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    try:
        here, whole = str(Path.cwd()), part.absolute()
        targets = [str(whole / f"{number:05}-{path.stem}.parquet") for number, path in enumerate(captures, 1)]
        works = [
            CaptureWork(protocol, here, str(path.absolute()), its, params or {}, line, client, wanted or FrameFilter())
            for path, its in zip(captures, targets, strict=True)
        ]
        jobs = min(jobs or os.cpu_count() or 1, len(works))
        with _cluster(engine) if engine else _processes(jobs) if jobs > 1 else nullcontext(_here) as results:
            yield from results(works)
        part.rename(target)
    finally:
        shutil.rmtree(part, ignore_errors=True)


def _ready(captures: Sequence[Path], target: Path) -> None:
    if not captures:
        raise RequestError("there is no such capture – check its name and folder")
    if target.exists():
        raise RequestError(f"{target} is there already – remove it, or name another")
    try:
        import pyarrow as pa  # noqa: F401 – fails if it is not installed
    except ImportError:
        raise RequestError(library_missing("an archive", "pyarrow")) from None


Results = Callable[[Sequence[CaptureWork]], Iterator[Decoded]]


def _here(works: Sequence[CaptureWork]) -> Iterator[Decoded]:
    """Decode in this process."""
    return map(decode_to, works)


@contextmanager
def _processes(jobs: int) -> Iterator[Results]:
    """Provide decoding in processes of this machine, which start afresh: threads of this process may hold locks."""
    with ProcessPoolExecutor(jobs, get_context("spawn"), signal.signal, (signal.SIGINT, signal.SIG_DFL)) as pool:

        def results(works: Sequence[CaptureWork]) -> Iterator[Decoded]:
            try:
                for future in as_completed([pool.submit(decode_to, work) for work in works]):
                    yield future.result()
            except BrokenProcessPool:
                raise RequestError("a process that decoded was ended from outside – try fewer with --jobs") from None

        try:
            yield results
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def _cluster(engine: str) -> Iterator[Results]:
    """Provide decoding by the workers of a dask cluster. Raises RequestError."""
    place = engine.removeprefix(CLUSTER)
    if not engine.startswith(CLUSTER) or not place:
        raise RequestError(f"'{engine}' is no engine – write dask://HOST:PORT")
    try:
        distributed: Any = import_module("distributed")
    except ImportError:
        raise RequestError(library_missing(engine, "distributed")) from None
    try:
        client = distributed.Client(f"tcp://{place}", timeout=LONGEST_CONNECT, set_as_default=False)
    except (OSError, ValueError) as error:
        raise RequestError(f"{engine} does not answer: {error}") from None
    with client, client.as_current():

        def results(works: Sequence[CaptureWork]) -> Iterator[Decoded]:
            for future in distributed.as_completed(client.map(decode_to, works, pure=False)):
                yield future.result()

        yield results


# ---- one capture ------------------------------------------------------------------------------------------------


def decode_to(work: CaptureWork) -> Decoded:
    """Decode a capture to its Parquet file, in any process. Raises OSError for the file that it writes."""
    from pyarrow import parquet

    counts: Counter[str] = Counter()
    rows, is_cut, problem = 0, False, ""
    with parquet.ParquetWriter(work.target, _schema(), compression="zstd") as writer:
        try:
            protocol = load_protocol(work.protocol, Path(work.folder))
            found = decoder(Path(work.capture), protocol, line=work.line, params=work.params, client=work.client)
            table = _Rows(protocol, Path(work.capture).name)
            try:
                for channel, seen in found.seen():
                    if seen.kind != "noise" or not seen.reason:  # noise left by a bad frame is part of that frame
                        counts[seen.kind] += 1
                    if work.wanted.takes(channel, seen):
                        table.add(channel, seen)
                        if table.count == ROWS_AT_ONCE:
                            rows += table.count
                            writer.write_batch(table.taken())
            finally:
                rows += table.count
                writer.write_batch(table.taken())
            is_cut = found.is_cut
        except (ValueError, OSError) as error:
            problem = str(error)
    return Decoded(work.capture, rows, dict(counts), is_cut, problem)


_AS_JSON = json.JSONEncoder(ensure_ascii=False).encode

COLUMNS = {
    "capture": "names", "time": "time", "channel": "number", "direction": "names", "event": "names", "frame": "names",
    "result": "names", "size": "number", "bytes": "bytes", "fields": "text", "reason": "text", "segment": "text",
    "offset": "number",
}  # fmt: skip
"""Columns of an archive.

`fields` is an object of JSON; `offset` and `segment` give the place of the fault of a bad frame.
"""


def _schema() -> pa.Schema:
    import pyarrow as pa

    types = {
        "names": pa.dictionary(pa.int32(), pa.string()), "time": pa.timestamp("ns", "UTC"), "number": pa.int32(),
        "bytes": pa.binary(), "text": pa.string(),
    }  # fmt: skip
    return pa.schema([(name, types[kind]) for name, kind in COLUMNS.items()])


class _Rows:
    """Rows that wait to be written."""

    def __init__(self, protocol: Protocol, capture: str) -> None:
        self._protocol, self._contents, self._requests = protocol, contents_of(protocol), Requests()
        self._capture = capture
        self._rows: list[tuple[Any, ...]] = []

    @property
    def count(self) -> int:
        return len(self._rows)

    def add(self, channel: int, seen: Seen) -> None:
        """Add an event."""
        self._requests.attach(self._contents, seen, channel)
        fields = self._contents.to_plain(seen.frame, seen.fields, seen.request)
        is_bad = seen.kind == "bad"
        self._rows.append(
            (
                self._capture, seen.at, channel, seen.direction, seen.kind, seen.frame or None,
                result_of(self._protocol, seen) or None, len(seen.raw), seen.raw, _AS_JSON(fields) if fields else None,
                seen.reason or None, (seen.segment or None) if is_bad else None, seen.place if is_bad else None,
            )
        )  # fmt: skip

    def taken(self) -> pa.RecordBatch:
        """Return the rows as a batch of columns, and remove them."""
        import pyarrow as pa

        schema = _schema()
        columns = list(zip(*self._rows, strict=True)) or [()] * len(schema)
        self._rows = []
        return pa.record_batch(
            [pa.array(column, one.type) for column, one in zip(columns, schema, strict=True)], schema=schema
        )


# ---- values in devices ----------------------------------------------------------------------------------------


HEAD = ("time", "point", "value", "unit", "quality", "reason")
"""Columns of the table of values, equal to those of the sink csv."""


class CapturedValue(NamedTuple):
    """A value that was read or written: its time (ns since 1970), and its point, `STATION/ADDRESS` or `ADDRESS`."""

    time: int
    point: str
    value: Any


def captured_values(
    found: Iterable[tuple[int, Seen]], protocol: Protocol, name: str, params: Mapping[str, Any]
) -> Iterator[CapturedValue]:
    """Yield the values in the frames of channels: each when first seen, and at every change. `name`: name or file of
    the protocol.

    Raises RequestError for a protocol without requests for places, and CaptureError (a ValueError).
    """
    codec = compile_protocol(protocol)
    table, scope = table_of(protocol, codec), Scope(protocol, params=params)
    try:
        memory = load_devices(name, Path.cwd())[0].create_memory()
    except DefinitionError as error:
        raise RequestError(f"the values of '{name}' have no place: {error.problems[0]}") from None

    def line_of(channel: int) -> Overheard:
        if channel not in lines:
            lines[channel] = Overheard(protocol, codec, memory, Names({}, scope))
        return lines[channel]

    lines: dict[int, Overheard] = {}
    known: dict[tuple[int, str], Any] = {}
    if line_of(1).hears_nothing:
        raise RequestError(f"no frame of '{protocol.name}' asks for places of memory")
    for channel, seen in found:
        if seen.kind != "frame":
            continue
        try:
            frame = table.received(seen.frame, seen.fields, seen.raw, None)
        except CODEC_ERRORS:
            continue
        for one in line_of(channel).hear(frame):
            point = point_of(one)
            if (channel, point) not in known or known[channel, point] != one.value:
                known[channel, point] = one.value
                yield CapturedValue(seen.at, point, one.value)


def point_of(one: KnownValue) -> str:
    """Return the name of an element as a point."""
    return one.address if one.station is None else f"{one.station}/{one.address}"


def write_values(values: Iterator[CapturedValue], target: Path) -> tuple[int, int]:
    """Write a table of comma-separated values; return the numbers of values and of points. Raises OSError."""
    points: set[str] = set()
    count = 0
    with target.open("w", encoding="utf-8", newline="") as stream:
        rows = csv.writer(stream, lineterminator="\n")
        rows.writerow(HEAD)
        for one in values:
            rows.writerow((iso_time(one.time), one.point, one.value, "", "good", ""))
            points.add(one.point)
            count += 1
    return count, len(points)
