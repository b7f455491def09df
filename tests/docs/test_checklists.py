"""The checklists of the protocols are true: their sources exist, and each row is tested or not covered."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from docs.checklists import ROOT, checklists, filled_in, read, written_out

CHECKLISTS = checklists()
WITH_SPECIFICATION = ("ccm", "ge-rtu", "snp", "snp-x", "df1", "srtp", "ge-channels")
"""The pages of the manuals whose specifications have numbered features."""


def test_every_manual_has_a_checklist_and_says_what_it_lacks() -> None:
    assert {page.stem for page in CHECKLISTS} == set(WITH_SPECIFICATION)
    for name in (*WITH_SPECIFICATION, "commreq"):
        text = (ROOT / "docs" / "protocols" / f"{name}.md").read_text(encoding="utf-8")
        assert "\n## Not covered\n" in text, name


@pytest.mark.parametrize("page", CHECKLISTS, ids=lambda page: page.stem)
def test_the_sources_exist_and_are_counted(page: Path) -> None:
    found = read(page)
    assert [path for paths in found.sources.values() for path in paths if not path.exists()] == []
    assert page.read_text(encoding="utf-8") == filled_in(page), "run python tests/docs/checklists.py"


@pytest.mark.parametrize("page", CHECKLISTS, ids=lambda page: page.stem)
def test_every_row_names_where_it_is_tested(page: Path) -> None:
    found = read(page)
    unknown = []
    for row in found.rows:
        without_remarks = re.sub(r"\([^)]*\)", "", row.tested)
        for part in filter(None, (word.strip(" *") for word in re.split(r"[,;]", without_remarks))):
            file = part.strip("`")
            exists = (ROOT / file).exists() or any((ROOT / "tests").rglob(file.split("/")[-1]))
            if part != "–" and part not in found.sources and not (part.startswith("`") and exists):
                unknown.append(f"{page.name}:{row.line}: {part}")
    assert unknown == []


@pytest.mark.parametrize("page", CHECKLISTS, ids=lambda page: page.stem)
def test_rows_without_a_test_are_not_covered_or_on_another_page(page: Path) -> None:
    found = read(page)
    named = set(written_out(found.not_covered.replace("|", ",").replace("\n", ",")))
    missing = []
    for row in found.rows:
        elsewhere = re.search(r"\]\(\S+\.md", row.state) is not None
        says_so = row.state.startswith("not covered")
        if row.tested == "–" and not elsewhere and not (says_so and set(row.identifiers) <= named):
            missing.append(f"{page.name}:{row.line}: {row.rows}: {row.state}")
        if "left out" in row.state:
            missing.append(f"{page.name}:{row.line}: {row.rows} is left out: say so under Not covered")
    assert missing == []


@pytest.mark.parametrize("page", CHECKLISTS, ids=lambda page: page.stem)
def test_no_number_is_left_out(page: Path) -> None:
    numbers: dict[str, set[int]] = {}
    for row in read(page).rows:
        for identifier in row.identifiers:
            letters = identifier.rstrip("0123456789")
            numbers.setdefault(letters, set()).add(int(identifier[len(letters) :]))
    gaps = {letters: sorted(set(range(1, max(some) + 1)) - some) for letters, some in numbers.items()}
    assert {letters: some for letters, some in gaps.items() if some} == {}


def test_ranges_are_written_out() -> None:
    assert written_out("F001 – F003, F007") == ["F1", "F2", "F3", "F7"]
    assert written_out("X-42 – X-43") == ["X42", "X43"]
    assert written_out("nothing") == []
