"""Check segments: `check: METHOD, over: …, as: …`."""

from __future__ import annotations

from collections.abc import Mapping as MappingOf
from typing import Any, Literal, TypeVar

from framekit.definition.load.namespace import Namespace
from framekit.definition.load.reader import Reader
from framekit.definition.model.checks import CheckMethod
from framekit.definition.model.segments import Check
from framekit.definition.nodes import Mapping, Node, Sequence

T = TypeVar("T")
Form = Literal["raw", "hex", "HEX", "dec", "nibbles"]
FORMS: dict[str, Form] = {"raw": "raw", "hex": "HEX", "HEX": "HEX", "dec": "dec", "nibbles": "nibbles"}
VERIFY: dict[str, Literal["error", "warn", "off"]] = {"error": "error", "warn": "warn", "off": "off"}


def load_check_segment(space: Namespace, keys: Mapping, common: dict[str, Any]) -> Check:
    """Raises Broken. `hex` digits are upper-case unless `case: lower`."""
    reader = space.reader
    node = keys.get("check")
    assert node is not None
    method = space.check(node)
    form = _word(reader, keys.get("as"), FORMS, "a form of a check code") or "raw"
    if form == "HEX" and reader.maybe(reader.text, keys.get("case")) == "lower":
        form = "hex"
    over, span = _range(reader, keys.get("over"))
    order = reader.maybe(reader.text, keys.get("order")) or "big"
    size = keys.get("size")
    return Check(
        method=method,
        over=over,
        span=span,
        form=form,
        order="little" if order == "little" else "big",
        size=_size(method, form) if size is None else reader.number(size),
        verify=_word(reader, keys.get("verify"), VERIFY, "a way to verify") or "error",
        **common,
    )


def _word(reader: Reader, node: Node | None, words: MappingOf[str, T], kind: str) -> T | None:
    return None if node is None else reader.one_of(node, words, kind)


def _range(reader: Reader, node: Node | None) -> tuple[tuple[str, ...] | None, tuple[str, str] | None]:
    if node is None:
        return None, None
    if isinstance(node, Sequence):
        return reader.texts(node), None
    text = reader.text(node)
    first, dots, last = text.partition("..")
    if not dots:
        return (text,), None
    return None, (first.strip(), last.strip())


def _size(method: CheckMethod, form: Form) -> int:
    """Bytes on the wire of a check code."""
    if form == "dec":
        return len(str((1 << method.width) - 1))
    return method.size * (1 if form == "raw" else 2)
