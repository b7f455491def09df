"""Passwords of sinks: in the environment or in a file, never in a run file, and in no log."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from framekit.definition.keys import Form, KeyReading, ref
from framekit.definition.tree import Node


@dataclass(frozen=True, slots=True)
class Secret:
    """Place of a password: `env`, the variable `name` of the environment, or `file`, the file `name`."""

    kind: str
    name: str

    def read(self) -> str:
        """Return the password. Raises OSError, ValueError."""
        if self.kind == "env":
            found = os.environ.get(self.name)
            if found is None:
                raise ValueError(f"what is secret is to stand in the environment as {self.name}, and does not")
            return found
        return Path(self.name).read_text("utf-8").rstrip("\r\n")


def secret_named(text: str, what: str) -> Secret:
    """Parse `env:NAME` or `file:NAME` of a command line; `what`: the noun for messages.

    Raises ValueError, without the text: it may be the secret itself.
    """
    kind, _, name = text.strip().partition(":")
    if kind not in ("env", "file") or not name.strip():
        raise ValueError(f"a {what} does not stand on the command line – write env:NAME or file:NAME")
    return Secret(kind, name.strip())


def read_secret(reading: KeyReading, node: Node) -> Secret:
    """Read `env:NAME` or `file:NAME`. Raises Broken, without the text: it may be a password."""
    kind, _, name = reading.reader.text(node).strip().partition(":")
    if kind not in ("env", "file") or not name.strip():
        what = "a secret does not stand in a run file"
        raise reading.reader.broken(node.at, what, "write env:NAME for the environment, or file:NAME")
    return Secret(kind, name.strip() if kind == "env" else str(reading.loader.folder / name.strip()))


SECRET = Form(ref("text"), read_secret)
"""env:NAME, a variable of the environment, or file:NAME, a file in the folder of the run."""
