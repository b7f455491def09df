"""`framekit generate c PROTOCOL -o DIR`: write a header and a source in C."""

from __future__ import annotations

import argparse
from pathlib import Path

from framekit.cli.common import VerbError, WordsError, load_codec, why_not
from framekit.cli.generate_verb import place
from framekit.definition.problems import plural, printable
from framekit.extras.generate_c.generate import MOST_BYTES, generate


def write_c(arguments: argparse.Namespace) -> int:
    """Write a header and a source into a directory; report the frames that are left out."""
    folder: Path | None = arguments.output
    if folder is None:
        raise WordsError("C is written into a directory – add -o DIR")
    made = generate(load_codec(arguments.protocol).protocol, arguments.max_bytes or MOST_BYTES)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{made.name}.h").write_text(made.header, encoding="ascii")
        (folder / f"{made.name}.c").write_text(made.source, encoding="ascii")
    except OSError as error:
        raise VerbError(f"cannot write {why_not(error, folder)}") from None
    total = len(made.frames) + len(made.left_out)
    print(f"{folder / made.name}.h, {folder / made.name}.c: {len(made.frames)} of {plural(total, 'frame')}")
    for frame, problem in made.left_out:
        print(printable(f"{place(problem)}: frame '{frame}' is left out: {problem.what}"))
    for frame, name, problem in made.to_give:
        print(printable(f"{place(problem)}: '{name}' of frame '{frame}' has no default in C: {problem.what}"))
    for frame, problem in made.not_built:
        print(printable(f"{place(problem)}: frame '{frame}' is read and not built: {problem.what}"))
    for frame, problem in made.not_measured:
        print(printable(f"{place(problem)}: frame '{frame}' is not looked for in streams: {problem.what}"))
    return 1 if arguments.strict and (made.left_out or made.not_built) else 0
