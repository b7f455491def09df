"""`schemas/` says what the tables of keys say, as their script writes it."""

from __future__ import annotations

from framekit.definition.schema_files import read_files, text_of, with_tables
from framekit.definition.sources import shipped_folder


def test_the_files_are_up_to_date() -> None:
    folder = shipped_folder("schemas")
    for name, schema in with_tables(read_files(folder)).items():
        written = text_of(schema) + "\n"
        assert (folder / name).read_text("utf-8") == written, "run python -m framekit.definition.schema_files"
