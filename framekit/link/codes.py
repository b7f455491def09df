"""Codes that devices answer with, and status words, as all messages write them: as definitions do, hexadecimal."""

from __future__ import annotations

from framekit.definition.model.protocol import Protocol


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
