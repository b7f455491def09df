"""The orderly end of a run: sessions are closed after the last exchange, and no wait is unbounded."""

from __future__ import annotations

from pathlib import Path

import pytest

from framekit.cli.main import main
from framekit.link.events import Seen
from framekit.runfile.run_file import load_run
from framekit.service.run import LONGEST_CLOSING, LONGEST_SHUTDOWN, RunService
from framekit.transport.clock import VirtualClock

MS = 1_000_000

PROTOCOL = """
protocol: talk
station: {type: number, range: 1..9}
frames:
  hello:   {from: client, body: [{const: 01}, {field: station, type: u8}]}
  welcome: {from: server, body: [{const: 02}]}
  bye:     {from: client, body: [{const: 03}]}
  so_long: {from: server, body: [{const: 07}]}
  ask:     {from: client, body: [{const: 04}, {field: x, type: u8}]}
  answer:  {from: server, body: [{const: 05}, {field: y, type: u8}]}
receiver: {quiet: 3 chars}
sequences:
  attach:
    steps:
      - {step: hello, send: {hello: {station: station}}, receive: [{frame: welcome, then: end}], within: 100 ms,
         on_timeout: {fail: nobody}}
  leave:
    steps:
      - {step: bye, send: bye, receive: [{frame: so_long, then: end}], within: 200 ms, on_timeout: {fail: nobody}}
  forget: {steps: [{step: again, send: bye}]}
  work:
    takes: [request]
    gives: {reply: found}
    local: {found: frame}
    steps:
      - {step: ask, send: request, receive: [{frame: answer, set: {found: it}, then: end}], within: 100 ms,
         on_timeout: {fail: no_reply}}
  serve:
    steps:
      - step: listen
        receive:
          - {frame: hello, then: welcome}
          - {frame: ask, then: answer}
          - {frame: bye, then: so_long}
        within: never
      - {step: welcome, send: welcome, then: listen}
      - {step: answer, send: {answer: {y: 9}}, then: listen}
      - {step: so_long, send: so_long, then: listen}
sessions:
  link: {open: [attach], close: [leave, forget], one_station: yes, lost_by: any}
roles:
  client: {session: link, lanes: {main: {exchange: work}}}
  server: {lanes: {main: {listen: serve}}}
services:
  get: [{takes: {x: {type: number}}, request: {ask: {x: x}}, reply: {answer: {}}, gives: {y: reply.y}}]
"""
RUN = """run: talking
memory: masterlogic
channels:
  1: {port: "sim:there.device.yaml", protocol: talk.yaml, station: 3}
blocks:
  0: {call: get, with: {x: 1}, every: 100 ms}
"""
DEVICE = "device: there\nprotocol: talk.yaml\nrole: server\nstation: 3\n"


@pytest.fixture
def run_file(tmp_path: Path) -> Path:
    (tmp_path / "talk.yaml").write_text(PROTOCOL, encoding="utf-8")
    (tmp_path / "there.device.yaml").write_text(DEVICE, encoding="utf-8")
    path = tmp_path / "r.run.yaml"
    path.write_text(RUN, encoding="utf-8")
    return path


class Bench:
    def __init__(self, path: Path, runs_for: int) -> None:
        self.clock = VirtualClock()
        self.seen: list[Seen] = []
        self.service = RunService(load_run(path), self.clock, lambda channel, seen: self.seen.append(seen))
        self.service.start()
        self.clock.run_for(runs_for)
        self.ended_at: int | None = None

    def finish(self) -> None:
        self.service.finish(self._ended)

    def _ended(self) -> None:
        assert self.ended_at is None, "told once"
        assert not self.service.running
        self.ended_at = self.clock.now()

    def frames(self) -> list[str]:
        return [event.frame for event in self.seen if event.kind == "frame" and event.frame]


def test_a_session_is_closed_by_all_its_sequences_before_the_port_is(run_file: Path) -> None:
    bench = Bench(run_file, 250 * MS)
    assert bench.frames() == ["hello", "welcome", "ask", "answer", "ask", "answer"]
    bench.finish()
    assert bench.ended_at is None
    bench.clock.run_for(1000 * MS)
    assert bench.frames()[6:] == ["bye", "so_long", "bye"]
    assert bench.ended_at is not None and bench.ended_at < 350 * MS


def test_what_runs_ends_first_and_nothing_new_begins(run_file: Path) -> None:
    bench = Bench(run_file, 201 * MS)
    assert bench.service.states[0].running
    bench.finish()
    bench.clock.run_for(1000 * MS)
    assert bench.frames()[4:] == ["ask", "answer", "bye", "so_long", "bye"]
    counters = bench.service.states[0]
    assert (counters.started, counters.done, counters.failed) == (2, 2, 0)


def test_without_an_open_session_nothing_is_sent(run_file: Path) -> None:
    bench = Bench(run_file, 50 * MS)
    bench.finish()
    bench.clock.run_for(0)
    assert bench.frames() == [] and bench.ended_at == 50 * MS


def test_a_port_that_never_finishes_closing_holds_the_run_up_to_the_bound(
    run_file: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    bench = Bench(run_file, 50 * MS)
    monkeypatch.setattr(bench.service.channels[1].driver.port, "when_closed", lambda done: None)
    bench.finish()
    bench.clock.run_for(LONGEST_CLOSING - 1)
    assert bench.ended_at is None and not bench.service.running
    bench.clock.run_for(1000 * MS)
    assert bench.ended_at == 50 * MS + LONGEST_CLOSING
    assert caplog.messages == ["the run ends while ports are closing: channel 1"]


def test_a_silent_other_side_is_left_after_its_time(run_file: Path) -> None:
    bench = Bench(run_file, 250 * MS)
    bench.service.devices[0].stop()
    bench.finish()
    bench.clock.run_for(1000 * MS)
    assert bench.frames()[6:] == ["bye", "bye"], "a sequence that fails only keeps the next one back for as long again"
    assert bench.ended_at is not None and 650 * MS <= bench.ended_at < 660 * MS


def test_no_session_holds_a_run_longer_than_the_bound(run_file: Path) -> None:
    path = run_file.parent / "talk.yaml"
    path.write_text(PROTOCOL.replace("within: 200 ms", "within: never"), encoding="utf-8")
    bench = Bench(run_file, 250 * MS)
    bench.service.devices[0].stop()
    bench.finish()
    bench.clock.run_for(60_000 * MS)
    assert bench.ended_at == 250 * MS + LONGEST_SHUTDOWN


def test_the_command_line_takes_leave(run_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(run_file), "--virtual", "--for", "250ms", "--frames"]) == 0
    shown = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert [words[4] for words in shown if len(words) > 4 and words[1] == "ch"][-3:] == ["bye", "so_long", "bye"]
