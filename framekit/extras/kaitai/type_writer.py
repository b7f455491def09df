"""Write one use of a type of a Kaitai Struct file as segments: its attributes in order, and its instances.

A type is written anew for each use, as the meaning of `_parent` and `rest` depends on the place. The work for a file is
bounded (`WorkDone`), however often types use each other.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial

from framekit.definition.expression import (
    ATOM,
    NOT,
    ExpressionError,
    Node,
    parse_expression,
    walk,
)
from framekit.definition.nodes import Entry, Scalar
from framekit.definition.nodes import Mapping as MappingNode
from framekit.definition.problems import CannotSayError, Position
from framekit.definition.wire_types import ANY, NOTHING, Sizes, bounds_of_bits, either, exactly
from framekit.extras.kaitai.attributes import (
    BITS,
    DEEPEST,
    FLOAT,
    MOST_BYTES,
    NUMBER,
    OF_ALL,
    OF_BYTES,
    OF_TEXTS,
    FileParts,
    Keys,
    KsyPart,
    LeftOutError,
    Region,
    bits_of,
    greatest,
    is_built_in,
    is_end,
    left_more,
    left_of,
    with_keys,
    without_repeat,
)
from framekit.extras.kaitai.choices import choose, entry_of_cases
from framekit.extras.kaitai.description import KsyAttribute, KsyType, one_number, scalar
from framekit.extras.kaitai.language import parse
from framekit.extras.kaitai.translation import (
    INDEX,
    IT,
    UNKNOWN,
    Kind,
    KsyMeaning,
    KsyScope,
    Translated,
    Translation,
    constant,
    own_name,
)
from framekit.extras.kaitai.values import KsyValueWriter, constant_meaning

_USER = re.compile(r"(?:::)?([a-z][a-z0-9_]*(?:::[a-z][a-z0-9_]*)*)")
MOST_OPTIONALS = 100
"""Limit of the optional attributes in a row, each of which is nested in the previous one."""
_REST_IS = "what stands behind it has no fixed size"


@dataclass(slots=True)
class _Branches:
    """The cases of a choice, each of which begins with the region as it is before the choice."""

    before: Region
    after: list[Region] = field(default_factory=list)
    """The region after each case."""
    meanings: list[tuple[str, KsyMeaning]] = field(default_factory=list)
    """The meaning of the attribute in each case that can be read, by the name of its type."""
    takes_all: bool = False
    """Whether a case takes all remaining bytes."""

    def enter(self, region: Region) -> None:
        """Restore the region for the next case."""
        region.is_taken, region.counts_back = self.before.is_taken, self.before.counts_back

    def leave(self, region: Region, takes_all: bool) -> None:
        """Record the region after a case."""
        self.after.append(replace(region))
        self.takes_all = self.takes_all or takes_all

    def join(self, region: Region) -> None:
        """Set the region to its state after any of the cases, or without a case."""
        states = (self.before, *self.after)
        region.is_taken = any(one.is_taken for one in states)
        region.counts_back = any(one.counts_back for one in states)


@dataclass(frozen=True, slots=True)
class _ListItem:
    """The item of a list."""

    part: KsyPart
    keys: Keys
    """The keys of the list that describe its items."""
    entry: KsyMeaning
    """The meaning of the list's name."""
    it: Translated
    """The meaning of `_` in the condition that ends the list."""
    scope: KsyScope


class TypeWriter:
    """Write one use of a type."""

    def __init__(
        self, file: FileParts, scope: KsyScope, region: Region, behind: int | None, *,
        alone: bool, using: tuple[KsyType, ...],
    ) -> None:  # fmt: skip
        """Prepare the use of a scope's type in a region, given the number of later bytes (None if unknown).

        `alone`: its region ends with it. `using`: the enclosing types, and the type itself.
        """
        self.file, self.scope, self.region, self.behind = file, scope, region, behind
        self.alone, self.using = alone, using
        self.out: list[Keys] = []
        self.sizes = NOTHING
        self._bits: list[tuple[KsyAttribute, int, str]] = []
        self._under_way: set[str] = set()
        self._failed = False
        self._unused_names: dict[str, str] = {}
        self._needs: list[str] = []
        self.values = KsyValueWriter(self)
        self._find_outside = scope.find
        scope.find = self._find

    def write(self) -> tuple[list[Keys], Sizes]:
        """Return the segments and their sizes. Raises LeftOutError if the type cannot be read."""
        type_ = self.scope.type
        behind = [self._all_behind(one) for one in self.file.static.behind(type_)[:-1]]
        chain = self._optional_chain()
        for place, attribute in enumerate(type_.seq):
            if place == chain:
                self._try(attribute, partial(self._optionals, type_.seq[chain:]))
                break
            self._try(attribute, partial(self._next, attribute, behind[place]))
        if self._bits:
            self._try(self._bits[-1][0], self._end_bits)
        for name, instance in type_.instances.items():
            if name not in self.scope.entries:
                try:
                    self._find(name, instance.at)
                except CannotSayError as error:
                    self._tell(error)
                    self.scope.entries[name] = KsyMeaning("", "lost")
        if self._failed:
            raise LeftOutError
        return self._with_lengths(), self.sizes

    def _with_lengths(self) -> list[Keys]:
        """Return the segments, with numbers that state the size or the count of one of them as lengths and counts."""
        found: list[Keys] = []
        sized: dict[str, list[tuple[str, Keys]]] = {}
        for segment in self.out:
            for key, name in _sizes_of(segment):
                sized.setdefault(name, []).append((key, segment))
        for segment in self.out:
            name = segment.get("field", "")
            asked = sized.get(name, []) if segment.keys() <= {"field", "type", "order", "range", "doc"} else []
            if len(asked) != 1 or "when" in asked[0][1] or segment["type"][0] != "u":
                found.append(segment)
                continue
            key, of = asked[0]
            if key == "count":
                counted: str | list[str] = of["repeat"]
            else:
                named = of.get("data") or of.get("field") or of.setdefault("name", self._unused(f"{name}_part"))
                counted = [named]
            others = {key: one for key, one in segment.items() if key != "field"}
            found.append({key: name, **others, "of": counted})
        return found

    def _all_behind(self, inside: int | None) -> int | None:
        return None if inside is None or self.behind is None else inside + self.behind

    def _try(self, attribute: KsyAttribute, write: Callable[[], None]) -> None:
        """Write an attribute; after an attribute without a form, the later attributes are still examined."""
        try:
            write()
        except CannotSayError as error:
            self._tell(error)
            self._lose(attribute)
            self._failed = True
        except LeftOutError:
            self._lose(attribute)
            self._failed = True

    def _tell(self, error: CannotSayError) -> None:
        self.file.tell(error.problem.at, error.problem.what, error.problem.todo)

    def _lose(self, attribute: KsyAttribute) -> None:
        self.scope.entries[attribute.name] = KsyMeaning("", "lost")

    def _put(self, part: KsyPart) -> None:
        self.out += part.segments
        self.sizes += part.sizes

    def _count(self, at: Position, number: int = 1) -> None:
        self.file.work.add(at, number)

    # ---- one attribute ------------------------------------------------------------------------------------

    def _next(self, attribute: KsyAttribute, behind: int | None) -> None:
        self._known_keys(attribute)
        bits = bits_of(attribute, self.scope.type)
        if bits is not None and (self._bits or bits[0] % 8):
            self._next_bits(attribute, *bits)
            return
        self._next_whole(attribute, behind)

    def _known_keys(self, attribute: KsyAttribute) -> None:
        self._count(attribute.at)
        if "" in attribute.keys:  # a wrong form, which has been reported
            raise LeftOutError
        for key in attribute.keys:
            if key not in OF_ALL | OF_TEXTS | OF_BYTES | {"contents", "enum"}:
                if not key.startswith("-"):
                    raise CannotSayError(
                        attribute.keys[key].at, f"the key {key!r} of '{attribute.name}'", "leave it out"
                    )
                self.file.tell(
                    attribute.keys[key].at, f"the key {key!r} is left out", "Kaitai passes over it too", warning=True
                )

    def _next_whole(self, attribute: KsyAttribute, behind: int | None) -> None:
        """Write an attribute that begins at a byte boundary."""
        if self._bits:
            is_open = sum(one[1] for one in self._bits) % 8 != 0
            self._flush_bits()
            if is_open and not self._begins_with_byte(attribute, self.scope.type, DEEPEST):
                what = f"'{attribute.name}' may go on within a byte of which bits have been read"
                raise CannotSayError(attribute.at, what, "fill the byte up before it")
        if is_end(attribute):
            if behind != 0:
                raise CannotSayError(attribute.at, "a condition that the stream ends", _REST_IS)
            self.region.is_exact = True
            self.scope.entries[attribute.name] = constant_meaning(constant(b""))
            return
        most = greatest(attribute)
        if most is not None and len(self.using) == 1 and self.alone:
            self.region.most = most
            return
        condition = attribute.keys.get("if")
        if condition is None:
            self._needs.clear()
            part = self._whole(attribute, behind)
            self._require_needs()
            self._put(part)
            return
        asked = self.parsed(scalar(condition, "if"))
        left = left_more(asked)
        if left is not None:
            self._put(self._optional(attribute, left, behind))
            return
        self._needs.clear()
        said = self.say(asked, condition.at, "bool")
        self._require_needs()
        self._put(self._under(attribute, said, behind))

    def _require_needs(self) -> None:
        """Write the conditions of the values that were read, since Kaitai continues only if they are present."""
        self.out += [{"require": one} for one in dict.fromkeys(self._needs)]
        self._needs.clear()

    def _begins_with_byte(self, attribute: KsyAttribute, type_: KsyType, most: int) -> bool:
        """Return whether an attribute always begins with whole bytes, so that remaining bits of a byte are skipped."""
        keys = attribute.keys
        if most == 0 or keys.keys() & {"if", "repeat"} or is_end(attribute):
            return False
        if keys.keys() & {"contents", "size", "size-eos", "terminator"}:
            return True
        said = keys.get("type")
        text = said.text.strip() if isinstance(said, Scalar) else ""
        if is_built_in(text):
            return BITS.fullmatch(text) is None
        found = type_.find_type(text.partition("(")[0])
        return found is not None and bool(found.seq) and self._begins_with_byte(found.seq[0], found, most - 1)

    def _under(self, attribute: KsyAttribute, condition: Translated, behind: int | None) -> KsyPart:
        """Return a conditional part; if it has no form, a frame that contains it is refused."""
        try:
            part = self._whole(attribute, behind)
        except (CannotSayError, LeftOutError) as error:
            if isinstance(error, CannotSayError):
                self._tell(error)
            self.file.tell(
                attribute.at, f"a frame in which '{attribute.name}' is there is refused", "see what is told of it"
            )
            self._lose(attribute)
            return KsyPart([{"require": f"not {condition.at_level(NOT)}"}])
        for one in dict.fromkeys(self._needs):
            if one not in (condition.text, *condition.parts):
                part.segments.insert(0, {"require": one})
        self._needs.clear()
        for segment in part.segments:
            own = segment.get("when")
            segment["when"] = condition.text if own is None else f"({condition.text}) and ({own})"
        entry = self.scope.entries[attribute.name]
        self.scope.entries[attribute.name] = replace(entry, when=condition.text, asked=condition.names)
        return KsyPart(part.segments, Sizes(0, part.sizes.most))

    def _whole(self, attribute: KsyAttribute, behind: int | None) -> KsyPart:
        """Return an attribute without its condition. Raises CannotSayError, LeftOutError."""
        repeat = attribute.text("repeat")
        if repeat is None:
            for key in ("repeat-expr", "repeat-until"):
                if key in attribute.keys:
                    raise CannotSayError(attribute.keys[key].at, f"{key}: without repeat:", "add repeat:")
            part = self._value(without_repeat(attribute), own_name(attribute.name), self.scope, behind)
        else:
            part = self._list(attribute, repeat, behind)
        if part.sizes.most != 0 and self.region.is_taken and not self._takes_all:
            raise CannotSayError(
                attribute.at, f"'{attribute.name}' stands behind what takes all that is left", "give it a size"
            )
        self._takes_all = False
        if attribute.doc and part.segments:
            part.segments[0].setdefault("doc", attribute.doc)
        return part

    _takes_all = False
    """Whether the current attribute takes all remaining bytes."""

    def take_all(self, at: Position, behind: int | None, what: str) -> None:
        """Record that a part takes all remaining bytes of the region. Raises CannotSayError if a part may follow."""
        if self.region.is_used_up:
            raise CannotSayError(at, f"{what} takes what is left, as another part does", "give one of them a size")
        if behind != 0:
            raise CannotSayError(
                at, f"{what} takes all that is left, and something may stand behind it", "give it a size"
            )
        self.region.is_taken = True
        self._takes_all = True

    # ---- expressions --------------------------------------------------------------------------------------

    def parsed(self, text: Scalar) -> Node:
        node = parse(one_number(text).text, text.at)
        self._count(text.at, sum(1 for _ in walk(node)))
        return node

    def say(
        self,
        node: Node,
        at: Position,
        kind: Kind | None = None,
        *,
        it: Translated | None = None,
        item: KsyScope | None = None,
        lazily: bool = False,
    ) -> Translated:
        """Return an expression in framekit's language. `item`: the names of the list item that contains the expression.

        The conditions it needs are recorded, unless it is evaluated `lazily`. Raises CannotSayError.
        """
        translation = Translation(self.scope, at, it, item is not None)
        made = translation.of(node)
        if kind is not None and made.kind != kind:
            raise CannotSayError(at, "an expression of another kind than is asked for", "correct it")
        if item is not None:
            hidden = (made.names - INDEX) & item.names
            if hidden:
                what = f"'{min(hidden)}', which an item of the list has too, is asked for in it"
                raise CannotSayError(at, what, "give one of them another name")
        try:
            parse_expression(made.text, at)
        except ExpressionError as error:
            raise CannotSayError(at, f"an expression is left out: {error.problem.what[:200]}", "divide it") from None
        for what, todo in translation.told:
            self.file.tell(at, what, todo, warning=True)
        if made.needs and not lazily:
            if item is not None or UNKNOWN in made.needs:
                raise CannotSayError(at, "an expression asks for what may not be there", "ask first whether it is")
            self._needs += made.needs
        return made

    def size(self, attribute: KsyAttribute, behind: int | None, item: KsyScope | None) -> int | str:
        """Return a number of bytes, an expression, or `rest`. Raises CannotSayError."""
        text = scalar(attribute.keys["size"], "size")
        node = self.parsed(text)
        left = left_of(node)
        if left is not None:
            if behind is None or left != behind:
                raise CannotSayError(text.at, f"where '{attribute.name}' ends", _REST_IS)
            if self.region.is_used_up:
                raise CannotSayError(
                    text.at, f"'{attribute.name}' takes what is left, as another part does", "give it a size"
                )
            self.region.counts_back = True
            return "rest"
        made = self.say(node, text.at, "int", item=item)
        if not made.names and made.span is not None and made.span[0] == made.span[1]:
            size = made.span[0]
            if not 0 <= size <= MOST_BYTES:
                raise CannotSayError(text.at, f"a size of {size} bytes", f"0 to {MOST_BYTES} are possible")
            return size
        return _not_rest(made.text)

    def _unused(self, name: str) -> str:
        """Return a name that no value of this type has, the same in all cases of a choice."""
        if name not in self._unused_names:
            self._unused_names[name] = _not_in(name, self.scope.names)
            self.scope.names.add(self._unused_names[name])
        return self._unused_names[name]

    # ---- bits ---------------------------------------------------------------------------------------------

    def _next_bits(self, attribute: KsyAttribute, width: int, order: str) -> None:
        if attribute.keys.keys() & {"if", "repeat"}:
            raise CannotSayError(
                attribute.at, f"bits '{attribute.name}' that may not be there, or are several,", "take bytes"
            )
        if self._bits and self._bits[-1][2] != order:
            self._bits.clear()
            raise CannotSayError(
                attribute.at, f"'{attribute.name}' begins in a byte whose bits are counted otherwise", "take one order"
            )
        self.values.only(attribute, frozenset({"enum"}))
        self._bits.append((attribute, width, order))
        if sum(one[1] for one in self._bits) % 8 == 0:
            self._flush_bits()

    def _end_bits(self) -> None:
        if not self.alone:
            at = self._bits[-1][0].at
            raise CannotSayError(at, f"the type '{self.scope.type.name}' ends within a byte", "fill the byte up")
        self._flush_bits()

    def _flush_bits(self) -> None:
        """Write the bits so far as a number, whose last byte may be incomplete."""
        taken, self._bits = self._bits, []
        width = sum(one[1] for one in taken)
        size = -(-width // 8)
        places: Keys = {}
        values: Keys = {}
        more: list[Keys] = []
        little = taken[0][2] == "le"
        before = 0
        if size > 256:
            raise CannotSayError(taken[0][0].at, "more than 256 bytes of bits in a row", "take bytes")
        segment: Keys = {"bits": places, "of": f"u{8 * size}" if size <= 8 else "uint"}
        if size > 8:
            segment["size"] = size
        if size > 1 and (little != (self.file.order == "little")):
            segment["order"] = "little" if little else "big"
        for attribute, bits, _ in taken:
            low = before if little else 8 * size - before - bits
            before += bits
            name = own_name(attribute.name)
            places[name] = str(low) if bits == 1 else f"{low}-{low + bits - 1}"
            enum = self.values.enum(attribute)
            if enum is not None and all(0 <= one < 1 << bits for one in enum.members.values()):
                values[name] = self.file.table(enum)
            kind: Kind = "bool" if bits == 1 and enum is None else "int"
            self.scope.entries[attribute.name] = KsyMeaning(name, kind, bounds_of_bits(bits, False))
            more += self.values.valid(attribute, None, self.scope.entries[attribute.name], self.scope, None)
            if attribute.doc:
                segment["doc"] = (
                    f"{segment['doc']}; {name}: {attribute.doc}" if "doc" in segment else f"{name}: {attribute.doc}"
                )
        if values:
            segment["values"] = values
        if self.region.is_taken:
            raise CannotSayError(taken[0][0].at, "bits stand behind what takes all that is left", "give that a size")
        self._put(KsyPart([segment, *more], exactly(size)))

    # ---- values -------------------------------------------------------------------------------------------

    def _value(
        self, attribute: KsyAttribute, name: str, into: KsyScope, behind: int | None, item: KsyScope | None = None
    ) -> KsyPart:
        """Return a value with the name `name` in the scope `into`. Raises CannotSayError, LeftOutError."""
        self._count(attribute.at)
        said = attribute.keys.get("type")
        if "contents" in attribute.keys:
            self.values.only(attribute, frozenset({"contents", "size"}))
            return self.values.constant(attribute, name, into)
        if isinstance(said, MappingNode) and "size" in attribute.keys:
            return self._sized_switch(attribute, said, name, into, behind, item)
        if isinstance(said, MappingNode):
            return self._switch(attribute, said, name, into, behind, item)
        text = "" if said is None else scalar(said, "type").text.strip()
        bits = bits_of(attribute, self.scope.type)
        if (match := NUMBER.fullmatch(text)) is not None:
            size, signed = int(match[2]), match[1] == "s"
            return self.values.number(attribute, name, into, size, match[3], signed, item)
        if bits is not None:
            if bits[0] % 8:
                raise CannotSayError(attribute.at, f"bits '{attribute.name}' that fill no bytes", "take bytes")
            return self.values.number(attribute, name, into, bits[0] // 8, bits[1], False, item)
        if (match := FLOAT.fullmatch(text)) is not None:
            self.values.only(attribute, frozenset())
            segment: Keys = {"field": name, "type": f"f{8 * int(match[1])}", **self.values.order(attribute, match[2])}
            into.entries[attribute.name] = KsyMeaning(name, "float")
            more = self.values.valid(attribute, None, into.entries[attribute.name], into, item)
            return KsyPart([segment, *more], exactly(int(match[1])))
        if text in ("str", "strz"):
            return self._or_raw(attribute, name, into, behind, item, self.values.text)
        if not text:
            return self._or_raw(attribute, name, into, behind, item, self.values.data)
        return self._or_raw(attribute, name, into, behind, item, self._of_type)

    def _or_raw(
        self, attribute: KsyAttribute, name: str, into: KsyScope, behind: int | None, item: KsyScope | None,
        write: Callable[[KsyAttribute, str, KsyScope, int | None, KsyScope | None], KsyPart],
    ) -> KsyPart:  # fmt: skip
        """Return a value, or, if it has no form, its bytes under another name.

        The bytes are only used if any bytes of its size are valid; otherwise the error is raised.
        """
        before = replace(self.region)
        keys = attribute.keys
        try:
            return write(attribute, name, into, behind, item)
        except (CannotSayError, LeftOutError) as error:
            sized = "size" in keys or ("size-eos" in keys and attribute.flag("size-eos", False))
            if not sized or "valid" in keys or item is not None or not self.values.reads_any_bytes(attribute):
                raise
            self.region.is_taken, self.region.counts_back = before.is_taken, before.counts_back
            self._takes_all = False
            raw = self._unused(f"{name}_raw")
            plain = KsyAttribute(
                attribute.at, attribute.name, {k: v for k, v in keys.items() if k in ("size", "size-eos")}
            )
            part = self.values.data(plain, raw, into, behind, item)
            if isinstance(error, CannotSayError):
                self._tell(error)
            self.file.tell(
                attribute.at,
                f"the bytes of '{attribute.name}' stay as they are, as '{raw}'",
                "write by hand what is in them",
            )
            self._lose(attribute)
            return part

    # ---- types and choices --------------------------------------------------------------------------------

    def _used(self, attribute: KsyAttribute, text: str, item: KsyScope | None) -> tuple[KsyType, KsyScope]:
        """Return the type that a text names, and a scope for it with its parameters. Raises CannotSayError."""
        at = attribute.keys["type"].at
        name, _, arguments = text.partition("(")
        match = _USER.fullmatch(name.strip())
        type_ = None if match is None else self.scope.type.find_type(match[1])
        if type_ is None:
            what = f"the type '{text[:60]}', which is not in this file,"
            raise CannotSayError(at, what, "write it into this file")
        if type_ in self.using:
            raise CannotSayError(
                at, f"the type '{type_.name}', which stands in itself,", "a layout with depth: may say it"
            )
        if len(self.using) >= DEEPEST:
            raise CannotSayError(at, f"types that use each other deeper than {DEEPEST}", "put them together")
        scope = KsyScope(type_, self.scope, ("index",) if item is not None else (), item)
        given: tuple[Node, ...] = ()
        if arguments:
            made = self.parsed(Scalar(f"x.call({arguments}", at))
            given = getattr(made, "arguments", ())
        if len(given) != len(type_.params):
            raise CannotSayError(
                at, f"'{type_.name}' takes {len(type_.params)} parameters, {len(given)} are given", "correct it"
            )
        for param, node in zip(type_.params, given, strict=True):
            said = self.say(node, at, item=item)
            words = said.names
            if words & (scope.names - INDEX):
                what = f"a parameter of '{type_.name}', which has a name that is asked for in it,"
                raise CannotSayError(at, what, "give one of them another name")
            text_ = said.at_level(ATOM)
            scope.entries[param] = KsyMeaning(
                text_, said.kind, said.span, said.scope, said.item, said.cases, words=words
            )
        return type_, scope

    def _inside(self, scope: KsyScope, region: Region, behind: int | None, alone: bool) -> KsyPart:
        writer = TypeWriter(self.file, scope, region, behind, alone=alone, using=(*self.using, scope.type))
        return KsyPart(*writer.write())

    def _of_type(
        self, attribute: KsyAttribute, name: str, into: KsyScope, behind: int | None, item: KsyScope | None
    ) -> KsyPart:
        """Return a value of a type of the file: a record, or the values of an item if `name` is empty."""
        self.values.only(
            attribute, frozenset({"size", "size-eos", "process", "terminator", "pad-right", "include", "consume"})
        )
        keys = attribute.keys
        for key in ("process", "terminator", "pad-right", "valid"):
            if key in keys:
                raise CannotSayError(
                    keys[key].at, f"{key}: of '{attribute.name}', which has a type,", "write by hand what it means"
                )
        type_, scope = self._used(attribute, scalar(keys["type"], "type").text.strip(), item)
        if "size" in keys or attribute.flag("size-eos", False):
            size: int | str = "rest"
            if "size" in keys:
                size = self.size(attribute, behind, item if name else scope)
            else:
                self.take_all(attribute.at, behind, f"'{attribute.name}'")
            part = self._region(type_, scope, name, size)
        else:
            before = self.region.is_taken
            part = self._inside(scope, self.region, behind, False)
            if self.region.is_taken and not before:
                self._takes_all = True
            part = KsyPart(self._record(type_, part.segments, name), part.sizes)
        into.entries[attribute.name] = KsyMeaning(name, "record", scope=scope)
        return part

    def _region(self, type_: KsyType, scope: KsyScope, name: str, size: int | str) -> KsyPart:
        """Return a type in a region of its own, with the remaining bytes of the region."""
        region = Region()
        part = self._inside(scope, region, 0, True)
        sizes = exactly(size) if isinstance(size, int) else ANY
        if isinstance(size, int) and part.sizes.least > size:
            raise CannotSayError(type_.at, f"'{type_.name}' takes more bytes than the {size} there are", "correct size")
        of = self._record(type_, part.segments, name)
        if not region.is_used_up and part.sizes.fixed != size:
            rest = self._unused(f"{name}_rest") if name else _not_in("rest", scope.names)
            of = [*of, {"data": rest, "size": "rest" if of or size == "rest" else size}]
            if len(of) == 1:
                return KsyPart(of, sizes)
        return KsyPart(of if size == "rest" or not of else [{"wrap": "none", "size": size, "of": of}], sizes)

    def _record(self, type_: KsyType, segments: list[Keys], name: str) -> list[Keys]:
        """Return the values of a type as a record, or unchanged if they belong to an item."""
        if not segments or not name:
            return segments
        return [{"include": self.file.layout(type_, segments), "as": name}]

    def _switch(
        self, attribute: KsyAttribute, said: MappingNode, name: str, into: KsyScope, behind: int | None,
        item: KsyScope | None,
    ) -> KsyPart:  # fmt: skip
        chosen, cases = self._choice(attribute, said, item)
        found: dict[int | str, KsyPart] = {}
        otherwise: KsyPart | None = None
        branches = _Branches(replace(self.region))
        for case in cases.entries:
            key = None if case.key.text == "_" else self._case(case.key, chosen.kind)
            if key in found:
                raise CannotSayError(case.key.at, f"the case {case.key.text[:40]!r} stands twice", "leave one out")
            branches.enter(self.region)
            self._takes_all = False
            part = self._part_of_case(attribute, case, name, into, behind, item, branches)
            branches.leave(self.region, self._takes_all)
            if key is None:
                otherwise = part
            else:
                found[key] = part
        branches.enter(self.region)
        said_otherwise = otherwise is not None
        if otherwise is None:
            otherwise = KsyPart([])
            if attribute.keys.keys() & {"size", "size-eos"}:
                otherwise = self._value(with_keys(attribute, type=None), name, into, behind, item)
                branches.meanings.append(("", into.entries[attribute.name]))
                branches.leave(self.region, self._takes_all)
        branches.join(self.region)
        self._takes_all = branches.takes_all
        always = said_otherwise or (found.keys() == {0, 1} and chosen.kind == "bool")
        into.entries[attribute.name] = entry_of_cases(name, branches.meanings, always)
        return KsyPart([choose(chosen, found, otherwise)], either(one.sizes for one in (*found.values(), otherwise)))

    def _choice(
        self, attribute: KsyAttribute, said: MappingNode, item: KsyScope | None
    ) -> tuple[Translated, MappingNode]:  # fmt: skip
        """Return the value that selects the type of an attribute, and the cases. Raises CannotSayError."""
        on, cases = said.value("switch-on"), said.value("cases")
        if on is None or not isinstance(cases, MappingNode) or len(said.entries) != 2:
            raise CannotSayError(said.at, f"the type of '{attribute.name}'", "write switch-on: and cases:")
        if "valid" in attribute.keys:
            what = f"valid: of '{attribute.name}', which is a choice,"
            raise CannotSayError(attribute.keys["valid"].at, what, "write it into its types")
        chosen = self.say(self.parsed(scalar(on, "switch-on")), on.at, item=item)
        if chosen.kind not in ("int", "bool", "str"):
            raise CannotSayError(on.at, "a choice by what is no number and no text", "choose by a number")
        return chosen, cases

    def _part_of_case(
        self, attribute: KsyAttribute, case: Entry, name: str, into: KsyScope, behind: int | None,
        item: KsyScope | None, branches: _Branches,
    ) -> KsyPart:  # fmt: skip
        """Return the part of a case; a case that cannot be read is reported, and its frames are refused."""
        try:
            part = self._value(with_keys(attribute, type=case.value), name, into, behind, item)
            if part.sizes.most != 0 and branches.before.is_taken:
                what = f"'{attribute.name}' stands behind what takes all that is left"
                raise CannotSayError(case.value.at, what, "give it a size")
        except (CannotSayError, LeftOutError) as error:
            if isinstance(error, CannotSayError):
                self._tell(error)
            what = f"a frame with the case {case.key.text[:40]!r} of '{attribute.name}' is refused"
            self.file.tell(case.value.at, what, "see what is told of it")
            return KsyPart([{"require": "false"}])
        type_ = case.value.text if isinstance(case.value, Scalar) else ""
        branches.meanings.append((type_.partition("(")[0].strip(), into.entries[attribute.name]))
        return part

    def _sized_switch(
        self,
        attribute: KsyAttribute,
        said: MappingNode,
        name: str,
        into: KsyScope,
        behind: int | None,
        item: KsyScope | None,
    ) -> KsyPart:
        """Return a choice in a region of its own, which each case fills."""
        size = self.size(attribute, behind, item)
        outer, self.region = self.region, Region()
        whole = with_keys(attribute, size=None, **{"size-eos": Scalar("true", attribute.at)})
        try:
            part = self._switch(whole, said, name, into, 0, item)
        finally:
            self.region, self._takes_all = outer, False
        if size == "rest":
            return KsyPart(part.segments, ANY)
        segment = {"wrap": "none", "size": size, "of": part.segments}
        return KsyPart([segment], exactly(size) if isinstance(size, int) else ANY)

    def _case(self, key: Scalar, kind: Kind) -> int | str:
        """Return the constant key of a case. Raises CannotSayError."""
        said = self.say(self.parsed(key), key.at)
        node = parse(key.text, key.at)
        if said.kind == kind and said.span is not None and said.span[0] == said.span[1] and not said.names:
            return said.span[0]
        value = getattr(node, "value", None)
        if kind == said.kind == "str" and isinstance(value, str) and not said.names:
            return value
        raise CannotSayError(
            key.at, f"the case {key.text[:40]!r}, which is no constant,", "write a number, a text or a member"
        )

    # ---- lists --------------------------------------------------------------------------------------------

    def _list(self, attribute: KsyAttribute, repeat: str, behind: int | None) -> KsyPart:
        at, before = attribute.at, replace(self.region)
        item = self._item(attribute, repeat)
        if (self.region.is_taken, self.region.counts_back) != (before.is_taken, before.counts_back):
            raise CannotSayError(at, f"an item of '{attribute.name}' takes all that is left", "give it a size")
        if not item.part.segments:
            raise CannotSayError(at, f"items of '{attribute.name}' that take no bytes", "leave them out")
        end, sizes = self._end_of_list(attribute, repeat, behind, item)
        if not isinstance(end.get("times"), int) and item.part.sizes.least == 0 and "until" not in end:
            raise CannotSayError(at, f"an item of '{attribute.name}' may take no bytes", "give its items a size")
        self.scope.entries[attribute.name] = item.entry
        return KsyPart([{"repeat": own_name(attribute.name)} | end | item.keys], sizes)

    def _item(self, attribute: KsyAttribute, repeat: str) -> _ListItem:
        """Return the item of a list: a plain number, a type, or a record with one value. Raises CannotSayError."""
        keys, at = attribute.keys, attribute.at
        name = own_name(attribute.name)
        single = without_repeat(attribute)
        said = keys.get("type")
        plain = not keys.keys() & {"enum", "valid", "contents"} and repeat != "until" and isinstance(said, Scalar)
        if isinstance(said, Scalar) and plain and (NUMBER.fullmatch(said.text) or FLOAT.fullmatch(said.text)):
            item = KsyScope(KsyType("item", at, None), self.scope)
            part = self._value(single, "value", item, None)
            of = {"of" if key == "type" else key: one for key, one in part.segments[0].items() if key != "field"}
            entry = KsyMeaning(name, "list", item=item.entries[attribute.name].kind)
            return _ListItem(part, of, entry, Translated("", ATOM, "int", names=IT), item)
        if isinstance(said, Scalar) and not is_built_in(said.text.strip()):
            taker = KsyScope(self.scope.type, self.scope)
            around = KsyScope(KsyType("item", at, None), self.scope, ("index",))
            part = self._value(single, "", taker, None, around)
            item = taker.entries[attribute.name].scope or around
            it = Translated("", ATOM, "record", names=IT, scope=item, above=True)
            entry = KsyMeaning(name, "list", scope=item, item="record")
            return _ListItem(part, {"of": part.segments}, entry, it, item)
        item = KsyScope(KsyType("item", at, None), self.scope, ("value", "index"))
        part = self._value(single, "value", item, None, item)
        made = item.entries[attribute.name]
        it = Translated(made.text, ATOM, made.kind, made.span, IT, scope=made.scope, item=made.item, cases=made.cases)
        entry = KsyMeaning(name, "list", scope=made.scope, item=made.kind, cases=made.cases, suffix=".value")
        return _ListItem(part, {"of": part.segments}, entry, it, item)

    def _end_of_list(
        self, attribute: KsyAttribute, repeat: str, behind: int | None, item: _ListItem
    ) -> tuple[Keys, Sizes]:  # fmt: skip
        """Return the key that ends a list, and the sizes of the list. Raises CannotSayError."""
        keys, at = attribute.keys, attribute.at
        match repeat:
            case "eos":
                self.take_all(at, behind, f"the list '{attribute.name}'")
                return {"times": "rest"}, ANY
            case "expr" if "repeat-expr" in keys:
                node = scalar(keys["repeat-expr"], "repeat-expr")
                times = self.say(self.parsed(node), node.at, "int")
                if not times.names and times.span is not None and times.span[0] == times.span[1]:
                    count = times.span[0]
                    if not 1 <= count <= MOST_BYTES:
                        raise CannotSayError(node.at, f"a list of {count} items", "leave it out")
                    return {"times": count}, item.part.sizes.times(count, count)
                safe = times.span is not None and times.span[0] >= 0
                return {"times": _not_rest(times.text) if safe else f"max({times.text}, 0)"}, ANY
            case "until" if "repeat-until" in keys:
                node = scalar(keys["repeat-until"], "repeat-until")
                condition = self.say(self.parsed(node), node.at, "bool", it=item.it, item=item.scope)
                return {"until": condition.text}, Sizes(item.part.sizes.least, None)
        raise CannotSayError(at, f"repeat: {repeat[:30]!r}", "write expr, eos or until, with what belongs to it")

    # ---- what may be left ---------------------------------------------------------------------------------

    def _optional(self, attribute: KsyAttribute, left: int, behind: int | None) -> KsyPart:
        """Return a part that is present if more bytes remain than the parts after it take."""
        if behind is None or left != behind:
            raise CannotSayError(attribute.at, f"whether '{attribute.name}' is there", _REST_IS)
        if self.region.is_used_up:
            raise CannotSayError(
                attribute.at, f"'{attribute.name}' asks what is left, as another part does", "give one a size"
            )
        part = self._whole(with_keys(attribute, **{"if": None}), behind)
        self.region.is_taken = self.region.is_taken or behind == 0
        self.region.counts_back = True
        self.scope.entries[attribute.name] = replace(self.scope.entries[attribute.name], when=UNKNOWN)
        if part.sizes.least == 0:
            raise CannotSayError(
                attribute.at, f"'{attribute.name}' may take no bytes where some are left", "give it a size"
            )
        return KsyPart([{"optional": part.segments}], Sizes(0, part.sizes.most))

    def _optional_chain(self) -> int:
        """Return the index of the first of several trailing attributes that are present if bytes remain.

        The result is -1 for fewer than two such attributes.
        """
        seq = self.scope.type.seq
        first = len(seq)
        while first > 0 and self.behind == 0:
            condition = seq[first - 1].keys.get("if")
            try:
                asked = parse(condition.text, condition.at) if isinstance(condition, Scalar) else None
            except CannotSayError:
                asked = None
            if asked is None or left_more(asked) != 0:
                break
            first -= 1
        return first if len(seq) - first > 1 else -1

    def _optionals(self, attributes: list[KsyAttribute]) -> None:
        """Write attributes that are present if bytes remain: each is nested in the previous one."""
        if len(attributes) > MOST_OPTIONALS:
            what = f"more than {MOST_OPTIONALS} attributes in a row, each there if bytes are left,"
            raise CannotSayError(attributes[0].at, what, "put them into a list")
        if self._bits:
            self._flush_bits()
        if self.region.is_used_up:
            raise CannotSayError(
                attributes[0].at, f"'{attributes[0].name}' asks what is left, as another part does", "give one a size"
            )
        outer: list[Keys] = self.out
        for attribute in attributes:
            kept, self.out = self.out, []
            try:
                self._known_keys(attribute)
                if self.region.is_taken:
                    raise CannotSayError(
                        attribute.at,
                        f"'{attribute.name}' stands behind what takes all that is left",
                        "give that a size",
                    )
                last = attribute is attributes[-1]
                part = self._whole(with_keys(attribute, **{"if": None}), 0 if last else None)
                if part.sizes.least == 0:
                    raise CannotSayError(
                        attribute.at, f"'{attribute.name}' may take no bytes where some are left", "give it a size"
                    )
                inside = [*self.out, *part.segments]
            finally:
                self.out = kept
            self.scope.entries[attribute.name] = replace(self.scope.entries[attribute.name], when=UNKNOWN)
            outer.append({"optional": inside})
            outer = inside
        self.region.is_taken = True
        self.sizes = Sizes(self.sizes.least, None)

    # ---- instances ----------------------------------------------------------------------------------------

    def _find(self, name: str, at: Position) -> KsyMeaning | None:
        """Return the entry of an instance, whose value is written here; None if it is unknown or not available yet."""
        instance = self.scope.type.instances.get(name)
        if instance is None or name in self._under_way:
            return self._find_outside(name, at)
        if len(self._under_way) >= DEEPEST:
            raise CannotSayError(at, f"instances that ask for each other deeper than {DEEPEST}", "put them together")
        self._under_way.add(name)
        try:
            entry = self._instance(instance)
        finally:
            self._under_way.discard(name)
        self.scope.entries[name] = entry
        return entry

    def _instance(self, instance: KsyAttribute) -> KsyMeaning:
        keys = instance.keys
        if "value" not in keys:
            what = f"the instance '{instance.name}' is left out: it stands at a place of its own"
            raise CannotSayError(instance.at, what, "a definition reads bytes in their order")
        for key in keys:
            if key not in ("value", "if", "enum", "doc", "doc-ref") and not key.startswith("-"):
                raise CannotSayError(keys[key].at, f"{key}: of the instance '{instance.name}'", "leave it out")
        self._count(instance.at)
        text = scalar(keys["value"], "value")
        said = self.say(self.parsed(text), text.at, lazily=True)
        needs = [*dict.fromkeys(said.needs)]
        condition: Translated | None = None
        if "if" in keys:
            condition = self.say(self.parsed(scalar(keys["if"], "if")), keys["if"].at, "bool", lazily=True)
            known = [
                one for one in needs if one not in (UNKNOWN, *condition.parts)
            ]  # the file states itself when the instance is present
            needs = [*dict.fromkeys((*condition.needs, condition.text, *known))]
        if UNKNOWN in needs:
            what = f"the instance '{instance.name}' asks for what may not be there"
            raise CannotSayError(text.at, what, "write it by hand")
        when = needs[0] if len(needs) == 1 else " and ".join(f"({one})" for one in needs)
        asked = said.names if condition is None else said.names | condition.names
        if said.kind in ("record", "choice"):
            if said.above:
                raise CannotSayError(
                    text.at, f"the instance '{instance.name}' is left out: it is what stands around", ""
                )
            return KsyMeaning(
                said.text, said.kind, None, said.scope, said.item, said.cases, when, asked, words=said.names
            )
        if "enum" in keys:
            what = f"the names of '{instance.name}' are left out"
            self.file.tell(keys["enum"].at, what, "framekit names numbers that are read", warning=True)
        name = own_name(instance.name)
        segment: Keys = {"value": name, "read": said.text}
        if when:
            segment["when"] = when
        if instance.doc:
            segment["doc"] = instance.doc
        self.out.append(segment)
        return KsyMeaning(name, said.kind, said.span, said.scope, said.item, when=when, asked=asked)


def _not_rest(text: str) -> str:
    """Return an expression as a size or count; the bare word `rest` would mean the remaining bytes."""
    return "(rest)" if text == "rest" else text


def _sizes_of(segment: Keys) -> Iterator[tuple[str, str]]:
    """Yield the names that are the whole size of a segment, or the count of a list, each with its key."""
    if isinstance(segment.get("times"), str):
        yield "count", segment["times"]
    elif isinstance(segment.get("size"), str) and "repeat" not in segment:
        yield "length", segment["size"]


def _not_in(name: str, taken: set[str]) -> str:
    made, number = name, 2
    while made in taken:
        made, number = f"{name}_{number}", number + 1
    return made
