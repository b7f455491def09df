"""Frames that cannot be told apart where both are waited for: found by building one and reading it as the other.

A receiver tries the frames of a receive matrix in the order of its rows. A frame whose every sample an earlier one
takes is never found; that is an error. Reference, sections 6 and 14. Which bytes come on a line is not known here.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from heapq import merge
from operator import itemgetter
from typing import Any

from framekit.codec.codec import Codec, compile_protocol
from framekit.codec.double_errors import check_weak_codes
from framekit.codec.errors import FrameError
from framekit.codec.hidden_ends import check_ends_inside, check_hidden_ends, check_silent_ends
from framekit.codec.python.choices import fixed_bytes
from framekit.codec.sample_context import sample_context
from framekit.codec.samples import Sample, Sampler, beginning
from framekit.definition.model.frame_sizes import StaticSizes
from framekit.definition.model.frames import Frame
from framekit.definition.model.procedure import Row
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Inner
from framekit.definition.model.walk import parts_of
from framekit.definition.problems import Position, Problem

FEWEST = 2
"""So many samples at least must be taken for the other frame before that is believed of all (or the only one)."""

PLACES = 6
"""Constant bytes of a frame that are looked at before it is tried."""

ALIKE = 256
"""Frames in one list that no constant tells from another one."""


@dataclass(frozen=True, slots=True)
class _Candidate:
    """A frame that is waited for, and where that stands. `free`: its row takes it whatever it holds.

    Frames of one `row` lead to the same, so that it matters little which of them is found. `inside`: it stands in
    another frame, which ends it.
    """

    frame: str
    free: bool
    at: Position
    row: int | None = None
    inside: bool = False


def check_matrices(protocol: Protocol) -> list[Problem]:
    """Frames nobody can tell apart, and warnings of ends and check codes that hold little."""
    codec = compile_protocol(protocol)
    sampler = Sampler(codec, sample_context(protocol))
    found: dict[tuple[Position, str], Problem] = {}
    checker = _Checker(codec, sampler)
    for candidates, todo in _matrices(protocol):
        for problem in checker.matrix(candidates, todo):
            found.setdefault((problem.at, problem.what), problem)
    ends = [*check_hidden_ends(protocol), *check_silent_ends(codec, sampler), *check_ends_inside(codec, sampler)]
    weak = list(check_weak_codes(codec, sampler))
    return [*found.values(), *ends, *weak, *_not_tried(protocol, sampler)]


def _not_tried(protocol: Protocol, sampler: Sampler) -> Iterator[Problem]:
    """Frames that could not be built, so that nothing was found out by building them."""
    for name in sampler.in_vain:
        what = f"no values were found that '{name}' can be built of: nothing was tried out with it"
        yield Problem(protocol.frames[name].at, what, "look whether its conditions can hold together", warning=True)


def _matrices(protocol: Protocol) -> Iterator[tuple[list[_Candidate], str]]:
    """Every list of frames that are looked for at once, in order, and what can be done about two of one kind."""
    rows_todo = "add a when: to the row above, or give one of the frames another constant"
    for sequence in protocol.sequences.values():
        for step in sequence.steps:
            rows = [*(step.receive or ()), *sequence.always]
            yield list(_of_rows(rows)), rows_todo
    replies_todo = "give one of the frames another constant, or order the replies otherwise"
    for service in protocol.services.values():
        for row in service:
            frames = [(reply.frame.frame, reply.frame.at) for reply in row.reply if reply.frame is not None]
            yield [_Candidate(name, True, at) for name, at in frames], replies_todo
    order_todo = "give one of the frames another constant, or move the one above behind it"
    if not protocol.roles:
        for side in ("client", "server"):
            frames_ = [frame for frame in protocol.frames.values() if _comes_from(frame, side)]
            yield [_Candidate(frame.name, True, frame.at) for frame in frames_], order_todo
    for frame in protocol.frames.values():
        for inner in parts_of(frame.segments, Inner):
            yield [_Candidate(name, True, protocol.frames[name].at, inside=True) for name in inner.frames], order_todo


def _of_rows(rows: list[Row]) -> Iterator[_Candidate]:
    for number, row in enumerate(rows):
        for name in row.frames:
            yield _Candidate(name, row.when is None, row.places.get("frame", row.at), number)


def _comes_from(frame: Frame, side: str) -> bool:
    return not frame.inner and frame.side in (side, "both") and frame.refuse is None


class _Before:
    """The frames of one list so far, found by their constant bytes: by where these are, and by what is there."""

    def __init__(self) -> None:
        self._known: dict[tuple[int, ...], dict[tuple[int, ...], list[tuple[int, _Candidate]]]] = {}
        self._count = 0

    def add(self, candidate: _Candidate, constants: tuple[tuple[int, int], ...]) -> None:
        places = tuple(place for place, _ in constants)
        values = tuple(value for _, value in constants)
        self._known.setdefault(places, {}).setdefault(values, []).append((self._count, candidate))
        self._count += 1

    def like(self, data: bytes) -> Iterator[_Candidate]:
        """Those whose constants are in these bytes, in their order."""
        found = [
            frames.get(tuple(data[place] for place in places), [])
            for places, frames in self._known.items()
            if not places or places[-1] < len(data)
        ]
        return (candidate for _, candidate in merge(*found, key=itemgetter(0)))


class _Checker:
    def __init__(self, codec: Codec, sampler: Sampler) -> None:
        self.codec = codec
        self.sampler = sampler
        self.shapes = StaticSizes(codec.protocol.frames)
        self.judged: dict[tuple[str, str, bool], Sample | None] = {}
        self.constants: dict[str, tuple[tuple[int, int], ...]] = {}

    def matrix(self, candidates: list[_Candidate], todo: str) -> Iterator[Problem]:
        """Frames of one matrix that earlier ones always take."""
        before = _Before()
        known: set[str] = set()
        for later in candidates:
            samples = () if later.frame in known else self.sampler.samples(later.frame)
            known.add(later.frame)
            tried = 0
            for earlier in before.like(samples[0].data) if samples else ():
                if not self._matters(earlier, later):
                    continue
                if tried == ALIKE:
                    what = f"no constant tells '{later.frame}' from more than {ALIKE} frames that are tried before it"
                    yield Problem(later.at, what, "give the frames constants")
                    return
                tried += 1
                if (sample := self._taken(earlier, later)) is not None:
                    what = f"'{later.frame}' is always taken for '{earlier.frame}', which is tried first"
                    yield Problem(later.at, f"{what}: {beginning(sample.data)} fits both", todo)
                    break
            before.add(later, self._constants(later.frame))

    def _constants(self, frame: str) -> tuple[tuple[int, int], ...]:
        """The first bytes of a frame that can have one value only: their places and values."""
        if frame not in self.constants:
            fixed = dict(fixed_bytes(self.shapes.segments(self.codec.protocol.frames[frame])))
            single = sorted((place, next(iter(values))) for place, values in fixed.items() if len(values) == 1)
            self.constants[frame] = tuple(single[:PLACES])
        return self.constants[frame]

    def _matters(self, earlier: _Candidate, later: _Candidate) -> bool:
        """Whether it would make a difference: not in one row, unless both are messages of one group and side."""
        if earlier.row is None or earlier.row != later.row:
            return earlier.free
        one, other = (self.codec.protocol.frames[each.frame] for each in (earlier, later))
        return one.side == other.side and one.groups[:1] == other.groups[:1] != ()

    def _taken(self, earlier: _Candidate, later: _Candidate) -> Sample | None:
        """A sample of `later`, if each of them would be taken for `earlier`."""
        key = earlier.frame, later.frame, later.inside
        if key not in self.judged:
            samples = self.sampler.samples(later.frame)
            enough = len(samples) >= FEWEST or (len(samples) == 1 and self._is_constant(later.frame))
            taken = enough and all(self._fits(earlier.frame, sample, later.inside) for sample in samples)
            self.judged[key] = samples[0] if taken else None
        return self.judged[key]

    def _is_constant(self, frame: str) -> bool:
        """Whether one sample is all there is: nothing in the frame varies."""
        return not self.sampler.samples(frame)[0].values

    def _fits(self, frame: str, sample: Sample, inside: bool) -> bool:
        """Whether a receiver that looks for `frame` first takes it from the bytes of a sample (`inside`: all)."""
        context = self.sampler.context
        try:
            length = len(sample.data) if inside else self.codec.measure(frame, sample.data, ctx=context)
            if length <= 0:
                return False
            values = self.codec.decode(frame, sample.data[:length], context)
        except FrameError as error:
            return error.refuse is not None
        except (KeyError, TypeError, IndexError, ValueError, ArithmeticError, AttributeError):
            return False
        return self._echo_agrees(frame, values, sample)

    def _echo_agrees(self, frame: str, values: dict[str, Any], sample: Sample) -> bool:
        """A client takes only what repeats the request: fields of one name would have to hold the same."""
        echo = self.codec.protocol.frames[frame].echo
        return all(name not in sample.read or values.get(name) == sample.read[name] for name in echo)
