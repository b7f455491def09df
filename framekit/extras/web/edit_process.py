"""Processes that do the work of the editor: one request at a time, each within a time limit.

A text that an author types can keep a loader busy. So the loop of the server never loads it: a process does, which is
killed when its time is over, and started again with the next request.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import sys
import tempfile

from framekit.extras.web.messages import Message

log = logging.getLogger(__name__)

LONGEST_WORK = 20.0
"""Time limit of a request (s)."""
LONGEST_ANSWER = 16 << 20
"""Largest number of bytes of an answer."""
_PROGRAM = "import json, sys; sys.path[:] = json.loads(sys.argv[1]); from {module} import main; main()"
_SHOWN = 300


class WorkError(ValueError):
    """A request without an answer; the text gives the reason."""


class WorkProcess:
    """A process that answers requests; it is started with the first request."""

    def __init__(self, module: str, limit: float = LONGEST_WORK) -> None:
        """Prepare the process; `module` has a function `main` that serves (`edit_worker.serve`)."""
        self._program = _PROGRAM.format(module=module)
        self.limit = limit
        """Time limit of a request (s)."""
        self._lock = asyncio.Lock()
        self._process: asyncio.subprocess.Process | None = None
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 (as long as the process)

    async def ask(self, request: Message) -> Message:
        """Return the answer to a request, in turn. Raise WorkError."""
        async with self._lock:
            try:
                return await asyncio.wait_for(self._answer(request), self.limit)
            except TimeoutError:
                await self._kill()
                raise WorkError(f"this took longer than {self.limit:g} s – make the file smaller") from None
            except asyncio.CancelledError:
                await self._kill()
                raise

    async def _answer(self, request: Message) -> Message:
        process = await self._started()
        assert process.stdin is not None and process.stdout is not None
        try:
            process.stdin.write(json.dumps(request).encode() + b"\n")
            await process.stdin.drain()
            line = await process.stdout.readline()
        except (OSError, ValueError):  # ValueError: the answer is longer than the limit
            line = b""
        if not line:
            await self._kill()
            log.error("edit: %s has no answer: %s", request.get("do"), self._last_words())
            raise WorkError("the work ended without an answer – run framekit check with this file")
        answer: Message = json.loads(line)
        return answer

    async def _started(self) -> asyncio.subprocess.Process:
        if self._process is None:
            self._process = await asyncio.create_subprocess_exec(
                sys.executable, "-P", "-c", self._program, json.dumps(sys.path),
                stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE, stderr=self._errors,
                limit=LONGEST_ANSWER,
            )  # fmt: skip
        return self._process

    async def _kill(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            await process.wait()

    def _last_words(self) -> str:
        """Return the end of the error output."""
        self._errors.seek(0, 2)
        self._errors.seek(max(0, self._errors.tell() - _SHOWN))
        return self._errors.read().decode(errors="replace").strip() or "no error output"

    async def close(self) -> None:
        """End the process."""
        await self._kill()
        self._errors.close()


class Workers:
    """The processes of an editor: `meaning` loads definitions, `text` only parses, so that it answers at once."""

    def __init__(self) -> None:
        self.meaning = WorkProcess("framekit.extras.web.edit_worker")
        self.text = WorkProcess("framekit.extras.web.edit_worker")

    async def close(self) -> None:
        """End the processes."""
        await asyncio.gather(self.meaning.close(), self.text.close())

    async def ask(self, request: Message, quick: bool = False) -> Message:
        """Return the answer to a request. Raise WorkError."""
        return await (self.text if quick else self.meaning).ask(request)
