"""Debian's mosquitto for tests: started on a free port, killed and restarted; and a subscriber."""

from __future__ import annotations

import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

BINARY = shutil.which("mosquitto", path="/usr/sbin:/usr/local/sbin:/usr/bin:/usr/local/bin:/opt/homebrew/sbin")
needs_mosquitto = pytest.mark.skipif(BINARY is None, reason="mosquitto is not installed")


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port: int = listener.getsockname()[1]
    return port


class Broker:
    """A mosquitto on `port`; `more` are lines of its configuration."""

    def __init__(self, folder: Path, *more: str, port: int | None = None) -> None:
        self.port = free_port() if port is None else port
        lines = (f"listener {self.port} 127.0.0.1", "max_queued_messages 0", "max_inflight_messages 0", *more)
        anonymous = () if any(line.startswith("password_file") for line in more) else ("allow_anonymous true",)
        self._file = folder / "mosquitto.conf"
        self._file.write_text("".join(f"{line}\n" for line in (*lines, *anonymous)))
        self._process: subprocess.Popen[bytes] | None = None
        self.start()

    def start(self) -> None:
        """Start the broker, and wait until it is reachable."""
        assert BINARY is not None
        self._process = subprocess.Popen([BINARY, "-c", str(self._file)], stderr=subprocess.DEVNULL)
        for _ in range(1000):
            try:
                socket.create_connection(("127.0.0.1", self.port), 1).close()
                return
            except OSError:
                time.sleep(0.01)
        raise AssertionError("mosquitto does not start")

    def kill(self) -> None:
        """End the process like a crash."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None

    def __enter__(self) -> Broker:
        return self

    def __exit__(self, *error: object) -> None:
        self.kill()


class Listener:
    """A subscriber of `topics`: records each message with its retain flag, and reconnects by itself.

    With `qos` 0 it acknowledges nothing, so all messages in transit arrive before the end of the connection, and no
    error before them.
    """

    def __init__(self, port: int, *topics: str, qos: int = 1, **access: Any) -> None:
        from paho.mqtt.client import Client
        from paho.mqtt.enums import CallbackAPIVersion

        self.heard: list[tuple[str, bytes, bool]] = []
        self._change = threading.Condition()
        self.listens = False
        self.client = client = Client(CallbackAPIVersion.VERSION2, client_id=f"test-{id(self)}")
        client.reconnect_delay_set(0.05, 0.05)  # type: ignore[arg-type]
        client.on_connect = lambda *_: client.subscribe([(topic, qos) for topic in topics])
        client.on_subscribe = lambda *_: self._set(True)
        client.on_disconnect = lambda *_: self._set(False)
        client.on_message = self._message
        if access:
            client.username_pw_set(access["user"], access["password"])
            client.tls_set(access["ca"])
        client.connect("127.0.0.1", port)
        client.loop_start()
        self.wait(lambda: self.listens)

    def _set(self, listens: bool) -> None:
        with self._change:
            self.listens = listens
            self._change.notify_all()

    def _message(self, client: Any, data: Any, message: Any) -> None:
        with self._change:
            self.heard.append((message.topic, message.payload, message.retain))
            self._change.notify_all()

    def wait(self, until: Callable[[], object], within: float = 20) -> None:
        with self._change:
            assert self._change.wait_for(until, within), self.heard[-20:]

    def of(self, topic: str) -> list[bytes]:
        """Return the payloads of a topic."""
        return [payload for one, payload, _ in self.heard if one == topic]

    def say(self, topic: str, payload: str, retain: bool = False) -> None:
        self.client.publish(topic, payload, 1, retain).wait_for_publish(10)

    def __enter__(self) -> Listener:
        return self

    def __exit__(self, *error: object) -> None:
        self.client.disconnect()
        self.client.loop_stop()
