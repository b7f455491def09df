"""Frames that a receiver cannot distinguish, end marks that data may contain, and weak check codes."""

from __future__ import annotations

import pytest
import shipped
from spread import spread

from framekit.codec.ambiguity import check_matrices, passing, sample_context
from framekit.codec.checks import compute
from framekit.codec.codec import compile_protocol
from framekit.codec.samples import Sampler
from framekit.definition.load.protocol import load_protocol, load_protocol_text

HEAD = """
protocol: t
line: {format: 8E1}
frames:
  long: {from: server, body: [{const: STX}, {data: d, size: 4}]}
  short: {from: server, body: [{const: STX}, {data: d, size: 2}]}
  fixed: {from: server, body: [{const: STX}, {text: AB}, {data: d, size: 2}]}
  other: {from: server, body: [{const: SOH}, {data: d, size: 2}]}
sequences:
  s:
    steps:
      - step: wait
        receive:
"""
TAIL = "\nroles: {client: {lanes: {main: {listen: s}}}}\n"


def problems(rows: str) -> list[str]:
    text = HEAD + "\n".join(f"          - {row}" for row in rows.split(";")) + TAIL
    return [problem.what for problem in check_matrices(load_protocol_text(text))]


@pytest.mark.parametrize("name", spread(shipped.PROTOCOLS, 4, 1))
def test_shipped_frames_can_be_told_apart(name: str) -> None:
    assert all(problem.warning for problem in check_matrices(load_protocol(name)))


def test_a_frame_that_an_earlier_row_always_takes_is_an_error() -> None:
    (what,) = problems("{frame: long, then: again}; {frame: fixed, then: again}")
    assert what.startswith("'fixed' is always taken for 'long', which is tried first: 02 41 42 ")
    assert what.endswith("fits both")


def test_a_frame_that_is_the_beginning_of_another_takes_it() -> None:
    (what,) = problems("{frame: short, then: again}; {frame: long, then: again}")
    assert what.startswith("'long' is always taken for 'short'")


@pytest.mark.parametrize(
    "rows",
    [
        "{frame: fixed, then: again}; {frame: long, then: again}",  # the candidates compete at times, not always
        "{frame: long, when: own == 1, then: again}; {frame: fixed, then: again}",
        "{frame: other, then: again}; {frame: long, then: again}",
        "{frame: [long, other], then: again}",
        "{frame: long, then: again}; {frame: other, then: again}",
    ],
)
def test_constants_conditions_and_the_order_of_rows_separate_frames(rows: str) -> None:
    assert problems(rows) == []


def test_a_count_in_a_row_does_not_separate() -> None:
    assert problems("{frame: long, then: again, at_most: 2, else: end}; {frame: fixed, then: again}")


def test_a_frame_of_varying_size_is_compared_with_one_of_fixed_size_before_it() -> None:
    """Assert a warning if only some frames of one kind look like another frame.

    Only some frames of the varying size have the fixed size, so it is a warning; a distinguishing constant removes it.
    """
    text = """
protocol: t
line: {format: 8E1}
frames:
  fixed: {from: server, body: [{const: STX}, {field: a, type: u8}, {field: b, type: u8}, {field: c, type: u8}]}
  varying: {from: server, body: [{const: STX}, {length: n, type: u8, of: [d]}, {data: d, size: n}]}
"""
    (problem,) = check_matrices(load_protocol_text(text))
    assert problem.warning and problem.at.line == 6
    assert problem.what.startswith("'varying' of 4 bytes is taken for 'fixed', which is tried first: 02 02 ")
    assert check_matrices(load_protocol_text(text.replace("{field: a, type: u8}", "{const: FF}"))) == []


def test_what_repeats_the_request_separates() -> None:
    text = """
protocol: t
line: {format: 8E1}
groups:
  a: {from: server, head: [{field: number, type: u8}, {field: kind, type: u8}], echo: [number]}
  b: {from: server, head: [{field: kind, type: u8}, {field: number, type: u8}], echo: [number]}
frames:
  ask: {from: client, body: [{field: number, type: u8}]}
  one: {group: a, body: []}
  two: {group: b, body: []}
"""
    assert check_matrices(load_protocol_text(text)) == [], "where the numbers stand decides"


def test_frames_inside_others_are_tried_in_order_too() -> None:
    text = """
protocol: t
line: {format: 8E1}
groups: {pdu: {from: none}}
frames:
  any: {group: pdu, body: [{field: code, type: u8}, {data: rest, size: rest}]}
  read: {group: pdu, body: [{const: 01}, {data: rest, size: rest}]}
  packet: {body: [{const: STX}, {length: n, type: u8, of: [pdu]}, {inner: pdu, of: pdu, size: n}]}
"""
    (problem,) = check_matrices(load_protocol_text(text))
    assert "'read' is always taken for 'any'" in problem.what
    assert check_matrices(load_protocol_text(text.replace("any: {group: pdu", "any: {refuse: 1, group: pdu"))) == []


def test_ends_that_data_may_hold_are_told() -> None:
    text = """
protocol: t
line: {format: 8E1}
frames:
  open: {body: [{const: STX}, {data: d, size: rest}, {const: CR}]}
  guarded: {body: [{const: SOH}, {data: d, size: rest}, {const: CR}, {check: crc16-modbus}]}
  digits: {body: [{const: ENQ}, {data: d, size: rest, convert: hex_to_ascii}, {const: CR}]}
  sized: {body: [{const: ACK}, {data: d, size: 4}, {const: CR}]}
"""
    found = [problem for problem in check_matrices(load_protocol_text(text)) if problem.warning]
    assert [problem.what.partition(": ")[2] for problem in found] == [
        "'open' ends at the first 0D, whatever was meant",
        "'guarded' ends at the first 0D with a fitting check code",
    ]


def test_the_share_of_double_errors_is_that_of_the_sum() -> None:
    """Inverting the same bit of two bytes, once up and once down, does not change a sum."""
    protocol = load_protocol_text(
        "protocol: t\nframes:\n  f: {body: [{const: STX}, {data: d, size: 30}, {check: sum8}]}\n"
    )
    codec = compile_protocol(protocol)
    sampler = Sampler(codec, sample_context(protocol))
    sample = sampler.samples("f")[0]
    share = passing(codec, "f", sample, sampler.context)
    method = protocol.frames["f"].body[-1].method  # type: ignore[attr-defined]
    covered, unchanged, pairs = sample.data[:-1], 0, 0
    for first in range(8, 8 * len(covered)):
        for second in range(first + 1, 8 * len(covered)):
            damaged = bytearray(covered)
            damaged[first // 8] ^= 1 << first % 8
            damaged[second // 8] ^= 1 << second % 8
            pairs += 1
            unchanged += compute(method, bytes(damaged)) == sample.data[-1]
    assert share == pytest.approx(unchanged / pairs, abs=0.03)


@pytest.mark.parametrize(("format_", "told"), [("8N1", True), ("8E1", False)])
def test_weak_codes_are_told_on_lines_without_parity(format_: str, told: bool) -> None:
    text = (
        f"protocol: t\nline: {{format: {format_}}}\nframes:\n  f: {{body: [{{data: d, size: 9}}, {{check: xor8}}]}}\n"
    )
    found = check_matrices(load_protocol_text(text))
    assert bool(found) is told
    assert all(problem.warning and "errors of two bits" in problem.what for problem in found)


def test_silence_ends_nothing_on_a_connection() -> None:
    text = "protocol: t\nline: {kind: stream}\nframes:\n  f: {body: [{const: STX}, {data: d, size: rest}]}\n"
    (problem,) = check_matrices(load_protocol_text(text))
    assert problem.what.startswith("only silence ends 'f'") and not problem.warning
    assert check_matrices(load_protocol_text(text + "receiver: {quiet: 20 ms}\n")) == []


INSIDE = """
protocol: t
frames:
  f: {{body: [{{inner: i, of: [{order}]}}, {{const: 03}}]}}
  long: {{from: none, body: [{{field: n, type: u8}}, {{data: d, size: 3}}]}}
  short: {{from: none, body: [{{const: 02}}, {{field: k, type: u8}}]}}
"""


def test_a_frame_inside_that_may_begin_one_tried_before_it() -> None:
    found = check_matrices(load_protocol_text(INSIDE.format(order="long, short")))
    (problem,) = [problem for problem in found if "may be the beginning of" in problem.what]
    assert problem.what.startswith("'short' in 'f' may be the beginning of a frame that is tried first: 02 ")
    assert not problem.warning and problem.at.line == 4
    found = check_matrices(load_protocol_text(INSIDE.format(order="short, long")))
    assert not any("may be the beginning of" in problem.what for problem in found)


def test_while_a_frame_inside_wants_more_none_behind_it_is_taken() -> None:
    codec = compile_protocol(load_protocol_text(INSIDE.format(order="long, short")))
    data = bytes.fromhex("02 05 03 02 03")
    assert [codec.measure("f", data[:have]) for have in range(1, 6)] == [-2, -1, -1, -1, 5]
    assert codec.decode("f", data[:3]) == {"i": {"short": {"k": 5}}}
