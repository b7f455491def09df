"""The verbs about definitions, which need no port: `encode`, `decode`, `frames`, `generate`, `check` and `test`.

`check` tells every problem of definitions, devices, runs, vectors, profiles, fault plans and jobs, at once; for a run
also how much of their time its channels need. `test` runs the vectors beside a definition, frames and conversations.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import AbstractContextManager, closing, nullcontext
from datetime import UTC, datetime
from functools import lru_cache
from glob import glob
from pathlib import Path
from typing import TYPE_CHECKING, Any

from framekit.api.rows import spaced
from framekit.cli.common import (
    ProgressLine,
    VerbError,
    WordsError,
    add,
    assignment,
    assignments,
    existing,
    filter_of,
    hex_bytes,
    in_words,
    line_of,
    load,
    load_codec,
    near,
    painted,
    print_json,
    problem_data,
    scope_of,
    seen_data,
    seen_text,
    status_of,
    table,
    tell_error,
    told,
    told_once,
    why_not,
)
from framekit.codec.shown import code_text
from framekit.definition.problems import no_such, plural, printable

if TYPE_CHECKING:
    from framekit import Seen
    from framekit.api.check import Checked
    from framekit.api.settings import Names
    from framekit.codec.cache import CachedCodec
    from framekit.codec.functions import Fit
    from framekit.codec.plain import PlainValues
    from framekit.definition.model.frames import Frame
    from framekit.definition.model.protocol import Protocol
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
    add(parser, "--set", "--json")


def run_encode(arguments: argparse.Namespace) -> int:
    from framekit.codec.codec import compile_protocol
    from framekit.codec.errors import EncodeError
    from framekit.codec.plain import PlainValues, with_hint

    protocol = load(arguments.protocol)
    if arguments.frame not in protocol.frames:
        raise WordsError(no_such(f"'{protocol.name}' has no frame", arguments.frame, protocol.frames))
    given = fields_given(arguments.fields)
    scope = scope_of(protocol, arguments.set)
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
"""The way to a value: names of fields, records and frames, and indexes of lists."""

_STEP = re.compile(r"(?P<name>[^\[\]]+)(\[(?P<index>[0-9]{1,9})\])?")


def fields_given(texts: Iterable[str]) -> dict[str, Any]:
    """The values of `NAME=VALUE`, `RECORD.NAME=VALUE` and `LIST[0].NAME=VALUE`, as the codec has them.

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
    """`a.b[0].c` in its steps. Raises WordsError."""
    steps: list[str | int] = []
    for part in path.split("."):
        found = _STEP.fullmatch(part)
        if found is None:
            what = f"'{part}' is not a name" if part else "a part is empty"
            raise WordsError(f"'{path}': {what} – write FIELD, RECORD.FIELD or LIST[0].FIELD")
        steps += [found["name"]] if found["index"] is None else [found["name"], int(found["index"])]
    return tuple(steps)


def _with_lists(nodes: dict[Steps, dict[str | int, Any]]) -> dict[str, Any]:
    """The outermost of the nodes, which stand before what is in them; those of indexes as lists. Raises WordsError."""
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


def add_decode_arguments(parser: argparse.ArgumentParser) -> None:
    add(parser, "protocol")
    bytes_ = parser.add_argument(
        "bytes", metavar="HEX", nargs="+", help="the bytes as hex digits, or - for standard input"
    )
    parser.add_argument("--frame", help="try this frame only")
    parser.add_argument("--from", dest="side", choices=("client", "server"), help="which side sent the bytes")
    add(parser, "--set", "--json")
    add_capture_arguments(parser, bytes_)


def run_decode(arguments: argparse.Namespace) -> int:
    from framekit.codec.functions import fitting, reason

    codec = load_codec(arguments.protocol)
    if arguments.capture is not None:
        return decode_capture(codec.protocol, arguments)
    for option in ("to", "values", "jobs", "engine"):
        if getattr(arguments, option) is not None:
            raise WordsError(f"--{option} has no effect without --capture – add it, or remove this")
    names = context(codec, arguments.set)
    data = hex_bytes(" ".join(arguments.bytes))
    tried = frames_tried(codec, arguments.frame, arguments.side)
    fits, faults = fitting(codec, codec.catalogue, data, tried, names)
    if not fits:
        tell_error(arguments, "no_frame", reason(faults, data))
        return 1
    if arguments.json:
        print_json(as_json(codec, fits, data, names))
    else:
        print("\n\n".join(as_text(codec, fit, data, names) for fit in fits))
    return 0


class StartNames(dict[str, Any]):
    """The start values of parameters and state; those that only the whole definition knows are looked up there."""

    def __init__(self, codec: CachedCodec) -> None:
        super().__init__(codec.defaults)
        self._codec = codec
        self._scope: Names | None = None

    def __missing__(self, name: str) -> Any:
        if self._scope is None:
            self._scope = scope_of(self._codec.protocol, ())
        return self._scope[name]

    def get(self, name: str, default: Any = None) -> Any:
        try:
            return self[name]
        except KeyError:
            return default


def context(codec: CachedCodec, settings: list[str]) -> Mapping[str, Any]:
    """What the bytes depend on: as the definition starts, or with these settings. Raises WordsError."""
    return scope_of(codec.protocol, settings) if settings else StartNames(codec)


def frames_tried(codec: CachedCodec, frame: str | None, side: str | None) -> list[str]:
    """The frames to try. Raises WordsError for one there is not."""
    from framekit.codec.functions import candidates, of_side

    if frame is None:
        return of_side(codec.catalogue, side)
    protocol = codec.protocol
    if frame not in protocol.frames and frame not in protocol.groups:
        raise WordsError(no_such(f"'{protocol.name}' has no frame", frame, [*protocol.frames, *protocol.groups]))
    return candidates(protocol, frame, side)


def as_json(codec: CachedCodec, fits: list[Fit], data: bytes, names: Mapping[str, Any]) -> dict[str, Any]:
    from framekit.codec.plain import PlainValues

    plain = PlainValues(codec.protocol)
    shown: list[dict[str, Any]] = []
    for fit in fits:
        one: dict[str, Any] = {"frame": fit.frame, "fields": plain.to_plain(fit.frame, fit.fields)}
        if fit.refusal is not None:
            one["refused"] = fit.refusal
        if warnings := codec.check_warnings(fit.frame, data, names):
            one["warnings"] = warnings
        shown.append(one)
    return shown[0] | ({"others": shown[1:]} if len(shown) > 1 else {})


def as_text(codec: CachedCodec, fit: Fit, data: bytes, names: Mapping[str, Any]) -> str:
    """The frame's name and a table of its fields."""
    from framekit.codec.shown import shown, with_name

    _, spans, _ = codec.trace(fit.frame, data, names)
    rows, named = [], codec.catalogue[fit.frame].names
    for path, start, end, value in spans:
        text = "" if value is None else f"{with_name(named, path, shown(value))}"
        rows.append((path, str(start), spaced(data[start:end]), text))
    refused = "" if fit.refusal is None else f"  (a server refuses it with {code_text(fit.refusal)})"
    warned = "".join(f"\nwarning: {text}" for text in codec.check_warnings(fit.frame, data, names))
    return f"{fit.frame}{refused}{warned}\n" + table(rows, ("field", "offset", "bytes", "value"))


DAY = 86_400_000_000_000


class _Instead(argparse.Action):
    """An option in the place of an argument that has to be there without it."""

    def __init__(self, *words: Any, instead_of: argparse.Action, **options: Any) -> None:
        super().__init__(*words, **options)
        self._instead_of = instead_of

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, option: str | None = None
    ) -> None:
        setattr(namespace, self.dest, values)
        self._instead_of.required = False


def add_capture_arguments(parser: argparse.ArgumentParser, bytes_: argparse.Action) -> None:
    """What decoding a capture takes beside PROTOCOL, --set and --json, in the place of `bytes_`."""
    parser.add_argument(
        "--capture", metavar="FILE", type=Path, action=_Instead, instead_of=bytes_,
        help="decode a capture (pcap or JSON lines) instead; with --to also several: 'DIR/*.pcap'",
    )  # fmt: skip
    parser.add_argument(
        "--to", metavar="OUT.parquet", type=Path,
        help="write rows to a table, a folder with a Parquet file for each capture, and print the counts only",
    )  # fmt: skip
    parser.add_argument(
        "--values", metavar="OUT.csv", type=Path,
        help="write what requests and replies say of the values in devices to a table, as a sink does",
    )  # fmt: skip
    parser.add_argument("--jobs", metavar="N", type=int, help="with --to: so many processes; default: one a core")
    parser.add_argument(
        "--engine",
        metavar="dask://HOST:PORT",
        help="with --to: the workers of this cluster decode, which see the same files",
    )
    parser.add_argument(
        "--client", choices=("in", "out"), default="out",
        help="direction of the client's frames in a capture that has both; default: out",
    )  # fmt: skip
    add(parser, "--ascii", help="show bytes of a capture as ASCII")
    add(parser, "--speed", "--format", "--filter", "--frame-name", "--bad")


def decode_capture(protocol: Protocol, arguments: argparse.Namespace) -> int:
    """Prints everything; 1 when there was a bad frame or noise. Raises VerbError."""
    from framekit.api.monitor import decoder, result_of
    from framekit.codec.plain import PlainValues

    if arguments.to is not None and arguments.values is not None:
        raise WordsError("--to and --values write different tables – leave one of them out")
    if arguments.to is not None:
        return _archive(protocol, arguments)
    for option in ("jobs", "engine"):
        if getattr(arguments, option) is not None:
            raise WordsError(f"--{option} has no effect without --to – add --to OUT.parquet, or remove it")
    if arguments.values is not None:
        return _values(protocol, arguments)
    wanted, plain = filter_of(arguments), PlainValues(protocol)
    counts: Counter[str] = Counter()
    if _matching(arguments.capture):
        raise WordsError(f"{arguments.capture}: a pattern needs --to OUT.parquet – add it, or name one file")
    path, line = existing(arguments.capture), line_of(protocol, arguments)
    given = assignments(arguments.set)
    try:
        with in_words():
            found = decoder(path, protocol, line=line, params=given, client=arguments.client)
        with decoding(counts):
            for channel, seen in found.seen():
                if seen.kind != "noise" or not seen.reason:  # what a bad frame left is part of that
                    counts[seen.kind] += 1
                if not wanted.takes(channel, seen):
                    continue
                if arguments.json:
                    more = {"time_ns": seen.at, "channel": channel, "result": result_of(protocol, seen)}
                    print_json(seen_data(seen, seen.at / 1e9, plain, **more))
                else:
                    print(_text(plain, channel, seen, arguments.ascii))
    except ValueError as error:
        raise VerbError(str(error)) from None
    if found.is_cut:
        print(f"{arguments.capture}: {_CUT}", file=sys.stderr)
    if not arguments.json:
        print(_counted(counts))
    return 1 if counts["bad"] or counts["noise"] else 0


def decoding(counts: Mapping[str, int]) -> AbstractContextManager[object]:
    """Tells how far it is, where what is decoded does not fill the terminal itself."""
    return nullcontext() if sys.stdout.isatty() else ProgressLine("decode", lambda: _counted(counts))


def _matching(pattern: Path) -> list[Path]:
    """The files that a pattern means, in order; none where it is a file itself."""
    return [] if pattern.exists() else [Path(one) for one in sorted(glob(str(pattern)))]


_CUT = "the last record is not whole – its writer was stopped"


def _counted(counts: Mapping[str, int]) -> str:
    return (
        f"{plural(counts.get('frame', 0), 'frame')}, {counts.get('bad', 0)} bad, {counts.get('noise', 0)} times noise"
    )


def _archive(protocol: Protocol, arguments: argparse.Namespace) -> int:
    """Decodes captures to a table, with a line for each as it ends.

    1 when one has a bad frame or noise, or could not be read. Raises VerbError.
    """
    from framekit.api.archive import archive

    if arguments.ascii:
        raise WordsError("--ascii has no effect with --to – remove it")
    if arguments.jobs is not None and (arguments.jobs < 1 or arguments.engine is not None):
        raise WordsError("--jobs is a number of processes on this machine, 1 or more – remove it or --engine")
    if not arguments.to.suffix == ".parquet":
        raise WordsError(f"--to {arguments.to}: write a name that ends in .parquet")
    captures = _matching(arguments.capture) or [existing(arguments.capture)]
    total: Counter[str] = Counter()
    rows, is_wrong, is_one, ended = 0, False, len(captures) == 1, 0
    shows = arguments.json or not is_one  # a line for each capture, which would stand in that line
    hidden = shows and sys.stdout.isatty()
    line = ProgressLine("decode", lambda: f"{ended} of {plural(len(captures), 'capture')}")
    with nullcontext() if hidden else line, in_words(), closing(
        archive(
            captures, arguments.protocol, arguments.to, params=assignments(arguments.set),
            line=line_of(protocol, arguments), client=arguments.client, wanted=filter_of(arguments),
            jobs=arguments.jobs, engine=arguments.engine or "",
        )
    ) as found:  # fmt: skip
        for one in found:
            ended += 1
            total.update(one.counts)
            rows += one.rows
            is_wrong |= bool(one.problem or one.counts.get("bad") or one.counts.get("noise"))
            for problem in filter(None, (one.problem, _CUT if one.is_cut else "")):
                print(problem if one.capture in problem else f"{one.capture}: {problem}", file=sys.stderr)
            if arguments.json:
                print_json({"capture": one.capture, "rows": one.rows, **one.counts})
            elif not is_one:
                print(f"{Path(one.capture).name}: {_counted(one.counts)}", flush=True)
    if not arguments.json:
        print(f"{arguments.to}: {plural(rows, 'row')} of {plural(len(captures), 'capture')}; {_counted(total)}")
    return 1 if is_wrong else 0


def _values(protocol: Protocol, arguments: argparse.Namespace) -> int:
    """Writes the values in a capture to a table. Raises VerbError."""
    from framekit.api.archive import captured_values, write_values
    from framekit.api.monitor import decoder

    useless = {"--ascii": arguments.ascii, "--filter": arguments.filter, "--frame-name": arguments.frame_name}
    for option, given in (useless | {"--bad": arguments.bad, "--json": arguments.json}).items():
        if given:
            raise WordsError(f"{option} has no effect with --values – remove it")
    if arguments.values.suffix != ".csv":
        raise WordsError(f"--values {arguments.values}: write a name that ends in .csv")
    path, given = existing(arguments.capture), assignments(arguments.set)
    try:
        with in_words():
            found = decoder(path, protocol, line=line_of(protocol, arguments), params=given, client=arguments.client)
            values = captured_values(found.seen(), protocol, arguments.protocol, given)
            with ProgressLine("decode"):
                count, points = write_values(values, arguments.values)
    except OSError as error:
        raise VerbError(why_not(error)) from None
    except ValueError as error:
        raise VerbError(str(error)) from None
    if found.is_cut:
        print(f"{arguments.capture}: {_CUT}", file=sys.stderr)
    print(f"{arguments.values}: {plural(count, 'value')} of {plural(points, 'place')}")
    if not count:
        print("no request with a reply of one frame tells a value – look at the frames themselves", file=sys.stderr)
    return 0 if count else 1


def _text(plain: PlainValues, channel: int, seen: Seen, as_ascii: bool) -> str:
    """The line of a frame and, below it, its fields."""
    text = seen_text(seen, time_text(seen.at), f"ch {channel}", as_ascii)
    fields = plain.to_plain(seen.frame, seen.fields)
    shown = "  ".join(f"{name}={_plain(value)}" for name, value in fields.items())
    return f"{text}\n{'':10}{shown}" if shown else text


def _plain(value: Any) -> str:
    return _AS_JSON(value) if isinstance(value, (dict, list)) else str(value)


_AS_JSON = json.JSONEncoder(ensure_ascii=False).encode


def time_text(at: int) -> str:
    """A time of a capture: the clock, with the date where it is a real one."""
    seconds, rest = divmod(at, 1_000_000_000)
    return f"{_second_text(seconds)}.{rest // 1000:06d}"


@lru_cache(1)
def _second_text(seconds: int) -> str:
    moment = datetime.fromtimestamp(seconds, UTC)
    return f"{moment:%H:%M:%S}" if seconds < DAY // 1_000_000_000 else f"{moment:%Y-%m-%d %H:%M:%S}"


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
    """The definitions that can be named, by family, a line each; one that extends another is of the same family."""
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
    """The family that a shipped definition names, or the first of those it extends that does."""
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
    """Name and form of every field, those of records and repeats indented below them."""
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
    add(parser, "--set")
    parser.add_argument(
        "--max-bytes", type=_bytes_of_a_frame, metavar="N", default=None,
        help="c: bytes of a frame whose definition has no limit (default 1024)",
    )  # fmt: skip


LONGEST_FRAME = 65_536


def _bytes_of_a_frame(text: str) -> int:
    """A number of bytes. Raises ArgumentTypeError."""
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
    if arguments.set and arguments.what != "wireshark":
        raise WordsError("--set is for wireshark: other code is given parameters when it runs")
    if arguments.what == "wireshark":
        from framekit.codec.lua.generate import generate_dissector

        made = generate_dissector(protocol, scope_of(protocol, arguments.set))
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
    """What a dissector does not say, with the frames that have it."""
    some = f" ({', '.join(frames[:3])}{', …' if len(frames) > 3 else ''})" if frames else ""
    return printable(told(problem) + some)


def _generate_document(arguments: argparse.Namespace) -> int:
    """One page, or Markdown with a folder of pictures beside it."""
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
    """Where a problem is, seen from the current folder."""
    return f"{near(problem.at.file)}:{problem.at.line}:{problem.at.column}"


def _generate_c(arguments: argparse.Namespace) -> int:
    """A header and a source in a directory; what is left out is told."""
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
    """A `.ksy` in a directory; what Kaitai does not say is told."""
    from framekit.codec.kaitai.generate import generate_kaitai

    folder: Path | None = arguments.output
    if folder is None:
        raise WordsError("a Kaitai file is written into a directory – add -o DIR")
    if arguments.set:
        raise WordsError("--set is for wireshark: a Kaitai file is given parameters when it reads")
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
    told: set[str] = set()
    for name, checked in results:
        lines = list(told_once(checked.problems))
        for line in lines:
            if line not in told:
                print(line, file=sys.stderr)
        if lines and told.issuperset(lines):  # of a device and its protocol, say
            print(f"{name}: what is wrong has been told above", file=sys.stderr)
        told.update(lines)
        if not any(not problem.warning for problem in checked.problems):
            print(f"{name}: {checked.what}")
            _show_loads(checked, arguments.load)
    return status


def _show_loads(checked: Checked, in_full: bool) -> None:
    """A line for each channel with cycles; in full, every channel with a table of its blocks."""
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
