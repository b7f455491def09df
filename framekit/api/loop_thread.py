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

from framekit.api.event_loop import new_event_loop

T = TypeVar("T")
Made = TypeVar("Made")
P = ParamSpec("P")


class LoopStoppedError(RuntimeError):
    """The thread has ended, or ended while the caller waited."""


class LoopThread:
    """A thread whose loop runs from its creation until `stop`. Any number of threads may use it."""

    def __init__(self, name: str) -> None:
        self.loop = new_event_loop()
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
        """Schedule a call in the loop's thread. Raise LoopStoppedError after `stop`."""
        with self._lock:
            if self._stopping:
                raise LoopStoppedError("it was closed")
            self.loop.call_soon_threadsafe(action)

    def wait(self, coroutine: Coroutine[Any, Any, T]) -> T:
        """Return the result of a coroutine; Ctrl-C cancels it. Raise its errors, LoopStoppedError.

        Raise RuntimeError in the loop's own thread.
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
        except (RuntimeError, KeyboardInterrupt):
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
        """Return the result of a function, called in the loop's thread. Raise its errors, LoopStoppedError."""
        if self.is_here:
            return action(*arguments)

        async def act() -> T:
            return action(*arguments)

        return self.wait(act())

    def do_even_stopped(self, action: Callable[[], T]) -> T:
        """Do as `do`; after the end call the function in the caller's thread, once the loop's thread has ended."""
        try:
            return self.do(action)
        except LoopStoppedError:
            self._thread.join()
            return action()

    def end_with(self, close_now: Callable[[], None], close: Callable[[], Coroutine[Any, Any, None]]) -> None:
        """Close the user of the loop, then end the thread; inside the loop's thread do not wait for either."""
        try:
            if self.is_here:
                close_now()
            else:
                self.wait(close())
        except LoopStoppedError:
            return
        self.stop()

    def stop(self) -> None:
        """Cancel the tasks of the loop and end the thread. A second call has no effect."""
        with self._lock:
            if not self._stopping:
                self._stopping = True
                self.loop.call_soon_threadsafe(self.loop.stop)
        if not self.is_here:
            self._thread.join()


def _copy(task: asyncio.Task[T], done: Future[T]) -> None:
    """Pass the result of a task to another thread."""
    if task.cancelled():
        done.cancel()
        done.set_running_or_notify_cancel()
    elif (error := task.exception()) is not None:
        done.set_exception(error)
    else:
        done.set_result(task.result())


class Stopping:
    """Base class of objects that `with` starts and stops."""

    def start(self) -> None:
        """Start the work."""
        raise NotImplementedError

    def stop(self) -> None:
        """Stop the work."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.stop()


class Closing:
    """Base class of objects that `with` closes."""

    def close(self) -> None:
        """Close the object. A second call has no effect."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def with_arguments_of(make: Callable[P, Made]) -> Callable[[Callable[[Made], T]], Callable[P, T]]:
    """Return a decorator: the function gets the object that `make` makes, its callers give the arguments of `make`."""

    def decorate(use: Callable[[Made], T]) -> Callable[P, T]:
        @functools.wraps(use)
        def call(*arguments: P.args, **options: P.kwargs) -> T:
            return use(make(*arguments, **options))

        returns = inspect.signature(use).return_annotation
        call.__signature__ = inspect.signature(make).replace(return_annotation=returns)  # type: ignore[attr-defined]
        return call

    return decorate
