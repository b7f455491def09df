"""The verbs about definitions, which need no port: `encode`, `frames`, `generate`, `check` and `test`.

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
    told,
    told_once,
    why_not,
)
from framekit.definition.problems import no_such, plural, printable

if TYPE_CHECKING:
    from framekit.api.check import Checked
    from framekit.definition.model.frames import Frame
    from framekit.definition.model.segments import Segment
    from framekit.definition.problems import Problem


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


def add_generate_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "what",
        choices=("python", "c", "wireshark", "kaitai", "jsonschema", "typescript", "document", "diagram"),
        help="python: a module of plain functions, usable without framekit; c: a header and a source in C99, with"
        " nothing to link; wireshark: a dissector in Lua; kaitai: a Kaitai Struct file (.ksy);"
        " jsonschema, typescript: types of what decode"
        " --json prints; document: the frames drawn, fields, services and sequences,"
        " for people; diagram: the sequences in Mermaid",
    )
    add(parser, "protocol")
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="FILE",
        help="where to write it; default: standard output; of c and kaitai a directory; of document NAME.html or"
        " NAME.md",
    )
    parser.add_argument(
        "--strict", action="store_true", help="c, wireshark, kaitai: exit status 1 if something is left out"
    )
    add(parser, "--param", help=NAMES_HELP)
    parser.add_argument(
        "--max-bytes", type=_bytes_of_a_frame, metavar="N", default=None,
        help="c: bytes of a frame whose definition has no limit (default 1024)",
    )  # fmt: skip


LONGEST_FRAME = 65_536


def _bytes_of_a_frame(text: str) -> int:
    """Return a number of bytes from its text. Raises ArgumentTypeError."""
    if not text.isdecimal() or not 1 <= int(text) <= LONGEST_FRAME:
        raise argparse.ArgumentTypeError(f"'{text}' is no size – write a number from 1 to {LONGEST_FRAME}")
    return int(text)


def run_generate(arguments: argparse.Namespace) -> int:
    if arguments.output is not None and arguments.output.suffix in (".yaml", ".yml"):
        raise WordsError(f"-o: {arguments.output} ends like a definition, and none is written over – name another file")
    if arguments.what == "c":
        return _generate_c(arguments)
    if arguments.what == "kaitai":
        return _generate_kaitai(arguments)
    if arguments.what == "document":
        return _generate_document(arguments)
    protocol = load_codec(arguments.protocol).protocol
    left_out = ""
    if arguments.param and arguments.what != "wireshark":
        raise WordsError("--param is for wireshark: other code is given parameters when it runs")
    if arguments.what == "wireshark":
        from framekit.codec.lua.generate import generate_dissector

        made = generate_dissector(protocol, scope_of(protocol, arguments.param))
        source, left_out = made.source, "\n".join(_not_said(*one) for one in made.left_out)
    elif arguments.what == "python":
        from framekit.codec.python.generate import generate_source

        source = generate_source(protocol)
    elif arguments.what in ("jsonschema", "typescript"):
        import json

        from framekit.api.value_types import json_schema, typescript

        is_schema = arguments.what == "jsonschema"
        source = (
            json.dumps(json_schema(protocol), indent=1, ensure_ascii=False) + "\n"
            if is_schema
            else typescript(protocol)
        )
    else:
        from framekit.definition.diagrams import diagrams

        if not protocol.sequences:
            raise VerbError(f"'{protocol.name}' has no sequences – there is nothing to draw")
        source = diagrams(protocol)
    if arguments.output is None:
        print(source, end="")
    else:
        try:
            arguments.output.write_text(source, encoding="utf-8")
        except OSError as error:
            raise VerbError(f"cannot write {why_not(error, arguments.output)}") from None
    if left_out:
        print(left_out, file=sys.stderr)
    return 1 if arguments.strict and left_out else 0


def _not_said(problem: Problem, frames: tuple[str, ...]) -> str:
    """Return a message about a part that the dissector lacks, with the names of its frames."""
    some = f" ({', '.join(frames[:3])}{', …' if len(frames) > 3 else ''})" if frames else ""
    return printable(told(problem) + some)


def _generate_document(arguments: argparse.Namespace) -> int:
    """Write one page, or Markdown with a folder of pictures."""
    from framekit.api.document import document, html, markdown
    from framekit.api.vectors import vectors_path
    from framekit.definition.load.protocol import definition_path

    place: Path | None = arguments.output
    if place is None or place.suffix not in (".html", ".md"):
        raise WordsError("a document is written into a file – add -o NAME.html or -o NAME.md")
    blocks = document(load(arguments.protocol), vectors_path(definition_path(arguments.protocol)))
    folder = place.with_suffix(".frames")
    text, pictures = (html(blocks), {}) if place.suffix == ".html" else markdown(blocks, folder.name)
    try:
        place.write_text(text, encoding="utf-8")
        if pictures:
            folder.mkdir(exist_ok=True)
        for name, picture in pictures.items():
            (folder / name).write_text(picture, encoding="utf-8")
    except OSError as error:
        raise VerbError(f"cannot write {why_not(error, place)}") from None
    return 0


def _place(problem: Problem) -> str:
    """Return the place of a problem, relative to the current folder."""
    return f"{near(problem.at.file)}:{problem.at.line}:{problem.at.column}"


def _generate_c(arguments: argparse.Namespace) -> int:
    """Write a header and a source into a directory; report the frames that are left out."""
    from framekit.codec.c.generate import MOST_BYTES, generate

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
        print(printable(f"{_place(problem)}: frame '{frame}' is left out: {problem.what}"))
    for frame, name, problem in made.to_give:
        print(printable(f"{_place(problem)}: '{name}' of frame '{frame}' has no default in C: {problem.what}"))
    for frame, problem in made.not_built:
        print(printable(f"{_place(problem)}: frame '{frame}' is read and not built: {problem.what}"))
    for frame, problem in made.not_measured:
        print(printable(f"{_place(problem)}: frame '{frame}' is not looked for in streams: {problem.what}"))
    return 1 if arguments.strict and (made.left_out or made.not_built) else 0


def _generate_kaitai(arguments: argparse.Namespace) -> int:
    """Write a `.ksy` into a directory; report the parts that Kaitai cannot express."""
    from framekit.codec.kaitai.generate import generate_kaitai

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
            print(f"{name}: what is wrong has been told above", file=sys.stderr)
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
    found = {"what": checked.what, "problems": [problem_data(one) for one in checked.problems]}
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
