"""Fill in the sources of the checklists in `tests/checklists` from the files: `python tests/docs/checklists.py`.

A checklist begins with a table of its sources: a word, files, and the number of their cases. Then come its rows:
identifiers of the specification, a description, the state, and the tests: a source by its word, a file by its name, or
a dash. A row with a dash is not covered, or is on another page. The page of the protocol says what is not covered.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import yaml

ROOT = Path(__file__).parents[2]
LISTS = ROOT / "tests" / "checklists"
PAGES = ROOT / "docs" / "protocols"
SOURCES = "| source | files | cases |"
ROWS = "| rows | what | state | where tested |"
_TEST = re.compile(r"^(?:async )?def test_", re.MULTILINE)
_ID = re.compile(r"([A-Z]+)-?(\d+)")


@dataclass(frozen=True)
class Row:
    """A row of a checklist."""

    line: int
    rows: str
    what: str
    state: str
    tested: str

    @property
    def identifiers(self) -> list[str]:
        """Return the identifiers of the row, ranges written out."""
        return written_out(self.rows)


@dataclass(frozen=True)
class Checklist:
    """The checklist of a protocol."""

    page: Path
    sources: dict[str, list[Path]]
    rows: list[Row]
    not_covered: str
    """Text of the section "not covered" of the protocol's page."""


def checklists() -> list[Path]:
    """Return the checklists."""
    return sorted(LISTS.glob("*.md"))


def written_out(text: str) -> list[str]:
    """Return the identifiers in `F001 – F003, F007`: F1, F2, F3, F7."""
    found: list[str] = []
    for part in text.split(","):
        names = [(letter, int(number)) for letter, number in _ID.findall(part)]
        if len(names) == 2 and "–" in part and names[0][0] == names[1][0]:
            found += [f"{names[0][0]}{number}" for number in range(names[0][1], names[1][1] + 1)]
        else:
            found += [f"{letter}{number}" for letter, number in names]
    return found


def read(page: Path) -> Checklist:
    """Return the checklist of a file."""
    lines = page.read_text(encoding="utf-8").splitlines()
    sources: dict[str, list[Path]] = {}
    rows: list[Row] = []
    for number, cells in _table(lines, SOURCES):
        assert len(cells) == 3, f"{page.name}:{number}"
        sources[cells[0].strip("*")] = [ROOT / name for name in re.findall(r"`([^`]+)`", cells[1])]
    for number, cells in _table(lines, ROWS):
        assert len(cells) == 4, f"{page.name}:{number}: {len(cells)} cells"
        rows.append(Row(number, *cells))
    _, _, rest = (PAGES / page.name).read_text(encoding="utf-8").partition("\n## Not covered\n")
    return Checklist(page, sources, rows, rest.partition("\n## ")[0])


def _table(lines: list[str], head: str) -> Iterator[tuple[int, list[str]]]:
    """Yield the rows of the table with this head: number of the line, cells."""
    start = lines.index(head) + 2
    for number, line in enumerate(lines[start:], start=start + 1):
        if not line.startswith("|"):
            return
        yield number, [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]


def cases(path: Path) -> str:
    """Return the number of cases of a file of vectors, or of the tests of a file, in words."""
    if path.suffix == ".yaml":
        content = yaml.load(path.read_text(encoding="utf-8"), yaml.CSafeLoader)
        counts = {kind: len(content.get(kind, ())) for kind in ("frames", "conversations")}
        return ", ".join(f"{count} {kind}" for kind, count in counts.items() if count)
    return f"{len(_TEST.findall(path.read_text(encoding='utf-8')))} tests"


def filled_in(page: Path) -> str:
    """Return the text of a checklist with the counted cases in the table of sources."""
    lines = page.read_text(encoding="utf-8").splitlines(keepends=True)
    stripped = [line.rstrip("\n") for line in lines]
    for number, cells in _table(stripped, SOURCES):
        files = [ROOT / name for name in re.findall(r"`([^`]+)`", cells[1])]
        counted = "; ".join(cases(file) for file in files)
        lines[number - 1] = f"| {cells[0]} | {cells[1]} | {counted} |\n"
    return "".join(lines)


if __name__ == "__main__":
    for checklist in checklists():
        checklist.write_text(filled_in(checklist), encoding="utf-8")
