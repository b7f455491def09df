"""The pages of the command line have every option of the parser; terminal pictures come from real runs."""

from __future__ import annotations

import re
from html import unescape

import cli_page
import pictures
import pytest
from docs.pages import PAGES, ROOT

from framekit.cli.verb_table import VERBS


def test_the_pages_have_the_options_of_the_parser() -> None:
    pages = cli_page.read_pages()
    assert cli_page.generated(pages) == pages, "run python tools/cli_page.py"
    index = pages.pop(cli_page.INDEX)
    assert "| `--retries N` |" in index, "an option of several verbs is described in the index"
    text = "".join(pages.values())
    for verb in VERBS:
        assert f"$ framekit {verb} " in text or f"\nframekit {verb}" in text, f"{verb}: show an example"
        options = text.partition(f"\n<!-- options {verb} -->\n")[2].partition("<!-- end -->")[0]
        for name, meaning in cli_page.rows_of(verb):
            shared = f"`{name.split(' ')[0].strip('`')}`"
            assert f"| {name} | {meaning} |" in options or (shared in options and f"| {name} | {meaning} |" in index)


@pytest.mark.parametrize("picture", pictures.PICTURES, ids=lambda picture: picture.name)
def test_pictures_are_used_and_name_no_other_host(picture: pictures.Picture) -> None:
    text = picture.file.read_text("utf-8")
    shown = unescape(re.sub(r"<[^>]*>", "", text)).replace("\xa0", " ")
    assert f"$ {picture.command}" in shown and "/work/" not in shown and "/tmp/" not in shown
    assert set(re.findall(r"https?://[^\"' ]*", text)) == {"http://www.w3.org/2000/svg"}
    assert any(f"images/{picture.file.name})" in page.read_text("utf-8") for page in PAGES)


def test_the_screen_of_a_drawing() -> None:
    output = "begin\r\r\n\x1b[?7lone\r\n\x1b[?7h\r\x1b[1A\x1b[J\x1b[?7ltwo\r\n\x1b[?7h\r\x1b[1A\x1b[Jend\r\n"
    assert pictures.screen_of(output, last_drawing=True) == "begin\ntwo"
    assert pictures.screen_of(output, last_drawing=False) == "begin\nend"


def test_the_output_of_a_command_on_a_terminal_becomes_a_picture() -> None:
    command = "framekit decode modbus-rtu 01 03"
    screen = pictures.screen_of(pictures.output_of(command, ROOT), last_drawing=False)
    assert "\x1b[31mframekit decode\x1b[0m: no frame fits" in screen
    svg = pictures.svg_of(command, screen)
    assert "no\xa0frame\xa0fits" in unescape(svg) and "#cc555a" in svg
