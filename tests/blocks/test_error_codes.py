"""The table of error codes: one row for each code, all distinct; the documentation page contains the same table."""

from __future__ import annotations

from pathlib import Path

import pytest

from framekit.run.block_state import FIRST_OWN, ErrorCode, Failure, error_code, error_table, status_word

PAGE = Path(__file__).parents[2] / "docs" / "error-codes.md"


def test_the_table_and_the_codes_are_the_same() -> None:
    rows = list(error_table().values())
    assert [row.code for row in rows] == sorted(code for code in ErrorCode if code)
    assert all(row.name == row.code.name.lower() for row in rows)
    assert all(row.meaning and row.advice for row in rows)
    assert all(FIRST_OWN < row.code <= 0xFFFF for row in rows)


def test_the_page_shows_the_table() -> None:
    wanted = [
        f"| `{row.code:04X}` | `{row.name}` | {row.meaning} | {row.advice} |" for row in error_table().values()
    ]  # fmt: skip
    shown = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("| `")]
    assert shown == wanted


@pytest.mark.parametrize(
    ("outcome", "device_code", "word"),
    [
        ("", None, 0),
        ("", 5, 0),
        ("no_reply", None, 0xFF01),
        ("refused", 0x1332, 0x1332),
        ("refused", 2, 2),
        ("refused", 0, 0xFF10),
        ("refused", 0x12345, 0xFF10),
        ("refused", 0xFF01, 0xFF10),
        ("refused", -1, 0xFF10),
        ("its_own_name", None, 0xFFFF),
        ("its_own_name", 7, 7),
    ],
)
def test_what_status_shows(outcome: str, device_code: int | None, word: int) -> None:
    assert status_word(outcome, device_code) == word


def test_outcomes_that_only_a_protocol_knows() -> None:
    assert error_code("its_own_name") is ErrorCode.FAILED
    assert error_code("closed") is ErrorCode.CLOSED


@pytest.mark.parametrize(
    ("failure", "shown"),
    [
        (Failure(outcome="no_reply", cause="nothing came in time"), "no_reply"),
        (Failure(outcome="no_reply", cause="check"), "no_reply: check"),
        (Failure(outcome="closed", cause="the other side has closed the connection"),
         "closed: the other side has closed the connection"),
        (Failure(outcome="own_name", cause="it is busy"), "own_name: it is busy"),
        (Failure(outcome="refused", device_code=2, meaning="illegal address"), "refused 0x0002: illegal address"),
        (Failure(outcome="refused", device_code=2, cause="in frame X"), "refused 0x0002: in frame X"),
        (Failure(outcome="dead"), "dead"),
    ],
)  # fmt: skip
def test_a_failure_is_shown_with_its_reason_where_that_says_more(failure: Failure, shown: str) -> None:
    assert str(failure) == shown
