"""The command line: what each verb prints, its exit status, and that no traceback ever shows."""

from __future__ import annotations

import gc
import io
import json
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from shipped import EXAMPLES, example_runs

from framekit import __version__
from framekit.api.settings import names_of
from framekit.cli.common import near
from framekit.cli.completion_verb import SHELLS
from framekit.cli.definition_verbs import fields_given
from framekit.cli.main import main
from framekit.cli.verb_table import VERBS
from framekit.codec.codec import compile_protocol
from framekit.codec.plain import PlainValues
from framekit.definition.load.protocol import load_protocol
from tests import shipped

READ = "05 32 30 72 53 53 30 31 30 36 25 4D 57 31 30 30 04 41 34"


def call(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    try:
        status = main(words)
    except SystemExit as ended:
        status = int(ended.code or 0)
    output = capsys.readouterr()
    assert "Traceback" not in output.out + output.err
    return status, output.out, output.err


def test_encode_prints_upper_case_hex(capsys: pytest.CaptureFixture[str]) -> None:
    words = ("encode", "mldp", "read_individual", "station=0x20", "command=r", 'variables=[{"name": "%MW100"}]')
    assert call(capsys, *words) == (0, READ + "\n", "")


def test_encode_an_inner_frame_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    words = ("encode", "modbus-rtu", "request_adu", "station=17", 'pdu={"read_holding": {"address": 107, "count": 3}}')
    assert call(capsys, *words)[:2] == (0, "11 03 00 6B 00 03 76 87\n")


def test_encode_takes_values_of_records_one_by_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("p.yaml").write_text(
        "protocol: p\nlayouts:\n  L: [{field: a, type: u8}, {field: t, type: u16, unit: ms}]\n"
        "  M: [{include: L, as: inner}, {field: b, type: u8}]\n"
        "frames:\n  A: {body: [{include: M, as: d1}, {field: x, type: u8}]}\n",
        "utf-8",
    )
    parts = ("d1.inner.a=5", "d1.inner.t=2 s", "x=9", "d1.b=0x0A")
    assert call(capsys, "encode", "p.yaml", "A", *parts) == (0, "05 07 D0 0A 09\n", "")
    assert call(capsys, "encode", "p.yaml", "A", 'd1={"inner": {"a": 5, "t": "2 s"}, "b": 10}', "x=9")[0] == 0
    _, out, _ = call(capsys, "decode", "p.yaml", "05 07 D0 0A 09")
    assert "\nd1.inner.a " in out, "the names are those that decode shows"
    for texts, message in (
        (("d1=5", "d1.b=1"), "'d1.b' is a part of 'd1', which has a value too – give one of the two"),
        (("d1.b=1", "d1={}"), "'d1.b' is a part of 'd1', which has a value too – give one of the two"),
        (("d1.inner.a=1", "d1.inner.t=1 s", 'd1={"b": 3}'), "'d1.inner.a' is a part of 'd1'"),
        (('d1={"b": 3}', "d1.inner.a=1"), "'d1.inner.a' is a part of 'd1'"),
        (("x=1", "x=2"), "'x' is given twice – give it once"),
        (("d1.b=1", "d1.b=1"), "'d1.b' is given twice"),
        (('d1={"b": 3, "b": 4}',), "in the value of 'd1', 'b' is given twice – give it once"),
        ((f"d1={'[' * 30_000}",), "the value of 'd1' is nested too deeply"),
        (('{d1}={"b": 3, "b": 4}',), "in the value of '{d1}', 'b' is given twice"),
        (("d1..b=1",), "'d1..b': a part is empty – write FIELD, RECORD.FIELD or LIST[0].FIELD"),
        ((".x=1",), "a part is empty"), (("x.=1",), "a part is empty"),
        (("d1.c=5", "x=1"), "there is no 'd1.c'"),
    ):  # fmt: skip
        status, _, err = call(capsys, "encode", "p.yaml", "A", *texts)
        assert status == 2 and message in err


def test_encode_takes_items_of_lists_by_their_index(capsys: pytest.CaptureFixture[str]) -> None:
    words = ("encode", "mldp", "read_individual", "station=32", "command=r")
    both = 'variables=[{"name": "%MW100"}, {"name": "%PW2"}]'
    items = ("variables[1].name=%PW2", "variables[0].name=%MW100")
    assert call(capsys, *words, *items) == call(capsys, *words, both)
    assert call(capsys, *words, 'variables[0]={"name": "%MW100"}')[1] == READ + "\n"
    for texts, message in (
        (("variables[1].name=%PW2",), "'variables[0]' is missing – give each index from 0 without a gap"),
        ((*items, "variables[9].name=%PW2"), "'variables[2]' is missing"),
        ((items[0], "variables.name=%PW2"), "'variables' has a value with an index and one without"),
        ((items[0], both), "'variables[1].name' is a part of 'variables', which has a value too"),
        ((items[1], "variables[00].name=%PW2"), "'variables[00].name' is given twice"),
        (("variables[].name=1",), "'variables[]' is not a name"), (("variables[-1].name=1",), "'variables[-1]' is not"),
        (("variables=5",), "'variables': a mapping {name: value} is wanted here"),
        (("[0]=1",), "'[0]' is not a name"), (("variables[0]name=1",), "'variables[0]name' is not a name"),
    ):  # fmt: skip
        status, out, err = call(capsys, *words, *texts)
        assert (status, out) == (2, "") and message in err


@pytest.mark.parametrize("name", ["ccm", "ge-rtu", "mldp", "modbus-rtu", "modbus-tcp", "snp"])
def test_what_decode_shows_as_names_encode_takes(name: str) -> None:
    protocol = load_protocol(name)
    codec, scope, plain = compile_protocol(protocol), names_of(protocol, {}), PlainValues(protocol)
    vectors = [frame for frame in shipped.vectors_of(name).frames if frame.frame in protocol.frames]
    for vector in vectors:
        data = vector.wire.exact
        if data is None or vector.expect is not None or vector.params or vector.state:
            continue
        fields, spans, fault = codec.trace(str(vector.frame), data, scope)
        assert fault is None
        values = list(paths_of(plain.to_plain(str(vector.frame), fields)))
        shown = [path for path, *_ in spans]
        assert not {path for path, _ in values}.difference(shown)
        texts = [f"{path}={json.dumps(value) if isinstance(value, list) else value}" for path, value in values]
        given = plain.from_plain(str(vector.frame), fields_given(texts))
        assert codec.encode(str(vector.frame), given, scope) == data


def paths_of(values: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """Yield every leaf value with its name as `decode` shows it."""
    for name, value in values.items():
        items = {f"{name}[{index}]": item for index, item in enumerate(value)} if isinstance(value, list) else {}
        if isinstance(value, dict) and value:
            yield from paths_of(value, f"{before}{name}.")
        elif items and all(isinstance(item, dict) for item in items.values()):
            yield from paths_of(items, before)
        else:
            yield before + name, value


@pytest.mark.usefixtures("small_heap")
@pytest.mark.parametrize(
    "words",
    [
        ("serve", "modbus-tcp", "--port", "tcp://127.0.0.1:0", "--for", "1 ms"),
        ("run", str(EXAMPLES / "srtp.run.yaml"), "--for", "1 ms"),
    ],
)
def test_what_is_there_at_the_start_is_left_out_of_garbage_collections(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]
) -> None:
    seen: list[str] = []
    for name in ("freeze", "unfreeze"):
        monkeypatch.setattr(gc, name, partial(seen.append, name))
    assert call(capsys, *words)[0] == 0
    assert seen == ["freeze", "unfreeze"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("modbus-rtu", "request_adu", "station=1", "pdu.address=1", "pdu.count=2"), "one frame with its values"),
        (("mldp", "read_individual", "statoin=1"), "did you mean 'station'"),
        (("mldp", "read_individual", "station=999", "command=r", 'variables=[{"name": "%MW1"}]'), "station"),
        (("modbus-rtu", "request_adu", "station=1", 'pdu={"read_holding": {"adress": 1}}'), "did you mean 'address'"),
        (("modbus-rtu", "request_adu", "station=1", 'pdu={"read_holdin": {}}'), "did you mean 'read_holding'"),
        (("mldp", "read_individual", "command=r", 'variables=[{"name": "%MW1"}]'), "station"),
        (("mldp", "read_individul", "station=1"), "did you mean 'read_individual'"),
        (("mldp", "read_individual", "variables=[{]"), "is not JSON"),
        (("mldp", "read_individual", "station"), "is not NAME=VALUE"),
        (("no-such", "x"), "there is no definition 'no-such'"),
        (("/no/such", "x"), "there is no definition '/no/such'"),
    ],
)
def test_encode_refuses_by_name(capsys: pytest.CaptureFixture[str], words: tuple[str, ...], message: str) -> None:
    status, out, err = call(capsys, "encode", *words)
    assert (status, out) == (2, "")
    assert err.startswith("framekit encode: ") and message in err


@pytest.mark.parametrize(
    "words",
    [
        "check no-such", "check mldp no-such.yaml", "encode no-such x", "decode no-such 00", "frames no-such",
        "generate python no-such", "test no-such", "read no-such --port loop:// M0", "serve no-such --port pty:",
        "read mldp --port sim:no-such.device.yaml --station 1 M0", "monitor no-such --port pty:", "commreq no-such 1",
        "commreq ccm @no-such", "commreq ccm --commands no-such 1", "run no-such.run.yaml",
        "replay no-such --port pty:", "decode mldp --capture no-such", "serve mldp --port pty: --faults no-such",
    ],
)  # fmt: skip
def test_names_that_mean_nothing_are_errors_of_the_command_line(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: str
) -> None:
    monkeypatch.chdir(tmp_path)
    status, _, err = call(capsys, *words.split())
    assert status == 2
    assert "there is no " in err and "no-such" in err and ":1:1" not in err


def test_a_name_that_means_nothing_in_a_file_is_an_error_of_the_file(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "one.device.yaml").write_text("device: one\nprotocol: no-such\n", encoding="utf-8")
    for words in ("check one.device.yaml no-such.yaml", "serve one.device.yaml --port pty:"):
        status, _, err = call(capsys, *words.split())
        assert status == 1 and "one.device.yaml:2:11: there is no definition 'no-such'" in err


def test_decode_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = call(capsys, "decode", "mldp", "--json", READ)
    decoded = json.loads(out)
    assert status == 0
    assert decoded["frame"] == "read_individual"
    assert decoded["fields"]["station"] == 0x20
    assert decoded["fields"]["variables"][0]["name"] == "%MW100"


REPLY_WITH_A_WRONG_COUNT = "00 01 00 00 00 06 01 03 04 00 00 0A"
"""A good request for registers, too: from address 1024 on."""


def test_decode_says_that_bytes_are_nearly_a_frame_of_the_other_side(capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = call(capsys, "decode", "modbus-tcp", REPLY_WITH_A_WRONG_COUNT)
    assert (status, out.splitlines()[0]) == (0, "request_adu")
    fault = "pdu.read_holding_reply.values at byte 9: short, expected 4 bytes, found 3"
    note = f"as reply_adu from the server it is bad: {fault} – say who sent it: --from server"
    assert out.splitlines()[-1] == note
    found = json.loads(call(capsys, "decode", "modbus-tcp", "--json", REPLY_WITH_A_WRONG_COUNT)[1])
    assert found["other_side"] == [{"frame": "reply_adu", "from": "server", "fault": fault}]
    for words in (("--from", "client", REPLY_WITH_A_WRONG_COUNT), ("00 01 00 00 00 06 01 03 00 6B 00 03",)):
        assert "from the server" not in call(capsys, "decode", "modbus-tcp", *words)[1]


@pytest.mark.parametrize(
    ("data", "fault"),
    [
        ("00 01 00 00 00 07 01 03 02 00 07 00 00", "read_holding_reply.frame at byte 11: surplus"),
        ("00 01 00 00 00 07 01 06 00 01 00 02 00", "write_register_reply.frame at byte 12: surplus"),
        ("00 01 00 00 00 07 01 10 00 01 00 02 00", "write_registers_reply.frame at byte 12: surplus"),
        ("00 01 00 00 00 05 01 83 02 00 07", "exception.frame at byte 9: surplus"),
    ],
)
def test_a_reply_that_is_too_long_is_no_request(data: str, fault: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Each may also be a request that a server would refuse."""
    for side in ([], ["--from", "server"]):
        status, out, err = call(capsys, "decode", "modbus-tcp", *side, data)
        assert (status, "reply_adu" in out) == (1, True)
        assert err.startswith(f"framekit decode: reply_adu is bad: pdu.{fault}, expected its end, found ")
    status, out, err = call(capsys, "decode", "modbus-tcp", "--json", data)
    found = json.loads(out)
    (bad,) = [one["bad"] for one in (found, *found.get("others", [])) if "bad" in one]
    assert (status, err, fault in bad) == (1, "", True)


@pytest.mark.parametrize(
    ("data", "frame"),
    [("00 01 00 00 00 05 01 03 02 00 07", "reply_adu"), ("00 01 00 00 00 06 01 2B 0E 01 00 01", "request_adu")],
)
def test_a_good_frame_comes_before_a_request_that_is_refused(
    data: str, frame: str, capsys: pytest.CaptureFixture[str]
) -> None:
    status, out, err = call(capsys, "decode", "modbus-tcp", "--json", data)
    assert (status, json.loads(out)["frame"], "others" in json.loads(out), err) == (0, frame, False, "")


@pytest.mark.parametrize(
    ("count", "fault"),
    [
        ("07", "pdu.read_holding_reply.values at byte 3: short, expected 7 bytes, found 6"),
        ("05", "pdu.read_holding_reply.frame at byte 8: surplus, expected its end, found 1 bytes more"),
    ],
)
def test_decode_names_a_wrong_count_beside_a_wrong_check_code(
    count: str, fault: str, capsys: pytest.CaptureFixture[str]
) -> None:
    status, _, err = call(capsys, "decode", "modbus-rtu", f"11 03 {count} 02 2B 00 00 00 64 C8 BA")
    assert status == 1
    assert "nearest is 'reply_adu': check at byte 9" in err
    assert err.strip().endswith(f"; also {fault}")
    assert "; also" not in call(capsys, "decode", "modbus-rtu", "11 03 00 6B 00 03 76 88")[2]


def test_decode_tells_of_check_codes_that_only_warn(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    file = tmp_path / "lenient.yaml"
    body = "[{field: value, type: u8}, {check: sum8, verify: warn}]"
    file.write_text(f"protocol: lenient\nline: {{kind: stream}}\nframes: {{one: {{body: {body}}}}}\n", encoding="utf-8")
    status, out, _ = call(capsys, "decode", str(file), "07 08")
    assert status == 0 and out.splitlines()[:2] == ["one", "warning: check at byte 1: check, expected 07, found 08"]
    assert json.loads(call(capsys, "decode", str(file), "--json", "07 08")[1]) == {
        "frame": "one", "fields": {"value": 7}, "warnings": ["check at byte 1: check, expected 07, found 08"],
    }  # fmt: skip
    assert "warning" not in call(capsys, "decode", str(file), "07 07")[1]


def test_damage_is_told_where_a_frame_takes_everything(capsys: pytest.CaptureFixture[str]) -> None:
    """`stray` of SNP accepts any bytes after ESC, but neither side sends it.

    Damaged bytes must not be decoded as `stray`.
    """
    good = "1B 41 41 42 00 00 00 00 00 00 44 30 30 37 30 20 20 20 17 00 00 00 44 45"
    assert call(capsys, "decode", "snp", good)[0] == 0
    for options in ([], ["--from", "client"]):
        status, out, err = call(capsys, "decode", "snp", *options, good[:-2] + "00")
        assert (status, out) == (1, "") and "no frame fits; nearest is" in err and "check" in err
    assert call(capsys, "decode", "snp", "--frame", "stray", good[:-2] + "00")[0] == 0


def test_the_nearest_frame_is_one_of_which_all_but_the_check_fits(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """A wrong check code counts less than a wrong constant."""
    file = tmp_path / "near.yaml"
    frames = "one: {body: [{const: 1A}, {data: d, size: 2}, {check: sum8}]}"
    others = "two: {body: [{const: 2B}, {data: d, size: 2}, {check: sum8}]}"
    for text in (f"{frames}, {others}", f"{others}, {frames}"):
        file.write_text(f"protocol: near\nframes: {{{text}}}\n", encoding="utf-8")
        _, _, err = call(capsys, "decode", str(file), "2B 00 00 AB")
        assert (
            err == "framekit decode: no frame fits; nearest is 'two': check at byte 3: check, expected 2B, found AB\n"
        )
        _, _, err = call(capsys, "decode", str(file), "--frame", "one", "2B 00 00 AB")
        assert err.endswith("expected 2B, found AB; also const at byte 0: constant, expected 1A, found 2B\n")


def test_decode_as_a_table(capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = call(capsys, "decode", "third-party-plc", "06 52 44 32 34 03")
    assert status == 0
    assert out.splitlines()[0] == "IMM.RESPONSE"
    assert "offset" in out.splitlines()[1]


def test_decode_shows_what_follows_absent_fields(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    definition = tmp_path / "absent.yaml"
    definition.write_text(
        "protocol: absent\nframes:\n  A:\n    body:\n      - {bits: {k: 0-3, more: 7}, of: u8}\n"
        "      - {bits: {d: 0-3, again: 7}, of: u8, when: more}\n      - {field: e, type: u8, when: again}\n"
        "      - {field: v, type: u8}\n"
    )
    assert main(["decode", str(definition), "01 09"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()[2:]] == ["k", "more", "v"]


def test_decode_reads_standard_input(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO("06 5244 3234 03\n"))
    assert json.loads(call(capsys, "decode", "third-party-plc", "--json", "-")[1])["frame"] == "IMM.RESPONSE"


def test_decode_lists_several_frames_and_narrows_by_side(capsys: pytest.CaptureFixture[str]) -> None:
    write = "11 06 00 01 00 03 9A 9B"
    both = json.loads(call(capsys, "decode", "modbus-rtu", "--json", write)[1])
    assert {both["frame"], both["others"][0]["frame"]} == {"request_adu", "reply_adu"}
    one = json.loads(call(capsys, "decode", "modbus-rtu", "--from", "server", "--json", write)[1])
    assert one["frame"] == "reply_adu" and "others" not in one


@pytest.mark.parametrize(
    ("protocol", "data", "message"),
    [
        ("mldp", READ[:-5] + "30 30", "check"),
        ("mldp", "41 42", "no frame fits"),
        ("modbus-rtu", "", "there are no bytes"),
        ("mldp", "0G", "'0G' is not bytes – write pairs of hex digits, such as 01 0F"),
        ("mldp", "01 zz 02", "'zz' is not bytes"),
        ("mldp", "01:0", "'0' has a digit without its pair"),
        ("mldp", "01" * 30 + "-" + "02" * 30, "'…01010101-0202020…' is not bytes"),
        ("mldp", "01" * 30 + "2", "'…10101012' has a digit without its pair"),
    ],
)
def test_decode_says_why_bytes_are_no_frame(
    capsys: pytest.CaptureFixture[str], protocol: str, data: str, message: str
) -> None:
    status, out, err = call(capsys, "decode", protocol, data)
    assert (status, out) == (2 if " is not bytes" in message or " its pair" in message else 1, "")
    assert message in err


def test_frames_lists_protocols_and_fields(capsys: pytest.CaptureFixture[str]) -> None:
    _, protocols, _ = call(capsys, "frames")
    listed = [protocols.index(f" {name} ") for name in ("fins-tcp", "host-link", "mewtocol")]
    assert "\nModbus " in protocols and listed == sorted(listed)
    families = {protocol["name"]: protocol["family"] for protocol in json.loads(call(capsys, "frames", "--json")[1])}
    assert {"mldp", "modbus-rtu", "third-party-plc"} <= families.keys()
    assert families["commreq-ccm"] == families["commreq"] == "GE Fanuc", "what extends another is of its family"
    assert all(families.values()), "a shipped definition says at its head whose it is, by family:"
    assert all(protocol["about"] for protocol in json.loads(call(capsys, "frames", "--json")[1])), (
        "and what it is, by about:"
    )
    _, frames, _ = call(capsys, "frames", "third-party-plc")
    assert "WR.REQ" in frames and "payload" in frames
    listed = json.loads(call(capsys, "frames", "mldp", "--json")[1])
    assert "read_individual" in [frame["frame"] for frame in listed]


def test_c_is_written_into_a_directory_and_strict_minds_what_is_left_out(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    folder = tmp_path / "made"
    assert call(capsys, "generate", "c", "ccm", "-o", str(folder), "--strict")[0] == 0
    assert {path.name for path in folder.iterdir()} == {"ccm.h", "ccm.c"}
    path = tmp_path / "keyed.yaml"
    path.write_text(
        "protocol: keyed\nparams: {k: {type: bytes, size: 16, secret: yes}}\nframes:\n"
        "  f: {body: [{field: n, type: u8}, {check: hmac-md5, key: k, size: 4}]}\n"
    )
    assert call(capsys, "generate", "c", str(path), "-o", str(folder))[0] == 0
    status, output, _ = call(capsys, "generate", "c", str(path), "-o", str(folder), "--strict")
    assert status == 1 and "keyed.yaml:4:36: frame 'f' is left out: 'hmac-md5'" in output
    assert call(capsys, "generate", "c", "ccm")[2] == "framekit generate: C is written into a directory – add -o DIR\n"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")
@pytest.mark.parametrize(
    ("words", "begin"),
    [
        (["generate", "python", "slip"], "framekit generate: cannot write "),
        (["generate", "jsonschema", "slip"], "framekit generate: cannot write "),
        (["schema"], "framekit schema: "),
    ],
)
def test_a_file_without_room_is_named(words: list[str], begin: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*words, "-o", "/dev/full"]) == 1
    assert capsys.readouterr().err.startswith(f"{begin}/dev/full: ")


def test_no_diagram_without_sequences(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["generate", "diagram", "slip"]) == 1
    captured = capsys.readouterr()
    assert (captured.out, captured.err) == (
        "", "framekit generate: 'slip' has no sequences – there is nothing to draw\n"
    )  # fmt: skip


def test_generated_python_stands_alone(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "mldp_codec.py"
    assert call(capsys, "generate", "python", "mldp", "-o", str(path))[0] == 0
    script = (
        "import sys; sys.path.insert(0, '.'); import mldp_codec as codec; "
        "assert 'framekit' not in sys.modules; "
        "data = codec.encode_read_individual({'station': 32, 'command': 'r', 'variables': [{'name': '%MW100'}]}); "
        "assert codec.decode_read_individual(data)['station'] == 32; print(data.hex(' ').upper())"
    )
    done = subprocess.run(
        [sys.executable, "-I", "-W", "error", "-c", script], cwd=tmp_path, capture_output=True, text=True
    )
    assert (done.stdout.strip(), done.stderr) == (READ, "")


@pytest.mark.parametrize("protocol", ["mldp", "modbus-tcp", "ccm"])  # all of them: tests/link/test_vectors.py
def test_vectors_beside_a_definition(capsys: pytest.CaptureFixture[str], protocol: str) -> None:
    status, out, _ = call(capsys, "test", protocol)
    assert (status, out.splitlines()[-1].split(", ")[1]) == (0, "0 failed"), out


def test_vectors_that_fail_are_shown(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "p.yaml").write_text("protocol: p\nframes:\n  f: {body: [{field: a, type: u8}]}\n", encoding="utf-8")
    (tmp_path / "p.vectors.yaml").write_text(
        "vectors: p\nframes:\n  - {frame: f, values: {a: 1}, bytes: 02, source: made up}\n", encoding="utf-8"
    )
    status, out, _ = call(capsys, "test", str(tmp_path / "p.yaml"))
    assert status == 1
    assert "0 passed, 1 failed" in out


def test_check_counts_and_complains(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert call(capsys, "check", "mldp")[0] == 0
    path = tmp_path / "bad.yaml"
    path.write_text("protocol: bad\nframes:\n  f: {body: [{field: a, type: u9}]}\n", encoding="utf-8")
    status, _, err = call(capsys, "check", str(path))
    assert status == 1
    assert f"{path}:3:" in err
    listed = json.loads(call(capsys, "check", "--json", str(path))[1])
    assert listed[0]["problems"][0]["line"] == 3
    device = tmp_path / "bad.device.yaml"
    device.write_text("device: bad\nprotocol: bad\n", encoding="utf-8")
    message = f"{err}{device}: not checked further – correct the problems above first\n"
    assert call(capsys, "check", str(path), str(device)) == (1, "", message)


def test_run_on_virtual_time(capsys: pytest.CaptureFixture[str]) -> None:
    run = str(EXAMPLES / "third-party-plc.run.yaml")
    status, out, _ = call(capsys, "run", run, "--virtual", "--for", "10s", "--frames", "--json")
    lines = [json.loads(line) for line in out.splitlines()]
    blocks = {line["block"]: line for line in lines if line["event"] == "block"}
    assert status == 0
    assert sum(line.get("frame") == "WR.REQ" for line in lines) == 10
    assert blocks[1]["done"] >= 9 and blocks[2]["done"] >= 9
    for block in blocks.values():
        assert block["started"] == block["done"] + block["failed"] + block["running"]


@pytest.mark.parametrize("name", [path.name for path in example_runs() if path.parent == EXAMPLES])
def test_every_example_shows_its_frames_as_json(capsys: pytest.CaptureFixture[str], tmp_path: Path, name: str) -> None:
    """Inner frames are shown, too; a frame that could not be shown would break the exchange."""
    shutil.copytree(EXAMPLES, tmp_path, dirs_exist_ok=True)
    status, out, _ = call(capsys, "run", str(tmp_path / name), "--virtual", "--for", "3s", "--frames", "--json")
    lines = [json.loads(line) for line in out.splitlines()]
    assert status == 0
    assert not [line for line in lines if line["event"] == "trouble"]
    assert all(line["failed"] == 0 for line in lines if line["event"] == "block")
    frames = [line for line in lines if line["event"] == "frame"]
    assert {line["direction"] for line in frames} == {"in", "out"}
    if name.startswith("modbus"):
        assert frames[0]["fields"]["pdu"] == {"read_inputs": {"function": 2, "address": 0, "count": 16}}


def test_check_names_all_stations_of_a_device(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "two.device.yaml"
    path.write_text("device: pump-1\nprotocol: mldp\nstation: [1, 7]\n", encoding="utf-8")
    assert call(capsys, "check", str(path))[1] == f"{path}: device pump-1, stations 1, 7, speaking mldp\n"


@pytest.mark.parametrize(
    ("words", "status"),
    [
        (("--version",), 0), (("--help",), 0), ((), 2), (("nonsense",), 2), (("encode",), 2),
        (("run", "x.yaml", "--for", "soon"), 2), (("run", "no-such.yaml"), 2), (("run", "x.yaml", "--virtual"), 2),
    ],
)  # fmt: skip
def test_exit_status(capsys: pytest.CaptureFixture[str], words: tuple[str, ...], status: int) -> None:
    assert call(capsys, *words)[0] == status


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert call(capsys, "--version")[1] == f"framekit {__version__}\n"


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_has_help(capsys: pytest.CaptureFixture[str], verb: str) -> None:
    status, out, _ = call(capsys, verb, "--help")
    assert status == 0 and "usage: framekit" in out


@pytest.mark.parametrize("shell", SHELLS)
def test_completion_scripts(capsys: pytest.CaptureFixture[str], shell: str) -> None:
    pytest.importorskip("shtab")
    status, out, _ = call(capsys, "completion", shell)
    assert status == 0
    assert all(verb in out for verb in VERBS)
    assert "retries" in out or shell == "tcsh"  # the completion of tcsh has no options
    assert len(out) < 200_000


def test_what_fish_completes(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    pytest.importorskip("shtab")
    fish = shutil.which("fish")
    if fish is None:
        pytest.skip("fish is not installed")
    (tmp_path / "framekit.fish").write_text(call(capsys, "completion", "fish")[1], "utf-8")
    asks = ("framekit re", "framekit serve --read", "framekit generate ")
    code = "; ".join([f"source {tmp_path}/framekit.fish", *(f"complete -C '{words}'" for words in asks)])
    ran = subprocess.run([fish, "-N", "-c", code], capture_output=True, text=True, env={"HOME": str(tmp_path)})
    found = {line.partition("\t")[0] for line in ran.stdout.splitlines()}
    assert {"read", "record", "replay", "--read-only", "python", "diagram"} <= found


def test_run_shows_what_a_protocol_publishes(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    protocol = (
        "protocol: counting\nextends: scale\nstate: {asked: {scope: line, type: u16, initial: 5, publish: yes},"
        " weighed: {scope: device, type: u16, publish: yes}}\n"  # a client has no value of a device variable
    )
    (tmp_path / "scale.yaml").write_text((EXAMPLES / "scale.yaml").read_text("utf-8"), "utf-8")
    (tmp_path / "counting.yaml").write_text(protocol, "utf-8")
    path = tmp_path / "counting.run.yaml"
    path.write_text(
        "run: counting\nmemory: masterlogic\nchannels: {1: {port: 'sim:scale.device.yaml', protocol: counting}}\n"
        "blocks: {0: {send: ASK, channel: 1, values: {station: 1}, once: yes}}\n", "utf-8",
    )  # fmt: skip
    (tmp_path / "scale.device.yaml").write_text((EXAMPLES / "scale.device.yaml").read_text("utf-8"), "utf-8")
    status, out, _ = call(capsys, "run", str(path), "--virtual", "--for", "100ms")
    assert status == 0 and out.splitlines()[-2:] == ["channel  status  value", "1        asked   5"]
    _, out, _ = call(capsys, "run", str(path), "--virtual", "--for", "100ms", "--json")
    events = [json.loads(line) for line in out.splitlines()]
    assert {"event": "status", "channel": 1, "status": {"asked": 5}} in events


def test_a_file_of_another_kind_is_one_problem(capsys: pytest.CaptureFixture[str]) -> None:
    scale = near(str(EXAMPLES / "scale.yaml"))
    assert call(capsys, "run", scale, "--virtual", "--for", "1s") == (
        1, "", f"{scale}:1:1: this is a protocol, not a run file – name a file that begins with run:\n",
    )  # fmt: skip
    vectors = EXAMPLES / "scale.vectors.yaml"
    assert "this is a vectors file, not a protocol" in call(capsys, "test", str(vectors))[2]


WRONG_VECTORS = """
vectors: p
frames:
  - {frame: b, values: {x: 1}, bytes: 01}
  - {frame: a, values: {y: 1}, byts: 01}
conversations:
  - {name: c, role: one, state: {s: 1}, do: {read: D0}, script: [], result: {memory: {D1: 1}, state: {t: 1}}}
"""


def test_vectors_are_looked_at_in_the_same_way_by_check_and_test(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "p.yaml").write_text(
        "protocol: p\ngroups: {g: {from: both, head: [{const: 05}]}}\n"
        "frames: {a: {group: g, body: [{field: x, type: u8}]}}\n"
    )
    (tmp_path / "p.vectors.yaml").write_text(WRONG_VECTORS)
    status, out, tested = call(capsys, "test", str(tmp_path / "p.yaml"))
    assert status == 1 and out == "" and len(tested.splitlines()) == 7
    assert tested == call(capsys, "check", str(tmp_path / "p.vectors.yaml"))[2]
    (tmp_path / "p.vectors.yaml").write_text("vectors: modbus-rtu\nframes: []\n")
    status, _, errors = call(capsys, "test", str(tmp_path / "p.yaml"))
    assert status == 1 and "these are vectors of 'modbus-rtu', and they stand beside p.yaml" in errors


def test_vectors_that_are_missing_are_named_as_they_would_be_found(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "some.yaml").write_text("protocol: some\nframes: {A: {body: [{const: STX}]}}\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    for name in ("some", "some.yaml"):
        status, _, err = call(capsys, "test", name)
        assert (status, err) == (
            1,
            "framekit test: there are no vectors beside 'some.yaml' – write some.vectors.yaml\n",
        )


@pytest.mark.parametrize(
    "words",
    [
        ("call", "scpi", "query", "header=*IDN?", "--port", "sim:scpi", "arguments="),
        ("call", "--port", "sim:scpi", "scpi", "query", "header=*IDN?", "arguments="),
        ("call", "scpi", "--port", "sim:scpi", "query", "header=*IDN?", "--frames", "arguments="),
    ],
)
def test_options_stand_anywhere_between_names(capsys: pytest.CaptureFixture[str], words: tuple[str, ...]) -> None:
    status, out, _ = call(capsys, *words)
    assert (status, out) == (0, "text: framekit,SIMULATED,0,1.0\n")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (
            ("run", "--virtal", "x.run.yaml"),
            "framekit run: error: there is no option '--virtal' – did you mean '--virtual'?",
        ),
        (
            ("run", "x", "--forr=10s", "--zzzz"),
            "no option '--forr' – did you mean '--for'?; there is no option '--zzzz'\n",
        ),
        (("check", "mldp", "--lod"), "framekit check: error: there is no option '--lod' – did you mean '--load'?"),
        (("frames", "mldp", "read", "more"), "framekit frames: error: nothing takes 'read', 'more'"),
        (("rnu", "x.run.yaml"), "did you mean 'run'?"),
        (("generate", "pyton", "mldp"), "did you mean 'python'?"),
    ],
)
def test_words_nobody_knows_get_a_suggestion(
    capsys: pytest.CaptureFixture[str], words: tuple[str, ...], says: str
) -> None:
    status, out, err = call(capsys, *words)
    assert (status, out) == (2, "") and says in err


@pytest.mark.parametrize(
    "words",
    [
        ("check", "FOLDER"),
        ("run", "FOLDER"),
        ("test", "FOLDER"),
        ("frames", "FOLDER"),
        ("decode", "mldp", "--capture", "FOLDER"),
        ("replay", "FOLDER", "--port", "loop://"),
    ],
)
def test_a_folder_is_no_file(capsys: pytest.CaptureFixture[str], tmp_path: Path, words: tuple[str, ...]) -> None:
    given = [str(tmp_path) if word == "FOLDER" else word for word in words]
    status, out, err = call(capsys, *given)
    assert (status, out) == (2, "") and f"{tmp_path}: this is a folder, not a file – name a file in it" in err


def test_memory_that_is_no_whole_words_is_shown_at_the_end(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "one.device.yaml").write_text(
        'device: one\nprotocol: modbus-rtu\nstation: 1\nmemory: {set: {"00001": [1, 0, 1, 1], 40001: [0x1234]}}\n'
    )
    (tmp_path / "small.run.yaml").write_text(
        "run: small\n"
        "memory: {areas: {E: {unit: bit, size: 4}, B: {unit: byte, size: 3}},"
        ' addresses: [{form: "{area}{start:dec}"}]}\n'
        'channels: {1: {port: "sim:one.device.yaml", protocol: modbus-rtu, station: 1}}\n'
        "blocks:\n"
        '  0: {read: "00001", count: 4, into: E0, once: yes}\n'
        '  1: {read: "40001", into: B1, when: E3}\n'
        '  2: {read: "40001", into: B0, on_change: E2}\n'
    )
    status, out, err = call(capsys, "run", str(tmp_path / "small.run.yaml"), "--virtual", "--for", "1s")
    assert status == 0 and err.count("store in one place") == 1
    blocks = [line.split()[1:6] for line in out.splitlines() if line[:3] in ("0  ", "1  ", "2  ") and "READ" in line]
    assert "E0      000D" in out and [block[2:4] for block in blocks] == [["1", "1"]] * 3


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ([], "missing: VERB – framekit --help lists the verbs"),
        (["nonsense"], "there is no verb 'nonsense' – framekit --help lists the verbs"),
        (["serv"], "there is no verb 'serv' – did you mean 'serve'?"),
    ],
)
def test_what_is_no_verb_is_told_with_the_verbs(
    words: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code == 2 and capsys.readouterr().err.endswith(f"framekit: error: {says}\n")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["run"], "begin with run: NAME"),
        (["serve", "--port", "tcp://127.0.0.1:0"], "begin with device: NAME or protocol: NAME"),
        (["frames"], "begin with protocol: NAME"),
    ],
)
def test_an_empty_file_is_told_how_it_should_begin(
    words: list[str], says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    empty = tmp_path / "empty.yaml"
    empty.write_text("", "utf-8")
    assert main([*words, str(empty)]) == 1
    assert capsys.readouterr().err.endswith(f"empty.yaml:1:1: the file is empty – {says}\n")


def test_the_version_is_told_without_what_only_other_verbs_need() -> None:
    script = (
        "import sys; from contextlib import suppress\nfrom framekit.cli.main import main\n"
        "with suppress(SystemExit): main(['--version'])\n"
        "print([name for name in ('asyncio', 'logging', 'dataclasses', 'yaml', 'hashlib') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[1:] == ["[]"], done.stdout


def test_fields_of_a_record_that_several_cases_have(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "rec.yaml"
    path.write_text(
        "protocol: rec\nlayouts:\n  a: [{field: n, type: u8}, {repeat: v, times: n, of: u8}]\n"
        "  b: [{field: t, type: ascii, size: 2}]\nframes:\n  F:\n    body:\n      - {field: kind, type: u8}\n"
        "      - choose: kind\n        cases: {1: [{include: a, as: body}], 2: [{include: b, as: body}]}\n"
    )
    for fields, told in (
        (["kind=1", "body.n=2", "body.v=[1,2]"], "01 02 01 02"),
        (["kind=1", 'body={"n": 2, "v": [1, 2]}'], "01 02 01 02"),
        (["kind=2", "body.t=10"], "02 31 30"),
    ):
        assert main(["encode", str(path), "F", *fields]) == 0
        assert capsys.readouterr().out.strip() == told


def test_what_is_there_is_not_written_over(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.yaml").write_text("protocol: own\nframes: {F: {body: [{const: 01}]}}\n")
    assert main(["generate", "python", "own.yaml", "-o", "own.yaml"]) == 2
    assert "own.yaml ends like a definition, and none is written over" in capsys.readouterr().err
    (tmp_path / "line-1.pcap").touch()
    with pytest.raises(SystemExit):
        main(["monitor", "own.yaml", "--port", "sim:x", "--capture", "line.pcap"])
    assert "line-1.pcap is there already – name another file, or delete it first" in capsys.readouterr().err


def test_a_speed_beyond_all_lines_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "fast.yaml").write_text(
        "protocol: fast\nline: {speed: 9999999999, format: 7E1}\nframes: {F: {body: [{const: 01}, {check: xor8}]}}\n"
    )
    assert main(["check", str(tmp_path / "fast.yaml")]) == 1
    assert "2:7: a line speed is a number of bits a second, 1 to 1000000000 – write 9600" in capsys.readouterr().err
