"""Read the constant arguments of a call: single values, lists of records, and bytes of a file.

A list of records has the fields of the list of the request, or of its buffer, in which the row puts the argument. So
every wrong name and value is reported at its place. Bytes may be the content of a file: `{file: NAME}`.
"""

from __future__ import annotations

from collections.abc import Sequence as SequenceOf
from pathlib import Path
from typing import Any

from framekit.definition.expression import Expression, Name
from framekit.definition.given_values import GivenValue, given_value
from framekit.definition.load.reader import Broken, Reader
from framekit.definition.model.frames import by_value_name, names_needed, parts_of
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.sections import Argument
from framekit.definition.model.segments import Repeat, Segment
from framekit.definition.model.services import ServiceRow
from framekit.definition.model.values import FrameOf, LayoutOf
from framekit.definition.nodes import Entry, Mapping, Node, Sequence
from framekit.definition.problems import did_you_mean, plural
from framekit.definition.sources import INSIDE, leaves_folder
from framekit.definition.start_values import StartValues
from framekit.link.services.rows import TYPES, checked
from framekit.link.variables import ParameterError
from framekit.runfile.channels import raw_value

MOST_BYTES = 1 << 20
"""The largest file that an argument may be read from."""


class ArgumentValues:
    """Reads the values of arguments; names of files count from `folder`."""

    def __init__(self, reader: Reader, folder: Path) -> None:
        self.reader = reader
        self.folder = folder

    def read(self, protocol: Protocol, rows: tuple[ServiceRow, ...], entry: Entry) -> Any:
        """Return the value of an argument, checked if all rows agree on the type. Raise Broken."""
        name, node = entry.key.text, entry.value
        taken = taken_by(rows, name)
        if not taken or taken[0].type not in TYPES or any(one.type != taken[0].type for one in taken):
            return self.reader.constant(node)
        if taken[0].type == "bytes" and isinstance(node, Mapping):
            value: Any = self._file(node)
        elif taken[0].type == "list" and _has_records(node):
            value = self._records(protocol, rows, name, node)
        else:
            value = raw_value(self.reader, node)
        refusals = [error for one in taken if (error := _refusal(one, value)) is not None]
        if len(refusals) == len(taken):
            what, _, todo = str(refusals[0]).replace("parameter", "argument", 1).partition(" – ")
            raise self.reader.broken(node.at, what, todo)
        return value

    # ---- files --------------------------------------------------------------------------------------------

    def _file(self, node: Mapping) -> bytes:
        """Return the content of the file of `{file: NAME}`. Raise Broken."""
        reader = self.reader
        for entry in node.read_all():
            if entry.key.text != "file":
                raise reader.broken(entry.key.at, f"bytes have no '{entry.key.text}'", "write {file: NAME}")
        named = node.get("file")
        if named is None:
            raise reader.broken(node.at, "no file is named", "write {file: NAME}")
        name = reader.text(named)
        if leaves_folder(name, self.folder):
            raise reader.broken(named.at, f"'{name}' leaves the run's folder", INSIDE)
        path = self.folder / name
        try:
            if path.stat().st_size > MOST_BYTES:
                raise reader.broken(named.at, f"'{name}' is larger than {plural(MOST_BYTES, 'byte')}", "cut it")
            return path.read_bytes()
        except OSError as error:
            hint = "check its name and folder"
            raise reader.broken(named.at, f"'{name}' cannot be read: {error.strerror}", hint) from None

    # ---- lists of records ---------------------------------------------------------------------------------

    def _records(self, protocol: Protocol, rows: tuple[ServiceRow, ...], name: str, node: Node) -> list[Any]:
        """Return a list of records with the fields of the list that the rows put it in. Raise Broken."""
        reader = self.reader
        found = next((one for row in rows if (one := list_of(protocol, row, name)) is not None), None)
        if found is None or found.plain_type is not None:
            raise reader.broken(node.at, f"'{name}' is no list of records", "write single values")
        before = len(reader.problems)
        values, given = StartValues(protocol.layouts), given_value(node)
        records = [values.given_fields(found.members, item) for item in given.items or ()]
        reader.problems.extend(values.problems)
        for record, item in zip(records, given.items or (), strict=True):
            self._complete(found.members, record, item)
        if len(reader.problems) > before:
            raise Broken("the problems of the records have been noted")
        return records

    def _complete(self, members: SequenceOf[Segment], record: Any, given: GivenValue) -> None:
        """Note the fields that a record lacks."""
        names = {entry.name for entry in given.entries or ()}
        known = by_value_name(members)
        missing = [name for name in names_needed(members) if name not in names]
        misspelt = any(did_you_mean(one, missing) for one in names - known.keys())
        if given.entries is not None and missing and not misspelt:
            self.reader.note(given.at, f"'{missing[0]}' is missing", f"add {missing[0]}: VALUE")


def taken_by(rows: SequenceOf[ServiceRow], name: str) -> list[Argument]:
    """Return the argument of this name of each row that has one."""
    return [argument for row in rows for argument in row.takes if argument.name == name]


def list_of(protocol: Protocol, row: ServiceRow, name: str) -> Repeat | None:
    """Return the list in the request of a row, or in its buffer, whose value is the argument `name`."""
    values = [row.request, row.buffer]
    holders = [(protocol.frames[one.frame].segments, one.fields) for one in parts_of(values, FrameOf)]
    holders += [(protocol.layouts[one.layout].segments, one.fields) for one in parts_of(values, LayoutOf)]
    for segments, fields in holders:
        for field, value in fields.items():
            is_argument = isinstance(value, Expression) and isinstance(value.root, Name) and value.root.name == name
            segment = by_value_name(segments).get(field) if is_argument else None
            if isinstance(segment, Repeat):
                return segment
    return None


def _has_records(node: Node) -> bool:
    return isinstance(node, Sequence) and any(isinstance(item, Mapping) for item in node.items)


def _refusal(argument: Argument, value: Any) -> ParameterError | None:
    """Return why an argument does not accept a value, or None if it accepts it."""
    try:
        checked(argument, value)
    except ParameterError as error:
        return error
    return None
