"""The guide to the language: its sentences are short, its examples are executed, and they show every key."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from docs.example_keys import Used, examples
from docs.pages import CHECKLISTS, DOCS, EXAMPLES, GUIDE, PAGES, ROOT, anchors, links, sentences, snippets
from reference_page import Reference

from framekit.cli.main import main
from framekit.definition.keys import properties_of
from framekit.definition.sources import shipped_folder
from framekit.run.behaviours import BEHAVIOURS, Behaviour
from framekit.runfile.schema_files import read_files

MOST_WORDS = 25
STORED = [
    file.with_name(file.name.replace(".vectors.yaml", ".yaml"))
    for file in sorted((EXAMPLES / "language").glob("*.vectors.yaml"))
]
"""The examples of the guide that are stored in the repository, each with test vectors."""


def name(page: Path) -> str:
    return str(page.relative_to(ROOT))


@pytest.mark.parametrize("page", GUIDE, ids=name)
def test_sentences_are_short(page: Path) -> None:
    assert [text for text in sentences(page) if len(text.split()) > MOST_WORDS] == []


@pytest.mark.parametrize("page", GUIDE, ids=name)
def test_every_example_is_a_file_that_a_command_reads(page: Path) -> None:
    """YAML that belongs to no file, or to a file that no command and no other file reads, would not be executed."""
    read = "\n".join(snippet.text for snippet in snippets(page) if snippet.kind in ("console", "python"))
    for snippet in snippets(page):
        if snippet.kind == "yaml":
            assert snippet.file is not None, f"line {snippet.line}: begin the block with '# file: NAME'"
            if EXAMPLES / read_by(snippet.file) in STORED:
                continue  # executed by test_the_vectors_of_the_stored_examples_pass
            others = (other.text for other in snippets(page) if other.kind == "yaml" and other.file != snippet.file)
            if any(f": {Path(snippet.file).name}\n" in text for text in others):
                continue
            assert read_by(snippet.file) in read, f"line {snippet.line}: no command reads {snippet.file}"


@pytest.mark.parametrize("definition", STORED, ids=lambda file: file.stem)
def test_the_vectors_of_the_stored_examples_pass(definition: Path) -> None:
    assert main(["test", str(definition)]) == 0


def test_every_stored_example_is_shown_or_named_by_a_page() -> None:
    text = "\n".join(page.read_text("utf-8") for page in PAGES)
    assert [file.name for file in STORED if f"language/{file.stem}." not in text] == []


def test_the_list_of_pages_is_whole() -> None:
    listed = {str((DOCS / file).resolve()) for file, _ in links(DOCS / "README.md")}
    indexes = [DOCS / "language.md", DOCS / "reference.md", DOCS / "segments.md"]
    guide = {(DOCS / page).resolve() for index in indexes for page, _ in links(index)}
    assert [name(page) for page in DOCS.glob("**/*.md") if str(page) not in listed and page not in guide] == [
        "docs/README.md"
    ]


def read_by(file: str) -> str:
    """Return the name that a command uses for this file: vectors are read with their definition."""
    return file.replace(".vectors.yaml", ".yaml")


def test_every_key_stands_in_an_example() -> None:
    used = Used(Reference(read_files(shipped_folder("schemas"))))
    for example in examples():
        used.visit(used.reference.root, example)
    assert used.all_keys() - used.keys == set(), "show these keys in an example of the guide, or in a case of segments"


def test_every_key_of_a_behaviour_stands_in_an_example_of_its_page() -> None:
    shown: set[tuple[str, str]] = set()
    page = next(page for page in PAGES if page.name == "behave.md")
    files = [snippet.text for snippet in snippets(page) if snippet.kind == "yaml"]
    for text in [*files, (ROOT / "examples" / "oven.device.yaml").read_text("utf-8")]:
        for keys in yaml.safe_load(text).get("behave", {}).values():
            kind = next(iter(keys.keys() & BEHAVIOURS.keys()))
            shown |= {(kind, key) for key in keys} | {("", key) for key in keys if key in properties_of(Behaviour)}
    wanted = {(word, key) for word, kind in BEHAVIOURS.items() for key in properties_of(kind)}
    of_all = {("", key) for key in properties_of(Behaviour)}
    assert {pair for pair in wanted if ("", pair[1]) not in of_all} - shown == set()
    assert of_all - shown == set()


@pytest.mark.parametrize("page", [*PAGES, *CHECKLISTS, ROOT / "CHANGELOG.md"], ids=name)
def test_links_lead_somewhere(page: Path) -> None:
    wrong = []
    for file, heading in links(page):
        target = (page.parent / file).resolve() if file else page
        if not target.exists() or (heading and heading not in anchors(target)):
            wrong.append(f"{file}#{heading}")
    assert wrong == []
