"""The files of the editor: YAML files of one folder, read as text and saved as a whole.

Paths from a browser name files inside the folder only. A file that has changed on disk is never replaced.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from framekit.api.replaced_file import digest_of, make_whole, replace_whole
from framekit.definition.problems import error_text, plural

ENDINGS = (".yaml", ".yml")
LARGEST_TEXT = 500_000
"""Largest number of bytes of a file that can be edited."""
MOST_FILES = 500
"""Largest number of files that are listed."""
MOST_ENTRIES = 20_000
"""Largest number of entries of folders that are looked at for the list."""


class EditRefusedError(Exception):
    """A file that cannot be opened or saved; the text gives the reason and a remedy."""


@dataclass(frozen=True, slots=True)
class EditedFile:
    """A file as it was read."""

    name: str
    text: str
    """The content with line ends as `\\n`, without a byte order mark."""
    digest: str
    """The digest of the content on disk."""


class EditedFolder:
    """The files that a browser may open and save: one file, or all YAML files in and below a folder."""

    def __init__(self, place: Path) -> None:
        """Raise EditRefusedError for a place that is no folder and no YAML file."""
        self._only = "" if place.is_dir() else place.name
        if self._only and place.suffix not in ENDINGS:
            raise EditRefusedError(f"'{place.name}' is no YAML file – name a file with the ending .yaml, or a folder")
        if self._only and not place.is_file():
            raise EditRefusedError(f"there is no file '{place}' – check its name, or make one: framekit new NAME")
        self.root = (place.parent if self._only else place).resolve()

    def names(self) -> list[str]:
        """Return the names of the files, relative to the folder, sorted."""
        if self._only:
            return [self._only]
        found: list[str] = []
        for name in self._walk():
            found.append(name)
            if len(found) == MOST_FILES:
                break
        return sorted(found, key=lambda name: (name.count("/"), name))

    def _walk(self) -> Iterator[str]:
        """Yield YAML files in and below the folder, without hidden ones; symbolic links to folders are not followed."""
        seen = 0
        for folder, folders, files in os.walk(self.root):
            folders[:] = sorted(name for name in folders if not name.startswith("."))
            seen += len(folders) + len(files)
            if seen > MOST_ENTRIES:
                return
            for name in sorted(files):
                relative = (Path(folder) / name).relative_to(self.root).as_posix()
                if self._names_file(relative) and self._resolved(relative) is not None:
                    yield relative

    def path_of(self, name: str) -> Path:
        """Return the path of a file. Raise EditRefusedError for a name that does not lead to a file in the folder."""
        path = self._resolved(name) if self._names_file(name) else None
        if path is None:
            raise EditRefusedError(f"'{name}' is no YAML file of this folder – choose one of the list")
        return path

    def _names_file(self, name: str) -> bool:
        """Return whether a name has the form of a file in the folder."""
        parts = PurePosixPath(name).parts
        if not parts or "\\" in name or "\0" in name or name.startswith("/"):
            return False
        if any(part.startswith(".") for part in parts) or not name.endswith(ENDINGS):
            return False
        return not self._only or name == self._only

    def _resolved(self, name: str) -> Path | None:
        """Return the path of an existing file, or None if it leads out of the folder."""
        try:
            path = (self.root / name).resolve(strict=True)
        except (OSError, RuntimeError, ValueError):  # a circle of links; a character that no file name has
            return None
        is_inside = path.is_relative_to(self.root) and path.suffix in ENDINGS and path.is_file()
        return path if is_inside else None

    def read(self, name: str) -> EditedFile:
        """Return the content of a file. Raise EditRefusedError."""
        content = _content(self.path_of(name))
        return EditedFile(name, _text(content), digest_of(content))

    def stamp(self, name: str) -> tuple[int, int]:
        """Return time of change and size of a file, to notice changes by other programs; (0, 0) for a missing file."""
        try:
            found = self.path_of(name).stat()
        except (EditRefusedError, OSError):
            return 0, 0
        return found.st_mtime_ns, found.st_size

    @property
    def takes_new(self) -> bool:
        """Return whether files can be made here: not if a single file is edited."""
        return not self._only

    def make(self, name: str, text: str) -> None:
        """Make a file with this text in the folder itself. Raise EditRefusedError; no file is replaced."""
        if "/" in name or not self.takes_new or not self._names_file(name):
            raise EditRefusedError(f"'{name}' cannot be made here – run framekit edit with a folder, and give a name")
        content = _as_before(text, b"")
        try:
            make_whole(self.root / name, content)
        except FileExistsError:
            raise EditRefusedError(f"{name} exists already – open it, or choose another name") from None
        except OSError as error:
            raise EditRefusedError(f"{name} cannot be made: {error_text(error)}") from None

    def save(self, name: str, text: str, digest: str) -> str:
        """Replace a file whose content on disk still has this digest; return the digest of the new content.

        Line ends and a byte order mark stay as in the file. Raise EditRefusedError.
        """
        path = self.path_of(name)
        before = _content(path)
        if digest_of(before) != digest:
            raise EditRefusedError(f"{name} has changed on disk since it was opened – open it again, and edit that")
        content = _as_before(text, before)
        if len(content) > LARGEST_TEXT:
            raise EditRefusedError(f"the text has more than {LARGEST_TEXT} bytes – split it with uses: or extends:")
        try:
            replace_whole(path, content, path)
        except OSError as error:
            raise EditRefusedError(f"{name} cannot be written: {error_text(error)}") from None
        return digest_of(content)


def _content(path: Path) -> bytes:
    """Return the content of a file. Raise EditRefusedError."""
    try:
        with path.open("rb") as stream:
            content = stream.read(LARGEST_TEXT + 1)
    except OSError as error:
        raise EditRefusedError(f"{path.name} cannot be read: {error_text(error)}") from None
    if len(content) > LARGEST_TEXT:
        limit = plural(LARGEST_TEXT, "byte")
        raise EditRefusedError(f"{path.name} has more than {limit} – edit it with another program")
    return content


_MARK = "\ufeff"


def _text(content: bytes) -> str:
    """Return a content as text. Raise EditRefusedError."""
    try:
        return content.decode("utf-8").removeprefix(_MARK).replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        raise EditRefusedError(f"the byte at offset {error.start} is not UTF-8 – save the file as UTF-8") from None


def _as_before(text: str, before: bytes) -> bytes:
    """Return a text as bytes with the line ends and the byte order mark of the content before it."""
    try:
        content = text.replace("\r\n", "\n").encode("utf-8")
    except UnicodeEncodeError as error:
        raise EditRefusedError(f"the character at offset {error.start} cannot be written in UTF-8") from None
    if b"\r\n" in before:
        content = content.replace(b"\n", b"\r\n")
    mark = _MARK.encode()
    return mark + content if before.startswith(mark) else content
