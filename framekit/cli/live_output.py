"""Standard output and standard error of verbs that keep a line alive: a reader that does not read stops no exchange.

While the context `live_output` lasts, `print` puts whole lines into a queue for each stream, and a thread writes them.
While `LiveOutput.may_drop` lasts, the queue is bounded: when it is full, whole lines are dropped and counted, and the
loss is reported as a trouble, and by a line in the output once it is read again. Outside of it every line is kept. At
the end the context waits until all lines are written; lines that cannot be written then are counted and reported.
"""

from __future__ import annotations

import codecs
import io
import os
import select
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import TYPE_CHECKING, Any, Protocol, TextIO

from framekit.api.write_queue import WriteQueue
from framekit.cli.common import (
    OUTPUT,
    OUTPUT_HELP,
    VerbError,
    json_line,
    on_signal,
    on_stop,
    print_trouble,
    until_stopped,
)
from framekit.cli.terminal import GuardedTerminal, harmless, unguarded
from framekit.definition.problems import error_text, plural

if TYPE_CHECKING:
    from framekit.api.trouble import SampleCount, Troubles, TroubleSource

MOST_WAITING = 4 << 20
"""Number of waiting bytes at which a queue is full; it takes lines again when half of them are written. An unfinished
line with more characters is queued in parts.
"""
AT_ONCE = 1 << 16
"""Largest number of bytes of one write."""
RETRY = 1.0
"""Seconds between two attempts to write to a stream that fails, such as a file on a full disk."""

ERASE = "\r\x1b[{}A\x1b[J"
NO_WRAP, WRAP = "\x1b[?7l", "\x1b[?7h"
"""Control characters of a terminal: delete the last lines; cut long lines off, or continue them in the next line."""

ERRORS = "standard error"
UNREAD = "its reader does not read"
GONE = "its reader has gone"
"""Name of the second stream; reasons of the trouble of a stream."""


class MakeSource(Protocol):
    """Registers a part of a run, as `Troubles.source` does."""

    def __call__(
        self, name: str, effect: Callable[[], str], count: Callable[[], SampleCount], unit: str
    ) -> TroubleSource: ...


class QueuedStream:
    """A standard stream whose lines are written by a thread. Any thread may write, and never waits.

    `loss_line` returns the line that replaces dropped lines, from their number and the reason. `on_gone` is called in
    the writer thread when the reader has closed its end; without it that is a trouble. Everything except writing is
    left to the stream itself.
    """

    def __init__(
        self, stream: TextIO, name: str, loss_line: Callable[[int, str], str], on_gone: Callable[[], object] | None
    ) -> None:
        self.stream = stream
        self.name = name
        self.gone = False
        """Whether the reader has closed its end; then lines are discarded."""
        self.error = ""
        """Reason of the last failed write; empty after a successful one."""
        self.unwritten = 0
        """Lines that waited at the end and could not be written."""
        self.is_stuck = False
        """Whether the end has not waited for the reader any longer: a write to the stream would block."""
        self.help = "read it"
        """Advice for the user when the queue is full."""
        self._loss_line, self._on_gone = loss_line, on_gone
        self._encoded, self._write = _functions_of(stream)
        self._encoding: str = getattr(unguarded(stream), "encoding", None) or "utf-8"
        self._queue = WriteQueue(self._write_lines, None, f"writes {name}", self._has_ended)
        self._begun: dict[int, io.StringIO] = {}
        """The begin of an unfinished line, by the thread that writes it."""
        self._waiting_lines = 0
        """Lines that are not written yet."""
        self._lost = self._dropped = 0
        """Lines lost since the start, and since the queue became full."""
        self._is_full = False
        """Whether lines are dropped: from a full queue on, until half of it is written."""
        self._source: TroubleSource | None = None
        """The trouble while lines may be dropped."""
        self._drawn = 0
        """Lines of the drawing that ends the output."""

    # ---- for those who print ------------------------------------------------------------------------------

    def write(self, text: str) -> int:
        """Queue the whole lines of a text, and keep the begin of an unfinished line; return the length of the text."""
        thread = threading.get_ident()
        lines, first_dropped = "", None
        with self._queue.change:
            if not (is_over := self._queue.is_closed):
                lines, newline, rest = text.rpartition("\n")
                lines += newline
                if lines and (begun := self._begun.pop(thread, None)) is not None:
                    lines = begun.getvalue() + lines
                if rest:
                    begun = self._begun.setdefault(thread, io.StringIO())
                    begun.write(rest)
                    if begun.tell() > MOST_WAITING:
                        lines += self._begun.pop(thread).getvalue()
                if lines:
                    first_dropped = self._take(lines)
        if is_over:
            self.stream.write(text)
        elif first_dropped is not None:
            self._is_unread(first_dropped)
            with self._queue.change:
                self._lost += lines.count("\n")  # the trouble has begun before its first loss
        return len(text)

    def writelines(self, lines: Any) -> None:
        """Write several texts."""
        for line in lines:
            self.write(line)

    def flush(self) -> None:
        """Flush the stream after the end; before it every line is written as soon as possible."""
        if self._queue.is_closed:
            self.stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)

    def draw(self, lines: list[str]) -> None:
        """Show harmless lines at the end of a terminal, in place of those that were drawn before.

        Printed lines erase the drawing. While lines wait to be written, nothing is drawn.
        """
        with self._queue.change:
            if not (self._queue.waiting or self._queue.is_closed or self.gone or self._is_full):
                text = "".join(f"{line}\r\n" for line in lines)
                self._put(f"{NO_WRAP}{text}{WRAP}".encode(self._encoding, "backslashreplace"))
                self._drawn = len(lines)

    def _take(self, lines: str) -> TroubleSource | None:
        """Queue or drop lines; return the trouble if they are the first to be dropped."""
        number = lines.count("\n")
        if self.gone:
            return None
        if self._is_full:
            self._lost += number
            self._dropped += number
        elif self._queue.is_full:
            self._is_full, self._dropped = True, number
            return self._source
        else:
            self._put(self._encoded(lines))
        return None

    def _put(self, data: bytes) -> None:
        if self._drawn:
            data = ERASE.format(self._drawn).encode() + data
            self._drawn = 0
        if not self._queue.has_begun:
            self.stream.flush()
        if self._queue.add(data):
            self._waiting_lines += data.count(b"\n")

    # ---- trouble ------------------------------------------------------------------------------------------

    @contextmanager
    def may_drop(self, make: MakeSource) -> Iterator[None]:
        """Drop lines for which the queue has no room, while the context lasts; `make` registers the trouble."""
        from framekit.api.trouble import SampleCount

        before = self._lost
        source = make(
            self.name, self._effect, lambda: SampleCount(waiting=self._waiting_lines, lost=self._lost - before), "line"
        )
        with self._queue.change:
            self._source, self._queue.most = source, MOST_WAITING
        try:
            if reason := GONE if self.gone else self.error:
                source.begins(reason)
            yield
        finally:
            with self._queue.change:
                self._source = self._queue.most = None
                self._end_loss()

    def _effect(self) -> str:
        if self._is_full:
            return f"lines are lost until it is read: {self.help}"
        return "" if self.gone else "lines wait"

    def _is_unread(self, source: TroubleSource) -> None:
        """Report that the queue is full."""
        if source.reason:
            source.loses(f"{self._waiting_lines:,} lines wait, from now on lines are lost")
        else:
            source.begins(UNREAD)

    def _end_loss(self) -> None:
        """Queue the line that replaces the dropped lines, and take lines again."""
        if self._is_full:
            self._is_full = False
            self._put(self._encoded(self._loss_line(self._dropped, self.error or UNREAD)))

    # ---- the writer thread --------------------------------------------------------------------------------

    def _write_lines(self, lines: bytes, number: int) -> None:
        """Write lines, after failures again and again; give up if it fails at the end."""
        data = memoryview(lines)
        while data:
            try:
                size = self._write(data[:AT_ONCE])
            except BrokenPipeError:
                self._has_gone()
                return
            except ValueError:
                if not self.stream.closed:
                    raise
                self._has_gone()
                return
            except OSError as error:
                if not self._has_failed(error_text(error)):
                    return
            else:
                self._has_written(data[:size])
                data = data[size:]

    def _has_written(self, data: memoryview) -> None:
        """Count written bytes, and end the trouble if the queue has room again."""
        with self._queue.change:
            if not self.unwritten:
                self.error = ""
            self._queue.has_written(len(data))
            self._waiting_lines -= bytes(data).count(b"\n")
            if self._is_full and self._queue.waiting <= MOST_WAITING // 2:
                self._end_loss()
            source = None if self._is_full else self._source
        if source is not None and source.reason:
            source.ends()

    def _has_failed(self, reason: str) -> bool:
        """Report a failed write, and pause; at the end drop everything and return False."""
        with self._queue.change:
            self.error = reason
            source = self._source
            if self._queue.is_ending:
                self._lost += self._waiting_lines
                self.unwritten += max(1, self._waiting_lines)  # an unfinished line counts
                self._forget()
                return False
        if source is not None:
            source.begins(reason)
        self._queue.pause(RETRY)
        return True

    def _has_ended(self, error: BaseException, number: int) -> None:
        """Count what waits as unwritten: an unexpected error has ended the thread."""
        with self._queue.change:
            self.error = error_text(error)
            self.unwritten += max(1, self._waiting_lines)  # an unfinished line counts
            self._waiting_lines = 0

    def _has_gone(self) -> None:
        """Discard everything, and report that the reader has gone."""
        with self._queue.change:
            self.gone, self._is_full, source = True, False, self._source
            self._forget()
        if self._on_gone is not None:
            self._on_gone()
        elif source is not None:
            source.begins(GONE)

    def _forget(self) -> None:
        """Discard everything that waits."""
        self._waiting_lines = 0
        self._queue.discard()

    def close(self, is_stopped: Callable[[], bool] = lambda: False) -> None:
        """Wait until all lines are written, or cannot be written; later texts go to the stream itself.

        If `is_stopped`, give up when the reader does not read; the waiting lines count as unwritten.
        """
        with self._queue.change:
            if not self.gone:
                for begun in self._begun.values():
                    self._put(self._encoded(begun.getvalue()))
            self._begun.clear()
            if not self._queue.close(is_stopped):
                self.is_stuck, self.error = True, UNREAD
                self.unwritten += max(1, self._waiting_lines)
                self._waiting_lines = 0


def _functions_of(stream: TextIO) -> tuple[Callable[[str], bytes], Callable[[memoryview], int]]:
    """Return the functions that encode a text for a stream and write it.

    The bytes of a stream with a file go to it directly: a thread that waits there holds no lock of the stream, which
    the end of the program would need.
    """
    shown = harmless if isinstance(stream, GuardedTerminal) else str
    text: TextIO = unguarded(stream)
    encoding = getattr(text, "encoding", None) or "utf-8"
    buffer = getattr(text, "buffer", None)
    raw = getattr(buffer, "raw", buffer)

    def encoded(lines: str) -> bytes:
        return shown(lines).encode(encoding, "backslashreplace")

    if sys.platform == "win32" or not isinstance(text, io.TextIOWrapper) or not isinstance(raw, io.RawIOBase):
        decoder = codecs.getincrementaldecoder(encoding)()  # the data may end inside a character

        def write_text(data: memoryview) -> int:
            before = decoder.getstate()
            try:
                text.write(decoder.decode(bytes(data)))
                text.flush()
            except OSError:  # the same data come again
                decoder.setstate(before)
                raise
            return len(data)

        return encoded, write_text

    def write(data: memoryview) -> int:
        number = raw.write(data)
        if number is None:  # another program has made the stream non-blocking
            select.select([], [raw], [], RETRY)
        return number or 0

    return encoded, write


class LiveOutput:
    """Both streams of a verb at work; a single queue for both if they lead to the same terminal, pipe or file.

    `goes_on`: the work that goes on when the reader of standard output has gone, such as `the run`; without it the
    verb ends.
    """

    def __init__(self, as_json: bool, has_quiet: bool, goes_on: str = "") -> None:
        self._goes_on = goes_on
        self.is_stopped = False
        """Whether a signal has asked the verb to stop."""
        loss_line = _loss_data if as_json else _loss_text
        self.output = self.errors = QueuedStream(sys.stdout, OUTPUT, loss_line, self._has_gone)
        if not _is_same(sys.stdout, sys.stderr):
            self.errors = QueuedStream(sys.stderr, ERRORS, _loss_text, None)
        self.streams = list(dict.fromkeys((self.output, self.errors)))
        if has_quiet:
            self.output.help = "read it, or start with --quiet"
        self.status = 0
        """Exit status of the verb."""
        self._lock = threading.Lock()
        self._stops: list[Callable[[], object]] = []
        self._troubles: Troubles | None = None

    @property
    def gone(self) -> bool:
        """Return whether the reader of standard output has gone."""
        return self.output.gone

    def on_stop(self, stop: Callable[[], object], *, at_hangup: bool = True) -> None:
        """Make the running loop call `stop` at each signal that asks the verb to stop.

        `at_hangup`: also at SIGHUP, unless the verb was started with SIGHUP ignored (nohup).
        """

        def has_stopped() -> None:
            self.is_stopped = True
            stop()

        on_stop(has_stopped)
        hangup = getattr(signal, "SIGHUP", None)
        if at_hangup and hangup is not None and signal.getsignal(hangup) != signal.SIG_IGN:
            on_signal("SIGHUP", has_stopped)

    @contextmanager
    def until_stopped(self) -> Iterator[None]:
        """End work without a loop at each signal that asks the verb to stop, without an error."""
        with until_stopped():
            try:
                yield
            except KeyboardInterrupt:
                self.is_stopped = True
                raise

    def on_gone(self, stop: Callable[[], object]) -> None:
        """Call `stop` when the reader of standard output has gone, in the writer thread."""
        with self._lock:
            self._stops.append(stop)
        if self.gone:
            stop()

    def stops(self, stop: Callable[[], object]) -> None:
        """Make the running loop call `stop` when the reader of standard output has gone."""
        import asyncio

        loop = asyncio.get_running_loop()

        def has_gone() -> None:
            with suppress(RuntimeError):  # the loop is closed
                loop.call_soon_threadsafe(stop)

        self.on_gone(has_gone)

    def _has_gone(self) -> None:
        if self._goes_on:
            self.errors.write(f"{OUTPUT}: {GONE} – {self._goes_on} goes on without it\n")
            return
        with self._lock:
            stops = list(self._stops)
        for stop in stops:
            stop()

    @contextmanager
    def may_drop(self, make: MakeSource | None = None) -> Iterator[None]:
        """Drop lines for which a queue has no room while the context lasts.

        `make` registers the troubles of the streams with a run; without it they are printed on standard error.
        """
        if make is None:
            from framekit.api.trouble import Troubles

            self._troubles = Troubles(time.monotonic_ns)
            self._troubles.listen(print_trouble)
            make = self._troubles.source
        with ExitStack() as stack:
            for stream in self.streams:
                stack.enter_context(stream.may_drop(make))
            yield

    def report_losses(self, status: int) -> int:
        """Print the losses since `may_drop` that belong to no run on standard error.

        Return the exit status of the verb: `status`, or 1 instead of 0 if there are losses.
        """
        lost = [] if self._troubles is None else [one for one in self._troubles.present() if one.lost]
        for trouble in lost:
            print(trouble, file=sys.stderr)
        self.status = status or (1 if lost else 0)
        return self.status

    def check(self) -> None:
        """Raise BrokenPipeError if the reader of standard output has gone, and the verb ends then."""
        if self.gone and not self._goes_on:
            raise BrokenPipeError


def _loss_text(number: int, reason: str) -> str:
    return f"({plural(number, 'line')} {'was' if number == 1 else 'were'} lost here: {reason})\n"


def _loss_data(number: int, reason: str) -> str:
    return f"{json_line({'event': 'lost_lines', 'count': number, 'reason': reason})}\n"


def _is_same(output: Any, errors: Any) -> bool:
    """Return whether both streams lead to the same terminal, pipe or file."""
    if unguarded(output) is unguarded(errors):
        return True
    try:
        return os.path.sameopenfile(output.fileno(), errors.fileno())
    except (OSError, ValueError, AttributeError):  # a stream without a file
        return False


class _UnwrittenError(VerbError):
    """Raised if lines could not be written at the end. An exit status that the verb has reported stays."""

    def __init__(self, message: str, status: int) -> None:
        super().__init__(message)
        self.status = status or VerbError.status


@contextmanager
def live_output(as_json: bool, *, has_quiet: bool = False, goes_on: str = "") -> Iterator[LiveOutput]:
    """Queue printed lines while the context lasts; wait at its end until all of them are written.

    Raise BrokenPipeError if the reader of standard output has gone, VerbError if lines of a stream could not be
    written. `as_json`: whether the lines of standard output are JSON objects. `has_quiet`: whether the verb has the
    option `--quiet`. `goes_on`: the work that goes on when the reader of standard output has gone, such as `the run`;
    without it the verb ends.
    """
    before = sys.stdout, sys.stderr
    live = LiveOutput(as_json, has_quiet, goes_on)
    streams: tuple[Any, Any] = live.output, live.errors
    sys.stdout, sys.stderr = streams
    try:
        yield live
    finally:
        try:
            for stream in live.streams:
                stream.close(lambda: live.is_stopped)
        finally:
            sys.stdout, sys.stderr = before
    live.check()
    if failed := [one for one in live.streams if one.unwritten]:
        messages = [f"{one.name}: {one.error}, {_last(one.unwritten)} lost – {_remedy(one)}" for one in failed]
        if live.errors.is_stuck:  # the message cannot be written either
            raise SystemExit(live.status or VerbError.status)
        raise _UnwrittenError("; ".join(messages), live.status)


def _remedy(stream: QueuedStream) -> str:
    return "read it, or send the output to another place" if stream.is_stuck else OUTPUT_HELP


def _last(number: int) -> str:
    return "the last line was" if number == 1 else f"the last {plural(number, 'line')} were"
