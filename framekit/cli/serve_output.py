"""What `framekit serve` shows: a line when it is ready, what goes over the line, and what was done at the end."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from framekit.cli.common import table
from framekit.cli.seen_output import seen_data, seen_text

if TYPE_CHECKING:
    from framekit.blocks.device import Device
    from framekit.link.observe import Seen
    from framekit.service.serving import Serving
    from framekit.service.serving_ports import Served


class ServeOutput:
    """Watches devices. `began` is when time began; `lost` is called when nobody reads the output any more."""

    def __init__(self, devices: Sequence[Device], began: int, lost: Callable[[], None]) -> None:
        self.devices = devices
        self.began = began
        self.lost = lost
        self.is_ready = False
        self._trouble: OSError | None = None

    def line(self, text: str) -> None:
        """Prints a line at once. When that can't be done, serving ends."""
        if self._trouble is None:
            try:
                print(text, flush=True)
            except OSError as error:
                self._trouble = error
                self.lost()

    def check(self) -> None:
        """Raises OSError when something could not be printed."""
        if self._trouble is not None:
            raise self._trouble

    def seen(self, port: str, number: int, seen: Seen) -> None:
        """Every device hears what comes: the first one's ears are enough."""
        if self.is_ready and (number == 0 or seen.direction == "out" or seen.kind == "trouble"):
            self.show(port, number, seen)

    def show(self, port: str, number: int, seen: Seen) -> None:
        raise NotImplementedError

    def warning(self, text: str) -> None:
        print(text, file=sys.stderr)

    def ready(self, served: Served) -> None:
        """The port is open: requests can come."""
        self.is_ready = True
        self.show_ready(served)

    def show_ready(self, served: Served) -> None:
        raise NotImplementedError

    def summary(self, serving: Serving) -> None:
        raise NotImplementedError

    def status(self, serving: Serving, now: int) -> None:
        """The same while it goes on."""
        raise NotImplementedError

    def reasons(self, serving: Serving, number: int) -> dict[str, int]:
        """Why a device has refused requests, and how often."""
        from framekit.service.service_counters import refusal_text

        protocol, counters = self.devices[number].protocol, serving.stores[number].counters
        return {refusal_text(protocol, code): count for code, count in sorted(counters.refused.items())}


def _client(port: str) -> str:
    """A connection by its other side; nothing for the one port there is."""
    return port.removeprefix("tcp://") if port.startswith("tcp://") else ""


class TextServeOutput(ServeOutput):
    """For people."""

    def show_ready(self, served: Served) -> None:
        own = list(dict.fromkeys(device.station for device in self.devices if device.own is not None))
        stations = f" station{'s' if len(own) > 1 else ''} {', '.join(own)}" if own else ""
        names = dict.fromkeys(device.protocol.name for device in self.devices)
        self.line(f"ready: {', '.join(names)}{stations} on {served.about}")

    def show(self, port: str, number: int, seen: Seen) -> None:
        self.line(seen_text(seen, (seen.at - self.began) / 1e9, _client(port)))

    def summary(self, serving: Serving) -> None:
        rows, reasons, status = [], [], []
        for number, store in enumerate(serving.stores):
            own = store.device.station or "-"
            rows.append((own, str(store.counters.done), str(store.counters.errors)))
            reasons += [(own, text, str(count)) for text, count in self.reasons(serving, number).items()]
            status += [(own, name, str(value)) for name, value in serving.published(number).items()]
        reasons += [("line", text, str(count)) for text, count in sorted(serving.line_errors.items())]
        self.line("\n" + table(rows, ("station", "services", "errors")))
        if reasons:
            self.line("\n" + table(reasons, ("where", "reason", "count")))
        if status:
            self.line("\n" + table(status, ("station", "status", "value")))

    def status(self, serving: Serving, now: int) -> None:
        self.line(f"\nstatus at {(now - self.began) / 1e9:.3f} s")
        self.summary(serving)
        self.line("")


class JsonServeOutput(ServeOutput):
    """One JSON object a line."""

    def data(self, line: dict[str, Any]) -> None:
        self.line(json.dumps(line, ensure_ascii=False))

    def show_ready(self, served: Served) -> None:
        stations = [_plain(device.own) for device in self.devices if device.own is not None]
        protocol = self.devices[0].protocol.name
        ready = {"event": "ready", "protocol": protocol, "port": served.port, "stations": stations}
        line = served.about.removeprefix(served.port).removeprefix(" at ")
        self.data({**ready, "line": line} if line else ready)

    def show(self, port: str, number: int, seen: Seen) -> None:
        from framekit.codec.plain import PlainValues

        device = self.devices[number]
        where = {"client": _client(port)} if _client(port) else {}
        if seen.direction == "out" and device.own is not None:
            where["station"] = _plain(device.own)
        self.data(seen_data(seen, (seen.at - self.began) / 1e9, PlainValues(device.protocol), **where))

    def summary(self, serving: Serving) -> None:
        for number, store in enumerate(serving.stores):
            counters = store.counters
            line = {
                "event": "station",
                "station": _plain(store.device.own),
                "services": counters.done,
                "errors": counters.errors,
                "reasons": self.reasons(serving, number),
                "status": {name: _plain(value) for name, value in serving.published(number).items()},
            }
            self.data({key: value for key, value in line.items() if value not in ({}, None)})
        self.data({"event": "line", "connections": serving.connections, "reasons": dict(serving.line_errors)})

    def status(self, serving: Serving, now: int) -> None:
        self.data({"event": "status", "time": (now - self.began) / 1e9})
        self.summary(serving)


def _plain(value: Any) -> Any:
    return value.hex(" ").upper() if isinstance(value, bytes) else value
