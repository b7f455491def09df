"""A key sent by KEYSET is used for the next secure channel, by framekit's client and by its simulated device."""

from __future__ import annotations

from pathlib import Path

import pytest

import framekit

pytest.importorskip("cryptography", reason="cryptography is not installed")

OLD, NEW = bytes(range(0x40, 0x50)), bytes(range(16))
DEVICE = f"device: reader\nprotocol: osdp\nstation: 5\nparams: {{scbk: {OLD.hex()}, answer_delay: 50 ms}}\n"
TOO_SHORT = {"reply_timeout": "10 ms", "retries": 0}
"""No reply of this device arrives within this time, so the client gives its channel up."""


def test_the_next_channel_of_a_client_has_the_new_key(tmp_path: Path) -> None:
    (tmp_path / "reader.device.yaml").write_text(DEVICE)
    port = f"sim:{tmp_path}/reader.device.yaml"
    with framekit.connect("osdp", port, station=5, params={"secure": "yes", "scbk": OLD.hex()}) as client:
        client.call("set_key", {"key": NEW})
        with pytest.raises(framekit.NoReplyError):
            client.call("poll", params=TOO_SHORT)
        answer = client.call("poll")
        assert answer.results["event"] == "done"
        assert answer.reply.fields["code"] == 0x40


def test_a_client_in_clear_gets_no_new_key_through(tmp_path: Path) -> None:
    (tmp_path / "reader.device.yaml").write_text(DEVICE)
    with framekit.connect("osdp", f"sim:{tmp_path}/reader.device.yaml", station=5) as client:
        with pytest.raises(framekit.RefusedError, match="encryption required"):
            client.call("set_key", {"key": NEW})
        assert client.call("poll").results["event"] == "done"
