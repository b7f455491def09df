"""Random frame bodies with values that fit them: unusual combinations of segments."""

from __future__ import annotations

from random import Random
from typing import Any

NUMBERS = (
    "u8", "u8", "i8", "u16", "u16, order: little", "u24", "u32, order: CDAB", "u64", "f32", "dec, size: 3",
    "hex, size: 2", "hex, size: 4", "hex, size: 4, order: little", "oct, size: 3", "bcd, size: 1",
)  # fmt: skip
TEXTS = {
    "ascii, size: 3": ("abc",),
    "ascii, size: 4, pad: 20": ("", "ab", "abcd"),
    "ascii, end: 00": ("", "abc"),
    "bytes, size: 2": (b"\x10\x02",),
}
BYTES = (0x10, 0x41, 0x03, 0x05, 0x00, 0xFF)


class RandomBody:
    """Draw a random frame body.

    `text` is the body in YAML, `values` are the values to build it from, `layouts` are the layouts it includes.
    """

    def __init__(self, seed: int) -> None:
        self.random = Random(seed)
        self.values: dict[str, Any] = {}
        self.numbers: list[str] = []
        self.layouts: dict[str, str] = {}
        self.count = 0
        self.text = f"[{self._body(0)}{self._end()}]"

    @property
    def sections(self) -> tuple[str, ...]:
        lines = "\n".join(f"  {name}: [{body}]" for name, body in self.layouts.items())
        return (f"layouts:\n{lines}",) if lines else ()

    def _name(self, letter: str) -> str:
        self.count += 1
        return f"{letter}{self.count}"

    def _bytes(self, size: int) -> bytes:
        return bytes(self.random.choice(BYTES) for _ in range(size))

    def _body(self, depth: int) -> str:
        kinds = [self._number, self._number, self._number, self._bits, self._constant, self._data, self._text]
        kinds += [self._sized, self._condition, self._derived]
        deep = [self._list, self._choice, self._wrap, self._record]
        parts = []
        for _ in range(self.random.randint(1, 4 if depth == 0 else 2)):
            if depth == 0 and self.random.random() < 0.3:
                parts.append(self.random.choice(deep)())
            else:
                parts.append(self.random.choice(kinds)())
        return ", ".join(parts)

    def _inside(self) -> tuple[str, dict[str, Any]]:
        """Return a body inside another segment, with values of its own."""
        values, numbers = self.values, list(self.numbers)
        self.values = {}
        body, inner = self._body(1), self.values
        self.values, self.numbers = values, numbers
        return body, inner

    # ---- single segments ----------------------------------------------------------------------------------

    def _number(self) -> str:
        name, type_ = self._name("f"), self.random.choice(NUMBERS)
        value: Any = self.random.randint(1, 8)
        options = [", range: 1..9"] if type_ != "f32" else []
        if type_ == "u8":
            options += [", plus: 3", ", zero_means: 256", ", default: 4", ", values: {1: A, 2: B, 3: C, 4: D, 8: E}"]
        if type_ in ("u8", "u16"):
            options.append(", long: {mark: 200, type: u16}")
        option = self.random.choice(["", "", *options])
        if "long" in option:
            value = self.random.choice([7, 199, 200, 300])
        self.values[name] = float(value) if type_ == "f32" else -value if type_ == "i8" and not option else value
        if type_ != "f32":
            self.numbers.append(name)
        return f"{{field: {name}, type: {type_}{option}}}"

    def _bits(self) -> str:
        low, high = self._name("b"), self._name("b")
        self.values |= {low: self.random.randrange(8), high: self.random.randrange(2)}
        self.numbers += [low, high]
        return (
            f"{{bits: {{{low}: 0-2, {high}: {self.random.choice([3, 7])}}}, of: {self.random.choice(['u8', 'u16'])}}}"
        )

    def _constant(self) -> str:
        return self.random.choice(["{const: 05}", "{const: 02 41}", "{text: XY}", "{skip: 3, fill: 2A}"])

    def _data(self) -> str:
        name, size = self._name("d"), self.random.choice([1, 2, 4])
        option = self.random.choice(["", ", convert: hex_to_ascii", ", swap: 2", ", pad: 00"])
        self.values[name] = self._bytes(self.random.randint(0, size) if "pad" in option else size)
        return f"{{data: {name}, size: {size}{option}}}"

    def _text(self) -> str:
        name, type_ = self._name("t"), self.random.choice(list(TEXTS))
        self.values[name] = self.random.choice(TEXTS[type_])
        return f"{{field: {name}, type: {type_}}}"

    def _sized(self) -> str:
        length, data = self._name("l"), self._name("d")
        type_ = self.random.choice(["u8", "u16", "hex, size: 2", "dec, size: 2"])
        self.values[data] = self._bytes(self.random.randrange(5))
        plain, convert = self.random.choice([("", ""), (", plain: yes", ", convert: hex_to_ascii")])
        between = f"{self._number()}, " if self.random.random() < 0.5 else ""
        counted = f"{{length: {length}, type: {type_}, of: [{data}]{plain}}}"
        return f"{counted}, {between}{{data: {data}, size: {length}{convert}}}"

    def _condition(self) -> str:
        if not self.numbers:
            return self._number()
        number = self.random.choice(self.numbers)
        when = self.random.choice([f"{number} > 4", f"{number} == 3", f"{number} % 2 == 0"])
        name = self._name("f")
        if self.random.random() < 0.3:
            return f"{{const: 77, when: {when}}}"
        if self.random.random() < 0.3:
            return f"{{data: {name}, size: 2, when: {when}, pad: 2E}}"
        return f"{{field: {name}, type: u16, when: {when}, default: 7}}"

    def _derived(self) -> str:
        if not self.numbers:
            return self._number()
        name, number = self._name("v"), self.random.choice(self.numbers)
        return self.random.choice(
            [
                f"{{value: {name}, read: {number} + 1}}",
                f"{{require: {number} < 400}}",
                f"{{field: {name}, type: u16, is: {number} + 1}}",
                f"{{field: {name}, type: u16, build: {number} * 2}}",
            ]
        )

    # ---- segments with others inside ----------------------------------------------------------------------

    def _list(self) -> str:
        count, items, times = self._name("n"), self._name("r"), self.random.randrange(4)
        head = f"{{count: {count}, type: u8, of: {items}}}, "
        if self.random.random() < 0.4:
            self.values[items] = [self.random.randrange(200) for _ in range(times)]
            return f"{head}{{repeat: {items}, times: {count}, of: {self.random.choice(['u8', 'u16', 'u24'])}}}"
        body, values = self._inside()
        self.values[items] = [dict(values) for _ in range(times)]
        return f"{head}{{repeat: {items}, times: {count}, of: [{{skip: 1}}, {body}]}}"

    def _choice(self) -> str:
        kind, taken = self._name("k"), self.random.randint(1, 3)
        cases = []
        for case in (1, 2):
            body, values = self._inside()
            cases.append(f"{case}: [{body}]")
            self.values |= values if case == taken else {}
        self.values[kind] = taken
        otherwise = self.random.choice(["[]", "[{const: 99}]"])
        return f"{{field: {kind}, type: u8}}, {{choose: {kind}, cases: {{{', '.join(cases)}}}, else: {otherwise}}}"

    def _wrap(self) -> str:
        numbers = list(self.numbers)
        content = self._body(1)
        self.numbers = numbers
        if self.random.random() < 0.5:
            rest = self._name("d")
            self.values[rest] = self._bytes(self.random.randrange(4))
            content += f", {{data: {rest}, size: rest}}"
        content += self.random.choice(["", ", {check: sum8}"])
        return f"{{wrap: {{escape: DLE}}, of: [{content}]}}, {{const: 10 03}}"

    def _record(self) -> str:
        name = self._name("rec")
        self.layouts[name], self.values[name] = self._inside()
        return f"{{include: {name}, as: {name}}}"

    def _end(self) -> str:
        """Return segments that are only allowed at the end: an open-ended segment, a check code, or both."""
        end, name = self.random.random(), self._name("e")
        text = ""
        if end < 0.2:
            self.values[name] = self._bytes(self.random.randrange(4))
            text = f", {{data: {name}, size: rest}}" + self.random.choice(["", ", {const: 03}"])
        elif end < 0.3:
            self.values |= {name: 5} if self.random.random() < 0.5 else {}
            text = f", {{optional: [{{field: {name}, type: u8}}]}}"
        elif end < 0.4:
            self.values[name] = [{"x": number} for number in range(self.random.randrange(4))]
            text = f", {{repeat: {name}, times: rest, of: [{{field: x, type: u8}}]}}"
        checks = ["", "", ", {check: sum8}", ", {check: sum8, as: hex}", ", {check: crc16-modbus, order: little}"]
        return text + self.random.choice([*checks, ", {check: xor8}, {const: 04}"])
