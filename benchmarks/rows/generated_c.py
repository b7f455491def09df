"""Generated C, C by hand and the C++ of Kaitai's compiler, compiled by the same compiler in one program.

The frame is the register reply of `benchmarks/registers.yaml`; `benchmarks/c` has the code it is compared with.
Kaitai's C++ library is not a Python package: `KAITAI_CPP=FOLDER` gives its folder (with `kaitai/kaitaistream.cpp`);
without it, the rows of Kaitai are left out.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING

from benchmarks.measure import ROUND, interleave
from benchmarks.row import Row, faster, slower
from framekit.definition.load.protocol import load_protocol
from framekit.extras.generate_c.generate import generate

if TYPE_CHECKING:
    from collections.abc import Iterator

NAME = "Generated C against C by hand and Kaitai's C++"
TARGET = "none; nanoseconds a frame"
SOURCES = Path(__file__).parent.parent / "c"
DEFINITION = Path(__file__).parent.parent / "registers.yaml"
FRAMES = 1000
"""Number of replies in a stream, as in `main.cpp`."""
WHAT = {"decode": 1, "encode": 1, "stream": FRAMES}
"""Name of a measurement → number of frames per call."""


def run(rounds: int) -> list[Row]:
    if shutil.which("g++") is None:
        return []
    library = os.environ.get("KAITAI_CPP")
    with tempfile.TemporaryDirectory() as folder:
        program = _compiled(Path(folder), None if library is None else Path(library))
        with _running(program) as ask:
            return [
                row
                for registers in (10, 125)
                for what in WHAT
                for row in _measured(ask, what, registers, library is not None, rounds)
            ]


def _compiled(folder: Path, library: Path | None) -> Path:
    """Compile the program of all sides. Raises CalledProcessError."""
    made = generate(load_protocol(str(DEFINITION)))
    (folder / "registers.h").write_text(made.header)
    (folder / "registers.c").write_text(made.source)
    c = [folder / "registers.c", SOURCES / "by_hand.c"]
    cpp, flags = [SOURCES / "main.cpp"], ["-O2", f"-I{folder}", f"-I{SOURCES}"]
    if library is not None:
        cpp += [SOURCES / "modbus_reply.cpp", library / "kaitai" / "kaitaistream.cpp"]
        flags += ["-DWITH_KAITAI", "-DKS_STR_ENCODING_NONE", f"-I{library}"]
    objects = []
    for source in (*c, *cpp):
        target = folder / f"{source.stem}.o"
        compiler = ["gcc", "-std=c99"] if source in c else ["g++", "-std=c++17"]
        subprocess.run([*compiler, *flags, "-c", str(source), "-o", str(target)], check=True)
        objects.append(str(target))
    subprocess.run(["g++", *objects, "-o", str(folder / "measured")], check=True)
    return folder / "measured"


Ask = Callable[[str, int, int], float]


@contextmanager
def _running(program: Path) -> Iterator[Ask]:
    """Run the program; yield a function that returns its seconds for a number of calls."""
    with subprocess.Popen([str(program)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None and process.stdout is not None
        to: IO[str] = process.stdin
        answers: IO[str] = process.stdout

        def ask(what: str, registers: int, count: int) -> float:
            to.write(f"{what} {registers} {count}\n")
            to.flush()
            return float(answers.readline())

        yield ask
        to.close()


def _measured(ask: Ask, what: str, registers: int, with_kaitai: bool, rounds: int) -> list[Row]:
    """Return the rows of an operation on a size of frame: seconds per frame."""
    sides = ["generated", "by_hand", *(["kaitai"] if with_kaitai and what != "encode" else [])]

    def timed(side: str) -> Callable[[], float]:
        name, count = f"{what}_{side}", 1
        while (took := ask(name, registers, count)) < ROUND / 4:
            count *= 4
        count = max(1, round(count * ROUND / took))
        return lambda: ask(name, registers, count) / count / WHAT[what]

    found = interleave({side: timed(side) for side in sides}, rounds)
    name = f"{registers} registers: {what}"
    rows = [slower(name, "by hand", found["generated"], found["by_hand"], None, 1e9)]
    if "kaitai" in found:
        rows.append(faster(name, "Kaitai", found["generated"], found["kaitai"], None, 1e9))
    return rows
