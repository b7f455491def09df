"""`framekit generate wireshark PROTOCOL`: write a dissector in Lua."""

from __future__ import annotations

import argparse
import sys

from framekit.cli.common import load_codec, scope_of, told
from framekit.cli.generate_verb import write_text
from framekit.definition.problems import Problem, printable
from framekit.extras.wireshark.generate import generate_dissector


def write_dissector(arguments: argparse.Namespace) -> int:
    """Write a dissector; report the parts that it lacks."""
    protocol = load_codec(arguments.protocol).protocol
    made = generate_dissector(protocol, scope_of(protocol, arguments.param))
    write_text(arguments, made.source)
    for problem, frames in made.left_out:
        print(_left_out(problem, frames), file=sys.stderr)
    return 1 if arguments.strict and made.left_out else 0


def _left_out(problem: Problem, frames: tuple[str, ...]) -> str:
    """Return a message about a part that the dissector lacks, with the names of its frames."""
    some = f" ({', '.join(frames[:3])}{', …' if len(frames) > 3 else ''})" if frames else ""
    return printable(told(problem) + some)
