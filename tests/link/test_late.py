"""Late replies at the engine: which requests are held back, for how long, and which events release them earlier."""

from __future__ import annotations

from typing import Any

import pytest
from service.late_world import MS, REGISTERS, SECOND

from framekit.codec.codec import compile_protocol
from framekit.definition.load.protocol import load_protocol, load_protocol_text
from framekit.definition.model.protocol import Protocol
from framekit.definition.problems import DefinitionError
from framekit.definition.times import parse_format
from framekit.link.engine import Engine
from framekit.link.events import Break, Command, Exchange, Seen, Send
from framekit.link.services.client import ServiceClient, TransferResult
from framekit.link.services.server import MemoryServer
from framekit.link.values import FrameValue
from framekit.memory.memory import DeviceMemory
from framekit.runfile.devices import memory_of

LINE = parse_format("8N1", 19200)


class Side:
    """A client whose frames are transmitted at once.

    `sent` are its transmissions, `replies` the device's reply to each.
    """

    def __init__(self, text: str = REGISTERS, role: str = "client", **params: Any) -> None:
        protocol = load_protocol_text(text, "made_up") if "\n" in text else load_protocol(text)
        codec = compile_protocol(protocol)
        line = None if protocol.line.kind == "stream" else LINE
        self.seen: list[Seen] = []
        self.unasked: list[FrameValue] = []
        self.engine = Engine(
            protocol, codec, role, params=params, line=line, own=1, monitor=self.seen.append,
            on_frame=self.unasked.append,
        )  # fmt: skip
        self.client = ServiceClient(protocol, codec, self.engine)
        self.device, self.memory = device_of(protocol)
        self.sent: list[bytes] = []
        self.replies: list[bytes] = []
        self.results: list[TransferResult] = []
        self.now = 0
        self.do(self.engine.opened(0))

    def do(self, commands: list[Command]) -> None:
        for command in commands:
            if isinstance(command, Send | Break):
                if isinstance(command, Send):
                    self.sent.append(command.data)
                    self.replies.append(b"".join(
                        sent.data for sent in self.device.receive(command.data, self.now) if isinstance(sent, Send)
                    ))  # fmt: skip
                    self.device.sent(self.now)
                self.do(self.engine.sent(self.now))

    def read(self, address: str, value: int = 0) -> None:
        """Request a place whose value is now `value`."""
        place = self.client.grammar.parse(address)
        self.memory.write(place.area, place.unit, place.start, [value])
        self.do(self.client.read(address, station=3, now=self.now, on_done=self.results.append).commands)
        self.until(self.now)

    def until(self, time: int) -> None:
        """Run all timers up to this time."""
        while self.engine.deadline <= time:
            self.now = max(self.now, self.engine.deadline)
            self.do(self.engine.tick(self.now))
        self.now = time

    def come(self, data: bytes) -> None:
        self.do(self.engine.receive(data, self.now))

    def reply(self, number: int) -> None:
        """Deliver the device's reply to the transmission of this number."""
        self.come(self.replies[number])

    @property
    def values(self) -> list[Any]:
        return [list(result.values) if result.ok else result.outcome for result in self.results]

    @property
    def late(self) -> int:
        return self.engine.counters.late


def device_of(protocol: Protocol) -> tuple[Engine, DeviceMemory]:
    codec = compile_protocol(protocol)
    memory = DeviceMemory(memory_of(protocol)[0])
    role = "server" if "server" in protocol.roles else None
    device = Engine(protocol, codec, role, own=3, server=MemoryServer(protocol, codec, memory), params={})
    device.opened(0)
    return device, memory


BARE = "\n".join(
    "  reply: {from: server, head: [{const: STX}, {field: code, type: u8}]}" if line.startswith("  reply:") else line
    for line in REGISTERS.split("\n")
)
"""Replies of this protocol have no check code and repeat no field of the request, so noise can look like them."""


@pytest.mark.parametrize(("noise", "late", "sent"), [(b"", 1, 1600 * MS), (b"\x55", 0, 2000 * MS)])
def test_bytes_that_look_like_a_reply_are_no_sign_of_it_on_a_noisy_line(noise: bytes, late: int, sent: int) -> None:
    side = Side(BARE, retries=0)
    side.read("R1", 11)
    side.until(1100 * MS)
    side.read("R2", 22)
    side.come(noise)
    side.until(1600 * MS)
    side.reply(0)
    assert side.late == late and len(side.sent) == 1 + (sent == side.now)
    side.until(sent)
    assert len(side.sent) == 2, "and the hold is no longer for it"


def test_the_second_reply_to_a_repeated_request_is_waited_for() -> None:
    side = Side()
    side.read("R1", 11)
    side.until(1200 * MS)
    assert len(side.sent) == 2, "asked again after a second"
    side.reply(0)
    side.read("R2", 22)
    assert side.values == [[11]] and len(side.sent) == 2, "the second reply is due: nothing else goes out"
    side.until(1900 * MS)
    side.reply(1)
    assert len(side.sent) == 3, "it came: the next request goes out at once"
    side.reply(2)
    assert side.values == [[11], [22]]
    assert side.late == 1 and side.unasked == [], "counted, and offered to nobody"
    (shown,) = [event for event in side.seen if event.kind == "not_taken"]
    assert shown.frame == "values" and shown.reason.startswith("late")


@pytest.mark.parametrize(("params", "free"), [({}, 2000), ({"late_reply": 300 * MS}, 1300)])
def test_without_a_repeat_the_hold_is_over_in_time(params: dict[str, Any], free: int) -> None:
    side = Side(retries=0, **params)
    side.read("R1", 11)
    side.read("R2", 22)
    side.until((free - 1) * MS)
    assert len(side.sent) == 1
    side.until(free * MS)
    assert side.values == ["no_reply"] and len(side.sent) == 2
    side.reply(1)
    assert side.values == ["no_reply"], "that may be the reply to the first request, later still"
    side.until((free + 125) * MS)
    assert len(side.sent) == 3 and side.sent[1] == side.sent[2], "an eighth of the time limit was silent: once more"
    side.reply(2)
    assert side.values == ["no_reply", [22]] and side.late == 0


def test_where_no_reply_is_late_the_next_request_goes_out_at_once_and_its_reply_is_stored() -> None:
    side = Side(retries=0, late_reply=0)
    side.read("R1", 11)
    side.read("R2", 22)
    side.until(SECOND)
    assert side.values == ["no_reply"] and len(side.sent) == 2
    side.reply(1)
    assert side.values == ["no_reply", [22]] and side.late == 0


def test_a_late_reply_gives_the_others_as_long_again() -> None:
    side = Side(retries=1)
    side.read("R1", 11)
    side.read("R2", 22)
    side.until(2900 * MS)
    assert side.values == ["no_reply"] and len(side.sent) == 2
    side.reply(0)
    side.until(6524 * MS)
    assert len(side.sent) == 2, "one of two took 2.9 s: the other is given as long and a quarter more"
    side.until(6525 * MS)
    assert len(side.sent) == 3 and side.late == 1


def test_a_damaged_reply_may_be_none() -> None:
    """A bad frame of another station does not count as the reply, which may still arrive."""
    side = Side()
    side.read("R1", 0)
    side.come(side.replies[0][:1] + b"\x09" + side.replies[0][2:-1] + b"\0")
    assert len(side.sent) == 2 and side.engine.counters.bad == 1 and len(side.engine.late.open) == 1


def test_a_reply_with_a_wrong_check_code_is_the_reply() -> None:
    """In step, a frame that differs from the reply by its check code only closes the request."""
    side = Side()
    side.read("R1", 0)
    side.come(side.replies[0][:-1] + b"\0")
    assert len(side.sent) == 2 and side.engine.counters.bad == 1 and not side.engine.late.open


def test_a_reply_with_a_wrong_check_code_out_of_step_closes_nothing() -> None:
    side = Side()
    side.read("R1", 0)
    side.until(1100 * MS)
    side.come(side.replies[0][:-1] + b"\0")
    assert len(side.sent) == 3 and side.engine.counters.bad == 1 and len(side.engine.late.open) == 2


def test_a_damaged_reply_is_the_cause_of_a_failure_although_good_replies_in_doubt_came_too() -> None:
    side = Side(retries=1)
    side.read("R1", 11)
    side.until(10 * SECOND)
    side.read("R2", 22)
    side.come(side.replies[-1][:-1] + b"\0")
    side.reply(-1)
    side.until(60 * SECOND)
    (failed,) = side.results[1:]
    assert failed.outcome == "damaged_reply"
    assert failed.cause.startswith("a reply arrived, with a wrong check code (expected ")


def test_an_unexpected_reply_when_nothing_is_under_way_is_a_sign() -> None:
    side = Side()
    side.read("R1", 11)
    side.reply(0)
    side.until(5 * SECOND)
    side.reply(0)
    side.read("R2", 22)
    side.until(5999 * MS)
    assert len(side.sent) == 1
    side.until(6 * SECOND)
    assert len(side.sent) == 2 and side.engine.counters.not_taken == 1


def test_a_reply_of_another_station_is_a_sign() -> None:
    side = Side()
    side.read("R1", 11)
    other = FrameValue("values", {"station": 4, "code": 1, "data": bytes(2)})
    side.come(side.engine.table.encode(other, side.engine.scope))
    side.reply(0)
    side.read("R2", 22)
    assert side.values == [[11]] and len(side.sent) == 1
    side.until(2 * SECOND - 1)
    assert len(side.sent) == 1, "and what was taken may have been the late one"
    side.until(2 * SECOND)
    assert len(side.sent) == 2


def test_replies_that_nobody_asked_for_come_without_end_and_the_exchange_fails() -> None:
    side = Side()
    side.read("R1", 11)
    side.reply(0)
    foreign = side.replies[0]
    side.come(foreign)
    side.read("R2", 22)
    for tenth in range(1, 150):
        side.until(tenth * SECOND // 10)
        side.come(foreign)
    assert side.values == [[11], "late_replies"] and len(side.sent) == 1
    side.read("R3", 33)
    side.until(16 * SECOND)
    side.reply(1)
    assert side.values[2:] == [[33]]


def test_what_the_line_kept_and_lets_go_with_the_next_reply_is_not_taken() -> None:
    """Two replies to one request: either may be the late reply, so the request is repeated."""
    side = Side(retries=0)
    side.read("R1", 11)
    side.until(3 * SECOND)
    side.read("R2", 22)
    side.come(side.replies[0] + side.replies[1])
    assert side.values == ["no_reply"] and side.late == 1 and len(side.sent) == 2
    side.until(3 * SECOND + 125 * MS)
    side.reply(2)
    assert side.values == ["no_reply", [22]]


def test_both_replies_in_one_piece() -> None:
    side = Side()
    side.read("R1", 11)
    side.read("R2", 22)
    side.until(1100 * MS)
    side.come(side.replies[0] + side.replies[1])
    assert side.values == [[11]] and len(side.sent) == 3 and side.late == 1


ONE_PLACE = ("R1", "R2", REGISTERS), ("40001", "40002", "modbus-rtu")


@pytest.mark.parametrize(("first", "second", "protocol"), ONE_PLACE)
def test_a_request_cannot_have_two_replies(first: str, second: str, protocol: str) -> None:
    """The first reply in the piece belongs to an unknown request.

    The request is repeated until two replies are equal.
    """
    side = Side(protocol)
    other = Side(protocol)
    other.read(first, 11)
    side.read(second, 22)
    side.come(other.replies[0] + side.replies[0])
    assert side.values == []
    for number, silence in ((1, 1100), (2, 100)):
        side.until(side.now + silence * MS)
        assert len(side.sent) == number + 1 and side.values == []
        side.reply(number)
    assert side.values == [[22]]


@pytest.mark.parametrize(("lost", "equal"), [(1, 2), (2, 3)])
def test_short_silences_prove_a_reply_that_comes_more_often_than_open_requests_can_bring_it(
    lost: int, equal: int
) -> None:
    side = Side("modbus-rtu", retries=0)
    for address in ("40001", "40002")[:lost]:
        side.read(address, 11)
        side.until(side.now + 3 * SECOND)
    side.read("40003", 22)
    begin = side.now
    for _ in range(equal - 1):
        side.until(side.now + 10 * MS)
        side.reply(-1)
        assert side.values == ["no_reply"] * lost
        side.until(side.now + 20 * MS)
    side.reply(-1)
    assert side.values == [*["no_reply"] * lost, [22]] and len(side.sent) == lost + equal
    assert side.now - begin < 125 * MS


def test_a_value_that_changes_is_not_proved_by_short_silences() -> None:
    side = Side("modbus-rtu", retries=0)
    side.read("40001", 11)
    side.until(3 * SECOND)
    side.read("40002", 22)
    side.reply(0)
    side.until(side.now + 100 * MS)
    side.reply(1)
    side.until(side.now + 100 * MS)
    assert len(side.sent) == 3 and side.values == ["no_reply"]
    side.until(side.now + 100 * MS)
    side.reply(1)
    assert side.values == ["no_reply", [22]]


def test_a_reply_that_later_replies_have_passed_makes_no_hold_longer() -> None:
    """The first reply is lost. 20 s later another one is 0.5 s late: the next hold is for that, not for 20 s."""
    side = Side("modbus-rtu", retries=0)
    side.read("40001", 11)
    side.until(3 * SECOND)
    for _ in range(2):
        side.read("40002", 22)
        while side.values[-1] == "no_reply" or len(side.values) < 2:
            side.reply(-1)
            side.until(side.now + 200 * MS)
        side.results.pop()
    side.until(20 * SECOND)
    side.read("40003", 33)
    side.until(side.now + 1500 * MS)
    side.reply(-1)
    side.read("40003", 33)
    side.until(side.now + 1100 * MS)
    begin = side.now
    assert side.engine.held_until - begin < 3 * SECOND


@pytest.mark.parametrize("more", [b"\0", b"\x03\x03", "begun", "damaged"])
def test_noise_and_what_is_no_frame_after_a_reply_make_no_doubt(more: Any) -> None:
    side = Side("modbus-rtu")
    side.read("40001", 11)
    whole = side.replies[0]
    parts = {"begun": whole[:-1], "damaged": whole[:-1] + bytes([whole[-1] ^ 1])}
    side.come(whole + parts.get(more, more))
    assert side.values == [[11]] and len(side.sent) == 1


def test_a_repeated_request_explains_an_equal_reply_and_no_other() -> None:
    for second, stored in ((11, [[11]]), (12, [])):
        side, other = Side("modbus-rtu", retries=1), Side("modbus-rtu")
        other.read("40001", second)
        side.read("40001", 11)
        side.until(1100 * MS)
        assert len(side.sent) == 2
        side.come(side.replies[0] + other.replies[0])
        assert side.values == stored


def test_a_request_is_open_until_a_later_reply_is_proved_however_long_that_takes() -> None:
    side = Side("modbus-rtu", retries=0)
    side.read("40001", 11)
    side.until(30 * SECOND)
    side.read("40002", 22)
    side.reply(0)
    assert side.values == ["no_reply"]
    side.until(side.now + 10 * MS)
    side.reply(1)
    for number in range(2, 5):
        side.until(side.now + SECOND)
        if len(side.sent) > number:
            side.reply(number)
    assert side.values == ["no_reply", [22]]
    sent = len(side.sent)
    side.until(side.now + 30 * SECOND)
    side.read("40001", 33)
    side.reply(sent)
    assert side.values[-1] == [33] and len(side.sent) == sent + 1


@pytest.mark.parametrize("when", [500 * MS, SECOND])
def test_a_late_reply_may_come_after_the_port_was_lost_and_opened_again(when: int) -> None:
    """A gateway forwards its serial line to whichever connection is open then."""
    side = Side(retries=0)
    side.read("R1", 11)
    side.until(when)
    side.do(side.engine.closed(side.now))
    side.do(side.engine.opened(side.now))
    side.read("R2", 22)
    assert len(side.sent) == 1, "the reply to the request before is due"
    side.until(when + 300 * MS)
    side.reply(0)
    assert side.late == 1 and len(side.sent) == 2
    side.reply(1)
    assert side.values[1:] == [[22]] and side.values[0] in ("closed", "no_reply")


def test_no_reply_to_a_request_of_an_earlier_connection_comes_on_a_stream() -> None:
    serial = "line: {speed: {default: 19200}, format: {default: 8N1}}"
    side = Side(REGISTERS.replace(serial, "line: {kind: stream}"), retries=0)
    side.read("R1", 11)
    side.until(SECOND)
    side.do(side.engine.closed(side.now))
    side.do(side.engine.opened(side.now))
    side.read("R2", 22)
    assert len(side.sent) == 2


def test_a_cancelled_exchange_leaves_its_reply_due() -> None:
    side = Side()
    exchanges: list[Exchange] = []
    start = side.engine.start
    side.engine.start = lambda exchange, now: (exchanges.append(exchange), start(exchange, now))[1]  # type: ignore[method-assign]
    side.read("R1", 11)
    side.do(side.engine.cancel(exchanges[0], side.now))
    side.read("R2", 22)
    assert side.values == ["cancelled"] and len(side.sent) == 1
    side.reply(0)
    assert len(side.sent) == 2 and side.late == 1
    side.do(side.engine.cancel(exchanges[1], side.now))
    side.read("R3", 33)
    side.do(side.engine.give_up(exchanges[2], side.now))
    assert side.values == ["cancelled"] * 3 and len(side.sent) == 2, "one that is held back has asked for nothing"


def test_frames_by_themselves_wait_too() -> None:
    side = Side(retries=0)
    side.read("R1", 11)
    side.until(SECOND)
    fields = {"station": 3, "address": 5, "count": 1}
    side.do(side.engine.send_frame("read", side.now, fields))
    assert len(side.sent) == 1
    assert [event.frame for event in side.seen if event.kind == "frame" and event.direction == "out"] == ["read"], (
        "not yet"
    )
    side.until(1500 * MS)
    side.reply(0)
    assert len(side.sent) == 2
    assert [event.at for event in side.seen if event.kind == "frame" and event.direction == "out"] == [0, 1500 * MS]


ASKED = {"station": 3, "address": 5, "count": 1}


def test_the_reply_to_a_frame_by_itself_is_no_reply_to_the_next_request() -> None:
    """SEND of a service's request, and READ right after it: the values of one are not returned for the other."""
    side = Side()
    side.do(side.engine.send_frame("read", side.now, ASKED))
    side.read("R1", 11)
    assert len(side.sent) == 1, "the reply to what was sent is due"
    side.until(500 * MS)
    side.reply(0)
    assert [event.frame for event in side.unasked] == ["values"] and side.late == 0, "it came, and for who wants it"
    assert len(side.sent) == 2
    side.reply(1)
    assert side.values == [[11]]


@pytest.mark.parametrize("name", ["modbus-rtu", "modbus-ascii"])
def test_the_reply_to_a_frame_by_itself_that_carries_a_request_is_none_to_the_next_one(name: str) -> None:
    """Services of these protocols ask by an inner frame; a broadcast request gets no reply."""
    side = Side(name)
    side.memory.write("holding", "word", 5, [99])
    request = {"read_holding": {"address": 5, "count": 1}}
    side.do(side.engine.send_frame("request_adu", side.now, {"station": 3, "pdu": request}))
    side.read("40001", 11)
    assert len(side.sent) == 1, "the reply to what was sent is due"
    side.until(500 * MS)
    side.reply(0)
    assert [event.frame for event in side.unasked] == ["reply_adu"] and side.values == []
    side.until(501 * MS)
    side.reply(1)
    assert side.values == [[11]]
    side.do(side.engine.send_frame("request_adu", side.now, {"station": 0, "pdu": request}))
    side.read("40001", 12)
    side.until(502 * MS)
    assert len(side.sent) == 4


EVERYONE = """
sequences:
  exchange:
    takes: [request]
    gives: {reply: answer}
    local: {answer: frame}
    steps:
      - step: everyone
        when: station == 0
        send: request
        then: pause
      - step: ask
        send: request
        receive: [{frame: expected, set: {answer: it}, then: end}]
        within: reply_timeout
        on_timeout: {fail: no_reply}
      - step: pause
        wait: 100 ms
        then: end
"""


@pytest.mark.parametrize(("text", "station", "sent"), [(EVERYONE, 0, 3), (EVERYONE, 3, 1), ("", 0, 1)])
def test_no_reply_is_due_to_a_frame_by_itself_that_is_for_everyone(text: str, station: int, sent: int) -> None:
    """The exchange of the definition gives the broadcast station: after sending to it, no reply is awaited."""
    side = Side(REGISTERS + text)
    for address in range(2):
        side.do(side.engine.send_frame("read", side.now, ASKED | {"station": station, "address": address}))
    side.read("R1", 11)
    assert len(side.sent) == sent
    if sent == 3:
        side.reply(2)
        assert side.values == [[11]]


def test_frames_by_themselves_go_out_one_after_the_other() -> None:
    side = Side()
    for address in range(3):
        side.do(side.engine.send_frame("read", side.now, ASKED | {"address": address}))
    for number in range(3):
        assert len(side.sent) == number + 1
        side.until(side.now + 10 * MS)
        side.reply(number)
    assert len(side.unasked) == 3


@pytest.mark.parametrize(("params", "free"), [({}, 2000), ({"late_reply": 300 * MS}, 1300)])
def test_a_frame_by_itself_that_gets_no_reply_holds_the_line_as_long_as_a_request(params: Any, free: int) -> None:
    side = Side(**params)
    side.do(side.engine.send_frame("read", side.now, ASKED))
    side.read("R1", 11)
    side.until((free - 1) * MS)
    assert len(side.sent) == 1
    side.until(free * MS)
    assert len(side.sent) == 2
    side.reply(1)
    side.until((free + 125) * MS)
    side.reply(2)
    assert side.values == [[11]]


def test_a_frame_by_itself_that_asks_waits_for_the_reply_under_way() -> None:
    side = Side(retries=0)
    side.read("R1", 11)
    side.do(side.engine.send_frame("read", side.now, ASKED))
    assert len(side.sent) == 1
    side.until(500 * MS)
    side.reply(0)
    assert side.values == [[11]]
    side.until(5 * SECOND)
    assert len(side.sent) == 2


def test_where_no_reply_is_late_frames_by_themselves_hold_nothing() -> None:
    side = Side(late_reply=0)
    for _ in range(2):
        side.do(side.engine.send_frame("read", side.now, ASKED))
    assert len(side.sent) == 2


def test_a_server_answers_whatever_is_due() -> None:
    """Frames that only a client waits for have no effect on a server, which never holds back a reply."""
    client = Side("modbus-rtu")
    client.read("40001", 11)
    device, now = client.device, 0
    for _ in range(3):
        now += SECOND
        device.receive(client.replies[0], now)
        now += SECOND
        assert any(isinstance(command, Send) for command in device.receive(client.sent[0], now))
        device.sent(now)
    assert device.late.until == 0 and device.late.expected.frames == frozenset()


def test_replies_with_a_number_are_never_waited_for() -> None:
    side = Side("modbus-tcp")
    side.read("40001", 11)
    side.until(SECOND)
    side.read("40002", 22)
    assert side.values == ["no_reply"] and len(side.sent) == 2
    side.reply(0)
    side.reply(1)
    assert side.values == ["no_reply", [22]]


OWN = """
sequences:
  exchange:
    takes: [request]
    gives: {reply: answer}
    local: {answer: frame}
    steps:
      - step: first
        send: {read: {station: station, address: 0, count: 1}}
        receive: [{frame: values, then: next}]
        within: 1 s
        on_timeout: {then: resend, at_most: 2, else: {fail: no_reply}}
      - step: second
        send: request
        URGENT
        receive: [{frame: values, set: {answer: it}, then: end}]
        within: 1 s
        on_timeout: {fail: no_reply}
"""


@pytest.mark.parametrize(("urgent", "sent"), [("", 2), ("urgent: yes", 3)])
def test_within_an_exchange_the_next_request_waits_unless_it_is_urgent(urgent: str, sent: int) -> None:
    side = Side(REGISTERS + OWN.replace("URGENT", urgent))
    side.read("R1", 11)
    side.until(1100 * MS)
    side.reply(0)
    assert len(side.sent) == sent
    side.reply(1)
    assert len(side.sent) == 3
    assert (side.values, side.late) == (([], 1) if not urgent else ([[0]], 0))


def test_urgent_without_a_frame_has_no_effect_and_is_refused() -> None:
    wrong = REGISTERS + OWN.replace("        send: request\n", "").replace("URGENT", "urgent: yes")
    with pytest.raises(DefinitionError, match="urgent"):
        load_protocol_text(wrong, "made_up")


def test_a_time_of_another_kind_is_refused() -> None:
    wrong = REGISTERS.replace("line: {", "line: {late: 5, ")
    with pytest.raises(DefinitionError, match="time"):
        load_protocol_text(wrong, "made_up")


def test_where_nothing_is_late_nothing_is_held_back() -> None:
    side = Side("modbus-rtu")
    for number in range(5):
        side.read("40001", number)
        side.reply(number)
    assert side.values == [[number] for number in range(5)] and side.engine.late.until == 0


@pytest.mark.parametrize(
    ("retries", "protocol"), [(0, REGISTERS), (1, REGISTERS), (0, "modbus-rtu"), (1, "modbus-rtu")]
)
def test_a_byte_behind_each_reply_does_not_make_a_client_deaf(retries: int, protocol: str) -> None:
    """The line's driver leaves a byte when it is switched off; a lost reply does not make further replies late."""
    side = Side(protocol, retries=retries)
    place = "R1" if protocol == REGISTERS else "40001"
    for number in range(5):
        side.read(place, number)
        sent = len(side.sent)
        while number and len(side.values) <= number:
            side.come(side.replies[sent - 1] + b"\0")
            side.until(side.now + SECOND // 5)
            sent = len(side.sent)
        side.until(side.now + 10 * SECOND)
    assert side.values == ["no_reply", [1], [2], [3], [4]]


def test_the_end_waits_for_a_frame_that_is_kept_back() -> None:
    side = Side(retries=0)
    ended: list[int] = []
    side.read("R1", 11)
    side.until(SECOND)
    side.do(side.engine.send_frame("read", side.now, {"station": 3, "address": 5, "count": 1}))
    side.do(side.engine.close_session(side.now, lambda: ended.append(len(side.sent))))
    assert len(side.sent) == 1 and not ended
    side.until(2 * SECOND)
    assert ended == [2]


TWO_FRAMES = (
    REGISTERS.replace(
        "  written: {group", "  accepted: {group: reply, where: {code: 9}, body: []}\n  written: {group"
    ).replace("echo: [station, code]", "echo: [station]")
    + """
sequences:
  exchange:
    takes: [request]
    gives: {reply: answer}
    local: {answer: frame}
    steps:
      - step: ask
        send: request
        receive: [{frame: accepted, then: next}]
        within: reply_timeout
        on_timeout: {fail: no_reply}
      - step: answer
        receive: [{frame: expected, set: {answer: it}, then: end}]
        within: reply_timeout
        on_timeout: {fail: no_reply}
"""
)
"""Two frames answer each request: an acceptance, and then the values."""


@pytest.mark.parametrize("later", [0, 3, 15])
def test_a_late_second_frame_of_a_reply_is_not_that_of_the_next_request(later: int) -> None:
    """The hold ends if no further frame arrives for as long as the first was late, but the second may still arrive."""
    side = Side(TWO_FRAMES)
    accepted = side.engine.table.infos["accepted"].encode({"station": 3, "code": 9}, side.engine.scope)
    side.read("R1", 11)
    side.until(1500 * MS)
    assert side.values == ["no_reply"]
    side.come(accepted)
    side.until(3500 * MS + later * SECOND)
    side.read("R2", 22)
    assert len(side.sent) == 2, "the hold is over"
    side.come(accepted)
    side.reply(0)
    assert side.values == ["no_reply"], "that is the second frame of the first reply"
    while len(side.values) == 1:
        count = len(side.sent)
        side.until(side.now + 100 * MS)
        if len(side.sent) > count:
            side.come(accepted)
            side.reply(-1)
    assert side.values[1] in ([22], "late_replies")


SWAPPED = REGISTERS.replace(
    "{field: station, type: u8}, {field: code, type: u8}", "{field: code, type: u8}, {field: station, type: u8}"
).replace("where: {code: 1}", "where: {code: 3}")
"""Another protocol: a reply of station 3 with code 1 is a reply of station 1 with code 3 in it."""


def line_of_another_protocol(text: str) -> tuple[Side, Side]:
    """Return the side whose request is open, and the side of another protocol that uses the line after it."""
    before, side = Side(retries=0), Side(text, retries=0)
    before.read("R1", 11)
    before.until(1200 * MS)
    assert before.values == ["no_reply"]
    side.engine.late.take_over(before.engine.late, is_same=False)
    side.until(1200 * MS)
    return before, side


def test_a_reply_to_a_request_of_another_protocol_is_not_stored() -> None:
    before, side = line_of_another_protocol(SWAPPED)
    side.do(side.client.read("R2", station=1, now=side.now, on_done=side.results.append).commands)
    side.until(1900 * MS)
    assert side.sent == [], "the hold of the line before"
    side.until(2000 * MS)
    assert len(side.sent) == 1
    side.come(before.replies[0])
    assert side.values == []
    side.until(2200 * MS)
    assert len(side.sent) == 2, "asked again"


def test_a_late_reply_to_an_own_request_is_none_to_that_of_another_protocol() -> None:
    before, side = line_of_another_protocol(REGISTERS.replace("values", "words"))
    side.read("R2", 22)
    side.until(3500 * MS)
    assert side.values == ["no_reply"]
    side.reply(0)
    assert side.late == 1
    side.read("R3", 33)
    side.until(5500 * MS)
    assert len(side.sent) == 2
    side.come(before.replies[0])
    side.until(5700 * MS)
    assert side.values == ["no_reply"] and len(side.sent) == 3
    side.reply(2)
    side.until(side.now + SECOND)
    assert side.values == ["no_reply"] and len(side.sent) == 4
    side.reply(3)
    assert side.values == ["no_reply", [33]]


def test_what_a_later_side_of_the_line_takes_over() -> None:
    before, side = Side(retries=0), Side(retries=0)
    before.read("R1", 11)
    before.until(1200 * MS)
    assert not before.engine.late.is_over(1999 * MS) and not before.engine.late.is_over(20 * SECOND)
    assert before.engine.late.is_over(23 * SECOND), "21 time limits after the request"
    for _ in range(2):
        side.engine.late.take_over(before.engine.late, is_same=True)
    assert len(side.engine.late.open) == 1
    off = Side(retries=0, late_reply=0)
    off.engine.late.take_over(before.engine.late, is_same=True)
    assert off.engine.late.open == []
