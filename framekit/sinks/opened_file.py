"""Watches the path of an open file: programs such as logrotate move, delete, replace or cut a file while it is written.

The open file of a moved path still takes data, which its user would never find. So every writer of a file compares the
file at the path with its open file before it writes; that costs one system call.
"""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

from framekit.run.file_places import obstacle, why_not_opened

MOVED = "the file was moved or deleted – a new file begins"
REPLACED = "the file was replaced – the new file is continued"
CUT = "the file was cut by another program – the rest of it is continued"


_SPECIAL = {
    stat.S_IFDIR: "a folder",
    stat.S_IFCHR: "a character device",
    stat.S_IFBLK: "a block device",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
}


def refuse_special(path: Path) -> None:
    """Raise OSError if the path leads to a folder, a device, a pipe or a socket, or nowhere, without opening it."""
    try:
        mode = os.stat(path).st_mode
    except OSError as error:
        if isinstance(error, FileNotFoundError) and not obstacle(path):
            return
        raise not_opened(path, error) from None
    if not stat.S_ISREG(mode):
        kind = _SPECIAL.get(stat.S_IFMT(mode), "no regular file")
        todo = "name another file" if kind.endswith("device") else "move it away, or name another file"
        raise FileExistsError(errno.EEXIST, f"{path} is {kind} – {todo}")


def not_opened(path: Path, error: OSError) -> OSError:
    """Return an error that names the obstacle on the way to a file that cannot be opened."""
    return type(error)(error.errno, why_not_opened(path, error), str(path))


class OpenedFile:
    """The file at `path`, which has just been opened. A pipe or a device never changes."""

    def __init__(self, path: Path) -> None:
        """Note the identity of the file. Raise OSError."""
        self.path = path
        found = os.stat(path)
        self._identity = _identity(found)
        self._is_plain = stat.S_ISREG(found.st_mode)

    def change(self, size: int = 0) -> str:
        """Return the change of the path since then as a message, or '' for the same file with at least `size` bytes.

        A path that cannot be examined, such as in a folder without permission, counts as unchanged: the open file can
        still be written.
        """
        if not self._is_plain:
            return ""
        try:
            found = os.stat(self.path)
        except (FileNotFoundError, NotADirectoryError):
            return MOVED
        except OSError:
            return ""
        if _identity(found) != self._identity:
            return REPLACED if found.st_size else MOVED
        return CUT if found.st_size < size else ""


def _identity(found: os.stat_result) -> tuple[int, int]:
    return found.st_dev, found.st_ino
