"""The pages of segments follow the cases that both compilers are tested with."""

from __future__ import annotations

from docs.pages import DOCS
from docs.segments_table import PAGES, pages
from segment_cases import SECTIONS


def test_the_pages_are_up_to_date() -> None:
    stored = [DOCS / "segments.md", *(DOCS / "segments").glob("*.md")]
    found = {str(page.relative_to(DOCS)): page.read_text(encoding="utf-8") for page in stored}
    assert found == pages(), "run python tests/docs/segments_table.py"


def test_every_section_is_on_one_page() -> None:
    assert sorted(title for titles in PAGES.values() for title in titles) == sorted(SECTIONS)
