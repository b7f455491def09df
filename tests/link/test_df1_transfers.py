"""Physical addresses, downloads and the terminal ID: commands that a simulated processor executes step by step."""

from __future__ import annotations

import pytest
from link.test_df1_commands import Pair, filled, part


@pytest.mark.parametrize(
    ("processor", "word", "address"),
    [
        ("plc2", "121", 0x46),  # the example of the manual, 13-3
        ("plc2", "000", 0),
        ("plc2", "100", 0x02),  # bit 7 of the byte address moves to bit 1
        ("plc2", "077", 0x7E << 1),
        ("plc2", "200", 0x100),  # the high octet stays
        ("plc1774", "121", 0xA2),
        ("plc1774", "020", 32),
    ],
)
def test_a_logical_word_address_becomes_a_physical_one(processor: str, word: str, address: int) -> None:
    pair = Pair(processor)
    memory = filled(pair)
    pair.state.set("transfer_kind", 2)
    pair.state.set("outputs_off", 1)
    assert pair.gives("physical_read", word=word, size=2) == memory[address : address + 2]
    assert pair.gives("physical_read", address=address, size=2) == memory[address : address + 2]
    pair.done("physical_write", word=word, data=b"\xab\xcd")
    assert pair.state["physical"][address : address + 2] == b"\xab\xcd"


def test_a_download_to_a_plc2_fills_the_rest_of_its_memory_with_zeros() -> None:
    pair = Pair("plc2")
    filled(pair)
    pair.done("download", image=part(0, b"\x11" * 300), words=128, memory_size=2048)
    assert pair.state["physical"][:2048] == b"\x11" * 300 + bytes(1748)
    assert pair.state["physical"][2048:2050] != bytes(2)
    assert pair.state["transfer_kind"] == 0


def test_a_download_to_a_plc2_writes_the_first_octet_of_the_program_last() -> None:
    pair = Pair("plc2")
    filled(pair)
    counted = pair.gives("read_counters")["received"]
    pair.done("download", image=part(0, b"\x77" * 300), words=128, verify=False, memory_size=300)
    # status, enter, size of the table, three pieces of the image, the first octet of the program, leave
    assert pair.gives("read_counters")["received"] - counted == 8 + 1
    counted += 9
    # the program begins after the image
    pair.done("download", image=part(0, b"\x77" * 200), words=128, verify=False, memory_size=200)
    assert pair.gives("read_counters")["received"] - counted == 6 + 1


def test_a_download_to_a_5_03_requests_the_download() -> None:
    pair = Pair("slc", slc_kind="modular")
    directory = b"\x10\x00" + bytes(14)
    pair.done("download", image=part(0, directory), ports=[0])
    assert pair.state["initialized"] == 1
    assert (pair.state["transfer_owner"], pair.state["transfer_kind"], pair.state["edit_owner"]) == (0xFF, 0, 0xFF)


def test_an_slc_that_runs_refuses_the_request_of_a_download() -> None:
    assert Pair("slc").refused("download_all") == 0xF00E


def test_the_terminal_id_of_a_micrologix_is_set() -> None:
    pair = Pair("micrologix")
    pair.done("set_terminal_id", terminal_id=0x1234)
    assert pair.state["terminal_id"] == 0x1234
    assert pair.refused("file_write", tag=0x4176, file_type=0x90, data=b"\1") == 0xF012
    assert pair.refused("file_write", tag=0x4176, file_type=0, data=b"\1\2") == 0xF012
    assert Pair("slc").refused("file_write", tag=0x4176, file_type=0x90, data=b"\1\2") == 0xF012


def test_the_public_status_of_a_plc5_250_is_read() -> None:
    pair = Pair("plc5_250")
    pair.memory.write("file1", "word", 7, [0x1234, 5])
    result = pair.until_done(
        lambda done: pair.client.read("I:007", station=5, count=2, now=pair.asking.now, on_done=done).commands
    )
    assert (result.ok, result.values) == (True, [0x1234, 5]), result


def with_end(pair: Pair, at: int) -> bytes:
    """Fill the physical memory of a device and end it by FFFF; return its content."""
    memory = filled(pair)
    memory = memory[:at] + b"\xff\xff" + memory[at + 2 :]
    pair.state.set("physical", memory)
    return memory


def test_an_upload_from_a_plc2_ends_at_ffff() -> None:
    pair = Pair("plc2")
    memory = with_end(pair, 2048)
    assert pair.gives("upload") == part(0, memory[:2048])
    assert pair.state["transfer_kind"] == 0


def test_an_upload_from_a_plc2_ends_where_its_memory_ends() -> None:
    pair = Pair("plc2")
    pair.state.set("physical", bytes(16384))
    assert pair.gives("upload") == part(0, bytes(16384))


def test_a_download_to_a_plc2_fills_its_memory_up_to_ffff() -> None:
    pair = Pair("plc2")
    with_end(pair, 2048)
    pair.done("download", image=part(0, b"\x11" * 300), words=128)
    assert pair.state["physical"][:2050] == b"\x11" * 300 + bytes(1748) + b"\xff\xff"
