"""Job profiles: the shipped profile has every code of the manual; invalid profiles give every error with its place."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from job_world import profile_with

from framekit.definition.problems import DefinitionError, separately
from framekit.extras.commreq.job_profiles import load_job_profile
from framekit.run.model import CodeClass

HOUR = 3600 * 1_000_000_000


def test_codes_by_number() -> None:
    profile = load_job_profile("ge-channels")
    assert len(profile.codes) == 15
    assert {code: len(major.minors) for code, major in profile.codes.items() if major.minors} == {
        0x05: 43, 0x11: 32, 0x85: 43, 0x90: 37,
    }  # fmt: skip
    for code in (0x02, 0x04, 0x05, 0x06, 0x07, 0x0B):
        assert code + 0x80 in profile.codes, "the client's twin of a server's code"


@pytest.mark.parametrize(
    ("word", "text", "kind"),
    [
        (0x0000, "", CodeClass.FATAL),
        (0x0001, "success", CodeClass.GOOD),
        (0xC105, "server: service request error: invalid block state transition", CodeClass.TRANSIENT),
        (0xC185, "client: service request error: invalid block state transition", CodeClass.TRANSIENT),
        (0x0290, "client: period is over, still waiting", CodeClass.TRANSIENT),
        (0x0302, "server: privilege too low, the high byte is the level needed, 0x03", CodeClass.TRANSIENT),
        (0xA290, "client: status word could not be written", CodeClass.FATAL),
        (0x0411, "server: error of its interface: unexpected version in a message", CodeClass.FATAL),
        (0x9090, "client: too few TCP connection resources", CodeClass.RESOURCE),
        (0x8890, "client: invalid channel number", CodeClass.SYNTAX),
        (0x9990, "client, 0x99", CodeClass.FATAL),
        (0x0033, "unknown code", CodeClass.FATAL),
    ],
)
def test_words_by_name(word: int, text: str, kind: CodeClass) -> None:
    profile = load_job_profile("ge-channels")
    assert profile.text_of(word) == text and profile.kind_of(word) is kind


@pytest.mark.parametrize(
    ("period", "wrong"),
    [
        (0, None),
        (10_000_000, None),
        (20 * 1_000_000_000, None),
        (5965 * HOUR, None),
        (5966 * HOUR, "is too long"),
        (7_000_000, "is no multiple"),
        (655_350_000_000, None),
        (70_000 * 10_000_000, None),
        (70_001 * 10_000_000, "is too long"),
    ],
)
def test_periods(period: int, wrong: str | None) -> None:
    assert load_job_profile("ge-channels").mismatch_period(period) == wrong


WRONG = """jobs: wrong
slots: 1..4
commands: 0
scan: 1 us
units: {1: {time: 0 ms}, 2: {time: 1 s, most: 0}}
lengths: {word: 0}
bits: {size: 10, any_error: 11, ready: 1, done: {first: 1, step: 2}, error: {first: 2, step: 3}}
words: {good: 0, late: 1, period: 2, replaced: 3, no_slot: 4, unknown_host: 5, no_resolver: 6, no_channel: 7,
  not_connected: 8, connect_timeout: 9, closed: 10, no_word: 11, no_place: 12, unsupported: 0x10000}
outcomes: {refused: {word: cod}, otherwise: {word: 1}}
codes: {1: {text: good, class: good}, 256: {text: large, class: fine}, 2: {text: x, class: fatal, minors: none}}
minors: {some: {0: zero, 1: {text: one, class: fatal}}}
events: {lost: {number: one}}
"""


def test_everything_that_is_wrong_comes_at_once(tmp_path: Path) -> None:
    path = tmp_path / "wrong.jobs.yaml"
    path.write_text(WRONG, encoding="utf-8")
    with pytest.raises(DefinitionError) as caught:
        load_job_profile(path)
    found = [(problem.at.line, problem.what) for problem in sorted(separately(caught.value.problems))]
    assert found == [
        (3, "0 is too small: 1 is the least"),
        (4, "a scan takes 1 ms or more"),
        (5, "a unit of no time counts nothing"),
        (5, "0 is too small: 1 is the least"),
        (6, "0 is too small: 1 is the least"),
        (7, "there is no bit 11 for any_error"),
        (7, "bit 1 is that of ready already"),
        (7, "there is no bit 11 for error 4"),
        (8, "0 is no word that answers a command"),
        (9, "65536 is no word that answers a command"),
        (10, "an outcome does not know 'cod'"),
        (11, "256 is no low byte of an answer"),
        (11, "'fine' is not a class"),
        (11, "there is no minor 'none'"),
        (12, "0 is no high byte that says more"),
        (13, "'one' is not a whole number (10 or 0x0A)"),
    ]


def test_a_profile_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(DefinitionError, match=re.escape("there is no job profile 'ge-channel' – did you mean")):
        load_job_profile("ge-channel", tmp_path)
    with pytest.raises(DefinitionError, match="leaves the folder"):
        load_job_profile("../x", tmp_path)


def test_a_profile_without_its_parts(tmp_path: Path) -> None:
    path = tmp_path / "bare.jobs.yaml"
    path.write_text("jobs: bare\n", encoding="utf-8")
    with pytest.raises(DefinitionError, match="missing keys 'slots', 'units', 'lengths', 'bits'"):
        load_job_profile(path)


def test_a_changed_profile_is_taken(tmp_path: Path) -> None:
    assert list(profile_with(tmp_path, "slots: 1..16", "slots: 1..8").slots) == list(range(1, 9))
