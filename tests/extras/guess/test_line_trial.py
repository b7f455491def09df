"""Speed and format of a line, found by listening: characters at wrong speeds, verdicts, whole trials."""

from __future__ import annotations

from random import Random

import pytest
from extras.guess.uart import SECOND, UartPort, Wire, receive
from spread import many, spread

from framekit.definition.times import LineFormat, parse_format
from framekit.extras.guess.line_trial import FORMATS, SPEEDS, HeardAt, LineTrial, TrialResult, judge
from framekit.link.events import CharacterFault, LineFault
from framekit.transport.clock import VirtualClock
from framekit.transport.port import PortEvents

MS = 1_000_000
LINES = [parse_format(form, int(speed)) for speed in SPEEDS.split(",") for form in FORMATS.split(",")]
NINE = parse_format("8N1", 9600)


# ---- the model ------------------------------------------------------------------------------------------------


def values(wire: Wire, line: LineFormat) -> bytes:
    return bytes(character.value for character in receive(wire, line))


def faults(wire: Wire, line: LineFormat) -> list[LineFault | None]:
    return [character.fault for character in receive(wire, line)]


@pytest.mark.parametrize("line", LINES, ids=str)
def test_a_uart_hears_what_was_sent(line: LineFormat) -> None:
    sent = bytes(value & (1 << line.data_bits) - 1 for value in Random(str(line)).randbytes(200))
    wire = Wire()
    wire.send(sent[:100], line, pause=20 * MS)
    wire.send(sent[100:], line, pause=1_234_567)
    wire.send(b"", line, pause=MS)
    assert values(wire, line) == sent
    assert set(faults(wire, line)) == {None}


def test_a_uart_with_another_setting_hears_damage() -> None:
    wire = Wire()
    wire.send(b"\x01\x03\x07", NINE, pause=20 * MS, between=5 * MS)
    wire.send_break(10 * MS)
    wire.send(b"\x55", NINE, pause=5 * MS)
    wire.send(b"", NINE, pause=MS)
    assert [(character.value, character.is_break) for character in receive(wire, NINE)] == [
        (1, False), (3, False), (7, False), (0, True), (0x55, False),
    ]  # fmt: skip
    even = faults(wire, parse_format("8E1", 9600))
    assert even[:3] == [None, LineFault.PARITY, None], "the stop bit is taken for the parity"
    assert values(wire, parse_format("8N1", 19200))[:1] == b"\x06", "each bit comes twice"


# ---- judging --------------------------------------------------------------------------------------------------


def heard_at(wire: Wire, line: LineFormat) -> HeardAt:
    found = HeardAt(line)
    for one in receive(wire, line):
        if one.is_break:
            found.add_break()
        else:
            found.add(bytes([one.value]), () if one.fault is None else (CharacterFault(0, one.fault),))
        if found.characters == 400:
            break
    return found


def verdict_on(wire: Wire, lines: list[LineFormat] = LINES) -> TrialResult:
    """Return the verdict of a trial with these line settings, without simulating its durations."""
    heard = [heard_at(wire, line) for line in lines]
    best = [trial for trial in judge(heard).ranking if trial.characters][:3]
    return judge(heard, [heard_at(wire, LineFormat(2 * trial.line.speed)) for trial in best])


TRAFFIC = {
    "binary": lambda random: bytes([1, 3, 0, random.randrange(30)]) + random.randbytes(2 + random.randrange(30)),
    "text": lambda random: f":{random.randrange(9)}TEMP={random.randrange(1000)}.{random.randrange(9)}\r\n".encode(),
    "zeros": lambda random: bytes([1, 3, 16]) + bytes(random.randrange(16)) + random.randbytes(2),
    "hex": lambda random: b"\x02" + random.randbytes(6).hex().upper().encode() + b"\x03",
    "one poll": lambda random: bytes.fromhex("010300000002C40B"),
}


def traffic(kind: str, line: LineFormat, random: Random, frames: int) -> Wire:
    """Yield frames with pauses; on some lines, characters are also separated by a rest."""
    wire, character = Wire(end=50 * MS), line.character_time
    between = random.choice([0, 0, 0, character * random.random() * 2])
    for _ in range(frames):
        wire.send(TRAFFIC[kind](random), line, pause=character * (4 + random.random() * 30), between=between)
    wire.send(b"", line, pause=50 * MS)
    return wire


def kinds_of(line: LineFormat) -> list[str]:
    return ["text", "hex"] if line.data_bits == 7 else list(TRAFFIC)


CASES = [12, pytest.param(many(50, 300), marks=pytest.mark.long)]


@pytest.mark.parametrize("count", CASES)
def test_what_is_sure_is_right_and_the_right_one_comes_first(count: int) -> None:
    random, first, wrong = Random(19), 0, 0
    for _ in range(count):
        line = random.choice(LINES)
        wire = traffic(random.choice(kinds_of(line)), line, random, random.choice([3, 8, 20]))
        found = verdict_on(wire)
        assert found.certainty != "sure" or found.line == line, (str(line), found.text)
        wrong += found.certainty == "likely" and found.line != line
        first += found.line == line
    assert first >= 0.97 * count and wrong <= 0.005 * count


OTHERS = [
    parse_format(form, speed)
    for speed in (300, 3600, 7200, 9000, 10400, 14400, 28800, 31250, 64000, 76800, 100000, 230400, 250000)
    for form in ("8N1", "8E1", "7E1", "7N2", "8M1")
]


@pytest.mark.parametrize("count", CASES)
def test_nothing_is_sure_where_the_right_one_is_not_tried(count: int) -> None:
    random = Random(20)
    for _ in range(count):
        line = random.choice(OTHERS)
        found = verdict_on(traffic(random.choice(kinds_of(line)), line, random, random.choice([3, 8, 20])))
        assert found.certainty != "sure", (str(line), found.text)


@pytest.mark.parametrize("line", spread(LINES[:6] + LINES[-6:], 4), ids=str)
def test_a_busy_line_is_sure(line: LineFormat) -> None:
    found = verdict_on(traffic("text", line, Random(1), 30))
    assert (found.certainty, found.line) == ("sure", line)
    assert f"at {2 * line.speed} each bit comes twice" in found.text


def test_damage_now_and_then_does_not_hide_it() -> None:
    heard = heard_at(traffic("binary", NINE, Random(3), 30), NINE)
    clean = heard.bits
    for place in range(heard.characters // 50):
        heard.add(bytes([place]), (CharacterFault(0, LineFault.FRAMING),))
    assert 16 < heard.bits < clean


def test_one_character_again_and_again_says_little() -> None:
    wire = Wire()
    for _ in range(300):
        wire.send(b"\xff", NINE, pause=5 * MS)
    wire.send(b"", NINE, pause=5 * MS)
    assert verdict_on(wire).certainty == "unsure"


def test_a_silent_line_and_one_that_nothing_fits() -> None:
    assert (found := judge([HeardAt(line) for line in LINES])).certainty == "silent" and found.line is None
    noise = HeardAt(NINE)
    noise.add(bytes(range(100)), tuple(CharacterFault(index, LineFault.FRAMING) for index in range(0, 100, 2)))
    assert (found := judge([noise])).certainty == "nothing fits" and found.line is None


def test_where_damage_is_not_seen_only_text_speaks_for_a_speed() -> None:
    speeds = [HeardAt(LineFormat(speed), sees_damage=False) for speed in (2400, 4800, 9600, 19200)]
    for one in speeds:
        one.add(b"TEMPERATURE=21.5 PRESSURE=3\r\n" if one.line.speed == 9600 else Random(one.line.speed).randbytes(40))
    found = judge(speeds)
    assert (found.certainty, found.line) == ("likely", NINE)
    assert "does not tell damaged characters" in found.text
    silent = [HeardAt(trial.line, sees_damage=False) for trial in speeds if trial.line != NINE]
    assert judge([speeds[2], *silent]).certainty == "unsure", "others heard nothing to compare it with"
    assert judge([HeardAt(NINE, sees_damage=False)]).certainty == "silent"
    poll = HeardAt(NINE, sees_damage=False)
    poll.add(bytes(8))
    assert judge([poll]).certainty == "unsure", "nothing speaks for it, and nothing against it"
    for one in silent:
        one.add(b"TEMPERATURE=21.5 PRESSURE=3\r\n")
    assert judge([speeds[2], *silent]).certainty == "unsure", "a port without bit times hears the same at each speed"


# ---- a trial --------------------------------------------------------------------------------------------------


def trial_result(
    port: UartPort, clock: VirtualClock, lines: list[LineFormat], stop_after: int = 0
) -> tuple[TrialResult, str]:
    ended: list[tuple[TrialResult, str]] = []
    lines_tried: list[str] = []
    trial = LineTrial(
        port, clock, lines, lambda *end: ended.append(end), on_result=lambda one: lines_tried.append(str(one.line))
    )
    trial.start()
    if stop_after:
        clock.run_for(stop_after)
        trial.stop()
    while clock.advance():
        pass
    assert len(ended) == 1 and (stop_after or lines_tried[: len(lines)] == [str(line) for line in lines])
    assert "write" not in port.log and "break" not in port.log, "it only listens"
    return ended[0]


def test_a_trial_finds_the_line_and_closes_the_port() -> None:
    line = parse_format("8E1", 19200)
    clock = VirtualClock()
    port = UartPort(traffic("binary", line, Random(4), 60), clock)
    verdict, why = trial_result(port, clock, LINES)
    assert (verdict.certainty, verdict.line, why) == ("sure", line, "")
    assert port.log == ["open", "close"]
    assert clock.now() < 150 * SECOND


def test_a_speed_that_the_device_cannot_have_is_passed_over() -> None:
    clock = VirtualClock()
    port = UartPort(traffic("text", NINE, Random(5), 60), clock, refused=(115200, 38400))
    verdict, why = trial_result(port, clock, LINES)
    assert (verdict.certainty, verdict.line, why) == ("sure", NINE, "")
    problems = {trial.line.speed for trial in verdict.ranking if trial.problem}
    assert problems == {115200, 38400}


def test_without_the_test_at_twice_the_speed_it_is_not_sure() -> None:
    clock = VirtualClock()
    port = UartPort(traffic("text", NINE, Random(5), 60), clock, refused=(19200,))
    verdict, _ = trial_result(port, clock, [NINE, parse_format("7E1", 9600)])
    assert (verdict.certainty, verdict.line) == ("likely", NINE)


def test_a_trial_that_is_stopped_says_what_it_knows() -> None:
    clock = VirtualClock()
    port = UartPort(traffic("text", NINE, Random(6), 60), clock)
    verdict, why = trial_result(port, clock, LINES, stop_after=1500 * MS)
    assert verdict.line == NINE and verdict.certainty != "sure" and why == ""


def test_a_port_that_is_lost_ends_a_trial() -> None:
    class Lost(UartPort):
        def open(self, events: PortEvents) -> None:
            self.clock.call_soon(lambda: events.closed(self.clock.now(), "the device is gone"))

    clock = VirtualClock()
    ended: list[tuple[TrialResult, str]] = []
    LineTrial(Lost(Wire(), clock), clock, LINES, lambda *end: ended.append(end)).start()
    while clock.advance():
        pass
    assert [(verdict.certainty, why) for verdict, why in ended] == [("silent", "the device is gone")]
