"""Kinds of segments defined outside framekit may be used at any place of a segment."""

from __future__ import annotations

import importlib
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import pytest

from framekit.codec.codec import compile_protocol
from framekit.codec.errors import FrameError
from framekit.codec.kinds import SegmentKind, register
from framekit.codec.python import forms
from framekit.codec.python import module as generated
from framekit.codec.python.encode_plan import PackArgument, Task
from framekit.codec.python.expressions import NameEntry
from framekit.codec.python.reader import Slot
from framekit.codec.python.registry import KINDS as CODES
from framekit.codec.samples import Sampler
from framekit.definition import brought, schema
from framekit.definition.keys import IDENTIFIER, key
from framekit.definition.kinds.base import KINDS
from framekit.definition.load.protocol import load_protocol_text
from framekit.definition.model.segments import Segment, Sizes, exactly

PAGE = Path(__file__).parents[2] / "docs" / "extending.md"


@dataclass(frozen=True, slots=True, kw_only=True)
class Nine(Segment):
    """A little-endian number of two bytes, packed and unpacked in one struct with its neighbours."""

    KEY: ClassVar[str] = "nine"
    name: str = key("nine", IDENTIFIER, "Name of the number.")

    @property
    def value_names(self) -> tuple[str, ...]:
        return (self.name,)

    @property
    def wanted_names(self) -> tuple[str, ...]:
        return (self.name,)

    def sizes(self, of_frame: Any) -> Sizes:
        return exactly(2)


class NineKind(SegmentKind[Nine]):
    model = Nine

    def struct_order(self, segment: Nine) -> str:
        return "<"

    def slot(self, r: Any, item: Any, segment: Nine, size: int) -> Slot:
        return Slot(item, size, "H", "<", r.function.local(segment.name, item.scope))

    def unpacked(self, r: Any, slot: Slot, segment: Nine, source: str, converted: bool) -> None:
        r.assign(slot.text, source)
        r.declare(slot.item, segment.name, slot.text, sized=False)

    def tasks(self, w: Any, segment: Nine, scope: Any, given: Any) -> list[Task]:
        def put(_: Any) -> None:
            local = w.local(segment.name, given)
            w.bind(local, given.value(segment.name) if segment.when is None else w.wanted(segment.name, given))
            w.refuse(segment, scope, f"not 0 <= {local} < 0x10000")
            scope.entries[segment.name] = NameEntry(local, sized=False)

        return [Task((segment.name,), w.waits(segment.when), put)]

    def argument(self, w: Any, segment: Nine, scope: Any, size: int) -> PackArgument:
        return PackArgument("H", "<", scope.entries[segment.name].text)

    def bytes_text(self, w: Any, segment: Nine, scope: Any) -> str:
        return f'({scope.entries[segment.name].text}).to_bytes(2, "little")'

    def room_waits(self, w: Any, segment: Nine) -> set[str]:
        return set()

    def rules(self, w: Any, segment: Nine, always: bool, lengths: Any) -> Any:
        yield segment.name, w.rule("number", forms.Range(0, 0xFFFF), always)

    def declare(self, d: Any, segment: Nine, scope: Any) -> None:
        scope.entries[segment.name] = NameEntry(f"n[{segment.name!r}]", sized=False)

    def diagnose(self, d: Any, segment: Nine, scope: Any, behind: Any) -> None:
        d.out.add(f'n.field({d.named(segment)}, 2, lambda raw: int.from_bytes(raw, "little"))')

    def sample(self, random: Any, segment: Nine) -> dict[str, int]:
        return {segment.name: random.randrange(300)}


@pytest.fixture(scope="module")
def outside(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Register the kind of the page and the kind above; restore all registries afterwards."""
    folder = tmp_path_factory.mktemp("outside")
    block = re.search(r"^```python\n# file: varint.py\n(.*?)^```$", PAGE.read_text("utf-8"), re.MULTILINE | re.DOTALL)
    assert block is not None
    (folder / "varint.py").write_text(block[1])
    kept = dict(KINDS), dict(CODES), list(generated._INLINED), list(brought.MODULES)
    sys.path.insert(0, str(folder))
    importlib.import_module("varint")
    register(NineKind)
    yield
    sys.path.remove(str(folder))
    del sys.modules["varint"]
    for place, before in zip((KINDS, CODES), kept[:2], strict=True):
        place.clear()
        place.update(before)  # type: ignore[arg-type]
    generated._INLINED[:], brought.MODULES[:] = kept[2:]
    for made in (
        schema._schemas,
        schema._validator,
        schema._known_keys,
        generated.inlined_names,
        generated._names_of_added,
    ):
        made.cache_clear()


TOP = "layouts: {pair: [{varint: low}, {nine: high}]}"
BODIES = {
    "bare": "[{const: 7E}, {nine: a}, {varint: v}, {field: b, type: u16}]",
    "run": "[{field: a, type: u16, order: little}, {nine: n}, {const: 0D}]",
    "size": "[{varint: v, most: 2}, {data: d, size: v}, {check: sum8}]",
    "length": "[{length: l, type: u8, of: [v, n]}, {varint: v}, {nine: n}]",
    "when": "[{field: k, type: u8, range: 0..1}, {varint: v, when: k}, {nine: n, when: k}, {const: 0D}]",
    "choose": "[{field: k, type: u8, range: 0..1}, {choose: k, cases: {0: [{varint: v}], 1: [{nine: n}]}}]",
    "optional": "[{nine: n}, {optional: [{varint: v}]}]",
    "repeat": "[{count: c, type: u8, of: r}, {repeat: r, times: c, of: [{varint: v}, {nine: n}]}]",
    "record": "[{include: pair, as: p}, {field: z, type: u8}]",
    "wrap": "[{const: 3A}, {wrap: hex, of: [{nine: n}, {varint: v}]}, {const: 0D 0A}]",
    "escape": "[{const: 10 02}, {wrap: {escape: 10}, of: [{varint: v}, {nine: n}]}, {const: 10 03}]",
    "read": "[{nine: n}, {value: twice, read: n * 2}, {require: n < 400}, {varint: v}]",
}


@pytest.mark.parametrize("body", BODIES.values(), ids=BODIES)
def test_it_stands_wherever_segments_stand(outside: None, body: str) -> None:
    protocol = load_protocol_text(f"protocol: outside\n{TOP}\nframes:\n  one: {{body: {body}}}\n")
    codec = compile_protocol(protocol)
    samples = Sampler(codec, {}).samples("one", count=6)
    assert len(samples) > 2
    for sample in samples:
        size = len(sample.data)
        assert codec.encode("one", sample.read, {}) == sample.data, "what was read builds the same again"
        if body == BODIES["optional"]:
            continue  # it ends wherever there are no more bytes
        assert codec.measure("one", sample.data + b"\xff", 0, size, {}) == size
        for end in range(size):
            wanted = codec.measure("one", sample.data, 0, end, {})
            assert end - size <= wanted < 0, "some more bytes are wanted, and no more than there are"
            with pytest.raises(FrameError):
                codec.decode("one", sample.data[:end], {})
