"""A server that refuses requests because a fault plan says so; every other request goes on to the server behind it."""

from __future__ import annotations

from typing import Any

from framekit.blocks.fault_plan import FaultRule
from framekit.link.evaluate import Names
from framekit.link.exchange import Served
from framekit.link.serving import MemoryServer
from framekit.link.values import FrameValue
from framekit.service.fault_injector import FaultInjector


class RefusingServer:
    """A request that is asked about twice (first only whether it would be refused) gets the same answer twice."""

    def __init__(self, server: MemoryServer, injector: FaultInjector) -> None:
        self.server = server
        self.injector = injector
        self._request: FrameValue | None = None
        self._rule: FaultRule | None = None

    def serve(self, request: FrameValue, buffer: bytes, station: Any, check_only: bool, names: Names) -> Served:
        if request is not self._request:
            self._request, self._rule = request, self.injector.happens("error_reply", request.frame)
        if not check_only:
            self._request = None
        if self._rule is None:
            return self.server.serve(request, buffer, station, check_only, names)
        return self.server.refuse(request, self._rule.code, buffer, station, names)
