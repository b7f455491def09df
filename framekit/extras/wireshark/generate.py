"""Generate a Wireshark dissector from a definition: one Lua file, and the list of parts that are left out.

The file contains the values, forms and reader modules of this package unchanged, the frames of the definition as
tables, and finally the dissector.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from framekit.codec.evaluate import EVALUATION_ERRORS, MissingName, start_values
from framekit.codec.functions import of_side
from framekit.codec.python.choices import fixed_bytes
from framekit.codec.python.diagnosis import checks_option
from framekit.codec.python.expressions import FieldScope, NameEntry
from framekit.codec.python.module import Module
from framekit.definition.expression import Expression, names_in
from framekit.definition.model.frames import WIRE, Frame, everything
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.sections import Parameter
from framekit.definition.model.segments import Inner, Nested
from framekit.definition.model.values import Table
from framekit.definition.problems import CannotSayError, Problem
from framekit.extras.wireshark.expressions import LuaExpressions, constant
from framekit.extras.wireshark.fields import FilterField, FilterFields
from framekit.extras.wireshark.segments import Checks, Entries, SegmentWriter
from framekit.extras.wireshark.source import comment, flag, identifier, listed, string, table, utf8

_UINT32 = 0xFFFF_FFFF
_PREFERENCES = ("number", "flag", "choice", "text")
"""The types of parameters that Wireshark's preferences can show."""
_FEW = 200
"""A byte with more possible values than this rarely distinguishes frames."""


@dataclass(frozen=True, slots=True)
class Dissector:
    """A generated dissector."""

    source: str
    """The Lua file."""
    prefix: str
    """The prefix of its field names."""
    left_out: tuple[tuple[Problem, tuple[str, ...]], ...]
    """The parts without a Lua form, each with the frames that contain it."""


@cache
def _part(name: str) -> str:
    return Path(__file__).with_name(f"{name}.lua").read_text(encoding="ascii")


def prefix_of(protocol: Protocol) -> str:
    """Return the prefix of a protocol's field names."""
    return f"fk_{identifier(protocol.name)}"


def preference_of(parameter: Parameter) -> str:
    """Return the name of a parameter in Wireshark's preferences, without `prefix_of` and the point."""
    return f"set_{identifier(parameter.name)}"


def generate_dissector(protocol: Protocol, given: Any = None) -> Dissector:
    """Return the dissector of a protocol. `given`: parameters and state by name; default: the definition's."""
    return _DissectorWriter(protocol, start_values(protocol) if given is None else given).write()


class _DissectorWriter:
    """Assemble the dissector of a protocol."""

    def __init__(self, protocol: Protocol, given: Any) -> None:
        self.protocol = protocol
        self.given = given
        self.module = Module(protocol)
        self.expressions = LuaExpressions(protocol)
        self.checks = Checks(self.expressions)
        self.fields = FilterFields(prefix_of(protocol))
        self.left_out: dict[Problem, list[str]] = {}

    def write(self) -> Dissector:
        frames = [self._frame(frame) for frame in self.protocol.frames.values()]
        places, fields = self.fields.all()
        about = f"{self.protocol.name}: {self.protocol.about}"
        lines = [
            comment(f"Wireshark's dissector for {about}"),
            comment("Made by framekit from the definition; make it anew rather than change it."),
            "",
            _part("values"),
            _part("forms"),
            _part("reader"),
            comment("---- the definition " + "-" * 95),
            "",
            f"local methods = {listed(self.checks.lines.values())}",
            *frames,
            *self._names(),
            f"R.places = {listed(str(places[number]) for number in sorted(places))}",
            f"R.fields = {listed(map(_field, fields))}",
            f"R.protocol = {self._protocol()}",
            "",
            _part("dissector"),
        ]
        left_out = tuple((problem, tuple(names)) for problem, names in self.left_out.items())
        return Dissector("\n".join(lines), prefix_of(self.protocol), left_out)

    def _protocol(self) -> str:
        protocol = self.protocol
        sides = {
            side: of_side(protocol.frames, None if side == "any" else side) for side in ("any", "client", "server")
        }
        return table(
            {
                "name": string(prefix_of(protocol)), "label": utf8(protocol.name), "about": utf8(protocol.about),
                "tcp": None if protocol.line.tcp is None else str(protocol.line.tcp),
                **{side: listed(map(string, names)) for side, names in sides.items()},
                "params": listed(filter(None, map(self._preference, self.protocol.params.values()))),
            }
        )  # fmt: skip

    def _preference(self, parameter: Parameter) -> str | None:
        """Return the preference for a parameter that frames depend on, or None.

        Secrets and formulas have no preference.
        """
        try:
            value = self.given[parameter.name]
        except (*EVALUATION_ERRORS, MissingName):
            return None  # a preference always has a value, so only `--set` can set this parameter
        low, high = parameter.limits or (0, _UINT32)
        fits = parameter.type != "number" or (isinstance(value, int) and 0 <= low <= value <= high <= _UINT32)
        is_asked = parameter.name in self.expressions.asked and parameter.type in _PREFERENCES and fits
        if not is_asked or parameter.secret or parameter.is_ is not None:
            return None
        return table(
            {
                "name": string(parameter.name), "key": string(preference_of(parameter)),
                "kind": string(parameter.type), "doc": utf8(parameter.doc),
                "of": listed(map(string, parameter.choices)) if parameter.choices else None,
                **({"low": str(low), "high": str(high)} if parameter.type == "number" else {}),
            }
        )  # fmt: skip

    def _frame(self, frame: Frame) -> str:
        writer = SegmentWriter(self.module, frame, self.expressions, self.checks, self.fields)
        whole = writer.whole()
        for problem in [*self.expressions.problems, *writer.unverified]:
            self.left_out.setdefault(problem, []).append(frame.name)
        # `_echo` and `_announces` below do not leave anything out of the frame itself
        self.expressions.problems.clear()
        segments = writer.segments
        size = self.module.static.all(segments).fixed
        checks = checks_option(segments)
        ends = any(isinstance(one, (Inner, Nested)) for one in everything(segments))
        entries: Entries = {
            "name": string(frame.name), **whole, "size_known": None if size is None else str(size),
            "looks_inside": flag(ends), "has_check": flag(checks), "checks": flag(checks),
            "most": None if frame.most is None else str(frame.most), "side": string(frame.side),
            "surplus": None if frame.surplus is None else str(frame.surplus),
            "refuse": None if frame.refuse is None else str(frame.refuse), "fixed": self._fixed(frame),
            "echo": self._echo(writer, frame), "announces": self._announces(writer, frame),
        }  # fmt: skip
        self.expressions.problems.clear()
        return f"R.add({table(entries)})"

    def _echo(self, writer: SegmentWriter, frame: Frame) -> str | None:
        """Return the fields that a reply must repeat, each with a function of the request's fields.

        None if there are none.
        """
        echo = ((string(name), self._of_request(expression)) for name, expression in frame.echo.items())
        return listed(f"{{ {name}, {text} }}" for name, text in echo) if frame.echo else None

    def _of_request(self, expression: Expression) -> str:
        scope = FieldScope()
        scope.entries |= {name: NameEntry("") for name in names_in(expression.root)}
        return self.expressions.function(expression, scope)

    def _announces(self, writer: SegmentWriter, frame: Frame) -> str | None:
        """Return the state that a frame announces for later frames, each with a function of the frame's fields.

        None if it announces no state.
        """
        told = []
        for one in frame.announces:
            if one.key is not None or WIRE in names_in(one.value.root):
                why = f"'{one.name}', which an earlier frame has told"
                text = f"function() X.limit({string(why)}) end"
            else:
                text = self.expressions.function(one.value, writer.scope)
            told.append(f"{{ {string(one.name)}, {text} }}")
        return listed(told) if told else None

    def _fixed(self, frame: Frame) -> str:
        """Return the bytes that distinguish the frame: offsets and possible values."""
        found = ((place, values) for place, values in fixed_bytes(self.module.static.segments(frame)))
        few = [(place, bytes(sorted(values))) for place, values in found if len(values) <= _FEW]
        return listed(f"{{ {place}, {string(values)} }}" for place, values in few)

    def _names(self) -> list[str]:
        """Return the start values of parameters and state that expressions read, and the tables."""
        lines = []
        for name in sorted(self.expressions.asked):
            try:
                lines.append(f"R.given[{string(name)}] = {constant(self.given[name], self.protocol.at)}")
            except (*EVALUATION_ERRORS, MissingName, CannotSayError):
                continue  # the missing value is reported where the name is read
        for name in sorted(self.expressions.tables):
            try:
                lines.append(f"R.tables[{string(name)}] = {_table(self.protocol.tables[name])}")
            except CannotSayError as error:
                self.left_out.setdefault(error.problem, [])
        return lines


def _table(of: Table) -> str:
    entries = ", ".join(f"[{constant(key, of.at)}] = {_entry(value, of)}" for key, value in of.entries.items())
    ranges = (f"{{ {first}, {last}, {_entry(value, of)} }}" for first, last, value in of.ranges)
    return f"{{ entries = {{ {entries} }}, ranges = {listed(ranges)} }}"


def _entry(value: Any, of: Table) -> str:
    return constant(dict(value) if isinstance(value, Mapping) else value, of.at)


def _field(field: FilterField) -> str:
    values = ", ".join(f"[{number}] = {utf8(name)}" for number, name in field.use.values)
    return table(
        {
            "filter": string(field.filter), "label": utf8(field.label), "kind": string(field.use.kind),
            "values": f"{{ {values} }}" if values else None, "doc": utf8(field.doc) if field.doc else None,
        }
    )  # fmt: skip
