"""The state of a run over its end: memory and counters in a file, written periodically and read at the start."""

from __future__ import annotations

import os
import secrets
import sqlite3
import stat
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import astuple, dataclass, field, fields
from pathlib import Path

from framekit.definition.fingerprint import fingerprint
from framekit.definition.problems import error_text
from framekit.definition.times import NEVER
from framekit.memory.memory import DeviceMemory, Shape, unit_bits
from framekit.run.block_state import BlockState, Failure
from framekit.run.file_places import obstacle, why_not_opened
from framekit.run.trouble import Troubles, remedy_of
from framekit.sinks.database import bound_log, close_moved, transaction, write_once
from framekit.sinks.opened_file import MOVED, OpenedFile
from framekit.transport.clock import Clock

APPLICATION = 0x464B5354
"""The application id in the SQLite header; it identifies state files of framekit."""

VERSION = 1
PAGE = 1024
"""Bytes of an area that are written together."""

Key = tuple[int, int]
"""Set and number of a block."""

_TABLES = f"""
BEGIN;
PRAGMA application_id = {APPLICATION};
PRAGMA user_version = {VERSION};
CREATE TABLE about (name TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE areas (name TEXT PRIMARY KEY, unit TEXT NOT NULL, size INTEGER NOT NULL) WITHOUT ROWID;
CREATE TABLE pages (area TEXT, number INTEGER, content BLOB NOT NULL, PRIMARY KEY (area, number)) WITHOUT ROWID;
CREATE TABLE blocks (
    "set" INTEGER, number INTEGER, content TEXT NOT NULL, started INTEGER NOT NULL, done INTEGER NOT NULL,
    failed INTEGER NOT NULL, overruns INTEGER NOT NULL, outcome TEXT NOT NULL, cause TEXT NOT NULL,
    device_code INTEGER, meaning TEXT NOT NULL, PRIMARY KEY ("set", number)) WITHOUT ROWID;
COMMIT;
"""


class StateError(ValueError):
    """Raised for a state file that cannot be used or written; the text has the reason and the remedy."""


@dataclass(frozen=True, slots=True)
class KeptBlock:
    """Counters of a block and its last failure, as the table has them; `content` is the block's fingerprint."""

    set: int
    number: int
    content: str
    started: int
    done: int
    failed: int
    overruns: int
    outcome: str = ""
    cause: str = ""
    device_code: int | None = None
    meaning: str = ""


_COLUMNS = ", ".join(f'"{column.name}"' for column in fields(KeptBlock))


@dataclass(frozen=True, slots=True)
class KeptRun:
    """The content of a state file: the bytes of areas, and blocks."""

    areas: Mapping[str, bytes] = field(default_factory=dict)
    blocks: Mapping[Key, KeptBlock] = field(default_factory=dict)


class StateFile:
    """The state of the run `run`, whose kept areas have this `shape`.

    Opening creates the file if it is missing, locks it and reads it: `kept` has all its blocks, and the areas that
    `shape` names. Every method raises StateError.
    """

    def __init__(self, path: Path, run: str, shape: Shape) -> None:
        self.path = path
        self.run = run
        self.shape = shape
        self.was_empty = False
        """Whether the file existed without content: a loss of power may have emptied it."""
        self._written: dict[str, bytes] = {}
        self._opened: OpenedFile | None = None
        """The open file at the path; None while the file at the path could not be opened."""
        self._is_other = False
        """Whether the open file has come to the path during the run: the next write replaces its whole content."""
        self.kept = self._opened_at_path()

    def _opened_at_path(self) -> KeptRun:
        """Open the file at the path, or create it; return its content."""
        path = self.path
        with self._errors():
            real = Path(os.path.realpath(path))
            if found := obstacle(path):
                raise self._not_opened(found)
            if not os.path.lexists(real):
                self._create(real)
            elif not stat.S_ISREG(real.stat().st_mode):
                raise StateError(f"{path} is no plain file – name another file")
            elif real.stat().st_size == 0:
                self.was_empty = True
                self._create(real)
            self._check_head()
            self._base = sqlite3.connect(real, isolation_level=None, check_same_thread=False, timeout=0)
        try:
            with self._errors():
                self._open()
                kept = self._load()
                write_once(self._base, "user_version", VERSION)
                self._opened = OpenedFile(path)
        except StateError:
            self._base.close()
            raise
        return kept

    def follow_path(self) -> str:
        """Open the file at the path if it is another file than the open one, to write the whole state there.

        Return the change as a message, or ''.
        """
        change = self.change
        if change:
            self.close()
            self._opened = None
            self._opened_at_path()
            self._is_other = True
        return change

    @property
    def change(self) -> str:
        """Return how another program has changed the path, as a message, or ''."""
        return MOVED if self._opened is None else self._opened.change()

    def close(self) -> None:
        """Close the file, which keeps the last written state."""
        if self.change:
            close_moved(self._base, Path(os.path.realpath(self.path)))
        else:
            self._base.close()

    # ---- opening ------------------------------------------------------------------------------------------

    def _create(self, place: Path) -> None:
        """Write the file under another name and rename it, so that it appears complete.

        `place` has all symbolic links resolved, so that a link remains a link.
        """
        beside = place.with_name(f".{place.name}.{secrets.token_hex(4)}")
        try:
            try:
                os.close(os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644))  # SQLite would give no reason
            except OSError as error:
                raise self._not_opened(why_not_opened(place, error)) from None
            with closing(sqlite3.connect(beside, isolation_level=None)) as base:
                base.executescript(_TABLES)
                base.execute("INSERT INTO about VALUES ('run', ?)", (self.run,))
                bound_log(base)
            os.replace(beside, place)
        finally:
            for name in (beside, Path(f"{beside}-wal"), Path(f"{beside}-shm"), Path(f"{beside}-journal")):
                name.unlink(missing_ok=True)

    def _check_head(self) -> None:
        """Check the first bytes: SQLite itself would report a file of another kind as damaged."""
        with self.path.open("rb") as file:
            head = file.read(100)
        if not head.startswith(b"SQLite format 3\0") or head[68:72] != APPLICATION.to_bytes(4, "big"):
            raise StateError(f"{self.path} is no state file – name another file")

    def _open(self) -> None:
        base = self._base
        base.execute("PRAGMA locking_mode = EXCLUSIVE")
        bound_log(base)
        base.execute("BEGIN IMMEDIATE")
        base.execute("ROLLBACK")
        (version,) = base.execute("PRAGMA user_version").fetchone()
        if version != VERSION:
            what = f"{self.path} has the form {version}, this framekit writes form {VERSION}"
            raise StateError(f"{what} – use the framekit that wrote it, or name another file")
        (found,) = base.execute("PRAGMA integrity_check(1)").fetchone()
        if found != "ok":
            raise self._damaged(str(found))
        self._check_run()

    def _check_run(self) -> None:
        row = self._base.execute("SELECT value FROM about WHERE name = 'run'").fetchone()
        if row is None:
            raise self._damaged("it names no run")
        if row[0] != self.run:
            what = f"{self.path} is the state of run '{row[0]}', this run is '{self.run}'"
            raise StateError(f"{what} – name another file, or move it away to begin anew")
        stored = {name: (unit, size) for name, unit, size in self._base.execute("SELECT name, unit, size FROM areas")}
        for name, unit, size in self.shape:
            if name in stored and stored[name] != (unit, size):
                what = f"{self.path} is of another memory: area {name} is {stored[name][1]} × {stored[name][0]} there"
                raise StateError(f"{what} and {size} × {unit} here – name another file, or move it away to begin anew")

    @contextmanager
    def _errors(self) -> Iterator[None]:
        try:
            yield
        except sqlite3.OperationalError as error:
            if getattr(error, "sqlite_errorcode", 0) & 0xFF in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
                raise StateError(f"{self.path} is in use – stop the run that uses it, or name another file") from None
            raise StateError(f"{self.path}: {error}") from None
        except sqlite3.DatabaseError as error:
            raise self._damaged(str(error)) from None
        except OSError as error:
            raise StateError(f"{self.path}: {error_text(error)}") from None

    def _not_opened(self, why: str) -> StateError:
        what = why if str(self.path) in why else f"{self.path}: {why}"
        return StateError(f"{what} – {remedy_of(why) or 'make room or change its permissions'}, or name another file")

    def _damaged(self, how: str) -> StateError:
        return StateError(f"{self.path} is damaged: {how} – put a copy in its place, or move it away to begin anew")

    # ---- reading ------------------------------------------------------------------------------------------

    def _load(self) -> KeptRun:
        stored = {name for (name,) in self._base.execute("SELECT name FROM areas")}
        areas = {name: self._area(name, size) for name, size in self._sizes().items() if name in stored}
        rows = self._base.execute(f"SELECT {_COLUMNS} FROM blocks")
        blocks = {(row[0], row[1]): self._block(row) for row in rows}
        self._written = dict(areas)
        return KeptRun(areas, blocks)

    def _sizes(self) -> dict[str, int]:
        return {name: (size * unit_bits(unit) + 7) // 8 for name, unit, size in self.shape}

    def _area(self, name: str, size: int) -> bytes:
        content = bytearray(size)
        for number, page in self._base.execute("SELECT number, content FROM pages WHERE area = ?", (name,)):
            if not isinstance(page, bytes) or number < 0 or number * PAGE + len(page) > size or len(page) > PAGE:
                raise self._damaged(f"page {number} of area {name} has no place")
            content[number * PAGE : number * PAGE + len(page)] = page
        return bytes(content)

    def _block(self, row: tuple[int | str | None, ...]) -> KeptBlock:
        numbers, texts = (row[0], row[1], *row[3:7]), (row[2], row[7], row[8], row[10])
        good = all(isinstance(number, int) and number >= 0 for number in numbers)
        good = good and all(isinstance(text, str) for text in texts) and isinstance(row[9], (int, type(None)))
        block = KeptBlock(*row)  # type: ignore[arg-type]
        if not good or block.started < block.done + block.failed:
            raise self._damaged(f"block {row[1]} of set {row[0]} has impossible counters")
        return block

    # ---- writing ------------------------------------------------------------------------------------------

    def save(self, kept: KeptRun) -> int:
        """Write the changed pages and all blocks in one transaction; return the number of pages."""
        written = {} if self._is_other else self._written
        pages = [
            (name, at // PAGE, content[at : at + PAGE])
            for name, content in kept.areas.items()
            for at in _changed(written.get(name), content)
        ]
        with self._errors(), transaction(self._base):
            if self._is_other:
                self._base.execute("DELETE FROM pages")
            self._base.executemany("INSERT OR REPLACE INTO areas VALUES (?, ?, ?)", self.shape)
            self._base.executemany("INSERT OR REPLACE INTO pages VALUES (?, ?, ?)", pages)
            places = ", ".join("?" * 11)
            rows = [astuple(block) for block in kept.blocks.values()]
            self._base.execute("DELETE FROM blocks")
            self._base.executemany(f"INSERT INTO blocks ({_COLUMNS}) VALUES ({places})", rows)
        self._written.update(kept.areas)
        self._is_other = False
        return len(pages)


def _changed(before: bytes | None, now: bytes) -> Iterable[int]:
    """Return the offsets of the changed pages; of a new area, those that are not all 0."""
    before = bytes(len(now)) if before is None else before
    return [at for at in range(0, len(now), PAGE) if before[at : at + PAGE] != now[at : at + PAGE]]


Words = tuple[str, int, int]
"""An area, a word of it, and a number of words from there on."""


class StateKeeper:
    """Keeps the areas of `file.shape` and the counters of the blocks that `states` gives, every `every` nanoseconds."""

    def __init__(
        self,
        file: StateFile,
        memory: DeviceMemory,
        states: Callable[[], Collection[BlockState]],
        clock: Clock,
        every: int,
        troubles: Troubles,
    ) -> None:
        self.file = file
        self.memory = memory
        self.states = states
        self.clock = clock
        self.every = every
        self._troubles = troubles
        self.trouble = troubles.source(
            f"state {file.path}", lambda: "the file keeps an older state, each write is tried again", unit=""
        )
        if file.was_empty:
            troubles.note(self.trouble.name, "the file was empty, memory and counters begin anew")
        self._contents: dict[int, tuple[object, str]] = {}
        self._last = KeptRun()
        self._writing: Future[bool] | None = None
        self._writer = ThreadPoolExecutor(1, "framekit-state")
        self._alarm = clock.alarm(self._turn)
        self._stopped = False

    # ---- putting back -------------------------------------------------------------------------------------

    def restore(self, words_of_blocks: Iterable[Words]) -> None:
        """Restore memory, except these words, and the counters of unchanged blocks.

        An exchange in progress when the file was written counts as failed, `interrupted`.
        """
        kept = self.file.kept
        spared = [(area, first, self.memory.read(area, "word", first, count)) for area, first, count in words_of_blocks]
        for name, content in kept.areas.items():
            self.memory.write_bytes(name, 0, content, force=True)
        for area, first, values in spared:
            self.memory.write(area, "word", first, values, force=True)
        for state in self.states():
            found = kept.blocks.get((state.block.set, state.block.number))
            if found is not None and found.content == self._content(state):
                put_back(state, found)

    def _content(self, state: BlockState) -> str:
        """Return the fingerprint of a block, computed once."""
        known = self._contents.get(id(state.block))
        if known is None:
            known = self._contents[id(state.block)] = (state.block, fingerprint(state.block))
        return known[1]

    # ---- writing ------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Begin to write; if `every` is never, only the end writes."""
        self._alarm.set(min(self.clock.now() + self.every, NEVER))

    def stop(self) -> None:
        """Write a last time, wait for the result, and close the file. A second call has no effect."""
        if self._stopped:
            return
        self._stopped = True
        self._alarm.cancel()
        self._see(wait=True)
        self._write()
        self._see(wait=True)
        self._writer.shutdown()
        self.file.close()

    def _turn(self) -> None:
        self.start()
        if self._see():
            self._write()

    def _see(self, wait: bool = False) -> bool:
        """Take the result of the last write, if it has ended; return whether the next may begin."""
        writing = self._writing
        if writing is None:
            return True
        if not wait and not writing.done():
            return False
        self._writing = None
        if not writing.result():
            self._last = KeptRun()
        return True

    def _write(self) -> None:
        kept = self.kept()
        if kept != self._last or self.file.change:
            self._last = kept
            self._writing = self._writer.submit(self._save, kept)

    def _save(self, kept: KeptRun) -> bool:
        """Write the file; False when that has failed, which is reported."""
        try:
            if change := self.file.follow_path():
                self._troubles.note(self.trouble.name, change)
            self.file.save(kept)
        except StateError as error:
            self.trouble.begins(str(error).removeprefix(f"{self.file.path}: "))
            return False
        self.trouble.ends()
        return True

    def kept(self) -> KeptRun:
        """Return the present state."""
        areas = {name: self.memory.read_bytes(name, 0, self.memory.area(name).size_bytes) for name in self.names()}
        states = self.states()
        blocks = [kept_of(state, self._content(state)) for state in states]
        if len(self._contents) > len(states):  # blocks that an edit has taken out or changed
            self._contents = {id(state.block): self._contents[id(state.block)] for state in states}
        return KeptRun(areas, {(block.set, block.number): block for block in blocks})

    def names(self) -> list[str]:
        """Return the areas that are kept."""
        return [name for name, _, _ in self.file.shape]


def kept_of(state: BlockState, content: str) -> KeptBlock:
    """Return a block's counters and its last failure."""
    failure = state.last_failure or Failure(outcome="")
    return KeptBlock(
        *state.key, content, state.started, state.done, state.failed, state.overruns,
        failure.outcome, failure.cause, failure.device_code, failure.meaning,
    )  # fmt: skip


def put_back(state: BlockState, kept: KeptBlock) -> None:
    """Restore the counters and the last failure of a block."""
    interrupted = kept.started - kept.done - kept.failed
    state.started, state.done, state.overruns = kept.started, kept.done, kept.overruns
    state.failed = kept.failed + interrupted
    if interrupted:
        state.last_failure = Failure(outcome="interrupted")
    elif kept.outcome:
        state.last_failure = Failure(
            outcome=kept.outcome, cause=kept.cause, device_code=kept.device_code, meaning=kept.meaning
        )
