"""Check of a run file: all problems that do not follow from others are reported together."""

from __future__ import annotations

from pathlib import Path

import pytest

from framekit.runfile.run_file import read_run

HEAD = "run: plant\nchannels:\n"


def problems(folder: Path, text: str) -> list[str]:
    """Return the errors of a run file without its name."""
    path = folder / "plant.run.yaml"
    return [str(problem).removeprefix(f"{path}:") for problem in read_run(path, text).problems if not problem.warning]


def channel(number: int, keys: str) -> str:
    return f"  {number}: {{{keys}}}\n"


# ---- numbers of ports ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("port", "problem"),
    [
        ("tcp://127.0.0.1:99999", "'127.0.0.1:99999': the number of a port is 65535 at most – write another one"),
        ("tcp://[::1]:65536", "'[::1]:65536': the number of a port is 65535 at most – write another one"),
        ("tls://127.0.0.1:99999", "'127.0.0.1:99999': the number of a port is 65535 at most – write another one"),
        ("udp://127.0.0.1:99999", "'127.0.0.1:99999': the number of a port is 65535 at most – write another one"),
        ("socket://127.0.0.1:99999", "'127.0.0.1:99999': the number of a port is 65535 at most – write another one"),
        (
            "rfc2217://10.0.0.1:99999?logging=info",
            "'10.0.0.1:99999': the number of a port is 65535 at most – write another one",
        ),
        (
            "tcp://127.0.0.1:abc",
            "'127.0.0.1:abc' is not HOST:PORT – write the number of the port, as in 127.0.0.1:4001",
        ),
        ("socket://10.0.0.1", "'10.0.0.1' is not HOST:PORT – write the number of the port, as in 10.0.0.1:4001"),
    ],
)  # fmt: skip
def test_the_number_of_a_port_is_checked(tmp_path: Path, port: str, problem: str) -> None:
    text = (
        HEAD
        + channel(1, f'port: "{port}", protocol: modbus-rtu, station: 1')
        + 'points: {a: {channel: 1, address: "40001"}}\n'
    )
    assert problems(tmp_path, text) == [f"3:13: {problem}"]


def test_the_number_of_a_listening_port_is_checked(tmp_path: Path) -> None:
    text = "run: plant\nmemory: {areas: {R: {unit: word, size: 10}}}\nchannels:\n" + channel(
        1, "port: tcp-listen://127.0.0.1:70000, protocol: modbus-tcp, role: server"
    )
    what = "'127.0.0.1:70000': the number of a port is 65535 at most – write another one"
    assert problems(tmp_path, text)[:1] == [f"4:13: {what}"]


@pytest.mark.parametrize("port", ["tcp://10.0.0.1", "tcp://10.0.0.1:502", "udp://[::1]:5000", "socket://10.0.0.1:4001"])
def test_a_good_port_has_no_problem(tmp_path: Path, port: str) -> None:
    text = (
        HEAD
        + channel(1, f'port: "{port}", protocol: modbus-tcp, station: 1')
        + 'points: {a: {channel: 1, address: "40001"}}\n'
    )
    assert problems(tmp_path, text) == []


# ---- points on a channel with an error -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("keys", "place", "problem"),
    [
        ("port: /dev/ttyX, protocol: modbus-rtu, station: 300", 55, "station 300 is not in 0..255"),
        (
            "port: tcp://10.0.0.1:99999, protocol: modbus-rtu, station: 3", 13,
            "'10.0.0.1:99999': the number of a port is 65535 at most – write another one",
        ),
        (
            "port: /dev/ttyX, protocol: modbus-rtu, role: no, station: 3", 52,
            "'modbus-rtu' has no role 'no' – known: client, server",
        ),
    ],
)  # fmt: skip
def test_points_of_a_channel_with_an_error_are_checked(tmp_path: Path, keys: str, place: int, problem: str) -> None:
    text = (
        HEAD
        + channel(1, keys)
        + (
            'points:\n  a: {channel: 1, address: "4000x"}\n'
            '  b: {channel: 1, address: "40001", type: float32, order: up}\n'
            '  c: {channel: 1, address: "40001", range: 5..1, access: rw}\n  d: {channel: 1, address: "40001"}\n'
            '  e: {channel: 1, address: "30001", access: rw}\n  f: {channel: 1, address: "40001", station: 256}\n'
        )
    )
    found = problems(tmp_path, text)
    assert found[0] == f"3:{place}: {problem}"
    assert [message.partition(" – ")[0].split(", in point")[0] for message in found[1:]] == [
        "5:28: '4000x' is not an address", "6:59: 'up' is not an order of bytes", "7:44: the range 5..1 is empty",
        "9:45: area 'input_register' can only be read", "10:46: station 256 is not in 0..255",
    ]  # fmt: skip


def test_a_broken_station_of_a_channel_makes_no_other_errors(tmp_path: Path) -> None:
    text = (
        HEAD
        + channel(1, "port: /dev/ttyX, protocol: modbus-rtu, station: x")
        + 'points: {a: {channel: 1, address: "40001"}}\n'
    )
    assert [problem[:4] for problem in problems(tmp_path, text)] == ["3:55"]


# ---- keys of a channel whose protocol is wrong ---------------------------------------------------------------------


def test_a_channel_of_an_unknown_protocol_is_checked_otherwise(tmp_path: Path) -> None:
    text = "run: plant\nchannels:\n  1:\n    port: tcp://10.0.0.1:99999\n    protocol: modbus-tpc\n    station: 1\n" + (
        "    format: 9X1\n    silence: 3 chars\n    dead: {failures: 0}\n    connect_timeout: 0 s\n"
        "    clients: 10.0.0.300\n    type: rs422\n    direction: {by: rts, before: 3 h}\n"
    ) + 'points: {a: {channel: 1, address: "4000x", range: 5..1}}\n'  # fmt: skip
    assert [problem.split(" – ")[0] for problem in problems(tmp_path, text)] == [
        "4:11: '10.0.0.1:99999': the number of a port is 65535 at most",
        "5:15: there is no definition 'modbus-tpc'",
        "7:13: '9X1' is not a line format (8N1 or 7E1), in channel 1",
        "9:22: a station cannot be dead before it failed",
        "10:22: '0 s' is no connect_timeout",
        "11:14: '10.0.0.300' is no address of clients",
        "13:34: 3 h is too long to hold a line",
        "14:51: the range 5..1 is empty",
    ]  # fmt: skip


# ---- keys of a sink ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("sink", "found"),
    [
        ("{csv: a.csv, form: rowz, rotate: week, points: tmp, every: 10 ms}", ["24", "38", "52", "64"]),
        ('{csv: "", rotate: week, points: tmp}', ["11", "23", "37"]),
        ("{csv: a.yaml, rotate: week, points: tmp, keep: 0}", ["11", "27", "41"]),
        ("{csv: a.csv, rotate: week, keep: 3}", ["26"]),
        ('{mqtt: "127.0.0.1:99999", most: 0, every: 10 ms}', ["12"]),
    ],
)
def test_every_key_of_a_sink_is_checked(tmp_path: Path, sink: str, found: list[str]) -> None:
    text = HEAD + channel(1, "port: /dev/ttyX, protocol: modbus-rtu, station: 1")
    text += f'points: {{a: {{channel: 1, address: "40001"}}}}\nsinks:\n  - {sink}\n'
    assert [problem.split(":")[:2] for problem in problems(tmp_path, text)] == [["6", column] for column in found]
