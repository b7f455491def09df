"""The files in `schemas/` equal the output of their script for the tables of keys."""

from __future__ import annotations

import pytest

from framekit.definition.keys import properties_of
from framekit.definition.model.sections import Line, Receiver, StationType
from framekit.definition.model.services import (
    After,
    BlockWork,
    CommandRules,
    Errors,
    JobWork,
    ServeWork,
    ServiceRow,
)
from framekit.definition.sources import shipped_folder
from framekit.runfile.schema_files import read_files, text_of, with_tables


def test_the_files_are_up_to_date() -> None:
    folder = shipped_folder("schemas")
    for name, schema in with_tables(read_files(folder)).items():
        written = text_of(schema) + "\n"
        assert (folder / name).read_text("utf-8") == written, "run python -m framekit.runfile.schema_files"


READ: dict[str, tuple[type, ...]] = {
    "receiver": (Receiver,), "line": (Line,), "station": (StationType,), "service_row": (ServiceRow,),
    "work": (ServeWork,), "block": (BlockWork, JobWork), "commands": (CommandRules,), "afterwards": (After,),
    "errors": (Errors,),
}  # fmt: skip
"""Handwritten definitions of the schema, with the classes that their keys are read into."""
OTHERS = {"doc", "rows"}
"""Keys for people, and those that stand for other rows."""


@pytest.mark.parametrize("name", READ)
def test_every_key_of_the_schema_is_read_and_no_other(name: str) -> None:
    known = read_files(shipped_folder("schemas"))["protocol.schema.json"]["$defs"][name]["properties"]
    assert {key for part in READ[name] for key in properties_of(part)} == {*known} - OTHERS
