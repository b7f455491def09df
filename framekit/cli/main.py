"""`framekit VERB …`: find the verb, run it, and turn errors into a message and an exit status, never a traceback.

0: success. 1: the object of the command is wrong, the command failed, or its output could not be written. 2: the
command line is wrong. 3: no reply, or no port. 141: the reader of the output
has gone.
"""

from __future__ import annotations

import io
import os
import sys

from framekit import __version__
from framekit.definition import PATH_VARIABLE, ROOT_VARIABLE

TYPE_CHECKING = False  # as typing has it, without the time that importing typing takes
if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

OUTPUT_CLOSED = 141
"""Exit status if the reader of standard output has gone: that of a program that SIGPIPE has ended, in shells."""


def fit_output() -> None:
    """Make every text printable: as UTF-8 in pipes of Windows, with escapes in the user's encoding elsewhere.

    A stream that the caller has closed (`>&-`) is replaced by one that discards every text.
    """
    if sys.stdout is None:
        sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115 (for the rest of the process)
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if not isinstance(stream, io.TextIOWrapper) or stream.encoding.lower().replace("-", "") == "utf8":
            continue
        if sys.platform == "win32" and not stream.isatty() and "PYTHONIOENCODING" not in os.environ:
            stream.reconfigure(encoding="utf-8", errors="backslashreplace")
        else:
            stream.reconfigure(errors="backslashreplace")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the console script and return the exit status."""
    fit_output()
    folders, words = _folders(list(sys.argv[1:] if arguments is None else arguments))
    before = {name: os.environ.get(name) for name in (PATH_VARIABLE, ROOT_VARIABLE)}
    if folders["--path"]:
        searched = before[PATH_VARIABLE]
        os.environ[PATH_VARIABLE] = os.pathsep.join([*folders["--path"], *([searched] if searched else [])])
    if folders["--root"]:
        os.environ[ROOT_VARIABLE] = folders["--root"][-1]
    try:
        return _written(words)
    finally:
        for name, value in before.items():
            if value is not None:
                os.environ[name] = value
            else:
                os.environ.pop(name, None)


def _folders(words: list[str]) -> tuple[dict[str, list[str]], list[str]]:
    """Return the folders of `--path` and of `--root` before the verb, and the remaining words."""
    folders: dict[str, list[str]] = {"--path": [], "--root": []}
    while words:
        option, equals, folder = words[0].partition("=")
        if option not in folders or not (equals or len(words) > 1):
            break
        folders[option].append(folder if equals else words.pop(1))
        del words[0]
    return folders, words


def _written(words: list[str]) -> int:
    """Carry out the words and write their output to the end; return the exit status, never 0 if the output failed."""
    status = 0
    try:
        try:
            status = _main(words)
        except SystemExit as end:  # of the parser
            status = end.code if isinstance(end.code, int) else 1
            raise
        finally:
            for stream in (sys.stdout, sys.stderr):
                if not stream.closed:
                    stream.flush()
    except OSError as error:
        from framekit.cli.common import print_failure
        from framekit.cli.terminal import discard_unwritten

        discard_unwritten()
        if isinstance(error, BrokenPipeError):  # the reader of a pipe may leave early, as `head` does
            return status or OUTPUT_CLOSED
        print_failure(error)
        return status or 1
    return status


def _main(words: list[str]) -> int:
    """Carry out the words after the folders of `--path` and `--root`."""
    if words == ["--version"]:  # without the parser, whose imports take longer than the answer
        print(f"framekit {__version__}")
        return 0
    from framekit.cli.terminal import guarded_terminals

    with guarded_terminals():
        return _verb(words)


def _verb(words: list[str]) -> int:
    """Parse the words of a verb, run it, and print its errors."""
    from framekit.cli.common import VerbError, tell_error, tell_problems
    from framekit.cli.parser import build_parser, parse
    from framekit.cli.verb_table import VERBS

    if words and words[0] == "help":
        words = [*words[1:2], "--help"]
    parser = build_parser(words[0] if words and words[0] in VERBS else "")
    for one in (parser, *parser.verbs.values()):
        one.tells_json, one.words = "--json" in words, words
    parsed, unknown = parse(parser, words)
    if unknown:
        parser.verbs[parsed.verb].refuse(unknown)
    try:
        return _run(parsed)
    except KeyboardInterrupt:
        return 130
    except VerbError as failure:
        tell_error(parsed, failure.kind, str(failure))
        return failure.status
    except ValueError as error:
        from framekit.definition.problems import DefinitionError

        if not isinstance(error, DefinitionError):
            raise
        return tell_problems(parsed, error.problems)


def _run(parsed: argparse.Namespace) -> int:
    """Run a verb; definitions are taken from the user's cache folder if it holds them."""
    from framekit.cli.parser import function_of
    from framekit.cli.verb_table import VERBS

    run = function_of(parsed.verb, f"run_{parsed.verb}")
    if not VERBS[parsed.verb].uses_cache:
        return int(run(parsed))
    from framekit.codec.cache import definition_cache
    from framekit.definition.sources import cached_by

    with cached_by(definition_cache()):
        return int(run(parsed))


if __name__ == "__main__":
    sys.exit(main())
