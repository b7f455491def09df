"""A file that is replaced on trial: it is the old one or the new one, whole, and can be put back until the new one has
proved itself, also after a kill.

The old content is kept as `NAME.before`. While the new one is on trial, `NAME.trial` holds its digest.
"""

from __future__ import annotations

import hashlib
import logging
import os
from contextlib import suppress
from pathlib import Path

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

    @property
    def companions(self) -> tuple[Path, ...]:
        """The file and those beside it that belong to it."""
        return self.path, self.before, self._trial, _part_of(self.path), _part_of(self.before), _part_of(self._trial)

    def put(self, content: bytes) -> None:
        """The file has this content, on trial."""
        replace_whole(self.before, self.path.read_bytes(), self.path)
        replace_whole(self._trial, digest_of(content).encode(), self.path)
        replace_whole(self.path, content, self.path)

    def put_back(self) -> None:
        """The file has the content of before."""
        replace_whole(self.path, self.before.read_bytes(), self.path)
        self.keep()

    def keep(self) -> None:
        """The new content has proved itself."""
        self._trial.unlink(missing_ok=True)

    def settle(self) -> bool:
        """At a start: puts a file back whose trial was cut off, and tells whether there was one."""
        try:
            mark = self._trial.read_bytes()
        except OSError:
            return False
        if mark != digest_of(self.path.read_bytes()).encode():  # the kill came before it, or people have edited it
            self.keep()
            return False
        self.put_back()
        log.warning("%s is the one of before again: the new one was cut off before it had begun", self.path.name)
        return True


def replace_whole(path: Path, content: bytes, like: Path) -> None:
    """A file has this content from one moment to the next, whatever happens, and the rights of another one.

    Raises OSError.
    """
    part = _part_of(path)
    with part.open("wb") as stream:
        os.chmod(part, like.stat().st_mode & MODE)
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())
    os.replace(part, path)
    with suppress(OSError):  # where a system cannot do that to folders
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def _part_of(path: Path) -> Path:
    return path.with_name(f".{path.name}.part")
