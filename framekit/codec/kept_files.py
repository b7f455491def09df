"""Files in the user's own cache folder that only this user can have written.

What is read from there is run as code, so the folder and every file have to belong to this user, and nobody else may
write or read them; else there is no cache. What the files hold is not known here.
"""

from __future__ import annotations

import contextlib
import os
import stat
import sys
from pathlib import Path

MOST_BYTES = 268_435_456
"""So much do the files hold together, then the oldest go; the newest one stays whatever it holds."""

SUFFIX = ".framekit"
"""How files of the cache end: no others are ever removed, whatever folder somebody has named."""


def cache_folder() -> Path | None:
    """The folder for framekit's files, made if need be; None where there is none that this user alone can write.

    `FRAMEKIT_CACHE` names another one; with an empty name nothing is kept.
    """
    if not hasattr(os, "geteuid"):
        return None  # no owner to check
    given = os.environ.get("FRAMEKIT_CACHE")
    if given == "":
        return None
    try:
        folder = Path(given) if given is not None else _user_cache() / "framekit"
        if not folder.is_absolute():
            return None
        with contextlib.suppress(FileExistsError):
            folder.mkdir(mode=0o700, parents=True)
        return folder if _is_own(os.lstat(folder), stat.S_ISDIR) else None
    except (OSError, RuntimeError):  # RuntimeError: no home folder
        return None


def _user_cache() -> Path:
    home = os.environ.get("XDG_CACHE_HOME", "")
    if os.path.isabs(home):
        return Path(home)
    return Path.home() / ("Library/Caches" if sys.platform == "darwin" else ".cache")


def _is_own(found: os.stat_result, kind: object) -> bool:
    """Whether it is of that kind (`stat.S_ISDIR`, …), this user's, and closed to all others."""
    return callable(kind) and bool(kind(found.st_mode)) and found.st_uid == os.geteuid() and not found.st_mode & 0o077


def read_kept(folder: Path, name: str) -> bytes | None:
    """The content of a file; None if there is none that can be read, or one that somebody else may have written."""
    try:
        descriptor = os.open(folder / (name + SUFFIX), os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
        try:
            if not _is_own(os.fstat(descriptor), stat.S_ISREG):
                return None
            with open(descriptor, "rb", closefd=False) as file:
                return file.read()
        finally:
            os.close(descriptor)
    except OSError:
        return None


def keep(folder: Path, name: str, data: bytes) -> None:
    """Writes a file, whole or not at all; a cache that cannot be written is none."""
    temporary = folder / f"{name}.{os.getpid()}.new{SUFFIX}"
    with contextlib.suppress(OSError):
        descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o600)
        try:
            with open(descriptor, "wb") as file:
                file.write(data)
            temporary.replace(folder / (name + SUFFIX))
        except OSError:
            temporary.unlink(missing_ok=True)
            raise
        _drop_oldest(folder)


def _drop_oldest(folder: Path) -> None:
    found = sorted(((file.lstat(), file) for file in folder.glob(f"*{SUFFIX}")), key=lambda each: -each[0].st_mtime_ns)
    size = 0
    for number, (state, file) in enumerate(found):
        size += state.st_size
        if number and size > MOST_BYTES:
            file.unlink(missing_ok=True)
