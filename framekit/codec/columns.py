"""Hold the results of decoding many frames: columns for frames of the same structure, single results for all others."""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any

from framekit.codec.errors import FrameError

Path = tuple[str, ...]
"""The path of a field: `pdu.read.count` is `("pdu", "read", "count")`."""


@dataclass(frozen=True, slots=True)
class BatchGroup:
    """Valid frames with the same fields at the same offsets."""

    rows: Any
    """The numbers of the frames, ascending."""
    columns: dict[Path, Any]
    """An array for each field path, in frame order: one number per frame, or one row of bytes per frame."""

    def values(self, place: int) -> dict[str, Any]:
        """Return the values of the frame `rows[place]`, equal to the result of `decode`."""
        found: dict[str, Any] = {}
        for path, column in self.columns.items():
            into = found
            for name in path[:-1]:
                into = into.setdefault(name, {})
            into[path[-1]] = column[place].tobytes() if column.ndim == 2 else int(column[place])
        return found


class Batch:
    """The results of many frames: `batch[n]` returns the values of frame n, or raises its FrameError.

    Raises IndexError for a number outside of the batch.
    """

    def __init__(self, size: int, groups: list[BatchGroup], singles: dict[int, dict[str, Any] | FrameError]) -> None:
        self.groups = groups
        """The columns of most frames."""
        self.singles = singles
        """The results of frames that were decoded individually, by number."""
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
        """Return the errors of the invalid frames, by number."""
        return {index: found for index, found in self.singles.items() if isinstance(found, FrameError)}

    def __iter__(self) -> Iterator[dict[str, Any] | FrameError]:
        """Yield all results in order; an invalid frame yields its FrameError."""
        for index in range(self._size):
            single = self.singles.get(index)
            yield self[index] if single is None else single


@dataclass(frozen=True, slots=True)
class Cut:
    """Frames as parts of one buffer: frame n is `data[starts[n] : starts[n] + lengths[n]]`."""

    data: bytes
    starts: array[int]
    lengths: array[int]

    @classmethod
    def of(cls, frames: Sequence[bytes]) -> Cut:
        """Join separate frames to one buffer."""
        lengths = array("q", map(len, frames))
        starts = array("q", [0, *accumulate(lengths)][: len(frames)])
        return cls(b"".join(frames), starts, lengths)

    def __len__(self) -> int:
        return len(self.starts)

    def __getitem__(self, index: int) -> bytes:
        start = self.starts[index]
        return self.data[start : start + self.lengths[index]]
