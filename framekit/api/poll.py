"""A read that a client repeats by itself: values go to a callback, and whoever wants to know how it ended may wait.

What is asked, and when, is `service.polling`'s business.
"""

from __future__ import annotations

import asyncio
import inspect
import math
from collections.abc import Callable, Generator
from typing import Any

from framekit.api.errors import ExchangeError, FramekitError, error_of
from framekit.api.typed import Typed
from framekit.link.services.client import TransferResult
from framekit.service.client import ClientService
from framekit.service.polling import Polling

OnValues = Callable[[tuple[Any, ...]], None]
OnError = Callable[[FramekitError], None]


class Poll:
    """Reads that follow each other until `stop`, made by `AsyncClient.poll`. `reads` and `failures` count them.

    `await` waits for the end, and raises what it ended with; who gives up waiting stops nothing. Raises ValueError for
    what cannot be asked.
    """

    def __init__(
        self, service: ClientService, how: Typed, address: str, station: Any, every: float, on_values: OnValues,
        on_error: OnError | None, trouble: Callable[[], str],
    ) -> None:  # fmt: skip
        if not isinstance(every, int | float) or not 0 <= every < math.inf:
            raise ValueError(f"every is {every!r}: it is the seconds from one read to the next, 0 or more")
        _check_callback("on_values", on_values)
        if on_error is not None:
            _check_callback("on_error", on_error)
        self.failures = 0
        self._address, self._every = address, every
        self._error: Exception | None = None
        self._reads = 0
        self._how = how
        self._on_values = on_values
        self._on_error = on_error
        self._trouble = trouble
        self._ended: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._polling = Polling(
            service, address, station=station, unit=how.unit, count=how.units, every=round(every * 1e9),
            on_result=self._result,
        )  # fmt: skip
        self._polling.start()

    @property
    def reads(self) -> int:
        """How many have ended well."""
        return self._reads

    @property
    def is_running(self) -> bool:
        """Whether more will be read."""
        return self._polling.is_running

    def stop(self) -> None:
        """Ends it: the callbacks are not called any more."""
        self._polling.stop()
        if not self._ended.done():
            self._ended.set_result(None)

    def __repr__(self) -> str:
        how, first = self._how, self._address
        what = first if how.count == 1 else f"{how.count} × {how.type} from {first} on"
        often = f"every {self._every:g} s" if self._every else "without pause"
        state = "running" if self.is_running else "stopped"
        if not self.is_running and self._error is not None:
            state = f"ended by {self._error!r}"
        return f"<Poll of {what}, {often}: {self.reads} reads, {self.failures} failures, {state}>"

    def __await__(self) -> Generator[Any, None, None]:
        yield from asyncio.wait([self._ended]).__await__()  # cancelled, it leaves the end to come, and others waiting
        self._ended.result()

    def _result(self, result: TransferResult) -> None:
        try:
            if not result.ok:
                raise error_of(result, self._trouble())
            values = tuple(self._how.values(result.data, result.values))
        except ExchangeError as error:
            self._failed(error)
        else:
            self._numbers(values)

    def _failed(self, error: ExchangeError) -> None:
        self.failures += 1
        if self._on_error is None:
            self._fail(error)
            return
        try:
            self._on_error(error)
        except Exception as another:
            self._fail(another)

    def _numbers(self, values: tuple[Any, ...]) -> None:
        self._reads += 1
        try:
            self._on_values(values)
        except Exception as error:  # whatever it is, it belongs to whoever waits for the end
            self._fail(error)

    def _fail(self, error: Exception) -> None:
        self._polling.stop()
        if not self._ended.done():
            self._error = error
            self._ended.set_exception(error)


def _check_callback(name: str, callback: object) -> None:
    """Raises ValueError for what cannot be called, or would have to be awaited: its values would be lost silently."""
    if not callable(callback):
        raise ValueError(f"{name} has to be a plain function, not {callback!r}")
    if inspect.iscoroutinefunction(callback):
        raise ValueError(
            f"{name} has to be a plain function: it is called, not awaited – for tasks, hand over an asyncio.Queue's "
            "put_nowait"
        )
