"""Recordings of other programs: the guess for each, compared with the known protocol."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from spread import WHOLE, many, spread

from framekit.extras.guess.draft import write_definition
from framekit.extras.guess.recordings import guess, reading_of

sys.path.insert(0, str(Path(__file__).parents[3]))
from benchmarks.guess_real import FOLDER, TRUTHS, case_of, cases_of, judged_real


@pytest.mark.parametrize("name", spread(TRUTHS, 3))
def test_what_is_said_of_a_recording_is_right(name: str) -> None:
    marks = judged_real(case_of(name, 200))
    missed = {what for what in ("framing", "check", "length") if getattr(marks, what) is False}
    assert not missed and not marks.wrong


@pytest.mark.parametrize("name", spread(TRUTHS, 5))
def test_the_definition_of_a_recording_reads_it(name: str, tmp_path: Path) -> None:
    case, path = case_of(name, 200), tmp_path / "found.yaml"
    assert write_definition(guess(case.chunks), path, name).problems == ()
    reading = reading_of(path, case.chunks).data
    assert (reading["frames"], reading["bad"], reading["noise"]) == (len(case.good), 0, 0)


def test_each_recording_has_its_truth_and_its_row() -> None:
    assert {path.stem for path in FOLDER.glob("*.pcap")} == set(TRUTHS)
    readme = (FOLDER / "README.md").read_text("utf-8")
    assert all(f"| {name}.pcap |" in readme for name in TRUTHS)
    assert sum(path.stat().st_size for path in FOLDER.glob("*.pcap")) < 300_000


DEAR = {"mbpoll-tcp", "melsec-4e", "melsec-3e-ascii", "fins-tcp"}
"""Recordings that take 10 s each and have a length before the body, like two others; only used in the whole test."""
SHARE = many(3, 1)
"""Step of the tested cases, over all recordings, numbers of frames, and damaged or clean."""


@pytest.mark.long
def test_first_frames_and_damaged_ones() -> None:
    cases = [case for name in TRUTHS if WHOLE or name not in DEAR for case in cases_of(name, 1)]
    marks = [judged_real(case) for case in cases[::SHARE]]
    assert sum(mark.framing for mark in marks) >= 0.98 * len(marks)
    for known in ([mark.check for mark in marks], [mark.length for mark in marks]):
        assert sum(bool(name) for name in known) >= 0.98 * sum(name is not None for name in known)
    assert sum(len(mark.wrong) for mark in marks) <= 0.005 * sum(mark.sure for mark in marks)
