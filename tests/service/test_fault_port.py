"""Frames that a fault plan holds back, combined with every fault of the next frame."""

from __future__ import annotations

import pytest

from framekit.codec.codec import compile_protocol
from framekit.definition.load.protocol import load_protocol
from framekit.link.frame_faults import FrameFaults
from framekit.link.scope import Scope
from framekit.run.model import FaultPlan, FaultRule
from framekit.service.faults import FaultInjector, FaultyPort
from framekit.transport.clock import VirtualClock
from framekit.transport.port import Port, PortEvents

MS = 1_000_000
A, B, C = b"\x01\x06\x00", b"\x01\x03\x02", b"\x01\x04\x05"


class Events(PortEvents):
    """The owner of the port: records events with their times."""

    def __init__(self) -> None:
        self.told: list[tuple[str, int]] = []

    def opened(self, now: int) -> None:
        self.told.append(("opened", now))

    def closed(self, now: int, reason: str) -> None:
        self.told.append((reason, now))

    def sent(self, now: int) -> None:
        self.told.append(("sent", now))


class Recorder(Port):
    """A port that takes 1 ms for each write."""

    name, settings, is_stream = "recorder", None, True

    def __init__(self, clock: VirtualClock) -> None:
        self.clock = clock
        self.written: list[bytes] = []
        self.marks: list[tuple[int, int]] = []
        self.events: PortEvents | None = None

    def open(self, events: PortEvents) -> None:
        self.events = events
        events.opened(self.clock.now())

    def write(self, data: bytes) -> None:
        self.written.append(data)
        self.clock.call_at(self.clock.now() + MS, self._left)

    def write_marked(self, data: bytes, marked: int) -> None:
        self.marks.append((len(self.written), marked))
        self.write(data)

    def _left(self) -> None:
        if self.events is not None:
            self.events.sent(self.clock.now())

    def close(self) -> None:
        self.events = None

    def send_break(self, duration: int) -> None: ...


def sent(*rules: FaultRule) -> tuple[list[bytes], list[tuple[str, int]]]:
    """Send three frames 10 ms apart; return the transmitted frames and the events of the owner."""
    clock = VirtualClock()
    protocol = load_protocol("modbus-rtu")
    frames = FrameFaults(protocol, compile_protocol(protocol), Scope(protocol, role="server"), answers=True)
    port, events = Recorder(clock), Events()
    faulty = FaultyPort(port, FaultInjector(FaultPlan(rules=rules), clock, frames))
    faulty.open(events)
    for frame in (A, B, C):
        faulty.write(frame)
        clock.run_for(10 * MS)
    return port.written, events.told


def marks_of(marked: int, *rules: FaultRule) -> tuple[list[bytes], list[tuple[int, int]]]:
    """Send A and B with a marked byte each; return the transmitted pieces, and the piece and offset of marked bytes."""
    clock = VirtualClock()
    protocol = load_protocol("modbus-rtu")
    frames = FrameFaults(protocol, compile_protocol(protocol), Scope(protocol, role="server"), answers=True)
    port = Recorder(clock)
    faulty = FaultyPort(port, FaultInjector(FaultPlan(rules=rules), clock, frames))
    faulty.open(Events())
    for frame in (A, B):
        faulty.write_marked(frame, marked)
        clock.run_for(10 * MS)
    return port.written, port.marks


GLUE = FaultRule(kind="glue", times=1)


def test_a_frame_is_glued_to_the_next() -> None:
    assert sent(GLUE)[0] == [A + B, C]


def test_a_frame_that_was_held_back_goes_out_when_the_next_is_swallowed() -> None:
    written, events = sent(GLUE, FaultRule(kind="no_reply", every=2))
    assert written == [A, C]
    assert [what for what, _ in events] == ["opened", "sent", "sent", "sent"], "one for each"


def test_a_frame_that_was_held_back_leaves_before_the_line_is_lost() -> None:
    written, events = sent(GLUE, FaultRule(kind="disconnect", every=2, time=500 * MS))
    assert written == [A]
    assert events[-1] == ("disconnected by the fault plan", 11 * MS), "1 ms after it began"


@pytest.mark.parametrize("times", [2, 3])
def test_several_held_back_go_out_together(times: int) -> None:
    rules = FaultRule(kind="glue", times=times), FaultRule(kind="no_reply", every=3)
    assert sent(*rules)[0] == ([A + B] if times == 2 else [])


@pytest.mark.parametrize(
    ("marked", "rules", "written", "marks"),
    [
        (0, (), [A, B], [(0, 0), (1, 0)]),
        (2, (), [A, B], [(0, 2), (1, 2)]),
        (0, (GLUE,), [A + B], [(0, 3)]),
        (0, (FaultRule(kind="split", size=2, times=1),), [A[:2], A[2:], B], [(0, 0), (2, 0)]),
        (2, (FaultRule(kind="split", size=2, times=1),), [A[:2], A[2:], B], [(1, 0), (2, 2)]),
    ],
)
def test_a_ninth_bit_goes_with_its_byte(
    marked: int, rules: tuple[FaultRule, ...], written: list[bytes], marks: list[tuple[int, int]]
) -> None:
    """Marked is the first or the last byte of a frame; a frame that is held back has no marked byte."""
    assert marks_of(marked, *rules) == (written, marks)
