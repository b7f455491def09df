"""Common part of the kinds of segments: keys, reading, contents, checks.

A kind is a class with a module here, and a row of the list in `model/segments.py`. Loaders, the checker and all walks
use the properties below and know no particular kind. Code that reads, builds and measures kinds is in `codec/kinds`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from collections.abc import Sequence as SequenceOf
from dataclasses import dataclass
from typing import Any, ClassVar, Self, TypeVar
from typing import Protocol as Interface

from framekit.definition.expression import Binary, Bytes, Call, Conditional, Expression, Number, Slice, Unary
from framekit.definition.expression import Node as ExpressionNode
from framekit.definition.keys import Form, Meanings, ValueKind, here, mapping_schema, read_keys, ref
from framekit.definition.load.reader import Reader, parse_number
from framekit.definition.problems import Position, Problem, did_you_mean, parted
from framekit.definition.tree import Mapping as Keys
from framekit.definition.tree import Node, Scalar
from framekit.definition.wire_types import EVERY_BYTE, NOTHING, FieldType, Sizes, exactly, of_any_frame

T = TypeVar("T")
SegmentClass = TypeVar("SegmentClass", bound="type[Segment]")
Segments = tuple["Segment", ...]
"""Segments in their order on the wire."""

Contents = Callable[[str], Iterable["Segment"] | None]
"""Function that returns the segments of a frame by name; None if unknown."""

Given = tuple[Expression | None, ValueKind, Mapping[int, str] | None]
"""An expression, its required kind, and the names of numbers that it may be instead."""


class SegmentLoading(Interface):
    """Loader of segments, for kinds that contain others. `side`: sender of the frame."""

    space: Meanings
    side: str | None
    aliases: dict[str, tuple[str, ...]]

    def load(self, node: Node | None) -> Segments: ...
    def layout(self, node: Node) -> Segments: ...
    def nested(self, node: Node, depth: Node) -> str: ...
    def find_frames(self, space: Meanings, node: Node) -> tuple[str, ...]: ...
    def common(self, keys: Keys, kind: str) -> dict[str, Any]: ...


class References(Interface):
    """Meanings of the names of segments in a frame; missing names are noted."""

    reader: Reader

    @property
    def names(self) -> Mapping[str, Segment]: ...

    def written_out(self, names: tuple[str, ...], at: Position, *, may_be_empty: bool = True) -> tuple[str, ...]: ...
    def at_offset(self, offset: int, at: Position, which: int) -> str: ...
    def inside(self, segments: Segments) -> Segments: ...


class Fixing(Interface):
    """Values fixed by `where`: constants as written, or an expression that computes the value."""

    @property
    def constants(self) -> SequenceOf[Scalar]: ...
    @property
    def build(self) -> Expression | None: ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Segment:
    """Base class of segments: common attributes and properties."""

    KEY: ClassVar[str] = ""
    """Key of the kind in YAML; empty for a kind that only other kinds create."""
    takes_bytes: ClassVar[bool] = True
    """Whether the segment has bytes on the wire."""
    is_ignored: ClassVar[bool] = False
    """Whether its bytes have no meaning."""
    HINTS: ClassVar[Mapping[str, str]] = {}
    """Remedies for keys that the kind does not have."""
    VALUE: ClassVar[ValueKind | None] = None
    """Kind of its single value, which has the segment's name; None if it has none, or several."""
    WANTED: ClassVar[bool] = False
    """Whether no frame can be built without its value."""

    at: Position
    name: str | None = None
    when: Expression | None = None
    refuse: int | None = None
    """Code with which a fault in the segment is answered; None: the frame is dropped."""
    doc: str = ""
    holder: str = ""
    """Path of the record or list that has its value; empty for the frame itself."""

    # ---- in YAML ------------------------------------------------------------------------------------------

    @classmethod
    def schema(cls) -> dict[str, Any]:
        """Return the schema of a segment of this kind."""
        found = mapping_schema(cls, f"{cls.KEY} segment")
        found["required"] = [one for one in found.get("required", ()) if one != cls.KEY]
        if not found["required"]:
            del found["required"]
        properties: dict[str, Any] = found.pop("properties")
        named = "name" in {one.name for one in cls.__dataclass_fields__.values() if "key" in one.metadata}
        if named:
            found["x-hints"] = {"name": f"the {cls.called()}'s name is what stands behind '{cls.KEY}:'", **cls.HINTS}
        common = ("when", "refuse", "doc") if named else ("name", "when", "refuse", "doc")
        properties |= {one: here("segment_name" if one == "name" else one) for one in common}
        return {**{one: value for one, value in found.items() if one != "additionalProperties"},
                "properties": properties, "additionalProperties": False}  # fmt: skip

    @classmethod
    def called(cls) -> str:
        """Return the noun of the segment in messages."""
        return cls.KEY

    @classmethod
    def load(cls, loader: SegmentLoading, keys: Keys) -> Segments:
        """Return the segments that a mapping of this kind defines. Raises Broken."""
        common = loader.common(keys, cls.KEY)
        return (cls(**{**common, **cls.attributes(loader, keys)}),)

    @classmethod
    def attributes(cls, loader: SegmentLoading, keys: Keys) -> dict[str, Any]:
        """Return the attributes from the keys of a mapping. Raises Broken."""
        return read_keys(cls, loader, keys)

    # ---- contents -----------------------------------------------------------------------------------------

    @property
    def path(self) -> str:
        """Return its name after the names of the records that contain it, joined by dots: unique, except between cases
        of a choice.
        """
        return self.sibling_path(self.name or "")

    def sibling_path(self, name: str) -> str:
        """Return the path of the segment of that name in the same record."""
        return f"{self.holder}.{name}" if self.holder else name

    @property
    def value_names(self) -> tuple[str, ...]:
        """Return the names of its own values."""
        return (self.name,) if self.name and self.VALUE is not None else ()

    @property
    def blocks(self) -> tuple[Segments, ...]:
        """Return the inner lists of segments whose values belong to the same record as the segment."""
        return ()

    @property
    def is_there_inside(self) -> bool:
        """Return whether the segments in `blocks` are present whenever the segment is."""
        return False

    @property
    def inner_record(self) -> Segments | None:
        """Return the segments inside whose values make records of their own; None if no such list exists."""
        return None

    @property
    def is_record(self) -> bool:
        """Return whether its value is a single record."""
        return self.inner_record is not None and not self.is_list

    @property
    def members(self) -> Segments:
        """Return the segments of `inner_record`; an empty tuple if it is None."""
        return self.inner_record or ()

    @property
    def usual_block(self) -> Segments:
        """Return the block that is present by default; an empty tuple if there are several."""
        return self.blocks[0] if len(self.blocks) == 1 else ()

    @property
    def has_cases(self) -> bool:
        """Return whether the segments in `blocks` may be absent although the segment is present."""
        return bool(self.blocks) and not self.is_there_inside

    @property
    def is_list(self) -> bool:
        """Return whether its value is a list, so that the segments inside it may occur several times."""
        return False

    @property
    def frames_inside(self) -> tuple[str, ...]:
        """Return the names of the frames that may take its place."""
        return ()

    def with_blocks(self, change: Callable[[Segments], Segments]) -> Self:
        """Return the segment with every list of `blocks` changed."""
        return self

    def with_record(self, change: Callable[[Segments], Segments]) -> Self:
        """Return the segment with the list of `inner_record` changed."""
        return self

    def with_lists(self, change: Callable[[Segments], Segments]) -> Self:
        """Return the segment with every inner list changed."""
        return self.with_blocks(change).with_record(change)

    # ---- bytes --------------------------------------------------------------------------------------------

    def sizes(self, of_frame: Callable[[str], Sizes]) -> Sizes:
        """Return its sizes on the wire if it is present; `of_frame` gives the sizes of a frame by name."""
        if self.number_type is None and self.takes_bytes:
            raise NotImplementedError
        return NOTHING if self.number_type is None else self.number_type.sizes

    def contents(self, of_frame: Contents) -> frozenset[int]:
        """Return the bytes that may occur in it; every byte if that is unknown."""
        if not self.takes_bytes:
            return frozenset()
        if self.number_type is not None:
            return self.number_type.contents
        inside = self.blocks if self.inner_record is None else (self.inner_record,)
        return contents_of((one for block in inside for one in block), of_frame) if inside else EVERY_BYTE

    @property
    def whole_frame(self) -> int | None:
        """Return the size of the whole frame, for a segment that fills the frame up; else None."""
        return None

    @property
    def takes_rest(self) -> bool:
        """Return whether it extends to the end of its region."""
        return False

    @property
    def number_type(self) -> FieldType | None:
        """Return the type of its value on the wire, if it has a single value with a type."""
        return None

    @property
    def size_expression(self) -> Expression | None:
        """Return the expression for its size, or None."""
        size = getattr(self, "size", None) if self.number_type is None else self.number_type.size
        return size if isinstance(size, Expression) else None

    # ---- values -------------------------------------------------------------------------------------------

    def value_kinds(self) -> Iterator[tuple[str, ValueKind]]:
        """Yield the names that expressions may use, with the kind of each."""
        if self.name:
            yield self.name, self.VALUE or "any"

    def numbers_with_names(self) -> Iterator[tuple[str, Mapping[int, str] | None]]:
        """Return the values that are numbers, with the names of these numbers."""
        return iter(())

    @property
    def wanted_names(self) -> tuple[str, ...]:
        """Return the values without which no frame can be built if the segment is present."""
        return self.value_names if self.WANTED else ()

    @property
    def given_names(self) -> tuple[str, ...]:
        """Return the values that may be given when a frame is built: those not always computed."""
        return self.value_names

    @property
    def lacks_default(self) -> bool:
        """Return whether it has a value without a computation or a default in the definition."""
        inside = self.blocks if self.is_there_inside else ()
        return bool(self.wanted_names) or any(lack_default(block) for block in inside)

    @property
    def may_be_given(self) -> bool:
        """Return whether a value of it may be given, which shows that the segment is present."""
        return bool(self.wanted_names)

    def needed(self) -> Iterator[tuple[str, Expression]]:
        """Yield the expressions that must be known to read it, with their nouns in messages."""
        if self.when is not None:
            yield "condition", self.when
        if self.size_expression is not None:
            yield "size", self.size_expression

    def given(self) -> Iterator[Given]:
        """Yield its expressions, with the required kind of each."""
        yield self.when, "any", None
        yield self.size_expression, "number", None

    def computed(self) -> Iterator[tuple[str, Expression]]:
        """Return the expressions that compute values, by the name of the value."""
        return iter(())

    @property
    def condition(self) -> Expression | None:
        """Return the condition on the frame, for a segment that is only a condition."""
        return None

    @property
    def follows(self) -> Expression | None:
        """Return the expression of a value without bytes."""
        return None

    # ---- loading ------------------------------------------------------------------------------------------

    def resolved(self, references: References) -> Segment:
        """Return the segment with the names of other segments expanded, in inner lists too."""
        return self.with_record(references.inside)

    def fixed(self, reader: Reader, wheres: Mapping[str, Fixing], used: set[str]) -> Segment:
        """Return the segment with the values fixed by `where`; their names are added to `used`. Raises Broken."""
        return self

    def with_numbers(self, reader: Reader, numbers: Mapping[str, int] | None) -> Segment:
        """Return the segment with names of numbers replaced, if it chooses by a value whose numbers have names."""
        return self

    @property
    def chooses_by(self) -> Expression | None:
        """Return the expression that selects its case, or None."""
        return None

    # ---- checking -----------------------------------------------------------------------------------------

    def check(self) -> Iterator[Problem]:
        """Report problems of the segment by itself."""
        return iter(())

    @property
    def title(self) -> str:
        """Return its title in messages."""
        if self.name and not self.name.startswith("_"):
            return f"'{self.name}'"
        return f"the {type(self).__name__.lower()} part"


def sizes_of(segments: Segments, of_frame: Callable[[str], Sizes]) -> Sizes:
    """Return the sizes of a list of segments on the wire; a conditional segment may take no bytes."""
    total = NOTHING
    for segment in segments:
        if segment.whole_frame is not None:
            return exactly(segment.whole_frame)
        sizes = segment.sizes(of_frame)
        total += sizes if segment.when is None else Sizes(0, sizes.most)
    return total


def lack_default(segments: Segments) -> bool:
    """Return whether a segment that is always present requires a given value."""
    return any(segment.when is None and segment.lacks_default for segment in segments)


def contents_of(segments: Iterable[Segment], of_frame: Contents) -> frozenset[int]:
    """Return the bytes that may occur in segments; every byte if that is unknown."""
    found: frozenset[int] = frozenset()
    for segment in segments:
        if len(found) == 256:
            break
        found |= segment.contents(of_frame)
    return found


def fixed_size(segment: Segment) -> int | None:
    """Return the constant size of a segment (bytes); None if it depends on content, or on an inner frame."""
    return all_fixed((segment,))


def all_fixed(segments: Segments) -> int | None:
    """Return the constant size of segments (bytes); None if it depends on content, or on an inner frame."""
    return sizes_of(segments, of_any_frame).fixed


def least_size(segments: Segments) -> int:
    """Return the least size of segments (bytes), without inner frames."""
    return sizes_of(segments, of_any_frame).least


# ---- the kinds there are ------------------------------------------------------------------------------------

KINDS: dict[str, type[Segment]] = {}
"""Kinds of segments by their keys."""


def add_kind(*kinds: type[Segment]) -> None:
    """Register kinds for definitions."""
    for kind in kinds:
        KINDS[kind.KEY] = kind


# ---- numbers ------------------------------------------------------------------------------------------------


class Numbered(Interface):
    """A segment with a single number."""

    @property
    def at(self) -> Position: ...
    @property
    def name(self) -> str: ...
    @property
    def type(self) -> FieldType: ...
    @property
    def plus(self) -> int: ...
    @property
    def limits(self) -> tuple[int, int] | None: ...
    @property
    def zero_means(self) -> int | None: ...


def value_names(space: Meanings, node: Node) -> Mapping[int, str]:
    """Return the names of numbers, from the name of a table or a mapping code: name. Raises Broken."""
    reader = space.reader
    if isinstance(node, Keys):
        found: dict[int, str] = {}
        for entry in node.read_all():
            number = reader.number(entry.key)
            if number in found:
                reader.note(entry.key.at, f"{number} has the name '{found[number]}' already", "remove one of them")
            found[number] = reader.text(entry.value)
        return found
    name = reader.text(node)
    table = space.table(name)
    if table is None:
        raise reader.unknown(node.at, "table", name, list(space.section("tables")))
    return {key: str(text) for key, text in table.entries.items() if isinstance(key, int)}


VALUE_NAMES = Form(ref("value_names"), lambda r, node: value_names(r.space, node))


def constant_number(expression: Expression | None) -> int | None:
    """Return the number if the expression is a constant number; else None."""
    match expression.root if expression is not None else None:
        case Number(value=value, is_time=False):
            return value
        case Unary(operator="-", operand=Number(value=value, is_time=False)):
            return -value
    return None


def most_bytes(node: ExpressionNode) -> int | None:
    """Return the number of bytes of the result of an expression, given enough input; None if it is variable."""
    match node:
        case Bytes(value=value):
            return len(value)
        case Binary(operator="+", left=left, right=right):
            parts = (most_bytes(left), most_bytes(right))
            return None if None in parts else sum(part for part in parts if part is not None)
        case Conditional(then=then, otherwise=otherwise):
            first = most_bytes(then)
            return first if first == most_bytes(otherwise) else None
        case Call(function="xor" | "aes", arguments=arguments):
            return most_bytes(arguments[1])
        case Slice(value=value, start=start, stop=stop):
            whole, first, last = most_bytes(value), _place(start), _place(stop)
            if whole is not None and None not in (first, last):
                return len(range(whole)[slice(first or None, last or None if stop is None else last)])
            if start is not None and first is not None and first < 0 and stop is None:
                return -first
            if last is not None and stop is not None and first is not None and 0 <= first <= last:
                return last - first
            if first is not None and last is not None and stop is not None and first < 0 and last < 0:
                return max(0, last - first)
    return None


def _place(node: ExpressionNode | None) -> int | None:
    """Return the end of a slice as a number: 0 for a missing end, None for a computed end."""
    return 0 if node is None else constant_number(Expression("", node))


def bytes_of_number(segment: Numbered, plus: int = 0) -> frozenset[int]:
    """Return the bytes that its number may have on the wire, where the wire number is number + plus.

    A range limits the bytes of numbers of one byte.
    """
    is_byte = segment.type.kind == "int" and segment.type.size == 1 and segment.zero_means is None
    if not is_byte or segment.limits is None or segment.limits[0] + plus < 0:
        return segment.type.contents
    return frozenset(range(segment.limits[0] + plus, min(segment.limits[1] + plus, 255) + 1))


def limits_that_do_not_fit(segment: Numbered, plus: int = 0) -> Iterator[Problem]:
    bounds = segment.type.bounds
    if bounds is not None and segment.limits is not None:
        for number in segment.limits:
            if not bounds[0] <= number + plus <= bounds[1]:
                yield too_large(segment, number, bounds, segment.at)
                return


def too_large(segment: Numbered, number: int, bounds: tuple[int, int], at: Position) -> Problem:
    what = f"{number} does not fit: '{segment.name}' holds {bounds[0] - segment.plus} to {bounds[1] - segment.plus}"
    return Problem(at, what, "use a wider type")


def zero_with_a_sign(segment: Numbered) -> Iterator[Problem]:
    if segment.zero_means is not None and segment.type.signed:
        what = f"'{segment.name}' has a sign: its 0 stands between other numbers and cannot mean {segment.zero_means}"
        yield Problem(segment.at, what, "take a type without sign, or leave zero_means out")


def number_written(reader: Reader, holder: Any, scalar: Scalar) -> int:
    """Return a number, or the number of a name among the `values` of a field or of bits. Raises Broken."""
    for number, name in (holder.values or {}).items():
        if name == scalar.text:
            return int(number)
    try:
        return parse_number(scalar.text)
    except ValueError as error:
        what, todo = parted(error)
        if holder.values:
            what = f"'{scalar.text}' is neither a number nor a name in the values of '{holder.name}'"
            todo = did_you_mean(scalar.text, holder.values.values())
        raise reader.broken(scalar.at, what, todo) from None
