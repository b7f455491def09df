"""Terminal pictures for the docs, made of real runs: `python tools/pictures.py` writes `docs/images/terminal-*.svg`.

Each command runs in a terminal of its own, in a copy of `examples`, or in the folder of the project. The picture
shows the screen as it was before the table of a run, if any, was erased. The extra `terminal` has the library that
draws it.
"""

from __future__ import annotations

import fcntl
import os
import pty
import re
import shlex
import shutil
import struct
import subprocess
import sys
import tempfile
import termios
from pathlib import Path
from typing import NamedTuple

from rich.console import Console
from rich.text import Text

ROOT = Path(__file__).parents[1]
IMAGES = ROOT / "docs" / "images"
WIDTH, HEIGHT = 100, 40
CONTROL = re.compile("\r?\x1b\\[(\\d+)A\x1b\\[J|\x1b\\[\\?7[hl]")
"""Control sequences of framekit's drawings: erase the last lines; cut long lines off."""
FORMAT = """\
<svg class="rich-terminal" viewBox="0 0 {width} {height}" xmlns="http://www.w3.org/2000/svg">
<style>
.{unique_id}-matrix {{ font-family: ui-monospace, "DejaVu Sans Mono", Menlo, Consolas, monospace;
  font-size: {char_height}px; line-height: {line_height}px; font-variant-east-asian: full-width; }}
.{unique_id}-title {{ font-size: 18px; font-weight: bold; font-family: sans-serif; }}
{styles}
</style>
<defs><clipPath id="{unique_id}-clip-terminal">
<rect x="0" y="0" width="{terminal_width}" height="{terminal_height}" /></clipPath>
{lines}
</defs>
{chrome}
<g transform="translate({terminal_x}, {terminal_y})" clip-path="url(#{unique_id}-clip-terminal)">
{backgrounds}
<g class="{unique_id}-matrix">
{matrix}
</g>
</g>
</svg>
"""
"""The picture of rich without fonts of other hosts."""


class Picture(NamedTuple):
    """A picture: its name, the command, its folder, and whether the last drawing is shown in place of the output."""

    name: str
    command: str
    folder: str = "examples"
    last_drawing: bool = False

    @property
    def file(self) -> Path:
        return IMAGES / f"terminal-{self.name}.svg"


PICTURES = (
    Picture("demo", "framekit demo --fast", folder=""),
    Picture("run", "framekit run oven.run.yaml --for 12s", last_drawing=True),
    Picture("scan", "framekit scan sim:remote-io-1.device.yaml,remote-io-3.device.yaml modbus-rtu --timeout 50ms"),
)


def output_of(command: str, folder: Path) -> str:
    """Return the output of a command on a terminal."""
    main, side = pty.openpty()
    fcntl.ioctl(side, termios.TIOCSWINSZ, struct.pack("HHHH", HEIGHT, WIDTH, 0, 0))
    programs = str(Path(sys.executable).parent)
    environment = {**os.environ, "TERM": "xterm-256color", "COLUMNS": str(WIDTH), "LINES": str(HEIGHT)}
    environment["PATH"] = os.pathsep.join([programs, os.environ.get("PATH", "")])
    words = [f"{programs}/framekit", *shlex.split(command)[1:]]
    environment.pop("NO_COLOR", None)
    with subprocess.Popen(words, cwd=folder, stdin=side, stdout=side, stderr=side, env=environment):
        os.close(side)
        found = b""
        while data := _read(main):
            found += data
    os.close(main)
    return found.decode()


def _read(terminal: int) -> bytes:
    try:
        return os.read(terminal, 1 << 16)
    except OSError:  # the program has ended
        return b""


def screen_of(output: str, last_drawing: bool) -> str:
    """Return the text on the screen at the end, or before the last drawing was erased."""
    lines = [""]
    at, erased = 0, []
    for found in CONTROL.finditer(output):
        _write(lines, output[at : found.start()])
        at = found.end()
        if found[1] is not None:
            erased = list(lines)
            del lines[max(0, len(lines) - 1 - int(found[1])) :]
            lines.append("")
    if last_drawing and erased:
        return "\n".join(erased).rstrip()
    _write(lines, output[at:])
    return "\n".join(lines).rstrip()


def _write(lines: list[str], text: str) -> None:
    first, *others = re.sub("\r+\n", "\n", text).split("\n")
    lines[-1] += first
    lines += others


def svg_of(command: str, screen: str) -> str:
    """Return the picture of a screen, with the command above its output."""
    with Path(os.devnull).open("w") as nowhere:
        console = Console(record=True, width=WIDTH, file=nowhere, force_terminal=True, color_system="truecolor")
        console.print(Text(f"$ {command}", style="bold"))
        console.print(Text.from_ansi(screen))
        return console.export_svg(title="framekit", code_format=FORMAT, unique_id="terminal")


def main(names: list[str]) -> None:
    """Make the pictures with these names, or all."""
    with tempfile.TemporaryDirectory() as folder:
        examples = Path(folder) / "examples"
        shutil.copytree(ROOT / "examples", examples)
        for picture in PICTURES:
            if names and picture.name not in names:
                continue
            place = examples if picture.folder else ROOT
            screen = screen_of(output_of(picture.command, place), picture.last_drawing)
            picture.file.write_text(svg_of(picture.command, screen), "utf-8")
            print(picture.file.relative_to(ROOT))


if __name__ == "__main__":
    main(sys.argv[1:])
