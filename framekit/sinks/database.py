"""SQLite files of framekit: how they are opened, and how large their log (WAL) may become."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from framekit.sinks.base import open_alone
from framekit.sinks.opened_file import refuse_special

LOG_PAGES = 128
"""Pages of 4 KB in the log before SQLite moves them into the file; 1000, its default, are 4 MB for each file."""

LOGS = ("-wal", "-shm")
"""Ends of the names of the files next to an open database."""


def lock_of(path: Path) -> int:
    """Lock a database for a single process by a file `NAME.lock` next to it. Return the file descriptor.

    Raises OSError, also if the path leads to no regular file.
    """
    refuse_special(path)
    return open_alone(path.with_name(f"{path.name}.lock"))


def connected(path: Path) -> sqlite3.Connection:
    """Open a database that threads may share, without transactions of its own. Raises sqlite3.Error."""
    return sqlite3.connect(path, isolation_level=None, check_same_thread=False)


def bound_log(database: sqlite3.Connection) -> None:
    """Use a log, and bound it. A commit survives a kill of the program; a loss of power may cost the last commits."""
    database.execute("PRAGMA journal_mode = WAL")
    database.execute("PRAGMA synchronous = NORMAL")
    database.execute(f"PRAGMA wal_autocheckpoint = {LOG_PAGES}")
    database.execute(f"PRAGMA journal_size_limit = {4096 * LOG_PAGES}")


def close_moved(database: sqlite3.Connection, path: Path) -> None:
    """Close a database whose file was moved or deleted after it was opened at `path`. Raise OSError.

    SQLite itself would leave the last commits in the log, which has the name of the path: they would be missing in the
    moved file, and lie next to the next database. A log of the database that is at the path now is kept.
    """
    is_written = False
    with suppress(sqlite3.Error):  # of a connection that has failed before
        ((busy, _, _),) = database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        is_written = not busy
    database.close()
    logs = [Path(f"{path}{name}") for name in LOGS]
    if is_written and logs[0].exists() and logs[0].stat().st_size:
        return  # the own log is empty now
    for log in logs:
        log.unlink(missing_ok=True)


def write_once(database: sqlite3.Connection, setting: str, value: int) -> None:
    """Write a setting again, as a test whether the file can be written. Raises sqlite3.Error."""
    with transaction(database):
        database.execute(f"PRAGMA {setting} = {value}")


@contextmanager
def transaction(database: sqlite3.Connection) -> Iterator[None]:
    """Commit the changes of the block, or none of them. Raises sqlite3.Error."""
    database.execute("BEGIN IMMEDIATE")
    try:
        yield
        database.execute("COMMIT")
    except BaseException:
        if database.in_transaction:
            database.execute("ROLLBACK")
        raise
