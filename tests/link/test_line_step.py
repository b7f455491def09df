"""`line:` in steps: another speed and format after a transmission, on both sides, and back."""

from __future__ import annotations

import asyncio
import os
import random
import termios
from typing import Any

import pytest
from link.link_world import MS, SECOND, compiled, load
from link.mode_c import MODE_C
from transport.real_world import run as in_real_time

from framekit.definition.problems import DefinitionError
from framekit.definition.times import parse_format
from framekit.link.engine import Engine
from framekit.link.events import Exchange, Outcome, Seen
from framekit.service.driver import Driver
from framekit.transport.clock import AsyncioClock, Clock, VirtualClock
from framekit.transport.port import Port
from framekit.transport.pty_port import PtyPair
from framekit.transport.schemes import open_port
from framekit.transport.simulated_line import SimulatedLine

BLOCK = b"1.8.0(00042)\r\n"
OWN = parse_format("7E1", 300)


class LineSide:
    """A side of the line: an engine on a port."""

    def __init__(self, role: str, port: Port, clock: Clock, text: str = MODE_C, **params: Any) -> None:
        protocol, codec = compiled(text)
        self.seen: list[Seen] = []
        self.outcomes: list[Outcome] = []
        self.engine = Engine(protocol, codec, role, now=clock.now(), params=params, monitor=self.seen.append)
        self.port = port
        self.driver = Driver(self.engine, port, clock)
        self.driver.start()

    def ask(self) -> None:
        self.driver.do(lambda now: self.engine.start(Exchange(on_done=self.outcomes.append), now))

    @property
    def lines(self) -> list[str]:
        return [seen.reason for seen in self.seen if seen.kind == "line"]

    @property
    def line(self) -> str:
        return str(self.engine.scope.line.line)


class World:
    """Client and meter on a simulated line."""

    def __init__(self, text: str = MODE_C, meter: str = MODE_C, **params: Any) -> None:
        self.clock = VirtualClock()
        self.line = SimulatedLine(self.clock, OWN, full_duplex=False)
        self.meter = LineSide("meter", self.line.port("meter"), self.clock, meter, **params)
        self.client = LineSide("client", self.line.port("client"), self.clock, text)
        self.clock.run_for(MS)

    def read(self) -> Outcome:
        self.client.ask()
        before = len(self.client.outcomes)
        while len(self.client.outcomes) == before and self.clock.advance():
            pass
        return self.client.outcomes[-1]


@pytest.mark.parametrize(("offers", "speed"), [(0x30, 300), (0x33, 2400), (0x35, 9600), (0x36, 19200)])
def test_both_sides_change_behind_what_was_sent_and_are_back_for_the_next(offers: int, speed: int) -> None:
    world = World(offers=offers)
    for _ in range(3):
        outcome = world.read()
        assert outcome.ok, outcome
        assert outcome.results["block"] == BLOCK
        assert outcome.results["speed"] == speed
        assert outcome.results["limit"] == round(10 * 10 * SECOND / speed), "ten characters of ten bits, at once"
        world.clock.run_for(5 * SECOND)
        assert (world.meter.line, world.client.line) == ("300 7E1", f"{speed} 7E1")
    changes = [] if speed == 300 else [f"{speed} 7E1", "300 7E1"]
    assert world.meter.lines == changes * 3
    assert not [seen for side in (world.client, world.meter) for seen in side.seen if seen.kind in ("bad", "noise")]


def test_times_on_the_wire() -> None:
    """The acknowledgement is transmitted at 300 baud, the block at 9600: 1/30 s and 1/960 s per character."""
    world = World()
    world.read()
    at = {(seen.direction, seen.frame): seen.at for seen in world.client.seen if seen.kind == "frame"}
    acknowledge, came = at["out", "acknowledge"], at["in", "readout"]
    changed = next(seen.at for seen in world.client.seen if seen.kind == "line")
    assert changed - acknowledge == pytest.approx(6 * SECOND / 30, abs=10)
    assert came - changed == pytest.approx(200 * MS + (len(BLOCK) + 6) * SECOND / 960, abs=100)


def test_where_one_side_does_not_change_nothing_good_comes() -> None:
    stays = MODE_C.replace("line: {speed: 'speeds[baud]'}, wait", "wait")
    assert stays != MODE_C
    world = World(meter=stays)
    outcome = world.read()
    assert (outcome.ok, outcome.outcome) == (False, "timeout")
    assert not [seen for seen in world.client.seen if seen.kind == "frame" and seen.frame == "readout"]
    assert [seen for seen in world.client.seen if seen.kind in ("bad", "noise")]
    world.clock.run_for(5 * SECOND)
    assert world.read().outcome == "timeout", "and the next one begins at 300 again: its sign-on is answered"
    assert [seen.frame for seen in world.client.seen if seen.kind == "frame"].count("identification") == 2


def test_a_connection_that_opens_anew_has_its_own_settings() -> None:
    world = World()
    assert world.read().ok
    assert (world.client.line, str(world.client.port.format)) == ("9600 7E1", "9600 7E1")
    world.client.port.pull()
    world.clock.run_for(5 * SECOND)
    assert (world.client.line, str(world.client.port.format)) == ("300 7E1", "300 7E1")
    assert world.read().ok


IN_SESSION = (
    MODE_C.replace("  client: {lanes:", "  client: {session: open, lanes:")
    .replace("exchange: read_out", "exchange: once_more")
    .replace(
        "  answer:",
        """  bye:
    steps: [{step: bye, send: sign_on}]
  once_more:
    gives: {speed: line.speed}
    steps: [{step: nothing, wait: 10 ms}]
  answer:""",
    )
    + """
sessions:
  open: {open: [read_out], close: [bye], lost_by: any}
"""
)


def test_the_end_of_a_session_brings_the_line_back_behind_its_last_frame() -> None:
    world = World(IN_SESSION)
    outcome = world.read()
    assert (outcome.ok, outcome.results["speed"]) == (True, 9600)
    assert world.read().results["speed"] == 9600, "it stays while the session is open"
    done: list[int] = []
    world.client.driver.do(lambda now: world.client.engine.close_session(now, lambda: done.append(world.clock.now())))
    while not done and world.clock.advance():
        pass
    assert (world.client.line, str(world.client.port.format)) == ("300 7E1", "300 7E1")
    last = next(seen for seen in reversed(world.client.seen) if seen.kind == "frame" and seen.direction == "out")
    back = next(seen for seen in reversed(world.client.seen) if seen.kind == "line")
    assert back.at - last.at == pytest.approx(5 * SECOND / 960, abs=10), "the last frame left at 9600"


def test_a_session_that_cannot_be_opened_leaves_no_other_line() -> None:
    world = World(IN_SESSION, MODE_C.replace("line: {speed: 'speeds[baud]'}, wait", "wait"))
    assert world.read().outcome == "timeout"
    assert world.client.lines == ["9600 7E1", "300 7E1"]
    assert world.client.line == "300 7E1"


def test_what_another_format_makes_of_characters() -> None:
    """7E1 received as 8N1 is the character with its parity bit as the highest bit; another speed is never good."""
    clock = VirtualClock()
    line = SimulatedLine(clock, OWN)
    one, other = line.port("one"), line.port("other")
    heard: list[tuple[bytes, int]] = []

    class Ears:
        def received(self, data: bytes, now: int, faults: Any = ()) -> None:
            heard.append((data, len(faults)))

        def __getattr__(self, name: str) -> Any:
            return lambda *values: None

    one.open(Ears())  # type: ignore[arg-type]
    other.open(Ears())  # type: ignore[arg-type]
    clock.run_for(MS)
    text = bytes(random.Random(1).randrange(128) for _ in range(64))
    for shape, speed in (("8N1", 300), ("7E1", 600), ("7E1", 150), ("7O1", 300), ("7E1", 300), ("7E1", 303)):
        heard.clear()
        other.change_line(parse_format(shape, speed))
        one.write(text)
        clock.run_for(10 * SECOND)
        (data, faults) = heard[0]
        assert len(data) == len(text)
        if (shape, speed) == ("8N1", 300):
            assert (data, faults) == (bytes(x | (x.bit_count() & 1) << 7 for x in text), 0)
        elif shape == "7O1":
            assert (data, faults) == (text, len(text)), "each with a parity fault"
        elif speed in (300, 303):
            assert (data, faults) == (text, 0), "one percent makes no difference"
        else:
            assert faults == len(text), "each without a stop bit"


def test_over_real_pseudo_terminals() -> None:
    async def scenario() -> None:
        clock = AsyncioClock(asyncio.get_running_loop())
        with PtyPair() as pair:
            meter = LineSide("meter", open_port(pair.first, OWN, clock), clock)
            client = LineSide("client", open_port(pair.second, OWN, clock), clock)
            looks = {
                side: os.open(path, os.O_RDWR | os.O_NOCTTY) for side, path in enumerate((pair.first, pair.second))
            }

            def speed(side: int) -> int:
                return int(termios.tcgetattr(looks[side])[4])

            try:
                while not (client.driver.is_open and meter.driver.is_open):
                    await asyncio.sleep(0)
                assert (speed(0), speed(1)) == (termios.B300, termios.B300)
                for _ in range(2):
                    client.ask()
                    before = len(client.outcomes)
                    while len(client.outcomes) == before:
                        await asyncio.sleep(0)
                    outcome = client.outcomes[-1]
                    assert outcome.ok, outcome
                    assert (outcome.results["block"], outcome.results["speed"]) == (BLOCK, 9600)
                    assert speed(1) == termios.B9600
                    while meter.line != "300 7E1":
                        await asyncio.sleep(0)
                    assert speed(0) == termios.B300
                    assert meter.lines == ["9600 7E1", "300 7E1"] * len(client.outcomes)
            finally:
                client.driver.stop()
                meter.driver.stop()
                for one in looks.values():
                    os.close(one)

    in_real_time(scenario())


# ---- what is wrong ------------------------------------------------------------------------------------------

WRONG = {
    "line: fast": "'fast' is not own, or {speed: 9600, format: 8N1}",
    "line: {}": "empty",
    "line: {speed: 0}": "0 is not a line speed",
    "line: {speed: 2 s}": "a number is wanted here",
    "line: {speed: 9600, format: 9600}": "a text is wanted here",
    "line: {format: \"'9X1'\"}": "'9X1' is not a line format",
    "line: {sped: 9600}": "did you mean 'speed'",
    "line: {speed: boud}": "there is no name 'boud' here",
}


@pytest.mark.parametrize(("line", "what"), WRONG.items())
def test_a_wrong_step_is_told_at_its_place(line: str, what: str) -> None:
    with pytest.raises(DefinitionError) as caught:
        load(MODE_C.replace("line: own}", f"{line}}}"))
    assert what in str(caught.value)
    assert ":16:" in str(caught.value)


def test_a_stream_has_no_line_to_change_and_nothing_is_sent_again_behind_one() -> None:
    with pytest.raises(DefinitionError, match="changes a line that is a stream"):
        load(MODE_C.replace("line: {speed: 300, format: 7E1}\n", "line: {kind: stream}\n"))
    with pytest.raises(DefinitionError, match="would go out with the line changed"):
        load(
            MODE_C.replace(
                "        complete: 100 chars",
                "        complete: 100 chars\n        on_timeout: resend\n        retries: 2",
            )
        )


@pytest.mark.parametrize("speed", ["0 - baud", "baud * 10000000000000", "'fast'", "h'01'"])
def test_a_speed_that_is_none_ends_the_sequence(speed: str) -> None:
    text = MODE_C.replace("line: {speed: 'speeds[baud]', format: 7E1}", f'line: {{speed: "{speed}"}}')
    try:
        world = World(text)
    except DefinitionError as error:
        assert "a number is wanted here" in str(error)
        return
    outcome = world.read()
    assert (outcome.outcome, world.client.line) == ("expression", "300 7E1")
    assert any("line speed" in seen.reason for seen in world.client.seen if seen.kind == "trouble")
