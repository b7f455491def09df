"""The small vectors of the channels' manual (specification 5.11) that no other test contains literally."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from framekit.definition.load.protocol import load_protocol
from framekit.definition.model.protocol import Protocol
from framekit.definition.problems import NOWHERE
from framekit.extras.commreq.command_meaning import meaning_of
from framekit.extras.commreq.job_profiles import load_job_profile
from framekit.link.scope import Scope
from framekit.memory.memory import DeviceMemory
from framekit.memory.views import as_signed
from framekit.run.commands import CommandBlocks, bytes_of, words_of
from framekit.run.model import CodeClass
from framekit.runfile.blocks import commands_for
from framekit.runfile.devices import memory_of

PROFILE = load_job_profile("ge-channels")
READ = [17, 0, 8, 9, 0, 0, 2003, 5, 10, 3, 20, 0, 8, 100, 8, 50, 4, 1, 4, 3, 0, 0, 2]


@cache
def srtp() -> Protocol:
    return load_protocol("srtp")


def blocks() -> CommandBlocks:
    application = commands_for(srtp(), "ge-channels", Path.cwd(), NOWHERE)
    memory = DeviceMemory(memory_of(application)[0])
    return CommandBlocks(application, memory, channel=Scope(srtp(), role="client"))


def test_names_have_their_first_character_in_the_low_byte() -> None:
    fields = {
        "channel": 1, "unit": 3, "period": 1, "here_type": 8, "here": 1, "type": 8, "address": 1, "count": 1,
        "name": "MARY",
    }  # fmt: skip
    assert words_of(blocks().words.make("channel_read_name", fields, {}))[19:21] == [0x414D, 0x5952]


def test_status_words_and_periods() -> None:
    made = blocks()
    for offset, place in ((0, "%R1"), (99, "%R100")):
        words = list(READ)
        words[3] = offset
        meaning = meaning_of(made.words.read(bytes_of(words)), made, srtp())
        assert meaning.status == place and "every 20 s" in meaning.does[1], "unit 3, count 20"


def test_an_error_is_told_by_its_number_not_by_its_size() -> None:
    assert as_signed([0x9090], "word") == [-28528]
    assert [word for word in (0x0001, 0x9090, 0xC105, 0x0290) if PROFILE.kind_of(word) is CodeClass.GOOD] == [1]


def test_the_bits_from_i33_on() -> None:
    bits, first = PROFILE.bits, 33
    (done, step), (error, _) = bits.done, bits.error
    assert (first + done - 1, first + error - 1) == (49, 50) and (done + 15 * step, error + 15 * step) == (47, 48)
    assert (first + bits.network - 1, first + bits.ready - 1, first + bits.size - 1) == (45, 48, 112)
