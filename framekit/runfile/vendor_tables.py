"""Register lists of vendors, converted to points: columns and types are recognized by their many usual names.

Each row that cannot be read is reported; no value is guessed: a row with an unknown type is left out.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Protocol

from framekit.definition.problems import DefinitionError, Position, Problem

COLUMNS: Mapping[str, tuple[str, ...]] = {
    "name": ("name", "tag", "parameter", "signal", "variable", "point", "label", "measurement", "quantity"),
    "address": ("address", "register", "reg", "addr", "start"),
    "type": ("type", "data type", "datatype", "format", "data format"),
    "scale": ("scale", "factor", "gain", "multiplier", "resolution", "scaling", "scale factor"),
    "offset": ("offset", "bias"),
    "unit": ("unit", "units", "engineering unit", "uom", "eng unit"),
    "access": ("access", "rw", "r w", "read write", "mode"),
    "size": ("size", "characters"),
    "about": ("about", "description", "comment", "remark", "remarks", "note", "notes", "meaning"),
}
"""The keys of a point, and the titles of columns that give them; in small letters, other characters as one space."""

TYPES: Mapping[str, str] = {
    "bool": "bit", "boolean": "bit", "bit": "bit", "coil": "bit", "byte": "byte", "word": "word", "dword": "dword",
    "int": "int16", "short": "int16", "s16": "int16", "i16": "int16", "int16": "int16", "sint16": "int16",
    "signed 16": "int16", "uint": "uint16", "ushort": "uint16", "u16": "uint16", "uint16": "uint16",
    "unsigned 16": "uint16", "unsigned": "uint16", "s32": "int32", "i32": "int32", "int32": "int32", "dint": "int32",
    "long": "int32", "signed 32": "int32", "sint32": "int32", "u32": "uint32", "uint32": "uint32", "udint": "uint32",
    "ulong": "uint32", "unsigned 32": "uint32", "s64": "int64", "i64": "int64", "int64": "int64", "lint": "int64",
    "u64": "uint64", "uint64": "uint64", "ulint": "uint64", "float": "float32", "real": "float32", "f32": "float32",
    "float32": "float32", "single": "float32", "ieee754": "float32", "ieee 754": "float32", "double": "float64",
    "f64": "float64", "float64": "float64", "lreal": "float64", "string": "string", "ascii": "string", "char": "string",
    "text": "string", "bcd": "bcd16", "bcd16": "bcd16", "bcd32": "bcd32",
}  # fmt: skip
"""Types in the terms of vendors, in the form of the titles of columns."""

_ACCESS = {"r": "r", "ro": "r", "read": "r", "read only": "r", "rw": "rw", "r w": "rw", "read write": "rw", "wr": "rw"}
_PLACE = re.compile(r"0x(?P<x>[0-9a-f]+)|(?P<h>[0-9a-f]+)h|(?P<plain>[0-9]+)", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Imported:
    """Result of importing a table."""

    points: Mapping[str, Mapping[str, str]]
    """Keys of each point, by the name of the point."""
    problems: tuple[Problem, ...]
    """Rows that were not read."""
    unused: tuple[str, ...]
    """Titles of columns without meaning here."""


def read_vendor_table(path: Path, address: str = "{}", add: int = 0, order: str | None = None) -> Imported:
    """Return the points of a register list.

    `address`: form of an address, in which `{}` stands for the number; `add`: added to the number; `order`: byte order
    of numbers that take several words.

    Raises DefinitionError for a file that is no table, or has no columns for names and addresses.
    """
    start = Position(str(path), 1, 1)
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError:
        text = path.read_bytes().decode("cp1252", "replace")
    except OSError as error:
        raise DefinitionError([Problem(start, f"the table cannot be read: {error}", "name another file")]) from None
    try:
        table = list(numbered_rows(csv.reader(io.StringIO(text, newline=""), delimiter=_delimiter(text))))
    except csv.Error as error:
        raise DefinitionError([Problem(start, f"the table cannot be read: {error}", "give a table")]) from None
    rows = [row for _, row in table]
    at = next((number for number, row in enumerate(rows) if _keys(row).keys() >= {"address"}), None)
    if at is None:
        known = ", ".join(COLUMNS["address"][:4])
        raise DefinitionError([Problem(start, "no row names a column for addresses", f"call one of them {known}")])
    columns = _keys(rows[at])
    naming = "name" if "name" in columns else "about"
    if naming not in columns:
        known = ", ".join(COLUMNS["name"][:4])
        raise DefinitionError([Problem(start, "no column has the names of the points", f"call one of them {known}")])
    points: dict[str, dict[str, str]] = {}
    problems: list[Problem] = []
    for number, row in table[at + 1 :]:
        cells = {key: row[column].strip() for key, column in columns.items() if column < len(row)}
        if not cells.get("address"):
            continue  # a heading between the rows, or an empty one
        line = Position(str(path), number, 1)
        try:
            name, keys = _point(cells, naming, address, add)
        except ValueError as error:
            problems.append(Problem(line, str(error)))
            continue
        if order is not None and any(keys.get("type", "").endswith(bits) for bits in ("32", "64")):
            keys["order"] = order
        if name in points:
            problems.append(Problem(line, f"there is a point '{name}' already"))
        else:
            points[name] = keys
    unused = tuple(cell for column, cell in enumerate(rows[at]) if cell.strip() and column not in columns.values())
    return Imported(points, tuple(problems), unused)


class TableRows(Protocol):
    """The interface of `csv.reader`."""

    line_num: int

    def __iter__(self) -> Iterator[list[str]]: ...


def numbered_rows(rows: TableRows) -> Iterator[tuple[int, list[str]]]:
    """Yield the rows of a table, each with the number of its first line: a cell may have several lines."""
    line = 1
    for row in rows:
        yield line, row
        line = rows.line_num + 1


def _delimiter(text: str) -> str:
    """Return the separator of cells: `;`, tab or `,`, whichever occurs most often in the first lines."""
    head = text.splitlines()[:20]
    return max((";", "\t", ","), key=lambda sign: sum(line.count(sign) for line in head))


def _folded(text: str) -> str:
    return " ".join(re.findall(r"[a-z0-9]+", text.lower()))


def _keys(row: Sequence[str]) -> dict[str, int]:
    """Return the column of each key of a point; the first of several."""
    found: dict[str, int] = {}
    for column, cell in enumerate(row):
        for key, names in COLUMNS.items():
            folded = _folded(cell)
            if folded in names or (key == "address" and folded.endswith((" address", " register"))):
                found.setdefault(key, column)
    return found


def _point(cells: Mapping[str, str], naming: str, address: str, add: int) -> tuple[str, dict[str, str]]:
    """Return the name and the keys of a point. Raises ValueError for a row that cannot be read."""
    name = label_of(cells.get(naming, ""))
    if not name:
        raise ValueError(f"'{cells.get(naming, '')}' has no letters or digits for a name")
    keys = {"address": _address(cells["address"], address, add)}
    if type_ := cells.get("type"):
        keys["type"] = _type(type_)
        if keys["type"] == "string":
            keys["size"] = _digits(cells.get("size", ""))
    for key in ("scale", "offset"):
        if text := cells.get(key):
            number = _number(text, key)
            if number != (1 if key == "scale" else 0):
                keys[key] = f"{number:f}"
    if (unit := cells.get("unit")) and unit not in ("-", "–", "n/a"):
        keys["unit"] = unit
    if access := cells.get("access"):
        if _folded(access) not in _ACCESS:
            raise ValueError(f"'{access}' does not say whether it may be written")
        if _ACCESS[_folded(access)] == "rw":
            keys["access"] = "rw"
    if naming != "about" and (about := cells.get("about")):
        keys["about"] = " ".join(about.split())
    return name, keys


def label_of(text: str) -> str:
    """Convert a text to a valid name of a point or a file of points; '' if no character is usable."""
    return re.sub(r"[^A-Za-z0-9_.-]+", "_", text).strip("_.-")


def _address(text: str, form: str, add: int) -> str:
    """Return the first number of `40001`, `0x10`, `10h` or `40001-40002` in the given form; the text unchanged if no
    form is requested. Raises ValueError.
    """
    first = re.split(r"\s*(?:-|–|\.\.|…)\s*", text, maxsplit=1)[0]
    if form == "{}" and not add:
        return first
    match = _PLACE.fullmatch(first)
    if match is None:
        raise ValueError(f"'{text}' is no number of a register")
    number = int(match["x"] or match["h"], 16) if match["plain"] is None else int(match["plain"])
    return form.replace("{}", str(number + add))


def _type(text: str) -> str:
    folded = _folded(text)
    plain = re.sub(r"\s*bits?$", "", folded)
    for name in (folded, plain, plain.replace(" ", ""), folded.replace("integer", "int").replace(" ", "")):
        if name in TYPES:
            return TYPES[name]
    raise ValueError(f"'{text}' is no type that is known here")


def _digits(text: str) -> str:
    if not text.isdecimal() or not int(text):
        raise ValueError("nothing says how many characters the text has")
    return text


def _number(text: str, key: str) -> Decimal:
    """Parse `0.1`, `0,1`, `1/10` or `x0.1`. Raises ValueError."""
    if re.search(r"[1-9][0-9]{0,2},[0-9]{3}(?![0-9])", text):
        raise ValueError(f"'{text}' may be a {key} of thousands or a fraction")
    plain = text.lower().lstrip("x*× ").replace(",", ".")
    over, slash, under = plain.partition("/")
    try:
        number = Decimal(over) / Decimal(under) if slash else Decimal(over)
    except (InvalidOperation, ZeroDivisionError):
        raise ValueError(f"'{text}' is no {key}") from None
    if not number.is_finite() or (not number and key == "scale"):
        raise ValueError(f"'{text}' is no {key}")
    return number
