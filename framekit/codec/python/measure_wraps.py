"""Measuring functions: wraps, and frames inside frames."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from framekit.codec.python.expressions import Scope
from framekit.codec.python.measure_segments import SegmentMeasurer
from framekit.codec.python.measuring import Pairs, needed_names
from framekit.codec.python.shape import leading
from framekit.codec.python.source import Source, bytes_literal, quoted
from framekit.definition.expression.syntax import Expression
from framekit.definition.model.frames import Frame
from framekit.definition.model.segments import Const, Inner, Skip, Wrap
from framekit.definition.model.walk import flat


class WrapMeasurer(SegmentMeasurer):
    """Writes how wraps and inner frames are passed. `asks_inside`: a frame inside decides on the size."""

    asks_inside = False

    def write(self, frame: Frame | None, scope: Scope | None = None) -> None:
        """The whole function; without a frame, that of the segments alone, with the names of `scope` around them."""
        raise NotImplementedError

    def function(self, sentence: str) -> Source:
        """The function around what was written."""
        raise NotImplementedError

    def inner_may_misfit(self) -> bool:
        """Whether an inner frame begins with constants, so that it has to be looked at."""
        return any(isinstance(segment, Inner) and self._begins(segment) for segment in flat(self.segments))

    def _begins(self, inner: Inner) -> bool:
        frames = (self.shapes.frames[name] for name in inner.frames)
        return any(leading(self.shapes, self.shapes.segments(frame)) for frame in frames)

    def wrap(self, wrap: Wrap, scope: Scope, after: Pairs) -> None:
        fixed = self.shapes.all(wrap.of).fixed
        if wrap.how == "hex":
            self._hex(wrap, scope, fixed, after)
            return
        self.settle()
        escape = f"{wrap.escape or 0:#04x}"
        behind = self.least(after)
        if fixed is not None:
            with self.out.block("try:"):
                self.add(f"at = {self.module.function('end_of_doubled')}(data, at, {escape}, {fixed}, end)")
            with self.out.block("except IndexError:"):
                self.add(f"return -{1 + behind}")
            with self.out.block("except ValueError:"):
                self.add("return LOST")
            if follows := _symbol_behind(wrap, after):
                with self.out.block(
                    f"if not {bytes_literal(follows)}.startswith(data[at:min(at + {len(follows)}, end)]):"
                ):
                    self.add("return LOST")
            self._read_content(wrap, scope, after)
            return
        find = self.module.function("find_region_end")
        resume = self.resume(after)
        embedded = self.module.embedded(wrap)
        more = f", {embedded}" if embedded else ""
        self.add(f"at = {find}(data, at, end, {escape}, {0 if resume is None else resume}{more})")
        with self.out.block("if at < 0:"):
            self.not_found(max(behind - 1, 1))
        if follows := _symbol_behind(wrap, after):  # what is not doubled has to be the end
            with self.out.block(f"if data[at + 1] != {follows[1]:#04x}:"):
                self.add("return LOST")
        self._read_content(wrap, scope, after, 2)

    def _read_content(self, wrap: Wrap, scope: Scope, after: Pairs, further: int = 0) -> None:
        """Values of a wrap that sizes behind it depend on; the careful function reads them, now that they are there."""
        needed = self.needed & needed_names(tuple(segment for segment, _ in after))
        names = [name for one in flat(wrap.of) for name in one.value_names if name in needed]
        if names:
            self.settle()
            self.may_fail = True
            stop = f"at + {further}" if further else "at"
            self.add(f"fields = examine_{self.identifier}(bytes(data[start:{stop}]), ctx).fields")
            for name in names:
                self.set_value(name, scope, f"fields[{quoted(name)}]")

    def _hex(self, wrap: Wrap, scope: Scope, fixed: int | None, after: Pairs) -> None:
        needed = any(name in self.needed for one in flat(wrap.of) for name in one.value_names)
        if fixed is not None:
            if needed:
                self.want(2 * fixed, after)
            self.skip(str(2 * fixed))
            self._read_content(wrap, scope, after)
            return
        first = after[0][0] if after else None
        if isinstance(first, Const) and first.when is None and first.data[:1].upper() not in b"0123456789ABCDEF":
            self.settle()
            self.add(f"at = {self.search(f'{first.data[0]:#04x}', 'at', after)}")
            with self.out.block("if at < 0:"):
                self.not_found(self.least(after))
            self._read_content(wrap, scope, after)
            return
        if isinstance(first, Const):
            self.rest(wrap, after)
        front = Skip(at=wrap.at, size=1)  # so that content of no bytes differs from no content
        inside = type(self)(self.module, f"{self.identifier}_content", (front, *wrap.of), self.most)
        inside.maybe_absent = self.maybe_absent
        given: dict[str, str] = {}
        inside.write(None, self._handed(inside.needed, scope, "", given))
        self.module.extra.append(inside.function(f"How long the content of the wrap in `{self.identifier}` is."))
        self.settle()
        size = self.names.fresh("size")
        measure = self.module.function("measure_hex")
        texts = "".join(f", {quoted(name)}: {text}" for name, text in given.items())
        context = f"{{**ctx{texts}}}" if given else "ctx"
        self.add(f"{size} = {measure}(measure_{inside.identifier}, data, at, end, {context})")
        with self.out.block(f"if {size} <= 0:"):
            self.add(f"return {size}")
        self.skip(f"{size} - 1")

    def _handed(self, names: Iterable[str], scope: Scope, path: str, given: dict[str, str]) -> Scope:
        """What the content of a wrap reads of the values around it, which it finds in the context it is given."""
        found = Scope()
        for name in sorted(names):
            entry = scope.find(name)
            if entry is not None and entry.direct and entry.inside is not None:
                inside = self._handed(entry.inside.entries, entry.inside, f"{path}{name}.", given)
                found.entries[name] = replace(entry, inside=inside)
            elif entry is not None:
                given[f"{path}{name}"] = entry.text
                found.entries[name] = replace(entry, text=f"ctx[{quoted(f'{path}{name}')}]")
        return found

    def inner_size(self, size: str, choice: str, measure: str, arguments: str, seen: str) -> None:
        """Gives the local `size` its value: that of the frame inside."""
        self.add(f"{size} = {measure}({choice}, {arguments}{seen})")

    def inner(self, inner: Inner, scope: Scope, after: Pairs) -> None:
        fixed = self.shapes.present(inner).fixed
        if isinstance(inner.size, Expression):
            self.skip(self.size_text(inner.size, scope))
            return
        if inner.size == "rest":
            self.rest(inner, after)
        if fixed is not None and not self._begins(inner):
            self.skip(str(fixed))
            return
        choice = self.module.choice(inner.frames, self.identifier, inner.name)
        behind = self.least(after)
        size = self.names.fresh(f"{inner.name}_size")
        if any(self.shapes.frame(name).least for name in inner.frames):
            self.want(1, after)
        place = self.place.text("")
        most = self.shapes.all(segment for segment, _ in after).most
        self.asks_inside = True
        seen = ""
        if most is not None:
            offset = f"({place} - start) - {most}" if self.place.base == "at" else str(self.place.offset + most)
            seen = f", max(seen - {offset}, 0)" if offset != "0" else ", seen"
        self.inner_size(size, choice, self.module.function("measure_first"), f"data, {place}, end, ctx", seen)
        with self.out.block(f"if {size} <= 0:"):
            with self.out.block(f"if {size} == QUIET and end - start > {self.most}:"):
                self.add("return LOST")
            self.add(f"return {size} - {behind} if QUIET < {size} < 0 else {size}" if behind else f"return {size}")
        self.skip(size)


def _symbol_behind(wrap: Wrap, after: Pairs) -> bytes:
    """The escape byte and its follower behind a wrap; empty if something else may stand there, or is to be refused."""
    found = b""
    for segment, _ in after:
        if not isinstance(segment, Const) or segment.when is not None or segment.refuse is not None:
            break
        found += segment.data
    return found[:2] if len(found) > 1 and found[0] == wrap.escape else b""
