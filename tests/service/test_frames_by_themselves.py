"""RECEIVE blocks and exchanges on one line: no unsolicited frame is lost, and none delays the exchanges."""

from __future__ import annotations

from pathlib import Path
from random import Random

import pytest

import framekit

PROTOCOL = """
protocol: news
extends: standard
station: {type: none}
line: {speed: 1200}
params: {late_reply: {default: LATE}, retries: {default: 0}}
groups: {request: {from: client, tail: [{const: CR}]}}
frames:
  ZERO: {group: request, body: [{text: Z}]}
  ASK: {group: request, body: [{text: A}]}
  NEWS: {from: server, body: [{text: N}, {field: t, type: dec, size: 8}, {const: CR}]}
  DONE: {from: server, body: [{text: D}, {const: CR}]}
services:
  zero: [{request: {ZERO: {}}, reply: {DONE: {}}}]
  now: [{request: {ASK: {}}, reply: {NEWS: {t: 0}}}]
"""
WITHOUT_OTHERS = """
sequences:
  exchange:
    takes: [request]
    gives: {reply: answer}
    local: {answer: frame}
    steps:
      - step: ask
        send: request
        receive: [{frame: expected, set: {answer: it}, then: end}]
        within: reply_timeout
        gap: byte_timeout
        on_timeout: {fail: no_reply}
"""
WITH_FLUSH = """
sequences:
  exchange:
    takes: [request]
    gives: {reply: answer}
    local: {answer: frame}
    steps:
      - {step: rest, wait: 300 ms}
      - step: ask
        send: request
        flush: yes
        receive: [{frame: expected, set: {answer: it}, then: end}]
        within: reply_timeout
        gap: byte_timeout
        on_timeout: {fail: no_reply}
"""
DEVICE = """
device: talker
protocol: news.yaml
state: {told: {scope: device, type: number, initial: 0}}
sequences:
  news: {steps: [{step: pause, wait: PAUSE}, {step: tell, set: {told: told + 1}, send: {NEWS: {t: told}}}]}
  answer:
    local: {request: frame}
    steps:
      - {step: idle, receive: [{frame: request, set: {request: it}, then: next}]}
      - {step: reply, serve: {request: request}, send: reply}
roles: {server: {lanes: {main: {listen: answer}, news: {listen: news}}}}
"""
RUN = """
run: news
memory: masterlogic
channels: {1: {port: "sim:talker.device.yaml", protocol: news.yaml}}
blocks:
  0: {receive: NEWS, data: {t: M0}}
  1: {call: zero, every: EVERY}
"""


def frames_of(folder: Path, late: str, pause: int, every: int, more: str) -> tuple[list[str], list[int], list[str]]:
    """Run for 10 s; return the received frames, the done and failed counts of both blocks, and the errors."""
    (folder / "news.yaml").write_text(PROTOCOL.replace("LATE", late) + more, "utf-8")
    (folder / "talker.device.yaml").write_text(DEVICE.replace("PAUSE", f"{pause} ms"), "utf-8")
    (folder / "news.run.yaml").write_text(RUN.replace("EVERY", f"{every} ms"), "utf-8")
    came: list[str] = []
    wrong: list[str] = []

    def seen(channel: int, event: framekit.Seen) -> None:
        if event.kind == "frame" and event.direction == "in":
            came.append(event.frame or "")
        elif event.kind in ("noise", "bad", "not_taken"):
            wrong.append(f"{event.kind} {event.data.hex(' ')}")

    with framekit.VirtualRun(folder / "news.run.yaml", monitor=seen) as run:
        run.run_for("10 s")
        receive, call = run.blocks
        return came, [receive.done, receive.failed, call.done, call.failed], wrong


@pytest.mark.parametrize("others", [True, False], ids=["other frames looked at", "not looked at"])
@pytest.mark.parametrize("late", ["0 ms", "reply_timeout"])
def test_every_frame_reaches_its_block_and_every_exchange_its_end(tmp_path: Path, late: str, others: bool) -> None:
    chance = Random(f"{late} {others}")
    for _ in range(3):
        pause, every = chance.randrange(20, 400), chance.randrange(150, 900)
        came, (taken, failed, done, lost), wrong = frames_of(
            tmp_path, late, pause, every, "" if others else WITHOUT_OTHERS
        )
        assert wrong == [], (pause, every)
        assert taken == came.count("NEWS") > 10 and failed == 0
        assert done == came.count("DONE") > 5 and lost == 0


def test_forgetting_what_came_forgets_no_frame_that_a_block_wants(tmp_path: Path) -> None:
    chance = Random(5)
    for _ in range(3):
        pause, every = chance.randrange(20, 200), chance.randrange(400, 900)
        came, (taken, failed, done, _), wrong = frames_of(tmp_path, "0 ms", pause, every, WITH_FLUSH)
        assert taken == came.count("NEWS") > 10 and failed == 0
        assert done > 3
        assert all(line.startswith("noise") for line in wrong), "what was half there is shown"
