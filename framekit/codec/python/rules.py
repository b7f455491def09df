"""What each value of a frame must be, as a table that generated encoders explain refusals with."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from framekit.codec.python import forms
from framekit.codec.python.module import Module
from framekit.codec.python.source import quoted
from framekit.definition.model.segments import (
    Bits,
    Count,
    Data,
    Field,
    FieldType,
    Inner,
    Length,
    Record,
    Repeat,
    Segment,
    Value,
)
from framekit.definition.model.walk import flat


class RuleWriter:
    """Writes the rules of the values of a list of segments."""

    def __init__(self, module: Module, title: str) -> None:
        self.module = module
        self.title = title
        module.function("Rule")

    def rules(self, segments: tuple[Segment, ...]) -> str:
        """The mapping name → rule, as text."""
        branches = {id(one) for segment in flat(segments) for one in _in_branches(segment)}
        lengths = _lengths(segments)
        found: dict[str, str] = {}
        for segment in flat(segments):
            always = id(segment) not in branches and segment.when is None
            for name, rule in self._of(segment, always, lengths):
                found.setdefault(name, rule)
        return "{" + ", ".join(f"{quoted(name)}: {rule}" for name, rule in found.items()) + "}"

    def _of(self, segment: Segment, always: bool, lengths: Mapping[str, forms.Range]) -> Iterable[tuple[str, str]]:
        match segment:
            case Field():
                yield segment.name, self._field(segment, always, lengths)
            case Length() | Count():
                yield segment.name, self._rule("number", forms.value_range(segment), False)
            case Bits(parts=parts):
                for part in parts:
                    names = "" if part.values is None else self.module.numbers(part.values, f"{self.title} {part.name}")
                    most = (1 << part.high - part.low + 1) - 1
                    yield part.name, self._rule("number", forms.Range(0, most), False, names)
            case Data():
                kind = "digits" if segment.convert == "ascii_to_hex" else "bytes"
                yield segment.name, self._rule(kind, _data_range(segment, lengths), always and segment.pad is None)
            case Repeat():
                yield segment.name, self._repeat(segment, always, lengths)
            case Record(name=name, of=of):
                needed = always and is_needed(of)
                yield name, self._rule("mapping", forms.Range(None, None), needed, inside=self.rules(of))
            case Inner(name=name):
                yield name, self._rule("mapping", forms.Range(None, None), always)
            case Value(name=name):
                yield name, 'Rule("any")'

    def _rule(
        self,
        kind: str,
        limits: forms.Range,
        needed: bool,
        names: str = "",
        inside: str = "",
        only: bool = False,
        unit: int = 1,
    ) -> str:
        parts = [quoted(kind)]
        if limits.least is not None or limits.most is not None:
            parts += [str(limits.least), str(limits.most)]
        if needed:
            parts.append("needed=True")
        if names:
            parts.append(f"names={names}")
        if only:
            parts.append("only=True")
        if unit != 1:
            parts.append(f"unit={unit:_}")
        if inside:
            parts.append(f"inside={inside}")
        return f"Rule({', '.join(parts)})"

    def _field(self, field: Field, always: bool, lengths: Mapping[str, forms.Range]) -> str:
        kind = {"ascii": "text", "bytes": "bytes", "float": "float"}.get(field.type.kind, "number")
        needed = (
            always and field.build is None and field.default is None and field.is_ is None and field.constants is None
        )
        names = "" if field.values is None else self.module.numbers(field.values, f"{self.title} {field.name}")
        if kind in ("text", "bytes"):
            return self._rule(kind, _text_range(field, lengths), needed, names)
        limits = forms.value_range(field) if kind == "number" else forms.Range(*(field.limits or (None, None)))
        return self._rule(kind, limits, needed, names, only=field.only, unit=field.unit or 1)

    def _repeat(self, repeat: Repeat, always: bool, lengths: Mapping[str, forms.Range]) -> str:
        if isinstance(repeat.times, int):
            limits = forms.Range(repeat.times, repeat.times)
        else:
            limits = lengths.get(repeat.name, forms.Range(None, None))
        if isinstance(repeat.of, FieldType):
            kind = {"ascii": "text", "bytes": "bytes", "float": "float"}.get(repeat.of.kind, "number")
            size = repeat.of.fixed_size if kind in ("text", "bytes") else None
            item = forms.Range(None, size) if kind != "number" else forms.wire_range(repeat.of)
            return self._rule("list", limits, always, inside=f'{{"": {self._rule(kind, item, False)}}}')
        return self._rule("list", limits, always, inside=self.rules(repeat.of))


def is_needed(segments: tuple[Segment, ...]) -> bool:
    """Whether anything in these segments has to be given."""
    for segment in segments:
        if segment.when is not None:
            continue
        match segment:
            case Field() if segment.build is None and segment.default is None and segment.is_ is None:
                if segment.constants is None:
                    return True
            case Data(pad=None) | Repeat() | Inner():
                return True
            case Record(of=of):
                if is_needed(of):
                    return True
    return False


def _in_branches(segment: Segment) -> Iterable[Segment]:
    for block in () if segment.is_there_inside else segment.blocks:
        yield from flat(block)


def _lengths(segments: tuple[Segment, ...]) -> dict[str, forms.Range]:
    """How long a value may be because of the one length or count that stands for it alone."""
    found: dict[str, forms.Range] = {}
    for segment in flat(segments):
        limits = forms.value_range(segment) if isinstance(segment, (Length, Count)) else forms.Range(None, None)
        least, most = limits.least, limits.most
        if isinstance(segment, Length) and len(segment.of) == 1 and segment.unit == 1 and segment.plus == 0:
            found[segment.of[0]] = forms.Range(least or None, most)
        if isinstance(segment, Count) and segment.plus == 0:
            found[segment.of] = forms.Range(least or None, most)
    return found


def _data_range(data: Data, lengths: Mapping[str, forms.Range]) -> forms.Range:
    if isinstance(data.size, int):
        return forms.Range(data.least if data.pad is not None else data.size, data.size)
    limits = lengths.get(data.name, forms.Range(None, None)) if data.convert is None else forms.Range(None, None)
    return forms.Range(max(data.least, limits.least or 0) or None, limits.most)


def _text_range(field: Field, lengths: Mapping[str, forms.Range]) -> forms.Range:
    size = field.type.fixed_size
    if size is not None:
        whole = field.type.kind == "bytes" or (field.type.pad is None and field.type.end is None)
        return forms.Range(size if whole else None, size)
    return lengths.get(field.name, forms.Range(None, None))
