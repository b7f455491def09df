"""Compare imported Kaitai Struct files with Kaitai itself, and with the definitions that exported files come from."""

from __future__ import annotations

import enum
import random
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any

from extras.kaitai.kaitai_world import Compared, compiled
from kaitaistruct import KaitaiStream, KaitaiStruct, KaitaiStructError
from strategies import base_context

from framekit.codec.codec import Codec, compile_protocol
from framekit.codec.samples import Sampler
from framekit.definition.codings import Plain
from framekit.definition.imported import ImportedDefinition
from framekit.definition.load.protocol import load_protocol
from framekit.definition.model.frames import everything
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Choose, Optional, Wrap
from framekit.definition.problems import DefinitionError
from framekit.extras.kaitai.generate import generate_kaitai
from framekit.extras.kaitai.importing import import_kaitai
from framekit.extras.kaitai.source import identifier

KSY = Path(__file__).parent / "ksy"
LIKELY = (0, 1, 2, 3, 4, 5, 7, 8, 0x2C, 0x3B, 0xFF)
FAILS = (KaitaiStructError, EOFError, ValueError, ZeroDivisionError, IndexError, TypeError, AttributeError)
"""Exceptions of Kaitai's Python for bytes that it cannot read."""


def loaded(made: ImportedDefinition, folder: Path) -> Codec:
    """Return the codec of an imported definition."""
    path = folder / "made.yaml"
    path.write_text(made.text, "utf-8")
    return compile_protocol(load_protocol(path))


def plain(value: Any) -> Any:
    """Return the values of a Kaitai object as plain data; instances that refer to absent attributes are left out."""
    if isinstance(value, KaitaiStruct):
        names = [name for name in vars(value) if not name.startswith("_")]
        names += [name for name, one in vars(type(value)).items() if isinstance(one, property)]
        found = {}
        for name in names:
            try:
                one = getattr(value, name)
            except AttributeError as error:
                if "object has no attribute" not in str(error):
                    raise
                continue
            if one is not None:
                found[name] = plain(one)
        return found
    if isinstance(value, list):
        return [plain(item) for item in value]
    return value.value if isinstance(value, enum.Enum) else value


def difference(kaitai: Any, ours: Any, path: str, without: Sequence[str]) -> str:
    """Return the first difference, or ''. `without`: constants and parameters, which are not values in framekit."""
    if isinstance(kaitai, dict) and isinstance(ours, dict):
        for name, one in kaitai.items():
            if name in ours:
                if found := difference(one, ours[name], f"{path}.{name}", without):
                    return found
            elif name not in without and one != {}:
                return f"{path}.{name} is not there, but {one!r}"
        left = [name for name, one in ours.items() if name not in kaitai and one is not None]
        return next((f"{path}.{name} is there" for name in left if not name.endswith("rest")), "")
    if isinstance(kaitai, list) and isinstance(ours, list):
        if len(kaitai) != len(ours):
            return f"{path}: {len(ours)} items, not {len(kaitai)}"
        for place, (one, other) in enumerate(zip(kaitai, ours, strict=True)):
            if (
                isinstance(other, dict)
                and [*other] == ["value"]
                and not (isinstance(one, dict) and [*one] == ["value"])
            ):
                other = other["value"]
            if found := difference(one, other, f"{path}[{place}]", without):
                return found
        return ""
    if isinstance(kaitai, float) and kaitai != kaitai and ours != ours:
        return ""
    same = kaitai == ours and isinstance(kaitai, (str, bytes)) == isinstance(ours, (str, bytes))
    return "" if same else f"{path}: {ours!r}, not {kaitai!r}"


@dataclass
class Trial:
    """Number of frames that both read alike, and that both refuse, and differences."""

    both: int = 0
    refused: int = 0
    differences: list[str] = field(default_factory=list)


@cache
def compiled_files() -> dict[str, Any]:
    """Return the classes of all files of `ksy/`, by name; one start of the compiler for all."""
    files = sorted(KSY.glob("*.ksy"))
    tops = compiled([path.read_text("utf-8") for path in files])
    return {path.stem: top for path, top in zip(files, tops, strict=True)}


@dataclass
class Description:
    """A file of `ksy/`: arguments of its top type, the corresponding frame, and the parameters of the frame.

    `seed`: a frame in hex, if no frame can be built from drawn values.
    """

    name: str
    frame: str
    without: tuple[str, ...] = ()
    arguments: tuple[tuple[str, str] | int | bool, ...] = ()
    context: Mapping[str, Any] = field(default_factory=dict)
    seed: str = ""

    def trial(self, folder: Path, count: int) -> Trial:
        path = KSY / f"{self.name}.ksy"
        text = path.read_text("utf-8")
        top = compiled_files()[self.name]
        codec = loaded(import_kaitai(text, str(path), self.name), folder)
        context = base_context(codec.protocol) | dict(self.context)
        given = [
            getattr(getattr(top, argument[0]), argument[1]) if isinstance(argument, tuple) else argument
            for argument in self.arguments
        ]
        found = Trial()
        samples = [sample.data for sample in Sampler(codec, context).samples(self.frame, 40, 400)]
        for data in mutated([*samples, *([bytes.fromhex(self.seed)] if self.seed else [])], count):
            stream = KaitaiStream(BytesIO(data))
            try:
                kaitai: Any = plain(top(*given, stream))
                kaitai = kaitai["content"] if given else kaitai
                if stream.pos() < len(data):  # a frame is the whole stream
                    kaitai = None
            except FAILS:
                kaitai = None
            try:
                ours: Any = codec.frames[self.frame].decode(data, context)
            except ValueError:
                ours = None
            if kaitai is None and ours is None:
                found.refused += 1
            elif kaitai is None or ours is None:
                found.differences.append(f"{data.hex(' ')}: Kaitai {kaitai}, framekit {ours}")
            elif found_difference := difference(kaitai, ours, "", self.without):
                found.differences.append(f"{data.hex(' ')}: {found_difference}")
            else:
                found.both += 1
        return found


def mutated(samples: list[bytes], count: int) -> Iterator[bytes]:
    """Yield the samples, mutated samples, and random bytes."""
    draw = random.Random(1)
    yield from samples
    for _ in range(count):
        data = bytearray(draw.choice(samples))
        for _ in range(draw.randint(0, 3)):
            way, byte = draw.random(), draw.choice((*LIKELY, draw.randrange(256)))
            if data and way < 0.7:
                data[draw.randrange(len(data))] = byte
            elif data and way < 0.85:
                del data[draw.randrange(len(data))]
            else:
                data.insert(draw.randint(0, len(data)), byte)
        if draw.random() < 0.1:
            data = bytearray(draw.choice((*LIKELY, draw.randrange(256))) for _ in range(draw.randrange(40)))
        yield bytes(data)


# ---- exported and imported --------------------------------------------------------------------------------------


@dataclass
class RoundTrip:
    """Number of exported frames, names of imported frames, and the comparison of their values."""

    exported: int
    imported: list[str]
    compared: Compared
    refused: list[str]


def round_trip(name: str, folder: Path, samples: int = 8) -> RoundTrip:
    """Export and import a shipped definition, and read its samples with both."""
    protocol = load_protocol(name)
    file = generate_kaitai(protocol)
    found, refused = Compared(), []
    try:
        made = import_kaitai(file.text, f"{file.name}.ksy", file.name)
    except DefinitionError:
        return RoundTrip(len(file.frames), [], found, [])
    codec, ours = compile_protocol(protocol), loaded(made, folder)
    context = base_context(protocol)
    known = base_context(ours.protocol)
    for one, value in context.items():
        for own in (identifier(one), f"{identifier(one)}_"):
            if own in ours.protocol.params:
                known[own] = value
    sampler, parts, coded = Sampler(codec, context), parts_of(protocol), coded_names(protocol)
    imported = [frame for frame in file.frames if file.types[frame] in ours.frames]
    for frame in imported:
        for sample in sampler.samples(frame, samples):
            path = f"{frame} {sample.data.hex(' ')}"
            try:
                values = ours.frames[file.types[frame]].decode(sample.data, known)
            except ValueError as error:
                refused.append(f"{path}: {error}")
                continue
            found.frames += 1
            found.left_out += [f"{path}.{name}" for name in sample.read if name in coded[frame]]
            compare(values, {n: v for n, v in sample.read.items() if n not in coded[frame]}, path, parts, found)
    return RoundTrip(len(file.frames), imported, found, refused)


def parts_of(protocol: Protocol) -> tuple[str, ...]:
    """Return the prefixes of records of an exported file whose values belong to the enclosing record."""
    every = [segment for frame in protocol.frames.values() for segment in everything(frame.segments)]
    named = [segment.name for segment in every if isinstance(segment, (Wrap, Choose, Optional)) and segment.name]
    return ("choice", "optional", "content", *map(identifier, named))


def coded_names(protocol: Protocol) -> dict[str, set[str]]:
    """Return the values of each frame in encoded content, which Kaitai does not decode."""
    found: dict[str, set[str]] = {}
    for frame in protocol.frames.values():
        wraps = (
            segment
            for segment in everything(frame.segments)
            if isinstance(segment, Wrap) and not isinstance(segment.coding, Plain)
        )
        found[frame.name] = {name for wrap in wraps for segment in everything(wrap.of) for name in segment.value_names}
    return found


def compare(
    found: Mapping[str, Any], fields: Mapping[str, Any], path: str, parts: tuple[str, ...], into: Compared
) -> None:
    """Compare the field values of a definition with those of its re-imported copy."""
    for name, wanted in fields.items():
        here = f"{path}.{name}"
        holder = _holder(found, identifier(name), parts)
        if holder is None:
            into.left_out.append(here)
        else:
            _value(holder[identifier(name)], wanted, here, parts, into)


def _value(found: Any, wanted: Any, path: str, parts: tuple[str, ...], into: Compared) -> None:
    if isinstance(wanted, Mapping) and isinstance(found, Mapping):
        compare(found, wanted, path, parts, into)
    elif isinstance(wanted, (list, tuple)) and isinstance(found, list):
        if len(found) != len(wanted):
            into.differences.append(f"{path}: {len(found)} items, not {len(wanted)}")
        for place, (one, other) in enumerate(zip(found, wanted, strict=False)):
            one = one["value"] if isinstance(one, Mapping) and not isinstance(other, Mapping) else one
            _value(one, other, f"{path}[{place}]", parts, into)
    elif found == wanted or (found != found and wanted != wanted):
        into.agreed += 1
    elif isinstance(found, (str, bytes)) and not isinstance(wanted, type(found)):
        into.left_out.append(path)  # text or bytes that Kaitai does not convert to a number
    else:
        into.differences.append(f"{path}: {found!r}, not {wanted!r}")


def _holder(found: Mapping[str, Any], name: str, parts: tuple[str, ...]) -> Mapping[str, Any] | None:
    if name in found:
        return found
    for key, one in found.items():
        if isinstance(one, Mapping) and key.startswith(parts) and (inner := _holder(one, name, parts)) is not None:
            return inner
    return None
