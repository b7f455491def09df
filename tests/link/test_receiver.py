# ruff: noqa: E501 - definitions in YAML
"""The receiver: events do not depend on the cuts of a stream, no exception is raised, valid frames are found."""

from __future__ import annotations

import functools
import operator
from random import Random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from link.link_world import MS, SECOND, comparable, compiled, cut_at, feed, receiver_of

from framekit.definition.times import NEVER
from framekit.link.arrivals import BadFrame, FrameArrived, Noise
from framekit.link.events import CharacterFault, LineFault
from framekit.link.values import FrameValue

LETTERS = """
protocol: letters
groups:
  command: {delimited: yes, surplus: 7, max: 64, head: [{const: STX}, {field: station, type: hex, size: 2}], tail: [{const: ETX}, {check: sum8, as: hex}]}
frames:
  set:  {group: command, body: [{text: S}, {field: value, type: hex, size: 4, range: 0..1000, refuse: 9}]}
  get:  {group: command, body: [{text: G}]}
  ack:  {body: [{const: ACK}]}
  nak:  {body: [{const: NAK}, {field: code, type: u8}]}
receiver: {gap: 50 ms, quiet: 4 chars}
"""

NUMBERS = """
protocol: numbers
frames:
  short: {body: [{const: AA}, {length: size, type: u8, of: [data]}, {data: data, size: size}, {check: sum8}]}
  long:  {body: [{const: AA 55}, {length: size, type: u16, of: [data]}, {data: data, size: size}, {check: xor8}]}
  stray: {from: none, body: [{const: BB}, {data: data, size: rest}]}
receiver: {gap: 100 ms, quiet: 10 ms, resync: %s}
"""

ALL = ("set", "get", "ack", "nak")


def built(text: str, frame: str, **fields: Any) -> bytes:
    _, codec = compiled(text)
    data: bytes = codec.frames[frame].encode(fields)
    return data


GET = built(LETTERS, "get", station=1)
SET = built(LETTERS, "set", station=1, value=100)
TOO_MUCH = built(LETTERS, "set", station=1, value=5).replace(b"0005", b"0FFF")


def checked(data: bytes) -> bytes:
    return data + b"%02X" % (sum(data) & 0xFF)


def test_frames_noise_and_bad_frames_of_one_stream() -> None:
    data = b"\x00\x01" + GET + SET[:-1] + b"!" + b"\x06" + b"\x99"
    found = feed(receiver_of(LETTERS), [data], ALL)
    kinds = [item[:2] for item in found]
    assert kinds[:3] == [("noise", b"\x00\x01"), ("frame", "get"), ("bad", "set")]
    assert ("frame", "ack") in kinds
    assert found[-1][:2] == ("noise", b"\x99")


def test_offsets_and_times_are_those_of_the_stream() -> None:
    receiver = receiver_of(LETTERS)
    receiver.append(b"\x00" + GET[:3], 10 * MS)
    assert receiver.next(ALL) is None
    receiver.append(GET[3:] + b"\x06", 20 * MS)
    noise, frame, ack = (receiver.next(ALL) for _ in range(3))
    assert isinstance(noise, Noise) and isinstance(frame, FrameArrived) and isinstance(ack, FrameArrived)
    assert (frame.offset, frame.started_at, frame.ended_at) == (1, 10 * MS, 20 * MS)
    assert ack.offset == 1 + len(GET)


def test_a_fault_with_a_code_makes_a_frame_to_be_refused() -> None:
    longer = checked(SET[:-3] + b"xyz\x03")
    found = feed(receiver_of(LETTERS), [checked(TOO_MUCH[:-2]), longer], ALL)
    assert [(item[0], item[1], item[4]) for item in found] == [("frame", "set", 9), ("frame", "set", 7)]


def test_a_wrong_check_outweighs_a_fault_with_a_code() -> None:
    found = feed(receiver_of(LETTERS), [TOO_MUCH[:-2] + b"00"], ALL)
    assert found[0][:3] == ("bad", "set", "check")


def test_expected_frames_come_before_others() -> None:
    receiver = receiver_of(LETTERS)
    receiver.append(GET + SET, 0)
    first = receiver.next(("set",), ("get", "ack", "nak"))
    second = receiver.next(("set",), ("get", "ack", "nak"))
    assert isinstance(first, FrameArrived) and first.value.frame == "get"
    assert isinstance(second, FrameArrived) and second.value.frame == "set"


def test_interest_may_change_between_two_frames() -> None:
    receiver = receiver_of(LETTERS)
    receiver.append(b"\x06" + GET, 0)
    assert comparable(receiver.next(("ack",)))[1] == "ack"  # type: ignore[arg-type]
    assert comparable(receiver.next(("get",)))[1] == "get"  # type: ignore[arg-type]


def test_a_pause_longer_than_gap_cuts_a_frame() -> None:
    receiver = receiver_of(LETTERS)
    receiver.append(SET[:5], 0)
    assert receiver.next(ALL) is None
    assert receiver.waiting == ("set", "get") and receiver.deadline == 50 * MS
    receiver.tick(receiver.deadline)
    bad = receiver.next(ALL)
    assert isinstance(bad, BadFrame) and bad.cause == "cut" and bad.raw == SET[:5]
    receiver.append(GET, 60 * MS)
    rest, frame = receiver.next(ALL), receiver.next(ALL)
    assert isinstance(rest, Noise) and rest.skipped and rest.data == SET[:5]
    assert isinstance(frame, FrameArrived) and frame.value.frame == "get"


def test_a_pause_cuts_also_when_nobody_ticked_in_between() -> None:
    receiver = receiver_of(LETTERS)
    receiver.append(SET[:5], 0)
    receiver.append(SET[5:] + GET, SECOND)
    kinds = []
    while (event := receiver.next(ALL)) is not None:
        kinds.append(comparable(event)[:3])
    assert kinds[0] == ("bad", "set", "cut") and kinds[-1][:2] == ("frame", "get")


def test_line_faults_make_the_frame_that_holds_them_bad() -> None:
    receiver = receiver_of(LETTERS)
    receiver.append(GET + SET, 0, [CharacterFault(len(GET) + 2, LineFault.FRAMING)])
    assert comparable(receiver.next(ALL))[1] == "get"  # type: ignore[arg-type]
    bad = receiver.next(ALL)
    assert isinstance(bad, BadFrame) and (bad.frame, bad.cause) == ("set", "framing")


def test_silence_ends_frames_only_when_nothing_else_fits() -> None:
    text = NUMBERS % "next_start"
    frame = built(text, "short", data=b"abc")
    names = ("short", "stray")
    receiver = receiver_of(text)
    receiver.append(b"\xbb123", 0)
    assert receiver.next(names) is None and receiver.deadline == 10 * MS
    receiver.tick(9 * MS)
    assert receiver.next(names) is None
    receiver.tick(10 * MS)
    assert comparable(receiver.next(names))[:3] == ("frame", "stray", b"\xbb123")  # type: ignore[arg-type]
    receiver.append(frame[:3], 20 * MS)
    receiver.tick(90 * MS)
    assert receiver.next(names) is None and receiver.waiting == ("short",)
    receiver.append(frame[3:], 100 * MS)
    assert comparable(receiver.next(names))[1] == "short"  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("resync", "then"),
    [
        ("next_start", [("bad", "check"), ("frame", "short"), ("frame", "short")]),
        ("after_frame", [("bad", "check"), ("frame", "short")]),
        ("after_quiet", [("bad", "check")]),
        ("never", [("bad", "check")]),
    ],
)
def test_where_reading_goes_on_after_a_bad_frame(resync: str, then: list[tuple[str, str | None]]) -> None:
    text = NUMBERS % resync
    inner = built(text, "short", data=b"")
    damaged = built(text, "short", data=inner)[:-1] + b"\x77"
    found = feed(receiver_of(text), [damaged + inner], ("short",), quiet_at_end=False)
    assert [(item[0], item[2] if item[0] == "bad" else item[1]) for item in found if item[0] != "noise"] == then
    assert all(item[3] for item in found if item[0] == "noise")


def test_after_quiet_goes_on_behind_the_silence() -> None:
    text = NUMBERS % "after_quiet"
    frame = built(text, "short", data=b"x")
    receiver = receiver_of(text)
    receiver.append(frame[:-1] + b"\x00" + frame, 0)
    assert comparable(receiver.next(("short",)))[0] == "bad"  # type: ignore[arg-type]
    assert receiver.next(("short",)) is None
    receiver.append(frame, 5 * MS)
    assert receiver.next(("short",)) is None
    receiver.append(frame, 30 * MS)
    found = []
    while (event := receiver.next(("short",))) is not None:
        found.append(comparable(event)[0])
    assert found == ["noise", "frame"]


def test_never_breaks_the_stream_off() -> None:
    receiver = receiver_of(NUMBERS % "never")
    receiver.append(b"\x01\x02", 0)
    assert comparable(receiver.next(("short",)))[0] == "noise"  # type: ignore[arg-type]
    assert receiver.broken
    receiver.append(built(NUMBERS % "never", "short", data=b""), 1)
    assert receiver.next(("short",)) is None
    receiver.reset()
    receiver.append(built(NUMBERS % "never", "short", data=b""), 2)
    assert comparable(receiver.next(("short",)))[0] == "frame"  # type: ignore[arg-type]


def test_bad_frames_inside_a_bad_frame_are_not_new_ones() -> None:
    text = NUMBERS % "next_start"
    data = b"\xaa\x06" + b"\xaa\x01" * 3 + b"\x00"
    found = feed(receiver_of(text), [data], ("short",))
    assert [item[0] for item in found].count("bad") == 1
    assert all(item[3] for item in found if item[0] == "noise")


def test_other_readings_of_the_same_bytes() -> None:
    text = "protocol: two\nframes:\n  a: {body: [{const: 01}, {field: x, type: u8}]}\n  b: {body: [{const: 01}, {field: y, type: u8}]}\n"
    receiver = receiver_of(text)
    receiver.append(b"\x01\x05\x01\x06", 0)
    first = receiver.next(("a", "b"))
    assert isinstance(first, FrameArrived) and first.value.frame == "a"
    second = receiver.other_reading()
    assert second is not None and second.value.frame == "b" and second.raw == first.raw
    assert receiver.other_reading() is None
    third = receiver.next(("a", "b"))
    assert isinstance(third, FrameArrived) and third.raw == b"\x01\x06"


ESCAPED = """
protocol: escaped
frames:
  message:
    body:
      - const: DLE STX
      - {wrap: {escape: DLE}, of: [{data: data, size: rest}], name: text, inside: [ack, nak]}
      - {const: DLE ETX, name: etx}
      - {check: sum8, over: [data]}
  enq: {body: [{const: DLE ENQ}]}
  ack: {body: [{const: DLE ACK}]}
  nak: {body: [{const: DLE NAK}]}
receiver: {symbols: DLE, resync: after_frame}
"""


def message(data: bytes) -> bytes:
    return b"\x10\x02" + data.replace(b"\x10", b"\x10\x10") + b"\x10\x03" + bytes([sum(data) & 0xFF])


def test_a_frame_inside_another_is_handed_over_at_once() -> None:
    whole = message(b"ab\x10cd")
    place = whole.index(b"c")
    with_ack = whole[:place] + b"\x10\x06" + whole[place:]
    receiver = receiver_of(ESCAPED)
    receiver.append(with_ack[: place + 2], 0)
    inner = receiver.next(("message", "ack"))
    assert isinstance(inner, FrameArrived) and inner.value.frame == "ack"
    receiver.append(with_ack[place + 2 :] + whole, 0)
    outer, following = receiver.next(("message", "ack")), receiver.next(("message", "ack"))
    assert isinstance(outer, FrameArrived) and outer.value.fields["data"] == b"ab\x10cd" and outer.raw == whole
    assert isinstance(following, FrameArrived) and following.offset == len(with_ack)


def test_doubled_data_are_no_start_of_a_frame() -> None:
    found = feed(receiver_of(ESCAPED), [b"\x10\x10\x02abc" + message(b"x")], ("message", "enq"))
    assert [item[:2] for item in found] == [("noise", b"\x10\x10\x02abc"), ("frame", "message")]


def test_a_symbol_that_breaks_a_message_off_shows_at_once_and_what_it_begins_is_found() -> None:
    receiver = receiver_of(ESCAPED)
    receiver.append(b"\x10\x02ab\x10\x05", 0)
    bad, enq = receiver.next(("message", "enq")), receiver.next(("message", "enq"))
    while isinstance(enq, Noise):
        enq = receiver.next(("message", "enq"))
    assert isinstance(bad, BadFrame) and (bad.cause, bad.raw) == ("constant", b"\x10\x02ab\x10\x05")
    assert isinstance(enq, FrameArrived) and enq.value.frame == "enq"
    found = feed(receiver_of(ESCAPED), [b"\x10\x02ab" + message(b"x")], ("message", "enq"))
    assert [item[0] for item in found if item[0] != "noise"] == ["bad", "frame"]


# ---- what holds for any bytes ------------------------------------------------------------------------------

PIECES = [GET, SET, b"\x06", b"\x15\x01", b"\x02", b"\x03", b"\x0201S", TOO_MUCH, checked(TOO_MUCH[:-2]), b"\xff\x00"]
LETTER_STREAM = st.lists(st.one_of(st.sampled_from(PIECES), st.binary(max_size=4)), max_size=12).map(b"".join)
CUTS = st.lists(st.integers(0, 10_000), max_size=12)


@given(LETTER_STREAM, CUTS)
def test_cutting_changes_nothing(data: bytes, places: list[int]) -> None:
    whole = feed(receiver_of(LETTERS), [data], ALL)
    assert feed(receiver_of(LETTERS), cut_at(data, places), ALL) == whole
    assert feed(receiver_of(LETTERS), [data[index : index + 1] for index in range(len(data))], ALL) == whole


@given(st.binary(max_size=60), CUTS, st.sampled_from(["next_start", "after_frame", "after_quiet", "never"]))
def test_cutting_changes_nothing_with_lengths_and_silence(data: bytes, places: list[int], resync: str) -> None:
    text = NUMBERS % resync
    data = data.replace(b"\x00", b"\xaa").replace(b"\x01", b"\xaa\x55\x00").replace(b"\x02", b"\xbb")
    names = ("short", "long", "stray")
    whole = feed(receiver_of(text), [data], names)
    assert feed(receiver_of(text), cut_at(data, places), names) == whole


@given(
    st.lists(
        st.sampled_from([b"\x10\x02", b"\x10\x03", b"\x10\x06", b"\x10\x10", b"a", b"\x10", message(b"q")]), max_size=14
    ),
    CUTS,
)
def test_cutting_changes_nothing_with_escapes(parts: list[bytes], places: list[int]) -> None:
    data = b"".join(parts)
    names = ("message", "ack", "nak", "enq")

    def ordered(found: list[tuple[Any, ...]]) -> list[tuple[Any, ...]]:
        return [item for item in found if item[0] != "noise"]

    whole = feed(receiver_of(ESCAPED), [data], names)
    assert ordered(feed(receiver_of(ESCAPED), cut_at(data, places), names)) == ordered(whole)


MAYBE_MORE = """
protocol: maybe-more
frames:
  note:
    body:
      - {wrap: {escape: DLE}, of: [{data: d, size: 2}, {data: e, size: rest}]}
      - {const: DLE ETX DLE STX}
      - {optional: [{field: more, type: u8}]}
      - {check: sum8, over: d..here}
receiver: {quiet: 4 chars}
"""


def test_cutting_changes_nothing_where_an_end_is_found_and_silence_is_waited_for() -> None:
    """An incomplete escape after the end is surplus, however the bytes are cut."""
    data = bytes.fromhex("FF 00 41 10 03 10 02 05 6A FF 00 41 10 FF 00 41 10 03 10 02 05 6A")
    whole = feed(receiver_of(MAYBE_MORE), [data], ("note",))
    assert whole[0] == ("bad", "note", "surplus", data, 0)
    for cut in range(len(data)):
        assert feed(receiver_of(MAYBE_MORE), cut_at(data, [cut]), ("note",)) == whole
    assert feed(receiver_of(MAYBE_MORE), [data[at : at + 1] for at in range(len(data))], ("note",)) == whole


ON_A_STREAM = """
protocol: on-a-stream
line: {kind: stream}
frames:
  note: {body: [{const: FD}, {length: n, type: u8, of: [d]}, {data: d, size: n}, {check: sum8}]}
"""


@given(st.lists(st.sampled_from([b"\xfd\x01\x05\x03", b"\xfd\x00\x01", b"\x05\x06", b"\xfc"]), max_size=8), CUTS)
def test_cutting_changes_nothing_on_a_stream_where_characters_take_no_time(
    parts: list[bytes], places: list[int]
) -> None:
    """Noise continues in the next piece, also if the definition has no `quiet` and the pieces arrive with pauses."""
    data = b"".join(parts)
    whole = feed(receiver_of(ON_A_STREAM), [data], ("note",))
    assert feed(receiver_of(ON_A_STREAM), cut_at(data, places), ("note",)) == whole
    pieces = [data[at : at + 1] for at in range(len(data))]
    assert feed(receiver_of(ON_A_STREAM), pieces, ("note",), step=MS) == whole


def test_noise_on_a_stream_is_told_when_nothing_more_comes() -> None:
    receiver = receiver_of(ON_A_STREAM)
    receiver.append(b"\x05", 0)
    assert receiver.next(("note",)) is None and receiver.deadline == 50 * MS
    receiver.append(b"\x06", 49 * MS)
    receiver.tick(98 * MS)
    assert receiver.next(("note",)) is None
    receiver.tick(99 * MS)
    noise = receiver.next(("note",))
    assert isinstance(noise, Noise) and noise.data == b"\x05\x06"


LOST_AND_LONG = """
protocol: lost
frames:
  good:  {body: [{const: CC}, {data: data, size: 2}]}
  short: {body: [{const: AA}, {field: size, type: u8, range: 0..9}, {data: data, size: size}]}
  long:  {body: [{const: AA}, {data: data, size: 6}, {check: sum8}]}
receiver: {gap: 50 ms, quiet: 4 chars}
"""


def test_a_frame_whose_end_is_lost_is_compared_where_it_stands_after_the_buffer_has_moved() -> None:
    """`short` is found bad early.

    `long` is found bad some bytes later, after the bytes before them have been released.
    """
    data = bytes.fromhex("CC 01 02" * 20 + "AA FF 01 02 03 04 05 06 CC 07 08")
    names = ("good", "short", "long")
    whole = feed(receiver_of(LOST_AND_LONG), [data], names)
    assert [item[:2] for item in whole[20:]] == [("bad", "long"), ("noise", data[60:68]), ("frame", "good")]
    for cut in range(len(data)):
        assert feed(receiver_of(LOST_AND_LONG), cut_at(data, [cut]), names) == whole
    assert feed(receiver_of(LOST_AND_LONG), [data[at : at + 1] for at in range(len(data))], names) == whole


@given(LETTER_STREAM, st.sampled_from([("set",), ("get", "ack"), ALL]))
def test_every_byte_becomes_something_exactly_once(data: bytes, names: tuple[str, ...]) -> None:
    receiver = receiver_of(LETTERS)
    found = feed(receiver, [data], names, tuple(name for name in ALL if name not in names))
    counted = sum(len(item[2]) for item in found if item[0] == "frame")
    counted += sum(len(item[1]) for item in found if item[0] == "noise")
    assert counted == len(data) and receiver.is_empty


@given(st.binary(max_size=200), st.sampled_from(["set", "get"]))
def test_a_frame_behind_noise_is_found_once_a_pause_has_shown_false_starts(noise: bytes, name: str) -> None:
    """A limit of the search: a false start that needs bytes holds it, until a pause longer than `gap` or its end."""
    receiver = receiver_of(LETTERS)
    feed(receiver, [noise], ALL, quiet_at_end=False)
    receiver.append(GET if name == "get" else SET, 3600 * SECOND)
    found = []
    while (event := receiver.next(ALL)) is not None:
        found.append(comparable(event))
    assert found[-1][:2] == ("frame", name)


LONG = LETTERS.replace("max: 64", "max: 60000").replace(
    "{text: G}", "{text: G}, {data: rest, size: rest, convert: hex_to_ascii}"
)


@pytest.mark.parametrize("size", [8, 25_000])
def test_byte_by_byte_each_byte_is_looked_at_a_bounded_number_of_times(size: int) -> None:
    """The work is linear for frames of any length: bytes are not searched twice."""
    frame = built(LONG, "get", station=1, rest=b"x" * size)
    receiver = receiver_of(LONG)
    info = receiver.table.infos["get"]
    measure, looked, total = info.measure, 0, 0

    def counting(data: Any, start: int, end: int, context: Any = None, seen: int = 0) -> int:
        nonlocal looked
        looked += end - start - seen
        result: int = measure(data, start, end, context, seen)
        return result

    info.measure = counting
    while total < 60_000:
        for byte in frame:
            receiver.append(bytes([byte]), 0)
            event = receiver.next(("get",))
        total += len(frame)
        assert isinstance(event, FrameArrived) and event.raw == frame
    assert looked <= 8 * total
    assert len(receiver.stream.buffer) <= 2 * max(len(frame), 4096)


def test_the_deadline_is_never_in_the_past() -> None:
    receiver = receiver_of(LETTERS)
    receiver.append(b"\xff", 0)
    assert receiver.next(ALL) is None
    assert 0 < receiver.deadline < NEVER
    receiver.tick(receiver.deadline)
    assert isinstance(receiver.next(ALL), Noise)
    assert receiver.next(ALL) is None and receiver.deadline == NEVER


def test_flush_gives_back_what_has_become_nothing() -> None:
    receiver = receiver_of(LETTERS)
    receiver.append(b"\xff" + SET[:4], 0)
    assert receiver.next(ALL) is None
    assert b"".join(noise.data for noise in receiver.flush()) == b"\xff" + SET[:4]
    receiver.append(GET, 1)
    event = receiver.next(ALL)
    assert isinstance(event, FrameArrived) and isinstance(event.value, FrameValue)


RADIO = """
protocol: radio
groups:
  g: {head: [{field: sync, type: u8%s}, {length: n, type: u8, of: [d], range: 1..20}], tail: [{check: crc16-modbus}]}
frames:
  A: {group: g, %sbody: [{data: d, size: n}]}
"""
STARTS = {
    "where": ("", "where: {sync: [0xC8, 0xEE]}, "),
    "is": (", is: 0xC8", ""),
    "only": (", values: {0xC8: here}, only: values", ""),
}


@pytest.mark.parametrize("how", STARTS)
@pytest.mark.parametrize("stray", [b"\x01\x05", b"\x00\x14", b"\x01\x05\xff"], ids=bytes.hex)
def test_stray_bytes_that_no_frame_begins_with_hold_nothing_up(how: str, stray: bytes) -> None:
    text = RADIO % STARTS[how]
    good = built(text, "A", d=b"\xc8abc", sync=0xC8)
    for pieces in ([stray + good], [bytes((byte,)) for byte in stray + good]):
        found = feed(receiver_of(text), pieces, ("A",), quiet_at_end=False)
        assert found == [("noise", stray, 0, False), ("frame", "A", good, len(stray), None)]


class SurpriseError(Exception):
    """An unexpected exception."""


@pytest.mark.parametrize("error", [SurpriseError, NameError, RecursionError, MemoryError, AssertionError])
@pytest.mark.parametrize("which", [("decode",), ("measure", "extent")], ids="-".join)
@pytest.mark.parametrize(
    "text, frame", [(LETTERS, "get"), (NUMBERS % "next_start", "short")], ids=["letters", "numbers"]
)
def test_whatever_a_generated_function_raises_ends_nothing(
    text: str, frame: str, which: tuple[str, ...], error: type[Exception], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A frame whose function raises is a bad frame; other frames are found as usual."""
    data = GET if frame == "get" else built(text, "short", data=b"ab")
    for pieces in ([data], [bytes((byte,)) for byte in data]):
        receiver = receiver_of(text)
        info = receiver.table.infos[frame]

        def fails(*_: Any, **__: Any) -> Any:
            raise error("what Python says")

        for name in which:
            monkeypatch.setattr(info, name, fails)  # other tests have the same table
        if "measure" in which:
            monkeypatch.setattr(info, "counted", None)  # measure all sizes
        monkeypatch.setattr(receiver.table, "_kept", {})  # cached tables contain the unpatched functions
        found = feed(receiver, pieces, (frame,))
        if "decode" in which:
            assert found[0][:3] == ("bad", frame, "value")
        assert b"".join(item[2] if item[0] == "frame" else b"" for item in found) in (b"", data)
        if "measure" in which:
            assert found == [("noise", data, 0, False)]


LONGER = """\
protocol: longer
line: {speed: 9600, format: 7E1}
receiver: {gap: 500 ms}
groups:
  reply:
    head: [{const: STX}, {field: mnemonic, type: ascii, size: 2}]
    tail: [{const: ETX}, {check: xor8, over: mnemonic..here}]
frames:
  told: {group: reply, body: [{field: value, type: decimal, decimals: any, end: [03]}]}
  told_hex: {group: reply, body: [{text: ">"}, {data: word, size: 2, convert: hex_to_ascii}]}
"""


def test_a_bad_frame_does_not_wait_for_a_longer_one_that_is_bad_already() -> None:
    """The other candidate is a byte longer, and has another constant at a place where this reply is right."""
    bad, good = b"\x02PV 25.1\x03\x11", b"\x02PV25.2\x03"
    good += bytes((functools.reduce(operator.xor, good[1:]),))
    receiver, names = receiver_of(LONGER), ("told", "told_hex")
    receiver.append(bad[:-1], 0)
    assert receiver.next(names) is None
    receiver.append(bad[-1:], 1)
    assert comparable(receiver.next(names))[:3] == ("bad", "told", "check")
    assert receiver.waiting == ()
    stream = bad + good + bad + bad + good
    whole = feed(receiver_of(LONGER), [stream], names)
    assert [event[0] for event in whole if event[0] != "noise"] == ["bad", "frame", "bad", "bad", "frame"]
    assert feed(receiver_of(LONGER), [stream[at : at + 1] for at in range(len(stream))], names) == whole
    random = Random(5)
    for _ in range(50):
        cuts = [random.randrange(len(stream)) for _ in range(random.randrange(6))]
        assert feed(receiver_of(LONGER), cut_at(stream, cuts), names) == whole


@pytest.mark.parametrize(
    ("data", "cause", "segment"),
    [
        ("05 04 00 01 00 02 99 0D", "check", "check"),  # complete, but with a wrong code
        ("05 04 00 01 00 02 99", "cut", ""),
        ("05 04 00 01 00", "cut", ""),
    ],
)
def test_a_wrong_code_after_a_list_is_told_when_no_more_comes(data: str, cause: str, segment: str) -> None:
    text = """
protocol: listed
line: {format: 8E1}
frames:
  told:
    body:
      - {const: 05}
      - {length: n, type: u8, of: [vals]}
      - {repeat: vals, times: rest, of: [{field: x, type: u16}]}
      - {check: sum8}
      - {const: CR}
"""
    receiver = receiver_of(text)
    receiver.append(bytes.fromhex(data), 0)
    assert receiver.next(("told",), ()) is None
    receiver.cut()
    bad = receiver.next(("told",), ())
    assert isinstance(bad, BadFrame)
    assert (bad.frame, bad.cause, bad.segment) == ("told", cause, segment)
