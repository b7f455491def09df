"""Stored hashes of the frozen texts, one file per protocol and one line per case: read, write, compare."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from hashlib import sha256
from pathlib import Path

from golden.frozen import Case

FOLDER = Path(__file__).parent / "kept"


def hash_of(case: Case) -> str:
    """Return the hash of the case's text, or '' if the text is empty."""
    text = case.make()
    return sha256(text.encode()).hexdigest()[:12] if text else ""


def read(name: str) -> dict[str, str]:
    """Return the stored hashes by case name.

    A name with two different hashes, after a merge, has the hash `unknown`.
    """
    file, found = FOLDER / f"{name}.txt", dict[str, str]()
    for line in file.read_text(encoding="utf-8").splitlines() if file.exists() else ():
        hash_, _, case = line.partition(" ")
        found[case] = hash_ if found.get(case, hash_) == hash_ else "unknown"
    return found


def write(name: str, hashes: Mapping[str, str]) -> None:
    FOLDER.mkdir(exist_ok=True)
    lines = "".join(f"{hash_} {case}\n" for case, hash_ in hashes.items() if hash_)
    (FOLDER / f"{name}.txt").write_text(lines, encoding="utf-8")


def differences(name: str, cases: Iterable[Case]) -> list[str]:
    """Return the names of cases whose text differs from the stored hash."""
    kept = read(name)
    return [case.name for case in cases if hash_of(case) != kept.get(case.name, "")]
