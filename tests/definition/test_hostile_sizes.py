"""Large and strange files: work grows with their size, problems are counted, numbers are bounded.

Work is counted in function calls, which do not depend on the machine.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
from spread import spread

from framekit.api.check import check_file
from framekit.cli.main import main
from framekit.definition.load.protocol import load_protocol_text
from framekit.definition.problems import LONGEST_SENTENCE, MOST_PROBLEMS, DefinitionError

HEAD = "protocol: m\nline: {speed: 9600, format: 8E1}\n"
ASK = f"{HEAD}frames: {{ASK: {{body: [{{const: STX}}, %s]}}}}\n"


def unknown_keys(count: int) -> str:
    return ASK % "{const: ETX}" + "".join(f"zz{number}: 1\n" for number in range(count))


def unknown_keys_of_a_field(count: int) -> str:
    return ASK % f"{{field: x, type: u8, {', '.join(f'zz{number}: 1' for number in range(count))}}}"


def keys_after_an_empty_one(count: int) -> str:
    return ASK % "{const: ETX}" + "params:\n" + "".join(f"zz{number}: 1\n" for number in range(count))


def unknown_types(count: int) -> str:
    return ASK % ", ".join(f"{{field: f{number}, type: nope{number}}}" for number in range(count))


def value_names(count: int) -> str:
    return ASK % f"{{field: x, type: u32, values: {{{', '.join(f'{number}: v{number}' for number in range(count))}}}}}"


def equal_frames(count: int) -> str:
    bodies = (f"F{number}: {{body: [{{const: STX}}, {{field: x, type: u8}}]}}" for number in range(count))
    return f"{HEAD}frames: {{{', '.join(bodies)}}}\n"


def fields(count: int) -> str:
    return ASK % ", ".join(f"{{field: f{number}, type: u8}}" for number in range(count))


def conditions(count: int) -> str:
    optional = (f"{{field: f{number}, type: u8, when: x == {number}}}" for number in range(count))
    return ASK % f"{{field: x, type: u32}}, {', '.join(optional)}"


def cases(count: int) -> str:
    inside = (f"{number}: [{{field: f{number}, type: u8}}]" for number in range(count))
    return ASK % f"{{field: x, type: u32}}, {{choose: x, cases: {{{', '.join(inside)}}}}}"


def long_expression(count: int) -> str:
    return ASK % f"{{field: x, type: u8, is: {' + '.join(['1'] * count)}}}"


def problems_of(text: str) -> tuple[str, ...]:
    """Return the problems of a definition."""
    try:
        load_protocol_text(text)
    except DefinitionError as error:
        return tuple(map(str, error.problems))
    return ()


def calls_of(work: Callable[[], object]) -> int:
    """Return the number of function calls of some work."""
    count = 0

    def note(frame: FrameType, event: str, argument: Any) -> None:
        nonlocal count
        count += event in ("call", "c_call")

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        work()
    finally:
        sys.setprofile(before)
    return count


GROWING = [
    unknown_keys, unknown_keys_of_a_field, keys_after_an_empty_one, unknown_types, value_names, equal_frames,
    fields, conditions, cases, long_expression,
]  # fmt: skip


@pytest.mark.parametrize("text", spread(GROWING, 5))
def test_the_work_of_loading_grows_with_the_size(text: Callable[[int], str]) -> None:
    size = 60
    problems_of(text(size))
    small, large = (calls_of(lambda count=count: problems_of(text(count))) for count in (size * 2, size * 8))
    assert large < 4.6 * small, (small, large)


@pytest.mark.parametrize(
    ("text", "counted"),
    [
        (unknown_keys, "901 more unknown keys in a protocol file – remove them or correct their names"),
        (unknown_keys_of_a_field, "901 more unknown keys in a field segment of frame 'ASK'"),
        (unknown_types, "901 more errors"),
    ],
)
def test_a_hundred_problems_are_reported_and_the_others_counted(text: Callable[[int], str], counted: str) -> None:
    problems = problems_of(text(1000))
    assert len(problems) <= MOST_PROBLEMS + 1
    assert any(counted in problem for problem in problems), problems[-2:]


def test_problems_of_loaders_are_counted_too() -> None:
    problems = problems_of(
        ASK % ", ".join(f"{{field: f{number}, type: u8, when: no{number}}}" for number in range(300))
    )
    assert len(problems) == MOST_PROBLEMS + 1
    assert problems[-1].endswith("200 more problems are not shown – correct the others first")


NUMBERS = ("9" * 20_000, f"0x{'f' * 20_000}", f"-{'7' * 5_000}", f"{'9' * 20_000} ms", f"{'9' * 20_000}.5 s")


@pytest.mark.parametrize("number", NUMBERS, ids=range(len(NUMBERS)))
@pytest.mark.parametrize(
    "place",
    [
        "{field: x, type: u8, default: %s}", "{field: x, type: u8, is: 1 + %s}", "{field: x, type: u8, range: 0..%s}",
        "{field: x, type: u8, values: {%s: a}}", "{data: x, size: %s}", "{const: ETX}, {repeat: r, times: %s, of: []}",
        "{field: x, type: u8, when: %s == 1}", "{field: x, type: %s}",
    ],
)  # fmt: skip
def test_a_number_of_any_length_is_a_short_problem(place: str, number: str, tmp_path: Path) -> None:
    path = tmp_path / "m.yaml"
    path.write_text(ASK % place.replace("%s", number), "utf-8")
    problems = [str(problem) for problem in check_file(str(path)).problems]
    assert problems and all(len(problem) < 3 * LONGEST_SENTENCE for problem in problems)


@pytest.mark.parametrize("section", ["line: {speed: %s}", "params: {p: {type: number, default: %s, range: 0..%s}}"])
def test_numbers_of_sections_are_bounded_too(
    section: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for number in NUMBERS:
        Path("m.yaml").write_text(
            f"protocol: m\n{section.replace('%s', number)}\nframes: {{ASK: {{body: []}}}}\n", "utf-8"
        )
        assert main(["check", "m.yaml"]) == 1
        assert "m.yaml:2:" in capsys.readouterr().err


def test_digits_of_other_scripts_are_no_traceback() -> None:
    assert problems_of(f"{ASK % '{const: ETX}'}tables: {{t: {{²-³: 1, 1-{'9' * 5000}: 2}}}}\n")
