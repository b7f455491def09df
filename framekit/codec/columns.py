"""What decoding many frames gives: columns of those that look alike, and single results of all others."""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any

from framekit.codec.errors import FrameError

Path = tuple[str, ...]


@dataclass(frozen=True, slots=True)
class BatchGroup:
    """Good frames with the same fields at the same places.

    `rows`: their numbers, ascending. `columns`: by the path of a field one array of numbers, or of bytes with a row of
    them a frame; in the order of the frame. `pdu.read.count` has the path `("pdu", "read", "count")`.
    """

    rows: Any
    columns: dict[Path, Any]

    def values(self, place: int) -> dict[str, Any]:
        """The values of the frame `rows[place]`, as `decode` gives them."""
        found: dict[str, Any] = {}
        for path, column in self.columns.items():
            into = found
            for name in path[:-1]:
                into = into.setdefault(name, {})
            into[path[-1]] = column[place].tobytes() if column.ndim == 2 else int(column[place])
        return found


class Batch:
    """The results of many frames by their numbers: `batch[n]` is what `decode` gives, or raises its FrameError.

    `groups` hold most of them; `singles` those that had to be read one by one.
    """

    def __init__(self, size: int, groups: list[BatchGroup], singles: dict[int, dict[str, Any] | FrameError]) -> None:
        self.groups = groups
        self.singles = singles
        self._size = size

    def __len__(self) -> int:
        return self._size

    def __getitem__(self, index: int) -> dict[str, Any]:
        if not 0 <= index < self._size:
            raise IndexError(index)
        found = self.singles.get(index)
        if isinstance(found, FrameError):
            raise found
        if found is not None:
            return found
        for group in self.groups:
            place = int(group.rows.searchsorted(index))
            if place < len(group.rows) and group.rows[place] == index:
                return group.values(place)
        raise IndexError(index)

    @property
    def faults(self) -> dict[int, FrameError]:
        """The frames that are none, by their numbers."""
        return {index: found for index, found in self.singles.items() if isinstance(found, FrameError)}

    def __iter__(self) -> Iterator[dict[str, Any] | FrameError]:
        """All results in order; a FrameError stands for itself."""
        for index in range(self._size):
            single = self.singles.get(index)
            yield self[index] if single is None else single


@dataclass(frozen=True, slots=True)
class Cut:
    """Frame n is `data[starts[n] : starts[n] + lengths[n]]`."""

    data: bytes
    starts: array[int]
    lengths: array[int]

    @classmethod
    def of(cls, frames: Sequence[bytes]) -> Cut:
        """Frames that are bytes by themselves."""
        lengths = array("q", map(len, frames))
        starts = array("q", [0, *accumulate(lengths)][: len(frames)])
        return cls(b"".join(frames), starts, lengths)

    def __len__(self) -> int:
        return len(self.starts)

    def __getitem__(self, index: int) -> bytes:
        start = self.starts[index]
        return self.data[start : start + self.lengths[index]]
