"""Protocols without an independent implementation: a client and a simulated device on a real terminal."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from peer_world import at_work, pty_device

import framekit
from framekit.definition.times import parse_format

CASES = {
    "uss": ("8E1", 3, "P700", "P2009.1", 5, "params: {array_size: 4}"),
    "melsec-mc-1c": ("7E1", 5, "D100", "X40", 1, ""),
    "rk512-3964r": ("8E1", None, "DB10.DW5", "DX3.DW0", 0x1010, ""),
}


def working(name: str, path: str) -> None:
    form, station, first, second, value, _ = CASES[name]
    with framekit.connect(name, path, station=station, format=form) as client:
        for address in (first, second):
            assert list(client.read(address)) == [0]
            client.write(address, value)
            assert list(client.read(address)) == [value]
        with pytest.raises(framekit.RefusedError) as refused:
            if name == "uss":
                client.read("P1.9")
            elif name == "rk512-3964r":
                client.read("DB1.DW255", 2)
            else:
                client.read("D100", params={"pc_number": 1})
        assert refused.value.code in (3, 0x10, 0x14)


@pytest.mark.parametrize("name", CASES)
def test_a_client_works_on_a_simulated_device(name: str, tmp_path: Path) -> None:
    form, station, *_, params = CASES[name]
    own = "" if station is None else f"station: {station}"
    text = f"device: there\nprotocol: {name}\n{own}\n{params}\n"

    async def scenario() -> None:
        async with pty_device(tmp_path, text, parse_format(form, 9600)) as (path, _):
            await at_work(working, name, path)

    asyncio.run(scenario())
