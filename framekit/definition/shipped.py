"""Where the definitions and schemas that come with framekit stand, installed or in a working copy.

What is in those folders is not known here.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal


def shipped_folder(name: Literal["frames", "schemas"]) -> Path:
    """The folder of shipped definitions or schemas: inside the installed package, else beside the package."""
    package = Path(__file__).parent.parent
    installed = package / "_shipped" / name
    return installed if installed.is_dir() else package.parent / name
