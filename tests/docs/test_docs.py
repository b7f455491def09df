"""Every snippet of README.md and docs/ is executed: consoles print the shown lines, YAML and Python work.

A block that begins with `# file: NAME` is written to a copy of the examples first, or shows the example that has this
name already, whole or in part. `...` in an output stands for any
lines, and inside of a line for any text.
"""

from __future__ import annotations

import re
import shlex
import shutil
import socket
import subprocess
import sys
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path

import pytest
from docs.pages import PAGES, ROOT, excerpt_of, shows, snippets
from points.mosquitto import BINARY, Broker
from spread import spread

from framekit.cli.main import main
from framekit.transport import schemes
from framekit.transport.schemes import SCHEMES


@pytest.mark.usefixtures("small_heap")
@pytest.mark.parametrize("page", spread(PAGES, 4, 1), ids=lambda page: str(page.relative_to(ROOT)))
def test_page(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "examples"
    shutil.copytree(ROOT / "examples", folder)
    monkeypatch.chdir(folder)
    monkeypatch.setattr(schemes, "SCHEMES", dict(SCHEMES))  # kinds of ports registered by a page end with it
    ports: dict[str, str] = {}
    with ExitStack() as programs:
        _carry_out_page(page, folder, ports, programs, capsys)


def _carry_out_page(
    page: Path, folder: Path, ports: dict[str, str], programs: ExitStack, capsys: pytest.CaptureFixture[str]
) -> None:
    for snippet in snippets(page):
        snippet = replace(snippet, text=with_free_ports(snippet.text, ports))
        where = f"{page.name}:{snippet.line}"
        if snippet.kind == "console":
            for command, expected in commands(snippet.text):
                if command == "mosquitto":  # the broker of a page, which runs until the end of the page
                    programs.enter_context(broker(folder, ports))
                else:
                    found = [with_free_ports(line, ports) for line in carry_out(command, capsys)]
                    assert_shown(found, expected, f"{where}: {command}")
        elif (stored := excerpt_of(snippet)) is not None:
            assert shows(snippet, stored.read_text("utf-8")), f"{where}: not the lines of {stored}"
        elif snippet.file is not None:
            (folder / snippet.file).write_text(snippet.text, "utf-8")
        elif snippet.kind == "python":
            exec(compile(snippet.text, where, "exec"), {"__name__": "snippet"})
        assert snippet.kind in ("c", "console", "yaml", "python", "text", "mermaid"), (
            f"{where}: what is {snippet.kind}?"
        )


PORTS = re.compile(r"\b(?:9102|1883|8086|8040)\b")
"""Ports that pages listen on."""


def with_free_ports(text: str, ports: dict[str, str]) -> str:
    """Return the text with free ports in place of its own; `ports` maps ports that were replaced before."""

    def free(match: re.Match[str]) -> str:
        if match[0] not in ports:
            with socket.create_server(("127.0.0.1", 0)) as listener:
                ports[match[0]] = str(listener.getsockname()[1])
        return ports[match[0]]

    return PORTS.sub(free, text)


def broker(folder: Path, ports: dict[str, str]) -> Broker:
    if BINARY is None:
        pytest.skip("mosquitto is not installed")
    return Broker(folder, port=int(ports["1883"]))


def commands(text: str) -> list[tuple[str, list[str]]]:
    """Return the commands of a console block, each with the lines that it prints."""
    found: list[tuple[str, list[str]]] = []
    for line in text.splitlines():
        if line.startswith("$ "):
            found.append((line[2:], []))
        else:
            assert found, "a console block begins with a command"
            found[-1][1].append(line)
    return found


def carry_out(command: str, capsys: pytest.CaptureFixture[str]) -> list[str]:
    words = shlex.split(command, comments=True)
    if words[0] == "framekit":
        with suppress(SystemExit):
            main(words[1:])
        output = capsys.readouterr()
        return (output.out + output.err).splitlines()
    if words[0] == "cat":
        return Path(words[1]).read_text("utf-8").splitlines()
    if words[0] == "tshark":
        if shutil.which("tshark") is None:
            pytest.skip("tshark is not installed")
        return subprocess.run(words, capture_output=True, text=True, check=True).stdout.splitlines()
    if words[0] == "gcc" or words[0].startswith("./"):
        if shutil.which("gcc") is None:
            pytest.skip("gcc is missing")
        return subprocess.run(words, capture_output=True, text=True, check=True).stdout.splitlines()
    assert words[0] == "python", f"'{words[0]}' is not carried out in tests"
    done = subprocess.run([sys.executable, *words[1:]], capture_output=True, text=True, check=True)
    return done.stdout.splitlines()


def assert_shown(found: list[str], expected: list[str], description: str) -> None:
    """Assert that the lines are as shown; `...` stands for any lines, and inside a line for any text."""
    while expected and not expected[-1]:
        expected = expected[:-1]
    pattern = "\n".join(
        ".*" if line.strip() == "..." else re.escape(line.rstrip()).replace(r"\.\.\.", "[^\n]*") for line in expected
    )
    text = "\n".join(line.rstrip() for line in found).rstrip()
    assert re.fullmatch(pattern, text, re.DOTALL), f"{description}\n--- found\n{text}\n--- shown\n" + "\n".join(
        expected
    )
