"""Definitions converted from other programs' descriptions of protocols: the file is read, and its format found.

A format is a row that an extra brings (`IMPORTERS` of `framekit/table_of_extras.py`). Its function takes the text of a
file, the file name for messages, and the name of the new protocol. It raises DefinitionError for a text that is no such
description.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from framekit.api.errors import RequestError
from framekit.definition.imported import ImportedDefinition
from framekit.definition.problems import DefinitionError, Position, Problem
from framekit.table_of_extras import IMPORTERS, load

MOST_BYTES = 1_000_000
"""Largest size of a file (bytes)."""


class ProtocolNameError(ValueError):
    """A file whose name gives no name of a protocol."""


def import_definition(path: Path, name: str) -> ImportedDefinition:
    """Return the definition `name`, made from a file.

    Raises OSError, RequestError for an unknown suffix, DefinitionError.
    """
    chosen = IMPORTERS.get(path.suffix.lower())
    if chosen is None:
        known = ", ".join(f"{ending} ({one.about})" for ending, one in IMPORTERS.items())
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
    read: Callable[[str, str, str], ImportedDefinition] = load(chosen.target)
    return read(text, str(path), name)


def protocol_name(path: Path) -> str:
    """Return the name of the protocol in this file. Raises ProtocolNameError."""
    name = path.name.removesuffix(".yaml")
    if path.suffix != ".yaml":
        raise ProtocolNameError(
            f"'{path.name}' is no file of a definition – write {path.name.partition('.')[0] or 'meter'}.yaml"
        )
    if re.fullmatch(r"[a-z][a-z0-9_-]*", name) is None:
        raise ProtocolNameError(
            f"'{name}' is no name of a protocol – write small letters, digits, - and _, such as meter.yaml"
        )
    return name


def definition_beside(path: Path) -> Path:
    """Return the path of the definition made from a file: in the same folder, with a name that a protocol may have."""
    name = re.sub(r"[^a-z0-9_-]+", "-", path.stem.lower()).strip("-")
    return path.with_name(f"{name}.yaml")
