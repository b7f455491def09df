"""Names of a definition: entries of its own sections, of its application's, and of the files it uses."""

from __future__ import annotations

from dataclasses import dataclass, replace

from framekit.definition.keys import Meanings
from framekit.definition.load.documents import SourceText, scalar_of
from framekit.definition.load.reader import Broken, Reader, parse_key, parse_number
from framekit.definition.model.checks import WIDEST, CheckMethod, ready_methods
from framekit.definition.model.values import Table, TableValue
from framekit.definition.nodes import Entry, Mapping, Node, Sequence
from framekit.definition.problems import Position, did_you_mean


def load_table(reader: Reader, entry: Entry) -> Table:
    """Return a table; keys are numbers, texts or ranges `1200-19200`."""
    entries: dict[int | str, TableValue] = {}
    ranges: list[tuple[int, int, TableValue]] = []
    for row in reader.entries(entry.value):
        with reader.going_on():
            value = _table_value(reader, row.value)
            low, dash, high = row.key.text.partition("-")
            if dash and low.strip().isdecimal() and high.strip().isdecimal():
                with reader.refusing(row.key.at):
                    first, last = parse_number(low), parse_number(high)
                if first > last:
                    reader.note(row.key.at, f"the range {row.key.text} is empty", f"write {high}-{low}")
                ranges.append((first, last, value))
            else:
                key = parse_key(row.key.text)
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
    """Read `{method: sum8, complement: twos}`, `{fold: EXPR, initial: N}` or the parameters of a CRC. Raises Broken."""
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
    if (code := node.get("code")) is not None:
        width = reader.maybe(reader.number, node.get("width")) or WIDEST
        return CheckMethod(name=name, kind="code", width=width, expression=reader.expression(code))
    if node.get("poly") is not None:
        return _crc(reader, name, node)
    method = reader.text(node.get("method"))
    if method not in ready_methods():
        at = node.get("method")
        assert at is not None
        raise reader.broken(at.at, f"there is no check method '{method}'", did_you_mean(method, ready_methods()))
    return _adjusted(reader, name, method, node)


def _adjusted(reader: Reader, name: str, method: str, node: Mapping) -> CheckMethod:
    ready = ready_methods()[method]
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


@dataclass(frozen=True, slots=True)
class Owned:
    """An entry of a section and its source; `inner` if the source is the application of a protocol."""

    entry: Entry
    source: SourceText
    inner: bool


class Namespace:
    """Name lookup for the loaders, one for every source; used files have their own.

    `circles`: layouts that include each other, `too_much`: whether includes of too many segments have been reported.
    `too_large`: the layouts with too many segments. `twice`: names that both a protocol and its application define,
    which are ambiguous.
    """

    def __init__(self, reader: Reader, source: SourceText) -> None:
        self.reader = reader
        self.space = self  # tables of keys are read by it too
        self.source = source
        self.uses = {name: Namespace(reader, used) for name, used in self._used()}
        self.circles: set[frozenset[str]] = set()
        self.too_much = False
        self.too_large: set[Position] = set()
        self.twice: set[str] = set()
        self._tables: dict[str, Table | None] = {}
        self._checks: dict[str, CheckMethod | None] = {}
        self._sections: dict[str, dict[str, Owned]] = {}
        self._little = self._saying("order", "little")
        self._turned = self._saying("conversions", "by_direction")

    def _sources(self) -> list[SourceText]:
        application = self.source.application
        return [self.source, application] if application else [self.source]

    def _used(self) -> list[tuple[str, SourceText]]:
        return [item for source in self._sources() for item in source.uses.items()]

    def _saying(self, key: str, word: str) -> set[str]:
        """Return the files in which a key has this value."""
        return {file for one in self._sources() if scalar_of(one.root.get(key)) == word for file in one.files}

    def turns_conversions(self, file: str) -> bool:
        """Return whether names of conversions in `file` are relative to the direction of the frame."""
        return file in self._turned

    def order(self, file: str) -> str:
        """Return the byte order of numbers in `file`."""
        return "little" if file in self._little else "big"

    def section(self, key: str) -> dict[str, Owned]:
        """Return the entries of a section by name, the definition's own first, then its application's."""
        if key not in self._sections:
            found: dict[str, Owned] = {}
            for source in self._sources():
                inner = source is not self.source
                for entry in source.section(key):
                    if entry.key.text in found and key in ("frames", "groups", "layouts", "sequences"):
                        at = found[entry.key.text].entry.key.at
                        what = f"'{entry.key.text}' stands in the protocol and in its application"
                        self.reader.note(at, what, "give one of them another name")
                        self.twice.add(entry.key.text)
                    found.setdefault(entry.key.text, Owned(entry, source, inner))
            self._sections[key] = found
        return self._sections[key]

    def of_application(self, key: str, name: str) -> Owned | None:
        """Return an entry of a section of the application, also if the definition has one of that name."""
        source = self.source.application
        if source is None:
            return None
        return next((Owned(entry, source, True) for entry in source.section(key) if entry.key.text == name), None)

    def elsewhere(self, name: str) -> tuple[str, Namespace] | None:
        """Return name and namespace for `FILE.name`: of a used file or of this definition's application; else
        None.
        """
        prefix, dot, rest = name.partition(".")
        if not dot:
            return None
        if prefix in self.uses:
            return rest, self.uses[prefix]
        application = self.source.application
        if (application is not None and prefix in application.names) or prefix in self.source.names:
            return rest, self
        return None

    def layout(self, node: Node) -> tuple[Sequence, Meanings]:
        """Return the segments of a layout and the namespace in which they are read. Raises Broken."""
        name = self.reader.text(node)
        space: Namespace = self
        layouts = space.section("layouts")
        if name not in layouts and (found := self.elsewhere(name)) is not None:
            name, space = found
            layouts = space.section("layouts")
        if name not in layouts:
            having = [used for used, one in self.uses.items() if name in one.section("layouts")]
            hint = f"write {having[0]}.{name}" if having else did_you_mean(name, layouts) or "add it to layouts:"
            raise self.reader.broken(node.at, f"there is no layout '{name}'", hint)
        return self.reader.sequence(layouts[name].entry.value), space

    def table(self, name: str) -> Table | None:
        """Return a table of this namespace, or `FILE.table` of a used file, or None."""
        if name not in self._tables:
            owned = self.section("tables").get(name)
            if owned is None and (found := self.elsewhere(name)) is not None and found[1] is not self:
                return found[1].table(found[0])
            self._tables[name] = None
            if owned is not None:
                with self.reader.going_on():
                    self._tables[name] = load_table(self.reader, owned.entry)
        return self._tables[name]

    def check(self, node: Node) -> CheckMethod:
        """Return a check method of this definition or a ready one. Raises Broken."""
        name = self.reader.text(node)
        own = self.section("checks")
        if name in own:
            if name not in self._checks:
                self._checks[name] = None
                self._checks[name] = load_check(self.reader, own[name].entry)
            method = self._checks[name]
            if method is None:
                raise Broken(name)
            return method
        ready = ready_methods()
        if name not in ready:
            raise self.reader.broken(node.at, f"there is no check '{name}'", did_you_mean(name, [*own, *ready]))
        return ready[name]


def used_entries(space: Namespace, section: str) -> dict[str, tuple[Namespace, Owned]]:
    """Return the entries of a section in the files used, also indirectly; the nearest wins."""
    found: dict[str, tuple[Namespace, Owned]] = {}
    for used in space.uses.values():
        for name, owned in used.section(section).items():
            found.setdefault(name, (used, owned))
    for used in space.uses.values():
        for name, entry in used_entries(used, section).items():
            found.setdefault(name, entry)
    return found
