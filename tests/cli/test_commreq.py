"""The verb for command blocks: words and names, files, refused blocks, and the exit status."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from framekit.cli.main import main

WRITE = ["6", "0", "8", "9", "0", "0", "0x17DF", "10", "1", "200", "50", "1"]


def words_shown(capsys: pytest.CaptureFixture[str]) -> str:
    return capsys.readouterr().out.splitlines()[0].removeprefix("words").strip()


def test_whole_blocks_and_those_without_their_head_are_the_same(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["commreq", "ccm", "--explain", *WRITE]) == 0
    whole = words_shown(capsys)
    assert main(["commreq", "ccm", "--explain", *WRITE[6:], "status_offset=9"]) == 0
    assert words_shown(capsys) == whole == "0006 0000 0008 0009 0000 0000 17DF 000A 0001 00C8 0032 0001"


def test_named_fields_and_words_from_a_file(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    file = tmp_path / "block.txt"
    file.write_text("# ten bits\n7202, 8 1\n10 70 1  # into I1\n", encoding="utf-8")
    assert main(["commreq", "snp", "--explain", f"@{file}"]) == 0
    from_file = words_shown(capsys)
    fields = ["type=R", "address=1", "count=10", "here_type=I", "here=1"]
    assert main(["commreq", "snp", "--explain", "snp_read", *fields]) == 0
    assert words_shown(capsys) == from_file


def test_json_has_words_fields_and_what_is_done(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["commreq", "ccm", "--explain", "--json", *WRITE]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["words"] == [int(word, 0) for word in WRITE]
    assert found["fields"]["target"] == 10 and found["status"] == "%R10" and found["refused"] == 0


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["hello"], "has no command 'hello'"),
        (["ccm_reed"], "did you mean 'ccm_read'"),
        (["ccm_read", "targt=1"], "there is no 'targt' in this frame – did you mean 'target'?"),
        (["ccm_read", "command=6101", "status_ofset=1"], "did you mean 'status_offset'"),
        (["ccm_read", "targt=1"], "The fields are command, target, type, address, count, here"),
        (
            ["ccm_read", "foo=1"],
            "there is no 'foo' in this frame – the fields are command, target, type, address, count, ",
        ),
        (
            ["ccm_read", "target=9", "type=1", "address=1", "count=8", "here=1"],
            "'command' is missing – give 6101 (R), ",
        ),
        (
            ["ccm_read", "target=9"],
            "'command', 'type', 'address', 'count' and 'here' are missing – command: give 6101 (R)",
        ),
        (["ccm_read", "target=9"], "6103 (Q); type: give 1 (registers), 2 (inputs), "),
        (["ccm_read", "command=6101", "type=X"], "1 (registers)"),
        (["6101", "wate=1"], "did you mean 'wait'"),
        (["6101", "count=1"], "'count' is no field beside words"),
        (["6101", "1.5"], "1.5"),
        (["6101", "70000"], "70000 is no word"),
        (["7", *WRITE[1:]], "the head says 7 words, and 6 words stand behind it"),
        (["5", *WRITE[1:]], "the head says 5 words, and 6 words stand behind it"),
        (WRITE[:-1], "the head says 6 words, and 5 words stand behind it"),
        (["0", *WRITE[1:]], "'words' is 0, expected 1..128 (6 words behind the head)"),
        (["0", "0", "8", "9", "0", "0"], "'words' is 0, expected 1..128 (0 words behind the head)"),
    ],
)
def test_what_is_no_command_is_told_and_exits_with_2(
    words: list[str], why: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["commreq", "ccm", "--explain", *words]) == 2
    assert why in capsys.readouterr().err


def test_protocols_without_commands_say_so(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["commreq", "mldp", "--explain", "1"]) == 2
    assert (
        "names no application of commands – add commands: NAME; on a command line --commands NAME"
        in capsys.readouterr().err
    )
    assert main(["commreq", "ccm", "--explain", "1", "--commands", "commreq-snp"]) == 2
    assert "command 'snp_attach' of 'commreq-snp' calls 'open', which 'ccm' has not" in capsys.readouterr().err
    assert main(["commreq", "ccm", "--explain", "1", "--commands", "ge-service"]) == 2
    assert "'ge-service' has no command blocks" in capsys.readouterr().err


@pytest.mark.parametrize("words", [["6199", "1", "2", "3", "4", "5"], ["7", "1", "2", "3", "4", "5"], ["0"]])
def test_words_of_no_known_command_need_no_head(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["commreq", "ccm", "--explain", *words]) == 0
    assert f"unknown_command: command {words[0]}" in capsys.readouterr().out


def test_fields_of_the_head_beside_a_whole_block_change_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["commreq", "ccm", "--explain", *WRITE, "longest=5"]) == 0
    assert words_shown(capsys) == "0006 0000 0008 0009 0000 0005 17DF 000A 0001 00C8 0032 0001"


def test_files_that_cannot_be_read_are_told(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["commreq", "ccm", "--explain", "@nowhere.txt"]) == 2
    why = "framekit commreq: @nowhere.txt: there is no such file – check its name and folder\n"
    assert capsys.readouterr().err == why
    (tmp_path / "bytes").write_bytes(b"\xff\xfe")
    assert main(["commreq", "ccm", "--explain", f"@{tmp_path / 'bytes'}"]) == 1
    assert "this is no text" in capsys.readouterr().err


# ---- carried out ---------------------------------------------------------------------------------------------

CCM = "device: five\nprotocol: ccm\nstation: 5\nmemory: {set: {'%R101': [11, 22, 33]}}\n"


@pytest.fixture
def port(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    (tmp_path / "five.device.yaml").write_text(CCM, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return ["commreq", "ccm", "--port", "sim:five.device.yaml", "--own", "1", "--param", "enq_count=1"]


def test_commands_share_the_memory_and_show_what_has_changed(
    port: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["6101", "5", "1", "101", "3", "200", "status_offset=9", "+", "6111", "5", "1", "1", "2", "201"]
    assert main([*port, *words, "+", "6101", "5", "1", "1", "2", "50"]) == 0
    shown = capsys.readouterr().out.splitlines()
    assert "%R200    11 22 33" in shown and "%R50     22 33" in shown
    assert "status   %R10 = 0x0001 success" in shown and "status   %R1 = 0x0001 success" in shown


def test_what_lies_beside_the_status_word_is_shown(port: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    words = ["ccm_read", "command=6101", "target=5", "type=1", "address=101", "count=3"]
    assert main([*port, *words, "here=11", "status_offset=9"]) == 0
    shown = capsys.readouterr().out.splitlines()
    assert "%R11     11 22 33" in shown and "status   %R10 = 0x0001 success" in shown
    assert not any(line.startswith("%R10") for line in shown)
    assert main([*port, "--json", *words, "here=9", "status_offset=11"]) == 0
    assert json.loads(capsys.readouterr().out)["memory"] == {"%R9": [11, 22, 33], "%R12": [1]}


def test_the_own_memory_can_be_set(port: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--json", "--set", "%R2=7,0x10", "6111", "5", "1", "1", "2", "2", "+", "6101", "5", "1", "1", "2", "50"]
    assert main([*port, *words]) == 0
    first, second = map(json.loads, capsys.readouterr().out.splitlines())
    assert first["memory"] == {"%R1": [1]} and second["memory"] == {"%R50": [7, 16]}
    assert second["status"] == 1 and second["outcome"] == ""
    assert main([*port, "--set", "%X2=7", "6002"]) == 2


@pytest.mark.parametrize(
    ("words", "status", "told"),
    [
        (["6101", "5", "200", "1", "1", "1"], 1, "0x0A02 invalid memory type"),
        (["6101", "5", "4", "1", "1", "1"], 3, "0x1602 ACK or NAK expected, not received (aborted)"),
        (["6", "2", "8", "9", "0", "0", "6101", "5", "1", "1", "1", "1"], 1, "%R10 = 0x0004 values of the COMMREQ"),
        (["6101", "9", "1", "1", "1", "1"], 3, "0x1702 no valid acknowledge to a master enquiry (no_enquiry_answer)"),
        (["1", "0", "8", "65535", "0", "0", "6002"], 0, "%R65536 = 0x0001"),
    ],
)
def test_the_exit_status(
    port: list[str], words: list[str], status: int, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*port, *words, "+", "6002"]) == status
    shown = capsys.readouterr().out
    assert told in shown
    assert shown.count("\nstatus ") == (2 if status == 0 else 1), "nothing is done after a failure"


def test_words_that_are_no_block_exit_with_2(port: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*port, "6", "0", "9", "9", "0", "0", "6101", "5", "1", "1", "4", "20"]) == 2
    assert "'status_type' is 9, expected" in capsys.readouterr().err


def test_the_own_number_is_asked_for(port: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*port[:4], "6002"]) == 2
    assert "say its number as own" in capsys.readouterr().err
