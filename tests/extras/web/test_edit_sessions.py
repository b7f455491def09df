"""The sessions of the editor: files of a folder, the token, and texts examined by a process within a time limit."""

from __future__ import annotations

import asyncio
import json
import os
import sys
from pathlib import Path
from typing import Any

import pytest
from extras.web.edit_world import LAMP, TOKEN, session_of, written

pytest.importorskip("starlette")
pytest.importorskip("httpx2")

from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from framekit.cli.main import main
from framekit.extras.web.access import Access
from framekit.extras.web.edit_board import EditBoard, EditSession
from framekit.extras.web.edit_files import LARGEST_TEXT, EditedFolder, EditRefusedError
from framekit.extras.web.edit_process import WorkError, WorkProcess
from framekit.extras.web.server import PageApp

HOME, LIVE = "http://127.0.0.1:8040", "ws://127.0.0.1:8040/live"


def answers_to(session: EditSession, *messages: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the answers to messages; the processes end with them."""

    async def every() -> list[dict[str, Any]]:
        try:
            return [await session.answer(message) or {} for message in messages]
        finally:
            await session.board.workers.close()

    return asyncio.run(every())


def test_a_folder_lists_its_yaml_files(tmp_path: Path) -> None:
    for name in ("b.yaml", "a.run.yml", "notes.txt", ".hidden.yaml"):
        written(tmp_path, name=name)
    for folder in ("deep", ".git"):
        (tmp_path / folder).mkdir()
        written(tmp_path / folder, name="c.yaml")
    assert EditedFolder(tmp_path).names() == ["a.run.yml", "b.yaml", "deep/c.yaml"]
    assert EditedFolder(tmp_path / "b.yaml").names() == ["b.yaml"]


@pytest.mark.parametrize(
    "name",
    ["../outside.yaml", "/etc/passwd", "sub/../../outside.yaml", "notes.txt", ".hidden.yaml", "", "none.yaml",
     "link.yaml", "folder/outside.yaml", "a\\b.yaml", "a\0.yaml", "lamp.yaml/", "deep.yaml"],
)  # fmt: skip
def test_other_files_are_neither_opened_nor_saved(tmp_path: Path, name: str) -> None:
    inside = tmp_path / "inside"
    inside.mkdir()
    outside = written(tmp_path, name="outside.yaml")
    for file in ("lamp.yaml", "notes.txt", ".hidden.yaml"):
        written(inside, name=file)
    (inside / "deep.yaml").mkdir()
    (inside / "link.yaml").symlink_to(outside)
    (inside / "folder").symlink_to(tmp_path)
    folder = EditedFolder(inside)
    assert folder.names() == ["lamp.yaml"]
    with pytest.raises(EditRefusedError, match="no YAML file of this folder"):
        folder.read(name)
    with pytest.raises(EditRefusedError, match="no YAML file of this folder"):
        folder.save(name, "x", "")
    assert outside.read_text("utf-8") == LAMP


def test_a_single_file_is_the_only_one(tmp_path: Path) -> None:
    written(tmp_path, name="other.yaml")
    folder = EditedFolder(written(tmp_path))
    with pytest.raises(EditRefusedError):
        folder.read("other.yaml")
    for place in (tmp_path / "none.yaml", written(tmp_path, name="x.txt")):
        with pytest.raises(EditRefusedError):
            EditedFolder(place)


def test_a_saved_file_keeps_line_ends_mark_and_rights(tmp_path: Path) -> None:
    path = tmp_path / "lamp.yaml"
    path.write_bytes("\ufeffprotocol: a\r\n# ä\r\n".encode())
    path.chmod(0o640)
    folder = EditedFolder(tmp_path)
    opened = folder.read("lamp.yaml")
    assert opened.text == "protocol: a\n# ä\n"
    digest = folder.save("lamp.yaml", "protocol: b\n# ä\n", opened.digest)
    assert path.read_bytes() == "\ufeffprotocol: b\r\n# ä\r\n".encode()
    assert (path.stat().st_mode & 0o777, folder.read("lamp.yaml").digest) == (0o640, digest)
    assert os.listdir(tmp_path) == ["lamp.yaml"]


def test_a_file_that_changed_meanwhile_is_not_saved(tmp_path: Path) -> None:
    path = written(tmp_path)
    folder = EditedFolder(tmp_path)
    opened = folder.read("lamp.yaml")
    path.write_text("protocol: other\n", "utf-8")
    with pytest.raises(EditRefusedError, match="has changed on disk"):
        folder.save("lamp.yaml", LAMP, opened.digest)
    assert path.read_text("utf-8") == "protocol: other\n"


def test_a_change_by_another_program_is_reported_once(tmp_path: Path) -> None:
    path, session = written(tmp_path), session_of(tmp_path)
    assert list(session.news()) == []
    (opened,) = answers_to(session, {"open": "lamp.yaml"})
    assert list(session.news()) == []
    (saved,) = answers_to(session, {"save": LAMP + "#", "file": "lamp.yaml", "digest": opened["digest"], "id": 1})
    assert "why" not in saved and list(session.news()) == []
    path.write_text(LAMP + "# other", "utf-8")
    assert list(session.news()) == [{"outside": "lamp.yaml"}]
    assert list(session.news()) == []
    path.unlink()
    assert list(session.news()) == [{"outside": "lamp.yaml"}]


@pytest.mark.parametrize(
    ("content", "why"), [(b"a: \xff", "not UTF-8"), (b"#" * (LARGEST_TEXT + 1), "another program")]
)  # fmt: skip
def test_what_cannot_be_edited_is_not_opened(tmp_path: Path, content: bytes, why: str) -> None:
    (tmp_path / "a.yaml").write_bytes(content)
    (answer,) = answers_to(session_of(tmp_path), {"open": "a.yaml"})
    assert answer["opened"] is None and why in answer["why"]


def test_with_the_token_a_text_is_examined_and_saved(tmp_path: Path) -> None:
    path, session = written(tmp_path), session_of(tmp_path)
    changed = LAMP.replace("u16", "u88")
    opened, checked, read, again = answers_to(
        session,
        {"open": "lamp.yaml"},
        {"text": changed, "file": "lamp.yaml", "number": 7},
        {"hex": "02", "protocol": "lamp"},
        {"text": LAMP, "file": "lamp.yaml", "number": 8},
    )
    assert opened["text"] == LAMP
    assert (checked["checked"], checked["problems"][0][0]) == (7, 10)
    assert read == {"decoded": "02", "why": "Correct the definition first"}
    assert [protocol["name"] for protocol in again["protocols"]] == ["lamp"]
    saved, stale = answers_to(
        session,
        {"save": changed, "file": "lamp.yaml", "digest": opened["digest"], "id": 1},
        {"save": LAMP, "file": "lamp.yaml", "digest": opened["digest"], "id": 2},
    )
    assert saved["saved"] == "lamp.yaml" and "why" not in saved
    assert "has changed on disk" in stale["why"]
    assert path.read_text("utf-8") == changed


def test_without_the_token_only_the_file_itself_is_examined(tmp_path: Path) -> None:
    path, session = written(tmp_path), session_of(tmp_path, token="another")
    opened, as_it_is, changed, saved = answers_to(
        session,
        {"open": "lamp.yaml"},
        {"text": LAMP, "file": "lamp.yaml", "number": 1},
        {"text": LAMP + "#", "file": "lamp.yaml", "number": 2},
        {"save": LAMP + "#", "file": "lamp.yaml", "digest": "", "id": 3},
    )
    assert opened["text"] == LAMP and as_it_is["problems"] == []
    assert changed == {"checked": 2, "why": "texts are examined only with the token"}
    assert saved == {"done": 3, "why": "only with the token"}
    assert path.read_text("utf-8") == LAMP


def test_words_and_cells_are_for_those_with_the_token(tmp_path: Path) -> None:
    text = "run: a\nblocks: {0: {read: M1}}\n"
    written(tmp_path, text, "a.run.yaml")
    words = {"complete": "run: a\nblo", "offset": 10, "file": "a.run.yaml"}
    cell = {"cell": text, "number": 1, "where": ["blocks"], "row": "0", "key": "read", "old": "read", "value": "M2"}
    row = {"cell": text, "number": 2, "where": ["blocks"], "row": "7", "remove": True}
    _, offered, changed, removed = answers_to(session_of(tmp_path), {"open": "a.run.yaml"}, words, cell, row)
    assert (offered["from"], offered["words"][0][0]) == (7, "blocks")
    ((begin, end, inserted),) = changed["edits"]
    assert (text[begin:end], inserted) == ("M1", "M2")
    assert removed == {"cell": 2, "why": "the table has no row '7'"}
    _, offered, changed = answers_to(session_of(tmp_path, token="another"), {"open": "a.run.yaml"}, words, cell)
    assert offered["words"] == [] and changed == {"cell": 1, "why": "only with the token"}


@pytest.mark.parametrize(
    "message",
    [
        {"cell": "", "number": 1, "where": "blocks", "row": "0"}, {"cell": "", "number": 1, "where": [], "row": "0"},
        {"complete": LAMP, "offset": -1, "file": "lamp.yaml"}, {"complete": LAMP, "offset": 1, "file": "a.yaml"},
        {"open": 5}, {"open": "x" * 301}, {"text": 5, "file": "lamp.yaml", "number": 1}, {"hex": "00" * 50_000},
        {"text": LAMP, "file": "other.yaml", "number": 1}, {"text": "#" * (LARGEST_TEXT + 1), "number": 1},
        {"build": "SWITCH", "protocol": "lamp", "rows": [[["a"], 5]]}, {"build": "SWITCH", "rows": [[[], "1"]]},
        {"save": LAMP, "file": "lamp.yaml", "digest": None, "id": 1}, {"form": ["x"]}, {"none": 1}, [], {"hex": None},
    ],
)  # fmt: skip
def test_other_messages_are_refused(tmp_path: Path, message: Any) -> None:
    written(tmp_path)
    session = session_of(tmp_path)
    answers_to(session, {"open": "lamp.yaml"})
    with pytest.raises(ValueError, match="this is no message"):
        answers_to(session, message)


def test_nothing_is_examined_before_a_file_is_open(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="this is no message"):
        answers_to(session_of(tmp_path), {"hex": "02", "protocol": "lamp"})


def test_another_page_or_name_is_not_let_in(tmp_path: Path) -> None:
    written(tmp_path)
    app = PageApp(Access(TOKEN))
    app.show(EditBoard(EditedFolder(tmp_path)))
    client = TestClient(app.app, base_url=HOME)
    assert client.get("/", headers={"origin": "http://evil.example"}).status_code == 403
    for headers in ({"origin": "http://evil.example"}, {"host": "evil.example"}):
        with pytest.raises(WebSocketDisconnect), client.websocket_connect(LIVE, headers=headers):
            pass
    with client.websocket_connect(LIVE, headers={"origin": HOME}) as socket:
        hello = socket.receive_json()
        assert (hello["files"], hello["first"]) == (["lamp.yaml"], "lamp.yaml")
        socket.send_json({"save": "x", "file": "lamp.yaml", "digest": "", "id": 1})
        assert socket.receive_json() == {"done": 1, "why": "only with the token"}
        socket.send_json({"token": TOKEN})
        assert socket.receive_json() == {"may": True}
        socket.send_json({"save": "x", "file": "../lamp.yaml", "digest": "", "id": 2})
        assert "no YAML file of this folder" in socket.receive_json()["why"]


def test_without_the_extra_the_verb_says_how_to_install_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delitem(sys.modules, "framekit.extras.web.server", raising=False)
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    assert main(["edit", str(written(tmp_path))]) == 1
    assert "pip install '.[web]'" in capsys.readouterr().err


def test_a_process_that_takes_too_long_is_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "slow_worker.py").write_text(
        "import json, sys, time\n"
        "def main():\n"
        "    for line in sys.stdin:\n"
        "        do = json.loads(line)['do']\n"
        "        if do == 'hang': time.sleep(1000)\n"
        "        if do == 'fail': sys.exit('a reason')\n"
        "        print(json.dumps({'done': do}), flush=True)\n",
        "utf-8",
    )
    monkeypatch.syspath_prepend(str(tmp_path))

    async def asks() -> None:
        process = WorkProcess("slow_worker", limit=5)
        try:
            assert await process.ask({"do": "one"}) == {"done": "one"}
            process.limit = 0.05
            with pytest.raises(WorkError, match=r"longer than 0\.05 s"):
                await process.ask({"do": "hang"})
            process.limit = 30
            assert await process.ask({"do": "two"}) == {"done": "two"}
            with pytest.raises(WorkError, match="ended without an answer"):
                await process.ask({"do": "fail"})
            assert json.dumps(await process.ask({"do": "three"})) == '{"done": "three"}'
        finally:
            await process.close()

    asyncio.run(asks())
