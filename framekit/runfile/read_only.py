"""A run that only reads: what could write into a device is refused, and so is what others write into its memory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from framekit.definition.problems import DefinitionError, Problem
from framekit.run.model import RunModel

WRITES = {
    "write": "writes into the other side",
    "send": "sends a frame, which may write",
    "call": "calls a service, which may write",
    "command": "carries out commands, which may write",
    "job": "begins a job, which may write",
}
"""What blocks do that a run which only reads does not have, by their instruction."""


def only_reading(run: RunModel) -> RunModel:
    """The same run, with channels whose clients may write nothing, and points that none writes.

    Raises DefinitionError where it could write.
    """
    problems = list(_writing(run))
    if problems:
        raise DefinitionError(problems)
    channels = {number: replace(channel, read_only=True) for number, channel in run.channels.items()}
    points = tuple(replace(point, is_writable=False) for point in run.points)
    return replace(run, channels=channels, points=points, only_reads=True)


def _writing(run: RunModel) -> Iterator[Problem]:
    todo = "leave it out, or run the file without --read-only"
    of_points = {point.writer for point in run.points}
    for block in run.blocks:
        if block.instruction in WRITES and block.id not in of_points:
            yield Problem(block.at, f"block {block.number} {WRITES[block.instruction]}, and this run only reads", todo)
    for point in run.points:
        if point.writer is not None:
            what = f"point '{point.name}' can be written into a device, and this run only reads"
            yield Problem(point.at, what, "leave access: rw out, or run the file without --read-only")
