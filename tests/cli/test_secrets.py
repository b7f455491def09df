"""Secret parameter values appear in no output, log, capture, decoded capture or state file of a run.

The tests search for the bytes, hex digits in any notation, the text of Python and JSON, and base64.
"""

from __future__ import annotations

import base64
import json
import re
import sqlite3
from pathlib import Path

import pytest

from framekit.cli.main import main

pytest.importorskip("cryptography")

KEY = bytes.fromhex("C3A1F05E2B7D94886E11D9A0B4570F3C")
OTHER = bytes.fromhex("C3A1F05E2B7D94886E11D9A0B4570F3D")
DERIVED = KEY[1:] + KEY[:1]
PASSWORD = "swordfish-4711"

PROTOCOL = """protocol: sealed
extends: standard
params:
  k: {type: bytes, size: 16, secret: yes}
  turned: {type: bytes, is: "k[1:] + k[:1]", secret: yes}
  word: {type: text, secret: yes}
groups:
  request: {from: client, head: [{const: 51}], tail: [{check: cmac-aes, key: k, size: 4}]}
frames:
  ask: {group: request, body: [{field: place, type: u8}, {field: n, type: u8}]}
  told:
    from: server
    body:
      - {const: 52}
      - {wrap: {cipher: aes-cbc, key: turned, iv: "h'000102030405060708090A0B0C0D0E0F'"}, of: [{data: d, size: 16}]}
      - {check: hmac-sha256, key: k, size: 8}
areas: {R: {unit: byte, size: 64}}
addresses: [{form: "R{start:dec}", area: R}]
services:
  read:
    - areas: [R]
      limit: {count: 16}
      request: {ask: {place: start, n: count}}
      back: {area: "'R'", start: request.place, count: request.n}
      reply: {told: {d: data}}
"""
DEVICE = (
    "device: sealed-device\nprotocol: sealed\nparams: {{k: {key}, word: {word}}}\nmemory: {{set: {{R0: [1, 2, 3]}}}}\n"
)
RUN = """run: sealed-run
memory: {{areas: {{M: {{unit: byte, size: 32}}}}, addresses: [{{form: "{{area}}{{start:dec}}"}}]}}
state: {{file: kept.state}}
channels:
  1: {{port: "sim:one.device.yaml", protocol: sealed, params: {{k: {key}, word: {word}, retries: 0}}}}
blocks:
  0: {{read: R0, count: 16, into: M0, every: 100 ms}}
"""


def shows(data: bytes, secret: bytes) -> bool:
    """Return whether the data contain the secret in any usual notation."""
    if secret in data or base64.b64encode(secret)[:-4] in data:
        return True
    text = data.decode("utf-8", "replace")
    forms = {repr(secret), repr(secret)[2:-1], json.dumps(secret.decode("latin-1"))[1:-1], str(list(secret))}
    digits = re.sub(r"[^0-9A-F]|0X", "", re.sub(r"\\X|0X", "", text.upper()))
    return any(form in text for form in forms) or secret.hex().upper() in digits


def call(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str]:
    status = main(list(words))
    out, err = capsys.readouterr()
    return status, out + err


def written_data(folder: Path) -> bytes:
    """Return the content of all files that the run has written."""
    parts = [path.read_bytes() for path in folder.rglob("*") if path.is_file() and path.suffix != ".yaml"]
    with sqlite3.connect(folder / "kept.state") as base:
        parts += ["\n".join(base.iterdump()).encode()]
    return b"\n".join(parts)


@pytest.mark.parametrize("of_device", [KEY, OTHER], ids=["right key", "wrong key"])
@pytest.mark.parametrize("form", ["jsonl", "pcap"])
def test_a_run_tells_no_secret(capsys: pytest.CaptureFixture[str], tmp_path: Path, of_device: bytes, form: str) -> None:
    (tmp_path / "sealed.yaml").write_text(PROTOCOL)
    (tmp_path / "one.device.yaml").write_text(DEVICE.format(key=of_device.hex(), word=PASSWORD))
    (tmp_path / "one.run.yaml").write_text(RUN.format(key=KEY.hex(), word=PASSWORD))
    capture = tmp_path / f"wire.{form}"
    printed = ""
    for more in ([], ["--json"]):
        for before in tmp_path.glob(f"wire*.{form}"):
            before.unlink()
        status, out = call(
            capsys, "run", str(tmp_path / "one.run.yaml"), "--virtual", "--for", "2s", "--frames", "--status",
            "--log", "debug", "--capture", str(capture), *more,
        )  # fmt: skip
        assert status == 0
        printed += out
    assert ("told" in printed) == (of_device == KEY), "with the wrong key nobody answers"
    found = next(path for path in tmp_path.glob(f"wire*.{form}"))
    for more in ([], ["--json"]):
        status, out = call(
            capsys, "decode", str(tmp_path / "sealed.yaml"), "--capture", str(found), "--param", f"k={KEY.hex()}", *more
        )
        assert "ask" in out
        printed += out
    everything = printed.encode() + written_data(tmp_path)
    for secret in (KEY, OTHER, DERIVED, PASSWORD.encode()):
        assert not shows(everything, secret)
    for form_of in (
        KEY,
        KEY.hex().encode(),
        KEY.hex(" ").upper().encode(),
        repr(KEY).encode(),
        str(list(KEY)).encode(),
    ):
        assert shows(b"log: " + form_of + b"\n", KEY), "the search itself finds it"


@pytest.mark.parametrize("wrong", [KEY.hex() + "11", KEY.hex()[:-1], f"[{KEY.hex()}]", f"h'{KEY.hex()}' + 1"])
def test_a_key_that_does_not_fit_is_not_shown(capsys: pytest.CaptureFixture[str], tmp_path: Path, wrong: str) -> None:
    (tmp_path / "sealed.yaml").write_text(PROTOCOL)
    (tmp_path / "one.device.yaml").write_text(DEVICE.format(key=KEY.hex(), word=PASSWORD))
    (tmp_path / "one.run.yaml").write_text(RUN.format(key=f'"{wrong}"', word=PASSWORD))
    status, out = call(capsys, "run", str(tmp_path / "one.run.yaml"), "--virtual", "--for", "1s")
    assert status == 1 and "'k'" in out and KEY.hex()[:20] not in out.replace(" ", "").lower()
    status, out = call(capsys, "decode", str(tmp_path / "sealed.yaml"), "51", "--param", f"k={wrong}")
    assert status != 0 and KEY.hex()[:20] not in out.replace(" ", "").lower()
