"""The files that a protocol of one's own begins with: a package that framekit finds when it is installed."""

from __future__ import annotations

import re
from pathlib import Path
from string import Template

from framekit.api.errors import RequestError

TEMPLATES = Path(__file__).parent.parent / "templates"
_SUFFIX = ".template"
_NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")
LONGEST_NAME = 40


def new_protocol(name: str, folder: Path) -> list[Path]:
    """Lays a package for the protocol `name` out in `folder`, which must not hold anything; the files in it.

    They are a definition that runs (an example to write over), vectors, a simulated device, a test and a readme.
    Raises RequestError for a name that cannot be one and for a folder that is in use; OSError.
    """
    if not _NAME.fullmatch(name) or len(name) > LONGEST_NAME:
        what = f"'{name}' cannot name a protocol: small letters, digits and single hyphens, a letter first"
        raise RequestError(f"{what}, {LONGEST_NAME} at most")
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise RequestError(f"{folder} is there already, and nothing in it is written over – name another folder by -o")
    module = f"framekit_{name.replace('-', '_')}"
    words = {"name": name, "module": module, "package": f"framekit-{name}"}
    source, written = TEMPLATES / "protocol", []
    for template in sorted(source.rglob(f"*{_SUFFIX}")):
        place = str(template.relative_to(source)).removesuffix(_SUFFIX)
        path = folder / place.replace("MODULE", module).replace("NAME", name)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(Template(template.read_text("utf-8")).substitute(words), "utf-8")
        written.append(path)
    return written
