"""What calls of the API give back: values that were read, answers of services, frames. Plain frozen objects."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar, overload

T = TypeVar("T")
"""What the values are: int, float or str."""


@dataclass(frozen=True, slots=True, eq=False)
class Reading(Sequence[T], Generic[T]):
    """Values that were read, in the order asked: a sequence, equal to a list or tuple of the same values.

    `type` is the unit or type they have, `addresses` where they were read, `station` from whom, `data` the same in
    device memory's form (low byte first, bits packed), `raw` the bytes of the last reply frame.
    """

    values: tuple[T, ...]
    type: str
    addresses: tuple[str, ...]
    station: Any
    data: bytes
    raw: bytes = b""

    @property
    def value(self) -> T:
        """The first value: the only one where one was asked for."""
        return self.values[0]

    @overload
    def __getitem__(self, index: int) -> T: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[T, ...]: ...
    def __getitem__(self, index: int | slice) -> T | tuple[T, ...]:
        return self.values[index]

    def __len__(self) -> int:
        return len(self.values)

    def __iter__(self) -> Iterator[T]:
        return iter(self.values)

    def __eq__(self, other: object) -> bool:
        if isinstance(other, Reading):
            return self.values == other.values
        if isinstance(other, (list, tuple)):
            return self.values == tuple(other)
        return NotImplemented

    def __hash__(self) -> int:
        return hash(self.values)

    def __repr__(self) -> str:
        return f"Reading({list(self.values)!r}, {self.type} at {', '.join(self.addresses)})"


@dataclass(frozen=True, slots=True)
class Frame:
    """A frame: its name, its fields as the codec gives them (an inner frame is `{name: fields}`), its bytes.

    `refusal` is the code a server refuses it with.
    """

    name: str
    fields: Mapping[str, Any]
    raw: bytes = b""
    refusal: int | None = None

    def __getitem__(self, name: str) -> Any:
        return self.fields[name]


@dataclass(frozen=True, slots=True)
class Answer:
    """What a service brought: `results` by the names the protocol gives them, and its reply frame, if there is one.

    `raw` are the bytes that came last; the reply may be a frame inside them.
    """

    results: Mapping[str, Any] = field(default_factory=dict)
    reply: Frame | None = None
    raw: bytes = b""

    def __getitem__(self, name: str) -> Any:
        return self.results[name]
