# ruff: noqa: E501 - definitions in YAML
"""The standard procedure, both roles, on virtual time: replies, repeats, time limits, late replies."""

from __future__ import annotations

from typing import Any

import pytest
from link.link_world import MS, SECOND, Echoing, Side, compiled, connect

from framekit.definition.times import NEVER
from framekit.link.events import Reopen, Send
from framekit.link.values import FrameValue
from framekit.link.variables import ParameterError

PING = """
protocol: ping
extends: standard
groups:
  request:
    from: client
    head: [{const: ENQ}, {field: station, type: hex, size: 2}, {field: command, type: ascii, size: 1}]
    tail: [{const: EOT}, {check: sum8, as: hex}]
  reply:
    from: server
    echo: [station, command]
    head: [{const: ACK}, {field: station, type: hex, size: 2}, {field: command, type: ascii, size: 1}]
    tail: [{const: ETX}, {check: sum8, as: hex}]
frames:
  get:   {group: request, where: {command: g}, body: [{field: place, type: hex, size: 4}]}
  put:   {group: request, where: {command: p}, body: [{field: place, type: hex, size: 4}, {field: value, type: hex, size: 4}]}
  got:   {group: reply, where: {command: g}, body: [{field: value, type: hex, size: 4}]}
  done:  {group: reply, where: {command: p}, body: []}
"""


def frame(name: str, **fields: Any) -> bytes:
    _, codec = compiled(PING)
    data: bytes = codec.frames[name].encode(fields)
    return data


def get(place: int = 16, station: int = 1) -> FrameValue:
    return FrameValue("get", {"station": station, "place": place})


def client(**params: Any) -> Side:
    return Side(PING, "client", params=params)


GOT = frame("got", station=1, value=0x1234)
REQUEST = frame("get", station=1, place=16)


def test_request_reply_result() -> None:
    side = client()
    side.ask(get(), expected=("got",))
    side.run(100 * MS)
    side.gets(GOT)
    (outcome,) = side.outcomes
    assert outcome.ok and outcome.reply is not None and outcome.reply.fields["value"] == 0x1234
    assert outcome.raw == GOT and outcome.results["reply"] is outcome.reply
    assert side.taken() == [REQUEST] and side.engine.deadline == NEVER


def test_a_request_is_repeated_unchanged_and_fails_in_the_end() -> None:
    side = client(retries=2, reply_timeout="1 s")
    side.ask(get(), expected=("got",))
    took = side.engine.scope.line.chars(len(REQUEST))
    side.run(10 * SECOND)
    assert [data for _, data in side.sent] == [REQUEST] * 3
    starts = [at for at, _ in side.sent]
    assert starts == [0, took + SECOND, 2 * (took + SECOND)]
    (outcome,) = side.outcomes
    assert (outcome.ok, outcome.outcome) == (False, "no_reply")
    assert [seen.repeated for seen in side.seen if seen.kind == "frame"] == [False, True, True]


def test_the_time_limit_starts_when_the_last_bit_has_left() -> None:
    side = client(reply_timeout="1 s")
    side.do(side.engine.start(_exchange(side), 0))
    assert side.engine.deadline == NEVER
    took = side.engine.scope.line.chars(len(REQUEST))
    side.run(took)
    assert side.engine.deadline == took + SECOND


def _exchange(side: Side) -> Any:
    from framekit.link.events import Exchange

    return Exchange(request=get(), expected=("got",), on_done=side.outcomes.append)


def test_a_damaged_reply_is_asked_for_again() -> None:
    side = client(retries=1)
    side.ask(get(), expected=("got",))
    side.run(50 * MS)
    side.gets(GOT[:-1] + b"0")
    side.run(50 * MS)
    assert side.taken() == [REQUEST, REQUEST]
    side.gets(GOT)
    assert side.outcomes[0].ok and side.reasons("bad") == ["check"]


def test_two_damaged_replies_are_reported() -> None:
    side = client(retries=1)
    side.ask(get(), expected=("got",))
    for _ in range(2):
        side.run(50 * MS)
        side.gets(GOT[:-1] + b"0")
    assert (side.outcomes[0].outcome, side.outcomes[0].cause) == (
        "damaged_reply", "2 replies arrived, all with a wrong check code (expected 39 42, found 39 30)",
    )  # fmt: skip


@pytest.mark.parametrize("wrong", [{"station": 2, "value": 1}, {"station": 1, "command": "g", "value": 1}])
def test_a_client_takes_only_a_reply_that_repeats_the_request(wrong: dict[str, Any]) -> None:
    side = client(reply_timeout="1 s", retries=0)
    side.ask(FrameValue("put", {"station": 1, "place": 2, "value": 3}), expected=("got", "done"))
    side.run(50 * MS)
    side.gets(frame("got", **wrong))
    assert not side.outcomes
    side.gets(frame("done", station=1))
    assert side.outcomes[0].ok and side.outcomes[0].reply.frame == "done"


def test_other_good_frames_are_waited_through() -> None:
    side = client(retries=0)
    side.ask(get(), expected=("got",))
    side.run(10 * MS)
    side.gets(frame("done", station=1) + GOT)
    assert side.outcomes[0].ok


def test_a_late_reply_is_not_taken_for_the_next_one() -> None:
    side = client(retries=0, reply_timeout="100 ms")
    side.ask(get(), expected=("got",))
    side.run(SECOND)
    assert side.outcomes[0].outcome == "no_reply"
    side.gets(frame("got", station=1, value=1))
    assert side.arrived == [] and side.engine.counters.late == 1, "it is known what it answers"
    side.gets(GOT[:5])
    side.ask(get(), expected=("got",))
    assert side.reasons("noise") == [""], "what had begun to come before is dropped"
    side.run(50 * MS)
    side.gets(GOT)
    assert side.outcomes[1].reply.fields["value"] == 0x1234


def test_a_reply_that_breaks_off_is_a_time_out() -> None:
    side = client(retries=1, byte_timeout="50 ms", reply_timeout="1 s")
    side.ask(get(), expected=("got",))
    side.run(20 * MS)
    side.gets(GOT[:-3])
    at = side.now
    side.run(60 * MS)
    assert [data for _, data in side.sent] == [REQUEST, REQUEST]
    assert side.sent[1][0] == at + 50 * MS
    side.run(30 * MS)
    side.gets(GOT)
    assert side.outcomes[0].ok


def test_a_slow_reply_is_no_time_out_as_long_as_bytes_come() -> None:
    side = client(retries=0, byte_timeout="50 ms", reply_timeout="100 ms")
    side.ask(get(), expected=("got",))
    side.run(20 * MS)
    for byte in GOT:
        side.run(40 * MS)
        side.gets(bytes([byte]))
    assert side.outcomes[0].ok


def test_noise_that_looked_like_a_reply_gives_the_time_back() -> None:
    side = client(retries=0, byte_timeout="50 ms", reply_timeout="100 ms")
    side.ask(get(), expected=("got",))
    side.run(side.engine.scope.line.chars(len(REQUEST)) + 60 * MS)
    side.gets(b"\x06")
    side.run(20 * MS)
    side.gets(b"zz!")
    assert not side.outcomes
    side.run(35 * MS)
    assert not side.outcomes, "20 ms and some were given back"


def test_exchanges_run_one_after_the_other() -> None:
    side = client()
    side.ask(get(1), expected=("got",))
    side.ask(get(2), expected=("got",))
    side.run(50 * MS)
    assert side.taken() == [frame("get", station=1, place=1)]
    side.gets(GOT)
    side.run(50 * MS)
    assert side.taken() == [frame("get", station=1, place=2)] and len(side.outcomes) == 1
    side.gets(GOT)
    assert [outcome.ok for outcome in side.outcomes] == [True, True]


def test_cancelling() -> None:
    side = client()
    first, second = side.ask(get(1), expected=("got",)), side.ask(get(2), expected=("got",))
    side.do(side.engine.cancel(second, side.now))
    assert side.outcomes[0].outcome == "cancelled"
    side.do(side.engine.cancel(first, side.now))
    assert side.outcomes[1].outcome == "cancelled"
    side.run(10 * SECOND)
    assert len(side.taken()) == 1 and len(side.outcomes) == 2


def test_what_is_given_up_is_waited_for_and_not_repeated() -> None:
    side = client(retries=3, reply_timeout=500 * MS)
    first, second = side.ask(get(16), expected=("got",)), side.ask(get(32), expected=("got",))
    side.run(100 * MS)
    side.do(side.engine.give_up(first, side.now))
    assert side.outcomes == [] and len(side.sent) == 1
    side.run(SECOND)
    assert [data for _, data in side.sent[:2]] == [REQUEST, frame("get", station=1, place=32)]
    assert not side.outcomes[0].ok
    side.gets(GOT)
    assert len(side.outcomes) == 1, "the reply to the first request looks the same"
    side.run(200 * MS)
    side.gets(GOT)
    assert side.outcomes[1].ok, "two came quickly one after the other"
    side.run(11 * SECOND)
    third, fourth = side.ask(get(48), expected=("got",)), side.ask(get(64), expected=("got",))
    side.run(10 * MS)
    side.do(side.engine.give_up(fourth, side.now))
    assert [outcome.outcome for outcome in side.outcomes[2:]] == ["cancelled"], "one that had not begun ends at once"
    side.do(side.engine.give_up(third, side.now))
    side.gets(GOT)
    assert side.outcomes[3].ok, "a reply in time is taken"
    assert second is not third and side.next_time() > side.now + SECOND


def test_a_lost_connection_fails_what_runs_and_what_waits() -> None:
    side = client()
    side.ask(get(1))
    side.ask(get(2))
    side.do(side.engine.closed(5, "cable pulled"))
    assert [outcome.outcome for outcome in side.outcomes] == ["closed", "closed"]
    side.ask(get(3))
    assert side.outcomes[2].outcome == "closed"
    side._waiting.clear()
    side._leaving = None
    side.sent.clear()
    side.do(side.engine.opened(10))
    side.ask(get(16), expected=("got",))
    assert side.taken() == [], "the reply to the request before may still come, by a gateway"
    side.run(3 * SECOND)
    assert side.taken()[0] == REQUEST


def test_values_that_cannot_be_sent_end_the_exchange() -> None:
    side = client()
    side.ask(FrameValue("get", {"station": 1}), expected=("got",))
    assert side.outcomes[0].outcome == "expression" and "place" in side.outcomes[0].cause
    assert side.reasons("trouble")


# ---- the other side -----------------------------------------------------------------------------------------


def server(**options: Any) -> Side:
    answering = Echoing(lambda request: FrameValue("got", {"value": request.fields["place"] + 1}))
    return Side(PING, "server", own=1, server=answering, **options)


def test_a_server_answers_its_own_station_and_copies_what_is_repeated() -> None:
    side = server()
    side.gets(frame("get", station=2, place=7))
    side.run(SECOND)
    assert side.taken() == []
    side.gets(frame("get", station=1, place=7))
    side.run(SECOND)
    assert side.taken() == [frame("got", station=1, value=8)]


def test_a_server_waits_its_delay_and_then_serves_the_next() -> None:
    side = server(params={"answer_delay": "20 ms"})
    side.gets(REQUEST)
    at = side.now
    side.gets(REQUEST)
    side.run(SECOND)
    assert side.sent[0][0] == at + 20 * MS
    assert len(side.sent) == 2


def test_damage_and_noise_do_not_disturb_a_server() -> None:
    side = server()
    side.gets(b"\x00\xff" + REQUEST[:-1] + b"?" + b"\x05\x05" + REQUEST)
    side.run(SECOND)
    assert side.taken() == [frame("got", station=1, value=17)]


def test_client_and_server_talk() -> None:
    one, other = client(), server()
    for place in range(5):
        one.ask(get(place), expected=("got",))
    connect(one, other, 5 * SECOND)
    assert [outcome.reply.fields["value"] for outcome in one.outcomes if outcome.reply] == [1, 2, 3, 4, 5]


def test_client_and_server_talk_over_a_bad_line() -> None:
    count = 0

    def damage(data: bytes) -> bytes:
        nonlocal count
        count += 1
        return data[:3] + b"\x00" + data[4:] if count % 3 == 0 else data

    one, other = client(retries=5), server()
    for place in range(6):
        one.ask(get(place), expected=("got",))
    connect(one, other, 120 * SECOND, damage)
    assert [outcome.reply.fields["value"] for outcome in one.outcomes if outcome.reply] == [1, 2, 3, 4, 5, 6]


def test_the_same_events_give_the_same_commands() -> None:
    def once() -> list[tuple[int, bytes]]:
        one, other = client(), server()
        for place in range(3):
            one.ask(get(place), expected=("got",))
        connect(one, other, SECOND)
        return one.sent + other.sent

    assert once() == once()


# ---- frames alone ------------------------------------------------------------------------------------------

ALONE = """
protocol: alone
frames:
  a: {body: [{const: STX}, {data: x, size: 2}, {check: sum8}]}
  b: {body: [{const: ETX}]}
"""


def test_frames_alone_are_sent_and_received() -> None:
    side = Side(ALONE, None)
    left: list[int] = []
    side.do(side.engine.send_frame("a", 0, {"x": b"hi"}, on_sent=lambda: left.append(side.now)))
    side.run(SECOND)
    assert side.taken() == [b"\x02hi\xd3"] and left == [side.engine.scope.line.chars(4)]
    side.gets(b"\x02hi\xd3\x02hi\xd4\x03")
    assert [value.frame for value in side.arrived] == ["a", "b"]
    assert side.reasons("bad") == ["check"] and side.engine.counters.bad == 1
    with pytest.raises(ValueError, match="x"):
        side.engine.send_frame("a", 0, {})


# ---- parameters, streams -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("params", "words"),
    [
        ({"retries": 11}, "0..10"),
        ({"retries": "many"}, "whole number"),
        ({"reply_timeout": "1 ms"}, "10 ms"),
        ({"reply_timeout": "soon"}, "not a time"),
        ({"colour": 1}, "no such parameter"),
    ],
)
def test_parameters_are_checked(params: dict[str, Any], words: str) -> None:
    with pytest.raises(ParameterError, match=words):
        client(**params)


STREAM = """
protocol: stream
line: {kind: stream, tcp: 1}
params: {most: {type: number, default: 2}}
state: {number: {type: u16}}
frames:
  ask:    {from: client, body: [{field: number, type: u16}, {const: 00}, {length: n, type: u8, of: [data]}, {data: data, size: n}]}
  answer: {from: server, echo: [number], body: [{field: number, type: u16}, {const: 01}, {length: n, type: u8, of: [data]}, {data: data, size: n}]}
receiver: {resync: never}
sequences:
  exchange:
    takes: [request]
    gives: {reply: found}
    local: {found: frame}
    steps:
      - step: ask
        set: {number: number + 1, request.number: number}
        send: request
        receive:
          - {frame: expected, set: {found: it}, then: end}
        within: 1 s
        on_timeout: {fail: no_reply}
roles:
  client: {lanes: {main: {exchange: exchange, at_once: most}}}
"""


def answer(number: int, data: bytes) -> bytes:
    _, codec = compiled(STREAM)
    built: bytes = codec.frames["answer"].encode({"number": number, "data": data})
    return built


def test_several_exchanges_at_once_are_matched_by_their_number() -> None:
    side = Side(STREAM, "client")
    for data in (b"a", b"b", b"c"):
        side.ask(FrameValue("ask", {"data": data}), expected=("answer",))
    side.run(0)
    assert [data[:2] for data in side.taken()] == [b"\0\1", b"\0\2"]
    side.gets(answer(2, b"B"), whole=True)
    assert [outcome.reply.fields["data"] for outcome in side.outcomes if outcome.reply] == [b"B"]
    side.run(0)
    assert [data[:2] for data in side.taken()] == [b"\0\3"]
    side.gets(answer(9, b"?") + answer(3, b"C") + answer(1, b"A"), whole=True)
    assert [outcome.reply.fields["data"] for outcome in side.outcomes if outcome.reply] == [b"B", b"C", b"A"]


def test_a_stream_out_of_step_is_opened_again() -> None:
    side = Side(STREAM, "client")
    side.ask(FrameValue("ask", {"data": b"a"}), expected=("answer",))
    side.run(0)
    side.gets(b"\x00\x01\x07\x00", whole=True)
    assert [type(command) for command in side.commands] == [Send, Reopen]
    side.gets(answer(1, b"A"), whole=True)
    assert not side.outcomes


def connected(session: str) -> Side:
    """Return a client whose session begins with a request of its own."""
    opening = (
        "  hello:\n    steps:\n      - step: ask\n        send: {ask: {number: 0, data: h'21'}}\n"
        "        receive: [{frame: answer, then: end}]\n        within: 1 s\n        on_timeout: {fail: nobody}\n"
    )
    text = STREAM.replace("sequences:\n", f"sessions: {{s: {{open: [hello], {session}}}}}\nsequences:\n{opening}")
    return Side(text.replace("client: {lanes", "client: {session: s, lanes"), "client")


def test_a_connection_whose_session_is_lost_is_opened_again() -> None:
    side = connected("lost_by: [no_reply], reconnect: yes")
    side.ask(FrameValue("ask", {"data": b"a"}), expected=("answer",))
    side.run(0)
    side.gets(answer(0, b"!"), whole=True)
    side.run(2 * SECOND)
    assert [outcome.outcome for outcome in side.outcomes] == ["no_reply"]
    assert side.commands[-1] == Reopen("the session is lost: no_reply")


def test_a_connection_whose_session_cannot_be_opened_is_opened_again() -> None:
    side = connected("lost_by: [no_reply], reconnect: yes")
    side.ask(FrameValue("ask", {"data": b"a"}), expected=("answer",))
    side.run(2 * SECOND)
    assert [outcome.outcome for outcome in side.outcomes] == ["nobody"]
    assert side.commands[-1] == Reopen("the session is lost: nobody")


def test_a_connection_stays_where_only_its_session_is_lost() -> None:
    side = connected("lost_by: [no_reply]")
    side.ask(FrameValue("ask", {"data": b"a"}), expected=("answer",))
    side.run(2 * SECOND)
    assert [type(command) for command in side.commands] == [Send]
