"""What a loaded definition was read from, so that it can be told whether loading it again would give the same.

Only files and names are looked at; what the files mean is not known here.
"""

from __future__ import annotations

from collections.abc import Iterable
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

from framekit.definition.shipped import find_definition


class Sources(NamedTuple):
    """Every file that was read, with a hash of what it held; every name in them, seen from its folder, with the file
    it meant. Plain texts, so that they can be kept."""

    files: tuple[tuple[str, str], ...]
    found: tuple[tuple[str, str, str], ...]

    def still_hold(self) -> bool:
        """Whether every file has the content it had, and every name still means the same file."""
        return all(_digest(Path(path)) == before for path, before in self.files) and all(
            str(find_definition(name, Path(folder))) == path for name, folder, path in self.found
        )


def sources_of(files: Iterable[Path], found: Iterable[tuple[str, Path, Path]]) -> Sources:
    """The sources as they are now."""
    return Sources(
        tuple((str(path), _digest(path)) for path in files),
        tuple((name, str(folder), str(path)) for name, folder, path in found),
    )


def _digest(path: Path) -> str:
    """The hash of a file's content; '' for one that cannot be read."""
    try:
        return sha256(path.read_bytes()).hexdigest()
    except OSError:
        return ""
