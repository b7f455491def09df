# ruff: noqa: E501 - definitions in YAML
"""Parallel lanes, queues, delivered frames, sessions, `ask` steps, inner frames, and steps that do not listen."""

from __future__ import annotations

from typing import Any

from link.link_world import MS, SECOND, Echoing, Side, compiled, connect

from framekit.definition.times import NEVER
from framekit.link.events import Exchange, Outcome, Send
from framekit.link.values import FrameValue

# ---- two lanes on one line: messages with acknowledgements, commands and replies matched by their number ------------

DUPLEX = """
protocol: duplex
params: {most: {type: number, default: 2}, reply_time: {type: time, default: 2 s}}
state: {number: {type: u8}, sent: {type: u8, publish: yes}}
queues:
  outbox: {holds: {packet: frame}, size: 4}
  inbox:  {holds: {packet: frame}, size: 2}
groups:
  packet: {head: [{field: kind, type: u8}, {field: number, type: u8}]}
frames:
  message: {body: [{const: STX}, {inner: packet, of: [command, reply]}, {const: ETX}, {check: sum8}]}
  command: {group: packet, where: {kind: 1}, body: [{field: x, type: u8}]}
  reply:   {group: packet, where: {kind: 2}, body: [{field: y, type: u8}], echo: [number]}
  ack:     {body: [{const: ACK}]}
  nak:     {body: [{const: NAK}]}
receiver: {quiet: 3 chars, resync: after_frame}
sequences:
  transmitter:
    local: {item: record}
    steps:
      - step: idle
        receive:
          - {queue: outbox, set: {item: it}, then: next}
          - {frame: [ack, nak], then: again}
      - step: send
        send: {message: {packet: item.packet}}
        receive:
          - {frame: ack, set: {sent: sent + 1}, then: end}
          - {frame: nak, then: resend, at_most: 2, else: {then: lost}}
        within: 300 ms
        on_timeout: {then: resend, at_most: 2, else: {then: lost}}
      - step: lost
        branch:
          - {when: item.packet.kind == 2, then: end}
          - {deliver: {reply: {number: item.packet.number, y: 255}}, then: end}
  receiver:
    local: {packet: frame}
    steps:
      - step: hunt
        receive:
          - {frame: message, set: {packet: it.packet}, then: next}
        on_bad: {send: nak, then: again}
        on_noise: again
      - step: accept
        branch:
          - {when: packet.frame == 'reply', send: ack, deliver: packet, then: end}
          - {when: full(inbox), send: nak, then: end}
          - {send: ack, put: {inbox: {packet: packet}}, then: end}
  command:
    takes: [request]
    gives: {reply: found}
    local: {found: frame}
    steps:
      - step: ask
        set: {number: number + 1, request.number: number}
        put: {outbox: {packet: request}}
        receive:
          - {frame: reply, set: {found: it}, then: end}
        within: reply_time
        on_timeout: {fail: no_reply}
  executor:
    local: {asked: frame}
    steps:
      - step: idle
        receive: [{queue: inbox, set: {asked: it.packet}, then: next}]
      - step: work
        wait: 20 ms
        serve: {request: asked}
        put: {outbox: {packet: reply}}
roles:
  full:
    lanes:
      sender:   {listen: transmitter}
      receiver: {listen: receiver}
      commands: {exchange: command, at_once: most}
      executor: {listen: executor}
"""


def message(frame: str, **fields: Any) -> bytes:
    _, codec = compiled(DUPLEX)
    data: bytes = codec.frames["message"].encode({"packet": {frame: fields}})
    return data


def full(**options: Any) -> Side:
    answering = Echoing(
        lambda request: FrameValue("reply", {"number": request.fields["number"], "y": request.fields["x"] + 1})
    )
    return Side(DUPLEX, "full", server=answering, **options)


def command(x: int) -> FrameValue:
    return FrameValue("command", {"x": x})


def test_commands_go_through_queues_and_their_replies_are_matched() -> None:
    side = full()
    for x in (10, 20, 30):
        side.ask(command(x))
    side.run(10 * MS)
    assert side.taken() == [message("command", number=1, x=10)]
    side.gets(b"\x06")
    side.run(20 * MS)
    assert side.taken() == [message("command", number=2, x=20)], "two at once, the third waits"
    side.gets(b"\x06" + message("reply", number=2, y=21))
    assert [outcome.reply.fields["y"] for outcome in side.outcomes if outcome.reply] == [21]
    side.run(20 * MS)
    assert sorted(side.taken()) == sorted([b"\x06", message("command", number=3, x=30)])
    side.gets(b"\x06" + message("reply", number=9, y=9) + message("reply", number=1, y=11))
    assert [outcome.reply.fields["y"] for outcome in side.outcomes if outcome.reply] == [21, 11]
    side.run(10 * SECOND)
    assert side.outcomes[2].outcome == "no_reply" and side.engine.status() == {"sent": 3}


def test_what_cannot_be_delivered_comes_back_as_a_reply() -> None:
    side = full()
    side.ask(command(1))
    side.run(1500 * MS)
    assert len(side.taken()) == 3
    assert side.outcomes[0].ok and side.outcomes[0].reply.fields["y"] == 255


def test_commands_of_the_other_side_are_served_meanwhile() -> None:
    side = full(params={"most": 1})
    side.ask(command(1))
    side.run(10 * MS)
    side.gets(message("command", number=77, x=4))
    side.run(50 * MS)
    assert side.taken() == [message("command", number=1, x=1), b"\x06"]
    side.gets(b"\x06")
    side.run(50 * MS)
    assert side.taken() == [message("reply", number=77, y=5)]


def test_a_full_queue_is_answered() -> None:
    side = full()
    for number in range(4):
        side.gets(message("command", number=number, x=0))
    side.run(5 * MS)
    short = [data for data in side.taken() if len(data) == 1]
    assert short == [b"\x06", b"\x06", b"\x06", b"\x15"], "one is being served, two wait, the fourth finds no room"


def test_what_is_due_at_once_goes_out_in_one_piece_on_a_stream() -> None:
    for is_stream, sent in ((True, [b"\x06\x06"]), (False, [b"\x06", b"\x06"])):
        side = full(is_stream=is_stream)
        side.gets(message("command", number=1, x=4) + message("command", number=2, x=5), whole=True)
        side.run(10 * MS)
        assert side.taken() == sent
        side.run(20 * MS)
        assert side.taken() == [message("reply", number=1, y=5)], "the line is free again"


def test_two_full_sides_talk_both_ways() -> None:
    one, other = full(), full()
    for x in range(4):
        one.ask(command(x))
        other.ask(command(100 + x))
    connect(one, other, 20 * SECOND)
    assert sorted(outcome.reply.fields["y"] for outcome in one.outcomes if outcome.reply) == [1, 2, 3, 4]
    assert sorted(outcome.reply.fields["y"] for outcome in other.outcomes if outcome.reply) == [101, 102, 103, 104]


def test_bad_frames_go_to_the_lane_that_names_them() -> None:
    side = full()
    side.gets(message("command", number=1, x=1)[:-1] + b"\x00")
    side.run(10 * MS)
    assert side.taken() == [b"\x15"] and side.reasons("bad") == ["check"]


CARRIED = """
protocol: carried
state: {seq: {type: u8}}
groups:
  request: {head: [{const: 01}, {field: seq, type: u8, build: seq}]}
  reply:   {head: [{const: 02}, {field: seq, type: u8}], echo: [seq]}
frames:
  box:  {body: [{const: STX}, {inner: body, of: [request, reply]}, {check: sum8}]}
  ask:  {group: request, body: [{field: x, type: u8}]}
  tell: {group: reply, body: [{field: y, type: u8}]}
receiver: {quiet: 3 chars}
sequences:
  exchange:
    takes: [request]
    gives: {reply: found}
    local: {found: frame}
    steps:
      - step: ask
        set: {seq: seq + 1}
        send: {box: {body: request}}
        receive: [{frame: box, when: it.body.frame in expected, set: {found: it.body}, then: end}]
        within: 1 s
  listen:
    local: {request: frame}
    steps:
      - step: idle
        receive: [{frame: box, set: {request: it.body}, then: next}]
      - step: answer
        call: deliver
        with: {message: {box: {body: {tell: {y: request.x}}}}}
  deliver:
    takes: [message]
    steps:
      - step: one
        send: message
roles:
  client: {lanes: {main: {exchange: exchange}}}
  server: {lanes: {main: {listen: listen}}}
"""


def test_what_a_carried_request_was_computed_as_has_to_be_repeated() -> None:
    one, other = Side(CARRIED, "client"), Side(CARRIED, "server")
    one.engine.scope.set("seq", 6)
    one.ask(FrameValue("ask", {"x": 3}), expected=("tell",))
    connect(one, other, 100 * MS)
    assert one.outcomes[0].reply.fields == {"seq": 7, "y": 3}
    one.ask(FrameValue("ask", {"x": 4}), expected=("tell",))
    one.run(50 * MS)
    one.gets(b"\x02\x02\x09\x04\x11")
    assert len(one.outcomes) == 1, "another number: a reply to something else"
    one.gets(b"\x02\x02\x08\x04\x10")
    assert one.outcomes[1].ok


# ---- listening gives way; rooms; holding ----------------------------------------------------------------------------

PEER = """
protocol: peer
queues: {jobs: {holds: {x: u8}, size: 1}}
frames:
  enq: {body: [{const: ENQ}]}
  ack: {body: [{const: ACK}]}
  job: {body: [{const: 01}, {field: x, type: u8}]}
  eot: {body: [{const: EOT}]}
receiver: {quiet: 3 chars}
sequences:
  call:
    steps:
      - step: ask
        send: enq
        receive: [{frame: ack, then: next}]
        within: 100 ms
      - step: close
        send: eot
  answer:
    steps:
      - step: idle
        receive:
          - {frame: enq, send: ack, then: next}
          - {frame: job, when: full(jobs), then: hold}
          - {frame: job, put: {jobs: {x: it.x}}, send: ack, then: again}
      - step: busy
        receive: [{frame: eot, then: end}]
        within: 1 s
        on_timeout: {then: end}
      - step: hold
        receive: [{room: jobs, send: ack, then: end}]
  work:
    local: {item: record}
    steps:
      - step: idle
        receive: [{queue: jobs, when: it.x != 9, set: {item: it}, then: next}]
      - step: doing
        wait: 100 ms
roles:
  peer: {lanes: {main: {exchange: call, listen: answer}, worker: {listen: work}}}
"""


def test_listening_gives_way_in_its_first_step_only() -> None:
    side = Side(PEER, "peer")
    side.ask()
    assert side.taken() == [b"\x05"], "it was idle"
    side.run(10 * MS)
    side.gets(b"\x06")
    side.run(10 * MS)
    side.gets(b"\x05")
    side.ask()
    side.run(500 * MS)
    assert side.taken() == [b"\x04", b"\x06"], "in a conversation: the exchange waits"
    side.gets(b"\x04")
    side.run(0)
    assert side.taken() == [b"\x05"]


def test_rows_wait_for_items_and_for_room() -> None:
    side = Side(PEER, "peer")
    side.gets(b"\x01\x01" + b"\x01\x02")
    side.run(1 * MS)
    assert side.taken() == [b"\x06", b"\x06"], "one at work, one in the queue"
    side.gets(b"\x01\x03")
    side.run(50 * MS)
    assert side.taken() == []
    side.run(60 * MS)
    assert side.taken() == [b"\x06"], "there was room when the first was done"


def test_an_item_that_does_not_fit_stays_in_the_queue() -> None:
    side = Side(PEER, "peer")
    side.gets(b"\x01\x09")
    side.run(SECOND)
    assert side.engine.machine.queues.items["jobs"][0] == {"x": 9}


# ---- sessions -------------------------------------------------------------------------------------------------------

SESSION = """
protocol: session
state: {token: {scope: session, type: u8, initial: 7}, opened: {type: u8}}
frames:
  hello:   {from: client, body: [{const: 01}, {field: station, type: u8}]}
  welcome: {from: server, body: [{const: 02}, {field: token, type: u8}]}
  bye:     {from: client, body: [{const: 03}]}
  ask:     {from: client, body: [{const: 04}, {field: x, type: u8}, {field: token, type: u8}]}
  answer:  {from: server, body: [{const: 05}, {field: y, type: u8}]}
  refused: {from: server, body: [{const: 06}]}
  ping:    {from: client, body: [{const: 07}]}
  pong:    {from: server, body: [{const: 08}]}
receiver: {quiet: 3 chars}
sequences:
  attach:
    steps:
      - step: hello
        send: {hello: {station: station}}
        receive: [{frame: welcome, set: {token: it.token}, then: end}]
        within: 100 ms
        on_timeout: {fail: nobody}
  count:
    steps:
      - step: one
        set: {opened: opened + 1}
  leave:
    steps:
      - step: bye
        send: bye
  work:
    takes: [request]
    gives: {reply: found}
    local: {found: frame}
    steps:
      - step: ask
        send: {ask: {x: request.x, token: token}}
        receive:
          - {frame: answer, set: {found: it}, then: end}
          - {frame: refused, set: {found: it}, then: end}
        within: 100 ms
        on_timeout: {fail: no_reply}
  plain:
    steps:
      - step: one
        send: {ask: {x: 0, token: token}}
  alive:
    steps:
      - step: ping
        send: ping
        receive: [{frame: pong, then: end}]
        within: 100 ms
sessions:
  link: {open: [attach, count], close: [leave], one_station: yes, keep_alive: {after: 1 s, run: alive}, lost_by: any}
roles:
  client: {session: link, lanes: {main: {exchange: [work, plain]}}}
"""


def work(x: int) -> FrameValue:
    return FrameValue("ask", {"x": x})


def opened() -> Side:
    side = Side(SESSION, "client")
    side.ask(work(1), station=9)
    side.run(10 * MS)
    assert side.taken() == [b"\x01\x09"]
    side.gets(b"\x02\x55")
    side.run(10 * MS)
    assert side.taken() == [b"\x04\x01\x55"]
    side.gets(b"\x05\x01")
    return side


def test_a_session_is_opened_once() -> None:
    side = opened()
    side.ask(work(2), station=9)
    side.run(10 * MS)
    assert side.taken() == [b"\x04\x02\x55"] and side.engine.scope["opened"] == 1
    side.gets(b"\x06")
    side.ask(work(3), station=9)
    side.run(10 * MS)
    assert side.taken() == [b"\x04\x03\x55"], "a refusal does not end it"


def test_another_station_closes_it_first() -> None:
    side = opened()
    side.ask(work(2), station=8)
    side.run(10 * MS)
    assert side.taken() == [b"\x03", b"\x01\x08"]
    assert side.engine.scope["token"] == 7, "session variables begin anew"
    side.gets(b"\x02\x66")
    side.run(10 * MS)
    assert side.taken() == [b"\x04\x02\x66"]


def test_a_failure_ends_it() -> None:
    side = opened()
    side.ask(work(2), station=9)
    side.run(SECOND // 2)
    assert side.outcomes[1].outcome == "no_reply" and not side.engine.session.is_open
    side.taken()
    side.ask(work(3), station=9)
    side.run(SECOND // 2)
    assert side.taken() == [b"\x01\x09"]
    assert side.outcomes[2].outcome == "nobody", "an exchange whose session cannot be opened fails as that did"


def test_it_is_kept_alive() -> None:
    side = opened()
    quiet_from = side.now
    side.run(SECOND - 1)
    assert side.taken() == []
    side.run(10 * MS)
    assert side.sent == [(quiet_from + SECOND, b"\x07")]
    side.gets(b"\x08")
    assert side.engine.deadline == side.now + SECOND
    side.run(3 * SECOND)
    assert not side.engine.session.is_open, "nobody answered"
    assert side.engine.deadline == NEVER


def test_outside_a_session() -> None:
    side = opened()
    side.ask(run="plain", outside_session=True)
    side.run(50 * MS)
    assert side.taken() == [b"\x03", b"\x04\x00\x07"] and not side.engine.session.is_open


def test_closing() -> None:
    side = opened()
    side.do(side.engine.close_session(side.now))
    side.run(10 * MS)
    assert side.taken() == [b"\x03"] and not side.engine.session.is_open
    assert side.engine.deadline == NEVER


def test_a_lost_connection_ends_it() -> None:
    side = opened()
    side.do(side.engine.closed(side.now, "gone"))
    side.do(side.engine.opened(side.now + 1))
    side.ask(work(2), station=9)
    side.run(MS)
    assert side.taken() == [b"\x01\x09"]


# ---- services asked for in a step ------------------------------------------------------------------------------------

ASKING = SESSION.replace(
    "  count:\n    steps:\n      - step: one\n        set: {opened: opened + 1}\n",
    "  count:\n    steps:\n      - step: one\n        ask: {unlock: {x: 40 + 2}}\n",
).replace(
    "roles:",
    "services:\n  unlock:\n    - {takes: {x: {type: number}}, request: {ask: {x: x, token: 0}}, reply: {answer: {y: 0}}}\nroles:",
)


def test_a_service_asked_for_runs_inside_the_step() -> None:
    asked: list[Any] = []

    def ask(service: str, arguments: dict[str, Any], station: Any, done: Any) -> None:
        asked.append((service, arguments, station))

        def ended(outcome: Outcome) -> None:
            done(outcome)

        side.engine.start(Exchange(run="work", request=work(arguments["x"]), on_done=ended), side.engine.scope.now)

    side = Side(ASKING, "client", ask=ask)
    side.ask(work(1), station=9)
    side.run(10 * MS)
    side.gets(b"\x02\x55")
    side.run(10 * MS)
    assert asked == [("unlock", {"x": 42}, 9)]
    side.gets(b"\x05\x00")
    side.run(10 * MS)
    side.gets(b"\x05\x01")
    assert side.taken() == [b"\x01\x09", b"\x04\x2a\x55", b"\x04\x01\x55"]
    assert side.outcomes[0].ok


def test_a_service_that_fails_fails_the_step() -> None:
    def ask(service: str, arguments: dict[str, Any], station: Any, done: Any) -> None:
        done(Outcome(False, "refused", "device says no"))

    side = Side(ASKING, "client", ask=ask)
    side.ask(work(1), station=9)
    side.run(10 * MS)
    side.gets(b"\x02\x55")
    assert (side.outcomes[0].outcome, side.outcomes[0].cause) == ("refused", "device says no")


# ---- announcements, frames put into others ---------------------------------------------------------------------------

ANNOUNCING = """
protocol: announcing
state: {left: {type: u16}, seen: {type: list}}
frames:
  header: {announces: {left: size}, body: [{const: 01}, {field: size, type: u8}]}
  data:   {announces: {left: left - len(data)}, body: [{const: 02}, {data: data, size: "min(4, left)"}, {const: 03}]}
  ack:    {body: [{const: ACK}]}
receiver: {quiet: 3 chars}
sequences:
  listen:
    local: {all: bytes}
    steps:
      - step: idle
        receive: [{frame: header, set: {all: "h''"}, then: data}]
      - step: data
        receive:
          - {frame: data, when: left > 0, set: {all: all + it.data}, send: ack, then: data}
          - {frame: data, set: {seen: "seen + [all + it.data]"}, send: ack, then: end}
        within: 1 s
        on_timeout: {then: end}
roles: {device: {lanes: {main: {listen: listen}}}}
"""


def test_frames_announce_the_size_of_later_ones() -> None:
    side = Side(ANNOUNCING, "device")
    side.gets(b"\x02abcd\x03")
    side.run(50 * MS)
    side.gets(b"\x01\x06\x02ab\x03d\x03\x02ef\x03")
    side.run(50 * MS)
    assert side.engine.scope["seen"] == [b"ab\x03def"] and side.taken() == [b"\x06", b"\x06"]


INSIDE = """
protocol: inside
params: {embedded: {type: flag, default: yes}}
frames:
  message:
    body:
      - const: DLE STX
      - {wrap: {escape: DLE}, of: [{data: data, size: rest}], name: text, inside: [ack], insert: embedded}
      - const: DLE ETX
  ack: {body: [{const: DLE ACK}]}
receiver: {symbols: DLE, resync: after_frame, quiet: 3 chars}
sequences:
  send:
    takes: [request]
    steps:
      - step: one
        send: request
        receive: [{frame: ack, then: end}]
        within: 1 s
  listen:
    steps:
      - step: one
        receive: [{frame: message, send: ack, then: again}]
roles: {full: {lanes: {out: {exchange: send}, in: {listen: listen}}}}
"""


def test_an_acknowledgement_is_put_into_the_message_that_is_leaving() -> None:
    side = Side(INSIDE, "full")
    side.ask(FrameValue("message", {"data": b"x" * 50}))
    side.gets(b"\x10\x02hello\x10\x03")
    acknowledgement = side.commands[-1]
    assert isinstance(acknowledgement, Send) and acknowledgement.inside and acknowledgement.data == b"\x10\x06"
    events: list[str] = []
    both = Side(INSIDE, "full")
    both.engine.opened(0)
    both.engine.send_frame("message", 0, {"data": b"abc"}, lambda: events.append("message"))
    both.engine.send_frame("ack", 0, {}, lambda: events.append("ack"))
    both.engine.sent(1)
    assert events == ["message", "ack"], "the one inside has left with the other"
    apart = Side(INSIDE, "full", params={"embedded": "no"})
    apart.ask(FrameValue("message", {"data": b"x" * 50}))
    apart.gets(b"\x10\x02hello\x10\x03")
    assert len(apart.taken()) == 1
    apart.run(SECOND)
    assert apart.taken() == [b"\x10\x06"]


def test_an_acknowledgement_in_the_middle_of_a_message_goes_to_the_lane_that_waits_for_it() -> None:
    side = Side(INSIDE, "full")
    side.ask(FrameValue("message", {"data": b"x"}))
    side.run(50 * MS)
    side.gets(b"\x10\x02hel\x10\x06")
    assert side.outcomes[0].ok
    side.gets(b"lo\x10\x03")
    side.run(50 * MS)
    assert side.taken()[1:] == [b"\x10\x06"]
