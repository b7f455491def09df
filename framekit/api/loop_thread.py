"""A thread with an event loop of its own, in which coroutines are carried out for callers that have none.

The thread is a daemon: a program ends whether or not it has been stopped.
"""

from __future__ import annotations

import asyncio
import functools
import inspect
import threading
from collections.abc import Callable, Coroutine
from concurrent.futures import CancelledError, Future
from typing import Any, ParamSpec, Self, TypeVar

T = TypeVar("T")
Made = TypeVar("Made")
P = ParamSpec("P")


class LoopStoppedError(RuntimeError):
    """The thread has ended, or ended while the caller waited."""


class LoopThread:
    """Its loop runs from the making until `stop`. Any number of threads may use it."""

    def __init__(self, name: str) -> None:
        self.loop = asyncio.new_event_loop()
        self._lock = threading.Lock()
        self._stopping = False
        self._thread = threading.Thread(target=self._run, daemon=True, name=name)
        self._thread.start()

    def _run(self) -> None:
        loop = self.loop
        asyncio.set_event_loop(loop)
        try:
            loop.run_forever()
            left = asyncio.all_tasks(loop)
            for task in left:
                task.cancel()
            loop.run_until_complete(asyncio.gather(*left, return_exceptions=True))
            loop.run_until_complete(loop.shutdown_asyncgens())
        finally:
            loop.close()

    @property
    def is_here(self) -> bool:
        """Return whether the caller is in the loop's thread: a callback, which must not wait for the loop."""
        return threading.current_thread() is self._thread

    def _schedule(self, action: Callable[[], object]) -> None:
        """What is scheduled before `stop` still comes; nothing is scheduled behind it."""
        with self._lock:
            if self._stopping:
                raise LoopStoppedError("it was closed")
            self.loop.call_soon_threadsafe(action)

    def wait(self, coroutine: Coroutine[Any, Any, T]) -> T:
        """The result of a coroutine; Ctrl-C cancels it. Raises what it raises, LoopStoppedError.

        In the loop's own thread it raises RuntimeError.
        """
        done: Future[T] = Future()
        tasks: list[asyncio.Task[T]] = []

        def begin() -> None:
            tasks.append(self.loop.create_task(coroutine))
            tasks[0].add_done_callback(lambda task: _copy(task, done))

        try:
            if self.is_here:
                raise RuntimeError("a callback cannot wait for its own loop – use the async API there")
            self._schedule(begin)
        except RuntimeError:
            coroutine.close()
            raise
        try:
            return done.result()
        except CancelledError:
            raise LoopStoppedError("it was closed") from None
        except KeyboardInterrupt:
            self._schedule(lambda: tasks[0].cancel())
            raise

    def do(self, action: Callable[..., T], *arguments: Any) -> T:
        """The result of a function, called in the loop's thread. Raises what it raises, LoopStoppedError."""
        if self.is_here:
            return action(*arguments)

        async def act() -> T:
            return action(*arguments)

        return self.wait(act())

    def do_even_stopped(self, action: Callable[[], T]) -> T:
        """As `do`; after the end in the caller's thread, when no other thread can be at it any more."""
        try:
            return self.do(action)
        except LoopStoppedError:
            self._thread.join()
            return action()

    def end_with(self, close_now: Callable[[], None], close: Callable[[], Coroutine[Any, Any, None]]) -> None:
        """Closes what the loop works for, and ends the thread; from inside of the loop without waiting."""
        try:
            if self.is_here:
                close_now()
            else:
                self.wait(close())
        except LoopStoppedError:
            return
        self.stop()

    def stop(self) -> None:
        """Cancels what is under way and ends the thread. Stopping twice does nothing."""
        with self._lock:
            if not self._stopping:
                self._stopping = True
                self.loop.call_soon_threadsafe(self.loop.stop)
        if not self.is_here:
            self._thread.join()


def _copy(task: asyncio.Task[T], done: Future[T]) -> None:
    """Hand the end of a task over to another thread."""
    if task.cancelled():
        done.cancel()
        done.set_running_or_notify_cancel()
    elif (error := task.exception()) is not None:
        done.set_exception(error)
    else:
        done.set_result(task.result())


class Stopping:
    """Something that `with` starts and stops."""

    def start(self) -> None:
        """Begins."""
        raise NotImplementedError

    def stop(self) -> None:
        """End it."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.stop()


class Closing:
    """Something that `with` closes."""

    def close(self) -> None:
        """Ends it. Twice does nothing."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def with_arguments_of(make: Callable[P, Made]) -> Callable[[Callable[[Made], T]], Callable[P, T]]:
    """The function takes the arguments of `make`, and is given what that makes of them."""

    def decorate(use: Callable[[Made], T]) -> Callable[P, T]:
        @functools.wraps(use)
        def call(*arguments: P.args, **options: P.kwargs) -> T:
            return use(make(*arguments, **options))

        returns = inspect.signature(use).return_annotation
        call.__signature__ = inspect.signature(make).replace(return_annotation=returns)  # type: ignore[attr-defined]
        return call

    return decorate
