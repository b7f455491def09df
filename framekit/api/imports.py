"""Definitions converted from other programs' descriptions of protocols: the formats and their readers.

A format is one row of `FORMATS`. Its function takes the text of a file, the file name for messages, and the
name of the new protocol. It raises DefinitionError for a text that is no such description.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from framekit.api.errors import RequestError
from framekit.api.streamdevice import from_streamdevice
from framekit.codec.kaitai.importing import import_kaitai
from framekit.definition.imported import ImportedDefinition
from framekit.definition.problems import DefinitionError, Position, Problem

MOST_BYTES = 1_000_000
"""Largest size of a file (bytes)."""


class ImportFormat(NamedTuple):
    """A format. `encoding`: encoding of its files; a file with invalid bytes is refused."""

    what: str
    encoding: str
    read: Callable[[str, str, str], ImportedDefinition]


FORMATS: dict[str, ImportFormat] = {
    ".ksy": ImportFormat("a description of Kaitai Struct", "utf-8", import_kaitai),
    ".proto": ImportFormat("a protocol file of EPICS StreamDevice", "latin-1", from_streamdevice),
}
"""Formats by the suffix of a file, in lower case."""


def import_definition(path: Path, name: str) -> ImportedDefinition:
    """Return the definition `name`, made from a file.

    Raises OSError, RequestError for an unknown suffix, DefinitionError.
    """
    chosen = FORMATS.get(path.suffix.lower())
    if chosen is None:
        known = ", ".join(f"{ending} ({one.what})" for ending, one in FORMATS.items())
        raise RequestError(f"'{path.name}' has no ending that says what it is – known: {known}")
    with path.open("rb") as file:
        data = file.read(MOST_BYTES + 1)
    if len(data) > MOST_BYTES:
        raise DefinitionError(
            [Problem(Position(str(path), 1, 1), f"the file has more than {MOST_BYTES} bytes", "divide it")]
        )
    try:
        text = data.decode(chosen.encoding)
    except UnicodeDecodeError as error:
        before = data[: error.start]
        at = Position(str(path), before.count(b"\n") + 1, error.start - before.rfind(b"\n"))
        problem = Problem(at, f"byte {data[error.start]:02X} is no {chosen.encoding} text", "save it in that encoding")
        raise DefinitionError([problem]) from None
    return chosen.read(text, str(path), name)


def definition_beside(path: Path) -> Path:
    """Return the path of the definition made from a file: in the same folder, with a name that a protocol may have."""
    name = re.sub(r"[^a-z0-9_-]+", "-", path.stem.lower()).strip("-")
    return path.with_name(f"{name}.yaml")
