"""Tables and check methods of a definition."""

from __future__ import annotations

from dataclasses import replace

from framekit.definition.checks_catalogue import from_ready, ready_methods
from framekit.definition.load import scalars
from framekit.definition.load.reader import Reader
from framekit.definition.model.checks import CheckMethod
from framekit.definition.model.values import Table, TableValue
from framekit.definition.nodes import Entry, Mapping, Node, Sequence
from framekit.definition.problems import did_you_mean


def load_table(reader: Reader, entry: Entry) -> Table:
    """A table; keys are numbers, texts or ranges `1200-19200`."""
    entries: dict[int | str, TableValue] = {}
    ranges: list[tuple[int, int, TableValue]] = []
    for row in reader.entries(entry.value):
        with reader.going_on():
            value = _table_value(reader, row.value)
            low, dash, high = row.key.text.partition("-")
            if dash and low.strip().isdigit() and high.strip().isdigit():
                if int(low) > int(high):
                    reader.note(row.key.at, f"the range {row.key.text} is empty", f"write {high}-{low}")
                ranges.append((int(low), int(high), value))
            else:
                key = scalars.parse_key(row.key.text)
                if key in entries:
                    reader.note(row.key.at, f"the table '{entry.key.text}' has two entries {key}", "remove one of them")
                entries[key] = value
    return Table(entry.key.text, entries, tuple(ranges), entry.key.at)


def _table_value(reader: Reader, node: Node) -> TableValue:
    if isinstance(node, Mapping):
        return {row.key.text: reader.cell(row.value) for row in node.read_all()}
    if isinstance(node, Sequence):
        return tuple(reader.cell(item) for item in node.items)
    return reader.cell(node)


def load_check(reader: Reader, entry: Entry) -> CheckMethod:
    """`{method: sum8, complement: twos}`, `{fold: EXPR, initial: N}` or the parameters of a CRC. Raises Broken."""
    method = _method(reader, entry, reader.mapping(entry.value))
    fault = method.fault()
    if fault is not None:
        raise reader.broken(entry.key.at, f"the check '{entry.key.text}' cannot be computed: {fault}")
    return method


def _method(reader: Reader, entry: Entry, node: Mapping) -> CheckMethod:
    name = entry.key.text
    if (fold := node.get("fold")) is not None:
        initial = reader.maybe(reader.number, node.get("initial")) or 0
        width = reader.maybe(reader.number, node.get("width")) or 8
        return CheckMethod(name=name, kind="fold", width=width, initial=initial, expression=reader.expression(fold))
    if node.get("poly") is not None:
        return _crc(reader, name, node)
    method = reader.text(node.get("method"))
    if method not in ready_methods():
        at = node.get("method")
        assert at is not None
        raise reader.broken(at.at, f"there is no check method '{method}'", did_you_mean(method, ready_methods()))
    return _adjusted(reader, name, method, node)


def _adjusted(reader: Reader, name: str, method: str, node: Mapping) -> CheckMethod:
    ready = from_ready(method)
    complement = reader.maybe(reader.text, node.get("complement"))
    order = reader.maybe(reader.text, node.get("order"))
    changed: dict[str, object] = {"name": name}
    if complement is not None:
        changed["complement"] = None if complement == "none" else complement
    if order is not None:
        changed["order"] = order
    for key in ("initial", "mask", "width"):
        if (value := node.get(key)) is not None:
            changed[key] = reader.number(value)
    return replace(ready, **changed)  # type: ignore[arg-type]


def _crc(reader: Reader, name: str, node: Mapping) -> CheckMethod:
    def number(key: str, default: int) -> int:
        value = node.get(key)
        return default if value is None else reader.number(value)

    return CheckMethod(
        name=name,
        kind="crc",
        width=number("width", 16),
        poly=number("poly", 0),
        initial=number("init", 0),
        refin=reader.flag(node.get("refin")),
        refout=reader.flag(node.get("refout"), default=reader.flag(node.get("refin"))),
        xorout=number("xorout", 0),
    )
