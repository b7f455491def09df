"""Gateways as separate programs with Debian's mosquitto: listed, lost, found again, and given other run files."""

from __future__ import annotations

import json
import os
import random
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from points.mosquitto import Broker, Listener, needs_mosquitto

from framekit.api.replaced_file import ReplacedFile, digest_of
from framekit.cli.main import main
from framekit.extras.fleet.fleet import Fleet, Member
from framekit.sinks.broker import BrokerAccess, Place

TOKEN = "a token of many letters"
DEVICE = """device: meter
protocol: modbus-tcp
station: 1
behave: {"40001": {counter: 1, every: 100 ms}}
"""
RUN = """run: meter
channels:
  1: {{port: "sim:meter.device.yaml", protocol: modbus-tcp, station: 1}}
points:
  count: {{channel: 1, address: "40001", every: 100 ms}}
sinks:
  - {{jsonl: rows.jsonl}}
  - {{mqtt: "127.0.0.1:{port}", topic: "{name}/{{point}}", payload: plain}}
fleet: {{broker: "127.0.0.1:{port}", name: {name}{more}}}
"""


def write_run(folder: Path, name: str, port: int, more: str = ', token: "env:FLEET_TOKEN"') -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "meter.device.yaml").write_text(DEVICE, "utf-8")
    path = folder / "meter.run.yaml"
    path.write_text(RUN.format(port=port, name=name, more=more), "utf-8")
    return path


@contextmanager
def gateway(path: Path, *options: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run `framekit run` on a file, and end it like a service manager."""
    words = [sys.executable, "-m", "framekit", "run", str(path), "--json", *options]
    with (path.parent / "printed").open("ab") as printed:
        process = subprocess.Popen(
            words, stdout=printed, stderr=printed, cwd=path.parent, env=os.environ | {"FLEET_TOKEN": TOKEN}
        )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGTERM)
        process.wait(30)


class Watcher:
    """A fleet with its change notifications."""

    def __init__(self, port: int) -> None:
        self._change = threading.Condition()
        self.fleet = Fleet(BrokerAccess(Place("127.0.0.1", port)), "framekit", self._changed)

    def _changed(self, name: str) -> None:
        with self._change:
            self._change.notify_all()

    def wait(self, name: str, until: Callable[[Member], object]) -> Member:
        """Return the gateway as soon as a condition on it is true."""
        with self._change:
            is_true = self._change.wait_for(
                lambda: name in self.fleet.members and until(self.fleet.members[name]), timeout=60
            )
        assert is_true, self.fleet.members
        return self.fleet.members[name]

    def __enter__(self) -> Watcher:
        return self

    def __exit__(self, *_: object) -> None:
        self.fleet.close()


def wait_for(holds: Callable[[], object]) -> None:
    """Poll until a condition holds that no notification reports."""
    until = time.monotonic() + 60
    while not holds():
        assert time.monotonic() < until
        time.sleep(0.02)


def is_well(member: Member) -> bool:
    """Return whether it is running and reads its point."""
    return member.online and member.health.get("bad") == [] and not member.troubles


def rows(path: Path) -> list[Any]:
    """Return the good values that a run has stored, in order."""
    found = [json.loads(line) for line in path.read_text("utf-8").splitlines()]
    return [record["value"] for record in found if record["quality"] == "good"]


@needs_mosquitto
def test_gateways_are_listed_and_told_of_when_they_end_or_are_killed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with Broker(tmp_path) as broker, Watcher(broker.port) as watcher:
        first = write_run(tmp_path / "one", "one", broker.port)
        second = write_run(tmp_path / "two", "two", broker.port, "")
        with gateway(first), gateway(second) as killed:
            assert watcher.wait("one", is_well).said("run") == "meter"
            assert watcher.wait("one", is_well).takes_files and not watcher.wait("two", is_well).takes_files
            assert main(["fleet", f"127.0.0.1:{broker.port}"]) == 0
            shown = capsys.readouterr().out.splitlines()
            listed = [line.split() for line in shown[1:]]
            assert [(*words[:2], words[3]) for words in listed] == [("one", "up", "meter"), ("two", "up", "meter")]
            assert all(words[2].startswith("20") and words[2].endswith("Z") for words in listed)
            killed.kill()
            watcher.wait("two", lambda member: not member.online)
        watcher.wait("one", lambda member: not member.online)
        assert main(["fleet", f"127.0.0.1:{broker.port}", "one", "--json"]) == 0
        listed = json.loads(capsys.readouterr().out)
        assert listed["gateway"] == "one" and not listed["online"] and listed["points"] == 1 and "number" not in listed
        assert main(["fleet", f"127.0.0.1:{broker.port}", "three"]) == 1
        assert "there is no gateway 'three'" in capsys.readouterr().err


@needs_mosquitto
def test_what_is_wrong_with_a_gateway_is_told(tmp_path: Path) -> None:
    with Broker(tmp_path) as broker, Watcher(broker.port) as watcher:
        path = write_run(tmp_path / "one", "one", broker.port)
        path.write_text(path.read_text().replace("sim:meter.device.yaml", "tcp://127.0.0.1:1"))
        with gateway(path):
            member = watcher.wait("one", lambda member: member.health.get("down"))
            assert member.online and member.health["bad"] == ["count"]
            assert member.troubles[:2] == ["not open: channel 1", "not good: point count"]


@pytest.mark.long
@needs_mosquitto
def test_a_run_file_is_rolled_out_or_refused_whole(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with Broker(tmp_path) as broker, Watcher(broker.port) as watcher:
        path = write_run(tmp_path / "one", "one", broker.port)
        other = write_run(tmp_path / "two", "two", broker.port, "")
        old, place = path.read_text(), f"127.0.0.1:{broker.port}"
        path.with_name("db.password").write_text("S3cr3t: {very: S3cr3t}\n")
        rolled = tmp_path / "rolled.run.yaml"

        def roll(text: str, token: str = TOKEN, name: str = "one") -> tuple[int, list[str]]:
            rolled.write_text(text)
            monkeypatch.setenv("ROLLING", token)
            status = main(["fleet", place, name, "--roll", str(rolled), "--token", "env:ROLLING"])
            return status, capsys.readouterr().out.splitlines()

        with gateway(path), gateway(other):
            watcher.wait("one", is_well)
            watcher.wait("two", is_well)
            wrong = {
                "every: 100 ms": ("every: soon", "meter.run.yaml:5:48: 'soon' is not a time"),
                "rows.jsonl": ("../rows.jsonl", "is not in the folder of the run file"),
                "payload: plain": (
                    "payload: plain, user: a, password: env:HOME",
                    "a sink with a secret, or one that the system gives",
                ),
                "jsonl: rows.jsonl": ("prometheus: '0.0.0.0:0'", "0.0.0.0:0 can be reached from outside"),
                "rows.jsonl}": ("printed}", "printed', or a file named after it, is there already"),
                "{jsonl: rows.jsonl}": ("{jsonl: site.py}", "'site.py' is not the name of a data file"),
                "channel: 1, address": ("channel: 1, scale: {}, address", "meter.run.yaml:5:"),
                "protocol: modbus-tcp": ("protocol: db.password", "db.password: this file has 2 problems"),
                "{jsonl: rows.jsonl": ("{jsonl: meter.run.yaml.before", "there already"),
                'port: "sim:meter.device.yaml"': ("port: 'spy:///dev/null?file=rows'", "writes into a file"),
                "- {jsonl: rows.jsonl": ("- {postgres: 'postgresql://127.0.0.1:1/x'", "one that the system gives"),
                "sim:meter.device": (f"sim:{'a' * 300}.device", "there is no file 'aaaa"),
                "name: one": ("name: two", "a rolled file stays in its fleet"),
                "run: meter": ("run: [", "meter.run.yaml:"),
            }
            for part, (instead, told) in wrong.items():
                status, lines = roll(old.replace(part, instead))
                assert status == 1 and lines[0] == "one: refused" and told in "\n".join(lines[1:]), lines
                assert "S3cr3t" not in "".join(lines)
                assert path.read_text() == old
            assert "signed" in roll(old, "another token of letters")[1][1]
            assert roll(old, name="two") == (
                1,
                ["two: not done", "  it takes no files: its run file has no fleet: token:"],
            )
            assert roll(old, name="three") == (1, ["three: not done", "  it is not there"])

            assert roll(old) == (0, ["one: it is this file already; what it names beside counts from a new start on"])
            more = old.replace("sinks:", "  second: {channel: 1, address: '40001', every: 100 ms}\nsinks:")
            assert roll(more) == (0, ["one: begun anew"])
            assert path.read_text() == more and path.with_name("meter.run.yaml.before").read_text() == old
            assert watcher.wait("one", lambda one: is_well(one) and one.birth["points"] == 2).online
            blocks = 'memory: masterlogic\nblocks: {0: {read: "40001", into: "%MW0", channel: 1, every: 1 s}}\n'
            status, lines = roll(more.replace("sinks:", f"{blocks}sinks:"))
            assert (status, lines) == (0, ["one: begun anew"])
            status, lines = roll(more.replace("sinks:", f"{blocks}sinks:").replace("every: 1 s", "every: 2 s"))
            assert (status, lines) == (0, ["one: applied while it goes on: block 0 changed"])
        counted = rows(path.with_name("rows.jsonl"))
        assert counted and not {"Traceback", "S3cr3t"} & set(re.findall(r"\w+", path.with_name("printed").read_text()))


def test_a_file_that_is_too_large_or_no_text_is_not_sent(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "token").write_text(TOKEN)
    rolled = tmp_path / "rolled.run.yaml"
    for content, told in ((b"#" * ((1 << 20) + 1), "more than 1048576 bytes"), (b"\xff", "no text in UTF-8")):
        rolled.write_bytes(content)
        words = ["fleet", "127.0.0.1:1", "one", "--roll", str(rolled), "--token", f"file:{tmp_path / 'token'}"]
        assert main(words) == 1
        assert told in capsys.readouterr().err


@pytest.mark.long
@needs_mosquitto
def test_a_run_that_cannot_begin_is_the_one_of_before_again(tmp_path: Path) -> None:
    with Broker(tmp_path) as broker, Watcher(broker.port) as watcher:
        path = write_run(tmp_path / "one", "one", broker.port)
        old = path.read_bytes()
        with gateway(path):
            watcher.wait("one", is_well)
            wrong = old.replace(b"sinks:", b"memory: masterlogic\nstate: kept.state\nsinks:")
            for text in (wrong, old):  # the first text makes the state file one of this gateway's own files
                (answer,) = watcher.fleet.roll(["one"], text, TOKEN)
                assert answer.ok, answer
                watcher.wait("one", is_well)
            before = path.with_name("meter.run.yaml.before").read_bytes()
            path.with_name("kept.state").write_text("this is no state")
            (answer,) = watcher.fleet.roll(["one"], wrong, TOKEN)
            assert not answer.ok and "kept.state is no state file" in answer.problems[0], answer
            assert path.read_bytes() == old and path.with_name("meter.run.yaml.before").read_bytes() == before == wrong
            watcher.wait("one", is_well)
            lost = old.replace(b"sinks:\n", b"sinks:\n  - {csv: meter.device.yaml/lost.csv}\n")
            (answer,) = watcher.fleet.roll(["one"], lost, TOKEN)
            assert not answer.ok and "meter.device.yaml/lost.csv cannot be opened" in answer.problems[0], answer
            assert path.read_bytes() == old
            watcher.wait("one", is_well)
            part = path.with_name(".meter.run.yaml.part")
            part.mkdir()
            other, before = old.replace(b"run: meter", b"run: other"), len(rows(path.with_name("rows.jsonl")))
            blocks = b'memory: masterlogic\nblocks: {0: {read: "40001", into: "%MW0", channel: 1, every: 1 s}}\nsinks:'
            for text in (other, old.replace(b"sinks:", blocks)):
                (answer,) = watcher.fleet.roll(["one"], text, TOKEN)
                assert not answer.ok and "cannot be replaced" in answer.problems[0], answer
                assert path.read_bytes() == old
            wait_for(lambda: len(rows(path.with_name("rows.jsonl"))) > before + 3)  # the run goes on
            assert not list(path.parent.glob("*.trial"))
            part.rmdir()
            (answer,) = watcher.fleet.roll(["one"], other, TOKEN)
            assert answer.ok
            assert watcher.wait("one", lambda one: is_well(one) and one.said("run") == "other").online


@pytest.mark.long
@needs_mosquitto
def test_what_was_rolled_out_once_cannot_be_sent_again(tmp_path: Path) -> None:
    with Broker(tmp_path) as broker, Watcher(broker.port) as watcher:
        path = write_run(tmp_path / "one", "one", broker.port)
        old = path.read_bytes()
        with gateway(path), Listener(broker.port, "framekit/one/#") as listener:
            watcher.wait("one", is_well)
            first = old.replace(b"run: meter", b"run: first")
            (answer,) = watcher.fleet.roll(["one"], first, TOKEN)
            assert answer.ok
            watcher.wait("one", lambda one: one.said("run") == "first")
            (answer,) = watcher.fleet.roll(["one"], old, TOKEN)
            assert answer.ok
            watcher.wait("one", lambda one: one.said("run") == "meter")
            message = listener.of("framekit/one/roll")[0]
            listener.wait(lambda: len(listener.of("framekit/one/rolled")) == 2)
            listener.say("framekit/one/roll", message.decode())
            listener.wait(lambda: len(listener.of("framekit/one/rolled")) == 3)
            assert b"was sent before" in listener.of("framekit/one/rolled")[-1]
            listener.wait(lambda: listener.of("framekit/one/birth"))
            instance = json.loads(listener.of("framekit/one/birth")[-1])["instance"]
            mine = f'"id": "1", "instance": "{instance}"'
            some = (
                f'{{{mine}, "file": 3, "signature": "x"}}',
                f'{{{mine}, "file": "", "signature": "é"}}',
                '{"id": 5}',
            )
            odd = f'{{"instance": "{instance}", "id": "\\ud800", "file": "\\ud800", "signature": "\\ud800"}}'
            for rubbish in ("", "[]", "{", "\0" * 10, odd, *some):
                listener.say("framekit/one/roll", rubbish)
            (answer,) = watcher.fleet.roll(["one"], old, TOKEN)
            assert answer.ok
        assert path.read_bytes() == old


@pytest.mark.long
@needs_mosquitto
def test_a_broker_that_starts_again_hears_of_all_anew(tmp_path: Path) -> None:
    with Broker(tmp_path) as broker, Watcher(broker.port) as watcher:
        path = write_run(tmp_path / "one", "one", broker.port)
        with gateway(path), Listener(broker.port, "one/count", qos=0) as listener:
            watcher.wait("one", is_well)
            broker.kill()
            watcher.wait("one", lambda one: not one.online)
            listener.listens = False
            kept = len(rows(path.with_name("rows.jsonl")))
            wait_for(lambda: len(rows(path.with_name("rows.jsonl"))) >= kept + 5)
            watcher.fleet.members.clear()
            broker.start()
            watcher.wait("one", is_well)
            last = rows(path.with_name("rows.jsonl"))[-1]
            listener.wait(lambda: str(last).encode() in listener.of("one/count"))


@pytest.mark.long
@needs_mosquitto
def test_a_trial_that_a_kill_cut_off_is_over(tmp_path: Path) -> None:
    with Broker(tmp_path) as broker, Watcher(broker.port) as watcher:
        path = write_run(tmp_path / "one", "one", broker.port)
        old = path.read_bytes()
        ReplacedFile(path).put(old.replace(b"run: meter", b"run: other"))
        with gateway(path):
            assert watcher.wait("one", is_well).said("run") == "meter" and path.read_bytes() == old
        assert not list(path.parent.glob("*.trial")) and not list(path.parent.glob("*.before"))


@pytest.mark.long
@needs_mosquitto
def test_two_of_one_name_are_told_and_both_go_on(tmp_path: Path) -> None:
    with Broker(tmp_path) as broker, Watcher(broker.port) as watcher:
        first = write_run(tmp_path / "one", "same", broker.port)
        second = write_run(tmp_path / "two", "same", broker.port)
        with gateway(first), Listener(broker.port, "framekit/same/online") as listener:
            watcher.wait("same", is_well)
            with gateway(second):
                member = watcher.wait("same", lambda one: one.troubles)
                assert "problem: another gateway is called 'same' too" in member.troubles
            listener.wait(lambda: listener.of("framekit/same/online")[-2:] == [b"0", b"1"])  # the first is listed


@pytest.mark.long
@needs_mosquitto
def test_what_gives_no_sign_of_life_is_silent(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with Broker(tmp_path) as broker, Listener(broker.port, "framekit/#") as listener:
        births = {
            "online": "1", "birth": json.dumps({"run": "\x1b[2Jx\x9b", "version": "1"}),
            "health": '{"at": "2026-01-01T00:00:00Z", "waiting": 5000}',
        }  # fmt: skip
        for what, said in births.items():
            listener.say(f"framekit/old/{what}", said, retain=True)
        listener.wait(lambda: listener.of("framekit/old/health"))
        assert main(["fleet", f"127.0.0.1:{broker.port}"]) == 0
        shown = capsys.readouterr().out
        assert shown.splitlines()[1].split() == [
            "old", "silent", "\\x1b[2Jx\\x9b", "1", "5000", "samples", "wait", "for", "a", "server",
        ]  # fmt: skip
        assert main(["fleet", f"127.0.0.1:{broker.port}", "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["online"] is False


@pytest.mark.long
@needs_mosquitto
def test_a_watch_tells_what_changes(tmp_path: Path) -> None:
    with Broker(tmp_path) as broker, Watcher(broker.port) as watcher:
        path = write_run(tmp_path / "one", "one", broker.port, "")
        background = ["sh", "-c", 'trap "" INT; exec "$@"', "sh"]  # as shells start jobs in the background
        words = [*background, sys.executable, "-m", "framekit", "fleet", f"127.0.0.1:{broker.port}", "--watch"]
        output_file = tmp_path / "told"
        with gateway(path, "--watch"), output_file.open("wb") as printed:
            watcher.wait("one", is_well)
            watching = subprocess.Popen(words, stdout=printed, stderr=printed)
            try:
                wait_for(lambda: "up" in output_file.read_text().split())
                first = watcher.wait("one", is_well).said("file")
                path.write_text(f"{path.read_text()}# edited\n")
                digest = watcher.wait("one", lambda one: one.said("file") != first).said("file")
                assert digest == digest_of(path.read_bytes())
                wait_for(lambda: digest in output_file.read_text())
                broker.kill()
                wait_for(lambda: "has gone" in output_file.read_text() and "one  down" in output_file.read_text())
            finally:
                watching.send_signal(signal.SIGINT)
                assert watching.wait(30) == 0


@pytest.mark.long
def test_a_file_is_the_old_one_or_the_new_one_when_its_writer_is_killed(tmp_path: Path) -> None:
    path = tmp_path / "some"
    contents = [bytes([digit]) * 300_000 for digit in b"ab"]
    path.write_bytes(contents[0])
    path.chmod(0o640)
    program = (
        "import sys; from pathlib import Path; from framekit.api.replaced_file import ReplacedFile\n"
        "file = ReplacedFile(Path(sys.argv[1])); print(flush=True)\n"
        "while True:\n for digit in b'ab': file.put(bytes([digit]) * 300_000)\n"
    )
    for turn in range(8):
        with subprocess.Popen([sys.executable, "-c", program, str(path)], stdout=subprocess.PIPE) as process:
            assert process.stdout is not None
            process.stdout.readline()
            time.sleep(random.Random(turn).random() / 20)
            process.kill()
        content = path.read_bytes()
        assert content in contents and path.stat().st_mode & 0o777 == 0o640
        ReplacedFile(path).settle()
        assert path.read_bytes() in contents and not list(tmp_path.glob("*.trial"))


def test_a_link_stays_one(tmp_path: Path) -> None:
    real = tmp_path / "real.yaml"
    real.write_bytes(b"old")
    (tmp_path / "link.yaml").symlink_to(real)
    file = ReplacedFile(tmp_path / "link.yaml")
    file.put(b"new")
    assert real.read_bytes() == b"new" and (tmp_path / "link.yaml").is_symlink()
    assert file.settle() and real.read_bytes() == b"old" and not file.settle()


@needs_mosquitto
@pytest.mark.long
def test_a_kill_leaves_the_old_file_or_the_new_one(tmp_path: Path) -> None:
    with Broker(tmp_path) as broker, Watcher(broker.port) as watcher:
        path = write_run(tmp_path / "one", "one", broker.port)
        old = path.read_bytes()
        new = old.replace(b"sinks:", b"  second: {channel: 1, address: '40001'}\nsinks:")
        for turn in range(3):
            with gateway(path) as process:
                watcher.wait("one", is_well)
                rolling = threading.Thread(target=watcher.fleet.roll, args=(["one"], new, TOKEN, 1 + turn / 10))
                rolling.start()
                time.sleep(turn / 100)
                process.kill()
                process.wait()
                rolling.join()
            assert path.read_bytes() in (old, new)
            watcher.wait("one", lambda one: not one.online)
            path.write_bytes(old)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("a:b", "'a:b' is no address of a broker – write HOST or HOST:PORT"),
        ("a --all", "--all has no effect without --roll"),
        ("a --roll x.run.yaml --all --token env:HOME --within 1000000h", "--within: write a day at most"),
        ("a..b", "'a..b' is no address of a broker"),
        ("a --within 3s", "--within has no effect without --roll"),
        ("a --token env:HOME", "--token has no effect without --roll"),
        ("a --for 3s", "--for has no effect without --watch"),
        ("a --roll x.run.yaml --all", "--roll needs --token: where the token of these gateways stands"),
        ("a --roll x.run.yaml --token env:HOME", "--roll needs the names of gateways, or --all"),
        ("a one --all --roll x.run.yaml --token env:HOME", "--roll needs the names of gateways, or --all"),
        (
            "a --roll x.run.yaml --all --watch --token env:HOME",
            "--roll ends with the answers – leave --watch and --for",
        ),
        ("a --all --roll x.run.yaml --token secret", "--token: a token does not stand on the command line"),
        ("a --group a/b", "--group: 'a/b' is no name here – write up to 64 characters without / + #"),
        ("a --password env:HOME", "--password has no effect without --user"),
        ("a --user me --password 123", "--password: a password does not stand on the command line"),
        ("a --tls none.pem", "--tls: there is no file 'none.pem'"),
    ],
)
def test_words_that_say_nothing_are_refused(words: str, told: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fleet", *words.split()]) == 2
    assert f"framekit fleet: {told}" in capsys.readouterr().err


def test_a_broker_that_is_not_there_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fleet", "127.0.0.1:1"]) == 1
    assert "framekit fleet: the broker 127.0.0.1:1 cannot be reached:" in capsys.readouterr().err


def test_keys_of_a_fleet_are_checked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_run(tmp_path / "one", "a/b", 99999, ", password: secret, token: abc")
    assert main(["check", str(path)]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert [line.partition("meter.run.yaml:")[2] for line in lines if ":9:" in line] == [
        "9:17: '127.0.0.1:99999' is no address of a broker – write HOST or HOST:PORT",
        "9:42: 'a/b' is no name here – write up to 64 characters without / + #",
        "9:57: a secret does not stand in a run file – write env:NAME for the environment, or file:NAME",
        "9:72: a secret does not stand in a run file – write env:NAME for the environment, or file:NAME",
    ]


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--screen"], "--screen is not for runs of a fleet"),
        (["--capture", "x.pcap"], "--capture is not for runs that files are rolled out to"),
        (["--watch"], "--watch is not for runs that files are rolled out to"),
    ],
)
def test_what_has_no_place_in_a_fleet(
    options: list[str], told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_run(tmp_path / "one", "one", 1883)
    assert main(["run", str(path), "--for", "1s", *options]) == 2
    assert told in capsys.readouterr().err


def test_a_token_that_cannot_be_used_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_run(tmp_path / "one", "one", 1883)
    monkeypatch.delenv("FLEET_TOKEN", raising=False)
    assert main(["run", str(path), "--for", "1s"]) == 1
    assert "fleet: what is secret is to stand in the environment as FLEET_TOKEN" in capsys.readouterr().err
    monkeypatch.setenv("FLEET_TOKEN", "short")
    assert main(["run", str(path), "--for", "1s"]) == 1
    assert "fleet: the token has 5 characters – give 12 or more" in capsys.readouterr().err


@pytest.mark.long
@needs_mosquitto
def test_what_was_changed_while_a_run_goes_on_stays_changed(tmp_path: Path) -> None:
    """Also if exchanges have failed, and with JSON output."""
    with Broker(tmp_path) as broker, Watcher(broker.port) as watcher:
        path = write_run(tmp_path / "one", "one", broker.port)
        (path.parent / "other.device.yaml").write_text(DEVICE.replace("device: meter", "device: other"), "utf-8")
        silent = path.read_text().replace("sim:meter.device.yaml", "tcp://127.0.0.1:1")
        path.write_text(silent)
        with gateway(path):
            watcher.wait("one", lambda one: one.health.get("bad"))
            other = silent.replace("tcp://127.0.0.1:1", "sim:other.device.yaml")
            more = other.replace("sinks:", "  second: {channel: 1, address: '40001'}\nsinks:")
            answers = []
            for text in (other, more):
                answers += watcher.fleet.roll(["one"], text.encode(), TOKEN)
                (path.parent / "meter.device.yaml").unlink(missing_ok=True)
            assert [answer.ok for answer in answers] == [True, True], answers
            assert answers[0].how.startswith("applied while it goes on: channel 1 changed"), answers
            watcher.wait("one", lambda one: is_well(one) and one.birth["points"] == 2)
            assert path.read_text() == more
        assert "Traceback" not in path.with_name("printed").read_text()


@pytest.mark.long
@needs_mosquitto
def test_one_process_at_a_time_takes_files_for_a_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with Broker(tmp_path) as broker, Watcher(broker.port) as watcher:
        path = write_run(tmp_path / "one", "one", broker.port)
        old = path.read_bytes()
        with gateway(path), pytest.MonkeyPatch.context() as patch:
            patch.setenv("FLEET_TOKEN", TOKEN)
            watcher.wait("one", is_well)
            ReplacedFile(path).put(old.replace(b"run: meter", b"run: other"))
            assert not ReplacedFile(path).settle() and path.read_bytes() != old  # left to the running gateway
            assert main(["run", str(path), "--for", "1s"]) == 1
            assert "another process takes files for meter.run.yaml already" in capsys.readouterr().err
        assert ReplacedFile(path).settle() and path.read_bytes() == old


@pytest.mark.long
@needs_mosquitto
def test_control_lines_come_to_the_run_at_work(tmp_path: Path) -> None:
    with Broker(tmp_path) as broker, Watcher(broker.port) as watcher:
        path = write_run(tmp_path / "one", "one", broker.port)
        words = [sys.executable, "-m", "framekit", "run", str(path), "--control"]
        with subprocess.Popen(
            words, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, cwd=path.parent,
            env=os.environ | {"FLEET_TOKEN": TOKEN},
        ) as process:  # fmt: skip
            watcher.wait("one", is_well)
            for name in (b"a", b"b"):
                text = path.read_bytes().replace(b"run: ", b"run: " + name)
                (answer,) = watcher.fleet.roll(["one"], text, TOKEN)
                assert answer.ok
            assert process.stdin is not None
            process.stdin.write("stop\n")
            process.stdin.flush()
            assert process.wait(30) == 0


@needs_mosquitto
def test_odd_messages_break_no_list(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with Broker(tmp_path) as broker, Listener(broker.port, "framekit/#") as listener:
        listener.say("framekit/odd/birth", '{"run": "\\ud800", "points": NaN}', retain=True)
        listener.say("framekit/odder/birth", '{"run": "\\ud800"}', retain=True)
        listener.wait(lambda: listener.of("framekit/odder/birth"))
        assert main(["fleet", f"127.0.0.1:{broker.port}", "--json"]) == 0
        assert [json.loads(line)["gateway"] for line in capsys.readouterr().out.splitlines()] == ["odd", "odder"]
