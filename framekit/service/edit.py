"""Applies an edited run to the one that goes on: whole, at a moment when no exchange runs on the channels touched.

What is not different is not touched: channels stay open, blocks keep their counters and the phase of their cycles,
memory stays. What is different, and whether it may be, is decided in `framekit.run.edit`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from framekit.run.edit import Edit, added_blocks, plan_edit
from framekit.service.exchanges import rules_of
from framekit.service.run_channels import Made

if TYPE_CHECKING:
    from framekit.run.model import Run
    from framekit.service.run import RunService

Applied = Callable[[Edit], None]


@dataclass(slots=True)
class _Prepared:
    """An edit with its channels made, which waits for its moment."""

    edit: Edit
    applied: Applied
    channels: dict[int, Made] = field(default_factory=dict)


class RunEditor:
    """Changes `service` to an edited run."""

    def __init__(self, service: RunService) -> None:
        self.service = service
        self._waiting: _Prepared | None = None

    def request(self, run: Run, applied: Applied) -> None:
        """Applies an edited run as soon as it can be; `applied` is called then. One that still waits is forgotten.

        Raises DefinitionError with the reasons when it cannot be applied, ValueError for a port of no known kind; the
        run goes on as it was then.
        """
        service = self.service
        edit = plan_edit(service.run, run)
        prepared = _Prepared(edit, applied)
        for number in (*edit.channels_changed, *edit.channels_new):
            prepared.channels[number] = service.lines.of_run(run, number)
        self._waiting = prepared
        service.scheduler.hold(edit.touched)
        self.step()

    def step(self) -> None:
        """Applies what waits, if its moment has come."""
        prepared, service = self._waiting, self.service
        if prepared is None or not service.running or not service.scheduler.idle(prepared.edit.touched):
            return
        self._waiting = None
        self._apply(prepared)
        service.scheduler.hold(())
        prepared.applied(prepared.edit)

    def _apply(self, prepared: _Prepared) -> None:
        service, edit = self.service, prepared.edit
        scheduler, now = service.scheduler, service.clock.now()
        for number in (*edit.blocks_gone, *edit.blocks_changed):
            state = scheduler.remove(number)
            service.removed.add(state)
            service.block_memory.remove(state.block)
            service.exchanges.forget(state.block)
        if service.jobs is not None:
            service.jobs.give_up((*edit.blocks_gone, *edit.blocks_changed))
        for number in (*edit.channels_gone, *edit.channels_changed):
            service.close_channel(number)
        for number in edit.channels_gone:
            scheduler.remove_channel(number)
        for number, made in prepared.channels.items():
            scheduler.add_channel(number, rules_of(edit.run.channels[number]))
            service.lines.put(number, made)
        before, service.run = service.run.sets, edit.run
        for number, on in edit.run.sets.items():
            if before.get(number) != on:  # one that somebody has switched by hand stays so
                scheduler.set_enabled(number, on, now)
                service.blocks.set_switched(number)
        added = [scheduler.add(block) for block in added_blocks(edit)]
        for state in added:
            block = state.block
            service.block_memory.add(state, None if block.job else edit.run.channels[block.channel].protocol)
        service.look_again()
        for number in prepared.channels:
            service.on_channel(number, service.channels[number])
            service.lines.open(number)
        for state in added:
            scheduler.arm(state, now)
