"""Compiled protocols in the user's cache folder: cached data, and cached data that must not be trusted."""

from __future__ import annotations

import hashlib
import marshal
import os
import pickle
import subprocess
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from types import CodeType

import pytest
import shipped
from spread import spread

from framekit.cli import definition_verbs, main, serve_verb
from framekit.codec import cache as cache_module
from framekit.codec import codec as codecs
from framekit.codec.cache import (
    SUFFIX,
    CacheEntry,
    CacheFolder,
    cache_folder,
    cached_codec,
    definition_cache,
    keep,
    read_entry,
)
from framekit.codec.codec import compile_protocol
from framekit.codec.functions import candidates, of_side
from framekit.definition.load import protocol as library
from framekit.definition.load.protocol import load_protocol
from framekit.definition.sources import Sources, cached_by, current_cache
from framekit.link.scope import Scope
from framekit.runfile.devices import load_devices

REQUEST = bytes.fromhex("01 03 00 00 00 0A C5 CD")
OWN = "protocol: own\nline: {kind: stream}\nframes:\n  one: {body: [{const: 01}, {field: value, type: u8}]}\n"

pytestmark = pytest.mark.skipif(not hasattr(os, "geteuid"), reason="there are no owners to check")


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty cache folder, isolated from the caches of other tests."""
    folder = tmp_path / "cache"
    monkeypatch.setenv("FRAMEKIT_CACHE", str(folder))
    with cached_by(None):
        yield folder


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Record the protocols that were loaded and compiled instead of taken from the cache."""
    found: list[str] = []
    make = cache_module._made

    def noting(name: str | Path, *more: object) -> CacheEntry:
        found.append(str(name))
        return make(name, *more)  # type: ignore[arg-type]

    monkeypatch.setattr(cache_module, "_made", noting)
    return found


def written(folder: Path, text: str = OWN, name: str = "own") -> Path:
    folder.mkdir(exist_ok=True)
    file = folder / f"{name}.yaml"
    file.write_text(text, encoding="utf-8")
    return file


# ---- kept and read again -----------------------------------------------------------------------------------


def test_what_was_kept_decodes_as_what_was_compiled(cache: Path, made: list[str], tmp_path: Path) -> None:
    first, again = cached_codec("modbus-rtu", tmp_path), cached_codec("modbus-rtu", tmp_path)
    assert made == ["modbus-rtu"]
    fields = again.decode("request_adu", REQUEST)
    assert fields == first.decode("request_adu", REQUEST)
    assert fields["pdu"]["read_holding"]["count"] == 10
    assert again.protocol == first.protocol == load_protocol("modbus-rtu")
    assert compile_protocol(again.protocol).encode("request_adu", fields) == REQUEST


@pytest.mark.parametrize("name", spread(shipped.PROTOCOLS, 8, 4))
def test_the_catalogue_and_the_start_values_are_those_of_the_definition(cache: Path, name: str) -> None:
    codec = cached_codec(name, Path.cwd())
    protocol = codec.protocol
    assert list(codec.catalogue) == list(protocol.frames)
    for side in (None, "client", "server"):
        assert of_side(codec.catalogue, side) == candidates(protocol, None, side)
    scope = Scope(protocol)
    assert {name: scope[name] for name in codec.defaults} == dict(codec.defaults)


def test_only_this_user_can_read_what_is_kept(cache: Path, tmp_path: Path) -> None:
    cached_codec(written(tmp_path), tmp_path)
    (file,) = cache.iterdir()
    assert (cache.stat().st_mode & 0o777, file.stat().st_mode & 0o777) == (0o700, 0o600)


# ---- not believed ------------------------------------------------------------------------------------------


def test_a_definition_that_has_changed_is_compiled_again(cache: Path, made: list[str], tmp_path: Path) -> None:
    file = written(tmp_path)
    cached_codec(file, tmp_path)
    written(tmp_path, OWN.replace("01", "02"))
    assert cached_codec(file, tmp_path).decode("one", b"\x02\x07")["value"] == 7
    assert len(made) == 2


def test_a_file_that_now_goes_before_a_shipped_one_counts(cache: Path, made: list[str], tmp_path: Path) -> None:
    file = written(tmp_path / "here", "protocol: mine\nextends: modbus-rtu\n", "mine")
    cached_codec(file, tmp_path)
    beside = "protocol: modbus-rtu\nline: {kind: stream}\nframes:\n  one: {body: [{const: 01}]}\n"
    written(tmp_path / "here", beside, "modbus-rtu")
    assert list(cached_codec(file, tmp_path).catalogue) == ["one"]
    assert len(made) == 2


def test_another_version_compiles_for_itself(
    cache: Path, made: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = written(tmp_path)
    cached_codec(file, tmp_path)
    monkeypatch.setattr(cache_module, "__version__", "9.9.9")
    cached_codec(file, tmp_path)
    assert len(made) == 2


@pytest.mark.parametrize("harm", ["cut", "changed", "open", "link"])
def test_what_is_damaged_or_could_be_another_users_is_not_run(
    cache: Path, made: list[str], tmp_path: Path, harm: str
) -> None:
    file = written(tmp_path)
    cached_codec(file, tmp_path)
    (kept,) = cache.iterdir()
    data = kept.read_bytes()
    if harm == "cut":
        kept.write_bytes(data[:-1])
    elif harm == "changed":
        kept.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    elif harm == "open":
        kept.chmod(0o620)
    else:
        kept.rename(tmp_path / "elsewhere")
        kept.symlink_to(tmp_path / "elsewhere")
    assert cached_codec(file, tmp_path).decode("one", b"\x01\x07")["value"] == 7
    assert len(made) == 2


def test_a_folder_that_others_can_write_is_no_cache(cache: Path, made: list[str], tmp_path: Path) -> None:
    cache.mkdir()
    cache.chmod(0o777)
    assert cache_folder() is None
    file = written(tmp_path)
    for _ in range(2):
        cached_codec(file, tmp_path)
    assert len(made) == 2
    assert list(cache.iterdir()) == []


@pytest.mark.parametrize(
    ("system", "settings", "place"),
    [
        ("linux", {}, ".cache/framekit"),
        ("linux", {"XDG_CACHE_HOME": "."}, ".cache/framekit"),
        ("linux", {"XDG_CACHE_HOME": "HOME/other"}, "other/framekit"),
        ("darwin", {"XDG_CACHE_HOME": "HOME/other"}, "other/framekit"),
        ("win32", {"FRAMEKIT_CACHE": "HOME/own"}, "own"),
        ("win32", {"FRAMEKIT_CACHE": "HOME/../own"}, None),  # other users may write there
    ],
)
def test_where_the_folder_is(
    system: str, settings: dict[str, str], place: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    home = tmp_path / "home"
    home.mkdir()
    monkeypatch.setattr(sys, "platform", system)
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.delenv("FRAMEKIT_CACHE", raising=False)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    for name, value in settings.items():
        monkeypatch.setenv(name, value.replace("HOME", str(home)))
    assert cache_folder() == (None if place is None else home / place)


def test_the_folder_of_a_mac(tmp_path: Path) -> None:
    code = "import sys; sys.platform = 'darwin'\nfrom framekit.codec.cache import cache_folder\nprint(cache_folder())"
    given = {name: value for name, value in os.environ.items() if name not in ("FRAMEKIT_CACHE", "XDG_CACHE_HOME")}
    ran = subprocess.run([sys.executable, "-c", code], env=given | {"HOME": str(tmp_path)}, capture_output=True)
    assert ran.stdout.decode().strip() == str(tmp_path / "Library/Caches/framekit")


def test_an_empty_name_keeps_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FRAMEKIT_CACHE", "")
    assert cache_folder() is None


def test_what_stands_under_the_name_of_another_is_not_run(cache: Path, made: list[str], tmp_path: Path) -> None:
    file, other = written(tmp_path), written(tmp_path, OWN.replace("const: 01", "const: 02"), "other")
    cached_codec(file, tmp_path)
    (first,) = cache.iterdir()
    cached_codec(other, tmp_path)
    (second,) = set(cache.iterdir()) - {first}
    first.write_bytes(second.read_bytes())
    assert cached_codec(file, tmp_path).decode("one", b"\x01\x07")["value"] == 7
    assert cached_codec(other, tmp_path).decode("one", b"\x02\x07")["value"] == 7
    assert len(made) == 3


@pytest.mark.parametrize("content", [b"", b"?", marshal.dumps(5), marshal.dumps((1, 2)), marshal.dumps((1,) * 6)])
def test_content_that_is_no_protocol_is_made_again(
    cache: Path, made: list[str], tmp_path: Path, content: bytes
) -> None:
    file = written(tmp_path)
    cached_codec(file, tmp_path)
    (kept,) = cache.iterdir()
    content = kept.name.removesuffix(SUFFIX).encode() + content
    kept.write_bytes(hashlib.sha256(content).digest() + content)
    assert cached_codec(file, tmp_path).decode("one", b"\x01\x07")["value"] == 7
    assert len(made) == 2


@pytest.mark.parametrize("pickled", [b"", b"?", pickle.dumps(5), b"cno.such.module\nname\n.", b"cframekit\nnone\n."])
def test_a_model_that_cannot_be_read_is_made_again(
    cache: Path, made: list[str], tmp_path: Path, pickled: bytes
) -> None:
    file = written(tmp_path)
    protocol = cached_codec(file, tmp_path).protocol
    files = CacheFolder(cache)
    kept = files.read(file)
    assert kept is not None
    files.write(file, kept._replace(pickled=pickled))
    with cached_by(definition_cache()):
        library._kept.clear()
        assert load_protocol(file) == protocol
    files.write(file, kept._replace(pickled=pickled))
    codec = cached_codec(file, tmp_path)
    assert codec.decode("one", b"\x01\x07")["value"] == 7
    assert len(made) == 1
    assert codec.protocol == protocol
    assert len(made) == 2
    assert files.read(file) == kept


def test_so_many_files_are_kept_as_there_is_room_for(cache: Path) -> None:
    folder = cache_folder()
    assert folder == cache
    for number in range(200):
        keep(folder, f"{number}", b"data")
    assert len(list(folder.iterdir())) == 200


def test_the_oldest_files_go_when_they_hold_too_much(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = cache_folder()
    assert folder is not None
    monkeypatch.setattr(cache_module, "MOST_BYTES", 1000)
    for number in range(5):
        keep(folder, f"{number}", bytes(400))
        os.utime(folder / f"{number}{SUFFIX}", ns=(number, number))
    assert sorted(file.name for file in folder.iterdir()) == [f"3{SUFFIX}", f"4{SUFFIX}"]
    keep(folder, "large", bytes(5000))
    assert [file.name for file in folder.iterdir()] == [f"large{SUFFIX}"]


def test_files_of_others_in_the_folder_stay(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = cache_folder()
    assert folder is not None
    monkeypatch.setattr(cache_module, "MOST_BYTES", 10)
    letter = folder / "letter.txt"
    letter.write_text("not ours", encoding="utf-8")
    os.utime(letter, ns=(0, 0))
    for number in range(5):
        keep(folder, f"{number}", b"data")
    assert letter.read_text(encoding="utf-8") == "not ours"


def test_a_folder_in_the_place_of_a_file_is_nothing_kept(cache: Path) -> None:
    folder = cache_folder()
    assert folder is not None
    (folder / f"one{SUFFIX}").mkdir(mode=0o700)
    assert read_entry(folder, "one") is None


def test_code_for_a_library_that_is_no_longer_there_is_made_again(
    cache: Path, made: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        wanted = 'compile("from framekit.codec import not_there", "gone", "exec")'
        patch.setattr("framekit.codec.codec.code_of", lambda protocol: eval(wanted))
        with pytest.raises(ImportError):
            cached_codec(written(tmp_path), tmp_path)
    assert cached_codec(written(tmp_path), tmp_path).encode("one", {"value": 2}) == b"\x01\x02"
    assert len(made) == 2


# ---- whoever loads and compiles ----------------------------------------------------------------------------

DEVICE = """
device: one
protocol: own
memory: {areas: {D: {unit: word, size: 4}}, addresses: [{form: "D{start:dec}", area: D}]}
"""


@pytest.fixture
def loads(cache: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Record which protocols are really loaded and compiled."""
    found: list[str] = []
    load, make = library._load, codecs.code_of
    monkeypatch.setattr(library, "_load", lambda path: found.append(f"load {path.stem}") or load(path))
    monkeypatch.setattr(codecs, "code_of", lambda protocol: found.append(f"compile {protocol.name}") or make(protocol))
    return found


def next_command(monkeypatch: pytest.MonkeyPatch) -> None:
    """Forget all loaded protocols, as if another process began."""
    monkeypatch.setattr(library, "_kept", {})
    monkeypatch.setattr(codecs, "_compiled", {})


def test_devices_take_their_protocol_and_its_functions_from_the_cache(
    loads: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written(tmp_path)
    device = written(tmp_path, DEVICE, "one.device")
    models = []
    for _ in range(2):
        next_command(monkeypatch)
        with cached_by(definition_cache()):
            (found,) = load_devices(device, tmp_path)
            models.append(found.protocol)
            assert compile_protocol(found.protocol).decode("one", b"\x01\x07") == {"value": 7}
            assert compile_protocol(found.protocol) is compile_protocol(load_protocol(tmp_path / "own.yaml"))
    assert loads == ["load own", "compile own"]
    assert models[0] == models[1] and models[0] is not models[1]


def test_a_definition_that_has_changed_is_loaded_again(
    loads: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = written(tmp_path)
    for byte in (b"\x01", b"\x02", b"\x02"):
        next_command(monkeypatch)
        written(tmp_path, OWN.replace("01", byte.hex()))
        with cached_by(definition_cache()):
            assert compile_protocol(load_protocol(file)).encode("one", {"value": 7}) == byte + b"\x07"
    assert loads == 2 * ["load own", "compile own"]


def test_what_the_library_keeps_is_what_decode_reads(
    loads: list[str], made: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = written(tmp_path)
    with cached_by(definition_cache()):
        compile_protocol(load_protocol(file))
    next_command(monkeypatch)
    assert cached_codec(file, tmp_path).decode("one", b"\x01\x07") == {"value": 7}
    assert made == [] and len(loads) == 2


def test_kept_code_for_a_library_that_is_no_longer_there_is_compiled_again(
    loads: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = written(tmp_path)
    gone = compile("from framekit.codec import not_there", "gone", "exec")
    with cached_by(definition_cache()), monkeypatch.context() as patch:
        patch.setattr(codecs, "code_of", lambda protocol: gone)
        with pytest.raises(ImportError):
            compile_protocol(load_protocol(file))
    for _ in range(2):
        next_command(monkeypatch)
        with cached_by(definition_cache()):
            assert compile_protocol(load_protocol(file)).encode("one", {"value": 2}) == b"\x01\x02"
    assert loads == ["load own", "compile own"]


@pytest.mark.parametrize(("verb", "keeps"), [("serve", True), ("check", False)])
def test_commands_keep_what_they_load_unless_they_are_to_look_at_it(
    cache: Path, monkeypatch: pytest.MonkeyPatch, verb: str, keeps: bool
) -> None:
    found: list[bool] = []
    module = {"serve": serve_verb, "check": definition_verbs}[verb]
    monkeypatch.setattr(module, f"run_{verb}", lambda arguments: found.append(current_cache() is not None) or 0)
    words = {"serve": ["serve", "mldp", "--port", "pty:"], "check": ["check", "mldp"]}[verb]
    assert main.main(words) == 0
    assert found == [keeps] and current_cache() is None


def test_the_code_of_sequences_is_kept_and_made_again_when_it_is_damaged(cache: Path, tmp_path: Path) -> None:
    made: list[int] = []
    file = written(tmp_path)

    def make() -> CodeType:
        made.append(1)
        return compile("found = 5", "<sequences>", "exec")

    def code() -> CodeType:
        with cached_by(definition_cache()):
            keeper = current_cache()
            assert keeper is not None
            protocol = load_protocol(file)
            keeper.was_loaded(file, protocol, Sources(((str(file), file.read_text()),), ()))
            return keeper.code(protocol, "sequences", make)

    for times in (1, 1):
        names: dict[str, object] = {}
        exec(code(), names)
        assert names["found"] == 5 and len(made) == times
    for kept in cache.glob("*" + SUFFIX):
        kept.write_bytes(kept.read_bytes()[:-9])
    code()
    assert len(made) == 2
    written(tmp_path, OWN.replace("value", "other"))
    code()
    assert len(made) == 3


def test_decoding_what_has_been_kept_needs_no_model(tmp_path: Path) -> None:
    (tmp_path / "small.yaml").write_text("protocol: small\nframes:\n  one: {body: [{field: a, type: u8}]}\n")
    script = (
        "import sys; from framekit.cli.main import main; main(['decode', 'small.yaml', '07']); "
        "print([name for name in sys.modules if name.startswith(('framekit.definition.model', 'yaml'))])"
    )
    run = partial(subprocess.run, [sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True)
    environment = {**os.environ, "FRAMEKIT_CACHE": str(tmp_path / "cache")}
    assert "framekit.definition.model" in run(env=environment).stdout, "it has to be compiled first"
    assert run(env=environment).stdout.splitlines()[-1] == "[]"
