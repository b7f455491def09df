"""The receiver's shortcuts change no result: rows, size bytes and quick tests find the same frames as measuring."""

from __future__ import annotations

import os
import random
from functools import cache
from typing import Any

import pytest
from link.link_world import MS, cut_at, feed
from link.test_shipped_streams import NAMES, loaded, receiver
from small_protocol import small_protocol
from spread import spread

from framekit.codec.codec import compile_protocol
from framekit.definition.times import LineFormat
from framekit.link.arrivals import Arrival, BadFrame, FrameArrived
from framekit.link.candidates import Candidates
from framekit.link.events import CharacterFault, LineFault
from framekit.link.frame_table import FrameTable
from framekit.link.quick_look import NO_SIZES, NOT_QUICK
from framekit.link.receiver import Receiver
from framekit.link.scope import Scope
from framekit.link.values import plain


@cache
def careful_table(name: str) -> FrameTable:
    """Return a table without shortcuts: frames are measured and decoded, not tested by bytes or size tables."""
    protocol, codec, _ = loaded(name)
    table = FrameTable(protocol, codec)
    for info in table.infos.values():
        info.quick, info.sizes, info.counted, info.intact = NOT_QUICK, NO_SIZES, None, None
        info.extent, info.guesses = info.measure, False
    return table


class Careful(Receiver):
    """A receiver that compares the candidates at every position."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._is_simple = False

    def _passes(self, here: Candidates, place: int, end: int, is_cut: bool) -> bool:
        return False


def careful(name: str) -> Receiver:
    protocol, codec, _ = loaded(name)
    return Careful(codec, protocol, receiver(name)._names, careful_table(name))


def comparable(event: Arrival) -> tuple[Any, ...]:
    if isinstance(event, FrameArrived):
        return ("frame", event.value.frame, event.value.refusal, plain(event.value), *placed(event))
    if isinstance(event, BadFrame):
        fault = event.cause, event.segment, event.place, event.expected, event.found, event.message
        return ("bad", event.frame, *fault, event.raw, event.offset, event.started_at, event.ended_at)
    return ("noise", *event)


def placed(event: FrameArrived) -> tuple[Any, ...]:
    return event.raw, event.offset, event.started_at, event.ended_at


def one_by_one(receiver: Receiver, expected: tuple[str, ...]) -> list[tuple[Any, ...]]:
    return [comparable(event) for event in iter(lambda: receiver.next(expected), None)]


def state(one: Receiver) -> tuple[Any, ...]:
    since = one.waiting_since if one.waiting else None
    return one.waiting, since, one.deadline, one.broken, one.is_empty


def stream_of(name: str, choose: random.Random) -> bytes:
    """Return whole and damaged frames with noise between them, and first bytes of frames."""
    samples = loaded(name)[2]
    parts = []
    for _ in range(choose.randrange(1, 12)):
        frame = bytearray(choose.choice(samples))
        kind = choose.random()
        if kind < 0.15:
            frame[choose.randrange(len(frame))] ^= choose.randrange(1, 256)
        elif kind < 0.25:
            del frame[choose.randrange(len(frame)) :]
        elif kind < 0.4:
            frame[:0] = choose.randbytes(choose.randrange(1, 9))
        elif kind < 0.45:
            frame[:0] = bytes([choose.choice(samples)[0]])
        elif kind < 0.6:
            place = choose.randrange(len(frame) + 1)
            frame[place:place] = min(choose.sample(samples, min(5, len(samples))), key=len)
        parts.append(bytes(frame))
    return b"".join(parts)


def expectations(name: str) -> list[tuple[tuple[str, ...], tuple[str, ...]]]:
    table = receiver(name).table
    of = {side: tuple(it for it in table.on_line if table.infos[it].frame.side in (side, "both")) for side in SIDES}
    pairs = [(table.on_line, ())]
    for names in of.values():
        rest = tuple(it for it in table.on_line if it not in names)
        pairs += [(names, ()), (names, rest), (names[:1], ()), (names[:1], rest), ((), names)]
    return pairs


ROUNDS = int(os.environ.get("FRAMEKIT_STREAMS", "1"))
"""Number of streams per protocol and kind; more on request."""

SIDES = ("client", "server")


def compare(name: str, stream: bytes, choose: random.Random, pieces: list[bytes], strange: bool) -> None:
    slow, one_by_one, quick = careful(name), receiver(name), receiver(name)
    expected, others = choose.choice(expectations(name))
    now = 0
    for piece in pieces:
        now += choose.choice((0, 1, 40, 3000)) * MS if strange else len(piece) * MS // 2
        faults = [CharacterFault(0, LineFault.PARITY)] if strange and choose.random() < 0.1 else []
        for each in (slow, one_by_one, quick):
            each.append(piece, now, faults)
        wanted = [comparable(event) for event in iter(lambda: slow.next(expected, others), None)]
        assert [comparable(event) for event in iter(lambda: one_by_one.next(expected, others), None)] == wanted
        assert [comparable(event) for event in quick.arrivals(expected, others)] == wanted
        assert state(slow) == state(one_by_one) == state(quick)
        if strange and choose.random() < 0.2:
            now += choose.choice((1, 100, 5000)) * MS
            for each in (slow, one_by_one, quick):
                each.tick(now)
            wanted = [comparable(event) for event in iter(lambda: slow.next(expected, others), None)]
            assert [comparable(event) for event in iter(lambda: one_by_one.next(expected, others), None)] == wanted
            assert [comparable(event) for event in quick.arrivals(expected, others)] == wanted
            assert state(slow) == state(one_by_one) == state(quick)
    assert (
        [comparable(it) for it in slow.reset()]
        == [comparable(it) for it in one_by_one.reset()]
        == [comparable(it) for it in quick.reset()]
    )


@pytest.mark.parametrize("strange", [False, True])
@pytest.mark.parametrize("name", spread(NAMES, 3, 0))
def test_the_quick_way_finds_what_looking_finds(name: str, strange: bool) -> None:
    choose = random.Random(f"{name} {strange}")
    for _ in range(ROUNDS):
        stream = stream_of(name, choose)
        compare(name, stream, choose, [stream], strange)
        compare(name, stream, choose, cut_at(stream, [choose.randrange(5000) for _ in range(6)]), strange)
        compare(name, stream, choose, [stream[at : at + 1] for at in range(len(stream))], strange)


def noise_of(name: str, choose: random.Random) -> bytes:
    """Return mostly noise: first bytes of frames, parts of frames, random bytes.

    And frames whole or with a wrong bit.
    """
    samples = loaded(name)[2]
    parts = []
    for _ in range(choose.randrange(5, 30)):
        sample, kind = choose.choice(samples), choose.randrange(6)
        place = choose.randrange(len(sample))
        if kind == 0:
            parts.append(choose.randbytes(choose.randrange(1, 12)))
        elif kind == 1:
            parts.append(sample[:1] * choose.randrange(1, 4))
        elif kind == 2:
            parts.append(sample[:2] + choose.randbytes(choose.randrange(6)))
        elif kind == 3:
            parts.append(sample[place : place + choose.randrange(1, 8)])
        elif kind == 4:
            parts.append(sample[:place] + bytes([sample[place] ^ 1 << choose.randrange(8)]) + sample[place + 1 :])
        else:
            parts.append(sample)
    return b"".join(parts)


@pytest.mark.parametrize("name", spread(NAMES, 3, 1))
def test_the_quick_way_finds_the_same_in_noise(name: str) -> None:
    choose = random.Random(f"noise {name}")
    for _ in range(2 * ROUNDS):
        stream = noise_of(name, choose)
        compare(name, stream, choose, [stream], False)
        compare(name, stream, choose, cut_at(stream, [choose.randrange(len(stream)) for _ in range(9)]), False)


@pytest.mark.parametrize("name", spread(NAMES, 3, 2))
def test_the_quick_way_finds_the_same_in_rows_of_one_kind(name: str) -> None:
    """Many good frames of an expected kind, some after noise, cut near their starts."""
    choose, looking = random.Random(f"rows {name}"), receiver(name)
    table, names = looking.table, looking._names
    good = {
        frame: [it for it in loaded(name)[2] if table.infos[frame].measure(it, 0, len(it), names, 0) > 0]
        for frame in table.on_line
    }
    frame = max(table.on_line, key=lambda one: len(good[one]))
    for _ in range(ROUNDS):
        stream, cuts = b"", []
        for _ in range(40):
            noise = choose.randbytes(choose.randrange(1, 9)) if choose.random() < 0.2 else b""
            stream += noise + choose.choice(good[frame])
            cuts += [len(stream) + choose.choice((-2, -1, 0, 1, 2, 3, 5))] if choose.random() < 0.4 else []
        pieces = cut_at(stream, cuts)
        slow, quick = careful(name), receiver(name)
        for now, piece in enumerate(pieces):
            slow.append(piece, now)
            quick.append(piece, now)
            assert [comparable(event) for event in quick.arrivals((frame,))] == one_by_one(slow, (frame,))
            assert state(slow) == state(quick)


def test_a_frame_longer_than_what_is_copied_is_found() -> None:
    """After a long rest, bytes are appended to the buffer; it becomes `bytes` again when the rest is short."""
    quick, slow = receiver("df1"), careful("df1")
    expected = ("message", "ack", "enq")
    begun = b"\x10\x02" + bytes(20_000)
    for now, piece in enumerate(
        [begun[at : at + 700] for at in range(0, len(begun), 700)] + [b"\x10\x03\x00\x00\x10\x06"]
    ):
        for each in (quick, slow):
            each.append(piece, now)
        assert [comparable(event) for event in quick.arrivals(expected)] == one_by_one(slow, expected)
        assert state(slow) == state(quick)


def test_two_frames_inside_of_fixed_sizes_are_looked_at() -> None:
    """A frame of fixed size whose second inner frame is unknown is noise, in any pieces."""
    frames = "frames:\n  one: {body: [{const: 01}]}\n  two: {body: [{const: 02}, {field: a, type: u16}]}"
    protocol = small_protocol("[{inner: i, of: [one]}, {inner: j, of: [two]}, {const: 7E}]", frames)
    codec = compile_protocol(protocol)
    good, wrong = bytes.fromhex("01 02 00 00 7E"), bytes.fromhex("01 09 00 00 7E")
    for pieces in ([good + wrong + good], [bytes([byte]) for byte in good + wrong + good]):
        names = Scope(protocol, params={}, line=LineFormat(9600))
        found = feed(Receiver(codec, protocol, names), pieces, ("f",))
        assert [(event[0], event[2]) for event in found if event[0] == "frame"] == [("frame", good), ("frame", good)]
        assert wrong not in [event[2] for event in found if event[0] == "frame"]
