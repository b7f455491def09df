"""Format values of frames for people and JSON without the model of their fields."""

from __future__ import annotations

from collections.abc import Mapping
from opcode import opmap
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # kept values are decoded without the model
    from framekit.definition.model.protocol import Protocol


def shown(value: Any) -> Any:
    """Return a JSON-ready value: bytes as upper-case hex pairs, exact decimals as numbers.

    A decimal that a float would round is returned as text.
    """
    if isinstance(value, (bytes, bytearray)):
        return value.hex(" ").upper()
    if isinstance(value, dict):
        return {name: shown(item) for name, item in value.items()}
    if isinstance(value, list):
        return [shown(item) for item in value]
    return _decimal(value) if type(value).__name__ == "Decimal" else value


def with_name(names: Mapping[str, Mapping[int, str]], path: str, value: Any) -> Any:
    """Return a number together with its name in its field, `2 (fast)`; any other value unchanged."""
    name = names.get(path.rpartition(".")[2], {}).get(value) if type(value) is int else None
    return value if name is None else f"{value} ({name})"


def with_names(names: Mapping[str, Mapping[int, str]], path: str, value: Any) -> Any:
    """Return a value of records and lists in which each number has its name; `path` ends in the name of the value."""
    if isinstance(value, dict):
        return {name: with_names(names, name, item) for name, item in value.items()}
    if isinstance(value, list):
        return [with_names(names, path, item) for item in value]
    return with_name(names, path, value)


def _decimal(value: Any) -> Any:
    """Return a decimal as a JSON number, or as text if the float is not exactly equal."""
    number = float(value)
    return number if type(value)(repr(number)) == value else str(value)


_OURS = str(Path(__file__).parent.parent)
_RAISE = opmap["RAISE_VARARGS"]
_WORDS: dict[type[Exception], str] = {
    ZeroDivisionError: "something is divided by 0",
    ArithmeticError: "a number is too large",
    IndexError: "there is no such item",
    TypeError: "a value is not there, or is of another kind than is needed",
    AttributeError: "a value is not there, or is of another kind than is needed",
    ValueError: "a value does not fit",
}


def explain(error: Exception) -> str:
    """Return the cause of an error in framekit's words; messages of the interpreter are replaced."""
    if isinstance(error, KeyError):
        name = error.args[0] if error.args else ""
        return name if isinstance(name, str) and " " in name else f"there is no '{name}'"
    text = str(error)
    if text and _is_worded(error):
        return text
    return next((words for kind, words in _WORDS.items() if isinstance(error, kind)), "it cannot be worked out")


def _is_worded(error: Exception) -> bool:
    """Return whether framekit or a generated module raised the error, so that its message is framekit's."""
    if type(error).__module__.startswith("framekit"):
        return True
    place = error.__traceback__
    while place is not None and place.tb_next is not None:
        place = place.tb_next
    if place is None:
        return True
    code = place.tb_frame.f_code
    is_ours = code.co_filename.startswith((_OURS, "<"))
    return is_ours and code.co_code[place.tb_lasti] == _RAISE


def code_text(code: int, digits: int = 4) -> str:
    """Return a code in hexadecimal with at least `digits` digits: `0x0002`, `0xF007`; a negative code in decimal."""
    return f"0x{code:0{digits}X}" if code >= 0 else str(code)


def refusal_text(protocol: Protocol, code: int) -> str:
    """Return the text of a refusal: its code, and the meaning of the code if the protocol has a table of its errors."""
    names = () if protocol.errors is None else protocol.errors.names
    ordered = sorted(names, key=lambda item: item.when is not None)  # the side of the error is unknown here
    tables = (protocol.tables[item.table].entries for item in ordered if item.table in protocol.tables)
    meaning = next((str(table[code]) for table in tables if code in table), "")
    return f"refused {code_text(code)}" + (f" {meaning}" if meaning else "")
