# ruff: noqa: E501 - definitions in YAML
"""Steps, words, handlers, calls, parts, counters and time limits in small invented protocols."""

from __future__ import annotations

from typing import Any

import pytest
from link.link_world import MS, SECOND, Echoing, Side, compiled

from framekit.definition.times import NEVER
from framekit.link.events import LineFault, Send, SetRts
from framekit.link.values import FrameValue

FRAMES = """
frames:
  ask:   {from: client, body: [{const: 01}, {field: x, type: u8}]}
  yes:   {from: server, body: [{const: 02}, {field: x, type: u8}]}
  no:    {from: server, body: [{const: 03}, {field: x, type: u8}]}
  block: {body: [{const: 04}, {length: n, type: u8, of: [data]}, {data: data, size: n}, {check: sum8}]}
  ack:   {body: [{const: 06}]}
  nak:   {body: [{const: 15}]}
  enq:   {body: [{const: 05}]}
receiver: {quiet: 3 chars}
"""


def protocol(sequences: str, roles: str = "client: {lanes: {main: {exchange: main}}}", more: str = "") -> str:
    lines = "\n".join(f"  {line}" for line in sequences.strip("\n").splitlines())
    return f"protocol: steps\n{FRAMES}\n{more}\nsequences:\n{lines}\nroles:\n  {roles}\n"


def block(data: bytes) -> bytes:
    body = bytes([4, len(data)]) + data
    return body + bytes([sum(body) & 0xFF])


def run(sequences: str, *, more: str = "", request: FrameValue | None = None, **options: Any) -> Side:
    side = Side(protocol(sequences, more=more), "client", **options.pop("engine", {}))
    side.ask(request, **options)
    side.run(0)
    return side


# ---- words -------------------------------------------------------------------------------------------------

WORDS = """
main:
  local: {n: u8}
  gives: {n: n}
  steps:
    - step: one
      send: {ask: {x: n}}
      receive:
        - {frame: ack, then: again}
        - {frame: enq, then: restart}
        - {frame: nak, then: resend, at_most: 9}
        - {frame: 'yes', when: it.x == 1, set: {n: n + 1}, then: one}
        - {frame: 'yes', then: two}
        - {frame: 'no', then: end}
      within: 100 ms
    - step: two
      set: {n: n + 10}
"""


def test_words() -> None:
    side = run(WORDS)
    side.run(50 * MS)
    side.gets(b"\x06")
    side.run(40 * MS)
    side.gets(b"\x05")
    side.run(90 * MS)
    assert not side.outcomes, "restart began the time anew"
    side.gets(b"\x15\x02\x01\x02\x02")
    side.run(SECOND)
    assert side.taken() == [b"\x01\x00", b"\x01\x00", b"\x01\x01"]
    assert side.outcomes[0].results == {"n": 11}


def test_again_lets_the_clock_go_on() -> None:
    side = run(WORDS)
    side.run(60 * MS)
    side.gets(b"\x06")
    side.run(50 * MS)
    assert side.outcomes[0].outcome == "timeout"


def test_conditions_skip_steps_and_branches_choose() -> None:
    text = """
main:
  takes: [request]
  gives: {path: path}
  local: {path: list}
  steps:
    - step: first
      when: request.x > 5
      set: {path: "path + [1]"}
    - step: choose
      branch:
        - {when: request.x == 7, set: {path: "path + [7]"}, then: end}
        - {when: request.x == 8, fail: eight}
        - {set: {path: "path + [0]"}}
    - step: last
      set: {path: "path + [9]"}
"""
    paths = {}
    for x in (1, 6, 7, 8):
        outcome = run(text, request=FrameValue("ask", {"x": x})).outcomes[0]
        paths[x] = outcome.results["path"] if outcome.ok else outcome.outcome
    assert paths == {1: [0, 9], 6: [1, 0, 9], 7: [1, 7], 8: "eight"}


def test_counters() -> None:
    text = """
main:
  steps:
    - step: one
      send: enq
      receive:
        - {frame: nak, then: resend, at_most: 2, else: {send: ack, fail: too_many_naks}}
        - {frame: 'yes', then: one}
      within: 1 s
"""
    side = run(text)
    side.gets(b"\x15\x15\x02\x00\x15\x15")
    assert not side.outcomes, "entering the step set the counter to zero"
    side.gets(b"\x15")
    side.run(SECOND)
    assert side.taken() == [b"\x05"] * 6 + [b"\x06"]
    assert side.outcomes[0].outcome == "too_many_naks"


def test_a_counted_row_that_leads_to_another_step_does_not_go_round_for_ever() -> None:
    text = """
main:
  steps:
    - step: wake
      send: enq
    - step: ask
      send: {ask: {x: 1}}
      receive: [{frame: 'yes', then: end}]
      within: 10 ms
      on_timeout: {then: wake, at_most: 2, else: {fail: nobody}}
"""
    side = run(text)
    side.run(SECOND)
    assert side.taken() == [b"\x05", b"\x01\x01"] * 3
    assert side.outcomes[0].outcome == "nobody"


def test_retries_and_exhausted() -> None:
    text = """
main:
  steps:
    - step: one
      send: enq
      receive: [{frame: ack, then: next}]
      within: 10 ms
      retries: 2
      on_timeout: resend
      on_exhausted: {send: nak, fail: worn_out}
"""
    side = run(text)
    side.run(SECOND)
    assert side.taken() == [b"\x05"] * 3 + [b"\x15"]
    assert side.outcomes[0].outcome == "worn_out"


def test_what_a_handler_sends_is_not_what_resend_repeats() -> None:
    text = """
main:
  steps:
    - step: one
      send: {ask: {x: 9}}
      receive:
        - {frame: enq, send: nak, then: again}
        - {frame: nak, then: resend, at_most: 9}
        - {frame: ack, then: end}
      within: 1 s
"""
    side = run(text)
    side.gets(b"\x05\x15\x06")
    side.run(SECOND)
    assert side.taken() == [b"\x01\x09", b"\x15", b"\x01\x09"] and side.outcomes[0].ok


# ---- calls -------------------------------------------------------------------------------------------------

CALLS = """
main:
  takes: [request]
  gives: {total: total, why: why}
  local: {total: u16, why: text}
  always:
    - {frame: enq, fail: interrupted}
  on_break: {set: {why: "'break'"}, then: end}
  steps:
    - step: first
      call: add
      with: {amount: request.x}
      into: {total: sum}
      on_fail: {set: {why: outcome}, then: last}
    - step: second
      call: add
      with: {amount: total}
      into: {total: sum}
    - step: last
      then: end
add:
  takes: [amount]
  gives: {sum: amount + more}
  local: {more: u8}
  steps:
    - step: ask
      send: {ask: {x: amount}}
      receive:
        - {frame: 'yes', set: {more: it.x}, then: end}
        - {frame: 'no', fail: refused}
      within: 100 ms
"""


def ask_frame(x: int) -> FrameValue:
    return FrameValue("ask", {"x": x})


def test_calls_take_arguments_and_give_results() -> None:
    side = run(CALLS, request=ask_frame(5))
    side.gets(b"\x02\x03\x02\x04")
    side.run(0)
    assert side.outcomes[0].results == {"total": 12, "why": ""}
    side.run(SECOND)
    assert side.taken() == [b"\x01\x05", b"\x01\x08"]


def test_a_failing_call_is_handled_or_passed_on() -> None:
    handled = run(CALLS, request=ask_frame(5))
    handled.gets(b"\x03\x00")
    assert handled.outcomes[0].results == {"total": 0, "why": "refused"}
    passed_on = run(CALLS, request=ask_frame(5))
    passed_on.gets(b"\x02\x03\x03\x00")
    assert passed_on.outcomes[0].outcome == "refused"
    late = run(CALLS, request=ask_frame(5))
    late.run(SECOND)
    assert late.outcomes[0].results["why"] == "timeout"


def test_rows_that_always_hold_and_breaks_reach_into_calls() -> None:
    side = run(CALLS, request=ask_frame(5))
    side.gets(b"\x05")
    assert side.outcomes[0].outcome == "interrupted"
    side = run(CALLS, request=ask_frame(5))
    side.line_break()
    assert side.outcomes[0].results["why"] == "break"


# ---- parts, wait, break ------------------------------------------------------------------------------------

PARTS = """
main:
  takes: [buffer]
  steps:
    - step: out
      parts: {of: buffer, size: 3}
      send: {block: {data: part.data}}
      receive:
        - {frame: ack, when: part.next >= 0, then: next}
        - {frame: nak, then: resend}
      within: 100 ms
      retries: 1
      then: close
    - step: never
      fail: unreachable
      send: enq
    - step: close
      send: {ask: {x: 99}}
      then: end
""".replace("      fail: unreachable\n", "")


def test_parts() -> None:
    side = run(PARTS, buffer=b"abcdefg")
    side.gets(b"\x06\x15")
    side.run(20 * MS)
    side.gets(b"\x06")
    side.run(20 * MS)
    side.gets(b"\x15")
    side.run(20 * MS)
    side.gets(b"\x06")
    side.run(20 * MS)
    assert side.taken() == [block(b"abc"), block(b"def"), block(b"def"), block(b"g"), block(b"g"), b"\x01\x63"]
    assert side.outcomes[0].ok


def test_no_parts_no_step() -> None:
    side = run(PARTS, buffer=b"")
    assert side.taken() == [b"\x01\x63"] and side.outcomes[0].ok


def test_waiting_and_breaks() -> None:
    text = """
main:
  steps:
    - step: wake
      break: 5 ms
    - step: settle
      wait: 50 ms
    - step: listen
      wait: 4 chars
      on_byte: {fail: somebody}
    - step: go
      send: enq
"""
    side = run(text)
    side.run(SECOND)
    assert side.sent == [(0, b"BREAK"), (55 * MS + side.engine.scope.line.chars(4), b"\x05")]
    side = run(text)
    side.run(20 * MS)
    side.gets(b"\x06")
    assert not side.outcomes
    side.run(34 * MS)
    assert side.outcomes[0].outcome == "somebody", "the byte was there when the step began"


BREAKS = """
protocol: breaks
line: {speed: 250000, format: 8N2}
receiver: {quiet: 1 ms, break_ends: yes}
state: {slots: {scope: device, type: u16}, bad: {scope: device, type: u16}, breaks: {scope: device, type: u16}}
frames:
  dmx: {body: [{const: 00}, {data: d, size: rest}]}
  rdm: {body: [{const: CC}, {length: n, type: u8, of: [d]}, {data: d, size: n}, {check: sum8}]}
sequences:
  hear:
    steps:
      - step: idle
        receive: [{frame: dmx, set: {slots: len(it.d)}, then: again}, {frame: rdm, then: again}]
        on_break: {set: {breaks: breaks + 1}, then: again}
        on_bad: {set: {bad: bad + 1}, then: again}
roles: {lamp: {lanes: {main: {listen: hear}}}}
"""


@pytest.mark.parametrize("ends", [True, False])
@pytest.mark.parametrize(
    ("data", "counts", "slots"),
    [("00 11 22", (1, 0, 0), 2), ("CC 05 11", (0, 1, 0), 0), ("CC 02 11 22 01", (1, 0, 0), 0)],
)
def test_a_break_ends_frames_where_the_definition_says_so(
    data: str, counts: tuple[int, int, int], slots: int, ends: bool
) -> None:
    """The frame is good or bad, never lost; a handler gets the break after the frame or alone."""
    side = Side(BREAKS if ends else BREAKS.replace(", break_ends: yes", ""), "lamp")
    if not ends and slots:
        counts, slots = (0, 1, 0), 0
    side.gets(bytes.fromhex(data), whole=True)
    side.line_break()
    counters = side.engine.counters
    assert (counters.received, counters.bad, counters.noise_bytes) == counts
    assert [side.engine.scope.device[name] for name in ("slots", "bad", "breaks")] == [slots, 0, 1]


INTERRUPTED = """
protocol: interrupted
line: {speed: 9600, format: 8N1}
receiver: {quiet: 5 ms}
frames:
  ask: {from: client, body: [{const: 3F}]}
  answer: {from: server, body: [{const: 3D}, {data: d, size: rest}]}
sequences:
  main:
    gives: {d: it.d}
    steps:
      - step: one
        send: {ask: {}}
        receive: [{frame: answer, then: end}]
        within: 1 s
        on_timeout: {fail: no_reply}
        on_break: {fail: interrupted}
roles: {client: {lanes: {main: {exchange: main}}}}
"""


@pytest.mark.parametrize(
    ("body", "data", "outcome"),
    [
        ("{data: d, size: rest}", b"=12", "interrupted"),
        ("{data: d, size: rest}, {check: sum8}", b"=12\xa0", "ok"),
        ("{data: d, size: rest}, {check: sum8}", b"=12\xa1", "interrupted"),
        ("{data: d, size: rest}, {check: sum8, verify: off}", b"=12\xa0", "interrupted"),
        ("{data: d, size: rest}, {const: 0D}", b"=12\r", "ok"),
        ("{data: d, size: rest}, {const: 0D}", b"=12", "interrupted"),
        ("{data: d, size: 2}", b"=12", "ok"),
        ("{data: d, size: 2}", b"=1", "interrupted"),
    ],
)
def test_a_reply_that_a_break_cuts_off_is_no_good_reply(body: str, data: bytes, outcome: str) -> None:
    """If only silence ends a frame, a break is a line fault and does not end the frame."""
    side = Side(INTERRUPTED.replace("{data: d, size: rest}", body), "client")
    side.ask()
    side.run(10 * MS)
    side.gets(data, whole=True)
    side.line_break()
    assert [outcome.outcome or "ok" for outcome in side.outcomes] == [outcome]
    assert side.engine.counters.bad == (outcome != "ok")
    if outcome != "ok" and data[-1] != 0xA1:
        assert (side.reasons("bad"), side.engine.counters.noise_bytes) == (["cut"], 0)


def test_a_reply_that_silence_has_ended_before_the_break_is_good() -> None:
    side = Side(INTERRUPTED, "client")
    side.ask()
    side.run(10 * MS)
    side.gets(b"=12", whole=True)
    side.now += 6 * MS  # the process is late: `tick` has not been called
    side.line_break()
    assert [outcome.ok for outcome in side.outcomes] == [True]


@pytest.mark.parametrize("repeats", [1, 2])
def test_a_break_fails_no_exchange_that_begins_after_it(repeats: int) -> None:
    side = Side(INTERRUPTED.replace("receiver: {quiet: 5 ms}", "receiver: {quiet: 5 ms, break_ends: yes}"), "client")
    for _ in range(1 + repeats):
        side.ask()
    side.run(10 * MS)
    side.gets(b"=12", whole=True)
    side.line_break()
    assert [outcome.ok for outcome in side.outcomes] == [True]
    side.run(10 * MS)
    side.line_break()
    assert [outcome.outcome for outcome in side.outcomes] == ["", "interrupted"]


# ---- handlers ----------------------------------------------------------------------------------------------

HANDLERS = """
main:
  gives: {seen: seen}
  local: {seen: list}
  on_noise: {set: {seen: "seen + ['noise']"}, then: again}
  steps:
    - step: one
      receive: [{frame: ack, then: end}]
      within: 1 s
      on_bad:
        - {when: "cause == 'check'", set: {seen: "seen + [frame, cause]"}, then: again}
        - {when: "cause == 'parity'", fail: parity}
      on_other: {set: {seen: "seen + [it.frame]"}, then: again}
      on_closed: {fail: cable}
"""


def test_handlers() -> None:
    side = run(HANDLERS)
    side.gets(block(b"xxxxxxxx")[:-1] + b"\x00" + b"\x02\x07" + b"\xee")
    side.run(20 * MS)
    side.gets(b"\x06")
    assert side.outcomes[0].results["seen"] == ["block", "check", "yes", "noise"]


def test_the_first_handler_whose_condition_holds() -> None:
    side = run(HANDLERS)
    side.gets(b"\x01\x01", faults={1: LineFault.PARITY})
    assert side.outcomes[0].outcome == "parity"
    side = run(HANDLERS)
    side.do(side.engine.closed(side.now, "gone"))
    assert side.outcomes[0].outcome == "cable"


def test_complete_limits_a_frame_from_its_first_to_its_last_byte() -> None:
    text = """
main:
  steps:
    - step: one
      receive: [{frame: block, then: end}]
      within: 1 s
      complete: 20 ms
      on_timeout: {fail: slow}
"""
    side = run(text)
    side.run(500 * MS)
    frame = block(b"abcdefgh")
    for byte in frame[:8]:
        side.run(5 * MS)
        side.gets(bytes([byte]))
    assert side.outcomes[0].outcome == "slow" and side.reasons("bad") == ["cut"]
    side = run(text)
    side.run(990 * MS)
    side.gets(frame)
    assert side.outcomes[0].ok


def test_without_other_limits_no_pause_is_longer_than_within() -> None:
    text = """
main:
  steps:
    - step: one
      receive: [{frame: block, then: end}]
      within: 100 ms
"""
    side = run(text)
    side.run(50 * MS)
    side.gets(block(b"abc")[:2])
    at = side.now
    side.run(SECOND)
    assert side.outcomes[0].outcome == "timeout"
    assert side.engine.deadline == NEVER and side.now > at


def test_a_good_frame_behind_a_false_start_is_found_when_the_time_is_up() -> None:
    text = """
main:
  gives: {x: x}
  local: {x: u8}
  steps:
    - step: one
      receive: [{frame: 'yes', set: {x: it.x}, then: end}, {frame: block, then: end}]
      within: 100 ms
      gap: 10 ms
"""
    side = run(text)
    side.gets(b"\x04\xf0" + b"\x02\x07")
    assert not side.outcomes
    side.run(50 * MS)
    assert side.outcomes[0].results == {"x": 7}


# ---- what cannot be worked out -----------------------------------------------------------------------------


def test_expressions_that_fail_end_the_sequence() -> None:
    text = """
main:
  gives: {why: why}
  local: {why: text}
  steps:
    - step: one
      call: bad
      on_fail: {set: {why: outcome}, then: end}
bad:
  local: {nothing: frame}
  steps:
    - step: one
      set: {nothing: nothing.x + 1}
"""
    side = run(text)
    assert side.outcomes[0].results == {"why": "expression"} and side.reasons("trouble")


def test_a_condition_of_a_row_that_fails_does_not_hold() -> None:
    text = """
main:
  steps:
    - step: one
      receive:
        - {frame: 'yes', when: 1 // it.x == 1, fail: wrong}
        - {frame: 'yes', then: end}
      within: 1 s
"""
    side = run(text)
    side.gets(b"\x02\x00")
    assert side.outcomes[0].ok and "divided by 0" in side.reasons("trouble")[0]


def test_circles_of_steps_are_stopped() -> None:
    text = """
main:
  steps:
    - step: one
      set: {n: n + 1}
    - step: two
      then: one
"""
    side = run(text, more="state: {n: {type: u32}}")
    assert side.outcomes[0].outcome == "circle" and side.engine.scope["n"] > 1000


def test_a_listener_that_goes_in_circles_is_held_back() -> None:
    text = protocol(
        "listen:\n  steps:\n    - step: one\n      wait: 0 ms\n      set: {n: n // 0}\n    - step: two\n      receive: [{frame: ack, then: end}]",
        roles="client: {lanes: {main: {listen: listen}}}",
        more="state: {n: {type: u32}}",
    )
    side = Side(text, "client")
    side.run(350 * MS)
    assert side.now == 350 * MS and side.engine.deadline > side.now


# ---- variables ---------------------------------------------------------------------------------------------


def test_numbers_wrap_at_their_width_and_parameters_stay_in_range() -> None:
    text = """
main:
  gives: {small: small}
  local: {small: i8}
  steps:
    - step: one
      set: {n: 255 + 2, small: 130, level: 3}
    - step: two
      set: {level: 11}
"""
    more = "state: {n: {type: u8}}\nparams: {level: {type: number, default: 1, range: 0..10}}"
    side = run(text, more=more)
    assert side.engine.scope["n"] == 1 and side.engine.scope["level"] == 3
    assert side.outcomes[0].outcome == "expression" and "0..10" in side.outcomes[0].cause


def test_tables_lists_and_fields_are_set() -> None:
    text = """
main:
  takes: [request]
  gives: {x: request.x, seven: "marks[7]", eight: "8 in marks", known: "get(marks, 3, 0)"}
  steps:
    - step: one
      set: {request.x: request.x + 1, "marks[request.x]": 40 + request.x}
"""
    side = run(text, request=ask_frame(6), more="state: {marks: {table: 0..9, holds: u8}}")
    assert side.outcomes[0].results == {"x": 7, "seven": 47, "eight": False, "known": 0}


def test_formulas_follow_what_they_depend_on() -> None:
    more = "state: {n: {type: u8}}\nparams: {limit: {type: time, default: ms(n) + 2 chars}, twice: {type: time, is: limit * 2}}"
    text = """
main:
  gives: {before: before, after: twice}
  local: {before: time}
  steps:
    - step: one
      set: {before: twice, n: 10}
"""
    side = run(text, more=more)
    chars = side.engine.scope.line.chars(2)
    assert side.outcomes[0].results == {"before": 2 * chars, "after": 2 * (10 * MS + chars)}
    given = run(text, more=more, engine={"params": {"limit": "3 chars"}})
    assert given.outcomes[0].results["after"] == 2 * given.engine.scope.line.chars(3)


# ---- the line ----------------------------------------------------------------------------------------------


def test_turnaround_counts_from_the_last_character_in_either_direction() -> None:
    more = "line: {turnaround: 5 ms}"
    text = """
main:
  steps:
    - step: one
      send: enq
      receive: [{frame: ack, send: nak, then: next}]
      within: 1 s
    - step: two
      send: enq
"""
    side = run(text, more=more)
    side.run(10 * MS)
    side.gets(b"\x06")
    came = side.now
    side.run(SECOND)
    char = side.engine.scope.line.chars(1)
    assert side.sent == [(0, b"\x05"), (came + 5 * MS, b"\x15"), (came + 10 * MS + char, b"\x05")]


def test_key_delay_switches_the_transmitter() -> None:
    text = """
main:
  steps:
    - step: one
      send: enq
    - step: two
      send: ack
"""
    side = run(text, more="line: {key_delay: 4 ms}")
    side.run(SECOND)
    char = side.engine.scope.line.chars(1)
    assert side.sent[:2] == [(0, b"RTS"), (4 * MS, b"\x05")]
    assert side.sent[-1] == (8 * MS + 2 * char, b"rts")
    assert [type(item) for item in side.commands] == [SetRts, Send, Send, SetRts]


def test_without_clear_to_send_nothing_is_sent() -> None:
    text = "main:\n  steps:\n    - step: one\n      send: enq"
    side = Side(protocol(text), "client")
    side.do(side.engine.control({"cts": False}, 0))
    side.ask()
    side.run(MS)
    assert side.taken() == []
    side.do(side.engine.control({"cts": True}, side.now))
    side.run(0)
    assert side.taken() == [b"\x05"]


HELD = "line: {clear_time: 2 s}"


def test_a_frame_that_is_held_back_too_long_is_dropped_and_its_exchange_fails() -> None:
    side = Side(protocol("main:\n  steps:\n    - step: one\n      send: enq", more=HELD), "client")
    side.do(side.engine.control({"cts": False}, 0))
    side.ask()
    side.run(2 * SECOND - 1)
    assert side.outcomes == [] or side.outcomes[0].ok, "a step that only sends does not wait for the line"
    side.run(1)
    assert side.seen[-1].reason == "clear-to-send stays off; frames not sent: 1"
    side.do(side.engine.control({"cts": True}, side.now))
    side.run(SECOND)
    assert side.sent == []


def test_the_transmitter_is_switched_on_while_a_frame_is_held_back() -> None:
    more = "line: {clear_time: 2 s, key_delay: 4 ms}"
    side = Side(protocol("main:\n  steps:\n    - step: one\n      send: enq", more=more), "client")
    side.do(side.engine.control({"cts": False}, 0))
    side.ask()
    side.run(SECOND)
    side.do(side.engine.control({"cts": True}, side.now))
    side.run(SECOND)
    assert [data for _, data in side.sent] == [b"RTS", b"\x05", b"rts"]
    side.do(side.engine.control({"cts": False}, side.now))
    side.ask()
    side.run(2 * SECOND)
    assert [data for _, data in side.sent[3:]] == [b"RTS", b"rts"]


def test_a_step_that_waits_fails_or_has_a_handler_if_its_frame_is_held_back() -> None:
    waits = "main:\n  steps:\n    - {step: one, send: enq, receive: [{frame: ack, then: end}], within: 5 s%s}"
    for handler, outcomes in (
        ("", ["held"]),
        (", on_held: {fail: not_clear}", ["not_clear"]),
        (", on_held: again", []),
    ):
        side = Side(protocol(waits % handler, more=HELD), "client")
        side.do(side.engine.control({"cts": False}, 0))
        side.ask()
        side.run(2 * SECOND)
        assert [outcome.outcome for outcome in side.outcomes] == outcomes
    side.run(5 * SECOND)
    assert [outcome.outcome for outcome in side.outcomes] == ["timeout"], "its time limit counts from then on"


def test_a_line_that_is_clear_in_time_sends_and_counts_afresh() -> None:
    waits = "main:\n  steps:\n    - {step: one, send: enq, receive: [{frame: ack, then: end}], retries: 3, on_timeout: resend, within: 3 s}"
    side = Side(protocol(waits, more=HELD), "client")
    side.do(side.engine.control({"cts": False}, 0))
    side.ask()
    side.run(2 * SECOND - 1)
    side.do(side.engine.control({"cts": True}, side.now))
    side.run(0)
    assert side.taken() == [b"\x05"]
    side.do(side.engine.control({"cts": False}, side.now))
    side.run(4 * SECOND)
    assert side.taken() == [] and side.outcomes == []
    side.run(2 * SECOND)
    assert [outcome.outcome for outcome in side.outcomes] == ["held"]


# ---- serving -----------------------------------------------------------------------------------------------


def test_serving_and_judging() -> None:
    text = protocol(
        """
listen:
  local: {asked: frame}
  steps:
    - step: idle
      receive: [{frame: ask, set: {asked: it}, then: next}]
    - step: judge
      serve: {request: asked, check: true}
    - step: verdict
      branch:
        - {when: refusal != 0, send: nak, then: end}
        - {then: next}
    - step: work
      serve: {request: asked, buffer: "h'01 02'"}
      send: reply
    - step: more
      when: len(reply_buffer) > 0
      send: {block: {data: reply_buffer}}
""",
        roles="server: {lanes: {main: {listen: listen}}}",
    )
    server = Echoing(lambda request: FrameValue("yes", {"x": request.fields["x"] + 1}))
    side = Side(text, "server", server=server)
    side.gets(b"\x01\x10")
    side.run(SECOND)
    assert side.taken() == [b"\x02\x11", block(b"\x02\x01")] and len(server.requests) == 1


ANSWERED = """
listen:
  local: {asked: frame, late: u8}
  steps:
    - step: idle
      receive:
        - {frame: ask, set: {asked: it}, then: work}
        - {frame: enq, set: {late: 1}, then: later}
    - step: work
      serve: {request: asked}
      send: ack
    - {step: answer, branch: [{when: asked.x != 0, send: reply, then: idle}, {then: idle}]}
    - {step: later, send: {ask: {x: late + 255}}, then: idle}
"""


def test_a_reply_that_cannot_be_built_is_told_to_the_server_and_nothing_else_is() -> None:
    """Also after an acknowledgement; not for a broadcast, which has no reply, nor after the reply was transmitted."""
    text = protocol(ANSWERED, roles="server: {lanes: {main: {listen: listen}}}")
    server = Echoing(lambda request: FrameValue("yes", {"x": request.fields["x"] + 0xFE}))
    side = Side(text, "server", server=server)
    for data, sent, count in [
        (b"\x01\x01", [b"\x06", b"\x02\xff"], 0),
        (b"\x05", [], 0),
        (b"\x01\x02", [b"\x06"], 1),
        (b"\x05", [], 1),
        (b"\x01\x00", [b"\x06"], 1),
        (b"\x05", [], 1),
    ]:
        side.gets(data)
        side.run(SECOND)
        assert (side.taken(), server.not_answered) == (sent, count), data


INNER = """
  middle: {body: [{const: 08}, {inner: pdu, of: yes}]}
  outer: {from: server, body: [{const: 09}, {inner: pdu, of: middle}]}
"""


@pytest.mark.parametrize("sent", ["{yes: {x: reply.x}}", "{outer: {pdu: {middle: {pdu: reply}}}}"])
def test_a_reply_that_has_gone_out_another_way_is_not_told_to_the_server(sent: str) -> None:
    """A reply that is built again from its fields or sent inside another frame does not count as sent to the server.

    The next reply is reported as usual.
    """
    steps = ANSWERED.replace("send: reply, then: idle", f"send: {sent}, then: spoilt")
    steps += "    - {step: spoilt, send: {ask: {x: asked.x + 255}}, then: idle}\n"
    text = protocol(steps, roles="server: {lanes: {main: {listen: listen}}}").replace("receiver:", f"{INNER}receiver:")
    server = Echoing(lambda request: FrameValue("yes", {"x": request.fields["x"] + 0xFE}))
    side = Side(text, "server", server=server)
    for data, count, told in [(b"\x01\x01", 2, 0), (b"\x01\x02", 1, 1)]:
        side.gets(data)
        side.run(SECOND)
        assert (len(side.taken()), server.not_answered) == (count, told), data


SIDE_BY_SIDE = """
slow:
  local: {asked: frame}
  steps:
    - {step: idle, receive: [{frame: ask, set: {asked: it}, then: next}]}
    - {step: work, serve: {request: asked}, then: next}
    - {step: answer, wait: 100 ms, send: reply, then: idle}
quick:
  local: {asked: frame}
  steps:
    - {step: idle, receive: [{frame: enq, set: {asked: it}, then: next}]}
    - {step: work, serve: {request: asked}, send: reply, then: idle}
"""


def test_a_reply_of_another_lane_meanwhile_hides_none_that_cannot_be_built() -> None:
    text = protocol(SIDE_BY_SIDE, roles="server: {lanes: {one: {listen: slow}, other: {listen: quick}}}")
    server = Echoing(lambda request: FrameValue("yes", {"x": request.fields.get("x", 0) + 0xFE}))
    side = Side(text, "server", server=server)
    side.gets(b"\x01\x02")
    side.gets(b"\x05")
    side.run(SECOND)
    assert (side.taken(), server.not_answered) == ([b"\x02\xfe"], 1)


def test_memory_is_stored_into_and_read() -> None:
    class Memory:
        def __init__(self) -> None:
            self.data = {"M0": b"abcd"}

        def read(self, address: str, size: int) -> bytes:
            return self.data[address][:size]

        def write(self, address: str, data: bytes) -> None:
            self.data[address] = data

    text = """
main:
  steps:
    - step: one
      send: {block: {data: "memory('M0', 2)"}}
      receive: [{frame: block, store: {it.data: M1}, then: end}]
      within: 1 s
"""
    memory = Memory()
    side = run(text, engine={"memory": memory})
    side.gets(block(b"xyz"))
    assert side.taken() == [block(b"ab")] and memory.data["M1"] == b"xyz"


def test_nothing_is_shown_to_nobody() -> None:
    protocol_, codec = compiled(protocol(WORDS))
    from framekit.link.engine import Engine
    from framekit.link.events import Exchange

    engine = Engine(protocol_, codec, "client")
    engine.opened(0)
    assert [type(command) for command in engine.start(Exchange(), 0)] == [Send]


# ---- flush -------------------------------------------------------------------------------------------------

FLUSHING = """
main:
  steps:
    - step: pause
      wait: 10 ms
    - step: one
      flush: {flush}
      send: {{ask: {{x: 0}}}}
      receive:
        - {{frame: block, then: end}}
      within: 100 ms
      on_bad: {{fail: damaged}}
"""


def test_what_came_before_is_forgotten() -> None:
    """Half a block precedes the reply: without flushing, both are one damaged block."""
    for flush, outcome in (("yes", ""), ("no", "damaged")):
        side = run(FLUSHING.format(flush=flush))
        side.gets(b"\x04\x04")
        side.run(20 * MS)
        side.gets(block(b"abc"))
        side.run(SECOND)
        assert [outcome.outcome for outcome in side.outcomes] == [outcome]
