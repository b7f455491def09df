"""The guide to the language: its sentences are short, its examples are executed, and they show every key."""

from __future__ import annotations

from pathlib import Path

import pytest
from docs.example_keys import Used, examples
from docs.pages import GUIDE, PAGES, ROOT, anchors, links, sentences, snippets

from framekit.definition.sources import shipped_folder
from framekit.runfile.reference_page import Reference
from framekit.runfile.schema_files import read_files

MOST_WORDS = 30
WITHOUT_EXAMPLE: dict[str, str] = {
    "action": "put store",
    "block section": "abort call every from host inspect into job late params read report session station then "
    "times write",
    "commands section": "done failed frame meaning most request status then waits",
    "drop section": "from when",
    "errors section": "detail names unanswered when",
    "keep_alive section": "after run",
    "lane": "at_once",
    "place": "area code count data memory start text unit",
    "place in serve section in service row": "area code count data memory start unit",
    "protocol file": "commands conversions profile server sessions",
    "read section": "area as code count each memory start text unit",
    "role": "session",
    "row": "because deliver station take",
    "row in then section": "set store when",
    "serve section in service row": "as block drop each let read set span update write",
    "server section": "refuse",
    "service row": "outside_session serve",
    "session": "close keep_alive lost_by one_station open reconnect",
    "step": "deliver on_break on_closed put",
    "table of names": "table when",
    "then section": "set store when",
    "what back says of each item": "memory",
}
"""Keys of a part of the reference page that no example shows yet. Only take keys out of this list."""
OLD = {"checker", "commands", "errors", "roles", "serving"}
"""Pages that are still to be written anew."""


def name(page: Path) -> str:
    return str(page.relative_to(ROOT))


@pytest.mark.parametrize("page", [page for page in GUIDE if page.stem not in OLD], ids=name)
def test_sentences_are_short(page: Path) -> None:
    assert [text for text in sentences(page) if len(text.split()) > MOST_WORDS] == []


@pytest.mark.parametrize("page", GUIDE, ids=name)
def test_every_example_is_a_file_that_a_command_reads(page: Path) -> None:
    """A piece of YAML that belongs to no file would be executed by nothing."""
    read = "\n".join(snippet.text for snippet in snippets(page) if snippet.kind in ("console", "python"))
    for snippet in snippets(page):
        if snippet.kind == "yaml":
            assert snippet.file is not None, f"line {snippet.line}: begin the block with '# file: NAME'"
            assert read_by(snippet.file) in read, f"line {snippet.line}: no command reads {snippet.file}"


def read_by(file: str) -> str:
    """What stands in a command that reads this file: vectors are read with their definition."""
    return file.replace(".vectors.yaml", ".yaml")


def test_every_key_stands_in_an_example() -> None:
    used = Used(Reference(read_files(shipped_folder("schemas"))))
    for example in examples():
        used.visit(used.reference.root, example)
    missing = used.all_keys() - used.keys
    listed = {(part, key) for part, keys in WITHOUT_EXAMPLE.items() for key in keys.split()}
    assert missing - listed == set(), "show these keys in an example of the guide"
    assert listed - missing == set(), "these have an example now: take them out of the list"


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_links_lead_somewhere(page: Path) -> None:
    wrong = []
    for file, heading in links(page):
        target = (page.parent / file).resolve() if file else page
        if not target.exists() or (heading and heading not in anchors(target)):
            wrong.append(f"{file}#{heading}")
    assert wrong == []
