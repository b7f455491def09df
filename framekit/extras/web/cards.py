"""The cards at the head of a page: a value and a sentence each, about lines, exchanges, errors, load, stations, points.

Everything that is not as it should be is named in words; the state of a card only adds a color to them.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from framekit.api.rows import percent
from framekit.api.run import ChannelStatus, RunStatus
from framekit.codec.shown import shown
from framekit.definition.problems import plural
from framekit.run.points import PointValue
from framekit.run.status import StationStatus
from framekit.service.device import DeviceStore

HEALTHY = ("open", "closed", "switched off")
"""States of channels that are as they should be: a channel that is closed has no work."""
RATE_OVER = 5_000_000_000
RATE_FROM = 2_000_000_000
ERRORS_OVER = 60_000_000_000
"""Spans over which exchanges are counted, at least over which, and for which the card of errors stays red (ns)."""
MOST_NAMED = 3


class Card(NamedTuple):
    """A card of the page."""

    title: str
    value: str
    text: str
    state: str = ""
    """`good`, `warn`, `bad`, or '' without a color."""
    number: float | None = None
    """A number to draw over time."""


class Rate:
    """A counter that is read at times: its increase a second over the last seconds, and its last increase."""

    def __init__(self) -> None:
        self._readings: deque[tuple[int, int]] = deque()
        self._increased: int | None = None

    def read(self, now: int, count: int) -> float | None:
        """Add a reading; return the increase a second, None while the readings are too near to each other."""
        readings = self._readings
        if readings and count > readings[-1][1]:
            self._increased = now
        readings.append((now, count))
        while len(readings) > 2 and readings[0][0] < now - RATE_OVER:
            readings.popleft()
        began, before = readings[0]
        return (count - before) * 1e9 / (now - began) if now - began >= RATE_FROM else None

    def has_increased_within(self, now: int, span: int) -> bool:
        """Return whether the counter has increased within a span before `now`."""
        return self._increased is not None and now - self._increased < span


class RunCards:
    """The cards of a run."""

    def __init__(self) -> None:
        self._exchanges, self._errors = Rate(), Rate()

    def of(self, status: RunStatus, loads: Sequence[tuple[int, float]], points: Sequence[PointValue]) -> list[Card]:
        """Return the cards at this moment. `loads`: the present load of channels that have a speed."""
        channels = status.channels
        cards = [
            _lines(channels), self._exchange_card(status), self._error_card(status),
            *([_load(channels, loads)] if loads else []), _stations(status),
        ]  # fmt: skip
        return [*cards, point_card(points)] if points else cards

    def _exchange_card(self, status: RunStatus) -> Card:
        total = sum(one.services for one in status.channels)
        return exchange_card("Exchanges", self._exchanges.read(status.at, total), total)

    def _error_card(self, status: RunStatus) -> Card:
        total = sum(one.errors for one in status.channels)
        self._errors.read(status.at, total)
        reasons: Counter[str] = Counter()
        for one in status.channels:
            reasons.update(one.reasons)
        is_fresh = self._errors.has_increased_within(status.at, ERRORS_OVER)
        return error_card(total, reasons, is_fresh)


class DeviceCards:
    """The cards of simulated devices."""

    def __init__(self) -> None:
        self._requests, self._errors = Rate(), Rate()

    def of(
        self, count: int, about: str, stores: Iterable[DeviceStore], line_errors: Mapping[str, int], now: int
    ) -> list[Card]:
        """Return the cards at a time. `line_errors`: faults on the line, in addition to refused requests."""
        reasons, done, stores = Counter(line_errors), 0, list(stores)
        for store in stores:
            done += store.counters.done
            reasons.update(store.counters.reasons(store.device.protocol))
        self._errors.read(now, reasons.total())
        return [
            _devices(count, about, stores),
            exchange_card("Requests", self._requests.read(now, done), done),
            error_card(reasons.total(), reasons, self._errors.has_increased_within(now, ERRORS_OVER)),
        ]


def _devices(count: int, about: str, stores: Sequence[DeviceStore]) -> Card:
    """Return the card of the devices: the station of a single device, or how many."""
    if count != 1:
        return Card("Devices", str(count), about, "good")
    device = stores[0].device
    protocol = device.protocol.name
    if not device.station:
        return Card("Device", protocol, about, "good")
    return Card("Device", f"Station {device.station}", f"{protocol} · {about}", "good")


def in_words(reason: str) -> str:
    """Return the name of an outcome in words: `no reply` for `no_reply`; other reasons unchanged."""
    return reason.replace("_", " ") if reason.islower() and " " not in reason else reason


def exchange_card(title: str, rate: float | None, total: int) -> Card:
    """Return the card of exchanges, or of requests."""
    text = f"{total:,} since the start".replace(",", "\u202f")
    return Card(title, "–" if rate is None else f"{rate:.1f} /s", text, number=rate)


def error_card(total: int, reasons: Counter[str], is_fresh: bool) -> Card:
    """Return the card of errors, with the most frequent reasons."""
    text = ", ".join(f"{count} × {in_words(reason)}" for reason, count in reasons.most_common(MOST_NAMED))
    return Card("Errors", f"{total:,}".replace(",", "\u202f"), text or "None so far", "bad" if is_fresh else "")


def _lines(channels: Sequence[ChannelStatus]) -> Card:
    lost = [one for one in channels if one.state not in HEALTHY]
    if lost:
        named = _some(f"channel {one.number}: {one.state}" for one in lost)
        return Card("Line", "Lost" if len(channels) == 1 else f"{len(lost)} of {len(channels)} lost", named, "bad")
    active = [one for one in channels if one.state == "open"]
    drivers = dict.fromkeys(one.driver if one.role is None else f"{one.driver} {one.role}" for one in channels)
    text = f"{plural(len(channels), 'channel')} · {_some(drivers)}" if channels else "This run has no channels"
    value = f"{len(active)} of {len(channels)} open" if len(channels) > 1 else "Open" if active else "Closed"
    return Card("Line", value, text, "good" if active else "")


def _load(channels: Sequence[ChannelStatus], loads: Sequence[tuple[int, float]]) -> Card:
    """Return the card of the busiest channel with a speed."""
    number, load = max(loads, key=lambda one: one[1])
    line = next((one.line for one in channels if one.number == number), "")
    text = f"channel {number}, {line}" if len(channels) > 1 else line
    return Card("Load", percent(load), f"Busiest: {text}" if len(loads) > 1 else text, number=load)


def _stations(status: RunStatus) -> Card:
    """Return the card of stations: dead ones, lines out of step, slow ones; else how many answer."""
    dead = [f"channel {one.channel}, station {shown(one.station)}" for one in status.stations if one.dead]
    unsure = [f"channel {one.number} is {one.step}" for one in status.channels if one.step != "in step"]
    slow = [f"channel {one.number}: {text}" for one in status.channels for text in one.slow]
    text = "; ".join(filter(None, (_some(dead), _some(unsure), _some(slow))))
    if dead:
        return Card("Stations", f"{len(dead)} dead", text, "bad")
    if unsure:
        return Card("Stations", "Out of step" if "out of" in unsure[0] else "Waiting", f"{text}: late replies", "warn")
    if slow:
        return Card("Stations", "Slow", text, "warn")
    if not status.stations:
        return Card("Stations", "In step", "No late replies")
    states = {one.number: one.state for one in status.channels}
    silent = [
        f"channel {one.channel}, station {shown(one.station)}"
        for one in status.stations
        if _is_silent(one, states[one.channel])
    ]
    if silent:
        return Card("Stations", f"{len(silent)} of {len(status.stations)} silent", _some(silent), "warn")
    answering = sum(one.answers for one in status.stations)
    is_all = answering == len(status.stations)
    words = "All answer" if answering > 1 else "Answers"
    value = words if is_all else f"{answering} of {len(status.stations)}"
    return Card("Stations", value, f"{plural(len(status.stations), 'station')}, in step", "good" if is_all else "")


def _is_silent(station: StationStatus, channel: str) -> bool:
    """Return whether a station does not answer on a channel in this state: no block has, or the port is lost."""
    return channel not in HEALTHY or (channel == "open" and bool(station.failed) and not station.answers)


def point_card(points: Sequence[PointValue]) -> Card:
    """Return the card of points: how many are good, and the names of others."""
    wrong = [value for value in points if value.quality != "good"]
    text = (
        "All good"
        if not wrong
        else _some(f"{value.name}: {in_words(value.reason) or value.quality}" for value in wrong)
    )
    state = "" if not wrong else "bad" if any(value.quality == "failed" for value in wrong) else "warn"
    return Card("Points", f"{len(points) - len(wrong)} of {len(points)}", text, state)


def _some(texts: Iterable[str]) -> str:
    """Return a few texts, and how many others there are."""
    found = list(texts)
    more = f", and {len(found) - MOST_NAMED} more" if len(found) > MOST_NAMED else ""
    return ", ".join(found[:MOST_NAMED]) + more
