"""`framekit frames [PROTOCOL]`: the shipped protocols, or the frames and fields of one."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from framekit.cli.common import add_json, add_protocol, load_codec, print_json, table

if TYPE_CHECKING:
    from framekit.definition.model.frames import Frame
    from framekit.definition.model.segments import Segment


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_protocol(parser, nargs="?")
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
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
    from framekit.definition.load.reader import Reader
    from framekit.definition.nodes import Mapping, Scalar, read_nodes
    from framekit.definition.shipped import shipped_folder

    rows = []
    for path in sorted(shipped_folder("frames").glob("*.yaml")):
        root = read_nodes(path)
        kind = root.entries[0].key.text if isinstance(root, Mapping) and root.entries else ""
        if kind in ("protocol", "application") and isinstance(root, Mapping):
            about = root.get("about")
            rows.append((path.stem, kind, Reader().text(about) if isinstance(about, Scalar) else ""))
    if as_json:
        print_json([{"name": name, "kind": kind, "about": about} for name, kind, about in rows])
    else:
        print(table(rows, ("name", "kind", "about")))
    return 0


def _as_json(frame: Frame, fields: list[tuple[str, str]]) -> dict[str, Any]:
    return {
        "frame": frame.name,
        "from": frame.side,
        "inner": frame.inner,
        "fields": [{"name": name, "form": form} for name, form in fields],
    }


def fields_of(segments: tuple[Segment, ...], indent: str = "") -> list[tuple[str, str]]:
    """Name and form of every field, those of records and repeats indented below them."""
    from framekit.definition.model.segments import Bits, Inner, Record, Repeat
    from framekit.definition.model.walk import flat

    found: list[tuple[str, str]] = []
    for segment in flat(segments):
        if isinstance(segment, Bits):
            found += [(indent + part.name, _places(part.low, part.high)) for part in segment.parts]
        elif isinstance(segment, (Record, Repeat)):
            found.append((indent + segment.name, "record" if isinstance(segment, Record) else "list"))
            found += fields_of(segment.inner_record or (), indent + "  ")
        elif isinstance(segment, Inner):
            found.append((indent + segment.name, "one of " + ", ".join(segment.frames)))
        elif (form := _form(segment)) is not None and segment.name:
            found.append((indent + segment.name, form))
    return found


def _places(low: int, high: int) -> str:
    return f"bit {low}" if low == high else f"bits {low}-{high}"


def _bytes(size: object) -> str:
    from framekit.definition.problems import plural

    return plural(size, "byte") if isinstance(size, int) else f"{size} bytes"


def _form(segment: Segment) -> str | None:
    from framekit.definition.model.segments import Count, Data, Field, Length, Value

    match segment:
        case Field(type=type_):
            size = f", {_bytes(type_.size)}" if type_.size is not None else ""
            return f"{type_.kind}{size}"
        case Data(size=size):
            return "bytes, the rest" if size == "rest" else f"bytes, {size}"
        case Length(of=of):
            return "length of " + ", ".join(of)
        case Count(of=counted):
            return f"count of {counted}"
        case Value():
            return "derived"
    return None
