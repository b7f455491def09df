"""A file that is replaced on trial: it always has the complete old or new content, and the old content can be restored
until the trial has ended well, also after a kill.

During the trial `NAME.trial` holds the digest of the new content and the old content; later `NAME.before` has the old.
"""

from __future__ import annotations

import hashlib
import logging
import os
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from framekit.sinks.base import open_alone

log = logging.getLogger(__name__)

MODE = 0o777
"""The permission bits that a new file takes over."""


def digest_of(content: bytes) -> str:
    """Return a digest of a content: 12 hex digits."""
    return hashlib.sha256(content).hexdigest()[:12]


class ReplacedFile:
    """The file at `path`; of a symbolic link the target is replaced. Raises OSError."""

    def __init__(self, path: Path) -> None:
        self.path = path.resolve()
        self.before = self.path.with_name(f"{self.path.name}.before")
        self._trial = self.path.with_name(f"{self.path.name}.trial")
        self._lock = self.path.with_name(f".{self.path.name}.lock")
        self._held: int | None = None

    @property
    def companions(self) -> tuple[Path, ...]:
        """Return the file and its companions in the same folder."""
        whole = (self.path, self.before, self._trial)
        return *whole, *map(_part_of, whole), self._lock

    def hold(self) -> None:
        """Reserve the file for this process. Raises OSError while another process holds it."""
        self._held = open_alone(self._lock)

    def let_go(self) -> None:
        """Release the file for other processes."""
        held, self._held = self._held, None
        if held is not None:
            with suppress(OSError):  # a lock file that stays reserves no file
                self._lock.unlink(missing_ok=True)
            os.close(held)

    def put(self, content: bytes) -> None:
        """Replace the content, on trial. A failure leaves the old content."""
        replace_whole(self._trial, digest_of(content).encode() + b"\n" + self.path.read_bytes(), self.path)
        try:
            replace_whole(self.path, content, self.path)
        except OSError:
            self._end_trial()
            raise

    def put_back(self) -> None:
        """Restore the content from before the trial."""
        _, _, content = self._trial.read_bytes().partition(b"\n")
        replace_whole(self.path, content, self.path)
        self._end_trial()

    def keep(self) -> None:
        """End the trial with success: the old content goes to `NAME.before`."""
        _, _, content = self._trial.read_bytes().partition(b"\n")
        replace_whole(self.before, content, self.path)
        self._end_trial()

    def settle(self) -> bool:
        """Restore the old content after an interrupted trial; return whether it was restored.

        The file stays as it is while another process holds it.
        """
        if not self._trial.exists():
            return False
        try:
            self.hold()
        except BlockingIOError:
            return False
        try:
            mark, _, _ = self._trial.read_bytes().partition(b"\n")
            if mark != digest_of(self.path.read_bytes()).encode():  # the kill came before it, or people have edited it
                self._end_trial()
                return False
            self.put_back()
        finally:
            self.let_go()
        log.warning("%s is the one of before again: the new one was cut off before it had begun", self.path.name)
        return True

    def _end_trial(self) -> None:
        self._trial.unlink(missing_ok=True)
        _sync_folder(self.path.parent)


def replace_whole(path: Path, content: bytes, like: Path | None = None) -> None:
    """Replace the content of a file atomically, with the permissions of the file `like`.

    Raises OSError.
    """
    part = _part_of(path)
    _write(part.open("wb"), part, content, like)
    os.replace(part, path)
    _sync_folder(path.parent)


def make_whole(path: Path, content: bytes) -> None:
    """Make a file with this content. Raises FileExistsError; OSError for a failure, after which the file is absent."""
    _write(path.open("xb"), path, content, None)
    _sync_folder(path.parent)


def _write(opened: BinaryIO, path: Path, content: bytes, like: Path | None) -> None:
    """Write the content of an open, empty file to the disk. Raises OSError, and removes the file then."""
    try:
        with opened as stream:
            if like is not None:
                os.chmod(path, like.stat().st_mode & MODE)
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
    except OSError:
        with suppress(OSError):
            path.unlink()
        raise


def _sync_folder(path: Path) -> None:
    with suppress(OSError):  # where a system cannot do that to folders
        folder = os.open(path, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def _part_of(path: Path) -> Path:
    return path.with_name(f".{path.name}.part")
