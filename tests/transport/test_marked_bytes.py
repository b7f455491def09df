"""Damaged characters and breaks as marked by a terminal, on invented streams and on a terminal that really marks."""

from __future__ import annotations

import asyncio
import os
import termios
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st
from transport.real_world import Waiting, open_pty, opened, run

from framekit.definition.times import LineFormat
from framekit.link.events import CharacterFault, LineFault
from framekit.transport import serial_port
from framekit.transport.clock import AsyncioClock
from framekit.transport.serial_port import DamageCounts, DamageMarks, SerialPort, damage_counts, mark_damage


def marked(characters: list[tuple[int, bool]]) -> bytes:
    """Return the bytes that a terminal delivers for characters, some of which are damaged."""
    return b"".join(
        b"\xff\x00" + bytes([value]) if damaged else bytes([value]) * (2 if value == 0xFF else 1)
        for value, damaged in characters
    )


Characters = st.lists(st.tuples(st.sampled_from([0, 1, 0x41, 0xFE, 0xFF]), st.booleans()), max_size=12)


@given(Characters, st.lists(st.integers(0, 40), max_size=4))
def test_marks_come_out_wherever_the_stream_is_cut(characters: list[tuple[int, bool]], cuts: list[int]) -> None:
    stream, marks = marked(characters), DamageMarks()
    found, places = b"", []
    edges = sorted({0, len(stream), *(cut for cut in cuts if cut < len(stream))})
    for begin, end in pairwise(edges):
        data, indices = marks.take_out(stream[begin:end])
        places += [len(found) + index for index in indices]
        found += data
    assert found == bytes(value for value, _ in characters)
    assert places == [index for index, (_, damaged) in enumerate(characters) if damaged]


def test_a_terminal_marks_when_it_is_asked_to() -> None:
    path, master = open_pty()
    with master:
        terminal = os.open(path, os.O_RDWR | os.O_NOCTTY)
        assert mark_damage(terminal)
        assert termios.tcgetattr(terminal)[0] & termios.INPCK
        master.write(b"a\xffb")
        assert DamageMarks().take_out(os.read(terminal, 100)) == (b"a\xffb", [])
        assert damage_counts(terminal) is None, "a pseudo-terminal counts nothing"
        os.close(terminal)


def test_what_is_no_terminal_marks_nothing() -> None:
    read, write = os.pipe()
    assert not mark_damage(read)
    os.close(read)
    os.close(write)


@pytest.mark.parametrize(
    ("parity", "added", "stream", "expected"),
    [
        ("E", None, [(1, False), (2, True)], [(b"\x01\x02", {1: LineFault.PARITY})]),
        ("N", None, [(1, False), (2, True)], [(b"\x01\x02", {1: LineFault.FRAMING})]),
        ("E", DamageCounts(framing=1), [(2, True)], [(b"\x02", {0: LineFault.FRAMING})]),
        ("E", None, [(1, False), (0, True), (2, True)], [(b"\x01", {}), "break", (b"\x02", {0: LineFault.PARITY})]),
        ("E", DamageCounts(parity=1), [(0, True), (1, False)], [(b"\x00\x01", {0: LineFault.PARITY})]),
        ("N", DamageCounts(breaks=1), [(0, True)], ["break"]),
        ("N", None, [(0, True), (0, True)], ["break", "break"]),
        ("N", None, [(0xFF, False), (0, False)], [(b"\xff\x00", {})]),
    ],
)
def test_a_port_tells_of_damage_and_breaks_in_order(
    monkeypatch: pytest.MonkeyPatch,
    parity: str,
    added: DamageCounts | None,
    stream: list[tuple[int, bool]],
    expected: list[object],
) -> None:
    """A pseudo-terminal is treated as a real terminal.

    The test writes the marks, which a pseudo-terminal does not make.
    """
    counted = [DamageCounts(), added]
    monkeypatch.setattr(serial_port, "is_pseudo", lambda descriptor: False)
    monkeypatch.setattr(serial_port, "mark_damage", lambda descriptor: True)
    monkeypatch.setattr(serial_port, "damage_counts", lambda descriptor: counted.pop(0) if added else None)

    async def check() -> None:
        path, master = open_pty()
        with master:
            port = SerialPort(path, LineFormat(9600, parity=parity), AsyncioClock(asyncio.get_running_loop()))
            events = await opened(port)
            master.write(marked(stream))
            assert [await next_of(events) for _ in expected] == expected
            port.close()

    run(check())


async def next_of(events: Waiting) -> object:
    kind, value = await events.queue.get()
    if kind != "received":
        return kind
    data, faults = value
    assert all(isinstance(fault, CharacterFault) for fault in faults)
    return data, {fault.index: fault.fault for fault in faults}
