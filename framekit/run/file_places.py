"""Name the obstacle on the way to a file that cannot be opened: a folder, a symbolic link, a permission."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

MOST_LINKS = 40
"""Symbolic links in sequence that are followed, as many as Linux follows."""


def obstacle(path: Path) -> str:
    """Return why no file can be opened at a path, as far as the path shows it; '' if its folder can be entered.

    The reason contains no remedy: see `framekit.run.trouble.remedy_of`.
    """
    links: list[Path] = []
    while True:
        try:
            found = _obstacle_of_folder(path.parent)
            target = None if found else os.readlink(path)
        except OSError as error:  # EINVAL: no symbolic link, ENOENT: a new file
            return "" if error.errno in (errno.EINVAL, errno.ENOENT) else _of_system(path, error)
        if target is None:
            return f"{links[0]} is a link to {path}: {found}" if links else found
        links.append(path)
        path = path.parent / target
        if len(links) > MOST_LINKS:
            return f"{links[0]} is a link that leads to itself"


def why_not_opened(path: Path, error: OSError) -> str:
    """Return why `error` was raised when a file was opened to write at `path`."""
    found = obstacle(path)
    if found:
        return found
    if isinstance(error, PermissionError):
        if os.path.lexists(path):
            return f"no permission to write {path}"
        return f"no permission to make a file in the folder {path.parent}"
    if isinstance(error, FileNotFoundError):
        return f"the folder {path.parent} takes no new files"
    return _of_system(path, error)


def _obstacle_of_folder(folder: Path) -> str:
    """Return why a folder cannot be entered, for its first part that cannot; '' if it can."""
    for part in (*reversed(folder.parents), folder):
        try:
            mode = os.stat(part).st_mode
        except FileNotFoundError:
            if os.path.lexists(part):
                return f"{part} is a link to {os.readlink(part)}, which does not exist"
            return f"the folder {folder} does not exist"
        except OSError as error:
            return _of_system(part, error)
        if not stat.S_ISDIR(mode):
            return f"{part} is no folder"
        if not os.access(part, os.X_OK):
            return f"no permission to enter the folder {part}"
    return ""


def _of_system(path: Path, error: OSError) -> str:
    """Return the reason of the system for a path, in words of its own where they say more."""
    match error.errno:
        case errno.ELOOP:
            return f"{path} is a link that leads to itself"
        case errno.ENAMETOOLONG:
            return "the name is too long"
        case errno.EROFS:
            return f"the folder {path.parent} is in a read-only file system"
        case errno.EACCES | errno.EPERM:
            return f"no permission for {path}"
    return error.strerror or str(error)
