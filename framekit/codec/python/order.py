"""In which order the values of a frame are worked out when it is built: each after those it depends on.

Fields may refer to later ones. Where values refer to each other in a circle, one that may be given is taken from what
was given.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field


@dataclass(slots=True)
class Task:
    """One thing to write: the names it gives, those it waits for, and how it is written.

    `write(missing)` gets the names that are not there yet because of a circle; they are read from the given values. In
    a circle a task with `may_be_given` is taken first, one with `prefer` before all.
    """

    gives: tuple[str, ...]
    waits_for: set[str]
    write: Callable[[set[str]], None]
    may_be_given: bool = False
    prefer: bool = False
    done: bool = field(default=False, init=False)


def run_in_order(tasks: list[Task]) -> None:
    """Writes every task after those it waits for, as far as possible in the order given."""
    givers = {name: task for task in tasks for name in task.gives}
    while pending := [task for task in tasks if not task.done]:
        ready = next((task for task in pending if not _open(task, givers)), None)
        if ready is None:
            given = [task for task in pending if task.may_be_given]
            ready = next((task for task in given if task.prefer), (given or pending)[0])
        ready.done = True
        ready.write(_open(ready, givers))


def _open(task: Task, givers: dict[str, Task]) -> set[str]:
    """The names a task still waits for."""
    return {name for name in task.waits_for if name in givers and not givers[name].done and givers[name] is not task}
