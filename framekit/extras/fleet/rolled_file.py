"""The check of a run file that a broker delivers, before a gateway applies it.

The file comes from another machine. Its first reading takes place in a process of its own with a time limit, so that a
hostile file neither stops the run nor fills its memory. The gateway then loads the checked file itself. To take the
model from the other process, it would have to unpickle it, which can execute code and takes longer than a second
reading (0.33 s and 0.14 s for `examples/ge-channels/chan4.run.yaml`).

A refusal is published to every subscriber of the broker. Therefore it quotes the rolled file alone, never the content
of another file that the rolled file names.
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import replace
from ipaddress import ip_address
from pathlib import Path

from framekit.api.replaced_file import ReplacedFile
from framekit.definition.fingerprint import fingerprint
from framekit.definition.problems import DefinitionError, Position, Problem, plural
from framekit.run.model import RunModel
from framekit.runfile.run_file import load_run
from framekit.sinks.base import SinkKind
from framekit.transport.schemes import writes_files

if sys.platform != "win32":
    import resource

LONGEST_CHECK = 40.0
"""Time limit of the check in a process of its own (s)."""
MOST_WORK = 20
"""Limit of its processor time (s), where the system has one; a busy machine does not count against a file."""
MOST_REPORTED = 50
"""Number of problems in a refusal; the others are counted."""
DATA_ENDINGS = frozenset(
    (".csv", ".tsv", ".txt", ".log", ".jsonl", ".ndjson", ".json", ".db", ".sqlite", ".sqlite3", ".parquet", ".state")
)
"""Endings of the files that a rolled file may create."""
_PROGRAM = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from framekit.extras.fleet.rolled_file import main; main()"
)


async def check_apart(path: Path, content: bytes, limit: float = LONGEST_CHECK) -> None:
    """Check `content` as the run file at `path`, in a process of its own.

    Raises DefinitionError with the problems of the file, and ValueError if the check ends without a result or is not
    complete after `limit` seconds.
    """
    command = (sys.executable, "-P", "-c", _PROGRAM, json.dumps(sys.path), str(path))
    pipe, null = asyncio.subprocess.PIPE, asyncio.subprocess.DEVNULL
    process = await asyncio.create_subprocess_exec(*command, stdin=pipe, stdout=pipe, stderr=null)
    try:
        output, _ = await asyncio.wait_for(process.communicate(content), limit)
    except TimeoutError:
        raise ValueError(f"the check took longer than {limit:g} s – make the file smaller") from None
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    if sys.platform != "win32" and process.returncode == -signal.SIGXCPU:
        raise ValueError(f"the check needs more than {MOST_WORK} s of processor time – make the file smaller")
    if process.returncode:
        raise ValueError("the check ended without a result – run framekit check with this file on the gateway")
    if problems := [Problem(Position(*at), what, todo) for at, what, todo in json.loads(output)]:
        raise DefinitionError(problems)


def main() -> None:
    """Check the run file on standard input and print its errors as JSON; `sys.argv[2]` is its path."""
    if sys.platform != "win32":
        resource.setrlimit(resource.RLIMIT_CPU, (MOST_WORK, MOST_WORK + 1))
    problems: tuple[Problem, ...] = ()
    try:
        load_run(Path(sys.argv[2]), sys.stdin.buffer.read().decode())
    except DefinitionError as error:
        problems = error.problems
    wrong = [problem for problem in problems if not problem.warning]
    print(json.dumps([((one.at.file, one.at.line, one.at.column), one.what, one.todo) for one in wrong]))


def refusal(error: Exception, path: Path) -> list[str]:
    """Return the sentences of a refusal: the problems of the run file at `path`, and other files by name only.

    An error that is no ValueError is an unforeseen failure; its text may quote anything, so only its type is reported.
    """
    if isinstance(error, DefinitionError):
        return [_relative(one, path) for one in _of_run_file(error.problems, path)]
    if isinstance(error, (ValueError, OSError)):
        return [_relative(str(error), path)]
    return [f"this gateway cannot apply the file ({type(error).__name__}) – see the log of the gateway"]


def _of_run_file(problems: Iterable[Problem], path: Path) -> Iterator[str]:
    """Yield the problems of the run file as sentences, then one sentence for each other file."""
    own, others = os.path.realpath(path), dict[str, int]()
    for problem in problems:
        if problem.warning:
            continue
        if not problem.at.line or os.path.realpath(problem.at.file) == own:
            yield str(problem)
        else:
            others[problem.at.file] = others.get(problem.at.file, 0) + 1
    for name, number in others.items():
        todo = "run framekit check on the gateway to see them; a refusal quotes no other file"
        yield f"{name}: this file has {plural(number, 'problem')} – {todo}"


def _relative(sentence: str, path: Path) -> str:
    """Return the sentence with the names of files relative to the folder of the run file."""
    for folder in {path.parent.resolve(), path.parent.absolute()}:
        sentence = sentence.replace(f"{folder}{os.sep}", "")
    return sentence


# ---- rights of a rolled file ----------------------------------------------------------------------------------


def more_than(old: RunModel, new: RunModel, file: ReplacedFile, own: set[str]) -> Iterator[Problem]:
    """Yield the parts of a rolled file that exceed its rights: another fleet, secrets for another server, foreign files
    and ports.

    `own`: files that runs of this gateway have written.
    """
    if new.fleet is None or fingerprint(new.fleet) != fingerprint(old.fleet):
        at = new.at if new.fleet is None else new.fleet.at
        yield Problem(at, "a rolled file stays in its fleet, and says the same of it", "change that on the gateway")
    known = {_in_essence(sink) for sink in old.sinks}
    for sink in new.sinks:
        if _in_essence(sink) in known:
            continue
        if sink.has_secret:
            what = "a sink with a secret, or one that the system gives, is not of the present file"
            yield Problem(sink.at, what, "change that sink on the gateway first")
        if sink.listens is not None and not _is_local(sink.listens[0]):
            what = f"{sink.target} can be reached from outside, and the present file does not have it so"
            yield Problem(sink.at, what, "listen on 127.0.0.1, or change that on the gateway first")
    ports = {channel.port for channel in old.channels.values()}
    for channel in new.channels.values():
        if channel.port not in ports and writes_files(channel.port):
            what = f"the port '{channel.port}' writes into a file, and the present file does not have it"
            yield Problem(channel.port_at, what, "name another port")
    here = Path(os.path.realpath(new.folder))
    for name in new.files:
        path = Path(os.path.realpath(name))
        if name in own:
            continue
        if not path.is_relative_to(here):
            what = f"'{name}' is not in the folder of the run file"
            yield Problem(new.at, f"{what}, and a rolled file writes nothing elsewhere", "name a file in that folder")
        elif path in file.companions or _is_taken(Path(name)):
            what = f"'{name}', or a file named after it, is there already, and neither this run nor the last has it"
            yield Problem(new.at, what, "name a file that is not there")
        elif Path(name).name.startswith(".") or Path(name).suffix.lower() not in DATA_ENDINGS:
            what = f"'{name}' is not the name of a data file, and a rolled file creates no others"
            yield Problem(new.at, what, f"use one of the endings {', '.join(sorted(DATA_ENDINGS))}")


def _is_taken(path: Path) -> bool:
    """Return whether the file exists, or a file that the same sink would name after it: rotated files, parts."""
    if os.path.lexists(path):
        return True
    try:
        names = os.listdir(path.parent)
    except OSError:
        return False
    put_aside = f"{path.stem}."
    return any(
        one.startswith(path.name) or (path.suffix and one.startswith(put_aside) and one.endswith(path.suffix))
        for one in names
    )


def _in_essence(sink: SinkKind) -> str:
    """Return the identity of a sink apart from its `points` and `every`."""
    return fingerprint(replace(sink, points=("*",), every=None))


def _is_local(host: str) -> bool:
    with suppress(ValueError):
        return ip_address(host).is_loopback
    return host == "localhost"


def files_of_before(path: Path, file: ReplacedFile) -> tuple[str, ...]:
    """Return the files that the run of the previous run file wrote; `path` is the run file as it was named."""
    try:
        return load_run(path, file.before.read_text("utf-8")).files
    except (OSError, ValueError):
        return ()
