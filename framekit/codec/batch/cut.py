"""Frames that are cut already: one long row of bytes, and where each frame begins and how long it is."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate


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
