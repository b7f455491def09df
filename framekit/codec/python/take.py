"""Taking functions: one call finds the end of a frame in a stream, judges it and reads it, out of the buffer itself.

Only for frames that can be read from front to back. A function gives bytes and values of what is surely good; () of
what has surely begun and wants more bytes; None and its size, if all but the check code is right; and None if it is
not sure, which is left to those who measure and decode. A receiver uses them for what comes in rows.
"""

from __future__ import annotations

from collections.abc import Collection

from framekit.codec.python.describe import write_docstring
from framekit.codec.python.expressions import Scope
from framekit.codec.python.function import MISFIT, Function
from framekit.codec.python.joined import Apart, Pair, compare_size, function_of, sole_names
from framekit.codec.python.measure import needed_names
from framekit.codec.python.module import Module
from framekit.codec.python.places import Fields, Place, between
from framekit.codec.python.reader import Item
from framekit.codec.python.shape import leading
from framekit.codec.python.source import Source, bytes_literal
from framekit.codec.python.take_reader import BEGIN, NotInARow, PairTakeReader, TakeReader
from framekit.definition.model.frames import Frame
from framekit.definition.model.segments import Bits, Const, Field, Length, Segment, Skip
from framekit.definition.problems import DefinitionError


class TakeWriter:
    """Writes one taking function. `answer`: how what it finds is returned.

    `endings`: conditions and what is returned where one holds, the first that does, behind what has to hold otherwise.
    """

    answer = "return "

    def __init__(self, module: Module, identifier: str, frame: Frame, is_inner: bool = False) -> None:
        self.module, self.identifier, self.frame, self.is_inner = module, identifier, frame, is_inner
        self.function, self.segments = self._function()
        self.function.names.fresh(BEGIN.base)
        if not is_inner:
            self.function.misfit = f"{self.answer}None"  # raising and catching would cost as much as reading
        self.fields = Fields(self.function.names.fresh("fields"))
        self.endings: list[tuple[str, str]] = []
        self.reader = self._reader()
        self.reader.answer = self.answer
        is_constant = all(isinstance(segment, Const) for segment in self.segments)
        self.can_be_taken = frame.surplus is None and not is_constant
        try:
            if self.can_be_taken:
                self._read()
        except (NotInARow, DefinitionError):
            self.can_be_taken = False

    def _function(self) -> tuple[Function, tuple[Segment, ...]]:
        segments = self.module.shapes.segments(self.frame)
        return Function(self.module, self.identifier, segments), segments

    def _reader(self) -> TakeReader:
        return TakeReader(self.function, self.frame, self.is_inner)

    def _compare(self, scope: Scope) -> None:
        """What else has to hold when everything is read."""

    def _read(self) -> None:
        reader, function, scope = self.reader, self.function, Scope()
        items = reader.items(self.segments, scope, self.fields)
        tail = len(self.frame.tail) if self.frame.delimited else 0
        if tail:
            self._read_delimited(items[:-tail], items[-tail:])
        else:
            reader.read_items(items, ())
        reader.finish_deferred()
        for item in items:
            item.fields.attach()
        for action in function.late:
            action()
        self._compare(scope)
        place = reader.place.text("data")
        longest = function.shapes.all(self.segments).most
        is_short = longest is not None and longest <= reader.most
        too_long = [] if is_short else [f"{place} - begin > {reader.most}"]
        begun = self._begun_behind()
        if begun is None:
            function.conditions = [f"{place} > end", *function.conditions, *too_long, *reader.checks]
            return
        short = [] if is_short else [f"{place} - begin <= {reader.most}"]
        self.endings.append((f"{begun.text('data')} > end", reader.begun(*short)))
        self.endings += [(one, function.misfit) for one in too_long]
        if begun != reader.place:
            self.endings.append((f"{place} > end", reader.begun()))
        if reader.checks:
            size = reader.place.offset if reader.place.base == BEGIN.base else f"{place} - begin"
            self.endings.append((" or ".join(reader.checks), f"{self.answer}(None, {size})"))

    def end(self, known: Collection[str] = ()) -> None:
        """Writes what is found where it is no good frame, which one condition tells; `known` ones do not hold."""
        function = self.function
        conditions = [one for one in function.conditions if one not in known]
        function.conditions = []
        endings = ([(" or ".join(conditions), function.misfit)] if conditions else []) + self.endings
        if not endings:
            return
        if function.misfit == MISFIT:
            self.module.function("Misfit")
        *before, (_, last) = endings
        with function.out.block(f"if {' or '.join(self._tests(conditions))}:"):
            for condition, answer in before:
                with function.out.block(f"if {condition}:"):
                    function.add(answer)
            function.add(last)

    def _tests(self, conditions: list[str]) -> list[str]:
        """What does not hold of a good frame: what is there if its end is there needs no test of its own."""
        tests = [condition for condition, _ in self.endings]
        if len(tests) > 1 and self._begun_behind() not in (None, self.reader.place):
            del tests[0]
        return [*conditions, *tests]

    def _begun_behind(self) -> Place | None:
        """The place that is not there yet if the frame has surely begun; None where measuring has to say that."""
        return self.reader.place

    def front(self) -> int:
        """With fewer bytes than these the frame has surely begun, whatever they are; 0 where that is not known."""
        return 0

    def _read_delimited(self, before: list[Item], tail: list[Item]) -> None:
        """The first byte of the tail ends the body, wherever it stands behind the head."""
        reader, head = self.reader, self.function.shapes.all(self.frame.head).fixed
        first = tail[0].segment
        if head is None or not isinstance(first, Const) or self.segments != self.frame.segments:
            raise NotInARow
        mark = bytes_literal(first.data[:1])
        self.function.add(f"stop = data.find({mark}, {BEGIN.plus(head).text('data')})")
        with self.function.out.block("if stop < 0:"):
            start = leading(self.function.shapes, self.segments)
            needed = needed_names(self.segments)
            if start and all(_fits_always(segment, needed) for segment in self.frame.head):
                reader.say_begun(f"data.startswith({bytes_literal(start)}, begin)", reader.room)
            else:
                self.function.add(MISFIT)
        reader.is_ended = True
        reader.read_items(before, ())
        reader.is_ended = False
        if reader.place != Place("stop", 0):
            self.function.misfit_if(f"{reader.place.text('data')} != stop")
            self.function.flush()
            reader.place = Place("stop", 0)
        reader.read_items(tail, ())

    # ---- functions ----------------------------------------------------------------------------------------

    def _head(self, out: Source, sentence: str, refusal: str) -> None:
        write_docstring(out, sentence, "")
        self.hoist(out, refusal)

    def hoist(self, out: Source, refusal: str) -> None:
        """Writes what fetches context values, and the locals of content that may be absent."""
        for local in self.function.regions:
            out.add(f'{local} = b""')
        for context, local in self.function.hoisted.items():
            out.add(f"{local} = {self.module.given(context)}")
            state = self.module.protocol.state.get(context)
            if state is not None and state.announced:
                with out.block(f"if {local} is None:"):
                    out.add(refusal)

    def inner_function(self) -> Source:
        function, out = self.function, Source()
        self.end()
        result = self.fields.text(function.out)
        header = "data: bytes, begin: int, end: int, ctx: Context"
        with out.block(f"def take_{self.identifier}({header}) -> tuple[int, dict[str, Any]]:"):
            self._head(out, f"The place behind the frame `{self.frame.name}` at data[begin], and its values.", MISFIT)
            out.extend(function.out)
            out.add(f"return {self.reader.place.text('data')}, {result}")
        return out

    def result(self, known: Collection[str] = ()) -> str:
        """The values as an expression, when everything else has been written; the local `raw` has the bytes."""
        function, reader = self.function, self.reader
        self.end(known)
        if reader.raw_until != reader.place:
            function.add(f"raw = {between('data', BEGIN, reader.place)}")
        return self.fields.text(function.out)

    def function_on_line(self) -> Source:
        function, out = self.function, Source()
        result = self.result()
        header = "data: bytes, begin: int, end: int, ctx: Context"
        with out.block(f"def take_{self.identifier}({header}) -> Taken:"):
            about = f"The bytes and values of the frame `{self.frame.name}` at data[begin], if it is surely good."
            self._head(out, about, "return None")
            with out.block("try:"):
                out.extend(function.out)
            with out.block("except MISFITS:"):
                front = self.front()
                out.add(f"return () if end - begin < {front} else None" if front else "return None")
            out.add(f"return raw, {result}")
        return out


def _fits_always(segment: Segment, needed: set[str]) -> bool:
    """Whether measuring finds nothing wrong with a segment that is there, whatever its bytes are."""
    if isinstance(segment, Field):
        is_free = segment.constants is None and segment.is_ is None and not segment.only
        is_text = segment.type.kind in ("ascii", "bytes")
        return is_free and segment.long is None and (segment.name not in needed or is_text)
    if isinstance(segment, Bits):
        return all(part.name not in needed and not part.constants and part.is_ is None for part in segment.parts)
    return isinstance(segment, (Const, Skip))


class PairTakeWriter(TakeWriter):
    """Writes what takes a frame and the plain one inside it at once."""

    def __init__(self, module: Module, identifier: str, frame: Frame, pair: Pair) -> None:
        self.pair = pair
        super().__init__(module, identifier, frame)

    def _function(self) -> tuple[Function, tuple[Segment, ...]]:
        return function_of(self.module, self.identifier, self.pair), self.pair.segments

    def _reader(self) -> TakeReader:
        return PairTakeReader(self.function, self.frame, Apart(self.function, self.pair, self.fields))

    def _compare(self, scope: Scope) -> None:
        compare_size(self.function, self.pair, scope)

    def _begun_behind(self) -> Place | None:
        """Behind the frame inside, if that is the only one that may stand there."""
        shapes, inner = self.module.shapes, self.pair.inner
        segments = shapes.segments(self.frame)
        behind = shapes.all(segments[segments.index(inner) + 1 :]).fixed
        return self.reader.place.plus(-behind) if self._is_sole and behind is not None else None

    @property
    def _is_sole(self) -> bool:
        """Whether nothing else may stand inside, and nothing else says how long it is."""
        inner = self.pair.inner
        return inner.size is None and self.pair.inside_name in sole_names(self.module.shapes, inner)

    def front(self) -> int:
        """Up to behind the first bytes that measuring may look at, if these are none of those that it compares."""
        size, needed = 0, needed_names(self.segments)
        for segment in self.segments if self._is_sole else ():
            fixed = self.module.shapes.of(segment).fixed
            is_length = isinstance(segment, Length)
            if fixed is None or isinstance(segment, Const) or not (is_length or _fits_always(segment, needed)):
                break
            size += fixed
            if is_length:
                break
        return size
