"""Vectors: reading their files, verification of the shipped vectors, and detection of wrong vectors."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from link.link_world import compiled
from shipped import vectors_of

from framekit.api.vectors import make_side
from framekit.codec.codec import compile_protocol
from framekit.definition.load.protocol import load_protocol
from framekit.definition.problems import DefinitionError
from framekit.definition.sources import shipped_definitions
from framekit.definition.vectors import Vectors, Wire, check_vectors, parse_wire
from framekit.link.conversation import Player, SideUnderTest, run_conversation, run_frame_vector
from tests.shipped import load_vectors

SHIPPED = shipped_definitions("*.vectors.yaml")


def read(tmp_path: Path, text: str) -> Vectors:
    file = tmp_path / "some.vectors.yaml"
    file.write_text(text)
    return load_vectors(file)


# ---- files ---------------------------------------------------------------------------------------------------


def test_bytes_of_a_case() -> None:
    wire = parse_wire("STX 41*3 xx 0D0A check 03")
    assert wire.head == (2, 0x41, 0x41, 0x41, None, 13, 10) and wire.tail == (3,)
    assert wire.exact is None and parse_wire("01 02").exact == b"\x01\x02"
    assert wire.matches(b"\x02AAAz\r\n99\x03") and wire.matches(b"\x02AAAz\r\n9\x03")
    assert not wire.matches(b"\x02AAAz\r\n\x03") and not wire.matches(b"\x02AABz\r\n9\x03")
    assert str(wire) == "02 41 41 41 xx 0D 0A check 03"


def test_bytes_with_a_ninth_bit() -> None:
    wire = parse_wire("10B 100*2 0B")
    assert wire.exact == b"\x0b\x00\x00\x0b" and wire.marks == {0, 1, 2}
    assert str(wire) == "10B 100 100 0B"
    last = parse_wire("01 check 103")
    assert last.marks == {-1} and str(last) == "01 check 103"
    assert last.marks_match(3, 4) and not last.marks_match(0, 4) and not last.marks_match(None, 4)
    first = parse_wire("101 02")
    assert first.marks_match(0, 2) and not first.marks_match(1, 2) and not first.marks_match(None, 2)
    computed = parse_wire("01 check")
    assert computed.marks_match(1, 2) and computed.marks_match(None, 2) and not computed.marks_match(0, 2)


@pytest.mark.parametrize("text", ["0", "check check", "01 zz", "00*99999999", "01*x", "20B"])
def test_bytes_that_are_none(text: str) -> None:
    with pytest.raises(ValueError):
        parse_wire(text)


def test_a_file_with_everything(tmp_path: Path) -> None:
    vectors = read(
        tmp_path,
        """
vectors: some
frames:
  - {frame: a, values: {x: 010}, bytes: 01 10, source: "manual, page 3"}
  - {bytes: 01 10 11, expect: {noise: 3}}
  - {bytes: 01, expect: {refused: 0x11}}
conversations:
  - name: asks
    role: client
    params: {retries: 2}
    do: {read: M1, count: 2}
    script:
      - {send: 01 xx, not_before: 3 chars, within: 50 ms}
      - {line: parity}
      - {receive: 02}
      - {silence: 1 s}
    result: {values: [1, 2], state: {n: 1}}
""",
    )
    first, second, third = vectors.frames
    assert (first.frame, first.values, first.source) == ("a", {"x": "010"}, "manual, page 3")
    assert (second.expect, third.expect) == (("noise", 3), ("refused", 0x11))
    (conversation,) = vectors.conversations
    assert [line.kind for line in conversation.script] == ["send", "line", "receive", "silence"]
    assert conversation.do == {"read": "M1", "count": "2"} and conversation.result.values == ["1", "2"]


def test_problems_have_their_place(tmp_path: Path) -> None:
    text = "vectors: some\nframes:\n  - {frame: a, bytes: 01 0}\n  - {bytes: 01}\n"
    with pytest.raises(DefinitionError) as caught:
        read(tmp_path, text)
    assert {problem.at.line for problem in caught.value.problems} == {3, 4}


# ---- the shipped ones ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [file.name.removesuffix(".vectors.yaml") for file in SHIPPED])
def test_the_shipped_cases_hold(name: str) -> None:
    vectors = vectors_of(name)
    protocol = load_protocol(vectors.protocol)
    codec = compile_protocol(protocol)
    assert vectors.frames or vectors.conversations
    for vector in vectors.frames:
        assert run_frame_vector(vector, protocol, codec) == [], vector.at
    for conversation in vectors.conversations:
        assert run_conversation(conversation, protocol, codec, make_side) == [], conversation.at


# ---- wrong ones are found out -------------------------------------------------------------------------------------

MADE_UP = """
protocol: made_up
state: {n: {type: u8}}
frames:
  ask: {from: client, body: [{const: 01}, {field: x, type: u8}, {check: sum8}]}
  yes: {from: server, body: [{const: 02}, {field: x, type: u8}]}
receiver: {quiet: 3 chars}
sequences:
  main:
    takes: [request]
    steps:
      - step: one
        wait: 10 ms
        set: {n: n + 1}
        send: request
        receive: [{frame: 'yes', then: end}]
        within: 100 ms
        on_bad: {fail: damaged}
roles: {client: {lanes: {main: {exchange: main}}}}
"""


@pytest.mark.parametrize(
    ("case", "words"),
    [
        ("{frame: ask, values: {x: 5}, bytes: 01 05 06}", []),
        ("{frame: ask, values: {x: 5}, bytes: 01 05 check}", []),
        ("{frame: ask, values: {x: 5}, bytes: 01 06 07}", ["built as 01 05 06", "x = 6, not 5"]),
        ("{frame: ask, values: {x: 5, y: 1}, bytes: 01 05 06}", ["cannot be built"]),
        ("{frame: nothing, values: {}, bytes: 01}", ["no frame 'nothing'"]),
        ("{bytes: 01 05 07, expect: {bad: check}}", []),
        ("{bytes: 01 05 07, expect: {bad: range}}", ["bad ask (check at byte 2: check, expected "]),
        ("{bytes: 01 05, expect: {bad: cut}}", []),
        ("{bytes: FF FF 02 01, expect: {noise: 2}}", []),
        ("{bytes: FF 02 01, expect: {noise: 2}}", ["1 bytes are noise, not 2"]),
    ],
)
def test_frame_cases(tmp_path: Path, case: str, words: list[str]) -> None:
    protocol, codec = compiled(MADE_UP)
    (vector,) = read(tmp_path, f"vectors: made_up\nframes:\n  - {case}\n").frames
    problems = run_frame_vector(vector, protocol, codec)
    assert len(problems) == len(words), problems
    assert all(word in problem for word, problem in zip(words, problems, strict=True))


GOOD = [
    "{send: 01 05 06, not_before: 10 ms, within: 10 ms}",
    "{wait: 20 ms}",
    "{receive: 02 05}",
]


@pytest.mark.parametrize(
    ("script", "more", "words"),
    [
        (GOOD, "result: {state: {n: 1}}", ""),
        (GOOD, "result: {state: {n: 2}}", "n is 1 afterwards, expected 2"),
        (["{send: 01 05 07}"], "", "sent 01 05 06, expected 01 05 07"),
        (["{send: 01 05 06, not_before: 11 ms}"], "", "sent after 10 ms, not before 11 ms"),
        (["{send: 01 05 06, within: 9 ms}"], "", "sent after 10 ms, not within 9 ms"),
        (["{silence: 10 ms}", *GOOD[1:]], "", "not expected"),
        (["{silence: 11 ms}"], "", "sent 01 05 06 at 10 ms, which was not expected"),
        (GOOD[:1], "", "it failed: outcome 'timeout'"),
        (GOOD[:1], "result: {outcome: timeout}", ""),
        ([GOOD[0], "{line: framing}", "{receive: 02 05}"], "result: {outcome: damaged}", ""),
        ([*GOOD, "{send: 03}"], "", "nothing was sent, expected 03"),
    ],
)
def test_conversations(tmp_path: Path, script: list[str], more: str, words: str) -> None:
    protocol, codec = compiled(MADE_UP)
    lines = "\n".join(f"      - {line}" for line in script)
    text = (
        "vectors: made_up\nconversations:\n  - name: one\n    role: client\n"
        "    do: {exchange: {ask: {x: 5}}, expected: ['yes']}\n"
        f"    script:\n{lines}\n    {more}\n"
    )
    (case,) = read(tmp_path, text).conversations
    problems = run_conversation(case, protocol, codec, make_side)
    assert problems == [] if not words else len(problems) >= 1 and words in problems[0], problems


ROLES = """
protocol: roles
extends: standard
groups:
  request: {from: client, head: [{const: 01}, {field: x, type: u8}]}
frames:
  ask: {group: request}
  got: {from: server, body: [{const: 02}, {field: x, type: u8}]}
services:
  fetch:
    - {request: {ask: {x: 5}}, reply: {got: {x: 6}}, gives: {x: reply.x}}
"""


@pytest.mark.parametrize(
    "case",
    [
        "{name: c, do: {fetch: {}}, script: [{send: 01 05}, {receive: 02 06}], result: {values: {x: 6}}}",
        "{name: c, script: [{receive: 01 05}, {send: 02 06}]}",
        "{name: c, do: {send: {ask: {x: 7}}}, script: [{send: 01 07}]}",
        "{name: c, role: server, do: {send: {got: {x: 7}}}, script: [{send: 02 07}]}",
    ],
)
def test_a_conversation_without_a_role_is_that_of_a_client_where_it_does_something_else_of_a_server(
    tmp_path: Path, case: str
) -> None:
    protocol, codec = compiled(ROLES)
    vectors = read(tmp_path, f"vectors: roles\nconversations:\n  - {case}\n")
    assert check_vectors(vectors, protocol) == []
    assert run_conversation(vectors.conversations[0], protocol, codec, make_side) == []


@pytest.mark.parametrize("do", ["{fetch: {}}", "{exchange: {ask: {x: 5}}}"])
def test_a_role_that_begins_no_exchanges_is_told_where_it_is_asked_to(tmp_path: Path, do: str) -> None:
    protocol, _ = compiled(ROLES)
    case = f"{{name: c, role: server, do: {do}, script: []}}"
    vectors = read(tmp_path, f"vectors: roles\nconversations:\n  - {case}\n")
    (problem,) = check_vectors(vectors, protocol)
    says = "3:21: role 'server' begins no exchanges, and 'do' asks it to – write role: client"
    assert says in str(problem)


CALLED = """
protocol: called
line: {kind: stream, tcp: 1}
state: {n: {type: u8, scope: session, initial: 1}}
frames:
  ask: {from: client, body: [{const: 01}, {field: x, type: u8}]}
  good: {from: server, body: [{const: 02}, {field: x, type: u8}]}
receiver: {resync: never}
sequences:
  main:
    takes: [request]
    steps:
      - {step: one, send: request, receive: [{frame: good, then: end}], within: 100 ms}
roles: {client: {lanes: {main: {exchange: main}}}}
"""
ASKED = "{send: 01 05, within: 0 ms}"


@pytest.mark.parametrize(
    ("script", "more", "words"),
    [
        ([ASKED, "{receive: 03}", "{connection: closed, within: 0 ms}"], "result: {outcome: closed}", ""),
        ([ASKED, "{receive: 03}"], "result: {outcome: closed}", "the connection was closed at 0 ms, which was not"),
        ([ASKED, "{receive: 02 05}", "{connection: closed}"], "", "the connection was not closed"),
        (
            [ASKED, "{wait: 5 ms}", "{receive: 03}", "{connection: closed, not_before: 6 ms}"],
            "result: {outcome: closed}",
            "closed after 0 ms, not before 6 ms",
        ),
        ([ASKED, "{receive: 02}", "{connection: lost}"], "result: {outcome: closed}", ""),
        (["{connection: lost}"], "result: {outcome: closed}", "sent 01 05 at 0 ms, which was not expected"),
        ([ASKED, "{connection: lost}", "{connection: opened}", "{silence: 1 s}"], "result: {outcome: closed}", ""),
    ],
)
def test_conversations_on_a_connection(tmp_path: Path, script: list[str], more: str, words: str) -> None:
    protocol, codec = compiled(CALLED)
    lines = "\n".join(f"      - {line}" for line in script)
    text = (
        "vectors: called\nconversations:\n  - name: one\n    role: client\n"
        "    do: {exchange: {ask: {x: 5}}, expected: [good]}\n"
        f"    script:\n{lines}\n    {more}\n"
    )
    (case,) = read(tmp_path, text).conversations
    problems = run_conversation(case, protocol, codec, make_side)
    assert problems == [] if not words else len(problems) >= 1 and words in problems[0], problems


def test_a_side_that_runs_nothing(tmp_path: Path) -> None:
    protocol, codec = compiled(MADE_UP)
    text = "vectors: made_up\nconversations:\n  - {name: one, role: client, do: {read: M1}, script: [{wait: 1 s}]}\n"
    (case,) = read(tmp_path, text).conversations
    problems = run_conversation(case, protocol, codec, lambda *_: SideUnderTest())
    assert "runs services" in problems[0]


DRAWN = """
protocol: drawn
extends: standard
groups:
  request: {from: client, head: [{const: 01}, {data: d, size: 2}]}
frames:
  ask: {group: request}
  got: {from: server, body: [{const: 02}]}
services:
  fetch:
    - {request: {ask: {d: random(2)}}, reply: {got: {}}, client_only: yes}
"""


@pytest.mark.parametrize(
    ("drawn", "words"),
    [
        ("random: 05 06, ", ""),
        ("random: 05 06 07, ", "random: has 1 byte more than are asked for"),
        ("random: 05, ", "random(2) wants 2 bytes, random: of the case has 1 left"),
        ("", "random(2) wants 2 bytes, random: of the case has 0 left"),
    ],
)
def test_random_bytes_of_a_case_are_as_many_as_are_asked_for(tmp_path: Path, drawn: str, words: str) -> None:
    protocol, codec = compiled(DRAWN)
    text = f"{{name: c, {drawn}do: {{fetch: {{}}}}, script: [{{send: 01 05 06}}, {{receive: 02}}]}}"
    (case,) = read(tmp_path, f"vectors: drawn\nconversations:\n  - {text}\n").conversations
    problems = run_conversation(case, protocol, codec, make_side)
    assert problems == [] if not words else any(words in problem for problem in problems), problems


CODES = {"modbus-rtu": (2, 0), "modbus-ascii": (2, 2), "uss": (1, 0)}
"""Size of a protocol's check code, and number of bytes after it."""


def _is_read(codec: Any, frame: str, data: bytes) -> bool:
    try:
        codec.frames[frame].decode(data, {"request": None, "buffer": b""})
    except (ValueError, LookupError, TypeError):
        return False
    return True


@pytest.mark.parametrize("name", CODES)
def test_a_check_code_that_is_received_is_computed(name: str) -> None:
    """The code of received frames in shipped conversations is recomputed; it equals the right code of the case."""
    vectors, protocol = vectors_of(name), load_protocol(name)
    codec, (size, after) = compile_protocol(protocol), CODES[name]
    computed = 0
    for case in vectors.conversations:
        player = Player(case, protocol, codec, make_side, None)
        for line in case.script:
            data = None if line.wire is None or line.kind != "receive" else line.wire.exact
            if data is None or len(data) <= size + after:
                continue
            tail = data[len(data) - after :]
            found = player.with_check(Wire(tuple(data[: -size - after]), tuple(tail)))
            is_good = any(_is_read(codec, frame, data) for frame in player.table.on_line)
            assert found == data or not is_good, (case.name, data.hex(" "))
            computed += found == data
    assert computed >= 5


def test_a_check_code_of_no_frame_is_a_problem_of_the_case(tmp_path: Path) -> None:
    vectors = read(
        tmp_path,
        """
vectors: modbus-rtu
conversations:
  - name: not a frame
    role: server
    own: 1
    script: [{receive: 41 check 42 43}]
""",
    )
    found = run_conversation(
        vectors.conversations[0], load_protocol("modbus-rtu"), compile_protocol(load_protocol("modbus-rtu")), make_side
    )
    assert len(found) == 1 and "no frame of the line is 41 check 42 43 with a check code in that place" in found[0]
