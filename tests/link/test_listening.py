# ruff: noqa: E501 - definitions in YAML
"""Listeners that restart at their end, lanes that reuse a run, and the order of simultaneous ends."""

from __future__ import annotations

from link.link_world import MS, SECOND, Echoing, Side
from link.test_engine_steps import FRAMES

from framekit.link.events import Exchange
from framekit.link.values import FrameValue

LISTENING = f"""
protocol: listening
{FRAMES}
sequences:
  listen:
    local: {{asked: frame, count: u8}}
    steps:
      - step: idle
        receive:
          - {{frame: enq, set: {{count: count + 1}}, at_most: 2, else: {{then: end}}, then: again}}
          - {{frame: ask, set: {{asked: it}}, then: next}}
      - {{step: work, serve: {{request: asked}}, send: reply}}
      - {{step: rest, send: {{ask: {{x: count}}}}}}
  main:
    steps:
      - {{step: one, send: ack, receive: [{{frame: nak, then: end}}], within: 100 ms}}
roles:
  server: {{lanes: {{main: {{listen: listen, exchange: main}}}}}}
"""


def replies_to(side: Side, x: int) -> list[bytes]:
    side.gets(bytes([1, x]))
    side.run(SECOND)
    return side.taken()


def server() -> Echoing:
    return Echoing(lambda request: FrameValue("yes", {"x": request.fields["x"] + 1}))


def test_a_listener_begins_anew_in_its_generator_with_new_variables() -> None:
    side = Side(LISTENING, "server", server=server())
    (run,) = side.engine.machine.order
    level = run.top
    generator, exchange = level.generator, level.x
    for x in (0x10, 0x20, 0x30):
        side.gets(b"\x05\x05")
        assert replies_to(side, x) == [bytes([2, x + 1]), b"\x01\x02"], "counters and variables begin anew"
        assert run.top is level and (level.generator, level.x) == (generator, exchange)
        waits_without = (exchange.request, exchange.reply, exchange.taken, exchange.last_sent, exchange.buffer)
        assert waits_without == (None, None, None, None, b"")


def test_a_listener_that_a_row_ends_begins_anew_too() -> None:
    side = Side(LISTENING, "server", server=server())
    for _ in range(3):
        side.gets(b"\x05\x05\x05")  # the third frame ends the run, so its counter starts again
    assert replies_to(side, 1) == [b"\x02\x02", b"\x01\x00"]
    assert side.reasons("trouble") == []


def test_a_listener_that_ends_leaves_its_lane_to_an_exchange_that_waits() -> None:
    def answer(request: FrameValue) -> FrameValue:
        if request.fields["x"] == 0x10:
            side.engine.start(Exchange(on_done=side.outcomes.append), side.now)
        return FrameValue("yes", {"x": request.fields["x"] + 1})

    side = Side(LISTENING, "server", server=Echoing(answer))
    side.gets(b"\x01\x10")
    side.run(20 * MS)
    assert side.taken() == [b"\x02\x11", b"\x01\x00", b"\x06"], "what it has begun is sent first"
    side.gets(b"\x15")
    side.run(MS)
    assert [outcome.ok for outcome in side.outcomes] == [True]
    assert replies_to(side, 0x40) == [b"\x02\x41", b"\x01\x00"], "and then it listens again"


SIDE_BY_SIDE = f"""
protocol: side_by_side
line: {{late: 0 ms}}
{FRAMES}
sequences:
  first: {{steps: [{{step: one, send: ack, receive: [{{frame: 'yes', then: end}}], within: 100 ms}}]}}
  second: {{steps: [{{step: one, send: nak, receive: [{{frame: 'no', then: end}}], within: 100 ms}}]}}
roles:
  client: {{lanes: {{one: {{exchange: first}}, two: {{exchange: second}}}}}}
"""


def test_runs_that_end_at_once_are_reported_in_the_order_of_their_lanes_and_before_a_lane_goes_on() -> None:
    side, events = Side(SIDE_BY_SIDE, "client"), list[str]()
    later = Exchange("first", on_done=lambda outcome: events.append(f"later {outcome.outcome}"))

    def first_ended(outcome: object) -> None:
        events.append("first")
        side.engine.cancel(second, side.now)
        side.engine.start(later, side.now)

    second = Exchange("second", on_done=lambda outcome: events.append(f"second {outcome.outcome}"))
    side.do(side.engine.start(second, side.now))
    side.do(side.engine.start(Exchange("first", on_done=first_ended), side.now))
    side.run(20 * MS)
    side.do(side.engine.closed(side.now, "unplugged"))
    assert events == ["first", "second closed", "later closed"], (
        "the second one has ended: it can't be cancelled any more"
    )


def test_runs_whose_times_run_out_at_once_are_reported_in_the_order_of_their_lanes() -> None:
    side, events = Side(SIDE_BY_SIDE, "client"), list[str]()
    for name in ("second", "first"):  # the second lane starts, so its run is the older run
        side.do(side.engine.start(Exchange(name, on_done=lambda outcome, name=name: events.append(name)), side.now))
    side.run(20 * MS)
    deadlines = {run.deadline for run in side.engine.machine.order}
    assert len(deadlines) == 2, "the second request has left later"
    for run in side.engine.machine.order:
        run.deadline = max(deadlines)
    side.run(2 * SECOND)
    assert events == ["first", "second"]


# ---- a run that is used again --------------------------------------------------------------------------------


def test_a_run_that_is_used_again_brings_nothing_from_its_first_exchange() -> None:
    side = Side(SIDE_BY_SIDE, "client")
    side.ask(run="first")
    side.gets(b"\x02")  # half a frame, until the time is up
    side.run(SECOND)
    (run,) = side.engine.machine.order
    assert (side.outcomes[-1].outcome, side.outcomes[-1].cause) == (
        "timeout", "a frame began and was not completed in time",
    )  # fmt: skip
    side.ask(run="first")
    assert side.engine.machine.order == (run,), "its place in the order is kept"
    side.run(SECOND)
    assert (side.outcomes[-1].outcome, side.outcomes[-1].cause) == ("timeout", "nothing came in time")
    side.ask(run="first")
    side.gets(b"\x02\x07")
    assert side.outcomes[-1].ok and side.outcomes[-1].cause == ""


def test_frames_that_come_by_themselves_are_handed_over_whether_a_run_stands_by_or_not() -> None:
    side = Side(SIDE_BY_SIDE, "client")
    for exchanges in range(3):
        side.gets(b"\x05")
        side.run(20 * MS)
        assert [value.frame for value in side.arrived] == ["enq"] * (exchanges + 1)
        assert side.reasons("not_taken") == [], "nothing waits: a run that is over does not count"
        side.ask(run="first")
        side.gets(b"\x02\x01")
        assert len(side.outcomes) == exchanges + 1 and side.outcomes[-1].ok


GIVING_WAY = SIDE_BY_SIDE.replace(
    "one: {exchange: first}", "one: {exchange: first, listen: idle}"
).replace("sequences:\n", "sequences:\n  idle: {steps: [{step: one, receive: [{frame: enq, then: end}]}]}\n")  # fmt: skip


def test_a_lane_that_listens_gets_its_listener_back_beside_a_run_that_stands_by() -> None:
    side = Side(GIVING_WAY, "client")
    for turn in range(3):
        for name, reply in (("second", b"\x03\x01"), ("first", b"\x02\x01")):
            side.ask(run=name)
            side.gets(reply)
        assert [outcome.ok for outcome in side.outcomes] == [True, True] * (turn + 1)
        live = [run.kind for run in side.engine.machine.order if run.top is not None]
        assert live == ["listen"] and side.engine.machine.live == 1
        side.gets(b"\x05")
        side.run(MS)
        assert side.arrived == [] and side.reasons("not_taken") == [], "the listener takes it"


# ---- pauses that depend on who waits -------------------------------------------------------------------------

PAUSES = f"""
protocol: pauses
line: {{late: 0 ms}}
{FRAMES.replace("quiet: 3 chars", "quiet: 3 chars, gap: 10 ms")}
sequences:
  usual: {{steps: [{{step: one, send: ack, receive: [{{frame: 'yes', then: end}}], within: 200 ms}}]}}
  patient: {{steps: [{{step: one, send: nak, receive: [{{frame: 'no', then: end}}], within: 200 ms, gap: 60 ms}}]}}
roles:
  client: {{lanes: {{one: {{exchange: usual}}, two: {{exchange: patient}}}}}}
"""


def replied(side: Side, reply: bytes, pause: int) -> bool:
    """Deliver a reply with a pause after its first byte; return whether the last exchange has succeeded."""
    before = len(side.outcomes)
    side.gets(reply[:1])
    side.run(pause)
    side.gets(reply[1:])
    side.run(SECOND)
    return [outcome.ok for outcome in side.outcomes[before:]][-1]


def test_the_step_that_waits_decides_how_long_pauses_in_a_frame_may_be_and_only_while_it_waits() -> None:
    side = Side(PAUSES, "client")
    for _ in range(2):
        side.ask(run="usual")
        assert not replied(side, b"\x02\x01", 20 * MS), "the receiver's gap holds"
        side.ask(run="patient")
        assert replied(side, b"\x03\x01", 20 * MS), "the step has a gap of its own"
        side.ask(run="patient")
        assert not replied(side, b"\x03\x01", 90 * MS)
    side.ask(run="usual")
    assert replied(side, b"\x02\x01", 5 * MS)


def test_a_step_with_a_gap_of_its_own_beside_another_lets_the_frames_of_both_pause() -> None:
    side = Side(PAUSES, "client")
    side.ask(run="patient")
    side.ask(run="usual")
    side.gets(b"\x02")
    side.run(20 * MS)
    side.gets(b"\x01")
    assert [outcome.ok for outcome in side.outcomes] == [True], "while both wait no pause ends a frame"
    side.gets(b"\x03\x01")
    assert [outcome.ok for outcome in side.outcomes] == [True, True]
