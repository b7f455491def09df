"""The compiler of Kaitai Struct (from npm) and its Python runtime: compile files, read frames, compare with framekit.

`needs_compiler` skips tests if the npm package `kaitai-struct-compiler` is not installed globally.
"""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest
import yaml
from kaitaistruct import KaitaiStream, KaitaiStruct, KaitaiStructError

from framekit.codec.stuffing import unstuff_cobs
from framekit.definition.codings import Cobs, Coding, Doubled, Escaped, Hex
from framekit.definition.model.frames import everything, flat
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Choose, Optional, Wrap
from framekit.extras.kaitai.generate import KaitaiFile, generate_kaitai
from framekit.extras.kaitai.source import identifier

COMPILE = """
const found = require('kaitai-struct-compiler');
const compiler = found.compile ? found : new found();
const specs = JSON.parse(require('fs').readFileSync(0));
Promise.all(specs.map(one => compiler.compile('python', one, null, false)
  .then(files => Object.values(files)[0], error => ({error: String(error)}))))
  .then(all => process.stdout.write(JSON.stringify(all)));
"""


@cache
def _modules() -> str | None:
    """Return the folder of npm's global packages, if it contains the compiler."""
    if shutil.which("npm") is None or shutil.which("node") is None:
        return None
    root = subprocess.run(["npm", "root", "-g"], capture_output=True, text=True, check=True).stdout.strip()
    return root if (Path(root) / "kaitai-struct-compiler").is_dir() else None


needs_compiler = pytest.mark.skipif(
    _modules() is None, reason="npm install -g kaitai-struct-compiler@0.11.0 brings the compiler"
)


def compiled(texts: Sequence[str]) -> list[Any]:
    """Return a compiled module for each file; assert that the compiler accepts all."""
    specs = json.dumps([yaml.safe_load(text) for text in texts])
    done = subprocess.run(
        ["node", "-e", COMPILE],
        input=specs,
        capture_output=True,
        text=True,
        check=True,
        env={"NODE_PATH": str(_modules()), "PATH": "/usr/bin:/bin:/usr/local/bin"},
    )
    modules = []
    for text, source in zip(texts, json.loads(done.stdout), strict=True):
        assert isinstance(source, str), f"{source}\n{text}"
        names: dict[str, Any] = {}
        exec(compile(source, "kaitai", "exec"), names)
        top = yaml.safe_load(text)["meta"]["id"]
        modules.append(names["".join(part.capitalize() for part in top.split("_"))])
    return modules


def class_name(type_: str) -> str:
    return "".join(part.capitalize() for part in type_.split("_"))


@dataclass
class Compared:
    """The result of a comparison: number of equal values, values left out of the Kaitai file, and differences."""

    frames: int = 0
    agreed: int = 0
    left_out: list[str] = field(default_factory=list)
    differences: list[str] = field(default_factory=list)


class Reader:
    """A protocol's exported file, compiled, with the definition it comes from."""

    def __init__(self, protocol: Protocol, file: KaitaiFile, top: Any) -> None:
        self.protocol, self.file, self.top = protocol, file, top
        frames = protocol.frames.values()
        wraps = [segment for frame in frames for segment in everything(frame.segments) if isinstance(segment, Wrap)]
        every = [
            segment
            for frame in frames
            for segment in flat(frame.segments)
            if isinstance(segment, (Wrap, Choose, Optional))
        ]
        every += wraps
        self.parts = ("choice", "optional", "content", *(identifier(segment.name) for segment in every if segment.name))
        """Prefixes of attributes whose values belong to the enclosing record."""
        self.codings = {wrap.coding.shown: wrap.coding for wrap in wraps}.values()

    def read(self, frame: str, data: bytes, context: Mapping[str, Any]) -> Any:
        """Return the Kaitai object of a frame. Raises the exceptions of the Kaitai runtime."""
        values = [context[name] for name in self.file.params[1:]]
        values = [int(value) if isinstance(value, bool) else value for value in values]
        kind = self.top.FrameKind[self.file.types[frame]]
        return self.top(kind, *values, KaitaiStream(BytesIO(data))).content

    def compare_frame(
        self, frame: str, data: bytes, context: Mapping[str, Any], fields: Mapping[str, Any], into: Compared
    ) -> None:  # fmt: skip
        """Compare the fields that framekit and Kaitai decode; Kaitai must fail for a frame that was left out."""
        path = f"{frame} {data.hex()}"
        try:
            found = self.read(frame, data, context)
        except (KaitaiStructError, EOFError, UnicodeDecodeError) as error:
            if self._is_told(frame, str(error)):
                into.left_out.append(path)
            else:
                into.differences.append(f"{path}: {type(error).__name__} {error}")
            return
        assert frame in self.file.frames
        into.frames += 1
        self.compare(found, fields, path, into)

    def _is_told(self, frame: str, error: str) -> bool:
        """Return whether the file reports the frame, or a frame inside it, as left out or indistinguishable."""
        if frame not in self.file.frames:
            return True
        inside = next((one for one, type_ in self.file.types.items() if f"/types/{type_}/" in error), None)
        messages = (problem.what for problem in self.file.left_out if "the first is read" in problem.what)
        names = {name.strip(",") for what in messages for name in what.split()}
        return inside is not None and (inside not in self.file.frames or inside in names)

    def compare(self, found: Any, fields: Mapping[str, Any], path: str, into: Compared) -> None:
        """Compare framekit's field values with the attributes of a Kaitai object."""
        for name, wanted in fields.items():
            here = f"{path}.{name}"
            holder = _holder(found, identifier(name), self.parts) or self._undone(found, identifier(name))
            if holder is None:
                into.left_out.append(here)
                continue
            self._value(getattr(holder, identifier(name)), wanted, here, into)

    def _undone(self, found: Any, name: str) -> Any:
        """Return the object of decoded content that has the value; the user of a Kaitai file must decode it, too."""
        for key, raw in vars(found).items():
            kind = getattr(type(found), class_name(f"{key}_plain"), None) if isinstance(raw, bytes) else None
            for coding in self.codings if kind is not None else ():
                try:
                    inner = kind(KaitaiStream(BytesIO(undo(coding, raw))), None, found._root)
                except (KaitaiStructError, EOFError, ValueError):
                    continue
                if _holder(inner, name, self.parts) is not None:
                    return _holder(inner, name, self.parts)
        return None

    def _value(self, found: Any, wanted: Any, path: str, into: Compared) -> None:
        if isinstance(wanted, Mapping) and isinstance(found, KaitaiStruct):
            inner = {class_name(type_): frame for frame, type_ in self.file.types.items()}.get(type(found).__name__)
            if inner is not None and [*wanted] == [inner]:
                wanted = wanted[inner]
            self.compare(found, wanted, path, into)
        elif isinstance(wanted, (list, tuple)) and isinstance(found, list):
            if len(found) != len(wanted):
                into.differences.append(f"{path}: {len(found)} items, not {len(wanted)}")
            for at, (one, other) in enumerate(zip(found, wanted, strict=False)):
                if isinstance(one, KaitaiStruct) and not isinstance(other, Mapping):
                    one = one.value if hasattr(type(one), "value") or hasattr(one, "value") else one.value_raw
                self._value(one, other, f"{path}[{at}]", into)
        elif _is_same(found, wanted):
            into.agreed += 1
        elif isinstance(found, (str, bytes)) and not isinstance(wanted, type(found)):
            into.left_out.append(path)  # text or bytes that Kaitai does not convert to a number
        else:
            into.differences.append(f"{path}: {found!r}, not {wanted!r}")


def undo(coding: Coding, raw: bytes) -> bytes:
    """Return the decoded content. Raises ValueError."""
    match coding:
        case Hex():
            return bytes.fromhex(raw.decode("ascii"))
        case Doubled(escape=escape):
            return raw.replace(bytes((escape, escape)), bytes((escape,)))
        case Escaped(escape=escape, codes=codes):
            pairs = {code: byte for byte, code in codes}
            parts = raw.split(bytes((escape,)))
            return parts[0] + b"".join(bytes((pairs[part[0]],)) + part[1:] for part in parts[1:])
        case Cobs():
            return unstuff_cobs(raw)
    raise ValueError(coding.shown)


def _is_same(found: Any, wanted: Any) -> bool:
    if isinstance(found, float) and not isinstance(wanted, (str, bytes)) and wanted is not None:
        return abs(found - float(wanted)) <= 1e-9 * max(1.0, abs(found)) or (found != found and wanted != wanted)
    return bool(found == wanted)


def _holder(found: Any, name: str, parts: tuple[str, ...]) -> Any:
    """Return the object that has a value: `found` itself, or an object of a case or part inside it."""
    if hasattr(type(found), name) or name in vars(found):
        return found
    for key, one in vars(found).items():
        if isinstance(one, KaitaiStruct) and not key.startswith("_"):
            inner = _holder(one, name, parts)
            if inner is not None and key.startswith(parts):
                return inner
    return None


def reader_of(protocol: Protocol) -> Reader:
    """Return the reader of one protocol."""
    return readers_of([protocol])[0]


def readers_of(protocols: Sequence[Protocol]) -> list[Reader]:
    """Return the readers of protocols, compiled together, since the compiler's start takes longer than a file."""
    files = [generate_kaitai(protocol) for protocol in protocols]
    tops = compiled([file.text for file in files])
    return [Reader(protocol, file, top) for protocol, file, top in zip(protocols, files, tops, strict=True)]
