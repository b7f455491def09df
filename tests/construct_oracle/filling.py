"""Values of a record that is being built: given values, and values computed from them on demand.

Values are computed in whatever order they need each other, and may refer to later fields and to sizes of segments. Each
kind of segment computes its own values.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from io import BytesIO
from typing import Any, Protocol

from construct import Container

from construct_oracle.evaluate import BYTES_OF, attribute, evaluate
from construct_oracle.faults import ConstructEncodeError
from construct_oracle.names import Names
from construct_oracle.state import Writing
from framekit.codec.evaluate import EVALUATION_ERRORS, MissingName
from framekit.codec.support import room
from framekit.definition.expression import Expression, names_in
from framekit.definition.model.segments import ITEM_WORDS

Condition = Callable[["Filling"], bool]
MISSING: Any = object()


class Circular(Exception):  # noqa: N818 - caught where a value may do without, else turned into an error
    """A value that depends on itself; `name` is its path."""

    def __init__(self, name: str) -> None:
        self.name = name
        super().__init__(name)


class Absent(KeyError):  # noqa: N818 - a KeyError for expressions, a signal for others
    """A value whose segment is absent."""


class Owner(Protocol):
    """The interface of a segment's construct that a filling uses."""

    def fill(self, filling: Filling, name: str) -> Any:
        """Return the value of `name`, given or computed. Raises EncodeError, Absent."""

    def refuse_absent(self, filling: Filling, name: str) -> None:
        """Refuse a value `name` that was given for an absent segment. Raises EncodeError."""

    def _build(self, obj: Any, stream: Any, context: Any, path: str) -> Any: ...


@dataclass(slots=True)
class Part:
    """The construct of a segment with its conditions of presence: those of its holders, and its own `when`."""

    construct: Owner
    holders: tuple[Condition, ...]
    when: Condition | None = None

    def is_held(self, filling: Filling) -> bool:
        """Return whether all holders are present; for example, whether the case is the chosen case."""
        return all(condition(filling) for condition in self.holders)

    def is_there(self, filling: Filling) -> bool:
        """Return whether the segment is part of the frame."""
        return self.is_held(filling) and (self.when is None or self.when(filling))


@dataclass(slots=True)
class Plan:
    """Values and segments of a record by name; a name has several parts if cases share it."""

    values: dict[str, list[Part]] = field(default_factory=dict)
    segments: dict[str, list[Part]] = field(default_factory=dict)


class Filling(Mapping[str, Any]):
    """The values of a record under construction; reading a value computes it. `path` is the prefix of its names.

    `item` is the list that the record is an item of, and its index; in the record's expressions, the list ends before
    that item. `words` are the item words, such as index and last.
    """

    def __init__(
        self,
        plan: Plan,
        given: Mapping[str, Any],
        names: Names,
        outer: Filling | None = None,
        path: str = "",
        echo: Mapping[str, Expression] | None = None,
        item: tuple[str, int] | None = None,
    ) -> None:
        self.plan = plan
        self.given = given
        self.names = names
        self.outer = outer
        self.path = path
        self.echo = echo or {}
        self.item = item
        self.words: dict[str, Any] = {}
        self._done: dict[str, Any] = {}
        self._running: set[str] = set()
        for name in given:
            if name not in plan.values:
                raise self.error(str(name), f"there is no field '{name}' here")

    # ---- values -------------------------------------------------------------------------------------------

    def __getitem__(self, name: str) -> Any:
        """Return the value of a field. Raises EncodeError, Circular, and Absent if its segment is absent."""
        if name not in self._done:
            if name in self._running:
                raise Circular(self.path + name)
            self._running.add(name)
            try:
                self._done[name] = self._owner(name).fill(self, name)
            finally:
                self._running.discard(name)
        return self._done[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.plan.values)

    def __len__(self) -> int:
        return len(self.plan.values)

    def __contains__(self, name: object) -> bool:
        try:
            self[str(name)]
        except KeyError:
            return False
        return True

    def _owner(self, name: str) -> Owner:
        parts = self.plan.values[name]
        return parts[0].construct if len(parts) == 1 else self._meant(parts, name).construct

    def _meant(self, parts: list[Part], name: str) -> Part:
        """Return the present part, else a part whose holders are present and that may have a default. Raises Absent."""
        held = [part for part in parts if part.is_held(self)]
        if not held:
            raise Absent(name)
        if len(held) == 1:  # its presence may depend on its own value
            return held[0]
        return next((part for part in held if part.when is None or part.when(self)), held[0])

    def _part(self, parts: list[Part], name: str) -> Part:
        """Return the present part. Raises Absent."""
        for part in parts:
            if part.is_there(self):
                return part
        raise Absent(name)

    def is_there(self, name: str) -> bool:
        """Return whether the segment of a value is part of the frame."""
        try:
            self._part(self.plan.values[name], name)
        except Absent:
            return False
        return True

    def is_held(self, name: str) -> bool:
        """Return whether all holders of a value are present; for example, whether its case is the chosen case."""
        return any(part.is_held(self) for part in self.plan.values[name])

    def refuse_absent(self) -> None:
        """Refuse values that were given for absent segments. Raises EncodeError."""
        for name, value in self.given.items():
            if not self.is_there(name):
                try:
                    owner = self._meant(self.plan.values[name], name).construct
                except Absent:
                    raise self.error(name, f"'{name}' is not part of this frame, but {value!r} is given") from None
                owner.refuse_absent(self, name)

    def given_of(self, name: str) -> Any:
        """Return the value that the caller gave, or MISSING."""
        return self.given.get(name, MISSING)

    def echo_of(self, name: str) -> Any:
        """Return the value of the request field that this field repeats, or MISSING without request."""
        expression = self.echo.get(name)
        if expression is None:
            return MISSING
        try:
            request = self.names["request"]
        except MissingName:
            return MISSING

        def lookup(word: str) -> Any:
            if word != "request":
                try:
                    return attribute(request, word)
                except EVALUATION_ERRORS:
                    pass
            return self.names[word]

        try:
            return evaluate(expression.root, lookup)
        except (MissingName, *EVALUATION_ERRORS):
            return MISSING

    def value_or_nothing(self, name: str) -> Any:
        """Return the value of a field for expressions. Raises EncodeError, Circular."""
        try:
            return self[name]
        except Absent:
            return None

    # ---- expressions --------------------------------------------------------------------------------------

    def evaluate(self, expression: Expression, own: str = "") -> Any:
        """Return the value of an expression; the name `own` refers to the outer record.

        Also raises EVALUATION_ERRORS.
        """

        def lookup(name: str) -> Any:
            if name.startswith(BYTES_OF):
                return self.size_of_frame(name.removeprefix(BYTES_OF))
            if name in ITEM_WORDS.values():
                return self.word(name)
            filling: Filling | None = self
            item: tuple[str, int] | None = None
            while filling is not None:
                if name != own or filling is not self:
                    if name in filling.plan.values:
                        value = filling.value_or_nothing(name)
                        return value[: item[1]] if item is not None and item[0] == name else value
                    if name in filling.plan.segments:
                        return filling.bytes_of(name)
                item, filling = filling.item, filling.outer
            return self.names[name]

        return evaluate(expression.root, lookup)

    def word(self, name: str) -> Any:
        """Return an item word of the enclosing item."""
        filling: Filling | None = self
        while filling is not None and not filling.words:
            filling = filling.outer
        assert filling is not None, "words of items are in items alone"
        return filling.words[name]

    def compute(self, expression: Expression, own: str) -> Any:
        """Return the value of an expression of the field `own`. Raises EncodeError if it cannot be evaluated."""
        try:
            return self.evaluate(expression, own)
        except ConstructEncodeError:
            raise
        except MissingName as error:
            raise self.error(own, f"'{own}' stands on '{error.name}', which the context does not have") from None
        except EVALUATION_ERRORS:
            raise self.error(own, f"'{own}' cannot be computed from '{expression}' and the values given") from None

    def size(self, expression: Expression, own: str) -> Any:
        """Return the value of a size expression, or None if it depends on a name that has no value yet."""
        for name in names_in(expression.root):
            if not self._is_field(name) and self.names.is_unset(name):
                return None
        size = self.compute(expression, own)
        if size is None:
            raise self.error(own, f"what the size of '{own}' is worked out from is not there")
        try:
            return room(size) if isinstance(size, int) else size
        except ValueError as error:
            raise self.error(own, str(error)) from None

    def _is_field(self, name: str) -> bool:
        filling: Filling | None = self
        while filling is not None and name not in filling.plan.values and name not in filling.plan.segments:
            filling = filling.outer
        return filling is not None

    def error(self, name: str, message: str) -> ConstructEncodeError:
        """Return an EncodeError for a field of this record."""
        return ConstructEncodeError(self.path + name, message)

    # ---- sizes --------------------------------------------------------------------------------------------

    def size_of(self, name: str, plain: bool = False) -> int:
        """Return the size of a segment in bytes, on the wire or before conversion; 0 if it is absent."""
        stream, context = self._scratch()
        self._build_segment(name, stream, context)
        if not plain:
            return stream.tell()
        return sum(leaf.plain for leaf in context._state.leaves)

    def size_of_frame(self, name: str) -> int:
        """Return the size of an inner frame of this record or an outer record. Raises KeyError if it is missing."""
        filling: Filling | None = self
        while filling is not None and name not in filling.plan.values:
            filling = filling.outer
        if filling is None:
            raise KeyError(name)
        return filling.size_of(name)

    def size_of_all(self, constructs: Iterable[Owner]) -> int:
        """Return the total size of segments of this record."""
        stream, context = self._scratch()
        for construct in constructs:
            construct._build(self, stream, context, "(measuring)")
        return stream.tell()

    def bytes_of(self, name: str) -> bytes:
        """Return the bytes of a segment before its wrap is applied."""
        stream, context = self._scratch()
        self._build_segment(name, stream, context)
        state: Writing = context._state
        return state.bytes_of(0, len(state.leaves))

    def _build_segment(self, name: str, stream: BytesIO, context: Container) -> None:
        filling: Filling = self
        while name not in filling.plan.segments and filling.outer is not None:
            filling = filling.outer
        try:
            part = filling._part(filling.plan.segments[name], name)
        except Absent:
            return
        part.construct._build(filling, stream, context, "(measuring)")

    def _scratch(self) -> tuple[BytesIO, Container]:
        context = Container(_=Container(), _params=Container(), _is_frame=True, _marks={})
        context._state = Writing(self.names, measuring=True)
        return BytesIO(), context
