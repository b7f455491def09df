"""The documentation's run with a scripted modem on a pseudo-terminal: it dials, exchanges data, hangs up."""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import sys
from itertools import chain
from pathlib import Path

import pytest
from docs.pages import DOCS, snippets
from transport.real_world import PtyMaster
from transport.real_world import run as run_real
from transport.scripted_modem import ScriptedModem

from framekit.api.run import AsyncRun
from framekit.runfile.run_file import load_run
from framekit.transport.clock import AsyncioClock

MS = 1_000_000
REQUEST = bytes.fromhex("01 03 00 00 00 01 84 0A")
REPLY = bytes.fromhex("01 03 02 12 34 B5 33")

[EXAMPLE] = [snippet.text for snippet in snippets(DOCS / "modems.md") if snippet.file == "pump-house.run.yaml"]


class Pump:
    """The station at the other end of the telephone line."""

    def __init__(self) -> None:
        self.heard = b""

    def __call__(self, data: bytes) -> bytes:
        self.heard += data
        return REPLY if self.heard.endswith(REQUEST) else b""


class Telephone:
    """A scripted modem on a pseudo-terminal."""

    def __init__(self, *calls: str, has_echo: bool, has_words: bool) -> None:
        self.cable = PtyMaster()
        self.loop = asyncio.get_running_loop()
        clock = AsyncioClock(self.loop)
        self.pump = Pump()
        self.modem = ScriptedModem(
            self.write,
            lambda delay, call: clock.call_at(clock.now() + delay, call),
            clock.now,
            list(calls),
            has_echo=has_echo,
            has_words=has_words,
            takes=20 * MS,
            guard=20 * MS,
            answer=self.pump,
        )
        self.loop.add_reader(self.cable.fileno(), lambda: self.modem.feed(os.read(self.cable.fileno(), 1024)))

    def write(self, data: bytes) -> None:
        os.write(self.cable.fileno(), data)

    def close(self) -> None:
        self.loop.remove_reader(self.cable.fileno())
        self.cable.close()


def made_quick(text: str, port: str) -> str:
    """Return the example with this port and short pauses."""
    quick = "guard: 100 ms, pause: 50 ms, "
    changed = text.replace("/dev/ttyUSB0", port).replace("pause: 10 s, ", quick)
    assert quick in changed and port in changed
    return changed.replace("    type: rs232\n", "    type: rs232\n    reconnect: 50 ms\n")


async def opened(run: AsyncRun) -> None:
    while run.status().channels[0].state != "open":
        await asyncio.sleep(0)


@pytest.mark.parametrize("has_echo", [True, False])
@pytest.mark.parametrize("has_words", [True, False])
def test_the_example_engaged_connected_lost_connected_and_hung_up(
    has_echo: bool, has_words: bool, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "framekit.service.driver")

    async def check() -> None:
        phone = Telephone("BUSY", "CONNECT 9600", "CONNECT 9600", has_echo=has_echo, has_words=has_words)
        port = phone.cable.path
        path = tmp_path / "pump-house.run.yaml"
        path.write_text(made_quick(EXAMPLE, port), "utf-8")
        ended: asyncio.Queue[bool] = asyncio.Queue()
        run = AsyncRun(path, on_end=lambda status, ok: ended.put_nowait(ok))
        run.start()
        await opened(run)
        run.fire(0)
        assert await ended.get() and run.status().channels[0].state == "open"
        phone.modem.has_words = True
        phone.modem.lose_carrier()
        while run.status().channels[0].state == "open":
            await asyncio.sleep(0)
        assert run.status().channels[0].state == f"{port}: the connection with 0,62211234 is lost"
        phone.modem.has_words = has_words
        await opened(run)
        run.fire(0)
        assert await ended.get()
        await run.finish()
        assert phone.modem.commands == [*["ATZ", "ATX3", "ATDT0,62211234"] * 3, "ATH"]
        assert not phone.modem.is_online, "the run has ended when the modem has hung up"
        assert phone.pump.heard == REQUEST * 2
        phone.close()

    run_real(check())
    first, second = [record.getMessage() for record in caplog.records if not hasattr(record, "is_report")]
    assert "the modem answers BUSY: 0,62211234 is engaged), trying again in 0.1 s" in first
    assert "the connection with 0,62211234 is lost), trying again in 0.1 s" in second


def test_a_channel_that_is_disabled_hangs_up_and_an_enabled_one_dials(tmp_path: Path) -> None:
    async def check() -> None:
        phone = Telephone("CONNECT", "CONNECT", has_echo=True, has_words=True)
        path = tmp_path / "pump-house.run.yaml"
        path.write_text(made_quick(EXAMPLE, phone.cable.path), "utf-8")
        async with AsyncRun(path) as run:
            await opened(run)
            run.enable_channel(1, False)
            while "ATH" not in phone.modem.commands:
                await asyncio.sleep(0)
            run.enable_channel(1)
            await opened(run)
        assert phone.modem.commands == ["ATZ", "ATX3", "ATDT0,62211234", "ATH"] * 2
        phone.close()

    run_real(check())


def test_an_edited_channel_dials_when_its_modem_has_hung_up(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "framekit.service.driver")

    async def check() -> None:
        phone = Telephone("CONNECT", "CONNECT", has_echo=True, has_words=True)
        path = tmp_path / "pump-house.run.yaml"
        text = made_quick(EXAMPLE, phone.cable.path)
        path.write_text(text, "utf-8")
        async with AsyncRun(path) as run:
            await opened(run)
            path.write_text(text.replace("6221 1234", "6221 5678"), "utf-8")
            run.edit(load_run(path))
            while len(phone.modem.dialled) < 2:
                await asyncio.sleep(0)
            await opened(run)
        calls = (["ATZ", "ATX3", f"ATDT0,6221{number}", "ATH"] for number in ("1234", "5678"))
        assert phone.modem.commands == [*chain(*calls)]
        phone.close()

    run_real(check())
    assert caplog.messages == [], "the device was not opened while the modem hung up"


def slow_example(port: str) -> str:
    """Return the example with a guard time that is long enough for an edit."""
    return made_quick(EXAMPLE, port).replace("guard: 100 ms", "guard: 500 ms")


async def dialled_again(phone: Telephone) -> None:
    while len(phone.modem.dialled) < 2:
        await asyncio.sleep(0)


def test_a_second_edit_waits_for_the_modem_too(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "framekit.service.driver")

    async def check() -> None:
        phone = Telephone("CONNECT", "CONNECT", has_echo=True, has_words=True)
        path = tmp_path / "pump-house.run.yaml"
        text = slow_example(phone.cable.path)
        path.write_text(text, "utf-8")
        async with AsyncRun(path) as run:
            await opened(run)
            for number in ("5678", "9999"):
                path.write_text(text.replace("6221 1234", f"6221 {number}"), "utf-8")
                run.edit(load_run(path))
            await dialled_again(phone)
            await opened(run)
        calls = (["ATZ", "ATX3", f"ATDT0,6221{number}", "ATH"] for number in ("1234", "9999"))
        assert phone.modem.commands == [*chain(*calls)]
        phone.close()

    run_real(check())
    assert caplog.messages == [], "the device was not opened while the modem hung up"


def test_a_channel_with_another_number_waits_for_the_modem(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "framekit.service.driver")

    async def check() -> None:
        phone = Telephone("CONNECT", "CONNECT", has_echo=True, has_words=True)
        path, link = tmp_path / "pump-house.run.yaml", tmp_path / "modem"
        link.symlink_to(phone.cable.path)
        text = slow_example(phone.cable.path)
        path.write_text(text, "utf-8")
        async with AsyncRun(path) as run:
            await opened(run)
            text = text.replace("  1:\n", "  2:\n").replace("{station: 1,", "{channel: 2, station: 1,")
            path.write_text(text.replace(phone.cable.path, str(link)), "utf-8")
            run.edit(load_run(path))
            await dialled_again(phone)
            await opened(run)
        assert phone.modem.commands == ["ATZ", "ATX3", "ATDT0,62211234", "ATH"] * 2
        phone.close()

    run_real(check())
    assert caplog.messages == [], "the device was not opened while the modem hung up"


def test_a_channel_disabled_and_enabled_by_hand_waits_for_the_modem_of_the_one_before(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "framekit.service.driver")

    async def check() -> None:
        phone = Telephone("CONNECT", "CONNECT", has_echo=True, has_words=True)
        path = tmp_path / "pump-house.run.yaml"
        text = slow_example(phone.cable.path)
        path.write_text(text, "utf-8")
        async with AsyncRun(path) as run:
            await opened(run)
            path.write_text(text.replace("6221 1234", "6221 5678"), "utf-8")
            run.edit(load_run(path))
            run.enable_channel(1, False)
            run.enable_channel(1)
            await dialled_again(phone)
            await opened(run)
        assert phone.modem.commands.count("ATH") == 2 and not phone.modem.is_online
        phone.close()

    run_real(check())
    assert caplog.messages == [], "the device was not opened while the modem hung up"


@pytest.mark.parametrize("change", ["disabled", "gone"])
def test_a_run_that_ends_after_an_edit_waits_until_the_modem_has_hung_up(change: str, tmp_path: Path) -> None:
    async def check() -> None:
        phone = Telephone("CONNECT", has_echo=True, has_words=True)
        path = tmp_path / "pump-house.run.yaml"
        text = slow_example(phone.cable.path)
        path.write_text(text, "utf-8")
        run = AsyncRun(path)
        run.start()
        await opened(run)
        if change == "disabled":
            text = text.replace("    protocol: modbus-rtu\n", "    protocol: modbus-rtu\n    enabled: no\n")
        else:
            text = text.replace(phone.cable.path, str(tmp_path / "another"))
        path.write_text(text, "utf-8")
        run.edit(load_run(path))
        assert phone.modem.is_online
        await run.finish()
        assert not phone.modem.is_online and phone.modem.commands[-1] == "ATH"
        phone.close()

    run_real(check())


def test_a_run_that_ends_while_it_dials_cancels_the_call(tmp_path: Path) -> None:
    async def check() -> None:
        phone = Telephone("", has_echo=True, has_words=True)
        path = tmp_path / "pump-house.run.yaml"
        path.write_text(made_quick(EXAMPLE, phone.cable.path), "utf-8")
        async with AsyncRun(path):
            while not phone.modem.dialled:
                await asyncio.sleep(0)
        assert not phone.modem.is_calling and "ATH" not in phone.modem.commands
        phone.close()

    run_real(check())


def test_a_second_signal_ends_a_run_whose_modem_does_not_hang_up(tmp_path: Path) -> None:
    async def check() -> None:
        phone = Telephone("CONNECT", has_echo=True, has_words=True)
        cable, heard = phone.cable, bytearray()
        requested, escaped = asyncio.Event(), asyncio.Event()

        def answer(data: bytes) -> bytes:
            reply = phone.pump(data)
            if reply:
                phone.loop.call_soon(requested.set)
            return reply

        def hear() -> None:
            heard.extend(os.read(cable.fileno(), 1024))
            if heard.endswith(b"+++"):
                escaped.set()

        phone.modem.answer = answer
        path = tmp_path / "pump-house.run.yaml"
        path.write_text(
            made_quick(EXAMPLE, cable.path)
            .replace("guard: ", "within: 30 s, guard: ")
            .replace("every: 1 min", "every: 1 s"),
            "utf-8",
        )
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "framekit", "run", str(path),
            stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
        )  # fmt: skip
        await requested.wait()
        phone.loop.remove_reader(cable.fileno())
        phone.loop.add_reader(cable.fileno(), hear)
        process.send_signal(signal.SIGINT)
        await escaped.wait()
        process.send_signal(signal.SIGINT)
        output, errors = await process.communicate()
        assert errors.decode() == (
            "framekit run: ended by a second signal: sessions may be open, and modems may hold the line\n"
        )
        assert process.returncode == 0 and b"READ 40001" in output, output
        assert heard.endswith(b"+++"), "it has not waited for a reply to the escape sequence"
        phone.close()

    run_real(check())
