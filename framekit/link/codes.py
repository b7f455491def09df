"""Codes that devices answer with, and status words, as all messages write them: as definitions do, hexadecimal."""

from __future__ import annotations


def code_text(code: int, digits: int = 4) -> str:
    """`0x0002`, `0xF007`: as a word, which is what they are in status words; larger ones have more digits."""
    return f"0x{code:0{digits}X}" if code >= 0 else str(code)
