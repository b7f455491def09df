"""Writing YAML: mappings, lists and scalars as text that reads back as the same values.

Every ambiguous text is written in double quotes, character by character, so that text of another file stays text.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

WIDEST = 118
"""Width of a line with a whole mapping (characters)."""
_PLAIN = re.compile(r"[A-Za-z_][A-Za-z0-9_()]*([ .-][A-Za-z0-9_()]+)*|[0-9]+ [a-z]+|[0-9A-F]{2}( [0-9A-F]{2})+")
"""Words, times such as 50 ms, and several bytes in hex digits."""
_NO_TEXT = frozenset({"true", "false", "yes", "no", "on", "off", "null", "none", "y", "n", "nan", "inf"})


def scalar(value: Any) -> str:
    """Return a scalar: numbers and flags plain, texts plain if unambiguous."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, float)):
        return repr(value)
    text = str(value)
    if _PLAIN.fullmatch(text) and text.lower() not in _NO_TEXT:
        return text
    return "".join(map(_sign, json.dumps(text, ensure_ascii=False)))


def _sign(sign: str) -> str:
    if sign.isprintable():
        return sign
    return f"\\u{ord(sign):04x}" if ord(sign) < 0x1_0000 else f"\\U{ord(sign):08x}"


def comment(text: str) -> str:
    """Return a comment of any text, on one line."""
    return "# " + "".join(sign if sign.isprintable() else " " for sign in text)


def flow(value: Any) -> str:
    """Return a value on one line."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{scalar(key)}: {flow(one)}" for key, one in value.items()) + "}"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "[" + ", ".join(map(flow, value)) + "]"
    return scalar(value)


def yaml_lines(value: Mapping[Any, Any], indent: int = 0, *, compact: bool = False) -> Iterator[str]:
    """Yield the lines of a mapping.

    `compact`: items of lists that fit and hold only scalars are on one line.
    """
    room = " " * indent
    for key, one in value.items():
        yield from _entry(f"{room}{scalar(key)}:", one, indent, compact)


def _entry(head: str, value: Any, indent: int, compact: bool) -> Iterator[str]:
    if isinstance(value, Mapping) and value:
        if compact and _is_flat(value) and len(whole := f"{head} {flow(value)}") <= WIDEST:
            yield whole
        else:
            yield head
            yield from yaml_lines(value, indent + 2, compact=compact)
    elif isinstance(value, Sequence) and not isinstance(value, str) and any(isinstance(one, Mapping) for one in value):
        yield head
        for item in value:
            yield from _item(item, indent + 2, compact)
    else:
        yield f"{head} {flow(value)}"


def _item(item: Any, indent: int, compact: bool) -> Iterator[str]:
    if not isinstance(item, Mapping) or (compact and _is_flat(item)):
        whole = f"{' ' * indent}- {flow(item)}"
        if not isinstance(item, Mapping) or len(whole) <= WIDEST:
            yield whole
            return
    lines = list(yaml_lines(item, indent + 2, compact=compact))
    yield f"{' ' * indent}- {lines[0][indent + 2 :]}"
    yield from lines[1:]


def _is_flat(value: Mapping[Any, Any]) -> bool:
    def plain(one: Any) -> bool:
        if isinstance(one, Mapping):
            return all(not isinstance(part, (Mapping, list, tuple)) for part in one.values())
        return not isinstance(one, (list, tuple)) or all(not isinstance(part, (Mapping, list)) for part in one)

    return all(map(plain, value.values()))
