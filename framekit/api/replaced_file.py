"""A file that is replaced on trial: it is the old one or the new one, whole, and can be put back until the new one has
proved itself, also after a kill.

While the new content is on trial, `NAME.trial` holds its digest and the old content; then the old one is `NAME.before`.
"""

from __future__ import annotations

import hashlib
import logging
import os
from contextlib import suppress
from pathlib import Path

from framekit.sinks.base import open_alone

log = logging.getLogger(__name__)

MODE = 0o777
"""What a new file has of the old one's rights."""


def digest_of(content: bytes) -> str:
    """What tells one content of a file from another: 12 hex digits."""
    return hashlib.sha256(content).hexdigest()[:12]


class ReplacedFile:
    """The file at `path`, which may be a link: what it leads to is replaced. Raises OSError."""

    def __init__(self, path: Path) -> None:
        self.path = path.resolve()
        self.before = self.path.with_name(f"{self.path.name}.before")
        self._trial = self.path.with_name(f"{self.path.name}.trial")
        self._lock = self.path.with_name(f".{self.path.name}.lock")
        self._held: int | None = None

    @property
    def companions(self) -> tuple[Path, ...]:
        """The file and those beside it that belong to it."""
        whole = (self.path, self.before, self._trial)
        return *whole, *map(_part_of, whole), self._lock

    def hold(self) -> None:
        """This process is the one that replaces the file. Raises OSError while another one is."""
        self._held = open_alone(self._lock)

    def let_go(self) -> None:
        """Others may."""
        held, self._held = self._held, None
        if held is not None:
            try:
                self._lock.unlink(missing_ok=True)
            finally:
                os.close(held)

    def put(self, content: bytes) -> None:
        """The file has this content, on trial. Where that fails nothing is changed."""
        replace_whole(self._trial, digest_of(content).encode() + b"\n" + self.path.read_bytes(), self.path)
        try:
            replace_whole(self.path, content, self.path)
        except OSError:
            self._end_trial()
            raise

    def put_back(self) -> None:
        """The file has the content of before the trial."""
        _, _, content = self._trial.read_bytes().partition(b"\n")
        replace_whole(self.path, content, self.path)
        self._end_trial()

    def keep(self) -> None:
        """The new content has proved itself: the old one is that of before."""
        _, _, content = self._trial.read_bytes().partition(b"\n")
        replace_whole(self.before, content, self.path)
        self._end_trial()

    def settle(self) -> bool:
        """At a start: puts a file back whose trial was cut off, and tells whether there was one.

        Nothing is done while another process is at work with the file.
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
    """A file has this content from one moment to the next, whatever happens, and the rights of another one, if given.

    Raises OSError.
    """
    part = _part_of(path)
    with part.open("wb") as stream:
        if like is not None:
            os.chmod(part, like.stat().st_mode & MODE)
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())
    os.replace(part, path)
    _sync_folder(path.parent)


def _sync_folder(path: Path) -> None:
    with suppress(OSError):  # where a system cannot do that to folders
        folder = os.open(path, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def _part_of(path: Path) -> Path:
    return path.with_name(f".{path.name}.part")
