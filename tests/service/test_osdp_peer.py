"""The control panel of the independent package `osdp`, with a simulated reader on a real terminal.

Unencrypted and in a secure channel. Skipped only if it is not installed. docs/protocols/osdp.md lists its bugs.
"""

from __future__ import annotations

import asyncio
import queue
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from peer_world import at_work, pty_device

from framekit.definition.times import LineFormat
from framekit.service.device import Serving

pytest.importorskip("cryptography", reason="cryptography is not installed")
osdp = pytest.importorskip("osdp", reason="osdp is not installed")
calculate_scbk = pytest.importorskip("osdp._secure_channel", reason="this osdp is another package").calculate_scbk

LINE = LineFormat(115200)
STATION = 0x25
MASTER = bytes.fromhex("404142434445464748494A4B4C4D4E4F")
IDENTITY = bytes.fromhex("464B000101000007")
KEY: bytes = calculate_scbk(MASTER, IDENTITY)
DEVICE = """
device: peer
protocol: osdp
station: 0x25
params: {{scbk: {key}, identity: {identity}, serial: 0x01020304, answer_delay: 0 ms{more}}}
state: {{inputs: {{initial: 00 01 00 01}}, card: {{initial: B5 81 23 40}}}}
"""


class Panel:
    """A control panel that polls one reader."""

    def __init__(self, path: str, secure: bool, use_crc: bool) -> None:
        self.replies: queue.Queue[Any] = queue.Queue()
        self.panel = osdp.ControlPanel(MASTER)
        self.panel._reply_handlers.append(self.replies.put)
        self.bus = self.panel.start_connection(osdp.SerialPortOsdpConnection(path, LINE.speed))
        self.panel.add_device(self.bus, STATION, use_crc, secure)

    def seen(self, kind: str) -> bytes:
        """Return the content of the next reply of a kind."""
        while True:
            found = self.replies.get(timeout=20)
            if found.type.name == kind:
                return bytes(found.extract_reply_data)

    def asked(self, command: Any) -> Any:
        """Return the reply to a command."""
        return self.panel.send_command(self.bus, command(STATION))


def working(path: str, secure: bool, use_crc: bool) -> None:
    panel = Panel(path, secure, use_crc)
    try:
        if secure:
            assert panel.seen("CrypticData")[:8] == IDENTITY
            assert len(panel.seen("InitialRMac")) == 16
        assert panel.seen("RawReaderData") == bytes.fromhex("00 01 1A 00 B5 81 23 40")
        identity = panel.panel.id_report(panel.bus, STATION)
        assert (identity.vendor_code, identity.serial_number, identity.firmware_major) == (b"FK\0", 0x01020304, 1)
        kinds = {
            capability.function.name for capability in panel.panel.device_capabilities(panel.bus, STATION).capabilities
        }
        assert {"ReaderLEDControl", "CommunicationSecurity", "CheckCharacterSupport"} <= kinds
        assert list(panel.panel.input_status(panel.bus, STATION).statuses) == [False, True, False, True]
        on = osdp.OutputControl(2, osdp.OutputControlCode.PermanentStateOnAbortTimedOperation, 0)
        assert panel.panel.output_control(panel.bus, STATION, osdp.OutputControls([on]))
        assert list(panel.panel.output_status(panel.bus, STATION).statuses) == [False, False, True, False]
        assert not panel.panel.local_status(panel.bus, STATION).tamper
        text = osdp.ReaderTextOutput(
            0, osdp.TextCommand.PermanentTextNoWrap, 0, 1, 1, "A text that takes several blocks"
        )
        assert panel.asked(partial(osdp.ReaderTextOutputCommand, reader_text_output=text)).type.name == "Ack"
        unknown = panel.asked(partial(osdp.ManufacturerSpecificCommand, manufacturer_data=b"\1\2\3"))
        assert (unknown.type.name, bytes(unknown.extract_reply_data)) == ("Nak", b"\3")
        for _ in range(7):  # more than one cycle of sequence numbers
            assert panel.seen("Ack") == b""
    finally:
        panel.panel.shutdown()


@pytest.mark.parametrize("use_crc", [True, False], ids=["crc", "checksum"])
@pytest.mark.parametrize("secure", [False, True], ids=["clear", "secure"])
def test_its_panel_works_with_a_simulated_reader(tmp_path: Path, secure: bool, use_crc: bool) -> None:
    async def scenario() -> Serving:
        text = DEVICE.format(key=KEY.hex(), identity=IDENTITY.hex(), more="")
        async with pty_device(tmp_path, text, LINE) as (path, serving):
            await at_work(working, path, secure, use_crc)
            (services,) = serving.connected.values()
            assert services[0].engine.status()["shown"] == "A text that takes several blocks"
            assert services[0].engine.scope["channel"].get(STATION, 0) == secure
        return serving

    assert not asyncio.run(scenario()).line_errors.keys() - {"bytes of noise"}, "but for the FF before each command"


def setting_a_key(path: str) -> None:
    panel = Panel(path, secure=True, use_crc=True)
    try:
        assert panel.seen("CrypticData")[:8] == IDENTITY
        assert len(panel.seen("InitialRMac")) == 16
        assert panel.seen("Ack") == b""
    finally:
        panel.panel.shutdown()


def test_its_panel_gives_a_new_reader_its_key(tmp_path: Path) -> None:
    """A reader in install mode accepts the default key.

    The panel opens a channel with it and sends the reader's own key.
    """

    async def scenario() -> None:
        text = DEVICE.format(key="00" * 16, identity=IDENTITY.hex(), more=", default_key: yes")
        async with pty_device(tmp_path, text.replace("B5 81 23 40", '""'), LINE) as (path, serving):
            await at_work(setting_a_key, path)
            (services,) = serving.connected.values()
            assert services[0].engine.scope["new_scbk"] == KEY

    asyncio.run(scenario())
