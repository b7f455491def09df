"""The page of an unknown line without a browser: by sessions, over real WebSockets, and from the command line."""

from __future__ import annotations

import asyncio
import json
import random
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("starlette")
pytest.importorskip("httpx2")

from extras.guess.hex_world import TOKEN, HexPage, framed, polled
from starlette.testclient import TestClient

from framekit.api.check import check_file
from framekit.api.vectors import run_vectors
from framekit.cli.main import main
from framekit.extras.guess.hex_session import MOST_LINES, HexBoard, HexSession
from framekit.extras.guess.hex_table import NOISE, HexTable, definition_table, guessed_table
from framekit.extras.guess.model import HeardBytes
from framekit.extras.guess.recordings import guess
from framekit.extras.web.access import Access
from framekit.extras.web.messages import LARGEST_MESSAGE
from framekit.extras.web.server import PageApp

HOME, LIVE = "http://127.0.0.1:8040", "ws://127.0.0.1:8040/live"


@pytest.fixture
def page(tmp_path: Path) -> HexPage:
    return HexPage(tmp_path)


def answered(session: HexSession, **told: object) -> dict[str, Any]:
    found = asyncio.run(session.answer(told))
    assert found is not None
    json.dumps(found, allow_nan=False)
    return found


def shown(table: HexTable) -> bytes:
    return b"".join(row.data for row in table.rows)


def lines(session: HexSession, first: int = 0, most: int = 100, kind: int | None = None, width: int = 16) -> list[Any]:
    return list(answered(session, lines=first, most=most, kind=kind, width=width)["list"])


# ---- rows --------------------------------------------------------------------------------------------------------


def test_every_byte_has_its_row(page: HexPage) -> None:
    table = page.board.table
    assert shown(table) == b"".join(chunk.data for chunk in polled())
    noise = [row for row in table.rows if row.kind == NOISE]
    assert [row.data for row in noise] == [b"\x13\x37\x00"] and noise[0].fault
    for number, row in enumerate(table.rows):
        spans = table.spans(number)
        assert row.kind == NOISE or [span.offset for span in spans] == [
            sum(span.size for span in spans[:at]) for at in range(len(spans))
        ]


def test_stuffed_frames_are_shown_plain_with_what_is_between_them() -> None:
    rng, data = random.Random(3), b""
    for at in range(60):
        inner = framed(bytes([7, at, rng.choice([0x7E, 0x7D, 1])]) + bytes(rng.randrange(256) for _ in range(at % 4)))
        stuffed = inner.replace(b"\x7d", b"\x7d\x5d").replace(b"\x7e", b"\x7d\x5e")
        data += b"\x7e" + stuffed + b"\x7e" + (b"\x11\x22" if at == 30 else b"")
    found = guess([HeardBytes(None, "", data)])
    assert found.framing is not None and found.framing.stuffing is not None
    table = guessed_table(found)
    assert sum(row.kind != NOISE for row in table.rows) == 60
    wrong = [(row.data, row.fault) for row in table.rows if row.kind == NOISE]
    assert wrong == [(b"\x7e\x11\x22\x7e", "its check is wrong")]
    assert all(row.data[1] == 7 for row in table.rows if row.kind != NOISE)


def test_lines_come_a_few_at_a_time(page: HexPage) -> None:
    session = page.session()
    assert len(lines(session, 0, 10_000)) == 81
    assert [line[0] for line in lines(session, 5, 3)] == [5, 6, 7]
    whole = "".join(line[7] for line in lines(session, most=200, width=8))
    assert bytes.fromhex(whole) == shown(page.board.table)
    kind_number = next(number for number, kind in enumerate(page.board.table.kinds) if kind.name == "told")
    assert {line[5] for line in lines(session, kind=kind_number)} == {kind_number}
    assert [line[7] for line in lines(session, kind=NOISE)] == ["133700"]
    assert lines(session, 10**9) == []


def test_a_hundred_thousand_frames_are_not_sent() -> None:
    few = guess(polled(40))
    found = replace(few, chunks=polled(40) * 1250, frames=few.frames * 1250)
    session = HexBoard("large", guessed_table(found), found.statements).session(Access(TOKEN), "test:1")
    hello = session.hello()
    assert hello["rows"] > 100_000 and len(json.dumps(hello)) < LARGEST_MESSAGE
    answer = answered(session, lines=90_000, most=10**9, kind=None, width=16)
    assert len(answer["list"]) == MOST_LINES and answer["of"] > 100_000 and len(json.dumps(answer)) < 100_000
    point = answered(session, point=answer["list"][0][0], first=2, size=1)
    assert point["frames"] <= 10_000


def test_a_definition_gives_the_fields(page: HexPage) -> None:
    table = definition_table(page.path, polled())
    assert shown(table) == b"".join(chunk.data for chunk in polled())
    spans = table.spans(1)
    assert [(span.offset, span.shade) for span in spans][:2] == [(0, "constant"), (1, "copy")]
    assert spans[-1].shade == "check"
    assert [row.data for row in table.rows if row.kind == NOISE] == [b"\x13\x37\x00"]
    session = HexBoard("with", table, []).session(Access(TOKEN), "test:1")
    assert not session.hello()["names"]
    answered(session, token=TOKEN)
    why = answered(session, name="x", kind="told", first=2, size=4, type="f32", order="big", id=1)["why"]
    assert why.startswith("the definition says what the bytes are")


def test_frames_with_others_inside_have_the_names_of_these() -> None:
    request, reply = bytes([3, 3, 0, 0, 0, 2]), bytes([3, 3, 4, 0, 215, 0, 1])
    table = definition_table(
        "modbus-rtu", [HeardBytes(0, "out", framed(request)), HeardBytes(10**9, "in", framed(reply))]
    )
    assert [(kind.name, kind.frame) for kind in table.kinds] == [
        ("read_holding", "request_adu"), ("read_holding_reply", "reply_adu"),
    ]  # fmt: skip
    assert [span.name.rpartition(".")[2] for span in table.spans(1)] == [
        "station",
        "function",
        "bytes",
        "values",
        "check",
    ]
    assert [span.shade for span in table.spans(1)][2:] == ["length", "named", "check"]


# ---- bytes and names ---------------------------------------------------------------------------------------------


def test_a_byte_tells_what_it_may_be(page: HexPage) -> None:
    session = page.session()
    answer = answered(session, point=1, first=2, size=4)
    assert answer["frames"] == 40 and answer["different"] == 40 and answer["bytes"] == "41a00000"
    assert ["f32", "big", "20", "20", "29.75", 40] in [row[1:] for row in answer["types"]]
    one = answered(session, point=1, first=2, size=1)
    assert {(size, type_, order) for size, type_, order, *_ in one["types"]} >= {
        (1, "u8", "big"), (2, "u16", "big"), (2, "i16", "little"), (4, "f32", "little"), (4, "f32", "CDAB"),
    }  # fmt: skip
    assert one["field"][3] == "constant" and one["covers"] == [one["field"][2]]
    course = answered(session, course=1, first=2, size=4, type="f32", order="big")
    assert course["numbers"][:3] == [20.0, 20.25, 20.5] and course["times"][1] == pytest.approx(0.52)


def test_names_need_the_token_and_reach_the_file(page: HexPage) -> None:
    session, other = page.session(), page.session()
    level = {"name": "level", "kind": "told", "first": 2, "size": 4, "type": "f32", "order": "big"}
    before = page.path.read_text("utf-8")
    list(other.news())
    assert answered(session, **level, id=1) == {"done": 1, "why": "only with the token"}
    assert page.path.read_text("utf-8") == before and list(other.news()) == []
    assert answered(session, token=TOKEN) == {"may": True}
    assert answered(session, **level, id=2) == {"done": 2}
    assert "{field: level, type: f32}" in page.path.read_text("utf-8")
    assert [problem for problem in check_file(str(page.path)).problems if not problem.warning] == []
    assert [case.problems for case in run_vectors(page.path)] == [()] * 6
    assert [message["problems"] for message in other.news()] == [[]]
    assert lines(other, 1, 1)[0][8][2][2:] == ["named", "level", 2]
    assert answered(other, point=1, first=2, size=4)["field"][5:] == ["40 of 40", "f32 big", False]
    assert "level" in answered(other, draft=True)["draft"]
    good = page.path.read_text("utf-8")
    why = answered(session, **{**level, "first": 6, "size": 1, "type": "u8"}, id=3)["why"]
    assert why == "'told' has a field 'level' already – give another name"
    assert page.path.read_text("utf-8") == good
    assert answered(session, forget="told", first=2, id=4) == {"done": 4}
    assert page.path.read_text("utf-8") == before


@pytest.mark.parametrize(
    "told",
    [[], {}, None, {"other": 1}, {"lines": 0}, {"lines": -1, "most": 1, "width": 16}, {"fields": 99},
     {"lines": 0, "most": 1, "width": 7}, {"lines": 0, "most": 1, "width": 16.0},
     {"lines": 0.0, "most": 1, "width": 16},
     {"lines": 0, "most": 1.0, "width": 16}, {"lines": 0, "most": 1, "width": [16]},
     {"lines": 0, "most": 1, "width": True},
     {"lines": 0, "most": 1, "width": 16, "kind": -1.0}, {"lines": 0, "most": 1, "width": 16, "kind": -2},
     {"lines": 0, "most": 1, "width": 16, "kind": False}, {"lines": 0, "most": 10**400, "width": 16}, {"fields": 0.0},
     {"point": 0, "first": 0, "size": 1.0}, {"forget": "told", "first": 2, "id": float("nan")},
     {"forget": "told", "first": 2, "id": [1]}, {"lines": 0, "most": 1, "width": 16, "kind": 99}, {"point": 0},
     {"point": 10**12, "first": 0, "size": 1}, {"point": 0, "first": 0, "size": 10**12},
     {"point": 0, "first": 99, "size": 1},
     {"course": 0, "first": 0, "size": 1, "type": "f32", "order": "big"}, {"name": 5}, {"name": "x" * 1000},
     {"name": "x", "kind": "told", "first": -1, "size": 1, "type": "u8", "order": "big"}, {"forget": "told"}],
)  # fmt: skip
def test_what_is_no_message_is_refused(page: HexPage, told: object) -> None:
    with pytest.raises(ValueError, match="this is no message"):
        asyncio.run(page.session().answer(told))


def test_a_float_is_refused_and_leaves_no_traceback(page: HexPage, caplog: pytest.LogCaptureFixture) -> None:
    app = PageApp(Access(TOKEN))
    app.show(page.board)
    with TestClient(app.app, base_url=HOME).websocket_connect(LIVE) as socket:
        assert [socket.receive_json() for _ in range(2)][1]["round"] == 1
        socket.send_text('{"lines": 0, "width": 16.0, "most": 5, "kind": null}')
        socket.send_text('{"forget": "told", "first": 2, "id": NaN}')
        socket.send_json({"lines": 0, "width": 16, "most": 5, "kind": None})
        answers = [socket.receive_json()]
        while "list" not in answers[-1]:
            answers.append(socket.receive_json())
    assert answers[:-1] == [{"trouble": "this is no message"}] * 2 and len(answers[-1]["list"]) == 5
    assert not [record for record in caplog.records if record.exc_info]


def test_a_browser_writes_no_lines_of_its_own_into_the_log(page: HexPage, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", "framekit.extras")
    session = page.session()
    answered(session, token=TOKEN)
    good = {"name": "level", "kind": "told", "first": 2, "size": 4, "type": "f32", "order": "big", "id": 1}
    for key in ("name", "kind", "type", "order"):
        answered(session, **{**good, key: "x\nINFO told\r\x1b[2K\u2028"})
    answered(session, forget="x\nINFO told", first=2, id=2)
    assert answered(session, **good) == {"done": 1}
    logged = [record.getMessage() for record in caplog.records]
    assert len(logged) == 6 and all(line.isprintable() for line in logged)
    assert sum("x\\nINFO told" in line for line in logged) == 4 and logged[-1].startswith("web: 'level' for byte 2")


def test_a_browser_names_over_a_socket(page: HexPage) -> None:
    app = PageApp(Access(TOKEN))
    app.show(page.board)
    client = TestClient(app.app, base_url=HOME)
    assert "hexlines" in client.get("/bytes.js").text and 'src="bytes.js"' in client.get("/").text
    with client.websocket_connect(LIVE, headers={"origin": HOME}) as socket:
        assert socket.receive_json()["hello"] == "meter.txt"
        assert socket.receive_json() == {"round": 1, "problems": [], "warnings": list(page.names.draft.warnings)}
        socket.send_json({"lines": 0, "most": 2, "kind": None, "width": 16})
        assert [line[0] for line in socket.receive_json()["list"]] == [0, 1]
        socket.send_json({"token": TOKEN})
        assert socket.receive_json() == {"may": True}
        socket.send_json(
            {"name": "level", "kind": "told", "first": 2, "size": 4, "type": "f32", "order": "big", "id": 7}
        )
        answers = [socket.receive_json() for _ in range(2)]
        assert {"done": 7} in answers and any(answer.get("round") == 2 for answer in answers)
    assert "level" in page.path.read_text("utf-8")


# ---- the command line --------------------------------------------------------------------------------------------


def test_what_the_command_line_says_wrongly(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "heard").write_text("01 02\n", "utf-8")
    heard = str(tmp_path / "heard")
    for words, told in (
        (["--for", "1s"], "--for ends the page – it has no effect without --web"),
        (["--web-token", "env:X"], "--web-token has no effect without --web"),
        (["--web", "here"], "'here' is no place to listen on"),
    ):
        assert main(["guess", heard, *words]) == 2
        assert told in capsys.readouterr().err


@pytest.mark.long
def test_the_page_of_the_command_ends_by_itself(tmp_path: Path) -> None:
    (tmp_path / "heard").write_text("".join(f"{chunk.data.hex()}\n" for chunk in polled(8)), "utf-8")
    words = [sys.executable, "-m", "framekit", "guess", "heard", "--web", "0", "--for", "300ms", "--json"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    web, found = map(json.loads, done.stdout.splitlines())
    assert (done.returncode, done.stderr, web["event"]) == (0, "", "web") and found["frames"] == 16
