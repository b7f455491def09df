"""A frame sender sends what `Engine.send_frame` sends, and counts it alike."""

from __future__ import annotations

from typing import Any

import pytest

from framekit.codec.codec import compile_protocol
from framekit.definition.load import load_protocol_text
from framekit.definition.load.library import load_protocol
from framekit.link.engine import Engine
from framekit.link.events import Send
from framekit.link.frame_sender import FrameSender

CASES = [
    ("third-party-plc", "WR.REQ", {"payload": bytes(44)}),
    ("modbus-rtu", "read_holding", {"address": 1, "count": 2}),
]


def engine(name: str, seen: list[Any] | None = None) -> Engine:
    protocol = load_protocol(name)
    made = Engine(protocol, compile_protocol(protocol), None, monitor=None if seen is None else seen.append)
    made.opened(0)
    return made


@pytest.mark.parametrize("watched", [False, True])
@pytest.mark.parametrize(("protocol", "frame", "fields"), CASES)
def test_it_sends_the_same(protocol: str, frame: str, fields: dict[str, Any], watched: bool) -> None:
    one, other = engine(protocol, [] if watched else None), engine(protocol, [] if watched else None)
    sent: list[int] = []
    sender = FrameSender(one, frame)
    for number in range(3):
        commands = sender.send(fields.copy(), 10 * number, lambda number=number: sent.append(number))
        assert commands == other.send_frame(frame, 10 * number, fields.copy())
        assert any(isinstance(command, Send) for command in commands)
        assert not sent[number:], "told when it has left, not before"
        one.sent(10 * number + 5)
        other.sent(10 * number + 5)
    assert sent == [0, 1, 2]
    assert one.counters == other.counters and one.counters.sent == 3


TIMED = """protocol: timed
line: {kind: stream, tcp: 1}
params: {late: {type: number, is: "1 if now > 7 ms else 0"}}
frames:
  told: {body: [{const: 02}, {field: what, type: u8}, {field: when, type: u16, build: BUILD}]}
"""


@pytest.mark.parametrize("build", ['"1 if now > 7 ms else 0"', "clock.second", "late"])
def test_a_frame_says_what_time_it_is_when_it_is_sent(build: str) -> None:
    protocol = load_protocol_text(TIMED.replace("BUILD", build), "timed")
    one, other = (Engine(protocol, compile_protocol(protocol), None) for _ in range(2))
    one.opened(0)
    other.opened(0)
    sender = FrameSender(one, "told")
    frames = []
    for now in (5_000_000, 9_000_000_000):
        commands = sender.send({"what": 1}, now, lambda: None)
        assert commands == other.send_frame("told", now, {"what": 1})
        frames += [command.data for command in commands if isinstance(command, Send)]
        one.sent(now)
        other.sent(now)
    assert len(set(frames)) == 2
    assert not sender.is_plain, "it does not leave before the time is known"


def test_what_a_frame_cannot_carry_is_refused_alike() -> None:
    one = engine("third-party-plc")
    with pytest.raises(ValueError) as told:
        one.send_frame("WR.REQ", 0, {"payload": bytes(100_000)})
    with pytest.raises(ValueError) as same:
        FrameSender(one, "WR.REQ").send({"payload": bytes(100_000)}, 0, lambda: None)
    assert str(same.value) == str(told.value)
    with pytest.raises(KeyError):
        FrameSender(one, "WR.NONE")
