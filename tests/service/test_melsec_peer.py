"""pymcprotocol, an independent client, with simulated controllers: 3E and 4E frames, binary and ASCII, on real TCP.

Skipped only if it is not installed.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial
from pathlib import Path
from random import Random
from typing import Any

import pytest
from peer_world import at_work, tcp_device

pymcprotocol = pytest.importorskip("pymcprotocol", reason="pymcprotocol is not installed")

DEVICE = """
device: peer
protocol: {protocol}
params: {{model: Q06UDVCPU, model_code: 0x0368}}
memory:
  set: {{D100: [4660, 2, 0xFFFE], M100: [1, 0, 1, 1], TN5: 77, W1F: 5, D200: 0x5678, D201: 0x1234}}
"""
KINDS = [
    ("melsec-mc-3e", pymcprotocol.Type3E, "binary", "Q"),
    ("melsec-mc-3e", pymcprotocol.Type3E, "binary", "iQ-R"),
    ("melsec-mc-3e-ascii", pymcprotocol.Type3E, "ascii", "Q"),
    ("melsec-mc-3e-ascii", pymcprotocol.Type3E, "ascii", "iQ-R"),
    ("melsec-mc-4e", pymcprotocol.Type4E, "binary", "Q"),
]


def connected(kind: Callable[[str], Any], code: str, series: str, number: int) -> Any:
    client = kind(series)
    client.setaccessopt(commtype=code)
    client.connect("127.0.0.1", number)
    return client


def words_and_points(make: Callable[[int], Any], number: int) -> None:
    client = make(number)
    assert client.batchread_wordunits("D100", 3) == [4660, 2, -2]
    assert client.batchread_wordunits("TN5", 1) == [77]
    assert client.batchread_bitunits("M100", 5) == [1, 0, 1, 1, 0]
    assert client.batchread_wordunits("M100", 1) == [0b1101]
    client.batchwrite_wordunits("D300", [1, -1, 32767])
    assert client.batchread_wordunits("D300", 3) == [1, -1, 32767]
    client.batchwrite_bitunits("M200", [1, 1, 0, 1, 1])
    assert client.batchread_bitunits("M200", 6) == [1, 1, 0, 1, 1, 0]
    client.batchwrite_bitunits("M201", [0])
    assert client.batchread_bitunits("M200", 4) == [1, 0, 0, 1]
    client.batchwrite_wordunits("M320", [-32767])
    assert client.batchread_bitunits("M320", 16) == [1] + [0] * 14 + [1]
    random = Random(1)
    for _ in range(20):
        values = [random.randrange(-32768, 32768) for _ in range(random.randrange(1, 200))]
        client.batchwrite_wordunits("D1000", values)
        assert client.batchread_wordunits("D1000", len(values)) == values
        points = [random.randrange(2) for _ in range(random.randrange(1, 200))]
        client.batchwrite_bitunits("M1001", points)
        assert client.batchread_bitunits("M1001", len(points)) == points
    client.close()


def lists_and_the_rest(make: Callable[[int], Any], number: int) -> None:
    client = make(number)
    assert client.randomread(word_devices=["D100", "TN5", "D102"], dword_devices=[]) == ([4660, 77, -2], [])
    both = client.randomread(word_devices=["TN5", "M96"], dword_devices=["D200", "D101"])
    assert both == ([77, 0b11010000], [0x12345678, -131070])
    client.randomwrite(["D400", "D410"], [11, 22], ["D401", "M320"], [-2, 0x10001])
    assert client.batchread_wordunits("D400", 3) + client.batchread_wordunits("D410", 1) == [11, -2, -1, 22]
    assert client.batchread_wordunits("M320", 2) == [1, 1]
    client.randomwrite_bitunits(["M50", "M60"], [1, 1])
    assert client.batchread_bitunits("M50", 11) == [1] + [0] * 9 + [1]
    assert client.read_cputype() == ("Q06UDVCPU", "0368")
    assert client.echo_test("ABCDE") == (5, "ABCDE")
    client.remote_stop()
    client.remote_run(clear_mode=0)
    client.remote_pause()
    for refused in (lambda: client.batchread_wordunits("D12000", 500), lambda: client.remote_latchclear()):
        with pytest.raises(pymcprotocol.mcprotocolerror.MCProtocolError) as error:
            refused()
        assert error.value.errorcode in ("0xC056", "0x4010")
    client.close()


@pytest.mark.parametrize(("protocol", "kind", "code", "series"), KINDS)
@pytest.mark.parametrize("work", [words_and_points, lists_and_the_rest])
def test_its_client(tmp_path: Path, protocol: str, kind: Any, code: str, series: str, work: Any) -> None:
    async def scenario() -> None:
        async with tcp_device(tmp_path, DEVICE.format(protocol=protocol)) as (number, _):
            await at_work(work, partial(connected, kind, code, series), number)

    asyncio.run(scenario())


def test_numbers_of_inputs_in_ascii_are_its_fault(tmp_path: Path) -> None:
    """A bug of pymcprotocol: it writes the hexadecimal number of an input in decimal, X20 as 000032."""

    def work(number: int) -> None:
        client = connected(pymcprotocol.Type3E, "ascii", "Q", number)
        client.batchwrite_bitunits("X20", [1])
        client.close()

    async def scenario() -> None:
        text = DEVICE.format(protocol="melsec-mc-3e-ascii")
        async with tcp_device(tmp_path, text) as (number, serving):
            await at_work(work, number)
            memory = serving.stores[0].memory
            assert (memory.read("X", "bit", 0x20), memory.read("X", "bit", 0x32)) == ([0], [1])

    asyncio.run(scenario())
