"""The meaning of a text for the editor: its problems, its frames, and bytes read and built by them.

Functions of a work process: a path, values of a JSON message, an answer for the browser.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Mapping
from itertools import islice
from pathlib import Path
from typing import Any

from framekit.api.check import check_file
from framekit.api.monitor import field_rows
from framekit.api.rows import field_row
from framekit.codec.codec import Codec, compile_protocol
from framekit.codec.errors import EncodeError, FrameError
from framekit.codec.functions import candidates, likely, nearest
from framekit.codec.plain import PlainValues, with_hint
from framekit.codec.python.flat import inner_frames
from framekit.codec.samples import Sampler
from framekit.definition.load.protocol import load_protocol
from framekit.definition.model.protocol import Protocol
from framekit.definition.nodes import read_nodes
from framekit.definition.problems import DefinitionError, Problem, separately
from framekit.definition.schema import kind_of
from framekit.extras.documents.diagrams import sequence_states
from framekit.extras.documents.document import drawn_frames
from framekit.extras.web.edit_states import states_svg
from framekit.extras.web.edit_table import tables
from framekit.link.events import Seen
from framekit.link.scope import Scope
from framekit.runfile.devices import load_devices
from framekit.runfile.run_file import read_run

Answer = dict[str, Any]

MOST_FRAMES = 200
"""Largest number of frames that are drawn."""
MOST_SEQUENCES = 60
"""Largest number of sequences that are drawn."""
MOST_READINGS = 8
"""Largest number of frames shown for the same bytes."""
LONGEST_BYTES = 4096
"""Largest number of bytes that are decoded."""
MOST_ROWS = 500
"""Largest number of fields of a frame, and of values of a form."""


def look(path: Path) -> Answer:
    """Return the problems of a file, its tables and, if its protocols can be loaded, their frames and sequences."""
    checked = check_file(str(path))
    return {
        "what": checked.what,
        "kind": kind(path),
        "problems": [_problem(one, path) for one in separately(checked.problems)],
        "protocols": _drawn(path),
        "tables": tables(path),
    }


def kind(path: Path) -> str:
    """Return the kind of a file, '' if it cannot be known."""
    try:
        return kind_of(read_nodes(path, noted=[]))
    except DefinitionError:
        return ""


def _problem(problem: Problem, path: Path) -> list[Any]:
    """Return line, column, problem, remedy, whether it is a warning, and the name of another file that has it."""
    at = problem.at
    is_here = at.line > 0 and Path(at.file).resolve() == path.resolve()
    other = "" if is_here else Path(at.file).name if at.line else at.file
    return [at.line if is_here else 0, at.column, problem.what, problem.todo, problem.warning, other]


def protocols_of(path: Path) -> dict[str, Protocol]:
    """Return the protocols that a file defines or names, by name. Raise DefinitionError."""
    found: list[Protocol] = []
    match kind_of(read_nodes(path, noted=[])):
        case "protocol":
            found = [load_protocol(path)]
        case "device":
            found = [device.protocol for device in load_devices(path, path.parent)]
        case "run":
            found = [channel.protocol for channel in read_run(path).channels]
    return {protocol.name: protocol for protocol in found}


def _drawn(path: Path) -> list[Answer] | None:
    """Return the frames of the protocols of a file; None while one of them has errors."""
    try:
        protocols = protocols_of(path)
    except DefinitionError:
        return None
    return [_frames_of(protocol) for protocol in protocols.values()]


def _frames_of(protocol: Protocol) -> Answer:
    frames = [
        [drawn.name, drawn.about, [[box.name, box.below, box.size, box.shade, box.optional] for box in drawn.boxes]]
        for drawn in islice(drawn_frames(protocol), MOST_FRAMES)
    ]
    more = max(0, len(protocol.frames) - MOST_FRAMES)
    sequences = [
        [name, states_svg(f"The states of {name}", sequence_states(sequence))]
        for name, sequence in islice(protocol.sequences.items(), MOST_SEQUENCES)
    ]
    return {"name": protocol.name, "about": protocol.about, "frames": frames, "more": more, "sequences": sequences}


class _Protocol:
    """A protocol of a file with its codec. Raise DefinitionError, ValueError for a name that the file does not have."""

    def __init__(self, path: Path, name: str) -> None:
        protocols = protocols_of(path)
        if name not in protocols:
            raise ValueError(f"This file has no protocol '{name}'" if protocols else "This file has no frames")
        self.definition = protocols[name]
        self.codec: Codec = compile_protocol(self.definition)
        self.scope = Scope(self.definition)


# ---- bytes -------------------------------------------------------------------------------------------------


def decode(path: Path, protocol: str, data: str) -> Answer:
    """Return the frames that bytes in hex are, or the nearest frame with its innermost fault."""
    try:
        raw = bytes.fromhex(data)
    except ValueError:
        return {"why": "This is no hex: write pairs of 0 to 9 and A to F"}
    if not raw or len(raw) > LONGEST_BYTES:
        return {"why": f"From 1 to {LONGEST_BYTES} bytes are decoded"}
    try:
        known = _Protocol(path, protocol)
        return {"bytes": raw.hex(), "readings": list(islice(_readings(known, raw), MOST_READINGS))}
    except ValueError as error:
        return {"why": _reason(error)}


def _readings(known: _Protocol, raw: bytes) -> Iterator[Answer]:
    """Yield the readings of bytes: every frame that fits, or the nearest frame."""
    frames = known.definition.frames
    fits, faults = likely(known.codec, frames, raw, candidates(known.definition), known.scope)
    for fit in fits:
        yield _reading(known, raw, fit.frame, None)
    best = None if fits else nearest(faults)
    if best is not None:
        yield _reading(known, raw, *best)


def _reading(known: _Protocol, raw: bytes, frame: str, fault: FrameError | None) -> Answer:
    """Return frame, rows (path, offset, bytes, value as texts; offset, size), innermost fault, and notes.

    The fault: its words, its offset, and its segment. Without a fault of the frame it is that of unknown inner bytes.
    """
    notes = known.codec.frames[frame].diagnose(raw, known.scope).notes
    path, innermost = next(iter(notes.unknown), ("", None)) if fault is None else ("", fault)
    words = f"{path} is none of its frames; nearest: " if path else ""
    seen = Seen("in", "frame" if fault is None else "bad", 0, raw, frame)
    rows = field_rows(known.codec, known.definition, seen)[:MOST_ROWS]
    return {
        "frame": frame,
        "rows": [[*field_row(row), row.offset, len(row.data)] for row in rows],
        "fault": None if innermost is None else [words + _fault_words(innermost), innermost.offset, innermost.segment],
        "notes": list(notes.warnings),
    }


def _fault_words(fault: FrameError) -> str:
    """Return a fault in words without its offset."""
    facts = [fault.cause]
    facts += [f"expected {fault.expected}"] if fault.expected else []
    facts += [f"found {fault.found}"] if fault.found else []
    return f"{fault.segment}: {', '.join(facts)}"


def _reason(error: ValueError) -> str:
    """Return the reason of an error; of a definition, its first problem."""
    if isinstance(error, DefinitionError):
        return "Correct the definition first"
    return str(error)


# ---- forms -------------------------------------------------------------------------------------------------


def form(path: Path, protocol: str, frame: str, inside: str = "") -> Answer:
    """Return the values of a frame with samples: rows of a path and a text; and the frames that it may contain.

    `inside`: the inner frame.
    """
    try:
        known = _Protocol(path, protocol)
    except ValueError as error:
        return {"why": _reason(error)}
    frames = known.definition.frames
    if frame not in frames or (inside and inside not in frames):
        return {"why": f"There is no frame '{frame}'"}
    inner = inner_frames(frames[frame])
    sampler = Sampler(known.codec, known.scope)
    plain = PlainValues(known.definition)
    sample = next(iter(sampler.samples(frame, 1)), None)
    values = {} if sample is None else plain.to_plain(frame, sample.values)
    holder, chosen = _inner_of(values, inner)
    if holder and inside in inner and inside != chosen:
        other = next(iter(sampler.samples(inside, 1)), None)
        values[holder] = {inside: {} if other is None else plain.to_plain(inside, other.values)}
        chosen = inside
    rows = list(islice(_rows(values, ()), MOST_ROWS))
    return {"frame": frame, "inner": list(inner), "inside": chosen, "rows": rows}


def _inner_of(values: Mapping[str, Any], inner: Collection[str]) -> tuple[str, str]:
    """Return the name of the value that holds an inner frame, and that frame; '' for none."""
    for name, value in values.items():
        if isinstance(value, dict) and len(value) == 1 and next(iter(value)) in inner:
            return name, str(next(iter(value)))
    return "", ""


def _rows(value: Mapping[str, Any], above: tuple[str, ...]) -> Iterator[list[Any]]:
    """Yield the path and the text of every value; a list is a text in JSON."""
    for name, one in value.items():
        at = (*above, name)
        if isinstance(one, dict):
            yield from _rows(one, at)
        else:
            yield [list(at), json.dumps(one) if isinstance(one, list) else str(one)]


def build(path: Path, protocol: str, frame: str, rows: list[list[Any]]) -> Answer:
    """Return the bytes of a frame with values of a form; rows with empty texts are left out."""
    try:
        known = _Protocol(path, protocol)
        if frame not in known.definition.frames:
            raise ValueError(f"There is no frame '{frame}'")
        given = _nested(rows)
    except ValueError as error:
        return {"why": _reason(error)}
    try:
        fields = PlainValues(known.definition).from_plain(frame, given)
        data = known.codec.encode(frame, fields, known.scope)
    except EncodeError as error:
        return {"why": with_hint(error, known.definition, frame, given), "field": error.field}
    return {"built": data.hex(" ").upper()}


def _nested(rows: list[list[Any]]) -> dict[str, Any]:
    """Return the values of rows as nested mappings. Raise ValueError."""
    given: dict[str, Any] = {}
    for steps, text in rows:
        node = given
        for step in steps[:-1]:
            node = node.setdefault(step, {})
            if not isinstance(node, dict):
                raise ValueError(f"'{step}' has a value and parts")
        if text:
            node[steps[-1]] = json.loads(text) if text.startswith("[") else text
    return given
