"""Values of frames as people and JSON write them, where nothing is known of their fields."""

from __future__ import annotations

from collections.abc import Mapping
from opcode import opmap
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # what has been kept is decoded without the model
    from framekit.definition.model.protocol import Protocol


def shown(value: Any) -> Any:
    """JSON-ready values: bytes as upper-case hex pairs; exact decimals as numbers, or as text if these say not all."""
    if isinstance(value, (bytes, bytearray)):
        return value.hex(" ").upper()
    if isinstance(value, dict):
        return {name: shown(item) for name, item in value.items()}
    if isinstance(value, list):
        return [shown(item) for item in value]
    return _decimal(value) if type(value).__name__ == "Decimal" else value


def with_name(names: Mapping[str, Mapping[int, str]], path: str, value: Any) -> Any:
    """A number of a frame with the name that its field has for it, `2 (fast)`; any other value as it is."""
    name = names.get(path.rpartition(".")[2], {}).get(value) if type(value) is int else None
    return value if name is None else f"{value} ({name})"


def _decimal(value: Any) -> Any:
    """A number of JSON; text where that would say another number."""
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
    """What went wrong, in framekit's words: what the interpreter says by itself is not shown."""
    if isinstance(error, KeyError):
        name = error.args[0] if error.args else ""
        return name if isinstance(name, str) and " " in name else f"there is no '{name}'"
    text = str(error)
    if text and _is_worded(error):
        return text
    return next((words for kind, words in _WORDS.items() if isinstance(error, kind)), "it cannot be worked out")


def _is_worded(error: Exception) -> bool:
    """Whether a statement of framekit, or of a module made by it, has raised the error, and so worded it."""
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
    """`0x0002`, `0xF007`: as a word, which is what they are in status words; larger ones have more digits."""
    return f"0x{code:0{digits}X}" if code >= 0 else str(code)


def refusal_text(protocol: Protocol, code: int) -> str:
    """A refusal with its code in the protocol's way and what that means, where the protocol says it."""
    names = () if protocol.errors is None else protocol.errors.names
    ordered = sorted(names, key=lambda item: item.when is not None)  # which side it was does not show here
    tables = (protocol.tables[item.table].entries for item in ordered if item.table in protocol.tables)
    meaning = next((str(table[code]) for table in tables if code in table), "")
    return f"refused {code_text(code)}" + (f" {meaning}" if meaning else "")
