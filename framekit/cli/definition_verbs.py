"""The verbs about definitions, which need no port: `encode`, `frames`, `check` and `test`.

`check` reports every problem of definitions, devices, runs, vectors, profiles, fault plans and jobs, at once; for a run
also how much of their time its channels need. `test` runs the vectors of a definition, frames and conversations.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from framekit.api.rows import spaced
from framekit.cli.common import (
    NAMES_HELP,
    ProgressLine,
    VerbError,
    WordsError,
    add,
    assignment,
    load,
    load_codec,
    near,
    painted,
    print_json,
    problem_data,
    scope_of,
    status_of,
    table,
    told_once,
)
from framekit.definition.problems import no_such, plural, separately

if TYPE_CHECKING:
    from framekit.api.check import Checked
    from framekit.definition.model.frames import Frame
    from framekit.definition.model.segments import Segment


def add_encode_arguments(parser: argparse.ArgumentParser) -> None:
    add(parser, "protocol")
    parser.add_argument("frame", metavar="FRAME", help="name of a frame; `framekit frames PROTOCOL` lists them")
    parser.add_argument(
        "fields",
        nargs="*",
        metavar="FIELD=VALUE",
        help="value of a field; RECORD.FIELD and LIST[0] as decode shows them, or JSON",
    )
    add(parser, "--param", help=NAMES_HELP)
    add(parser, "--json")


def run_encode(arguments: argparse.Namespace) -> int:
    from framekit.codec.codec import compile_protocol
    from framekit.codec.errors import EncodeError
    from framekit.codec.plain import PlainValues, with_hint

    protocol = load(arguments.protocol)
    if arguments.frame not in protocol.frames:
        raise WordsError(no_such(f"'{protocol.name}' has no frame", arguments.frame, protocol.frames))
    given = fields_given(arguments.fields)
    scope = scope_of(protocol, arguments.param)
    try:
        fields = PlainValues(protocol).from_plain(arguments.frame, given)
        data = compile_protocol(protocol).encode(arguments.frame, fields, scope)
    except EncodeError as error:
        raise WordsError(f"frame '{arguments.frame}': {with_hint(error, protocol, arguments.frame, given)}") from None
    if arguments.json:
        print_json({"frame": arguments.frame, "bytes": spaced(data)})
    else:
        print(spaced(data))
    return 0


Steps = tuple[str | int, ...]
"""Path to a value: names of fields, records and frames, and indexes of lists."""

_STEP = re.compile(r"(?P<name>[^\[\]]+)(\[(?P<index>[0-9]{1,9})\])?")


def fields_given(texts: Iterable[str]) -> dict[str, Any]:
    """Return the values of `NAME=VALUE`, `RECORD.NAME=VALUE` and `LIST[0].NAME=VALUE`, in the form of the codec.

    Raises WordsError.
    """
    given: dict[Steps, str] = {}
    nodes: dict[Steps, dict[str | int, Any]] = {(): {}}
    for text in texts:
        path, value = assignment(text)
        steps = steps_of(path)
        if steps in given:
            raise WordsError(f"'{path}' is given twice – give it once")
        if steps in nodes:
            part = next(one for known, one in given.items() if known[: len(steps)] == steps)
            raise WordsError(f"'{part}' is a part of '{path}', which has a value too – give one of the two")
        given[steps] = path
        node = nodes[()]
        for length in range(1, len(steps)):
            whole = steps[:length]
            if whole in given:
                raise WordsError(f"'{path}' is a part of '{given[whole]}', which has a value too – give one of the two")
            node = nodes.setdefault(whole, node.setdefault(steps[length - 1], {}))
        node[steps[-1]] = value
    return _with_lists(nodes)


def steps_of(path: str) -> Steps:
    """Parse `a.b[0].c` into its steps. Raises WordsError."""
    steps: list[str | int] = []
    for part in path.split("."):
        found = _STEP.fullmatch(part)
        if found is None:
            what = f"'{part}' is not a name" if part else "a part is empty"
            raise WordsError(f"'{path}': {what} – write FIELD, RECORD.FIELD or LIST[0].FIELD")
        steps += [found["name"]] if found["index"] is None else [found["name"], int(found["index"])]
    return tuple(steps)


def _with_lists(nodes: dict[Steps, dict[str | int, Any]]) -> dict[str, Any]:
    """Return the outermost node, with nodes of indexes as lists; a node precedes its parts. Raises WordsError."""
    for steps, node in reversed(nodes.items()):
        indexes = sorted(step for step in node if isinstance(step, int))
        if not indexes:
            continue
        if len(indexes) < len(node):
            raise WordsError(f"'{steps[-1]}' has a value with an index and one without – give one of the two")
        if missing := set(range(len(indexes))).difference(indexes):
            raise WordsError(f"'{steps[-1]}[{min(missing)}]' is missing – give each index from 0 without a gap")
        nodes[steps[:-1]][steps[-1]] = [node[index] for index in indexes]
    return {str(name): value for name, value in nodes[()].items()}


def add_frames_arguments(parser: argparse.ArgumentParser) -> None:
    add(parser, "protocol", nargs="?")
    add(parser, "--json")


def run_frames(arguments: argparse.Namespace) -> int:
    if arguments.protocol is None:
        return _protocols(arguments.json)
    protocol = load_codec(arguments.protocol).protocol
    frames = [(frame, fields_of(frame.segments)) for frame in protocol.frames.values()]
    if arguments.json:
        print_json([_as_json(frame, fields) for frame, fields in frames])
        return 0
    for frame, fields in frames:
        marks = [f"from {frame.side}"] if frame.side != "both" else []
        marks += ["inside other frames"] if frame.inner else []
        print(f"{frame.name}" + (f"  ({', '.join(marks)})" if marks else ""))
        for name, form in fields:
            print(f"    {name}: {form}")
    return 0


def _protocols(as_json: bool) -> int:
    """Print the definitions that can be named, by family, a line each; return the exit status.

    A definition that extends another is of the same family.
    """
    from framekit.definition.nodes import head_of
    from framekit.definition.sources import known_definitions

    heads = {path.stem: head_of(path) for path in known_definitions()}
    rows = [
        (_family(name, heads), name, kind, head.get("about", ""))
        for name, head in heads.items()
        if (kind := next(iter(head), "")) in ("protocol", "application")
    ]
    rows.sort(key=lambda row: (row[0].casefold(), row[1]))
    head = ("family", "name", "kind", "about")
    if as_json:
        print_json([dict(zip(head, row, strict=True)) for row in rows])
    else:
        print(table(rows, head))
    return 0


def _family(name: str, heads: Mapping[str, Mapping[str, str]]) -> str:
    """Return the family that a shipped definition names, or else the nearest definition that it extends."""
    while name in heads:
        if family := heads[name].get("family"):
            return family
        name = heads[name].get("extends", "")
    return ""


def _as_json(frame: Frame, fields: list[tuple[str, str]]) -> dict[str, Any]:
    return {
        "frame": frame.name,
        "from": frame.side,
        "inner": frame.inner,
        "fields": [{"name": name, "form": form} for name, form in fields],
    }


def fields_of(segments: tuple[Segment, ...], indent: str = "") -> list[tuple[str, str]]:
    """Return name and form of every field, those of records and repeats indented below them."""
    from framekit.definition.model.frames import flat
    from framekit.definition.model.segments import Bits

    found: list[tuple[str, str]] = []
    for segment in flat(segments):
        if isinstance(segment, Bits):
            found += [(indent + part.name, _places(part.low, part.high)) for part in segment.parts]
        elif segment.is_record or segment.is_list:
            found += [(indent + name, "record" if segment.is_record else "list") for name in segment.value_names]
            found += fields_of(segment.members, indent + "  ")
        elif segment.frames_inside:
            found += [(indent + name, "one of " + ", ".join(segment.frames_inside)) for name in segment.value_names]
        elif (form := _form(segment)) is not None and segment.name:
            found.append((indent + segment.name, form))
    return found


def _places(low: int, high: int) -> str:
    return f"bit {low}" if low == high else f"bits {low}-{high}"


def _bytes(size: object) -> str:
    return plural(size, "byte") if isinstance(size, int) else f"{size} bytes"


_KINDS = {
    "fraction": "decimal",
    "scaled": "scaled number",
    "hex_int": "signed number in hex",
    "hex_float": "float in hex",
}


def _form(segment: Segment) -> str | None:
    from framekit.definition.model.segments import Count, Data, Field, Length, Value

    match segment:
        case Field(type=type_):
            size = f", {_bytes(type_.size)}" if type_.size is not None else ""
            return f"{_KINDS.get(type_.kind, type_.kind)}{size}"
        case Data(size=size):
            return "bytes, the rest" if size == "rest" else f"bytes, {size}"
        case Length(of=of):
            return "length of " + ", ".join(of)
        case Count(of=counted):
            return f"count of {counted}"
        case Value():
            return "derived"
    return None


# ---- check and test -----------------------------------------------------------------------------------------


def add_check_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("files", nargs="+", metavar="FILE", help="a YAML file, or the name of a shipped protocol")
    parser.add_argument("--load", action="store_true", help="show what each block of a run takes of its channel's time")
    add(parser, "--json")


def run_check(arguments: argparse.Namespace) -> int:
    from framekit.api.check import check_file

    results = [(name, check_file(name)) for name in arguments.files]
    status = status_of(problem for _, checked in results for problem in checked.problems)
    if arguments.json:
        print_json([{"file": name, **_file_as_json(checked)} for name, checked in results])
        return status
    shown: set[str] = set()
    for name, checked in results:
        lines = list(told_once(checked.problems))
        for line in lines:
            if line not in shown:
                print(line, file=sys.stderr)
        if lines and shown.issuperset(lines):  # such as of a device and its protocol
            print(f"{name}: not checked further – correct the problems above first", file=sys.stderr)
        shown.update(lines)
        if not any(not problem.warning for problem in checked.problems):
            print(f"{name}: {checked.what}")
            _show_loads(checked, arguments.load)
    return status


def _show_loads(checked: Checked, in_full: bool) -> None:
    """Print a line for each channel with cycles; in full, every channel with a table of its blocks."""
    from framekit.cli.run_output import load_line, load_table

    for one in checked.loads:
        if in_full:
            print(f"\n{load_line(one)}\n{load_table(one)}")
        elif one.round:
            print(f"  {load_line(one)}")


def _file_as_json(checked: Checked) -> dict[str, Any]:
    found = {"what": checked.what, "problems": [problem_data(one) for one in separately(checked.problems)]}
    if checked.loads:
        from framekit.cli.run_output import load_data

        found["channels"] = [load_data(load) for load in checked.loads]
    return found


def add_test_arguments(parser: argparse.ArgumentParser) -> None:
    add(parser, "protocol", "--json")


def run_test(arguments: argparse.Namespace) -> int:
    from framekit.api.vectors import run_vectors, vectors_path
    from framekit.definition.load.protocol import definition_path

    with ProgressLine("test") as line:

        def progress(done: int, of: int) -> None:
            line.says = lambda: f"{done} of {of} cases"

        results = run_vectors(arguments.protocol, Path.cwd(), progress)
    if not results:
        path = definition_path(arguments.protocol, Path.cwd())
        raise VerbError(f"there are no vectors beside '{near(str(path))}' – write {near(str(vectors_path(path)))}")
    failed = [result for result in results if result.problems]
    if arguments.json:
        print_json([{"kind": one.kind, "name": one.name, "problems": one.problems} for one in results])
        return int(bool(failed))
    for result in results:
        word = painted("FAILED  ", "red", sys.stdout) if result.problems else painted("ok      ", "green", sys.stdout)
        print(f"{word}{result.kind}: {result.name}")
        for problem in result.problems:
            print(f"        {problem}")
    print(f"{len(results) - len(failed)} passed, {len(failed)} failed")
    return int(bool(failed))
