"""Initial files: the schemas for editors, and a package for a new protocol.

A schema is for one kind of file, or for all kinds, selected by their first key. Each is self-contained: definitions of
other shipped schemas are in its `$defs`. An installed package is found by framekit.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from string import Template
from typing import Any

from framekit.api.errors import RequestError
from framekit.definition.problems import did_you_mean
from framekit.definition.schema import FIRST_KEYS
from framekit.definition.sources import known_definitions, shipped_folder

DRAFT = "https://json-schema.org/draft/2020-12/schema"
_SUFFIX = ".schema.json"
_DEFINITIONS = "#/$defs/"

Schema = dict[str, Any]


def kinds() -> list[str]:
    """Return the names of the kinds of files."""
    return sorted(set(FIRST_KEYS.values()))


def schema(kind: str | None = None) -> Schema:
    """Return the schema of a kind of file; without one, that of all of them.

    Raises RequestError for an unknown kind.
    """
    if kind is not None and kind not in kinds():
        hint = did_you_mean(kind, kinds()) or f"known: {', '.join(kinds())}"
        raise RequestError(f"there is no kind of file '{kind}' – {hint}")
    definitions: Schema = {}
    names = [path.stem for path in known_definitions() if "." not in path.stem]
    for file in sorted(shipped_folder("schemas").glob(f"*{_SUFFIX}")):
        stem = file.name.removesuffix(_SUFFIX)
        whole = _moved(json.loads(file.read_text("utf-8")), stem)
        for place in _protocols_of(stem, whole):
            place["anyOf"] = [{"enum": names}, {"not": {"enum": names}}]
        for key in ("$schema", "$id"):
            whole.pop(key, None)
        definitions |= whole.pop("$defs", {})
        if stem in kinds():
            definitions[stem] = whole
    chosen = _chosen(definitions) if kind is None else {"$ref": _DEFINITIONS + kind}
    name = "framekit" if kind is None else definitions[kind]["title"]
    return {"$schema": DRAFT, "$id": f"framekit:{kind or 'any'}", "title": name, **chosen, "$defs": definitions}


def _protocols_of(stem: str, whole: Schema) -> list[Schema]:
    """Yield the places of a schema in which a known protocol may be named, so that an editor offers their names."""
    if stem == "run":
        return [whole["$defs"]["run.channel"]["properties"]["protocol"]]
    if stem == "device":
        return [whole["properties"]["protocol"]]
    return [whole["properties"][key] for key in ("extends", "application")] if stem == "protocol" else []


def settings_of_vscode(path: Path) -> Schema:
    """Return settings that apply the schema at a path to YAML files; files of other kinds are not affected."""
    place = str(path) if path.is_absolute() else f"./{path.as_posix()}"
    return {"yaml.schemas": {place: ["*.yaml", "*.yml"]}}


def _chosen(definitions: Schema) -> Schema:
    """Return the schema that selects the kind by the key with which only that kind begins."""
    rules = []
    for key, kind in FIRST_KEYS.items():
        others = [{"required": [other]} for other in FIRST_KEYS if _goes_before(other, key, definitions)]
        known: Schema = {"required": [key], **({"not": {"anyOf": others}} if others else {})}
        rules.append({"if": known, "then": {"$ref": _DEFINITIONS + kind}})
    return {"type": "object", "allOf": rules}


def _goes_before(other: str, key: str, definitions: Schema) -> bool:
    """Return whether a file with both keys is of the other key's kind: its schema contains this key too."""
    mine, named = FIRST_KEYS[key], FIRST_KEYS[other]
    return named != mine and key in definitions[named]["properties"] and other not in definitions[mine]["properties"]


def _moved(part: Any, stem: str) -> Any:
    """Return a schema with its definitions and references under names that are unique across files."""
    if isinstance(part, list):
        return [_moved(item, stem) for item in part]
    if not isinstance(part, dict):
        return part
    if "dependentSchemas" in part and "oneOf" in part:  # editors offer the keys of the alternatives
        part = {key: value for key, value in part.items() if key not in ("dependentSchemas", "oneOf", "type")} | {
            "anyOf": list(part["dependentSchemas"].values())
        }
    found: Schema = {}
    for key, value in part.items():
        if key == "$ref":
            file, _, name = value.partition(_DEFINITIONS)
            found[key] = f"{_DEFINITIONS}{file.removesuffix(_SUFFIX) or stem}.{name}"
        elif key == "$defs":
            found[key] = {f"{stem}.{name}": _moved(one, stem) for name, one in value.items()}
        else:
            found[key] = _moved(value, stem)
    return found


# ---- a package for a protocol ---------------------------------------------------------------------------------


TEMPLATES = Path(__file__).parent.parent / "templates"
_TEMPLATE = ".template"
_NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")
LONGEST_NAME = 40


def new_protocol(name: str, folder: Path) -> list[Path]:
    """Create a package for the protocol `name` in `folder`, which must be empty; return its files.

    They are a working definition (an example to replace), vectors, a simulated device, a test and a readme. Raises
    RequestError for an invalid name and for a folder in use; OSError.
    """
    check_new_name(name, "protocol")
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise RequestError(f"{folder} is there already, and nothing in it is written over – name another folder by -o")
    words = _words(name)
    source, written = TEMPLATES / "protocol", []
    for template in sorted(source.rglob(f"*{_TEMPLATE}")):
        place = str(template.relative_to(source)).removesuffix(_TEMPLATE)
        path = folder / place.replace("MODULE", words["module"]).replace("NAME", name)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(_filled(template, words), "utf-8")
        written.append(path)
    return written


def check_new_name(name: str, what: str) -> None:
    """Raise RequestError for a name that a new protocol or file cannot have."""
    if not _NAME.fullmatch(name) or len(name) > LONGEST_NAME:
        words = f"'{name}' cannot name a {what}: small letters, digits and single hyphens, a letter first"
        raise RequestError(f"{words}, {LONGEST_NAME} at most")


def _words(name: str) -> dict[str, str]:
    return {"name": name, "module": f"framekit_{name.replace('-', '_')}", "package": f"framekit-{name}"}


def _filled(template: Path, words: Mapping[str, str]) -> str:
    return Template(template.read_text("utf-8")).substitute(words)


# ---- a file ---------------------------------------------------------------------------------------------------


NEW_KINDS = {"protocol": ".yaml", "device": ".device.yaml", "run": ".run.yaml", "points": ".points.yaml"}
"""The kinds of files that have a template, each with the end of its file name."""


def new_text(kind: str, name: str, **words: str) -> str:
    """Return the text of a new file of a kind of NEW_KINDS; `words`: the values of its template.

    Raises RequestError for an invalid name.
    """
    check_new_name(name, kind)
    if kind == "protocol":
        return _filled(TEMPLATES / "protocol" / "MODULE" / f"NAME.yaml{_TEMPLATE}", _words(name))
    return _filled(TEMPLATES / "files" / f"{kind}.yaml{_TEMPLATE}", {"name": name, **words})
