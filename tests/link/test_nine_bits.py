"""`mark:` of frames on a simulated line: the characters whose ninth bit is set, and their effect on a receiver."""

from __future__ import annotations

import random
from itertools import pairwise

import pytest
from link.link_world import MS, compiled, feed
from link.nine_bits import VENDING
from transport.line_world import Listener
from transport.line_world import World as Wires

from framekit.definition.times import Direction, LineFormat, LineSettings, parse_format
from framekit.link.engine import Engine
from framekit.link.events import CharacterFault, Exchange, LineFault, Outcome, Seen
from framekit.link.receiver import Receiver
from framekit.link.scope import Scope
from framekit.service.driver import Driver
from framekit.transport.clock import Clock, VirtualClock
from framekit.transport.port import LineEvent, Port, SharedPort, TappedPort
from framekit.transport.simulated_line import SimulatedLine
from framekit.transport.wiring import wired

NINE = parse_format("9N1", 9600)
POLL, SELL, DONE = bytes.fromhex("0B 0B"), bytes.fromhex("0C 02 0E"), b"\x00"
STATE, TAKEN = bytes.fromhex("00 05 0A 0F"), b"\x00"
COMMANDS = ("poll", "sell", "done")


class Side:
    """An engine on a port of the line."""

    def __init__(self, role: str, port: Port, clock: Clock, text: str = VENDING) -> None:
        protocol, codec = compiled(text)
        self.seen: list[Seen] = []
        self.outcomes: list[Outcome] = []
        self.engine = Engine(protocol, codec, role, line=NINE, now=clock.now(), monitor=self.seen.append)
        self.driver = Driver(self.engine, port, clock)
        self.driver.start()

    @property
    def bad(self) -> list[tuple[str, str, bytes]]:
        return [(event.frame, event.reason, event.raw) for event in self.seen if event.kind == "bad"]


class World:
    """A client and a machine; `heard` lists the bytes on the line, with an asterisk after each marked byte."""

    def __init__(self, client: str = VENDING, machine: str = VENDING, formats: str = "9N1") -> None:
        self.clock = VirtualClock()
        self.line = SimulatedLine(self.clock, NINE, full_duplex=False)
        self.heard: list[str] = []
        self.machine = Side("machine", self.line.port("machine"), self.clock, machine)
        port = self.line.port("client")
        port.settings = parse_format(formats, 9600)
        self.client = Side("client", TappedPort(port, self.clock, self._tap), self.clock, client)
        self.clock.run_for(MS)

    def _tap(self, event: LineEvent) -> None:
        if event.kind == "data":
            self.heard.append(with_marks(event.data, event.faults))

    def ask(self) -> Outcome:
        client = self.client
        exchange = Exchange(on_done=client.outcomes.append)
        client.driver.do(lambda now: client.engine.start(exchange, now))
        while not client.outcomes and self.clock.advance():
            pass
        return client.outcomes[-1]


def with_marks(data: bytes, faults: tuple[CharacterFault, ...]) -> str:
    marks = {fault.index for fault in faults if fault.fault is LineFault.MARK}
    return " ".join(f"{byte:02X}{'*' if index in marks else ''}" for index, byte in enumerate(data))


def marked(text: str) -> list[tuple[int, bool]]:
    """Parse `0B* 0B`: bytes, the marked bytes with an asterisk."""
    return [(int(word[:2], 16), word.endswith("*")) for word in text.split()]


def receiver_of(text: str = VENDING) -> Receiver:
    protocol, codec = compiled(text)
    receiver = Receiver(codec, protocol, Scope(protocol, line=NINE))
    receiver.hear_marks(True)
    return receiver


def found_in(
    characters: list[tuple[int, bool]], cuts: list[int], expected: tuple[str, ...], text: str = VENDING
) -> list[tuple[object, ...]]:
    """Return the events of a receiver for characters in pieces without pauses, and for the silence after them."""
    receiver, found = receiver_of(text), []
    edges = [0, *cuts, len(characters)]
    for begin, end in pairwise(edges):
        piece = characters[begin:end]
        faults = [CharacterFault(index, LineFault.MARK) for index, (_, mark) in enumerate(piece) if mark]
        receiver.append(bytes(value for value, _ in piece), 0, faults)
        found += feed(receiver, [], expected, quiet_at_end=False)
    return found + feed(receiver, [], expected)


def test_each_side_marks_the_byte_that_its_frames_say() -> None:
    world = World()
    assert world.ask().ok
    world.clock.run_for(20 * MS)
    assert world.heard == ["0B* 0B", "00 05 0A 0F*", "00"]
    assert not world.client.bad and not world.machine.bad


def test_a_mark_ends_a_frame_at_once() -> None:
    """The bytes of `state` do not determine its end; the mark does, so the receiver does not wait for silence."""
    world = World()
    assert world.ask().ok
    characters = len(POLL) + len(STATE)
    assert world.client.engine.scope.now == MS + characters * NINE.character_time


def test_characters_take_eleven_bit_times() -> None:
    assert NINE.character_bits == 11
    assert str(NINE) == "9600 9N1"
    with pytest.raises(ValueError, match="has a parity besides the ninth bit – write 9N1"):
        parse_format("9E1", 9600)


@pytest.mark.parametrize("of", ["command", "answer"])
def test_who_disagrees_about_marks_sees_damaged_frames(of: str) -> None:
    """The client marks the first byte of commands and expects a marked last byte.

    The machine is configured otherwise.
    """
    other = {"command": ("mark: first", "mark: none"), "answer": ("mark: last, tail", "mark: none, tail")}[of]
    text = VENDING.replace(*other)
    assert text != VENDING
    world = World(machine=text)
    assert not world.ask().ok
    side = world.machine if of == "command" else world.client
    assert {cause for _, cause, _ in side.bad} == {"mark"}


@pytest.mark.parametrize("other", ["8N1", "8E1"])
def test_who_has_no_ninth_bit_is_not_understood(other: str) -> None:
    """The stop or parity bit after eight data bits is read as the ninth bit."""
    assert not World(formats=other).ask().ok


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("0B* 0B", [("frame", "poll", POLL)]),
        ("0B 0B", [("bad", "poll", "mark")]),
        ("0B* 0B*", [("bad", "poll", "cut"), ("bad", "poll", "cut")]),
        ("00", [("frame", "done", DONE)]),
        ("00*", [("bad", "done", "mark")]),
        ("0C* 02 0B* 0B", [("bad", "sell", "cut"), ("frame", "poll", POLL)]),
        ("0C* 0B* 0B", [("bad", "sell", "cut"), ("frame", "poll", POLL)]),
        ("55 0B* 0B", [("noise", b"\x55"), ("frame", "poll", POLL)]),
        ("0C* 02 0E 00 0B* 0B", [("frame", "sell", SELL), ("frame", "done", DONE), ("frame", "poll", POLL)]),
        ("0B* 0C 0B* 0B", [("bad", "poll", "check"), ("frame", "poll", POLL)]),
    ],
)
def test_a_marked_byte_begins_a_command(line: str, expected: list[tuple[object, ...]]) -> None:
    for cuts in ([], list(range(1, len(marked(line))))):
        found = found_in(marked(line), cuts, COMMANDS)
        assert [short(event) for event in found if event[-1] is not True] == expected, cuts


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("00 05 0A 0F*", [("frame", "state", STATE)]),
        ("00*", [("frame", "taken", TAKEN)]),
        ("05 05* 00*", [("frame", "state", b"\x05\x05"), ("frame", "taken", TAKEN)]),
        ("05 06* 00*", [("bad", "state", "check"), ("frame", "taken", TAKEN)]),
    ],
)
def test_a_marked_byte_ends_an_answer(line: str, expected: list[tuple[object, ...]]) -> None:
    for cuts in ([], list(range(1, len(marked(line))))):
        found = found_in(marked(line), cuts, ("state", "taken"))
        assert [short(event) for event in found if event[-1] is not True] == expected, cuts


def short(event: tuple[object, ...]) -> tuple[object, ...]:
    return event[:3] if event[0] != "noise" else event[:2]


def test_how_the_stream_is_cut_changes_nothing() -> None:
    """Whole, byte by byte, randomly: the same frames, bad frames and noise."""
    random_of = random.Random(9)
    pieces = ["0B* 0B", "0C* 02 0E", "00", "0C* 02", "55", "0B 0B", "0C* 03 0E", "00*", "0B*", "AA*"]
    for _ in range(200):
        line = marked(" ".join(random_of.choice(pieces) for _ in range(random_of.randrange(1, 9))))
        whole = found_in(line, [], COMMANDS)
        assert found_in(line, list(range(1, len(line))), COMMANDS) == whole
        cuts = sorted(random_of.sample(range(1, len(line)), random_of.randrange(len(line)))) if len(line) > 1 else []
        assert found_in(line, cuts, COMMANDS) == whole


def test_without_marks_frames_are_told_by_their_bytes() -> None:
    """A pseudo-terminal or a connection does not transmit ninth bits."""
    receiver = receiver_of()
    receiver.hear_marks(False)
    assert [short(event) for event in feed(receiver, [POLL + SELL], COMMANDS)] == [
        ("frame", "poll", POLL),
        ("frame", "sell", SELL),
    ]


def test_a_skipped_bad_frame_ends_where_a_mark_begins_the_next() -> None:
    text = VENDING.replace("resync: after_frame", "resync: after_quiet")
    found = found_in(marked("0B* 0C 55 0B* 0B"), [], COMMANDS, text)
    assert [short(event)[:2] for event in found] == [("bad", "poll"), ("noise", b"\x55"), ("frame", "poll")]


# ---- the line itself -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("listens", "expected"),
    [
        ("9N1", "0B* 0B"),
        ("8S1", {0: LineFault.PARITY}),
        ("8M1", {1: LineFault.PARITY}),
        ("8N1", {1: LineFault.FRAMING}),
    ],
)
def test_a_port_of_another_format_hears_its_own_bits(listens: str, expected: object) -> None:
    wires = Wires(text="9N1")
    wires.ports[1].format = parse_format(listens, 9600)
    wires.ports[0].write_marked(POLL, 0)
    wires.clock.run_for(100 * MS)
    listener = wires.listeners[1]
    found = tuple(CharacterFault(index, fault) for index, fault in listener.faults)
    assert (with_marks(listener.bytes, found) if listens == "9N1" else dict(listener.faults)) == expected


def test_a_ninth_bit_can_be_damaged_too() -> None:
    wires = Wires(text="9N1", fault=lambda transmission: transmission.flip(1, 0x100))
    wires.ports[0].write_marked(POLL, 0)
    wires.clock.run_for(100 * MS)
    assert wires.listeners[1].bytes == POLL
    assert dict(wires.listeners[1].faults) == {0: LineFault.MARK, 1: LineFault.MARK}


def test_what_stands_around_a_port_passes_marks_on() -> None:
    """Direction control, echo removal, and a port shared by stations."""
    wires = Wires(text="9N1", echo=True)
    for port in wires.ports:
        port.close()
    wired_up = wired(wires.ports[0], LineSettings(direction=Direction(), echo=True), wires.clock)
    shared = SharedPort(wired_up, wires.clock).user()
    here, far_end = Listener(wires.ports[0]), Listener(wires.ports[1])
    shared.open(here)
    wires.ports[1].open(far_end)
    wires.clock.run_for(MS)
    assert shared.hears_marks
    shared.write_marked(POLL, 0)
    wires.clock.run_for(100 * MS)
    assert far_end.bytes == POLL and far_end.faults == [(0, LineFault.MARK)]
    assert here.bytes == b"", "a marked byte of the echo is the same byte"
    wires.ports[1].write_marked(TAKEN, 0)
    wires.clock.run_for(100 * MS)
    assert here.bytes == TAKEN and here.faults == [(0, LineFault.MARK)]


def test_a_port_without_ninth_bits_sends_none() -> None:
    wires = Wires(text="8N1")
    wires.ports[0].write_marked(POLL, 0)
    wires.clock.run_for(100 * MS)
    assert wires.listeners[1].bytes == POLL and not wires.listeners[1].faults
    assert not wires.ports[1].hears_marks
    assert LineFormat(9600).has_marks is False
