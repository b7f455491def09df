"""Late replies that contain the number of their request: none is confused with another, and the advice is the same."""

from __future__ import annotations

import json
from itertools import product
from pathlib import Path
from typing import Any

import pytest
from link.link_world import Side
from service.late_world import MS, SECOND, LateWorld

from framekit.cli.main import main
from framekit.codec.codec import compile_protocol
from framekit.definition.load.protocol import load_protocol_text
from framekit.link.engine import Engine
from framekit.link.events import Command, Exchange, Send
from framekit.link.slow import WELL_TIME
from framekit.run.model import FaultRule

NUMBERED = ("modbus-tcp", "melsec-mc-4e")
IN_SESSIONS = (*NUMBERED, "fins-tcp", "srtp")
"""The last ones have a session, whose own procedures are quick, and the number of FINS is in a frame inside."""
SHOWN = {"fins-tcp": "station 0"}
QUICK = 2 * SECOND
"""Time at which the device becomes slow."""
WELL = 100 * SECOND
"""Time at which a device that was slow becomes quick (ns)."""


def slow_world(name: str, late: int, overlapping: bool, **more: Any) -> tuple[LateWorld, list[str]]:
    """Return a world whose replies are late from `QUICK` to `WELL`, and its reports of slow stations.

    `overlapping`: each reply is delayed independently; else the device handles one request after the other.
    """
    more["reply_timeout"] = SECOND
    if overlapping:
        world = LateWorld(name, lateness=lambda now: late if QUICK <= now < WELL else 0, **more)
    else:
        world = LateWorld(name, FaultRule(kind="delay", time=late, begin=QUICK, end=WELL), **more)
    reports: list[str] = []
    world.service.engine.late.slow.on_change = lambda station, is_slow: reports.append(
        str(station) if is_slow else "well"
    )
    assert world.exchange() == "ok"
    world.clock.run_until(QUICK + SECOND)
    return world, reports


@pytest.mark.parametrize(("name", "overlapping"), list(product(IN_SESSIONS, (False, True))))
@pytest.mark.parametrize(
    ("times", "shown"), [(1.5, "1.5 s: set reply_timeout to 2 s"), (3.5, "3.5 s: set reply_timeout to 4 s")]
)
def test_the_advice_is_that_of_replies_without_numbers(name: str, overlapping: bool, times: float, shown: str) -> None:
    world, reports = slow_world(name, int(times * SECOND), overlapping)
    while world.clock.now() < WELL:
        world.exchange()
    assert reports == [f"{SHOWN.get(name, 'station 3')} answers after {shown} or more"]
    assert world.late > 10 and world.service.engine.held_until == 0, "no request waits"
    end = world.clock.now() + 2 * WELL_TIME
    while world.clock.now() < end:
        world.exchange()
        world.clock.run_for(SECOND)
    assert reports[1:] == ["well"] and world.wrong == [] and world.outcomes["ok"] > 60


@pytest.mark.parametrize("name", NUMBERED)
def test_a_late_reply_between_two_requests_is_shown_as_such(name: str) -> None:
    """No request is waiting then, and the bytes of a reply may also fit a request."""
    world = LateWorld(name, FaultRule(kind="delay", time=1500 * MS), watched=True, reply_timeout=SECOND)
    assert world.exchange() == "no_reply"
    world.seen.clear()
    world.clock.run_for(2 * SECOND)
    (late,) = [event for event in world.seen if event.kind == "not_taken"]
    assert late.frame.startswith("reply") and late.reason == "late: the reply to a request that is over"
    assert world.late == 1


REPEATING = """
protocol: repeating
about: Requests have a number and are repeated with it.
station: {type: number, range: 0..255}
line: {kind: stream, tcp: 5000}
params: {reply_timeout: {type: time, default: 1 s}}
state: {number: {type: u8}}
frames:
  read: {from: client, body: [{const: 01}, {field: number, type: u8}, {field: station, type: u8}]}
  value: {from: server, echo: [number, station], body: [{const: 02}, {field: number, type: u8}, {field: station, type: u8}, {field: it_is, type: u8}]}
sequences:
  exchange:
    gives: {reply: answer}
    local: {answer: frame}
    steps:
      - step: ask
        set: {number: number + 1}
        send: {read: {number: number, station: station}}
        receive: [{frame: value, set: {answer: it}, then: end}]
        within: reply_timeout
        on_timeout: {then: resend, at_most: 1, else: {fail: no_reply}}
  listen: {steps: [{step: idle, receive: [{frame: read, then: end}]}]}
roles:
  client: {lanes: {main: {exchange: exchange}}}
  server: {lanes: {main: {listen: listen}}}
"""  # noqa: E501
"""A protocol whose reply to a repeated request may be the reply to the first request."""


class Asking:
    """A client of REPEATING whose port is the test; `slow` are the reports of slow stations."""

    def __init__(self, text: str = REPEATING) -> None:
        protocol = load_protocol_text(text, "repeating")
        self.engine = Engine(protocol, compile_protocol(protocol), "client", own=1)
        self.slow: list[str] = []
        self.engine.late.slow.on_change = lambda station, is_slow: self.slow.append(str(station))
        self.outcomes: list[str] = []
        self._leave(self.engine.opened(0), 0)

    def _leave(self, commands: list[Command], now: int) -> None:
        for _ in [command for command in commands if isinstance(command, Send)]:
            self._leave(self.engine.sent(now), now)

    def ask(self, now: int) -> None:
        exchange = Exchange(station=3, on_done=lambda outcome: self.outcomes.append(outcome.outcome or "ok"))
        self._leave(self.engine.start(exchange, now), now)

    def tick(self, now: int) -> None:
        self._leave(self.engine.tick(now), now)

    def come(self, number: int, now: int) -> None:
        self._leave(self.engine.receive(bytes([2, number, 3, 77]), now), now)


@pytest.mark.parametrize("is_late", [True, False])
def test_the_second_reply_to_a_repeated_request_shows_that_the_first_was_late(is_late: bool) -> None:
    """With a single reply, the other was lost, and no late reply is known."""
    asking = Asking()
    asking.ask(0)
    asking.tick(SECOND)
    asking.come(1, 1500 * MS)
    assert asking.outcomes == ["ok"] and asking.slow == []
    if is_late:
        asking.come(1, 2500 * MS)
    assert asking.slow == ["station 3 answers after 1.5 s: set reply_timeout to 2 s or more"] * is_late
    assert asking.engine.counters.late == is_late


def test_a_number_that_begins_again_names_the_last_request() -> None:
    text = REPEATING.replace("{number: number,", '{number: "number % 4",').replace(
        "{then: resend, at_most: 1, else: {fail: no_reply}}", "{fail: no_reply}"
    )
    asking = Asking(text)
    for second in range(5):
        asking.ask(second * SECOND)
        asking.tick((second + 1) * SECOND)
    asking.come(1, 5500 * MS)
    assert asking.outcomes == ["no_reply"] * 5
    assert asking.slow == ["station 3 answers after 1.5 s: set reply_timeout to 2 s or more"]


def test_the_run_reports_it_everywhere(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    device = "device: d1\nprotocol: modbus-tcp\nstation: 1\nmemory: {set: {40001: [7]}}\n"
    delay = "faults: {rules: [{fault: delay, time: 1500 ms, from: 5 s, until: 30 s}]}\n"
    (tmp_path / "d1.device.yaml").write_text(device + delay)
    path = tmp_path / "r.run.yaml"
    path.write_text(
        'run: r\nchannels:\n  1: {port: "sim:d1.device.yaml", protocol: modbus-tcp, station: 1}\n'
        'points:\n  a: {channel: 1, address: "40001"}\n'
    )
    shown = "station 1 answers after 1.5 s: set reply_timeout to 2 s or more"
    assert main(["run", str(path), "--virtual", "--for", "20s", "--json", "--status"]) == 0
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    troubles = [row["text"] for row in rows if row["event"] == "run_trouble"]
    assert troubles[0] == f"channel 1: {shown}"
    (status,) = [row for row in rows if row["event"] == "status"]
    (channel,) = status["channels"]
    assert channel["slow"] == [shown] and channel["late"] == 7
    assert main(["run", str(path), "--virtual", "--for", "120s"]) == 0
    printed = capsys.readouterr()
    assert printed.err.startswith(f"channel 1: {shown}\n")
    assert "channel 1: station 1 answers in time again after " in printed.err


COUNTED = """
protocol: counted_events
line: {speed: 9600, format: 8N1}
receiver: {quiet: 5 ms}
state: {number: {scope: line, type: u8}}
frames:
  ask: {from: client, body: [{const: 3F}, {field: n, type: u8}]}
  answer: {from: server, echo: [n], body: [{const: 3D}, {field: n, type: u8}, {field: v, type: u8}]}
sequences:
  main:
    gives: {v: it.v}
    steps:
      - step: one
        set: {number: number + 1}
        send: {ask: {n: number}}
        receive: [{frame: answer, then: end}]
        within: 1 s
        on_timeout: {fail: no_reply}
roles: {client: {lanes: {main: {exchange: main}}}}
"""


@pytest.mark.parametrize("is_awaited", [True, False])
def test_an_awaited_frame_with_the_number_of_an_overdue_request_is_handed_over(is_awaited: bool) -> None:
    """The frame may be unsolicited; without a RECEIVE block it is the late reply."""
    side = Side(COUNTED, "client")
    side.engine.reception.await_frames(["answer"] if is_awaited else [])
    side.ask()
    side.run(2 * SECOND)
    assert side.outcomes[0].outcome == "no_reply"
    side.gets(bytes([0x3D, 1, 7]), whole=True)
    assert [value.fields["v"] for value in side.arrived] == [7] * is_awaited
    assert side.engine.counters.late == (not is_awaited)
    assert side.engine.late.slow.number == 1
    side.gets(bytes([0x3D, 1, 8]), whole=True)
    assert [value.fields["v"] for value in side.arrived] == ([7, 8] if is_awaited else [8])


KEEPS = "a gateway or an adapter keeps replies"
PERHAPS = f"if that does not help, {KEEPS}"
NO_HELP = "answers only when it is asked again: a longer reply_timeout does not help"


@pytest.mark.parametrize(
    ("name", "keeps", "pause", "reported"),
    [
        ("modbus-tcp", 1.0, 5, f"station 3 {NO_HELP}, {KEEPS}"),
        ("modbus-tcp", 1.0, 0, f"station 3 answers after 1 s: set reply_timeout to 1.5 s or more; {PERHAPS}"),
        ("fins-tcp", 0.3, 5, f"station 0 {NO_HELP}, {KEEPS}"),
        ("df1", 0.3, 5, f"station 3 {NO_HELP}, {KEEPS}"),
        ("df1", 1.0, 0, f"station 3 answers after 5 s: set reply_timeout to 6 s or more; {PERHAPS}"),
        ("modbus-rtu", 1.0, 0, f"station 3 {NO_HELP}, {KEEPS}"),
        ("mldp", 1.0, 5, f"station 3 {NO_HELP}, {KEEPS}"),
    ],
)  # fmt: skip
def test_a_gateway_that_keeps_replies_is_reported_once(name: str, keeps: float, pause: int, reported: str) -> None:
    """It stays a reply behind. Without pauses its replies may also be those of a device that is a little too slow."""
    world = LateWorld(name, keeps=keeps)
    reports: list[str] = []
    world.service.engine.late.slow.on_change = lambda station, is_slow: reports.append(str(station))
    for _ in range(25):
        world.exchange()
        world.clock.run_for(pause * SECOND)
    assert reports == [reported] and world.wrong == []


@pytest.mark.parametrize("name", ["modbus-rtu", "mldp", "df1"])
def test_no_gateway_is_suspected_on_a_line_that_loses_replies(name: str) -> None:
    """The values differ from read to read, and repeats are answered at once. Lost frames of df1 make replies late."""
    world = LateWorld(name, FaultRule(kind="no_reply", rate=0.3), seed=6)
    reports: list[str] = []
    world.service.engine.late.slow.on_change = lambda station, is_slow: reports.append(str(station))
    world.exchanges(200)
    assert not any("keeps" in report for report in reports) and world.outcomes["ok"] > 100 and world.wrong == []
    assert reports == [] or name == "df1"
