"""Command blocks as words: the manual's examples in both directions, invalid words, and the description of a block."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest
from shipped import EXAMPLES

from framekit.cli.main import main
from framekit.definition.load.protocol import load_protocol
from framekit.extras.commreq.command_meaning import Meaning, meaning_of
from framekit.link.conversation import default_line
from framekit.link.scope import Scope
from framekit.memory.memory import DeviceMemory
from framekit.run.commands import CommandBlocks, CommandFaultError, bytes_of, words_of
from framekit.runfile.devices import memory_of

HEAD = [0, 8, 9, 0, 0]


@cache
def blocks_of(protocol: str, role: str = "master") -> CommandBlocks:
    channel = load_protocol(protocol)
    application = load_protocol(channel.commands_file)
    scope = Scope(channel, role=role, line=default_line(channel))
    areas, _ = memory_of(application)
    return CommandBlocks(application, DeviceMemory(areas), channel=scope)


def block(*words: int) -> bytes:
    return bytes_of([len(words), *HEAD, *words])


def meaning(protocol: str, *words: int) -> Meaning:
    blocks = blocks_of(protocol)
    return meaning_of(blocks.words.read(block(*words)), blocks, load_protocol(protocol))


def test_named_fields_make_the_words_and_words_give_the_fields() -> None:
    words = blocks_of("ccm").words
    data = words.make("ccm_read", {"command": "I", "target": "2", "type": 2, "address": 9, "count": 16, "here": 1}, {})
    assert words_of(data) == [6, 0, 8, 0, 0, 0, 6102, 2, 2, 9, 16, 1]
    request = words.read(data).request
    assert (request.frame, request.fields["command"], request.fields["count"]) == ("ccm_read", 6102, 16)


def test_what_stands_behind_a_block_is_not_looked_at() -> None:
    data = block(6002)
    assert blocks_of("ccm").words.read(data + b"\1\2\3").raw == data


@pytest.mark.parametrize(
    ("words", "why"),
    [
        ([0, *HEAD, 6002], "'words' is 0"),
        ([129, *HEAD, *[6002] * 129], "'words' is 129"),
        ([2, *HEAD, 6002], "more words than there are"),
        ([1, 0, 9, 9, 0, 0, 6002], "'status_type' is 9"),
        ([1], "more words than there are"),
    ],
)
def test_words_that_are_no_command_block_are_a_fault(words: list[int], why: str) -> None:
    with pytest.raises(CommandFaultError, match=why):
        blocks_of("ccm").words.read(bytes_of(words))


def test_numbers_that_are_no_words_are_refused() -> None:
    assert bytes_of([-1, 0x1234]) == b"\xff\xff\x34\x12"
    with pytest.raises(ValueError, match="65536 is no word"):
        bytes_of([65536])


def test_a_transfer_is_told_with_both_its_places() -> None:
    found = meaning("snp", 7203, 8, 200, 50, 8, 1)
    assert found.does == ["other side: ''", "writes %R200 from the own %R1 (50 × word)"]
    found = meaning("ccm", 6101, 10, 2, 9, 1, 30)
    assert found.does[1:] == ["calls read_memory type=2 address=9 bytes=2", "fills the own %R30"]
    found = meaning("ccm", 6111, 10, 1, 200, 50, 1)
    assert found.does[1:] == ["calls write_memory type=1 address=200 data=…", "sends the own %R1 (50 × word)"]
    assert (found.status, found.refused, found.names["type"]) == ("%R10", 0, "registers")


def test_a_service_is_told_with_its_arguments() -> None:
    assert meaning("snp", 7201, 2, 0x4150, 0x5353, 0x31, 0).does == [
        "other side: ''",
        "calls change_level level=2 password=PASS1",
    ]
    assert meaning("snp", 7211, 8, 1).does[-1] == "stores what it brings from the own %R1 on"


def test_a_place_that_is_not_there_is_told() -> None:
    assert "no area has the code 99" in meaning("snp", 7202, 99, 1, 10, 70, 1).does[1]


def test_a_refusal_is_told_with_its_name() -> None:
    found = meaning("snp", 7202, 8, 1, 10, 70, 1)
    assert (found.refused, found.because) == (0x030C, "no SNP session")
    found = meaning("ccm", 6101, 10)
    assert (found.request, found.refused) == ("wrong_length", 2)


def test_the_application_is_looked_for_beside_its_definition(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    vat = EXAMPLES / "language" / "vat.yaml"
    assert main(["commreq", str(vat), "--explain", "CLEAR", "status=400", "there=3"]) == 0
    assert "writes D3" in capsys.readouterr().out
