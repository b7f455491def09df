"""`framekit generate kaitai PROTOCOL -o DIR`: write a Kaitai Struct file."""

from __future__ import annotations

import argparse
from pathlib import Path

from framekit.cli.common import VerbError, WordsError, load_codec, told, why_not
from framekit.definition.problems import plural, printable
from framekit.extras.kaitai.generate import generate_kaitai


def write_ksy(arguments: argparse.Namespace) -> int:
    """Write a `.ksy` into a directory; report the parts that Kaitai cannot express."""
    folder: Path | None = arguments.output
    if folder is None:
        raise WordsError("a Kaitai file is written into a directory – add -o DIR")
    if arguments.param:
        raise WordsError("--param is for wireshark: a Kaitai file is given parameters when it reads")
    made = generate_kaitai(load_codec(arguments.protocol).protocol)
    path = folder / f"{made.name}.ksy"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        path.write_text(made.text, encoding="utf-8")
    except OSError as error:
        raise VerbError(f"cannot write {why_not(error, path)}") from None
    print(f"{path}: {len(made.frames)} of {plural(len(made.types), 'frame')}")
    for problem in made.left_out:
        print(printable(told(problem)))
    return 1 if arguments.strict and len(made.frames) < len(made.types) else 0
