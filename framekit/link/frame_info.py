"""What the link knows of one frame before any byte comes: its functions, how it begins, what is inside and repeated.

Made once from the definition and the codec. It knows no other frame but by name.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from framekit.codec.errors import FrameError, Misread
from framekit.definition.expression.syntax import Name
from framekit.definition.model.frames import Frame
from framekit.definition.model.segments import (
    Bits,
    BitsPart,
    Check,
    Const,
    Field,
    Inner,
    Segment,
    Wrap,
)
from framekit.definition.model.walk import by_value_name
from framekit.link.evaluate import Evaluate, compile_expression
from framekit.link.intact import Intact, any_intact, intact_of
from framekit.link.values import FrameValue


class FrameCodec(Protocol):
    """One frame's compiled functions, as the codec contract has them."""

    @property
    def encode(self) -> Callable[..., bytes]: ...
    @property
    def decode(self) -> Callable[..., dict[str, Any]]: ...
    @property
    def measure(self) -> Callable[..., int]: ...
    @property
    def extent(self) -> Callable[..., int] | None: ...
    @property
    def examine(self) -> Callable[..., Any]: ...


UNKNOWN = 1 << 62
"""More bytes than any frame has."""

Make = Callable[[dict[str, Any], bytes, int | None], FrameValue]
"""Makes a value of decoded fields, bytes and refusal, with values of the frames inside."""

Shape = tuple[tuple[str, str, Any], ...]
"""Where frames stand inside a frame's fields: (`inner`, name, None), (`record` or `list`, name, shape of that)."""


class FrameInfo:
    """One frame. `first`: the byte it begins with, if that is certain. `known`: fields that are constants.

    `extent`: as `measure` if the frame is good and, where it `guesses`, the frame inside is one that is known.
    `inner`: the field with the only frame inside; `behind`: the most that stands behind it. `intact`: a quick look at
    its check code, where there is one; what fails it is bad, never refused. The table of all frames sets `make`.
    `carries`: frames that may be put into this one when `insert` holds. `value_names`: its fields.
    """

    __slots__ = (
        "_examine", "announces", "behind", "carries", "computed", "decode", "echo",
        "encode", "extent", "first", "flat", "frame", "guesses", "inner", "insert", "intact", "known", "make",
        "measure", "most", "name", "numbers", "on_line", "refuse", "shape", "value_names",
    )  # fmt: skip

    def __init__(self, frame: Frame, codec: FrameCodec) -> None:
        self.frame = frame
        self.name = frame.name
        self.make: Make
        self.encode, self.decode, self.measure = codec.encode, codec.decode, codec.measure
        self.first = first_byte(frame.segments)
        self.shape = shape_of(frame.segments)
        self.flat = not self.shape
        self.inner = self.shape[0][1] if len(self.shape) == 1 and self.shape[0][0] == "inner" else None
        self.guesses = codec.extent is not None and self.inner is not None
        self.behind = _behind_inner(frame.segments)
        self.extent = codec.extent if self.guesses and codec.extent is not None else codec.measure
        self.refuse = frame.refuse
        self.intact = intact_of(frame)
        self._examine = codec.examine
        self.most = frame.most
        self.known: dict[str, Any] = {}
        self.computed: list[tuple[str, Evaluate]] = []
        self.numbers: dict[str, dict[str, int]] = {}
        self.on_line = True
        self.carries: tuple[str, ...] = ()
        self.insert: Evaluate | None = None
        self._collect(frame.segments)
        self.value_names = frozenset(by_value_name(frame.segments))
        self.echo = tuple((name, _plain_name(item), compile_expression(item)) for name, item in frame.echo.items())
        self.announces = tuple((name, compile_expression(item)) for name, item in frame.announces.items())

    def misread(self, raw: bytes, names: Mapping[str, Any]) -> FrameError:
        """What `decode` raises for a frame that is not `intact`."""
        return Misread(self.name, self._examine, raw, names)

    def _collect(self, segments: tuple[Segment, ...], certain: bool = True) -> None:
        for segment in segments:
            there = certain and segment.when is None
            if isinstance(segment, Field):
                self._field(segment, segment.values, there)
            elif isinstance(segment, Bits):
                for part in segment.parts:
                    self._field(part, part.values, there)
            elif isinstance(segment, Wrap):
                self._collect(segment.of, there)
                if segment.inside and segment.insert is not None:
                    self.carries, self.insert = segment.inside, compile_expression(segment.insert)
            elif segment.has_cases and segment.chooses_by is None:
                self._collect(segment.usual_block, False)

    def _field(self, field: Field | BitsPart, values: Mapping[int, str] | None, there: bool) -> None:
        """Constants of a field that may be absent are not known: the builder decides whether it is there.

        Nor is one of several that repeats the request's: that decides which.
        """
        name, constants, is_ = field.name, field.constants, field.is_
        if values:
            self.numbers[name] = {text: number for number, text in values.items()}
        if not there:
            return
        if constants and (len(constants) == 1 or name not in self.frame.echo):
            self.known[name] = constants[0]
        elif is_ is not None:
            self.computed.append((name, compile_expression(is_)))


Ends = tuple[tuple[Callable[..., int], Intact | None], ...]
"""Of candidates: what finds the end of several of them alike, and a quick look whether one of them may be good."""


def by_extent(infos: Sequence[FrameInfo]) -> Ends:
    """Candidates together where the functions that find their ends do the very same."""
    groups: dict[Any, list[FrameInfo]] = {}
    for info in infos:
        groups.setdefault(_does(info.extent), []).append(info)
    return tuple((group[0].extent, any_intact([(one.frame, one.intact) for one in group])) for group in groups.values())


def _does(function: Callable[..., int]) -> Any:
    code = getattr(function, "__code__", None)
    if code is None:
        return id(function)
    constants = tuple((type(one), one) for one in code.co_consts if one != function.__doc__)
    return code.co_code, constants, code.co_names


def _plain_name(expression: Any) -> str | None:
    return expression.root.name if isinstance(expression.root, Name) else None


def _behind_inner(segments: tuple[Segment, ...]) -> int:
    """The bytes behind the last frame inside; more than any frame has if these are not plain."""
    size = 0
    for segment in reversed(segments):
        if isinstance(segment, Inner):
            return size
        if not isinstance(segment, Check) or segment.when is not None:
            break
        size += segment.size
    return UNKNOWN


def first_byte(segments: tuple[Segment, ...]) -> int | None:
    """The byte every frame of these segments begins with, when that is a constant."""
    first = segments[0] if segments else None
    if isinstance(first, Const) and first.when is None and first.data:
        return first.data[0]
    return None


def shape_of(segments: tuple[Segment, ...]) -> Shape:
    """Where inner frames stand in the fields of these segments."""
    found: list[tuple[str, str, Any]] = []
    for segment in segments:
        if isinstance(segment, Inner):
            found.append(("inner", segment.name, None))
        for block in segment.blocks:
            found.extend(shape_of(block))
        below = shape_of(segment.inner_record or ())
        if below:
            found.append(("record" if segment.is_record else "list", segment.name or "", below))
    return tuple(found)
