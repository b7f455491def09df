"""Wording of messages: lists, suggestions for misspelt names, readable times."""

from __future__ import annotations

import pytest

from framekit.definition.load.protocol import load_protocol_text
from framekit.definition.problems import DefinitionError, error_text, is_nearly, listed
from framekit.definition.times import NEVER, readable_time


def test_lists_of_things() -> None:
    assert (listed(["a"]), listed([1, 2]), listed(("a", "b", "c"))) == ("a", "1 and 2", "a, b and c")


@pytest.mark.parametrize(
    ("word", "other", "nearly"),
    [("station", "staton", True), ("station", "station", False), ("station", "stations", False),
     ("values", "value", True), ("into", "from", False), ("from", "form", True)],
)  # fmt: skip
def test_near_misses(word: str, other: str, nearly: bool) -> None:
    assert is_nearly(word, other) is nearly


@pytest.mark.parametrize(
    ("time", "text"),
    [(12_499_996, "12.5 ms"), (319_270_829, "319.271 ms"), (1_250_000_000, "1.25 s"), (2_000, "0.002 ms"), (0, "0 ms"),
     (3_600_000_000_000, "3600 s"), (NEVER, "never")],
)  # fmt: skip
def test_times_for_people(time: int, text: str) -> None:
    assert readable_time(time) == text


def _following(error: Exception, earlier: Exception) -> Exception:
    error.__cause__ = earlier
    return error


@pytest.mark.parametrize(
    ("error", "text"),
    [(TimeoutError(), "no answer within the time limit"), (TimeoutError("timed out"), "timed out"),
     (ConnectionResetError(), "the other side has reset the connection"),
     (ConnectionAbortedError(), "the connection was lost"),
     (OSError(28, "No space left on device"), "No space left on device"),
     (EOFError(), "the other side has closed the connection"), (KeyError("level"), "KeyError: 'level'"),
     (_following(RuntimeError(), OSError(5, "Input/output error")), "Input/output error"),
     (_following(RuntimeError(" "), RuntimeError()), "an error of the kind RuntimeError, without a text"),
     (OSError("refused\n\tIs it on?\n"), "refused Is it on?"), (ValueError("no number"), "no number"),
     (MemoryError(), "not enough memory"), (OSError(5, ConnectionError("it is gone")), "[Errno 5] it is gone"),
     (OSError(2, b"away"), "[Errno 2] b'away'")],
)  # fmt: skip
def test_the_text_of_an_error_is_never_empty(error: Exception, text: str) -> None:
    assert error_text(error) == text


FOLLOWED = """
protocol: p
line: {format: 8E1}
areas: {D: {size: 100, unit: word}}
addresses: [{form: "{area}{start:dec}.{slot:dec}", unit: word}]
groups:
  ask: {from: client, where: {kind: 1}, head: [{field: kind, type: u8}], tail: [{check: sum8}]}
frames:
  read: {group: ask, body: [{field: start, type: u16}, {field: slot, type: u8}, {length: n, type: u8, of: [kind]}]}
  reply: {from: server, body: [{length: n, type: u8, of: [data]}, {data: data, size: n}]}
services:
  read: [{units: [word], request: {read: {start: start, slot: slot}}, reply: [{reply: {data: data}}]}]
"""


@pytest.mark.parametrize(
    ("right", "wrong", "told"),
    [
        ("group: ask", "group: aks", "there is no group 'aks'"),
        ("start:dec", "start:dex", "'dex' is neither a kind of number nor a column of an area"),
        ("form:", "fomr:", "missing key 'form' in address form 1"),
    ],
)
def test_what_only_follows_from_an_error_is_not_told(right: str, wrong: str, told: str) -> None:
    load_protocol_text(FOLLOWED, "p")
    with pytest.raises(DefinitionError) as caught:
        load_protocol_text(FOLLOWED.replace(right, wrong), "p")
    (problem,) = caught.value.problems
    assert told in problem.what
