"""Word blocks of the five channel commands: their meaning, and every code that refuses a block (GFK-1084B, 3-39)."""

from __future__ import annotations

from functools import cache

import pytest

from framekit.definition.load.protocol import load_protocol
from framekit.extras.commreq.command_meaning import Meaning, meaning_of
from framekit.extras.commreq.job_profiles import load_job_profile
from framekit.link.scope import Scope
from framekit.memory.memory import DeviceMemory
from framekit.run.commands import CommandBlocks, CommandFaultError, bytes_of
from framekit.runfile.devices import memory_of

READ = [17, 0, 8, 9, 0, 0, 2003, 5, 10, 3, 7, 50, 8, 100, 8, 50, 8, 1, 4, 3, 0, 0, 1]
NAME = [0x4C50, 0x5F43, 0x6131, 0x0061] + [0] * 28
BY_NAME = [45, *READ[1:17], 3, 32, *NAME]
REPORT = [17, 0, 8, 9, 0, 0, 2010, 7, 10, 3, 7, 50, 8, 50, 8, 0, 0, 1, 4, 3, 0, 0, 1]


@cache
def blocks() -> CommandBlocks:
    application, protocol = load_protocol("ge-channels"), load_protocol("srtp")
    areas, _ = memory_of(application)
    scope = Scope(protocol, role="client")
    return CommandBlocks(application, DeviceMemory(areas), channel=scope)


def meaning(words: list[int]) -> Meaning:
    return meaning_of(blocks().words.read(bytes_of(words)), blocks(), load_protocol("srtp"))


def changed(words: list[int], **at: int) -> list[int]:
    """Return the words with replacements, such as `w17=0`; places count from 1 as in the manual."""
    found = list(words)
    for name, value in at.items():
        found[int(name[1:]) - 1] = value
    return found


def test_what_the_commands_mean() -> None:
    assert meaning(READ).does == [
        "reads %R50 (8 × word) into the own %R100",
        "as the job in slot 5, with 3.0.0.1, every 7 s, 10 times, late after 500 ms",
    ]
    assert meaning(BY_NAME).does[1].startswith("as the job in slot 5, with PLC_1aa,")
    assert meaning(changed(READ, w7=2004, w9=0, w11=0, w12=0)).does == [
        "writes %R50 (8 × word) from the own %R100",
        "as the job in slot 5, with 3.0.0.1, back to back, until it is aborted",
    ]
    assert meaning(REPORT).does[1] == "reports the own %R50 (8 × word)"
    assert meaning([2, 0, 8, 9, 0, 0, 2001, 5]).does == ["aborts the job in slot 5"]
    assert meaning([2, 0, 8, 9, 0, 0, 2001, -1]).does == ["aborts all jobs"]
    assert meaning([4, 0, 8, 9, 0, 0, 2002, 5, 8, 100]).does[1] == "stores two words from the own %R100 on"
    assert meaning(READ).status == "%R10" and meaning(changed(READ, w3=70, w4=0)).status == "%I1"


REFUSED = [
    ("no such command", [2, 0, 8, 9, 0, 0, 2005, 5], 0x9E90),
    ("too short for the command", [8, *READ[1:14]], 0x8190),
    ("too short for abort", [1, 0, 8, 9, 0, 0, 2001], 0x8190),
    ("too short for the address", [15, *READ[1:21]], 0x8290),
    ("too short for a name", [17, *READ[1:17], 3, 32, 0x4C50, 0x5F43, 0x6131, 0x61], 0x8290),
    ("channel 0", changed(READ, w8=0), 0x8890),
    ("channel 17", changed(READ, w8=17), 0x8890),
    ("all channels to be read", changed(READ, w8=0xFFFF), 0x8890),
    ("details of all channels", [4, 0, 8, 9, 0, 0, 2002, 0xFFFF, 8, 100], 0x8890),
    ("time unit 0", changed(READ, w10=0), 0x8990),
    ("time unit 6", changed(READ, w10=6), 0x8990),
    ("5966 hours", changed(READ, w10=5, w11=5966), 0x8A90),
    ("local type", changed(READ, w13=9), 0x8C90),
    ("local type of the other side only", changed(READ, w13=4), 0x8C90),
    ("local system bits to be read into", changed(READ, w13=84), 0x8C90),
    ("local address 0", changed(READ, w14=0), 0x9190),
    ("server type", changed(READ, w15=9), 0x8390),
    ("server system bits to be written", changed(READ, w7=2004, w15=30), 0x8390),
    ("server address 0", changed(READ, w16=0), 0x8B90),
    ("no elements", changed(READ, w17=0), 0x8690),
    ("1025 words", changed(READ, w17=1025), 0x8790),
    ("2049 bytes", changed(READ, w15=16, w17=2049), 0x8790),
    ("16385 bits", changed(READ, w15=70, w17=16385), 0x8790),
    ("a report of no elements", changed(REPORT, w15=0), 0x8690),
    ("a report of 1025 words", changed(REPORT, w15=1025), 0x8790),
    ("address type 2", changed(READ, w18=2), 0x8D90),
    ("IP address of 5 words", changed(READ, w19=5), 0x9290),
    ("name of 31 words", changed(BY_NAME, w19=31), 0xA490),
    ("256 in the IP address", changed(READ, w23=256), 0x8E90),
    ("class D", changed(READ, w20=224), 0x8F90),
    ("no name", [45, *READ[1:17], 3, 32, *[0] * 32], 0xB090),
    ("32 characters", [45, *READ[1:17], 3, 32, *[0x4141] * 16, *[0] * 16], 0xB090),
    ("no program name for P", changed(READ, w15=4), 0x9490),
    ("no program name for L", changed(READ, w15=0), 0x9490),
    ("half a program name", [19, *changed(READ, w15=4)[1:], 0x4141, 0x41], 0x9490),
    ("no program block name", [21, *changed(READ, w15=0)[1:], 0x4141, 0, 0, 0], 0x9390),
    ("a program name without its end", [21, *changed(READ, w15=4)[1:], *[0x4141] * 4], 0x8490),
    ("an empty program block name", [25, *changed(READ, w15=0)[1:], 0x4141, 0, 0, 0, 0, 0, 0, 0], 0x8590),
]


@pytest.mark.parametrize(("words", "code"), [row[1:] for row in REFUSED], ids=[row[0] for row in REFUSED])
def test_refusals(words: list[int], code: int) -> None:
    found = meaning(words)
    assert found.refused == code and found.because
    assert load_job_profile("ge-channels").kind_of(code).value == "syntax"


@pytest.mark.parametrize(
    "words",
    [
        changed(READ, w17=1024),
        changed(READ, w10=5, w11=5965),
        changed(READ, w15=16, w17=2048),
        changed(READ, w15=70, w17=16384),
        changed(READ, w7=2004, w13=84),
        [25, *changed(READ, w15=0)[1:], 0x4141, 0, 0, 0, 0x4242, 0, 0, 0],
        [21, *changed(READ, w15=4)[1:], 0x4141, 0x4141, 0x4141, 0x41],
        [21, *READ[1:], 0, 0, 0, 0],
    ],
)
def test_what_is_just_all_right(words: list[int]) -> None:
    assert meaning(words).refused == 0


@pytest.mark.parametrize("words", [[0, *READ[1:]], [129, *READ[1:]], changed(READ, w2=1), changed(READ, w3=24)])
def test_faults_that_no_status_word_tells(words: list[int]) -> None:
    with pytest.raises(CommandFaultError):
        blocks().words.read(bytes_of(words + [0] * 120))


def test_the_order_of_refusals() -> None:
    assert meaning(changed(READ, w8=0, w10=9, w13=9, w17=0)).refused == 0x8890
    assert meaning(changed(READ, w10=9, w13=9, w17=0)).refused == 0x8990
    assert meaning(changed(READ, w13=9, w17=0, w18=7)).refused == 0x8C90
    assert meaning(changed(READ, w17=0, w18=7)).refused == 0x8690
