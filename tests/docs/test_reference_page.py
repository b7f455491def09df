"""The pages of the reference follow the schema, and describe every key."""

from __future__ import annotations

from docs.pages import DOCS
from reference_page import GUIDE, Reference

from framekit.definition.sources import shipped_folder
from framekit.runfile.schema_files import read_files

REFERENCE = Reference(read_files(shipped_folder("schemas")))


def test_the_pages_are_up_to_date() -> None:
    stored = [DOCS / "reference.md", *(DOCS / "reference").glob("*.md")]
    pages = {str(page.relative_to(DOCS)): page.read_text("utf-8") for page in stored}
    assert pages == REFERENCE.pages(), "run python tools/reference_page.py"


def test_every_part_is_on_one_page() -> None:
    text = "\n".join(REFERENCE.pages().values())
    assert [part.name for part in REFERENCE.parts.values() if text.count(f"\n## {part.name}\n") != 1] == []


def test_every_key_is_described() -> None:
    keys = [
        (f"{part.name}: {key}", schema)
        for part in REFERENCE.parts.values()
        for key, schema in part.schema["properties"].items()
    ]
    assert [where for where, schema in keys if not REFERENCE.description(schema)] == []


def test_the_guide_explains_keys_that_there_are() -> None:  # the test of links covers the existence of the pages
    assert set(GUIDE) <= set(REFERENCE.root["properties"])


def test_every_mapping_of_the_schema_that_has_keys_is_a_part() -> None:
    definitions = REFERENCE.root["$defs"].values()
    assert [
        found["title"] for found in definitions if found.get("properties") and id(found) not in REFERENCE.parts
    ] == []
