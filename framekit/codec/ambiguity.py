"""Find frames that a receiver cannot distinguish, by building a frame and reading it as another frame.

A receiver tries the frames of a receive matrix in row order. If an earlier frame accepts every sample of a later frame,
the later frame is never found; that is an error. The check does not know which bytes are possible on the real line.
Guide: receiving, checker.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from heapq import merge
from operator import itemgetter
from typing import Any

from framekit.codec.codec import Codec, compile_protocol
from framekit.codec.errors import EncodeError, FrameError
from framekit.codec.evaluate import EVALUATION_ERRORS, MissingName, evaluate, start_values
from framekit.codec.python.choices import fixed_bytes
from framekit.codec.python.runtime import RangeTable
from framekit.codec.samples import Sample, Sampler, beginning
from framekit.definition.model.frames import Frame, StaticSizes, bytes_of, parts_of
from framekit.definition.model.procedure import Row
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.sections import Parameter, StateVariable
from framekit.definition.model.segments import Check, Const, Data, Inner, Segment
from framekit.definition.problems import Position, Problem
from framekit.definition.times import parse_format

WEAK = 8
"""Check codes of at most this number of bits are tested."""

TRIALS = 600
"""Number of two-bit errors that are tested on a frame."""

WORTH_TELLING = 0.005
"""Share of undetected two-bit errors from which a warning is given."""


def check_weak_codes(codec: Codec, sampler: Sampler) -> list[Problem]:
    """Return a warning for the frame whose check code misses the most two-bit errors, or an empty list.

    Only serial lines without parity and without mark bits are checked.
    """
    protocol = codec.protocol
    if protocol.line.kind != "serial":
        return []
    line = parse_format(protocol.line.format, protocol.line.speed or 1)
    if line.parity != "N" or line.has_marks:
        return []
    shares = [
        (passing(codec, frame.name, sample, sampler.context), frame, check)
        for frame in protocol.frames.values()
        if (check := _weak_check(frame)) is not None and (sample := _longest(sampler, frame, check)) is not None
    ]
    if not shares:
        return []
    share, frame, check = max(shares, key=lambda one: one[0])
    if share < WORTH_TELLING:
        return []
    what = f"about {max(share * 100, 1):.0f} % of the errors of two bits pass in '{frame.name}'"
    told = f"{what}: its check code has {check.method.width} bits, the line no parity"
    return [Problem(check.at, told, _todo(protocol), warning=True)]


def passing(codec: Codec, frame: str, sample: Sample, context: Mapping[str, Any]) -> float:
    """Return the share of samples with two inverted bits that decode as valid frames with other values."""
    random_ = random.Random(f"framekit {frame}")
    passed = 0
    for _ in range(TRIALS):
        damaged = bytearray(sample.data)
        for place in random_.sample(range(len(damaged) * 8), 2):
            damaged[place // 8] ^= 1 << place % 8
        try:
            passed += codec.decode(frame, bytes(damaged), context) != sample.read
        except (KeyError, TypeError, IndexError, ValueError, ArithmeticError, AttributeError):
            continue
    return passed / TRIALS


def _weak_check(frame: Frame) -> Check | None:
    """Return the frame's check code if all of its verified check codes are weak, else None."""
    checks = [check for check in parts_of(frame.segments, Check) if check.verify == "error"]
    return checks[0] if checks and all(check.method.width <= WEAK for check in checks) else None


def _longest(sampler: Sampler, frame: Frame, check: Check) -> Sample | None:
    """Return the longest sample in which the check code is present, or None."""
    there = [sample for sample in sampler.samples(frame.name) if _is_there(check, sample, sampler.context)]
    return max(there, key=lambda sample: len(sample.data), default=None)


def _is_there(check: Check, sample: Sample, context: Mapping[str, Any]) -> bool:
    if check.when is None:
        return True
    try:
        return bool(evaluate(check.when.root, {**context, **sample.read}))
    except (KeyError, TypeError, IndexError, ValueError, ArithmeticError, AttributeError):
        return False


def _todo(protocol: Protocol) -> str:
    bits = protocol.line.format[0]
    return f"use a format with parity, such as {bits}E1, where the device offers one"


def check_hidden_ends(protocol: Protocol) -> Iterator[Problem]:
    """Yield at most one warning per frame: content that may contain the constant that ends it.

    Delimited bodies are checked elsewhere: they cannot contain their end.
    """
    for frame in protocol.frames.values():
        for place, segment in enumerate(frame.segments[:-1]):
            if frame.delimited or segment.when:
                continue
            behind = frame.segments[place + 1 :]
            end = next((one for one in behind if isinstance(one, Const) and one.when is None), None)
            if end is None:
                break
            warning = _warning(protocol, frame, segment, end, behind)
            if warning is not None:
                yield warning
                break


def check_silent_ends(codec: Codec, sampler: Sampler) -> Iterator[Problem]:
    """Yield a problem for each frame that only silence ends, on a connection without `receiver.quiet`."""
    protocol = codec.protocol
    if protocol.line.kind != "stream" or protocol.receiver.quiet is not None:
        return
    for frame in protocol.frames.values():
        samples = () if frame.inner or frame.side == "none" else sampler.samples(frame.name)
        if any(codec.measure(frame.name, sample.data, ctx=sampler.context) == codec.QUIET for sample in samples):
            what = f"only silence ends '{frame.name}', and a connection has none of its own"
            todo = "add a length or an end constant, or receiver: {quiet: TIME}"
            if frame.name in protocol.carried:
                todo = f"write from: none if it stands only inside other frames, else {todo}"
            yield Problem(frame.at, what, todo)


def check_ends_inside(codec: Codec, sampler: Sampler) -> Iterator[Problem]:
    """Yield a problem for each inner frame whose bytes may begin a longer frame that is tried first.

    A receiver would wait for the rest of the longer frame.
    """
    for frame in codec.protocol.frames.values():
        for inner in parts_of(frame.segments, Inner):
            for later in inner.frames[1:] if inner.size is None else ():
                data = _waiting(codec, sampler, frame.name, inner, later)
                if data is not None:
                    what = f"'{later}' in '{frame.name}' may be the beginning of a frame that is tried first"
                    what = f"{what}: {beginning(data)}"
                    todo = f"give '{inner.name}' a size, or write the frame with less bytes first"
                    yield Problem(inner.at, what, todo)
                    break


def _waiting(codec: Codec, sampler: Sampler, frame: str, inner: Inner, later: str) -> bytes | None:
    """Return a frame that is complete without silence, but for which `measure` still expects bytes, or None.

    The frame contains the inner frame `later`.
    """
    outer = [sample.values for sample in sampler.samples(frame) if inner.name in sample.values]
    for values, inside in zip(outer, sampler.samples(later), strict=False):
        if codec.measure(later, inside.data, ctx=sampler.context) == codec.QUIET:
            continue
        try:
            data = codec.encode(frame, {**values, inner.name: {later: inside.values}}, sampler.context)
        except EncodeError:
            continue
        if codec.QUIET < codec.measure(frame, data, ctx=sampler.context) < 0:
            return data
    return None


def _warning(
    protocol: Protocol, frame: Frame, segment: Segment, end: Const, behind: tuple[Segment, ...]
) -> Problem | None:
    sign = f"{end.data[0]:02X}"
    before = behind[: behind.index(end)]
    open_ended = segment.takes_rest or (isinstance(segment, Inner) and segment.size == "rest")
    if open_ended and end.data[0] in bytes_of([segment, *before], protocol.frames):
        guarded = any(check.verify == "error" for check in parts_of(behind, Check))
        where = f"the first {sign} with a fitting check code" if guarded else f"the first {sign}, whatever was meant"
        holder, todo = segment, "give it a size, or send it as digits or in a wrap"
        if segment.is_list or (segment.has_cases and segment.chooses_by is None):
            todo = "say by a field how much there is of it, or send it as digits or in a wrap"
        if end.data[0] not in bytes_of([segment], protocol.frames):
            holder = next(one for one in before if end.data[0] in bytes_of([one], protocol.frames))
            todo = "send it as digits, or put it after the end"
        what = f"{holder.title} may hold {sign}, which ends it: '{frame.name}' ends at {where}"
        return Problem(holder.at, what, todo, warning=True)
    sized = protocol.profile is not None and isinstance(segment, Data) and isinstance(segment.size, int)
    if sized and not before and end in frame.tail and end.data[0] in bytes_of([segment]):
        what = (
            f"{segment.title} may hold {sign}, the first byte of the tail: '{frame.name}' ends by its size, not there"
        )
        return Problem(segment.at, what, "nothing to do if the size is right", warning=True)
    return None


ANNOUNCED = 16
"""The sample value of a size that an earlier frame would have announced."""


class SampleLine:
    """Implement `line` of the language at a common speed: 9600 bit/s, times in nanoseconds."""

    speed = 9600

    def chars(self, numerator: int, denominator: int = 1) -> int:
        return 1_041_667 * numerator // denominator

    def bits(self, numerator: int, denominator: int = 1) -> int:
        return 104_167 * numerator // denominator

    def language_attribute(self, name: str) -> int:
        if name != "speed":
            raise KeyError(name)
        return self.speed


def sample_context(protocol: Protocol) -> dict[str, Any]:
    """Return a context for encoding and decoding the protocol's frames; names without a sample value are omitted."""
    station = _station(protocol)
    clock = dict.fromkeys(("second", "minute", "hour", "day", "month", "year", "weekday"), 7)
    context: dict[str, Any] = {
        "buffer": b"", "role": "client", "station": station, "own": station, "clock": clock, "now": 0,
        "line": SampleLine(),
    }  # fmt: skip
    context |= start_values(protocol)
    for parameter in protocol.params.values():
        if parameter.secret and context.get(parameter.name) is None:
            context[parameter.name] = "A" if parameter.type == "text" else bytes(parameter.size or 16)
    for variable in protocol.state.values():
        if variable.announced:
            context[variable.name] = _announced(variable)
    items: list[Parameter | StateVariable] = [*protocol.params.values(), *protocol.state.values()]
    for _ in range(3):  # defaults may depend on other defaults
        for item in items:
            if item.name not in context:
                context |= _worked_out(item, context)
    return context


def _announced(variable: StateVariable) -> Any:
    """Return a sample value of a state variable that earlier frames announce; a table holds it for every key."""
    samples: dict[str, Any] = {"bytes": bytes(variable.size or ANNOUNCED), "text": "A"}
    value = samples.get(variable.type, ANNOUNCED)
    return value if variable.keys is None else RangeTable({}, ((*variable.keys, value),))


def _station(protocol: Protocol) -> Any:
    station = protocol.station
    if station.type == "text":
        return "A" * min(station.size or 1, 8)
    if station.type == "bytes":
        return bytes(station.size or 1)
    low, high = station.limits or (1, 1)
    return min(max(low, 1), high)


def _worked_out(item: Parameter | StateVariable, context: Mapping[str, Any]) -> dict[str, Any]:
    expression = item.initial if isinstance(item, StateVariable) else item.is_ or item.default
    if expression is None:
        return {}
    try:
        return {item.name: evaluate(expression.root, context)}
    except (MissingName, *EVALUATION_ERRORS):
        return {}


FEWEST = 2
"""Minimum number of samples that must be accepted as the other frame; fewer only for a constant frame."""

PLACES = 6
"""Limit of the constant bytes of a frame that are compared before it is tried."""

MOST_TWIN = 64
"""Largest size in bytes of a frame of fixed size that is compared with others of the same size."""

ALIKE = 256
"""Limit of the frames in a list that no constant distinguishes from another frame."""


@dataclass(frozen=True, slots=True)
class _Candidate:
    """A frame that a receiver waits for."""

    frame: str
    free: bool
    """Whether its row accepts it without a condition."""
    at: Position
    """The position of the frame in the list."""
    row: int | None = None
    """The number of its row; frames of a row have the same consequence, so confusing them rarely matters."""
    inside: bool = False
    """Whether another frame contains it and determines its end."""


def check_matrices(
    protocol: Protocol, weak_codes: bool = True, built: Callable[[], Collection[str]] = frozenset
) -> list[Problem]:
    """Return problems for frames that cannot be distinguished, with warnings about ends and weak check codes.

    `weak_codes`: include the warnings about check codes. `built` returns the names of frames that are known to be built
    from some values.
    """
    codec = compile_protocol(protocol)
    sampler = Sampler(codec, sample_context(protocol))
    found: dict[tuple[Position, str], Problem] = {}
    checker = _Checker(codec, sampler)
    for candidates, todo in _matrices(protocol):
        for problem in checker.matrix(candidates, todo):
            found.setdefault((problem.at, problem.what), problem)
    ends = [*check_hidden_ends(protocol), *check_silent_ends(codec, sampler), *check_ends_inside(codec, sampler)]
    weak = check_weak_codes(codec, sampler) if weak_codes else []
    return [*found.values(), *ends, *weak, *_not_tried(protocol, sampler, built)]


def _not_tried(protocol: Protocol, sampler: Sampler, built: Callable[[], Collection[str]]) -> Iterator[Problem]:
    """Yield a warning for each frame of which no sample could be built, so that no test was possible."""
    known = built() if sampler.in_vain else ()
    for name in sampler.in_vain:
        if name in known:
            continue
        what = f"no values were found that '{name}' can be built of: nothing was tried out with it"
        yield Problem(protocol.frames[name].at, what, "look whether its conditions can hold together", warning=True)


def _matrices(protocol: Protocol) -> Iterator[tuple[list[_Candidate], str]]:
    """Yield every list of frames that are searched at once, in order, with the advice for similar frames."""
    rows_todo = "add a when: to the row above, or give one of the frames another constant"
    for sequence in protocol.sequences.values():
        for step in sequence.steps:
            rows = [*(step.receive or ()), *sequence.always]
            yield list(_of_rows(rows)), rows_todo
    replies_todo = "give one of the frames another constant, or order the replies otherwise"
    for row in protocol.service_rows:
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
    """The earlier frames of a list, indexed by the offsets and values of their constant bytes."""

    def __init__(self) -> None:
        self._known: dict[tuple[int, ...], dict[tuple[int, ...], list[tuple[int, _Candidate]]]] = {}
        self._count = 0

    def add(self, candidate: _Candidate, constants: tuple[tuple[int, int], ...]) -> None:
        places = tuple(place for place, _ in constants)
        values = tuple(value for _, value in constants)
        self._known.setdefault(places, {}).setdefault(values, []).append((self._count, candidate))
        self._count += 1

    def like(self, data: bytes) -> Iterator[_Candidate]:
        """Yield the frames whose constants the bytes contain, in list order."""
        found = [
            frames.get(tuple(data[place] for place in places), [])
            for places, frames in self._known.items()
            if not places or places[-1] < len(data)
        ]
        return (candidate for _, candidate in merge(*found, key=itemgetter(0)))


class _Checker:
    """Compare the frames of receive matrices; results are cached per pair of frames."""

    def __init__(self, codec: Codec, sampler: Sampler) -> None:
        self.codec = codec
        self.sampler = sampler
        self.static = StaticSizes(codec.protocol.frames)
        self.samples_taken: dict[tuple[str, str, bool], Sample | None] = {}
        self.twins: dict[tuple[str, str, bool], Sample | None] = {}
        self.constants: dict[str, tuple[tuple[int, int], ...]] = {}

    def matrix(self, candidates: list[_Candidate], todo: str) -> Iterator[Problem]:
        """Yield a problem for each frame of a matrix that an earlier frame always accepts."""
        before = _Before()
        known: set[str] = set()
        for later in candidates:
            samples = () if later.frame in known else self.sampler.samples(later.frame)
            known.add(later.frame)
            tried, twin = 0, ""
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
                    at, todo_there = self._own_place(later, todo)
                    yield Problem(at, f"{what}: {beginning(sample.data)} fits both", todo_there)
                    break
                if not twin and (sample := self._twin(earlier, later)) is not None:
                    twin = f"'{later.frame}' of {len(sample.data)} bytes is taken for '{earlier.frame}', which is tried"
                    twin = f"{twin} first: {beginning(sample.data)} fits both"
            else:
                if twin:
                    at, todo_there = self._own_place(later, todo)
                    yield Problem(at, twin, todo_there, warning=True)
            before.add(later, self._constants(later.frame))

    def _own_place(self, later: _Candidate, todo: str) -> tuple[Position, str]:
        """Return the position and the advice for a problem: the user's own frame if the row belongs to another file."""
        own, frame = self.codec.protocol.at.file, self.codec.protocol.frames[later.frame].at
        if later.at.file == own or frame.file != own:
            return later.at, todo
        return frame, "give one of the frames another constant, in its where: or in its body"

    def _constants(self, frame: str) -> tuple[tuple[int, int], ...]:
        """Return offset and value of the first bytes of a frame that can have one value only."""
        if frame not in self.constants:
            fixed = dict(fixed_bytes(self.static.segments(self.codec.protocol.frames[frame])))
            single = sorted((place, next(iter(values))) for place, values in fixed.items() if len(values) == 1)
            self.constants[frame] = tuple(single[:PLACES])
        return self.constants[frame]

    def _matters(self, earlier: _Candidate, later: _Candidate) -> bool:
        """Return whether confusing the frames has a consequence: in one row only for messages of one group and side."""
        if earlier.row is None or earlier.row != later.row:
            return earlier.free
        one, other = (self.codec.protocol.frames[each.frame] for each in (earlier, later))
        return one.side == other.side and one.groups[:1] == other.groups[:1] != ()

    def _taken(self, earlier: _Candidate, later: _Candidate) -> Sample | None:
        """Return a sample of `later` if every sample of it would be accepted as `earlier`, else None."""
        key = earlier.frame, later.frame, later.inside
        if key not in self.samples_taken:
            samples = self.sampler.samples(later.frame)
            enough = len(samples) >= FEWEST or (len(samples) == 1 and self._is_constant(later.frame))
            taken = enough and all(self._fits(earlier.frame, sample, later.inside) for sample in samples)
            self.samples_taken[key] = samples[0] if taken else None
        return self.samples_taken[key]

    def _twin(self, earlier: _Candidate, later: _Candidate) -> Sample | None:
        """Return a sample of `later` with the size of `earlier` if every sample of that size is accepted as `earlier`.

        None if `later` has a fixed size.
        """
        size = self.static.frame(earlier.frame).fixed
        if size is None or size > MOST_TWIN or self.static.frame(later.frame).fixed is not None:
            return None
        key = earlier.frame, later.frame, later.inside
        if key not in self.twins:
            samples = list(self.sampler.resized(later.frame, size))
            taken = len(samples) >= FEWEST and all(self._fits(earlier.frame, one, later.inside) for one in samples)
            self.twins[key] = samples[0] if taken else None
        return self.twins[key]

    def _is_constant(self, frame: str) -> bool:
        """Return whether a frame has no variable values, so that one sample is enough."""
        return not self.sampler.samples(frame)[0].values

    def _fits(self, frame: str, sample: Sample, inside: bool) -> bool:
        """Return whether a receiver that tries `frame` first accepts the bytes of a sample.

        `inside`: all of the bytes.
        """
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
        """Return whether the echoed fields of `frame` equal those of the sample, as a client requires."""
        echo = self.codec.protocol.frames[frame].echo
        return all(name not in sample.read or values.get(name) == sample.read[name] for name in echo)
