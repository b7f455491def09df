"""Simulated devices on the page: the areas of their memory, values set by hand, faults switched on and off."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from functools import partial
from typing import Any

from framekit.api.errors import RequestError
from framekit.definition.times import format_time
from framekit.extras.web.messages import Actions, Message, Told, plain_text, whole_number
from framekit.link.addresses import Address, AddressError
from framekit.memory.memory import Area, DeviceMemoryError, unit_bits
from framekit.run.behaviours import Behaviour
from framekit.run.model import FaultRule
from framekit.service.device import DeviceStore
from framekit.service.faults import RuleAtWork

log = logging.getLogger(__name__)

MOST_ELEMENTS = 512
"""Maximum number of elements in one message."""
TIMES = ("every", "after", "over", "period", "pulse", "lag")
"""Keys of behaviours that are times in ns."""
KIND_WORDS = {
    "no_reply": "No reply", "delay": "Delay", "jitter": "Jitter", "wrong_check": "Wrong check code",
    "wrong_station": "Wrong station", "error_reply": "Request refused", "truncate": "End missing",
    "extra": "Extra bytes", "glue": "Frames joined", "split": "Frames in pieces", "echo": "Echo", "noise": "Noise",
    "stray": "Stray bytes", "disconnect": "Disconnect",
}  # fmt: skip

Tried = Callable[[Told, Callable[[], None]], Message]
"""Executes an action if the visitor may; the answer says whether it was done, or why not."""


class DeviceView:
    """Devices under their names on the page. A device over two protocols appears once."""

    def __init__(self, named: Mapping[str, DeviceStore]) -> None:
        self.names = tuple(named)
        self.stores = list(named.values())

    def described(self) -> list[Message]:
        """Return the constant content: names, areas and faults of each device, and what its values do by themselves."""
        return [
            {
                "name": name,
                "protocol": store.device.protocol.name,
                "station": store.device.station,
                "areas": [[area.name, area.size, area.unit, area.element_bits, area.access] for area in _areas(store)],
                "used": _used(store),
                "faults": [fault_text(rule.model) for rule in _rules(store)],
                "behaviours": {one.name or one.place.address: behaviour_text(one) for one in store.device.behaviours},
            }
            for name, store in zip(self.names, self.stores, strict=True)
        ]

    def actions(self, tried: Tried, who: str) -> Actions:
        """Return the requests of a browser about devices."""
        return {
            "area": self._area,
            "find": self._find,
            "set": partial(self._set, tried, who),
            "faults": self._faults,
            "fault": partial(self._fault, tried, who),
        }

    # ---- areas ----------------------------------------------------------------------------------------------

    def _store(self, number: Any) -> DeviceStore:
        """Return a device by its number. Raise ValueError."""
        at = whole_number(number)
        if at >= len(self.stores):
            raise ValueError("this is no message")
        return self.stores[at]

    def _place(self, device: Any, told: Told) -> tuple[DeviceStore, Area]:
        """Return the device and the area that a message names. Raise ValueError."""
        store, number = self._store(device), whole_number(told.get("number"))
        areas = _areas(store)
        if number >= len(areas):
            raise ValueError("this is no message")
        return store, areas[number]

    def _area(self, device: Any, told: Told) -> Message:
        """Return values of an area, and the addresses of every `step`-th of them."""
        store, area = self._place(device, told)
        first, step = whole_number(told.get("first")), whole_number(told.get("step"))
        count = min(whole_number(told.get("count")), MOST_ELEMENTS, area.size - first)
        if count < 1 or step < 1:
            raise ValueError("this is no message")
        store.refresh()
        values = area.read(area.unit, first, count)
        large = area.element_bits > 32
        return {
            "area": device, "number": told.get("number"), "first": first,
            "elements": [str(value) for value in values] if large else values,
            "addresses": [address_text(store, area, first + at) for at in range(0, count, step)],
        }  # fmt: skip

    def _find(self, device: Any, told: Told) -> Message:
        """Return the place of an address: the number of its area, and of its element."""
        store = self._store(device)
        answer: Message = {"find": device}
        try:
            address = store.device.grammar.parse(plain_text(told.get("address")))
        except AddressError as error:
            return {**answer, "why": str(error)}
        for number, area in enumerate(_areas(store)):
            if address.area in (area.name, *area.aliases):
                return {**answer, "number": number, "element": address.first_bit // area.element_bits}
        return {**answer, "why": "this address has no place in memory"}

    def _set(self, tried: Tried, who: str, device: Any, told: Told) -> Message:
        """Write one element of an area."""
        store, area = self._place(device, told)
        element, text = whole_number(told.get("element")), plain_text(told.get("value"))
        if element >= area.size:
            raise ValueError("this is no message")

        def write() -> None:
            value = number_for(text, area)
            before = area.read(area.unit, element)[0]
            try:
                area.write(area.unit, element, [value], force=True)
            except DeviceMemoryError as error:
                raise RequestError(str(error)) from None
            where = address_text(store, area, element) or f"{area.name} {element}"
            log.info("device %s: %s: %d → %d, set by %s", store.device.name, where, before, value, who)

        return tried(told, write)

    # ---- faults ---------------------------------------------------------------------------------------------

    def _faults(self, wanted: Any, told: Told) -> Message:
        """Return for each device its faults: whether each is on, and how often it occurred."""
        return {"faults": [[[rule.is_on, rule.done] for rule in _rules(store)] for store in self.stores]}

    def _fault(self, tried: Tried, who: str, device: Any, told: Told) -> Message:
        """Switch a fault on or off."""
        store, number, on = self._store(device), whole_number(told.get("number")), told.get("on")
        rules = _rules(store)
        if number >= len(rules) or not isinstance(on, bool):
            raise ValueError("this is no message")

        def switch() -> None:
            rule = rules[number]
            rule.is_on = on
            if on and rule.model.times is not None and rule.done >= rule.model.times:
                rule.done = 0  # a fault that occurs some times only begins anew
            text = fault_text(rule.model)
            log.info("device %s: fault %r is %s, by %s", store.device.name, text, "on" if on else "off", who)

        return tried(told, switch)


def _areas(store: DeviceStore) -> Sequence[Area]:
    return [store.memory.area(area.name) for area in store.device.areas]


def _used(store: DeviceStore) -> int:
    """Return the number of the first area with a value that behaves or has a start value; 0 without any."""
    device = store.device
    places = [*(one.place.place for one in device.behaviours), *(place for place, _ in device.initial)]
    first = places[0].address.area if places else ""
    return next((number for number, area in enumerate(device.areas) if area.name == first), 0)


def _rules(store: DeviceStore) -> Sequence[RuleAtWork]:
    return () if store.faults is None else store.faults.rules


def address_text(store: DeviceStore, area: Area, element: int) -> str:
    """Return the address of an element as users write it; '' if the protocol has no text that means this element."""
    grammar = store.device.grammar
    same = (one.name for one in store.device.protocol.areas.values() if one.memory == area.name)
    for name in dict.fromkeys((area.name, *same)):
        try:
            text = grammar.print(Address(name, area.unit, element))
            place = grammar.parse(text)
        except (AddressError, KeyError):
            continue
        if place.area in (area.name, *area.aliases) and place.first_bit == element * area.element_bits:
            return text
    return ""


def number_for(text: str, area: Area) -> int:
    """Return the number to store for a text: decimal, hexadecimal `0x1F`, or negative. Raise RequestError."""
    bits = unit_bits(area.unit)
    try:
        value = int(text, 0)
    except ValueError:
        raise RequestError(f"{text!r} is no number – write one such as 12, 0x1F or -5") from None
    if not -(1 << bits - 1 if bits > 1 else 0) <= value < 1 << bits:
        raise RequestError(f"{value} does not fit into a {area.unit}: give 0 to {(1 << bits) - 1}")
    return value % (1 << bits)


def fault_text(rule: FaultRule) -> str:
    """Return a fault in words: its kind, and how often it occurs."""
    words = [KIND_WORDS[rule.kind]]
    if rule.time is not None:
        words.append(format_time(rule.time))
    if rule.every is not None:
        words.append(f"every {rule.every}. frame")
    if rule.rate is not None:
        words.append(f"{100 * rule.rate:g} %")
    if rule.times is not None:
        words.append("once" if rule.times == 1 else f"{rule.times} times")
    if rule.frame is not None:
        words.append(f"frame {rule.frame}")
    return ", ".join(words)


def behaviour_text(behaviour: Behaviour) -> str:
    """Return a behaviour as its file defines it: `sine 18..24, period 1 min`."""
    words = []
    for one in fields(behaviour):
        value = getattr(behaviour, one.name)
        if (
            "key" not in one.metadata
            or one.name in ("name", "type", "order", "scale", "offset", "unit")
            or value == one.default
        ):
            continue
        words.append((one.name.replace("_", " "), _value_text(one.name, value)))
    words.sort(key=lambda word: word[0] != behaviour.word)
    return ", ".join(f"{name} {value}" for name, value in words)


def _value_text(name: str, value: Any) -> str:
    if isinstance(value, tuple):
        return "..".join(f"{number:g}" for number in value)
    return format_time(value) if name in TIMES and isinstance(value, int) else str(value)
