"""Timing of a line: which side replies to which, how a client reacts to a missing reply, and which requests repeat."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from framekit.api.check import check_file
from framekit.definition.load.protocol import load_protocol
from framekit.extras.guess.draft import write_definition
from framekit.extras.guess.model import Guess, HeardBytes
from framekit.extras.guess.recordings import guess, heard
from framekit.extras.guess.times import TimedFrame, times_of

RECORDINGS = Path(__file__).parents[2] / "data" / "guess"
MS = 1_000_000


def recorded(name: str) -> Guess:
    return guess(heard(RECORDINGS / f"{name}.pcap"))


@pytest.mark.parametrize(
    ("name", "timeout", "repeats", "period"),
    [("mbpoll-silent", 250, 0, 355), ("pymodbus-silent", 200, 2, 613)],
)
def test_the_time_out_of_a_program_is_seen(name: str, timeout: int, repeats: int, period: int) -> None:
    """mbpoll waits 150 ms, and then 100 ms as after a reply; pymodbus waits 200 ms, and repeats twice."""
    times = recorded(name).times
    assert times.longest_timeout is not None and abs(times.longest_timeout / MS - timeout) <= 5
    assert times.unanswered is not None and times.unanswered.repeats == repeats
    assert times.unanswered.alike == times.unanswered.given_up
    assert period in [round(period.every.middle / MS) for period in times.periods]


def test_a_definition_waits_and_repeats_as_the_client_did(tmp_path: Path) -> None:
    path = tmp_path / "found.yaml"
    assert write_definition(recorded("pymodbus-silent"), path, "pymodbus").problems == ()
    params = load_protocol(path).params
    assert "reply_timeout: {default: 200 ms}" in path.read_text("utf-8") and "reply_timeout" in params
    assert "retries: {default: 2}" in path.read_text("utf-8") and not check_file(str(path)).problems


def test_who_answers_whom_is_told_with_its_times() -> None:
    found = recorded("m-bus")
    (answers,) = found.times.answers
    assert answers.told == (("told", 69), ("told_2", 6)) and answers.of == answers.answered == 75
    assert (
        answers.delay is not None and 20 * MS <= answers.delay.least <= answers.delay.middle <= answers.delay.greatest
    )
    assert any(
        statement.text.startswith("asked is answered by told (69) or told_2 (6), after 20")
        for statement in found.statements
    )
    assert found.times.unanswered is None and found.times.longest_timeout is None


def test_what_only_sends_has_periods_and_no_answers() -> None:
    times = recorded("nmea").times
    assert times.answers == () and times.unanswered is None
    assert [round(period.every.middle / MS) for period in times.periods] == [30, 30, 30]


def line(*frames: tuple[int, str, bytes]) -> list[TimedFrame]:
    return [TimedFrame(at * MS, side, "kind", data) for at, side, data in frames]


def test_a_device_that_is_never_there_tells_no_repeats() -> None:
    """The same request once a second may be polls or repeats."""
    answered = [(at, side, data) for at, side, data in ((0, "client", b"askA"), (5, "server", b"told"))]
    times = times_of(line(*answered, *((1000 * at, "client", b"askB") for at in range(1, 20))))
    assert times.unanswered is not None and times.unanswered.repeats is None
    assert times.unanswered.wait is not None and times.unanswered.wait.middle == 1000 * MS


def test_repeats_are_no_polls() -> None:
    rng, frames, now = random.Random(3), list[tuple[int, str, bytes]](), 0
    for _ in range(20):
        dead = rng.random() < 0.4
        for again in range(3 if dead else 1):
            frames.append((now + 50 * again, "client", b"ask1"))
        if not dead:
            frames.append((now + 7, "server", b"told"))
        frames += [(now + 400, "client", b"ask2"), (now + 407, "server", b"told")]
        now += 1000
    times = times_of(line(*frames))
    assert times.unanswered is not None and times.unanswered.repeats == 2
    assert [(period.data, period.every.middle // MS, period.near) for period in times.periods] == [
        (b"ask1", 1000, 19), (b"ask2", 1000, 19),
    ]  # fmt: skip


def test_a_damaged_reply_is_a_reply() -> None:
    chunks = heard(RECORDINGS / "mbpoll-rtu.pcap")
    for at in (11, 21):
        data = chunks[at].data
        chunks[at] = chunks[at]._replace(data=data[:-1] + bytes([data[-1] ^ 1]))
    found = guess(chunks)
    assert found.times.unanswered is None
    assert found.times.answers[0].told == (("told", 56), ("a damaged frame", 2))


def test_times_that_are_not_known_tell_nothing() -> None:
    chunks = [HeardBytes(None, chunk.direction, chunk.data) for chunk in heard(RECORDINGS / "mbpoll-silent.pcap")]
    times = guess(chunks).times
    assert times.answers[0].delay is None and times.longest_timeout is None and times.periods == ()
    assert times.unanswered is not None and times.unanswered.repeats == 0
