"""Write check codes in C: a function per method that processes bytes piece by piece, and the encoding of codes."""

from __future__ import annotations

from typing import Any, Protocol

from framekit.codec import support
from framekit.definition.model.checks import CheckMethod
from framekit.definition.model.segments import Check
from framekit.definition.problems import CannotSayError, Position
from framekit.extras.generate_c.expressions import CExpressionWriter, CFacts, CScope, Val
from framekit.extras.generate_c.source import CSource, identifier


class CheckFile(CFacts, Protocol):
    """The file that the functions are written into."""

    def function(self, name: str, code: CSource) -> None: ...


class CheckFunctions:
    """The functions of the check methods that a file uses, by method."""

    def __init__(self, file: CheckFile) -> None:
        self.file = file
        self.known: dict[CheckMethod, tuple[str, int]] = {}

    def of(self, method: CheckMethod, at: Position) -> tuple[str, int]:
        """Return the name of the function of a method, and the initial value of its code. Raises CannotSayError."""
        if method not in self.known:
            if method.is_keyed:
                raise CannotSayError(at, f"'{method.name}', a code that is made with a key")
            if method.width > 64:
                raise CannotSayError(at, f"'{method.name}', a check code of {method.width} bits")
            names = {name for name, _ in self.known.values()}
            base = f"fk_check_{identifier(method.name)}"
            name = next(one for one in (base, *(f"{base}_{count}" for count in range(2, 1000))) if one not in names)
            self.known[method] = name, self._write(method, name, at)
        return self.known[method]

    def finished(self, method: CheckMethod, code: str) -> str:
        """Return the text of the code after all bytes are processed."""
        ones = (1 << method.width) - 1
        if method.kind in ("sum7", "xor7"):
            ones = (1 << min(method.width, 7)) - 1
        bits = ones if method.mask is None else ones & method.mask
        text = code
        if method.kind == "crc":
            if method.width < 8 and not method.refin:
                text = f"({text} >> {8 - method.width})"
            if method.refin != method.refout:
                text = f"{self.file.helper('reflected')}({text}, {method.width})"
            if method.xorout:
                text = f"({text} ^ {_hex(method.xorout)})"
        if method.complement == "ones":
            text = f"(~{text})"
        elif method.complement == "twos":
            text = f"(UINT64_C(0) - {text})"
        return f"({text} & {_hex(bits)})"

    def _write(self, method: CheckMethod, name: str, at: Position) -> int:
        code = CSource()
        uses_place = method.kind == "word_sum" or (method.kind == "xor" and method.width > 8)
        width = method.width
        start = method.initial
        with code.block(f"static uint64_t {name}(uint64_t code, size_t place, const uint8_t *data, size_t size)"):
            code.add("size_t i;")
            if not uses_place:
                code.add("(void)place;")
            if method.kind == "crc":
                start = self._crc(method, code)
            else:
                with code.block("for (i = 0; i < size; i++)"):
                    code.add(*self._step(method, at))
            code.add("return code;")
        if width > 64 or start >= 1 << 64:
            raise CannotSayError(at, f"'{method.name}', a check code of {width} bits")
        self.file.function(name, code)
        return start

    def _step(self, method: CheckMethod, at: Position) -> list[str]:
        size = (method.width + 7) // 8
        match method.kind:
            case "sum" | "sum7":
                return ["code += data[i];"]
            case "word_sum":
                high = "0" if method.order == "big" else "1"
                return [f"code += (place + i) % 2 == {high} ? (uint64_t)data[i] << 8 : (uint64_t)data[i];"]
            case "xor" if size > 1:
                byte = "(place + i)" if method.order == "little" else f"({size} - 1 - (place + i) % {size})"
                return [f"code ^= (uint64_t)data[i] << 8 * ({byte} % {size});"]
            case "xor" | "xor7":
                return ["code ^= data[i];"]
            case "or":
                return ["code |= data[i];"]
            case "multiply":
                return [f"code = code * data[i] & {_hex((1 << method.width) - 1)};"]
            case "fold" if method.expression is not None:
                scope = CScope(None, {
                    "acc": Val("number", "(int64_t)code", 0, (1 << method.width) - 1),
                    "byte": Val("number", "(int64_t)data[i]", 0, 255),
                })  # fmt: skip
                value = CExpressionWriter(self.file, scope).number(method.expression)
                if "&bad" in value.text:
                    raise CannotSayError(at, f"'{method.name}', whose expression may have no value")
                return [f"code = (uint64_t){value.text} & {_hex((1 << method.width) - 1)};"]
        raise CannotSayError(at, f"'{method.name}', a check of the kind '{method.kind}'")

    def _crc(self, method: CheckMethod, code: CSource) -> int:
        width = method.width
        table = support.make_crc_table(width, method.poly, method.refin)
        digits = max((width + 3) // 4, 2)
        type_ = next(bits for bits in (8, 16, 32, 64) if bits >= width)
        rows = [f"0x{entry:0{digits}X}{'u' if type_ < 64 else 'ull'}" for entry in table]
        if type_ == 64:
            rows = [f"UINT64_C(0x{entry:016X})" for entry in table]
        per = 8 if type_ <= 16 else 4
        lines = [f"    {', '.join(rows[at : at + per])}," for at in range(0, 256, per)]
        code.lines.insert(1, f"    static const uint{type_}_t table[256] = {{")
        code.lines[2:2] = [*(f"    {line}" for line in lines), "    };"]
        with code.block("for (i = 0; i < size; i++)"):
            if width < 8 or (width == 8 and not method.refin):
                code.add("code = table[(code ^ data[i]) & 0xFF];")
            elif method.refin:
                code.add("code = code >> 8 ^ table[(code ^ data[i]) & 0xFF];")
            else:
                low = (1 << width - 8) - 1
                code.add(f"code = (code & {_hex(low)}) << 8 ^ table[(code >> {width - 8} ^ data[i]) & 0xFF];")
        if method.refin:
            return support.reflect(method.initial, width)
        return method.initial << 8 - width if width < 8 else method.initial


def finish_code(r: Any, segment: Check, code: str) -> None:
    """Write the conversion of the accumulated code to the encoded number, cut to its encoded size."""
    text = r.file.checks.finished(segment.method, code)
    bits = {"raw": 8, "nibbles": 4, "hex": 4, "HEX": 4, "dec": 0}[segment.form] * segment.size
    if bits and segment.method.width > bits:
        text = f"({text} & UINT64_C({(1 << bits) - 1}))"
    r.add(f"{code} = {text};")


def put_code(r: Any, segment: Check, code: str, target: str) -> None:
    """Write the encoding of a check code."""
    little = "true" if segment.order == "little" else "false"
    match segment.form:
        case "raw":
            r.add(f"{r.file.helper('put_int')}({target}, {code}, {segment.size}, {little});")
        case "nibbles":
            r.add(f"{r.file.helper('put_nibbles')}({target}, {code}, {segment.size}, {little});")
        case "dec":
            r.add(f"{r.file.helper('put_digits')}({target}, {code}, {segment.size}, 10, {little}, true);")
        case _:
            if little == "true" and segment.size % 2:
                raise CannotSayError(segment.at, "digits of a check code in pairs, of which one is missing")
            upper = "false" if segment.form == "hex" else "true"
            r.add(f"{r.file.helper('put_digits')}({target}, {code}, {segment.size}, 16, {little}, {upper});")


def _hex(value: int) -> str:
    return f"UINT64_C(0x{value:X})"
