"""Files for tests of the editor, and sessions that examine them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from framekit.extras.web.access import Access
from framekit.extras.web.edit_board import EditBoard, EditSession
from framekit.extras.web.edit_files import EditedFolder
from framekit.extras.web.edit_worker import answer

TOKEN = "a-token-of-tests"

LAMP = """# lamps of the hall
protocol: lamp
frames:
  SWITCH:
    from: client
    doc: Sets the level of a lamp
    body:
      - {const: STX}
      - {field: station, type: u8}   # 1 to 16
      - {field: level, type: u16}
      - {check: crc16-modbus}
  STATE:
    from: server
    body:
      - {const: STX}
      - {field: station, type: u8}
      - {field: lit, type: u8}
"""


def written(folder: Path, text: str = LAMP, name: str = "lamp.yaml") -> Path:
    """Return a written file."""
    path = folder / name
    path.write_text(text, "utf-8")
    return path


def session_of(place: Path, token: str = TOKEN) -> EditSession:
    """Return the session of a browser, which has given the token if any."""
    session = EditBoard(EditedFolder(place)).session(Access(TOKEN), "test:1")
    session.visitor.give(token)
    return session


def answer_of(do: str, path: Path, text: str | None = None, **given: Any) -> dict[str, Any]:
    """Return the answer of a work process about a text, computed in this process."""
    return answer({"do": do, "path": str(path), "text": path.read_text("utf-8") if text is None else text, **given})
