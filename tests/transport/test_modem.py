"""A modem that dials, answers and hangs up, on the simulated line and the virtual clock."""

from __future__ import annotations

import logging
from itertools import pairwise
from typing import Any

import pytest
from transport.line_world import Listener
from transport.scripted_modem import ScriptedModem

from framekit.definition.times import Dialling, LineSettings, Modem, parse_format
from framekit.service.driver import Driver
from framekit.transport.clock import VirtualClock
from framekit.transport.modem import HUNG_UP, ModemPort
from framekit.transport.port import PassingPort, PortEvents
from framekit.transport.simulated_line import SimulatedLine
from framekit.transport.wiring import wired

MS = 1_000_000
SECOND = 1000 * MS
NUMBER = "062211234"


class ModemEnd(PortEvents):
    """The computer's side of the scripted modem."""

    def __init__(self) -> None:
        self.modem: ScriptedModem | None = None

    def received(self, data: bytes, now: int, faults: tuple[object, ...] = ()) -> None:
        assert self.modem is not None
        self.modem.feed(data)


class DtrPort(PassingPort):
    """A port that records the times at which DTR changes."""

    def __init__(self, inner: Any, clock: VirtualClock) -> None:
        super().__init__(inner)
        self.clock = clock
        self.dtr: list[tuple[bool, int]] = []

    def set_dtr(self, on: bool) -> None:
        self.dtr.append((on, self.clock.now()))


class Desk:
    """A port with a modem, and the scripted modem at the other end of its cable."""

    def __init__(self, modem: Modem, *calls: str, **script: Any) -> None:
        self.clock = clock = VirtualClock()
        line = SimulatedLine(clock, parse_format("8N1", 9600))
        self.wire, far = line.port("com"), line.port("modem")
        self.inner = DtrPort(self.wire, clock)
        self.port = wired(self.inner, LineSettings(modem=modem), clock)
        end = ModemEnd()
        self.modem = end.modem = ScriptedModem(
            far.write, lambda delay, call: clock.call_at(clock.now() + delay, call), clock.now, list(calls), **script
        )
        far.open(end)
        self.here = Listener(self.wire)

    def open(self, seconds: float = 10) -> None:
        self.port.open(self.here)
        self.run(seconds)

    def run(self, seconds: float) -> None:
        self.clock.run_for(round(seconds * SECOND))

    @property
    def events(self) -> list[str]:
        return [name for name, _ in self.here.events]


def dialling(**keys: Any) -> Modem:
    own = {key: keys.pop(key) for key in list(keys) if key in Modem.__dataclass_fields__}
    return Modem(answer=None, dialling=Dialling(**{"number": NUMBER, **keys}), **own)


# ---- dialling -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("has_echo", [True, False])
@pytest.mark.parametrize("has_words", [True, False])
def test_a_call_opens_the_port_and_closing_hangs_up(has_echo: bool, has_words: bool) -> None:
    desk = Desk(dialling(init="ATZ;ATX3"), "CONNECT 9600", has_echo=has_echo, has_words=has_words)
    desk.open()
    assert desk.modem.commands == ["ATZ", "ATX3", f"ATDT{NUMBER}"]
    assert (desk.events, desk.here.bytes) == (["opened"], b""), "no result or echo is data"
    desk.port.write(b"\r\nask")
    desk.wire.line.ports[1].write(b"\r\nOK\r\n")
    desk.run(1)
    assert (desk.modem.heard, desk.here.bytes) == (b"\r\nask", b"\r\nOK\r\n"), "data of a connection stays as it is"
    desk.port.close()
    ended: list[int] = []
    desk.port.when_closed(lambda: ended.append(desk.clock.now()))
    desk.port.write(b"too late")
    desk.run(10)
    assert desk.modem.commands[3:] == ["ATH"] and not desk.modem.is_online
    assert desk.modem.heard == b"\r\nask" and len(ended) == 1
    assert desk.events == ["opened", "sent"], "closing reports no event"


@pytest.mark.parametrize(
    ("number", "extension", "command"),
    [
        ("0,62211234", "", "ATDT0,62211234"),
        ("P5551234", "", "ATDP5551234"),
        ("T5551234", "12", "ATDT5551234,12"),
        ("5551234", ",,34#", "ATDT5551234,,,34#"),
    ],
)
def test_the_dial_command(number: str, extension: str, command: str) -> None:
    desk = Desk(dialling(number=number, extension=extension), "CONNECT")
    desk.open()
    assert desk.modem.commands[-1] == command and desk.events == ["opened"]


@pytest.mark.parametrize(
    ("result", "reason"),
    [
        ("BUSY", f"the modem answers BUSY: {NUMBER} is engaged"),
        ("NO CARRIER", f"the modem answers NO CARRIER: no modem at {NUMBER} has taken the call"),
        ("NO ANSWER", f"the modem answers NO ANSWER: the call to {NUMBER} was not taken"),
        (
            "NO DIALTONE",
            "the modem answers NO DIALTONE: the telephone line has no dial tone – check its cable; for a private "
            "exchange add X3 to init",
        ),
        ("ERROR", f"the modem answers ERROR: it refuses ATDT{NUMBER} – check dial and extension"),
    ],
)
@pytest.mark.parametrize("has_words", [True, False])
def test_a_call_without_a_connection_says_why(result: str, reason: str, has_words: bool) -> None:
    desk = Desk(dialling(), result, has_words=has_words)
    desk.open()
    assert desk.events == [f"closed: com: {reason}"]
    rest = desk.port.rests_until - desk.modem.dialled[0]
    assert 12 * SECOND < rest < 12 * SECOND + 50 * MS, "two seconds of the call, ten from its result on"


def test_a_number_that_means_something_else_with_each_modem_is_no_connection() -> None:
    desk = Desk(dialling(), "17", has_words=False)
    desk.open()
    assert desk.events == ["closed: com: the modem answers 17, which each maker uses differently – add ATV1 to init"]
    words = Desk(dialling(), "CARRIER 9600")
    words.open()
    words.modem.say("PROTOCOL: LAP-M")
    words.modem.connect("CONNECT 9600/ARQ")
    words.run(1)
    assert words.events == ["opened"], "other messages before the connection are no results"


def test_a_call_that_takes_too_long_is_cancelled() -> None:
    desk = Desk(dialling(connect_within=30 * SECOND), "")
    desk.open(30)
    assert desk.events == []
    desk.run(2)
    assert desk.events == [f"closed: com: no connection with {NUMBER} within 30 s"]
    assert not desk.modem.is_calling, "the modem has put the line down"


def test_a_call_that_is_connected_while_it_is_cancelled_is_a_connection() -> None:
    desk = Desk(dialling(connect_within=30 * SECOND), "CONNECT 2400", takes=30 * SECOND + MS)
    desk.modem.feed = lambda data: None if data == b"\r" else ScriptedModem.feed(desk.modem, data)  # type: ignore[method-assign]
    desk.open(40)
    assert desk.events == ["opened"]


def test_closing_cancels_a_call() -> None:
    desk = Desk(dialling(), "CONNECT 9600", takes=20 * SECOND)
    desk.open(5)
    desk.port.close()
    ended: list[int] = []
    desk.port.when_closed(lambda: ended.append(1))
    desk.run(40)
    assert ended and not desk.modem.is_online and desk.events == []


def test_opening_while_the_modem_hangs_up_dials_when_it_has_hung_up() -> None:
    desk = Desk(dialling(), "CONNECT", "CONNECT")
    desk.open()
    desk.port.close()
    desk.open()
    assert desk.events == ["opened", "opened"]
    assert desk.modem.commands == ["ATZ", f"ATDT{NUMBER}", "ATH", "ATZ", f"ATDT{NUMBER}"]


# ---- again and again ----------------------------------------------------------------------------------------


class Idle:
    """An engine without commands."""

    deadline = 1 << 62
    good_frames = 0

    def opened(self, now: int) -> list[Any]:
        return []

    def closed(self, now: int, reason: str = "") -> list[Any]:
        return []

    def receive(self, data: bytes, now: int, faults: object = ()) -> list[Any]:
        return []

    def sent(self, now: int) -> list[Any]:
        return []


def driven(desk: Desk, longest_retry: int = 30 * SECOND) -> tuple[Driver, list[str]]:
    states: list[str] = []
    driver = Driver(Idle(), desk.port, desk.clock, states.append)  # type: ignore[arg-type]
    driver.longest_retry = longest_retry
    driver.start()
    return driver, states


def pauses(desk: Desk) -> list[float]:
    times = desk.modem.dialled
    return [round((later - earlier) / SECOND) for earlier, later in pairwise(times)]


def test_engaged_twice_and_then_connected() -> None:
    desk = Desk(dialling(), "BUSY", "BUSY", "CONNECT 9600")
    driver, states = driven(desk)
    desk.run(60)
    busy = f"com: the modem answers BUSY: {NUMBER} is engaged"
    assert states == [busy, busy, "open"] and driver.reopenings == 2
    assert pauses(desk) == [12, 12], "two seconds for the call, ten between two calls"


def test_after_all_retries_no_call_for_a_long_time() -> None:
    desk = Desk(dialling(retries=1, pause=20 * SECOND, rest=600 * SECOND), *["NO ANSWER"] * 4, "CONNECT")
    _, states = driven(desk, longest_retry=SECOND)
    desk.run(1900)
    assert pauses(desk) == [22, 602, 22, 602]
    assert states[1].endswith("; after 2 failed calls framekit waits for 600 s")
    assert not states[0].endswith("600 s") and states[-1] == "open"


def test_a_request_in_a_hurry_makes_no_earlier_call() -> None:
    desk = Desk(dialling(), "BUSY", "CONNECT")
    driver, _ = driven(desk)
    desk.run(4)
    assert driver.hurry()
    desk.run(4)
    assert len(desk.modem.dialled) == 1
    desk.run(10)
    assert driver.is_open


@pytest.mark.parametrize("way", ["while it dials", "while it is connected", "carrier"])
def test_calls_that_the_other_end_of_the_cable_ends_at_once_are_failed_calls(way: str) -> None:
    desk = Desk(dialling(retries=3, pause=10 * SECOND, rest=600 * SECOND), *["CONNECT"] * 20)
    _, states = driven(desk, longest_retry=SECOND)
    for _ in range(4 * 1290):
        desk.run(0.25)
        if {"while it dials": desk.modem.is_calling, "while it is connected": desk.modem.is_online}.get(way):
            desk.modem.is_calling = desk.modem.is_online = False
            desk.wire.pull("the serial server has closed the connection")
        elif desk.modem.is_online:
            desk.modem.lose_carrier()
    short = 10 if way == "while it dials" else 12
    assert pauses(desk)[:8] == [short, short, short, short + 590] * 2
    waits = "; after 4 failed calls framekit waits for 600 s"
    assert [waits in state for state in states if state != "open"][:8] == [False, False, False, True] * 2


def test_a_connection_that_lasts_begins_a_new_count_of_failed_calls() -> None:
    desk = Desk(dialling(retries=1), "CONNECT", "BUSY", "CONNECT", "BUSY", "CONNECT")
    _, states = driven(desk)
    for _ in range(2):
        desk.run(60)
        desk.modem.is_online = False
        desk.wire.pull("pulled")
        desk.run(20)
    desk.run(10)
    assert states == ["open", "pulled", f"com: the modem answers BUSY: {NUMBER} is engaged"] * 2 + ["open"]
    assert all(gap <= 72 for gap in pauses(desk))


@pytest.mark.parametrize("way", ["words", "in pieces", "after data", "dcd"])
def test_a_lost_carrier_is_dialled_again(way: str) -> None:
    desk = Desk(dialling(), "CONNECT", "CONNECT")
    _, states = driven(desk)
    desk.run(10)
    desk.modem.is_online = False
    if way == "words":
        desk.modem.say("NO CARRIER")
    elif way == "dcd":
        desk.wire.signal({"dcd": False})
    else:
        for piece in (b"\r\nNO CA", b"RRIER\r\n") if way == "in pieces" else (b"reply\r\nNO CARRIER\r\n",):
            desk.modem.write(piece)
            desk.run(0.1)
    desk.run(2)
    assert states == ["open", f"com: the connection with {NUMBER} is lost"]
    desk.run(20)
    assert states[2:] == ["open"] and "ATH" not in desk.modem.commands, "a lost call needs no hanging up"


def test_the_words_inside_of_data_end_no_connection() -> None:
    desk = Desk(dialling(), "CONNECT")
    _, states = driven(desk)
    desk.run(10)
    desk.modem.write(b"log: NO CARRIER\r\n")
    desk.run(5)
    desk.modem.write(b"\r\nNO CARRIER\r\nand more of it, ")
    desk.run(5)
    desk.modem.write(b"end\r\nNO CARRIER\r\n")
    desk.run(0.5)
    desk.modem.write(b"goes on")
    desk.run(5)
    assert states == ["open"]


@pytest.mark.parametrize("reports_junk", [True, False])
@pytest.mark.parametrize("request_", [b"\x01\x03\x00\x00\x00\x01\x84\x0a", b"read 1\r"])
def test_requests_do_not_hide_a_lost_carrier_where_the_modem_echoes(request_: bytes, reports_junk: bool) -> None:
    desk = Desk(dialling(), "CONNECT", "CONNECT", reports_junk=reports_junk)
    _, states = driven(desk)
    desk.run(10)
    desk.port.write(request_)
    desk.run(0.5)
    desk.modem.is_online = False
    desk.modem.write(b"x~}\r\nNO CARRIER\r\n")
    for _ in range(10):
        desk.run(0.3)
        desk.port.write(request_)
    assert states == ["open", f"com: the connection with {NUMBER} is lost"]
    desk.run(20)
    assert states[2:] == ["open"]


def test_an_echo_in_the_same_piece_as_the_message() -> None:
    desk = Desk(dialling(), "CONNECT", "CONNECT")
    _, states = driven(desk)
    desk.run(10)
    desk.port.write(b"request")
    desk.run(0.2)
    desk.modem.is_online = False
    desk.modem.write(b"\r\nNO CARRIER\r\nquest")
    desk.run(2)
    assert len(states) == 2


def test_other_data_after_the_words_is_data() -> None:
    desk = Desk(dialling(), "CONNECT")
    _, states = driven(desk)
    desk.run(10)
    desk.port.write(b"show the log\r")
    desk.modem.write(b"log:\r\nNO CARRIER\r\nshow the lot")
    desk.run(100)
    assert states == ["open"]


# ---- hanging up ---------------------------------------------------------------------------------------------


def test_the_escape_sequence_waits_for_the_last_byte() -> None:
    desk = Desk(dialling(), "CONNECT")
    desk.open()
    desk.port.write(bytes(4800))
    desk.port.close()
    desk.run(20)
    assert len(desk.modem.heard) == 4800 and desk.modem.commands[-1] == "ATH"


def test_dtr_hangs_up() -> None:
    desk = Desk(dialling(hang_up="dtr"), "CONNECT")
    desk.open()
    begun = desk.clock.now()
    desk.port.close()
    ended: list[int] = []
    desk.port.when_closed(lambda: ended.append(desk.clock.now()))
    desk.run(5)
    assert desk.inner.dtr == [(False, begun)] and ended == [begun + SECOND]
    assert desk.modem.commands[-1] == f"ATDT{NUMBER}"


def test_a_modem_that_does_not_confirm_is_reported(caplog: pytest.LogCaptureFixture) -> None:
    desk = Desk(dialling(), "CONNECT")
    desk.open()
    desk.modem.is_deaf = True
    desk.port.close()
    ended: list[int] = []
    desk.port.when_closed(lambda: ended.append(1))
    with caplog.at_level(logging.WARNING):
        desk.run(20)
    assert ended and caplog.messages == [
        "com: the modem does not confirm that it has hung up: it may still hold the line"
    ]


def test_a_call_that_the_other_side_ends_while_the_modem_hangs_up(caplog: pytest.LogCaptureFixture) -> None:
    desk = Desk(dialling(), "CONNECT")
    desk.open()
    desk.port.close()
    desk.run(0.5)
    desk.modem.lose_carrier()
    ended: list[int] = []
    desk.port.when_closed(lambda: ended.append(1))
    desk.run(1)
    assert ended and not caplog.messages


def test_a_cable_that_is_pulled_out_while_the_modem_hangs_up() -> None:
    desk = Desk(dialling(), "CONNECT")
    desk.open()
    desk.port.close()
    ended: list[int] = []
    desk.port.when_closed(lambda: ended.append(1))
    desk.wire.pull()
    desk.run(1)
    assert ended == [1] and desk.events == ["opened"]


def test_an_unknown_number_after_dialling_may_be_a_connection_and_is_hung_up() -> None:
    desk = Desk(dialling(retries=0, rest=100 * SECOND), "12", has_words=False, unknown_connections=("12",))
    _, states = driven(desk)
    desk.run(50)
    assert desk.modem.commands == ["ATZ", f"ATDT{NUMBER}", "ATH"] and not desk.modem.is_online
    why = "the modem answers 12, which each maker uses differently – add ATV1 to init"
    assert states == [f"com: {why}; after the failed call framekit waits for 100 s"]
    assert desk.port.rests_until > desk.modem.dialled[0] + 104 * SECOND, "the rest begins when the modem has hung up"


def test_closing_while_an_unclear_call_is_hung_up_reports_no_event() -> None:
    desk = Desk(dialling(), "12", has_words=False, unknown_connections=("12",))
    desk.open(2.5)
    desk.port.close()
    ended: list[int] = []
    desk.port.when_closed(lambda: ended.append(1))
    assert ended == []
    desk.run(20)
    assert ended == [1] and desk.events == [] and desk.modem.commands[-1] == "ATH"


def test_a_cable_that_is_pulled_out_while_an_unclear_call_is_hung_up() -> None:
    desk = Desk(dialling(), "12", has_words=False, unknown_connections=("12",))
    desk.open(2.5)
    desk.wire.pull("pulled")
    desk.run(1)
    assert desk.events == ["closed: com: the modem answers 12, which each maker uses differently – add ATV1 to init"]


def test_a_call_whose_cancelling_has_no_reply_is_hung_up() -> None:
    desk = Desk(dialling(connect_within=30 * SECOND), "")
    desk.open(29)
    desk.modem.is_calling, desk.modem.is_online = False, True
    desk.run(30)
    assert desk.modem.commands[-1] == "ATH" and not desk.modem.is_online
    assert desk.events == [f"closed: com: no connection with {NUMBER} within 30 s"]


def test_closing_hangs_up_when_cancelling_the_call_has_no_reply() -> None:
    desk = Desk(dialling(), "")
    desk.open(5)
    desk.modem.is_calling, desk.modem.is_online = False, True
    desk.port.close()
    desk.run(30)
    assert desk.modem.commands[-1] == "ATH" and not desk.modem.is_online


@pytest.mark.parametrize("has_words", [True, False])
def test_data_that_still_comes_does_not_hide_the_reply_to_the_escape_sequence(has_words: bool) -> None:
    desk = Desk(dialling(), "CONNECT", has_words=has_words)
    desk.open()
    desk.port.close()
    desk.run(1.5)
    desk.modem.write(b"\x01\x03tail")
    desk.run(30)
    assert desk.modem.commands[-1] == "ATH" and not desk.modem.is_online


def test_a_modem_in_command_mode_is_hung_up_too(caplog: pytest.LogCaptureFixture) -> None:
    desk = Desk(dialling(), "CONNECT", has_words=False)
    desk.open()
    desk.modem.lose_carrier()
    desk.run(10)
    assert desk.events == ["opened"], "a number among data is data"
    desk.port.close()
    desk.run(30)
    assert desk.modem.commands[-1] == "ATH" and not caplog.messages


@pytest.mark.parametrize("has_words", [True, False])
@pytest.mark.parametrize("modem", [dialling(), Modem(answer=1)])
def test_a_modem_that_is_still_connected_at_the_start_is_hung_up_first(modem: Modem, has_words: bool) -> None:
    desk = Desk(modem, "CONNECT", has_words=has_words)
    desk.modem.is_online = True
    desk.open(60)
    assert desk.modem.commands[:2] == ["ATH", "ATZ"] and "ATH" not in desk.modem.commands[2:]
    assert desk.events == ([] if modem.dialling is None else ["opened"])


def test_dtr_ends_a_connection_of_an_earlier_run() -> None:
    desk = Desk(dialling(hang_up="dtr"), "CONNECT")
    desk.modem.is_online = True
    desk.run(0.1)
    desk.port.open(desk.here)
    desk.run(15.5)
    assert desk.inner.dtr, "three commands without a reply"
    desk.modem.is_online = False
    desk.run(20)
    assert desk.events == ["opened"] and [on for on, _ in desk.inner.dtr] == [False]


# ---- answering, dedicated lines -----------------------------------------------------------------------------


def test_a_modem_answers_and_the_port_is_open_until_the_caller_hangs_up() -> None:
    desk = Desk(Modem(init="ATZ;ATE0", answer=2))
    desk.open()
    assert desk.modem.commands == ["ATZ", "ATE0"] and desk.events == []
    desk.port.write(b"no caller yet")
    desk.modem.say("RING")
    desk.run(1)
    assert desk.modem.commands == ["ATZ", "ATE0"], "it waits for the second ring"
    desk.modem.say("RING")
    desk.run(1)
    assert desk.modem.commands == ["ATZ", "ATE0", "ATA"] and desk.events == ["opened"]
    desk.wire.line.ports[1].write(b"hello")
    desk.port.write(b"there")
    desk.run(1)
    assert (desk.here.bytes, desk.modem.heard) == (b"hello", b"there")
    desk.modem.lose_carrier()
    desk.run(1)
    assert desk.events == ["opened", "sent", f"closed: com: {HUNG_UP}"]


def test_an_answered_call_is_hung_up_by_closing() -> None:
    desk = Desk(Modem(answer=1))
    desk.open()
    desk.modem.say("RING")
    desk.run(1)
    desk.port.close()
    desk.run(10)
    assert desk.modem.commands == ["ATZ", "ATA", "ATH"]


def test_an_answer_without_a_result_is_cancelled_and_the_next_call_is_answered(
    caplog: pytest.LogCaptureFixture,
) -> None:
    desk = Desk(Modem(answer=2), answers_calls=False)
    desk.open()
    for _ in range(2):
        desk.modem.say("RING")
        desk.run(5)
    desk.run(70)
    assert not desk.modem.is_calling
    assert caplog.messages == ["com: no connection within 60 s after ATA"]
    desk.modem.answers_calls = True
    for _ in range(2):
        assert desk.events == []
        desk.modem.say("RING")
        desk.run(5)
    assert desk.modem.commands == ["ATZ", "ATA", "ATA"] and desk.events == ["opened"]


def test_a_modem_that_confirms_no_cancelled_answer_is_hung_up_and_set_up_again() -> None:
    desk = Desk(Modem(answer=1), answers_calls=False)
    desk.open()
    desk.modem.say("RING")
    desk.run(5)
    desk.modem.is_calling, desk.modem.is_online, desk.modem.answers_calls = False, True, True
    desk.run(90)
    assert desk.modem.commands == ["ATZ", "ATA", "ATH", "ATZ"] and desk.events == []
    desk.modem.say("RING")
    desk.run(5)
    assert desk.events == ["opened"]


def test_rings_go_on_after_an_answer_that_the_modem_has_not_understood() -> None:
    desk = Desk(Modem(answer=1), answers_calls=False)
    desk.open()
    desk.modem.say("RING")
    desk.run(0.5)
    desk.modem.say("RING")
    desk.run(5)
    assert desk.modem.commands == ["ATZ", "ATA"], "a ring at the same time as the answer"
    desk.modem.is_calling, desk.modem.answers_calls = False, True
    desk.modem.say("RING")
    desk.run(5)
    assert desk.modem.commands == ["ATZ", "ATA", "ATA"] and desk.events == ["opened"]


def test_rings_of_two_calls_are_not_added() -> None:
    desk = Desk(Modem(answer=2))
    desk.open()
    for _ in range(3):
        desk.modem.say("RING")
        desk.run(60)
    assert desk.modem.commands == ["ATZ"]


def test_an_unknown_number_after_an_answer_is_hung_up(caplog: pytest.LogCaptureFixture) -> None:
    desk = Desk(Modem(answer=1), has_words=False, answers_calls=False)
    desk.open()
    desk.modem.say("RING")
    desk.run(2)
    desk.modem.is_calling = False
    desk.modem.connect("12")
    desk.run(20)
    assert desk.modem.commands == ["ATZ", "ATA", "ATH", "ATZ"] and not desk.modem.is_online
    assert caplog.messages == ["com: the modem answers 12, which each maker uses differently – add ATV1 to init"]


def test_a_dedicated_line_is_open_once_the_modem_is_set_up() -> None:
    desk = Desk(Modem(init="ATZ", answer=None))
    desk.open()
    assert desk.modem.commands == ["ATZ"] and desk.events == ["opened"]
    desk.modem.write(b"NO CARRIER")
    desk.run(1)
    assert desk.here.bytes == b"NO CARRIER", "data of the line"
    desk.port.close()
    desk.run(10)
    assert desk.modem.commands == ["ATZ"], "no call to end"


@pytest.mark.parametrize("modem", [Modem(), dialling()])
@pytest.mark.parametrize(
    ("script", "reason"),
    [({"is_deaf": True}, "the modem does not answer"), ({"refused": ("ATZ",)}, "the modem refuses 'ATZ'")],
)
def test_a_modem_that_cannot_be_set_up(modem: Modem, script: dict[str, Any], reason: str) -> None:
    desk = Desk(modem, **script)
    desk.open(40)
    assert desk.events == [f"closed: com: {reason}"]
    assert isinstance(desk.port, ModemPort) and desk.modem.dialled == []
