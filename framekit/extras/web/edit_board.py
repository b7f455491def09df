"""The page of the editor: the files of a folder, each with its problems and its meaning as it is typed.

Without the token a browser sees the files as they are on disk. With the token it may have texts examined, and save
them.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from framekit import __version__
from framekit.extras.web.access import Access, Visitor
from framekit.extras.web.edit_files import LARGEST_TEXT, EditedFile, EditedFolder, EditRefusedError
from framekit.extras.web.edit_process import WorkError, Workers
from framekit.extras.web.messages import Actions, Message, Told, answered, plain_text, whole_number

log = logging.getLogger(__name__)

LONGEST_HEX = 40_000
MOST_VALUES = 500
"""Limits of a message: characters of bytes in hex, and values of a form."""
ONE_FILE = "a file cannot be made here – run framekit edit with a folder"
"""The refusal of a new file while a single file is edited."""


class EditBoard:
    """Content common to all browsers: the files, and the processes that examine texts."""

    name = "Editor"
    home = "edit.html"
    largest_message = 4 * LARGEST_TEXT

    def __init__(self, folder: EditedFolder, first: str = "") -> None:
        """Prepare the page; `first`: the file to open."""
        self.folder = folder
        self.first = first
        self.workers = Workers()

    def session(self, access: Access, who: str) -> EditSession:
        """Return a session for a browser."""
        return EditSession(self, access, who)

    async def go_on(self) -> None:
        """Keep the processes until the server ends."""
        try:
            await asyncio.Event().wait()
        finally:
            await self.workers.close()


class EditSession:
    """The session of a browser: the file that it has opened, and its text as the browser has it."""

    def __init__(self, board: EditBoard, access: Access, who: str) -> None:
        self.board = board
        self.visitor = Visitor(access, who)
        self._file: EditedFile | None = None
        self._text = ""
        self._stamp = (0, 0)
        """The time of change and the size of the file as the browser knows it."""
        self._actions: Actions = {
            "token": lambda given, told: self.visitor.give(given),
            "open": self._open,
            "text": self._look,
            "complete": self._complete,
            "hex": self._decode,
            "form": self._form,
            "build": self._build,
            "cell": self._cell,
            "offer": self._offer,
            "known": self._known,
            "new": self._new,
            "try": self._try,
            "save": self._save,
        }

    @property
    def wrong_tokens(self) -> int:
        """Return the number of wrong tokens it has sent."""
        return self.visitor.wrong_tokens

    def hello(self) -> Message:
        """Return the list of files."""
        folder = self.board.folder
        names = folder.names()
        first = self.board.first or (names[0] if names else "")
        return {
            "hello": f"edit {folder.root.name}", "version": __version__, "files": names, "first": first,
            "longest": LARGEST_TEXT, "makes": folder.takes_new,
        }  # fmt: skip

    def news(self) -> Iterator[Message]:
        """Yield an update if another program has changed the open file."""
        if self._file is not None and (stamp := self.board.folder.stamp(self._file.name)) != self._stamp:
            self._stamp = stamp
            yield {"outside": self._file.name}

    async def answer(self, told: Any) -> Message | None:
        """Execute a message and return the answer. Raises ValueError if it is no message of the page."""
        return await answered(self._actions, told)

    # ---- files --------------------------------------------------------------------------------------------

    async def _open(self, name: Any, told: Told) -> Message:
        """Return the content of a file, which becomes the text of this session."""
        try:
            file = await asyncio.to_thread(self.board.folder.read, plain_text(name))
        except EditRefusedError as error:
            return {"opened": None, "why": str(error)}
        self._file, self._text = file, file.text
        self._stamp = self.board.folder.stamp(file.name)
        return {"opened": file.name, "text": file.text, "digest": file.digest}

    async def _save(self, text: Any, told: Told) -> Message:
        """Save a text; `digest`: of the content that it replaces."""
        answer: Message = {"done": whole_number(told.get("id"))}
        name, digest = plain_text(told.get("file")), plain_text(told.get("digest"))
        why = self.visitor.refused()
        if why:
            return {**answer, "why": why}
        try:
            saved = await asyncio.to_thread(self.board.folder.save, name, _text(text), digest)
        except EditRefusedError as error:
            log.warning("edit: %r was not saved for %s: %s", name, self.visitor.who, error)
            return {**answer, "why": str(error)}
        log.info("edit: %r saved for %s", name, self.visitor.who)
        if self._file is not None and self._file.name == name:
            self._file = EditedFile(name, _text(text), saved)
            self._stamp = self.board.folder.stamp(name)
        return {**answer, "saved": name, "digest": saved}

    async def _known(self, given: Any, told: Told) -> Message:
        """Return the protocols that a new file may name."""
        return await self._worked({}, "known", self.board.folder.root / "new", {})

    async def _new(self, kind: Any, told: Told) -> Message:
        """Make a file from a template; `of`: the protocol or device file that it is for."""
        answer: Message = {"done": whole_number(told.get("id"))}
        given = {"kind": plain_text(kind), "name": plain_text(told.get("name")), "of": plain_text(told.get("of"))}
        folder = self.board.folder
        why = self.visitor.refused() or ("" if folder.takes_new else ONE_FILE)
        if why:
            return {**answer, "why": why}
        found = await self._worked({}, "new", folder.root / "new", given)
        if "why" in found:
            return {**answer, **found}
        try:
            await asyncio.to_thread(folder.make, found["name"], found["text"])
        except EditRefusedError as error:
            log.warning("edit: %r was not made for %s: %s", found["name"], self.visitor.who, error)
            return {**answer, "why": str(error)}
        log.info("edit: %r made for %s", found["name"], self.visitor.who)
        return {**answer, "made": found["name"], "files": folder.names()}

    # ---- meaning ------------------------------------------------------------------------------------------

    async def _look(self, text: Any, told: Told) -> Message:
        """Examine a text of the open file; without the token, only its content on disk."""
        number = whole_number(told.get("number"))
        if self._file is None or plain_text(told.get("file")) != self._file.name:
            raise ValueError("this is no message")
        if _text(text) != self._file.text and (why := self.visitor.refused()):
            return {"checked": number, "why": f"texts are examined {why}"}
        self._text = text
        return await self._asked({"checked": number, "file": self._file.name}, "look", {})

    async def _complete(self, text: Any, told: Told) -> Message:
        """Return the completions at an offset of a text."""
        offset = whole_number(told.get("offset"))
        if self._file is None or plain_text(told.get("file")) != self._file.name or offset > LARGEST_TEXT:
            raise ValueError("this is no message")
        head = {"words": [], "from": offset, "offset": offset}
        if not self.visitor.may:
            return head
        self._text = _text(text)
        return await self._asked(head, "complete", {"offset": offset}, quick=True)

    async def _decode(self, data: Any, told: Told) -> Message:
        """Decode bytes in hex."""
        if not isinstance(data, str) or len(data) > LONGEST_HEX:
            raise ValueError("this is no message")
        return await self._asked({"decoded": data}, "decode", {"protocol": _protocol(told), "data": data})

    async def _form(self, frame: Any, told: Told) -> Message:
        """Return the values of a frame, with samples."""
        given = {"protocol": _protocol(told), "frame": plain_text(frame), "inside": plain_text(told.get("inside"))}
        return await self._asked({"form": frame}, "form", given)

    async def _build(self, frame: Any, told: Told) -> Message:
        """Build a frame with the values of a form."""
        rows = told.get("rows")
        if not isinstance(rows, list) or len(rows) > MOST_VALUES or not all(map(_is_row, rows)):
            raise ValueError("this is no message")
        given = {"protocol": _protocol(told), "frame": plain_text(frame), "rows": rows}
        return await self._asked({"build": frame}, "build", given)

    async def _cell(self, text: Any, told: Told) -> Message:
        """Return the edits of a text for a change in a table, or for the removal of a row."""
        where, number = told.get("where"), whole_number(told.get("number"))
        if not isinstance(where, list) or not 0 < len(where) <= 3 or self._file is None:
            raise ValueError("this is no message")
        given: Message = {"where": [plain_text(step) for step in where], "row": plain_text(told.get("row"))}
        remove = told.get("remove") is True
        if not remove:
            given |= {name: plain_text(told.get(name)) for name in ("key", "old", "value")}
        head = {"cell": number}
        if not self.visitor.may:
            return {**head, "why": "only with the token"}
        self._text = _text(text)
        return await self._asked(head, "remove" if remove else "change", given, quick=True)

    async def _offer(self, given: Any, told: Told) -> Message:
        """Return the services that can be tried."""
        return await self._asked({"offer": True}, "offer", {})

    async def _try(self, service: Any, told: Told) -> Message:
        """Return the frames and the result of a request to a simulated device, or of a run."""
        given = {name: plain_text(told.get(name)) for name in ("address", "values", "station")}
        return await self._asked({"try": service}, "trial", {"service": plain_text(service), **given})

    async def _asked(self, head: Message, do: str, given: Message, quick: bool = False) -> Message:
        """Return the answer of a process about the text of this session after a head, or why there is no answer."""
        if self._file is None:
            raise ValueError("this is no message")
        try:
            path = self.board.folder.path_of(self._file.name)
        except EditRefusedError as error:
            return {**head, "why": str(error)}
        return await self._worked(head, do, path, given, quick)

    async def _worked(self, head: Message, do: str, path: Path, given: Message, quick: bool = False) -> Message:
        """Return the answer of a process about a file after a head, or why there is no answer."""
        try:
            found = await self.board.workers.ask({"do": do, "path": str(path), "text": self._text, **given}, quick)
        except WorkError as error:
            return {**head, "why": str(error)}
        return {**head, **found}


def _protocol(told: Told) -> str:
    """Return the name of a protocol in a message. Raises ValueError."""
    return plain_text(told.get("protocol"))


def _text(given: Any) -> str:
    """Return a text of a file from a message. Raises ValueError."""
    if not isinstance(given, str) or len(given) > LARGEST_TEXT:
        raise ValueError("this is no message")
    return given


def _is_row(row: Any) -> bool:
    """Return whether a value of a message is a row of a form: a path and a text."""
    match row:
        case [[*steps], str()]:
            return 0 < len(steps) <= 32 and all(isinstance(step, str) for step in steps)
    return False
