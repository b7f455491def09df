"""The values of a simulated device that people look at: places that behave, and those with a start value.

They are points of its memory, by name or address; all may be written, also where others may only read.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from framekit.definition.problems import NOWHERE
from framekit.definition.times import NEVER
from framekit.link.packing import typed_at
from framekit.memory.memory import DeviceMemory
from framekit.run.model import OwnPlace, Point
from framekit.runfile.devices import Device
from framekit.service.points import PointService
from framekit.service.run_loop import RunLoop
from framekit.transport.clock import Clock

MOST_OF_A_ROW = 64
"""So many of the values that one start value gives are points."""


def points_of(device: Device) -> dict[str, Point]:
    """The points of a device by name, those that behave first."""
    found: dict[str, Point] = {}
    taken: set[tuple[str, int]] = set()
    for behaviour in sorted(device.behaviours, key=lambda one: (one.at.line, one.at.column)):
        place = behaviour.place
        name = behaviour.name or place.address
        found[name] = replace(place, name=name, is_writable=True, stale=NEVER, about=behaviour.word)
        taken.update(_bits(place))
    for start, values in device.initial:
        for number in range(min(len(values), MOST_OF_A_ROW)):
            point = _started(device, start, number)
            if point is not None and taken.isdisjoint(_bits(point)):
                found.setdefault(point.name, point)
    return found


def _bits(point: Point) -> Iterator[tuple[str, int]]:
    place = point.place.address
    return ((place.area, bit) for bit in range(place.first_bit, place.first_bit + point.bits))


def _started(device: Device, place: OwnPlace, number: int) -> Point | None:
    """One of the values that a device starts with; None where no text names its place."""
    address = device.grammar.advance(place.address, number) if number else place.address
    text = address.text if number else place.text
    if not text:
        return None
    form = typed_at(device.grammar, text, address.unit, None, 1)
    return Point(
        name=text, form=form, place=OwnPlace(address=address, text=text), address=text, is_writable=True,
        at=NOWHERE,
    )  # fmt: skip


class DevicePoints:
    """The points of a device at work, whose memory this is, between `start` and `stop`."""

    def __init__(self, device: Device, memory: DeviceMemory, clock: Clock) -> None:
        self.loop = loop = RunLoop(clock, lambda now: self.service.tick(now), lambda now: self.service.deadline)
        self.service = PointService(
            points_of(device).values(), (), memory, clock, loop.wake, lambda block: None, force=True
        )  # fmt: skip

    def start(self) -> None:
        """What they are is known from now on."""
        self.loop.start()
        self.service.tick(self.loop.clock.now())

    def stop(self) -> None:
        """They stay as they are."""
        self.loop.stop()
