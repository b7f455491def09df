"""Documents of protocols: every shipped frame is drawn and described.

Sizes add up, and no text of a file becomes markup.
"""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import pytest

from framekit.api.vectors import vectors_path
from framekit.cli.main import main
from framekit.definition.load.protocol import definition_path, load_protocol, load_protocol_text
from framekit.definition.model.frames import StaticSizes
from framekit.definition.sources import shipped_definitions
from framekit.extras.documents.document import (
    Box,
    Heading,
    Listing,
    PageTable,
    Paragraph,
    Picture,
    byte_diagram,
    document,
    html,
    markdown,
)

NAMES = [path.stem for path in shipped_definitions() if "." not in path.stem]

QUICK = ("modbus-rtu", "mldp", "m-bus", "dnp3-link", "scpi")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name in QUICK else pytest.mark.long) for name in NAMES]
)
def test_every_frame_is_drawn_and_its_sizes_add_up(name: str) -> None:
    protocol = load_protocol(name)
    blocks = document(protocol, vectors_path(definition_path(name)))
    pictures = {block.title: block for block in blocks if isinstance(block, Picture)}
    assert len(pictures) == len(protocol.frames)
    titles = [block.text for block in blocks if isinstance(block, Heading)]
    assert titles[0] == name and set(protocol.frames) <= set(titles)
    sizes = StaticSizes(protocol.frames)
    for frame in protocol.frames.values():
        place = next(at for at, block in enumerate(blocks) if isinstance(block, Heading) and block.text == frame.name)
        table = next(block for block in blocks[place:] if isinstance(block, PageTable))
        rows = [row for row in table.rows if not row[2].startswith("· ")]
        whole = sizes.frame(frame.name)
        if whole.fixed is not None and all(row[1].isdigit() or not row[1] for row in rows):
            assert sum(int(row[1] or 0) for row in rows) == whole.fixed
            assert [int(row[0]) for row in rows if row[1]] == [
                sum(int(row[1] or 0) for row in rows[:at]) for at, row in enumerate(rows) if row[1]
            ]
    for picture in pictures.values():
        root = ElementTree.fromstring(picture.svg)
        assert root.tag.endswith("svg") and float(root.get("width") or 0) <= 1100


HOSTILE = """
protocol: hostile
about: '<script>alert(1)</script> | `x` [a](javascript:b) ![c](d)'
source: "]]> & </title> <b>"
params: {p: {type: text, default: "'<i>|</i>'", doc: '</td><script>'}}
frames:
  A:
    doc: '</svg><script>alert(2)</script>'
    body:
      - {const: STX, doc: 'a | b <img src=x onerror=y>'}
      - {field: size, type: u8, doc: '`code` *bold*'}
      - {text: '</text><script>'}
"""


class Tags(HTMLParser):
    """A parser that collects the elements of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.found: set[str] = set()

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.found.add(tag)
        assert not any(name.startswith("on") for name, _ in attributes)


def test_text_of_a_definition_is_never_markup() -> None:
    blocks = document(load_protocol_text(HOSTILE))
    tags = Tags()
    tags.feed(html(blocks))
    assert not tags.found & {"script", "img", "i", "b", "a"} and "svg" in tags.found
    text, pictures = markdown(blocks, "pictures")
    assert "<" not in re.sub(r"\\<", "", text) and not re.search(r"(?<!\\)\]\(javascript|!\[c", text)
    table = [line for line in text.splitlines() if "img src" in line]
    assert len(table) == 1 and len(re.findall(r"(?<!\\)\|", table[0])) == 5
    assert list(pictures) == ["A.svg"] and ElementTree.fromstring(pictures["A.svg"]) is not None


def test_invisible_characters_are_shown() -> None:
    marks = "a\u202eb\u2066c\x1b[2Jd\x9b"
    blocks = [Heading(1, marks), Paragraph(marks), PageTable([marks], [[marks]]), Listing("", marks)]
    for page, times in ((html(blocks), 6), (markdown(blocks, "pictures")[0], 5)):
        assert not set(page) & set("\u202e\u2066\x1b\x9b")
        assert page.replace("\\\\", "\\").count("\\u202e") == times, page


def test_a_long_frame_has_several_rows_and_strange_signs_are_shown_as_such() -> None:
    boxes = [Box(f"field {n}", "u16", "2", 2, "value") for n in range(40)]
    root = ElementTree.fromstring(byte_diagram("many \x00\x1b", boxes))
    rows = {rect.get("y") for rect in root.iter() if rect.tag.endswith("rect")}
    assert len(rows) > 2


def test_the_command_writes_a_page_or_markdown_with_pictures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["generate", "document", "modbus-rtu", "-o", "a.html"]) == 0
    assert "read_holding" in (tmp_path / "a.html").read_text("utf-8")
    assert main(["generate", "document", "modbus-rtu", "-o", "b.md"]) == 0
    text = (tmp_path / "b.md").read_text("utf-8")
    named = set(re.findall(r"\((b\.frames/[^)]*)\)", text))
    assert named == {f"b.frames/{path.name}" for path in (tmp_path / "b.frames").iterdir()}
    assert main(["generate", "document", "modbus-rtu"]) == 2
    assert "add -o NAME.html" in capsys.readouterr().err
    assert main(["generate", "document", "modbus-rtu", "-o", "no/such/folder/x.html"]) == 1
