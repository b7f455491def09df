"""Command blocks that establish jobs, executed by the verb with our own server over real TCP."""

from __future__ import annotations

import json
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import framekit
from framekit.cli.main import main
from framekit.extras.commreq.commreq_verb import CommandOutput

DEVICE = 'device: plc\nprotocol: srtp\nmemory: {sizes: {"%R1": 100}, set: {"%R50": [1, 2, 3, 4, 5, 6, 7, 8]}}\n'


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[framekit.Server]:
    device = tmp_path_factory.mktemp("plc") / "plc.device.yaml"
    device.write_text(DEVICE, encoding="utf-8")
    with framekit.serve(device, "tcp://127.0.0.1:0") as serving:
        yield serving


def transfer(
    number: int, *, slot: int = 5, times: int = 1, every: int = 1, remote: int = 50, count: int = 4
) -> list[str]:
    """Return the words of a read (2003) or write (2004) job with periods of 10 ms and %R100 as own memory."""
    words = [number, slot, times, 1, every, 0, 8, 100, 8, remote, count, 1, 4, 3, 0, 0, 1]
    return [str(word) for word in words]


def commreq(server: framekit.Server, *words: str, application: str = "ge-channels") -> int:
    return main(["commreq", "srtp", "--commands", application, "--port", server.port, *words])


def shown(capsys: pytest.CaptureFixture[str]) -> list[str]:
    return capsys.readouterr().out.splitlines()


def test_one_read(server: framekit.Server, capsys: pytest.CaptureFixture[str]) -> None:
    assert commreq(server, *transfer(2003, every=6000)) == 0
    lines = shown(capsys)
    assert lines[1:3] == [
        "does     reads %R50 (4 × word) into the own %R100",
        "         as the job in slot 5, with 3.0.0.1, every 1 min, 1 times",
    ]
    assert lines[3:] == ["%R100    1 2 3 4", "status   %R1 = 0x0001 success"]


def test_repetitions_are_carried_out(server: framekit.Server, capsys: pytest.CaptureFixture[str]) -> None:
    assert commreq(server, "--json", *transfer(2003, times=4, every=2)) == 0
    command, *rest = (json.loads(line) for line in shown(capsys))
    assert command["status"] in (1, 0x0290), "late on a busy machine"
    ends = [event["transfers"] for event in rest if not event["late"]]
    assert ends[-1] == 4 and rest[-1]["active"] is False and rest[-1]["time"] >= 0.06


def test_a_write_and_what_it_needs(server: framekit.Server, capsys: pytest.CaptureFixture[str]) -> None:
    assert commreq(server, "--set", "%R100=11,12", *transfer(2004, remote=60, count=2, every=6000)) == 1
    assert shown(capsys)[-1] == "status   %R1 = 0x008B client: illegal service request (not_allowed)"
    write = transfer(2004, remote=60, count=2, every=6000)
    assert commreq(server, "--param", "allow=writes", "--set", "%R100=11,12", *write) == 0
    assert server.memory.read("%R60", 2) == [11, 12]


def test_commands_follow_each_other_and_abort_what_is_endless(
    server: framekit.Server, capsys: pytest.CaptureFixture[str]
) -> None:
    details, abort = ["2002", "5", "8", "200"], ["2001", "5"]
    assert commreq(server, *transfer(2003, times=0, every=6000), "+", *details, "+", *abort) == 0
    lines = shown(capsys)
    assert "%R200    1 1" in lines and sum(line.endswith("= 0x0001 success") for line in lines) == 3


@pytest.mark.parametrize("interrupted", [False, True])
def test_an_endless_job_ends_with_its_time_or_when_somebody_stops_it(
    server: framekit.Server, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, interrupted: bool
) -> None:
    """Exit status is 0: the command has been answered, and the completed transfer is shown."""
    show = CommandOutput.show

    def shown_and_stopped(*given: Any) -> None:
        show(*given)
        signal.raise_signal(signal.SIGINT)

    limit = ["--for", "1s"]
    if interrupted:
        limit = []
        monkeypatch.setattr(CommandOutput, "show", shown_and_stopped)
    assert commreq(server, *limit, *transfer(2003, times=0, every=6000)) == 0
    assert shown(capsys)[1:] == [
        "does     reads %R50 (4 × word) into the own %R100",
        "         as the job in slot 5, with 3.0.0.1, every 1 min, until it is aborted",
        "%R100    1 2 3 4",
        "status   %R1 = 0x0001 success",
    ]


def test_what_the_device_refuses(server: framekit.Server, capsys: pytest.CaptureFixture[str]) -> None:
    assert commreq(server, *transfer(2003, remote=90, count=20, every=6000)) == 1
    assert shown(capsys)[-1] == "status   %R1 = 0xF405 server: service request error: invalid input parameter"


@pytest.mark.parametrize(
    ("words", "status", "told"),
    [
        (transfer(2003, slot=17), 1, "status   %R1 = 0x8890 client: invalid channel number"),
        (
            [*transfer(2010)[:8], "4", "0", "0", *transfer(2010)[11:]],
            1,
            "status   %R1 = 0x008B client: illegal service",
        ),
        (["channel_abort", "channel=5", "wait=1"], 2, ""),
        (["6101", "1"], 1, "status   %R1 = 0x9E90 client: unrecognised command code"),
    ],
)
def test_refusals_and_faults(
    server: framekit.Server, capsys: pytest.CaptureFixture[str], words: list[str], status: int, told: str
) -> None:
    assert commreq(server, *words) == status
    lines = shown(capsys)
    assert (lines[-1] if lines else "").startswith(told)


def test_nobody_is_there(capsys: pytest.CaptureFixture[str]) -> None:
    words = transfer(2003, every=6000)
    assert main(["commreq", "srtp", "--commands", "ge-channels", "--port", "tcp://127.0.0.1:1", *words]) == 3
    out, err = capsys.readouterr()
    assert err.startswith("framekit commreq: no connection to 127.0.0.1:1: Connection refused – nothing listens")
    status = out.splitlines()[-1]
    assert status.startswith("status   %R1 = 0x9690 client: TCP connection reset by the server (not_connected")


def test_the_host_of_the_words_may_be_the_port(server: framekit.Server, capsys: pytest.CaptureFixture[str]) -> None:
    port = server.port.replace("127.0.0.1", "{host}")
    words = [*transfer(2003, every=6000)[:-4], "127", "0", "0", "1"]
    assert main(["commreq", "srtp", "--commands", "ge-channels", "--port", port, *words]) == 0
    assert shown(capsys)[-1] == "status   %R1 = 0x0001 success"


def test_ports_and_times_that_are_none(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    words = transfer(2003)
    assert main(["commreq", "srtp", "--commands", "ge-channels", "--port", "nix://1", *words]) == 2
    assert "is no port" in capsys.readouterr().err
    assert main(["commreq", "srtp", "--commands", "ge-channels", "--port", f"sim:{tmp_path}/none.yaml", *words]) == 2
    assert "there is no file" in capsys.readouterr().err
    assert main(["commreq", "ccm", "--port", "nix://1", "--for", "1s", "6101", "36", "9", "1"]) == 2
    assert "--for is for commands that repeat" in capsys.readouterr().err
