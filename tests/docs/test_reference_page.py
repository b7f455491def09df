"""`docs/reference.md` is what the schema makes of it, says something about every key, and its links lead somewhere."""

from __future__ import annotations

import re
from pathlib import Path

from framekit.definition.sources import shipped_folder
from framekit.runfile.reference_page import GUIDE, Reference
from framekit.runfile.schema_files import read_files

DOCS = Path(__file__).parents[2] / "docs"
REFERENCE = Reference(read_files(shipped_folder("schemas")))


def anchors(page: str) -> set[str]:
    """Where links into a page may lead: its headings as GitHub makes anchors of them."""
    titles = re.findall(r"^#+ (.*)$", (DOCS / page).read_text("utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def test_the_page_is_up_to_date() -> None:
    page = (DOCS / "reference.md").read_text("utf-8")
    assert page == REFERENCE.page(), "run python -m framekit.runfile.reference_page"


def test_every_key_is_described() -> None:
    assert REFERENCE.undescribed() == []


def test_every_part_of_a_protocol_file_has_a_place_in_the_guide() -> None:
    assert set(GUIDE) <= set(REFERENCE.root["properties"])
    assert set(GUIDE.values()) <= anchors("language.md")


def test_links_within_the_page_lead_to_a_part() -> None:
    linked = re.findall(r"\]\(#([^)]*)\)", REFERENCE.page())
    assert linked
    assert set(linked) <= anchors("reference.md")


def test_every_mapping_of_the_schema_that_has_keys_is_a_part() -> None:
    definitions = REFERENCE.root["$defs"].values()
    assert [
        found["title"] for found in definitions if found.get("properties") and id(found) not in REFERENCE.parts
    ] == []
