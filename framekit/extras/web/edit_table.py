"""Tables of the editor: blocks and points of a file as rows that can be filled in, written back into its text.

Only the characters of a changed value are replaced, by the positions of the parsed text, so that comments, quotes and
the order of keys stay. After every change the new text is parsed and compared with the intended content.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from framekit.definition import tree
from framekit.definition.nodes import read_text
from framekit.definition.problems import DefinitionError
from framekit.definition.sources import edited_text
from framekit.definition.tree import Scalar
from framekit.run.triggers import TRIGGERS
from framekit.runfile.blocks import INSTRUCTIONS

Answer = dict[str, Any]
Where = list[str]
"""The path of a section: keys from the root."""

MOST_ROWS = 2_000
"""Largest number of rows of a table."""
LONGEST_CELL = 300
"""Largest number of characters of a cell."""
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_BREAK = re.compile("\r\n|[\n\r\x85\u2028\u2029]")


class TableColumn(NamedTuple):
    """A column: its title, and the keys of a row that it shows, of which a row has one."""

    title: str
    keys: tuple[str, ...]


BLOCK_COLUMNS = (
    TableColumn("Kind and address", INSTRUCTIONS),
    TableColumn("Channel", ("channel",)),
    TableColumn("Station", ("station",)),
    TableColumn("Size", ("count",)),
    TableColumn("Own address", ("into", "from", "values")),
    TableColumn("Condition", tuple(TRIGGERS)),
    TableColumn("Unless", ("unless",)),
    TableColumn("Name", ("name",)),
)
POINT_COLUMNS = tuple(
    TableColumn(key.capitalize(), (key,))
    for key in ("address", "channel", "station", "type", "scale", "unit", "every", "access", "range")
)


class TableError(ValueError):
    """A change that cannot be made; the text gives the reason."""


class Section(NamedTuple):
    """A mapping of rows in a file, with the columns of its table."""

    where: Where
    columns: Sequence[TableColumn]
    node: yaml.MappingNode | None
    """None for a section that the file does not have yet, or that is empty."""


# ---- the text and its nodes ----------------------------------------------------------------------------------


class EditedText:
    """A text with its nodes. Raise TableError for a text that is no valid YAML."""

    def __init__(self, path: Path) -> None:
        self.text = edited_text(path) or ""
        self.file = path.name
        try:
            self.plain = _plain(read_text(self.text, self.file, []))
            self.root = yaml.compose(self.text, Loader=_LOADER)
        except (DefinitionError, yaml.YAMLError):
            raise TableError("correct the errors of the text first") from None
        self._starts = [0, *(match.end() for match in _BREAK.finditer(self.text))]

    def begin(self, node: yaml.Node) -> int:
        """Return the offset of the first character of a node."""
        return self._at(node.start_mark)

    def end(self, node: yaml.Node) -> int:
        """Return the offset after the last character of a node, without comments and blank space after it."""
        if isinstance(node, yaml.CollectionNode) and not node.flow_style and node.value:
            last = node.value[-1]
            return max(self.end(last[0]), self.end(last[1])) if isinstance(last, tuple) else self.end(last)
        end = self._at(node.end_mark)
        return self.begin(node) + len(self.text[self.begin(node) : end].rstrip())

    def _at(self, mark: Any) -> int:
        return min(self._starts[int(mark.line)] + int(mark.column), len(self.text))

    def line_start(self, offset: int) -> int:
        return max(start for start in self._starts if start <= offset)

    def line_end(self, offset: int) -> int:
        """Return the offset of the end of the line, before its line break."""
        match = _BREAK.search(self.text, offset)
        return len(self.text) if match is None else match.start()

    def indent(self, offset: int) -> str:
        """Return the blank space between the start of the line and an offset."""
        return " " * (offset - self.line_start(offset))


def _plain(node: tree.Node) -> Any:
    """Return a tree of nodes as dicts, lists and texts."""
    if isinstance(node, Scalar):
        return node.text
    if isinstance(node, tree.Mapping):
        return {entry.key.text: _plain(entry.value) for entry in node.entries}
    return [_plain(item) for item in node.items]


def _value(node: yaml.Node | None, key: str) -> yaml.Node | None:
    """Return the value of a key of a mapping."""
    pairs = node.value if isinstance(node, yaml.MappingNode) else ()
    return next((value for name, value in pairs if name.value == key), None)


def _pair(node: yaml.MappingNode, key: str) -> int | None:
    """Return the place of a key in a mapping."""
    return next((place for place, (name, _) in enumerate(node.value) if name.value == key), None)


# ---- tables --------------------------------------------------------------------------------------------------


def tables(path: Path) -> list[Answer]:
    """Return the tables of a file: path of the section, title, columns and rows; empty for a wrong text."""
    try:
        source = EditedText(path)
    except TableError:
        return []
    return [_table(source, section) for section in _sections(source)]


def _sections(source: EditedText) -> Iterator[Section]:
    root = source.root
    if not isinstance(root, yaml.MappingNode):
        return
    if _value(root, "run") is not None:
        yield _section(root, ["blocks"], BLOCK_COLUMNS)
        sets = _value(root, "sets")
        for name, _ in sets.value if isinstance(sets, yaml.MappingNode) else ():
            yield _section(root, ["sets", name.value, "blocks"], BLOCK_COLUMNS)
        points = _value(root, "points")
        if points is None or isinstance(points, yaml.MappingNode):
            yield _section(root, ["points"], POINT_COLUMNS)
    elif _value(root, "points") is not None:
        yield _section(root, ["values"], POINT_COLUMNS)


def _section(root: yaml.Node, where: Where, columns: Sequence[TableColumn]) -> Section:
    node: yaml.Node | None = root
    for key in where:
        node = _value(node, key)
    return Section(where, columns, node if isinstance(node, yaml.MappingNode) else None)


def _table(source: EditedText, section: Section) -> Answer:
    pairs = [] if section.node is None else section.node.value[:MOST_ROWS]
    return {
        "where": section.where,
        "columns": [[column.title, list(column.keys)] for column in section.columns],
        "rows": [_row(source, section.columns, name, value) for name, value in pairs],
    }


def _row(source: EditedText, columns: Sequence[TableColumn], name: yaml.Node, value: yaml.Node) -> Answer:
    """Return name, line, cells (key, text, whether it can be changed here) and the text of other keys."""
    shown = {key for column in columns for key in column.keys}
    pairs = {key.value: one for key, one in value.value} if isinstance(value, yaml.MappingNode) else {}
    cells = []
    for column in columns:
        key = next((key for key in column.keys if key in pairs), "")
        cells.append([key, *_cell(source, pairs[key])] if key else ["", "", True])
    other = ", ".join(f"{key}: {_cell(source, one)[0]}" for key, one in pairs.items() if key not in shown)
    return {"name": name.value, "line": name.start_mark.line + 1, "cells": cells, "other": other[:LONGEST_CELL]}


def _cell(source: EditedText, node: yaml.Node) -> tuple[str, bool]:
    """Return the text of a value, and whether it can be changed in a table."""
    if isinstance(node, yaml.ScalarNode):
        text = str(node.value)
        return text[:LONGEST_CELL], len(text) <= LONGEST_CELL and "\n" not in text and node.style not in ("|", ">")
    text = source.text[source.begin(node) : source.end(node)]
    is_short = len(text) <= LONGEST_CELL and "\n" not in text
    is_flow = isinstance(node, yaml.CollectionNode) and bool(node.flow_style)
    return " ".join(text.split())[:LONGEST_CELL], is_short and is_flow


# ---- changes -------------------------------------------------------------------------------------------------


class TextEdit(NamedTuple):
    """Characters of the text that are replaced."""

    begin: int
    end: int
    text: str


def change(path: Path, where: Where, row: str, key: str, old: str, value: str) -> Answer:
    """Return the edits that set a value of a row: `key` replaces the key `old` (one of them may be '').

    With an empty value the key is removed. The row is added if the section does not have it.
    """
    return _answered(path, lambda source: _changed(source, where, row, key, old, value))


def remove(path: Path, where: Where, row: str) -> Answer:
    """Return the edits that remove a row."""
    return _answered(path, lambda source: _removed(source, where, row))


def _answered(path: Path, make: Callable[[EditedText], tuple[list[TextEdit], Any]]) -> Answer:
    try:
        source = EditedText(path)
        edits, intended = make(source)
        _validate(source, edits, intended)
    except TableError as error:
        return {"why": str(error)}
    units = source.text.encode("utf-16-le", "surrogatepass")
    is_plain = len(units) == 2 * len(source.text)

    def unit(offset: int) -> int:
        """Return an offset as a browser counts: in UTF-16 code units."""
        return offset if is_plain else len(source.text[:offset].encode("utf-16-le", "surrogatepass")) // 2

    return {"edits": [[unit(edit.begin), unit(edit.end), edit.text] for edit in edits]}


def _validate(source: EditedText, edits: Sequence[TextEdit], intended: Any) -> None:
    """Raise TableError if the edits do not give exactly the intended content."""
    text = source.text
    for edit in sorted(edits, reverse=True):
        text = text[: edit.begin] + edit.text + text[edit.end :]
    try:
        found = _plain(read_text(text, source.file, []))
    except DefinitionError:
        found = None
    if found != intended:
        raise TableError("this cannot be changed in the table – change the text")


def _changed(source: EditedText, where: Where, row: str, key: str, old: str, value: str) -> tuple[list[TextEdit], Any]:
    section = _found(source, where)
    if key not in {one for column in section.columns for one in column.keys} or len(value) > LONGEST_CELL:
        raise TableError("this is no value of the table")
    written = _written(value)
    intended = json.loads(json.dumps(source.plain))
    rows = _inside(intended, where)
    if rows is None or row not in rows:
        if not written:
            raise TableError("write a value")
        _put(intended, where, row, {key: _read(written)})
        return [_new_row(source, section, row, f"{key}: {written}")], intended
    mapping = _value(section.node, row)
    if not isinstance(mapping, yaml.MappingNode) or not mapping.value:
        raise TableError("this row is no mapping – change the text")
    cells = rows[row]
    if old and old != key and key in cells:
        raise TableError(f"this row has '{key}' already")
    place = _pair(mapping, old or key)
    if place is None:
        if not written:
            raise TableError("write a value")
        cells[key] = _read(written)
        return [_added(source, mapping, f"{key}: {written}")], intended
    if not written:
        if len(mapping.value) == 1:
            raise TableError("this is the only value of the row – remove the row")
        del cells[old or key]
        return [_without(source, mapping, place)], intended
    rows[row] = {(key if name == old else name): one for name, one in cells.items()} if old else cells
    rows[row][key] = _read(written)
    name, present = mapping.value[place]
    edits = [TextEdit(source.begin(name), source.end(name), key)] if old and old != key else []
    if isinstance(present, yaml.ScalarNode) and present.style in ("'", '"') and written == value.strip():
        written = json.dumps(value.strip(), ensure_ascii=False) if not _is_flow(written) else written
    if source.begin(present) == source.end(present):
        written = f" {written}"
    return [*edits, TextEdit(source.begin(present), source.end(present), written)], intended


def _found(source: EditedText, where: Where) -> Section:
    section = next((one for one in _sections(source) if one.where == where), None)
    if section is None:
        raise TableError("the file has no such table")
    return section


def _inside(content: Any, where: Where) -> dict[str, Any] | None:
    """Return the rows of a section of a plain tree."""
    for key in where:
        content = content.get(key) if isinstance(content, dict) else None
    return content if isinstance(content, dict) else None


def _put(content: dict[str, Any], where: Where, row: str, value: Mapping[str, Any]) -> None:
    for key in where:
        below = content.get(key)
        if not isinstance(below, dict):
            below = content[key] = {}
        content = below
    content[row] = dict(value)


def _is_flow(text: str) -> bool:
    return text.startswith(("[", "{"))


def _written(value: str) -> str:
    """Return a value as YAML for a mapping in braces: a list or mapping as it is, a text in quotes if it needs them.

    Raise TableError for a list that is not valid.
    """
    if not value.isprintable():
        raise TableError("write the value on one line")
    value = value.strip()
    if _is_flow(value):
        try:
            _read(value)
        except (yaml.YAMLError, TableError):
            raise TableError("write a list as [a, b]") from None
        return value
    try:
        is_plain = not value or _read(value) == value
    except (yaml.YAMLError, TableError):
        is_plain = False
    return value if is_plain else json.dumps(value, ensure_ascii=False)


def _read(written: str) -> Any:
    """Return the plain content of a value. Raise TableError for a text that is more than a value."""
    try:
        found = _plain(read_text(f"{{k: {written}}}", "a value", []))
    except DefinitionError:
        raise TableError("this is no value") from None
    if not isinstance(found, dict) or list(found) != ["k"]:
        raise TableError("this is no value")
    return found["k"]


def _added(source: EditedText, mapping: yaml.MappingNode, pair: str) -> TextEdit:
    """Return the edit that adds a key to a mapping, which is not empty."""
    if mapping.flow_style:
        end = max(source.end(part) for part in mapping.value[-1])
        return TextEdit(end, end, f", {pair}")
    for name, value in reversed(mapping.value):
        if isinstance(value, yaml.ScalarNode) and value.style not in ("|", ">"):
            end = source.line_end(max(source.end(name), source.end(value)))
            return TextEdit(end, end, f"\n{source.indent(source.begin(name))}{pair}")
    begin = source.begin(mapping.value[0][0])
    return TextEdit(begin, begin, f"{pair}\n{source.indent(begin)}")


def _without(source: EditedText, mapping: yaml.MappingNode, place: int) -> TextEdit:
    """Return the edit that removes a key of a mapping with several keys."""
    name, value = mapping.value[place]
    begin, end = source.begin(name), max(source.end(name), source.end(value))
    if not mapping.flow_style:
        return TextEdit(*_lines(source, begin, end), "")
    if place + 1 < len(mapping.value):
        return TextEdit(begin, source.begin(mapping.value[place + 1][0]), "")
    before = max(source.end(part) for part in mapping.value[place - 1])
    if "#" in source.text[before:begin]:
        raise TableError("a comment is next to it – change the text")
    return TextEdit(before, end, "")


def _lines(source: EditedText, begin: int, end: int) -> tuple[int, int]:
    """Return the range of the whole lines between two offsets, with the last line break."""
    first, last = source.line_start(begin), source.line_end(end)
    if source.text[first:begin].strip():
        raise TableError("the line has other keys – change the text")
    match = _BREAK.match(source.text, last)
    return first, last if match is None else match.end()


def _new_row(source: EditedText, section: Section, row: str, pair: str) -> TextEdit:
    """Return the edit that adds a row to a section, after its last row; a missing section is added."""
    name = _written(row)
    if not row or _is_flow(name):
        raise TableError("write a name")
    entry = f"{name}: {{{pair}}}"
    node = section.node
    if node is not None and node.value:
        if node.flow_style:
            end = max(source.end(part) for part in node.value[-1])
            return TextEdit(end, end, f", {entry}")
        end = source.line_end(max(source.end(part) for part in node.value[-1]))
        return TextEdit(end, end, f"\n{source.indent(source.begin(node.value[0][0]))}{entry}")
    if node is not None:
        return TextEdit(source.begin(node) + 1, source.begin(node) + 1, entry)
    above, key = source.root, section.where[-1]
    for step in section.where[:-1]:
        above = _value(above, step)
    if not isinstance(above, yaml.MappingNode) or above.flow_style or not above.value:
        raise TableError("write the section into the text first")
    indent = source.indent(source.begin(above.value[0][0]))
    place = _pair(above, key)
    if place is not None:
        end = source.line_end(source.end(above.value[place][0]))
        return TextEdit(end, end, f"\n{indent}  {entry}")
    end = source.line_end(max(source.end(part) for part in above.value[-1]))
    return TextEdit(end, end, f"\n{indent}{key}:\n{indent}  {entry}")


def _removed(source: EditedText, where: Where, row: str) -> tuple[list[TextEdit], Any]:
    section = _found(source, where)
    node = section.node
    place = None if node is None else _pair(node, row)
    if node is None or place is None:
        raise TableError(f"the table has no row '{row}'")
    if len(node.value) == 1:
        raise TableError("this is the last row – remove the section in the text")
    intended = json.loads(json.dumps(source.plain))
    rows = _inside(intended, where)
    assert rows is not None
    del rows[row]
    return [_without(source, node, place)], intended
