"""Compare the stored texts with the texts that the code makes now, and show the differences.

    python -m tests.golden [PROTOCOL …]            lists the cases that differ
    python -m tests.golden --write [PROTOCOL …]    stores the texts that the code makes now
    python -m tests.golden --diff REVISION [PROTOCOL …]   shows the texts that differ from those of a commit
    python -m tests.golden --dump FOLDER [PROTOCOL …]     writes all texts into a folder
    python -m tests.golden --frames                draws sample frames where they are missing

`--only damage` (or source, stream, capture, conversation, message, or a prefix of a case's name) selects cases.
"""

from __future__ import annotations

import argparse
import difflib
import os
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent)]

from golden import kept  # noqa: E402
from golden.frozen import KEPT_FRAMES, NAMES, Case, Shipped, cases  # noqa: E402

MOST_LINES = 60
"""Number of changed lines that are shown of a text."""


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.golden", description=__doc__.splitlines()[0])
    parser.add_argument("protocols", nargs="*", metavar="PROTOCOL", help="all shipped ones if none is named")
    parser.add_argument("--only", default="", metavar="CASES", help="cases whose name begins so")
    parser.add_argument("--all-lines", action="store_true", help="--diff: show long differences whole")
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--write", action="store_true", help="keep what the code makes now")
    what.add_argument("--dump", metavar="FOLDER", help="write all texts into a folder")
    what.add_argument("--diff", metavar="REVISION", help="show the texts that differ from those of a commit")
    what.add_argument("--frames", action="store_true", help="draw sample frames for frames that have none")
    options = parser.parse_args()
    names = options.protocols or NAMES
    if wrong := [name for name in names if name not in NAMES]:
        parser.error(f"no shipped protocol '{wrong[0]}'; there are {', '.join(NAMES)}")
    if options.frames:
        return draw_frames()
    if options.diff:
        return diff(options.diff, names, options.only, None if options.all_lines else MOST_LINES)
    if options.dump:
        dump(Path(options.dump), names, options.only)
        return 0
    return compare(names, options.only, options.write)


def every(names: list[str], only: str) -> Iterator[tuple[str, list[Case]]]:
    for name in names:
        yield name, [case for case in cases(Shipped(name)) if case.name.startswith(only)]


def compare(names: list[str], only: str, is_written: bool) -> int:
    count = 0
    for name, some in every(names, only):
        before, now = kept.read(name), {case.name: kept.hash_of(case) for case in some}
        gone = [case for case in before if case not in now and case.startswith(only)]
        changed = [*(case for case in now if before.get(case, "") != now[case]), *gone]
        count += len(changed)
        for case in changed:
            print(f"{name}: {case}{' is gone' if case in gone else ''}")
        if is_written and changed:
            rest = {case: hash_ for case, hash_ in before.items() if not case.startswith(only)}
            kept.write(name, dict(sorted({**rest, **now}.items())))
    done = "kept as they are now" if is_written else "differ; `--diff REVISION` shows how, `--write` keeps them"
    print(f"{count} cases {done}" if count else "nothing differs")
    return 1 if count and not is_written else 0


def dump(folder: Path, names: list[str], only: str) -> None:
    """Write a file for each pair of the first two parts of case names, so related texts are in one file."""
    for name, some in every(names, only):
        texts: dict[str, list[str]] = {}
        for case in some:
            parts = case.name.split("/", 1 if case.name.startswith("conversation") else 2)
            texts.setdefault("/".join(parts[:2] if len(parts) == 3 else parts[:1]), []).append(
                f"#### {case.name}\n{case.make()}"
            )
        for title, text in texts.items():
            file = folder / name / f"{title}.txt"
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text("".join(text), encoding="utf-8")


def diff(revision: str, names: list[str], only: str, most: int | None) -> int:
    """Compare the texts of the current code with the texts that the code of a commit makes from the current cases."""
    root = HERE.parent.parent
    wanted = ["git", "archive", "--format=tar", revision, "framekit", "schemas"]
    packed = subprocess.run(wanted, cwd=root, stdout=subprocess.PIPE, check=True).stdout
    with tempfile.TemporaryDirectory() as temporary:
        tree, before, now = (Path(temporary) / part for part in ("tree", "before", "now"))
        with tarfile.open(fileobj=BytesIO(packed)) as tar:
            tar.extractall(tree, filter="data")
        for part in ("frames", "tests"):
            (tree / part).symlink_to(root / part)
        command = [sys.executable, str(HERE), "--only", only, *names, "--dump"]
        subprocess.run([*command, str(before)], cwd=tree, env={**os.environ, "PYTHONPATH": str(tree)}, check=True)
        dump(now, names, only)
        return show(before, now, most)


def show(before: Path, now: Path, most: int | None) -> int:
    files = sorted({file.relative_to(side) for side in (before, now) for file in side.rglob("*.txt")})
    count = 0
    for name in files:
        texts = [(side / name).read_text("utf-8") if (side / name).exists() else "" for side in (before, now)]
        if texts[0] == texts[1]:
            continue
        count += 1
        lines = list(difflib.unified_diff(*(text.splitlines() for text in texts), *[str(name)] * 2, n=2, lineterm=""))
        print("\n".join(lines[:most]))
        if most is not None and len(lines) > most:
            print(f"… and {len(lines) - most} lines more of {name} (`--all-lines`)")
    print(f"{count} texts differ" if count else "nothing differs")
    return 1 if count else 0


def draw_frames() -> int:
    KEPT_FRAMES.mkdir(exist_ok=True)
    for one in map(Shipped, NAMES):
        if text := one.draw_frames():
            (KEPT_FRAMES / f"{one.name}.txt").write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
