"""The program of a work process of the editor: requests as JSON lines on standard input, answers on standard output."""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from framekit.definition.sources import edited_texts
from framekit.extras.web import edit_complete, edit_meaning, edit_new, edit_table, edit_trial

Work = Callable[..., dict[str, Any]]

WORK: Mapping[str, Work] = {
    "complete": edit_complete.complete,
    "look": edit_meaning.look,
    "decode": edit_meaning.decode,
    "form": edit_meaning.form,
    "build": edit_meaning.build,
    "change": edit_table.change,
    "remove": edit_table.remove,
    "known": edit_new.known,
    "new": edit_new.new,
    "offer": edit_trial.offer,
    "trial": edit_trial.trial,
}
"""The function for each request. Its first argument is the path of the file; others are of the request."""
ALARM = 60
"""Seconds after which a request ends the process, should its parent be gone."""


def answer(request: dict[str, Any]) -> dict[str, Any]:
    """Return the answer to a request: `text` is read in place of the content of the file at `path`."""
    do, path, text = request.pop("do"), Path(request.pop("path")), request.pop("text")
    with edited_texts({path: text}):
        return WORK[do](path, **request)


def main() -> None:
    """Answer requests until standard input ends."""
    requests = sys.stdin.buffer
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    sys.stdout = sys.stderr
    for line in requests:
        if sys.platform != "win32":
            signal.alarm(ALARM)
        answers.write(json.dumps(answer(json.loads(line))).encode() + b"\n")
        answers.flush()
        if sys.platform != "win32":
            signal.alarm(0)
