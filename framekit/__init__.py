"""framekit: protocols of serial field devices described in YAML, and run.

The names of the API stand here; each is imported when it is first used, so that importing framekit is fast.
"""

from __future__ import annotations

from importlib import import_module

TYPE_CHECKING = False  # as typing has it, without the time that importing typing takes
if TYPE_CHECKING:
    from typing import Any

    from framekit.api.client import AsyncClient, Client, aconnect, connect
    from framekit.api.codec import Protocol, load
    from framekit.api.errors import (
        ExchangeError,
        FramekitError,
        LineClosedError,
        NoReplyError,
        RefusedError,
        ReplyError,
        RequestError,
    )
    from framekit.api.memory import Memory
    from framekit.api.points import RunPoint
    from framekit.api.run import AsyncRun, Run, VirtualRun
    from framekit.api.scan import FoundDevice, Scan, ascan, scan
    from framekit.api.server import AsyncServer, Server, aserve, serve
    from framekit.api.values import Answer, Frame, Reading
    from framekit.codec.columns import Batch
    from framekit.codec.errors import EncodeError, FrameError
    from framekit.definition.problems import DefinitionError
    from framekit.link.events import Seen
    from framekit.memory.views import Order
    from framekit.run.block_state import BlockStatus, ErrorCode, Failure
    from framekit.run.points import PointValue

__version__ = "0.2.0"

_HOMES = {
    "api.client": ("AsyncClient", "Client", "aconnect", "connect"),
    "api.codec": ("Protocol", "load"),
    "api.errors": (
        "ExchangeError", "FramekitError", "LineClosedError", "NoReplyError", "RefusedError", "ReplyError",
        "RequestError",
    ),
    "api.memory": ("Memory",),
    "api.points": ("RunPoint",),
    "api.scan": ("FoundDevice", "Scan", "ascan", "scan"),
    "api.run": ("AsyncRun", "Run", "VirtualRun"),
    "api.server": ("AsyncServer", "Server", "aserve", "serve"),
    "api.values": ("Answer", "Frame", "Reading"),
    "codec.columns": ("Batch",),
    "codec.errors": ("EncodeError", "FrameError"),
    "definition.problems": ("DefinitionError",),
    "link.events": ("Seen",),
    "memory.views": ("Order",),
    "run.points": ("PointValue",),
    "run.block_state": ("BlockStatus", "ErrorCode", "Failure"),
}  # fmt: skip
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

__all__ = [
    "Answer",
    "AsyncClient",
    "AsyncRun",
    "AsyncServer",
    "Batch",
    "BlockStatus",
    "Client",
    "DefinitionError",
    "EncodeError",
    "ErrorCode",
    "ExchangeError",
    "Failure",
    "FoundDevice",
    "Frame",
    "FrameError",
    "FramekitError",
    "LineClosedError",
    "Memory",
    "NoReplyError",
    "Order",
    "PointValue",
    "Protocol",
    "Reading",
    "RefusedError",
    "ReplyError",
    "RequestError",
    "Run",
    "RunPoint",
    "Scan",
    "Seen",
    "Server",
    "VirtualRun",
    "aconnect",
    "ascan",
    "aserve",
    "connect",
    "load",
    "scan",
    "serve",
]


def __getattr__(name: str) -> Any:
    home = _HOME_OF.get(name)
    if home is None:
        raise AttributeError(f"module 'framekit' has no attribute '{name}'")
    value = getattr(import_module(f"framekit.{home}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
