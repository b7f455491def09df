"""Protocol files of StreamDevice as definitions: what is taken over, run end to end, and what is told."""

from __future__ import annotations

from pathlib import Path
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

import framekit
from framekit.api.streamdevice import from_streamdevice
from framekit.cli.main import main
from framekit.definition.load.protocol import load_protocol_text
from framekit.definition.problems import DefinitionError

SUPPLY = r"""
# a supply
Terminator = CR LF;
ReplyTimeout = 500;
current   { out "CURR?"; in "CURR %f A"; }
set       { out "CURR %.3f"; }
identify  { out "*IDN?"; in "%s"; }
channel   { out "CH\$1?"; in "CH%d=%(level)d,%(unit)s"; }
measure   { out "INIT"; wait 300; out "MEAS?"; in "%f"; }
status    { out STX "S" ETX; in STX "%02X%04x" ETX; InTerminator = ""; OutTerminator = ""; }
checked   { out "A%03d%0<sum8>"; in 0x06; OutTerminator = CR; InTerminator = ""; }
again     { current; }
"""


def loaded(text: str, folder: Path) -> framekit.Protocol:
    (folder / "made.yaml").write_text(from_streamdevice(text, "x.proto", "made").text, "utf-8")
    return framekit.load(folder / "made.yaml")


@pytest.mark.parametrize(
    ("frame", "values", "wire"),
    [
        ("current_out", {}, b"CURR?\r\n"),
        ("current_in", {"value": 1.25}, b"CURR 1.25 A\r\n"),
        ("set_out", {"value": 1.5}, b"CURR 1.500\r\n"),
        ("identify_in", {"value": "Acme,7"}, b"Acme,7\r\n"),
        ("channel_out", {"arg_1": "2"}, b"CH2?\r\n"),
        ("channel_in", {"value": 2, "level": -40, "unit": "mV"}, b"CH2=-40,mV\r\n"),
        ("status_in", {"value": 0xA5, "value_2": 0x00FF}, b"\x02A500ff\x03"),
        ("checked_out", {"value": 7}, b"A007D8\r"),
        ("checked_in", {}, b"\x06"),
    ],
)
def test_frames_on_the_wire(tmp_path: Path, frame: str, values: dict[str, object], wire: bytes) -> None:
    made = loaded(SUPPLY, tmp_path)
    assert made.encode(frame, **values) == wire
    assert made.decode(wire, frame).fields == values


def test_a_client_speaks_with_a_device_made_of_the_same_file(tmp_path: Path) -> None:
    loaded(SUPPLY, tmp_path)
    (tmp_path / "supply.device.yaml").write_text("device: supply\nprotocol: made.yaml\n", "utf-8")
    seen: list[bytes] = []
    with framekit.connect(
        tmp_path / "made.yaml", f"sim:{tmp_path / 'supply.device.yaml'}", monitor=lambda one: seen.append(one.raw)
    ) as client:
        assert client.call("current").results == {"value": 0}
        assert client.call("channel", {"arg_1": "7"}).results == {"value": 0, "level": 0, "unit": ""}
        client.call("set", {"value": 2.5})
    assert b"CURR 2.500\r\n" in seen and b"CH7?\r\n" in seen


def test_what_is_left_out_is_told_with_its_place() -> None:
    text = 'Separator = ",";\na { out "A"; in "%b"; }\nb { out "B"; @mismatch { in "E%d"; } }\nc { in "%s"; }\n'
    text += 'd { event; out "D"; }\n'
    told = [str(one) for one in from_streamdevice(text, "x.proto", "made").left_out]
    assert told == [
        "x.proto:1:1: the setting Separator – see what the device needs",
        "x.proto:2:18: %b, which no segment is like: the protocol is left out – write its frames by hand",
        "x.proto:3:14: the handler @mismatch – a frame of its own and a row in services may say it",
        "x.proto:4:9: a text with nothing behind it that ends it: the protocol is left out – write its frames by hand",
        "x.proto:5:5: the command event of 'd' – nothing in a definition is like it",
    ]


def test_every_error_at_once() -> None:
    text = 'Nothing = 1;\na { out "open;\n  shout "x"; }\nb { out 999999999999x; }\nb { out "%q"; }\n'
    with pytest.raises(DefinitionError) as raised:
        from_streamdevice(text, "x.proto", "made")
    told = [str(one).partition(" – ")[0] for one in raised.value.problems]
    assert told == [
        "x.proto:1:1: there is no setting 'Nothing'",
        "x.proto:2:9: '\"' begins nothing",
        "x.proto:2:10: 'open' is no byte",
        "x.proto:3:3: there is no command or protocol 'shout' before",
        "x.proto:4:9: '999999999999x' is no byte",
        "x.proto:5:1: there are two protocols 'b'",
        "x.proto:5:10: a converter that is not known",
    ]


def test_protocols_that_take_each_other_have_a_bound() -> None:
    lines = ['p0 { out "0123456789"; in "%d"; }'] + [f"p{n} {{ p{n - 1}; p{n - 1}; }}" for n in range(1, 40)]
    with pytest.raises(DefinitionError, match="more than 10000 pieces"):
        from_streamdevice("Terminator = CR;\n" + "\n".join(lines), "x.proto", "made")


PIECES = [
    "%d", "%4d", "%04d", "%+d", "%u", "%f", "%.2f", "%8.3f", "%e", "%g", "%s", "%5s", "%c", "%x", "%02X", "%[A-Z]",
    "%{on|off}", "%r", "%2r", "%#4r", "%4R", "%0<xor>", "%<sum>", "%<crc16>", "%b", "%*d", "%(level)d", "A", " ", "=",
    ",", "\\x02", "\\r", "\\$1", "%%", "\\?", "'", "é", "#", ": {", "- x",
]  # fmt: skip
strings = st.lists(st.sampled_from(PIECES), max_size=5).map(lambda found: f'"{"".join(found)}"')
commands = st.one_of(
    st.tuples(st.sampled_from(["out", "in"]), strings).map(lambda found: f"{found[0]} {found[1]};"),
    st.sampled_from(
        ["wait 100;", "out STX 3;", "in ETX;", "p0;", "@init { out 'x'; }", 'InTerminator = ";";', "event;"]
    ),
)
protocols = st.lists(st.lists(commands, max_size=4), min_size=1, max_size=4)
endings = st.sampled_from(["", "Terminator = CR;\n", "Terminator = CR LF;\nOutTerminator = NUL;\n"])


@given(endings, protocols)
def test_every_definition_that_is_made_is_a_right_one(ending: str, found: list[list[str]]) -> None:
    text = ending + "\n".join(f"p{number} {{ {' '.join(one)} }}" for number, one in enumerate(found))
    try:
        made = from_streamdevice(text, "x.proto", "made")
    except DefinitionError as error:
        assert error.problems and all(one.at.file == "x.proto" for one in error.problems)
        return
    assert load_protocol_text(made.text, "made.yaml").name == "made"


def test_damaged_files_end_in_words() -> None:
    rng, ended = Random(1), 0
    for _ in range(300):
        data = bytearray(SUPPLY.encode())
        for _ in range(rng.randrange(1, 6)):
            data[rng.randrange(len(data))] = rng.randrange(256)
        try:
            from_streamdevice(data.decode("utf-8", "replace"), "x.proto", "made")
        except DefinitionError as error:
            ended += len(error.problems) > 0
    assert ended > 100


def test_the_verb_writes_it_and_tells_what_is_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "s.proto").write_text(SUPPLY + "late { event; }\n", "utf-8")
    assert main(["import", str(tmp_path / "s.proto"), "-o", str(tmp_path / "supply.yaml")]) == 0
    assert "the command event of 'late'" in capsys.readouterr().err
    assert main(["check", str(tmp_path / "supply.yaml")]) == 0
    assert main(["import", str(tmp_path / "s.proto"), "--strict", "-o", str(tmp_path / "supply.yaml")]) == 1
    (tmp_path / "s.yaml").write_text("mine", "utf-8")
    with pytest.raises(SystemExit) as ended:
        raise SystemExit(main(["import", str(tmp_path / "s.proto")]))
    assert ended.value.code == 2 and (tmp_path / "s.yaml").read_text("utf-8") == "mine"
