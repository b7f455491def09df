"""Names that segments mention: what a length counts, what a count counts, what a check covers."""

from __future__ import annotations

from dataclasses import replace

from framekit.definition.load.reader import Reader
from framekit.definition.load.where import Parts
from framekit.definition.model.frame_sizes import fixed_size
from framekit.definition.model.segments import (
    Bits,
    Check,
    Count,
    Data,
    Field,
    Length,
    Repeat,
    Segment,
)
from framekit.definition.model.walk import change_all, flat, leaves
from framekit.definition.problems import Position, did_you_mean


def resolve_references(reader: Reader, parts: Parts, aliases: dict[str, tuple[str, ...]]) -> Parts:
    """The segments with named includes, `body` and bit names written out; names that are not there are noted."""
    head, body, tail = parts
    names = {segment.name: segment for segment in flat(head + body + tail) if segment.name}
    meant = dict(aliases)
    if "body" not in names:
        meant.setdefault("body", tuple(segment.name for segment in body if segment.name))
    for segment in names.values():
        if isinstance(segment, Bits):
            meant |= {part.name: (segment.name or "",) for part in segment.parts}
    resolver = _Resolver(reader, names, meant)
    return (
        change_all(head, resolver.change),
        change_all(body, resolver.change),
        change_all(tail, resolver.change),
    )


class _Resolver:
    def __init__(self, reader: Reader, names: dict[str, Segment], meant: dict[str, tuple[str, ...]]) -> None:
        self.reader = reader
        self.names = names
        self.meant = meant
        self.order = [name for name in names if name]

    def change(self, segment: Segment) -> Segment:
        if isinstance(segment, Length):
            return replace(segment, of=self._written_out(segment.of, segment.at))
        if isinstance(segment, Count):
            self._repeat(segment)
        if isinstance(segment, Check):
            return self._check(segment)
        return segment.with_record(
            lambda inside: resolve_references(self.reader, ((), inside, ()), dict(self.meant))[1]
        )

    def _written_out(self, names: tuple[str, ...], at: Position) -> tuple[str, ...]:
        result: list[str] = []
        for name in names:
            meant = [name] if name in self.names else self.meant.get(name)
            if meant is None:
                self._unknown(name, at)
                continue
            on_wire = [one for one in meant if one not in self.names or any(leaves((self.names[one],)))]
            if not on_wire:
                self.reader.note(at, f"'{name}' takes no bytes", "name segments that stand on the wire")
            result.extend(on_wire)
        return tuple(result)

    def _unknown(self, name: str, at: Position) -> None:
        known = [known for known in [*self.order, *self.meant] if not known.startswith("_")]
        self.reader.note(at, f"there is no segment '{name}' in this frame", did_you_mean(name, known))

    def _repeat(self, count: Count) -> None:
        if not isinstance(self.names.get(count.of), Repeat):
            known = [name for name, segment in self.names.items() if name and isinstance(segment, Repeat)]
            todo = did_you_mean(count.of, known) or "name a segment repeat: in of"
            if isinstance(self.names.get(count.of), (Data, Field)):
                todo = f"write length: {count.name} for the number of bytes"
            self.reader.note(count.at, f"there is no repeat '{count.of}' to count", todo)

    def _check(self, check: Check) -> Segment:
        if check.over is not None:
            return replace(check, over=self._written_out(check.over, check.at))
        if check.span is None:
            return check
        first, last = check.span
        return replace(
            check, span=(self._edge(first, check, 0), "here" if last == "here" else self._edge(last, check, -1))
        )

    def _edge(self, name: str, check: Check, which: int) -> str:
        """The segment at one end of a range: by name, or by its offset in bytes from the start."""
        if name.isdigit():
            return self._at_offset(int(name), check, which)
        written = self._written_out((name,), check.at)
        return written[which] if written else ""

    def _at_offset(self, offset: int, check: Check, which: int) -> str:
        place = 0
        for name in self.order:
            size = fixed_size(self.names[name])
            if which == 0 and place == offset:
                return name
            if size is None:
                break
            place += size
            if which == -1 and place == offset + 1:
                return name
        self.reader.note(
            check.at, f"no segment {'begins' if which == 0 else 'ends'} at offset {offset}", "name the segment instead"
        )
        return ""
