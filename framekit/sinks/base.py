"""The interface of sinks: their keys in a run file, and the object that takes values.

A kind is a class whose attributes, made by `key`, are its keys; the first names the kind and gives the destination of
the values. `make` returns the sink itself, which is used by one thread.
"""

from __future__ import annotations

import errno
import os
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from fnmatch import fnmatchcase
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar, NamedTuple
from typing import Protocol as Interface

from framekit.definition.keys import Form, KeyReading, key, kind_schema, ref
from framekit.definition.problems import Position, without_library
from framekit.definition.schema import add_kind_of
from framekit.definition.tree import Node
from framekit.memory.views import NumberView
from framekit.run.model import Point
from framekit.run.points import PointValue, scaled
from framekit.run.status import RunStatus
from framekit.sinks.opened_file import not_opened, refuse_special
from framekit.sinks.secrets import Secret
from framekit.transport.network import listening_at

if sys.platform != "win32":
    import fcntl


_INT64 = range(-(1 << 63), 1 << 63)
_UINT64 = range(1 << 64)


class Sampled(NamedTuple):
    """Values of one moment (ns since 1970, UTC): a changed value, or the values of all points."""

    time: int
    values: tuple[PointValue, ...]


def good_value(value: PointValue) -> Any:
    """Return the value; None if its quality is not good."""
    return value.value if value.quality == "good" else None


def as_record(time: str, value: PointValue, unit: str) -> dict[str, Any]:
    """Return a value for JSON: `time`, `point`, `value`, `unit` if any, `quality`, and the `reason` of a bad one."""
    data = {"time": time, "point": value.name, "value": good_value(value)}
    data |= {"unit": unit} if unit else {}
    return data | {"quality": value.quality, **({"reason": value.reason} if value.reason else {})}


def value_type(point: Point) -> str:
    """Return the type of a point's values: string, bool, int64, uint64, decimal128(38, 0) or double."""
    form = point.form
    if point.names or form.type == "string":
        return "string"
    if form.is_float or (point.scaling is not None and not point.scaling.is_whole):
        return "double"
    if point.scaling is None and form.bits == 1:
        return "bool"
    is_signed = isinstance(form.view, NumberView) and form.view.kind == "signed"
    ends = (-(1 << form.bits - 1), (1 << form.bits - 1) - 1) if is_signed else (0, (1 << form.bits) - 1)
    ends = (scaled(point, ends[0]), scaled(point, ends[1]))
    for name, numbers in (("int64", _INT64), ("uint64", _UINT64)):
        if all(end in numbers for end in ends):
            return name
    return "decimal128(38, 0)" if all(abs(end) < 10**38 for end in ends) else "string"


PERIOD = Form(ref("time"), lambda r, node: r.reader.time(node))
FILE = Form(ref("text"), lambda r, node: r.loader.file(node))
"""A file that it writes; a relative name counts from the folder of the run."""
READ_FILE = Form(ref("text"), lambda r, node: str(r.loader.folder / r.reader.text(node).strip()))
"""A file that it only reads."""


def read_listening(reading: KeyReading, node: Node) -> tuple[str, int]:
    """Read `PORT`, or `ADDRESS:PORT` (an IPv6 address in brackets). Raises Broken."""
    try:
        return listening_at(reading.reader.text(node).strip())
    except ValueError as error:
        todo = "write a port such as 9101, or ADDRESS:PORT such as 0.0.0.0:9101"
        raise reading.reader.broken(node.at, str(error), todo) from None


LISTENING = Form(ref("text"), read_listening)
"""A port to listen on, at 127.0.0.1 unless an address precedes it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SinkKind(ABC):
    """The keys of a sink in a run file.

    `points`: names of points, in which `*` stands for any text; `every`: period (ns) of values of all points, or None
    for each change.
    """

    word: ClassVar[str]
    is_local: ClassVar[bool] = False
    """Whether the sink writes files of this machine: a run does not start unless they can be opened and written."""
    points: tuple[str, ...] = key(
        "points", Form(ref("texts"), lambda r, node: r.loader.patterns(node)),
        "The points that go there, by name; * stands for any text. Default: all.", default=("*",),
    )  # fmt: skip
    every: int | None = key(
        "every",
        PERIOD,
        "All points so often, as they are then; default: each change of value or quality.",
        default=None,
    )  # fmt: skip
    at: Position

    @abstractmethod
    def make(self) -> Sink:
        """Return the sink, not opened yet."""

    @property
    def target(self) -> str:
        """Return the destination of the values for users: the value of the key that names the kind."""
        return str(getattr(self, self.word))

    @property
    def has_secret(self) -> bool:
        """Return whether it sends a secret to the other side."""
        return any(isinstance(getattr(self, one.name), Secret) for one in fields(self))

    @property
    def listens(self) -> tuple[str, int] | None:
        """Return the address and port on which it listens, or None."""
        return None

    def mistakes(self) -> Iterator[tuple[str, str, str]]:
        """Return the mistakes in the keys of the sink: key ('' for the whole sink), fault, remedy."""
        yield from ()

    def mistakes_with(self, points: Sequence[Point]) -> Iterator[tuple[str, str, str]]:
        """Return the mistakes of the sink in a run with these points, as `mistakes` does."""
        yield from ()


def as_glob(pattern: str) -> str:
    """Return a glob of which only `*` is special: `?` and `[` are escaped."""
    return pattern.replace("[", "[[]").replace("?", "[?]")


def fits(pattern: str, name: str) -> bool:
    """Return whether a name matches a pattern."""
    return fnmatchcase(name, as_glob(pattern))


class NeverTakenError(ValueError):
    """Raised if the first of the samples will never be accepted; the text gives the reason.

    The sample is dropped and counted.
    """


class Host(Interface):
    """The run, as a sink sees it; its methods may be called from any thread."""

    @property
    def run(self) -> str:
        """Return the name of the run."""

    def status(self) -> RunStatus:
        """Return the present state of channels, blocks and sinks. Raises TimeoutError while the run is busy or ends."""

    def values(self) -> Sequence[PointValue]:
        """Return the present values of all points. Raises TimeoutError."""

    def write(self, point: str, value: Any, who: str, answer: Callable[[str], None]) -> None:
        """Write a value, in the point's own scale; `who` names the sender and its origin, for the log.

        `answer` is called once, in another thread, with the reason of a refusal, or '' after the write.
        """

    def lost(self, problem: str) -> None:
        """Report that the sink has lost its server: it must be closed and opened again."""

    def now(self) -> int:
        """Return the time of the run's clock (ns), which never goes back."""

    def loses(self, samples: int, points: Mapping[str, int], why: str) -> None:
        """Report that accepted samples are lost, such as by another program that has cut the file; `points`: their
        number of values by point.
        """

    def report(self, what: str) -> None:
        """Report an event of the sink, such as an empty file where values should be, to the user."""


class Sink(ABC):
    """Takes values. An exception of a method is reported, does not affect the lines, and the call is repeated later."""

    def meet(self, host: Host) -> None:  # noqa: B027 – most sinks do not use the run
        """Receive the host, once, before all other calls."""

    @abstractmethod
    def open(self, points: Sequence[Point]) -> None:
        """Open the sink, and continue after the data of an earlier run. `points`: the points whose values follow."""

    @abstractmethod
    def write(self, samples: Sequence[Sampled]) -> int:
        """Write samples, oldest first, and return the number accepted: the others are passed again. If it raises, it
        has accepted none.

        Raises NeverTakenError for a first sample that will never be accepted, so that the following samples are.
        """

    @abstractmethod
    def close(self) -> None:
        """Close the sink, also after a failure."""


def open_alone(path: Path) -> int:
    """Open a file for appending by a single process; create it if it is missing. Return the file descriptor.

    Raises OSError, also while another process has the file open: two writers of one file would mix their lines. A
    missing folder is an error, too: it may be the place of a disk that is not mounted. Devices, pipes and sockets are
    refused.
    """
    refuse_special(path)
    try:
        file = os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT, 0o644)
    except OSError as error:
        raise not_opened(path, error) from None
    if sys.platform != "win32":
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(file)
            raise BlockingIOError(errno.EAGAIN, "another process writes there – end it, or name another file") from None
    return file


def not_installed(library: str, module: str) -> Iterator[tuple[str, str, str]]:
    """Return the mistake that a library of a kind is not installed, for `mistakes`; empty if it is installed."""
    try:
        is_installed = find_spec(module) is not None
    except ModuleNotFoundError:  # a parent package is missing
        is_installed = False
    if not is_installed:
        yield "", *without_library("this", library)


SINKS: dict[str, type[SinkKind]] = {}
"""The kinds of sinks by the key that names them."""


def add_sink(word: str, kind: type[SinkKind]) -> None:
    """Register a kind of sink of a program.

    Raises ValueError for a word that has a meaning in a sink already, and for an invalid schema.
    """
    add_kind_of("run", "sink", word, schema_of(kind), kind.__module__)
    SINKS[word] = kind


def schema_of(kind: type[SinkKind]) -> dict[str, Any]:
    """Return the schema of a sink of this kind."""
    return kind_schema(kind, f"{kind.word} sink")
