"""Check codes found in frames of an unknown protocol, verified on frames that the search has not used."""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest
from spread import spread

from framekit.codec.checks import compute
from framekit.definition.model.checks import CheckMethod, ready_methods
from framekit.extras.guess.checks import find_checks, fletcher, holds

METHODS = [
    method
    for method in dict.fromkeys(ready_methods().values())
    if method.is_of_bytes and method.width in (8, 16, 24, 32) and method.kind not in ("or", "multiply")
    and not (method.width == 32 and method.kind != "crc")
]  # fmt: skip


class Maker:
    """Builds frames of one protocol: optional mark, station, function, data, code, optional mark."""

    def __init__(self, seed: int, method: CheckMethod | None) -> None:
        self.rng = rng = random.Random(seed)
        self.method = method or drawn(rng)
        self.order = rng.choice(["big", "little"])
        self.start, self.tail = rng.choice([0, 1]), rng.choice([0, 1])

    def frames(self, count: int, sizes: list[int], damage: float = 0.0) -> list[bytes]:
        rng, found = self.rng, []
        for _ in range(count):
            data = bytes([2, rng.choice([1, 1, 1, 2, 3]), rng.choice([3, 4, 6])])
            data += bytes(rng.choice([0, 0, rng.randrange(256)]) for _ in range(rng.choice(sizes)))
            code = compute(self.method, data[self.start :]).to_bytes(self.method.size, self.order)  # type: ignore[arg-type]
            data += code + b"\x03" * self.tail
            if rng.random() < damage:
                place = rng.randrange(len(data))
                data = data[:place] + bytes([data[place] ^ 1 << rng.randrange(8)]) + data[place + 1 :]
            found.append(data)
        return found


def drawn(rng: random.Random) -> CheckMethod:
    """Draw a CRC that is in no catalogue."""
    width, refin = rng.choice([16, 16, 24, 32]), rng.random() < 0.5
    starts = 0, (1 << width) - 1, rng.randrange(1 << width)
    return CheckMethod(
        name="drawn", kind="crc", width=width, poly=rng.randrange(1 << width) | 1, initial=rng.choice(starts),
        refin=refin, refout=refin, xorout=rng.choice(starts),
    )  # fmt: skip


def is_right(maker: Maker, frames: list[bytes], fresh: list[bytes]) -> bool:
    found = find_checks(frames, 0, maker.tail)
    return bool(found) and all(holds(found[0], frame) for frame in fresh)


@pytest.mark.parametrize("method", METHODS, ids=lambda method: method.name)
def test_every_ready_method_is_found(method: CheckMethod) -> None:
    maker = Maker(1, method)
    assert is_right(maker, maker.frames(14, [4, 7, 12]), maker.frames(8, [5, 9, 20]))
    maker = Maker(2, method)
    if method.kind == "crc":
        assert is_right(maker, maker.frames(14, list(range(4, 60))), maker.frames(8, [7, 13, 30]))


def share(count: int, right: Callable[[int], bool]) -> float:
    return sum(right(seed) for seed in range(count)) / count


def test_polynomials_that_stand_nowhere_are_found() -> None:
    def right(seed: int) -> bool:
        maker = Maker(seed, None)
        return is_right(maker, maker.frames(20, [6, 9, 14]), maker.frames(6, [8, 20]))

    assert share(20, right) == 1.0


def test_some_frames_may_be_damaged() -> None:
    def right(seed: int) -> bool:
        maker = Maker(seed, METHODS[seed % len(METHODS)])
        return is_right(maker, maker.frames(40, [5, 8, 13], damage=0.05), maker.frames(6, [7, 30]))

    assert share(30, right) >= 0.96


def test_a_request_of_one_content_tells_of_the_register() -> None:
    method = CheckMethod(name="x", kind="crc", width=16, poly=0x3D65, initial=0x1234, refin=True, refout=True)
    maker = Maker(3, method)
    maker.start = maker.tail = 0
    (found, *_) = find_checks([*maker.frames(1, [2]), *maker.frames(20, [7])])
    assert (found.method.initial, found.method.xorout, found.evidence.holds) == (0x1234, 0, 21)


def test_codes_as_hex_digits_are_found() -> None:
    rng = random.Random(5)
    for over_digits in (True, False):
        frames = []
        for _ in range(20):
            data = bytes(rng.randrange(256) for _ in range(rng.choice([3, 5, 8])))
            text = data.hex().upper().encode()
            code = compute(ready_methods()["lrc8"], text if over_digits else data)
            frames.append(b":" + text + b"%02X\r\n" % code)
        (found, *_) = find_checks(frames, 1, 2)
        assert found.name == "lrc8" and found.place.form == "hex" and found.place.start == 1
        assert found.place.counted == ("binary" if over_digits else "hex")


def test_fletchers_code_is_found() -> None:
    rng = random.Random(6)
    frames = []
    for _ in range(12):
        data = bytes(rng.randrange(256) for _ in range(rng.choice([5, 9, 14])))
        frames.append(b"\xb5\x62" + data + fletcher(data).to_bytes(2, "little"))
    (found, *_) = find_checks(frames, 2)
    assert found.method.kind == "fold" and found.place.start == 2 and found.place.order == "little"


def test_a_mark_beside_a_code_is_no_part_of_it() -> None:
    """A sum whose high byte hardly changes could be a two-byte code of which one byte is the mark."""
    rng = random.Random(11)
    frames = []
    for size in [rng.choice([3, 5]) for _ in range(60)]:
        data = bytes([0x68, *(rng.randrange(8, 20) for _ in range(size))])
        frames.append(data + bytes([sum(data) & 0xFF, 0x16]))
    (found, *_) = find_checks(frames)
    assert (found.name, found.place.size, found.place.tail) == ("sum8", 1, 1)


def test_a_mark_before_a_code_does_not_count() -> None:
    rng, frames = random.Random(12), []
    for _ in range(20):
        data = bytes(rng.randrange(0x20, 0x7F) for _ in range(rng.choice([5, 9, 14])))
        code = compute(ready_methods()["crc16-xmodem"], data)
        frames.append(b"#" + data + b"*" + code.to_bytes(2, "big"))
    (found, *_) = find_checks(frames, 1)
    assert (found.name, found.place.start, found.place.stop) == ("crc16-xmodem", 1, 1)


def others(kind: str, rng: random.Random) -> list[bytes]:
    """Return frames without a check code."""
    count, size, value = rng.choice([10, 50, 200]), rng.choice([8, 16, 24]), 500
    match kind:
        case "random":
            return [bytes(rng.randrange(256) for _ in range(rng.choice([size, size + 4]))) for _ in range(count)]
        case "counters":
            return [bytes([2, 1, at & 255, 7, 0, at * 3 & 255, at & 255, 0, 0, 0]) for at in range(count)]
        case "constant":
            return [b"\x02\x01\x07\x00\x55"] * count
        case "text":
            return [b"T=%d H=%d\r\n" % (rng.randrange(1000), rng.randrange(100)) for _ in range(count)]
        case "two numbers":
            return [bytes([0xAA, at & 255, at + 5 & 255]) for at in range(count)]
    found = []
    for _ in range(count):
        value += rng.randrange(-3, 4)
        found.append(b"\xaa\x01" + value.to_bytes(2, "big") + b"\0\0" + (value + 7).to_bytes(2, "big") + b"\x55")
    return found


@pytest.mark.parametrize("kind", spread(["random", "counters", "constant", "text", "two numbers", "a value twice"], 3))
def test_nothing_is_said_where_there_is_no_check(kind: str) -> None:
    assert [find_checks(others(kind, random.Random(seed))) for seed in range(8)] == [[]] * 8


@pytest.mark.parametrize("start", [b"$", b"!"])
def test_the_exclusive_or_between_a_mark_and_an_asterisk_is_found_with_few_codes(start: bytes) -> None:
    """Sentences in the style of NMEA, with few values of the code.

    A CRC with the polynomial 1 is equivalent, but more complex.
    """
    frames = []
    for number in range(40):
        body = f"WIMWV,{number * 9 % 360:03d}.0,R,{number % 20:04.1f},N,A".encode()
        code = compute(ready_methods()["xor8"], body)
        frames.append(start + body + f"*{code:02X}\r\n".encode())
    assert len({frame[-4:-2] for frame in frames}) < 20
    (found, *_) = find_checks(frames, 1, 2)
    assert (found.name, found.place.start, found.place.stop, found.place.form, found.place.tail) == (
        "xor8",
        1,
        1,
        "hex",
        2,
    )
