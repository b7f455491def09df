"""A trivial device in a process of its own: it answers every read of registers and looks at no other part of a request.

One process serves any number of connections, so the other process measures its own work alone. The kind `counting`
sends as many registers as the request asks for, with other values in each reply; otherwise a reply has ten registers.
"""

from __future__ import annotations

import asyncio
import contextlib
import struct
import subprocess
import sys
from collections.abc import Iterator

REGISTERS = bytes(range(20))
"""The content of the ten registers, high byte first."""
VALUES = list(struct.unpack(">10H", REGISTERS))
REQUEST_SIZE = 12


class Responder(asyncio.Protocol):
    """A responder that returns the reply with the same transaction number and station for each twelve bytes."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self.transport = transport

    def data_received(self, data: bytes) -> None:
        for start in range(0, len(data), REQUEST_SIZE):
            request = data[start : start + REQUEST_SIZE]
            self.transport.write(request[:2] + b"\0\0\0\x17" + request[6:8] + b"\x14" + REGISTERS)


class CountingResponder(Responder):
    """A responder with the requested number of registers.

    The first is the reply's number, each further one is 1 more.
    """

    replies = 0

    def data_received(self, data: bytes) -> None:
        for start in range(0, len(data), REQUEST_SIZE):
            request = data[start : start + REQUEST_SIZE]
            count = request[11]
            self.replies += 1
            values = struct.pack(f">{count}H", *(self.replies + place & 0xFFFF for place in range(count)))
            self.transport.write(
                request[:4] + struct.pack(">H", 3 + 2 * count) + request[6:8] + bytes((2 * count,)) + values
            )


KINDS = {"constant": Responder, "counting": CountingResponder}


async def serve(kind: str) -> None:
    server = await asyncio.get_running_loop().create_server(KINDS[kind], "127.0.0.1", 0)
    print(server.sockets[0].getsockname()[1], flush=True)
    await asyncio.to_thread(sys.stdin.read)


@contextlib.contextmanager
def responder(kind: str = "constant") -> Iterator[int]:
    """Run a responder within the context; yield its TCP port."""
    command = [sys.executable, "-m", "benchmarks.responder", kind]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stdin is not None
        try:
            yield int(process.stdout.readline())
        finally:
            process.stdin.close()


if __name__ == "__main__":
    asyncio.run(serve(sys.argv[1]))
