"""The state file of a run: restored values, refused files that are left unchanged, and the file after a kill."""

from __future__ import annotations

import os
import signal
import sqlite3
import stat
import subprocess
import sys
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from framekit.service.state import PAGE, KeptBlock, KeptRun, StateError, StateFile

SHAPE = (("M", "word", 4096), ("bits", "bit", 13))


def block(done: int, failed: int = 0, number: int = 0, running: int = 0) -> KeptBlock:
    return KeptBlock(
        set=1, number=number, content="c", started=done + failed + running, done=done, failed=failed, overruns=2,
        outcome="refused", cause="no", device_code=0x1332, meaning="types",
    )  # fmt: skip


def kept(word: int, *blocks: KeptBlock) -> KeptRun:
    memory = bytearray(8192)
    memory[2 * 3000 : 2 * 3000 + 2] = word.to_bytes(2, "little")
    return KeptRun({"M": bytes(memory), "bits": b"\x01\x10"}, {(block.set, block.number): block for block in blocks})


def test_what_is_kept_comes_back(tmp_path: Path) -> None:
    path = tmp_path / "plant.state"
    with closing(StateFile(path, "plant", SHAPE)) as file:
        assert file.kept == KeptRun()
        assert file.save(kept(77, block(3), block(1, 1, 5, 1))) == 2, "pages of zeros are not written"
        assert file.save(kept(77, block(4))) == 0
        assert file.save(kept(78, block(4))) == 1
    with closing(StateFile(path, "plant", SHAPE)) as file:
        assert file.kept == kept(78, block(4)), "rows of blocks that are gone leave the file"
        assert file.save(kept(0)) == 1, "what became 0 is written too"
    with closing(StateFile(path, "plant", SHAPE)) as file:
        assert file.kept.areas == kept(0).areas
    assert sorted(path.name for path in tmp_path.iterdir()) == ["plant.state"], "nothing is left beside it"


def test_other_areas_may_be_kept_later(tmp_path: Path) -> None:
    path = tmp_path / "s"
    with closing(StateFile(path, "plant", SHAPE[:1])) as file:
        file.save(KeptRun({"M": kept(5).areas["M"]}))
    with closing(StateFile(path, "plant", SHAPE)) as file:
        assert file.kept == KeptRun({"M": kept(5).areas["M"]})


def refused(path: Path, run: str = "plant", shape: tuple[tuple[str, str, int], ...] = SHAPE) -> str:
    """Return the error message; assert that the file is unchanged."""
    before = path.read_bytes() if path.is_file() else b""
    with pytest.raises(StateError) as found:
        StateFile(path, run, shape)
    assert (path.read_bytes() if path.is_file() else b"") == before
    return str(found.value).replace(str(path), "FILE")


def written(path: Path) -> Path:
    with closing(StateFile(path, "plant", SHAPE)) as file:
        file.save(kept(77, block(3)))
    return path


def test_a_file_of_another_run(tmp_path: Path) -> None:
    path = written(tmp_path / "s")
    assert refused(path, "mill") == (
        "FILE is the state of run 'plant', this run is 'mill' – name another file, or move it away to begin anew"
    )
    assert refused(path, shape=(("M", "word", 2048),)) == (
        "FILE is of another memory: area M is 4096 × word there and 2048 × word here – "
        "name another file, or move it away to begin anew"
    )


def test_a_file_of_another_form(tmp_path: Path) -> None:
    path = written(tmp_path / "s")
    with closing(sqlite3.connect(path)) as base:
        base.execute("PRAGMA user_version = 0")
    assert "has the form 0, this framekit writes form 1" in refused(path)


@pytest.mark.parametrize("content", [b"hello", b"SQLite format 3\0", os.urandom(5000)])
def test_a_file_of_another_kind(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "s"
    path.write_bytes(content)
    assert refused(path) == "FILE is no state file – name another file"


def test_another_database(tmp_path: Path) -> None:
    path = tmp_path / "s"
    with closing(sqlite3.connect(path)) as base:
        base.execute("CREATE TABLE mine (x)")
    assert refused(path) == "FILE is no state file – name another file"


def test_an_empty_file_is_a_new_one(tmp_path: Path) -> None:
    (tmp_path / "s").touch()
    with closing(StateFile(tmp_path / "s", "plant", SHAPE)) as file:
        assert file.kept == KeptRun() and file.was_empty
    with closing(StateFile(tmp_path / "s", "plant", SHAPE)) as file:
        assert not file.was_empty


@pytest.mark.parametrize("cut", [4096, 5000, 12288])
def test_a_file_that_was_cut_off(tmp_path: Path, cut: int) -> None:
    path = written(tmp_path / "s")
    path.write_bytes(path.read_bytes()[:cut])
    assert refused(path).startswith("FILE is damaged: ")


def test_every_damaged_page_is_refused_or_harmless(tmp_path: Path) -> None:
    whole = written(tmp_path / "whole").read_bytes()
    messages = set()
    for at in range(4096, len(whole), 257):
        path = tmp_path / "s"
        path.write_bytes(whole[:at] + bytes(byte ^ 0xFF for byte in whole[at : at + 64]) + whole[at + 64 :])
        try:
            with closing(StateFile(path, "plant", SHAPE)) as file:
                assert file.kept.blocks.keys() <= {(1, 0)}
        except StateError as error:
            messages.add(str(error).split(":")[0].replace(str(path), "FILE"))
        path.unlink()
    assert "FILE is damaged" in messages and all(message.startswith("FILE is") for message in messages)


@pytest.mark.parametrize(
    "sql",
    [
        "UPDATE blocks SET done = 9",
        "UPDATE blocks SET started = -1, done = -1",
        "UPDATE blocks SET outcome = 5",
        "UPDATE blocks SET device_code = 'x'",
        "UPDATE pages SET number = 100",
        "UPDATE pages SET number = -1",
        "UPDATE pages SET content = 'text'",
        f"UPDATE pages SET content = zeroblob({PAGE + 1}) WHERE number = 0",
        "DELETE FROM about",
        "DROP TABLE blocks",
    ],
)
def test_content_that_cannot_be(tmp_path: Path, sql: str) -> None:
    path = written(tmp_path / "s")
    with closing(sqlite3.connect(path)) as base, base:
        base.execute(sql)
    if "outcome = 5" in sql:  # the column's type makes a text of it
        with closing(StateFile(path, "plant", SHAPE)) as file:
            assert file.kept.blocks[1, 0].outcome == "5"
        return
    message = refused(path)
    assert message.startswith("FILE is damaged: ") or "no such table" in message


def test_a_file_in_use(tmp_path: Path) -> None:
    path = written(tmp_path / "s")
    with closing(StateFile(path, "plant", SHAPE)) as file:
        with pytest.raises(StateError, match="is in use – stop the run that uses it"):
            StateFile(path, "plant", SHAPE)
        file.save(kept(79))
    with closing(StateFile(path, "plant", SHAPE)) as file:
        assert file.kept.areas == kept(79).areas


def device(path: Path) -> None:
    try:
        os.mknod(path, stat.S_IFCHR | 0o600, os.makedev(1, 7))
    except PermissionError:
        pytest.skip("only root makes devices")


@pytest.mark.parametrize("make", [device, os.mkfifo, Path.mkdir])
@pytest.mark.parametrize("linked", [False, True])
def test_what_is_no_plain_file_is_left_alone(tmp_path: Path, make: Callable[[Path], None], linked: bool) -> None:
    path = tmp_path / "odd"
    make(path)
    kind = stat.S_IFMT(path.stat().st_mode)
    if linked:
        (tmp_path / "link").symlink_to(path)
    assert refused(tmp_path / "link" if linked else path) == "FILE is no plain file – name another file"
    assert stat.S_IFMT(path.stat().st_mode) == kind


@pytest.mark.parametrize("empty", [False, True])
def test_a_link_stays_a_link_to_the_state(tmp_path: Path, empty: bool) -> None:
    (tmp_path / "far").mkdir()
    place, link = tmp_path / "far" / "state", tmp_path / "link"
    link.symlink_to(Path("far") / "state")
    if empty:
        place.touch()
    written(link)
    assert link.is_symlink() and [path.name for path in place.parent.iterdir()] == ["state"]
    with closing(StateFile(place, "plant", SHAPE)) as file:
        assert file.kept.areas == kept(77).areas


def test_links_in_a_circle(tmp_path: Path) -> None:
    (tmp_path / "one").symlink_to(tmp_path / "two")
    (tmp_path / "two").symlink_to(tmp_path / "one")
    assert "is a link that leads to itself – mend the link" in refused(tmp_path / "one")


def test_a_folder_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(StateError, match=r"the folder .* does not exist – make the folder"):
        StateFile(tmp_path / "no" / "s", "plant", SHAPE)


WRITER = """
import sys
from pathlib import Path
from framekit.service.state import KeptBlock, KeptRun, StateFile

file = StateFile(Path(sys.argv[1]), "plant", (("M", "word", 4096),))
done = file.kept.blocks[1, 0].done if file.kept.blocks else 0
while True:
    done += 1
    block = KeptBlock(set=1, number=0, content="c", started=done + 1, done=done, failed=0, overruns=0)
    file.save(KeptRun({"M": done.to_bytes(4, "little") * 2048}, {(1, 0): block}))
    print(done, flush=True)
"""


@pytest.mark.long
def test_killed_at_any_time_the_last_committed_state_is_there(tmp_path: Path) -> None:
    path = tmp_path / "s"
    last = 0
    for turn in range(4):
        writer = subprocess.Popen([sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE, text=True)
        assert writer.stdout is not None
        for _ in range(1 + 14 * turn):
            writer.stdout.readline()
        writer.send_signal(signal.SIGKILL)
        numbers = [int(line) for line in writer.communicate()[0].split()]
        numbers += [last + 1 + 14 * turn]
        with closing(StateFile(path, "plant", (("M", "word", 4096),))) as file:
            found = file.kept.blocks[1, 0].done
            assert file.kept.areas["M"] == found.to_bytes(4, "little") * 2048, "memory and counters are of one moment"
            assert max(numbers) <= found <= max(numbers) + 1, "what was told as written is there"
        last = found
    with closing(sqlite3.connect(path)) as base:
        assert base.execute("PRAGMA integrity_check").fetchone() == ("ok",)
