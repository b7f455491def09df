"""Where the shipped definitions and schemas stand."""
# interim version by the lead; the owner of this file replaces it

from __future__ import annotations

from pathlib import Path


def shipped_folder(name: str) -> Path:
    package = Path(__file__).parent.parent
    installed = package / "_shipped" / name
    return installed if installed.is_dir() else package.parent / name
