"""Write wraps in C: the decoding and encoding of their content; a row for each coding, by its class."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from framekit.definition.codings import Blocks, Cobs, Coding, Doubled, Escaped, Hex, Inserted, Plain, Short
from framekit.definition.model.segments import Wrap
from framekit.definition.problems import CannotSayError
from framekit.extras.generate_c.checks import put_code
from framekit.extras.generate_c.source import CSource, string


def open_wrap(
    r: Any, segment: Wrap, opened: str, room: str, capacity: int, fixed: int | None, has_content: str, here: Any
) -> bool:
    """Write the decoding of the bytes of `opened` into a buffer of the struct; return whether it may fail."""
    coding = segment.coding
    r.embedded = r.embedded_in(segment)
    raw = f"{opened}.raw, {opened}.raw_size"
    if isinstance(coding, Plain):
        r.add(f"{opened}.data = {opened}.raw;", f"{opened}.end = {opened}.raw_size;")
        r.add(f"{opened}.map = {r.file.helper('map_same')};")
        return False
    row = _OPEN.get(type(coding))
    if row is None:
        raise CannotSayError(segment.at, f"a wrap of the kind {coding.shown}")
    way = row(r, coding, fixed)
    call = f"{r.file.helper(way.function) if way.is_helper else way.function}({raw}{way.arguments}, {room}"
    r.add(f"{opened}.data = {room};", f"{opened}.map = {r.file.helper(way.map)};")
    if way.how:
        name = r.fresh("coding")
        r.locals.append(f"static const struct fk_coding {name} = {{ {way.how} }};")
        r.add(f"{opened}.how = &{name};")
    bad = r.local("size_t", "bad_place")
    reason = r.local("enum framekit_reason", "opened_as", "FRAMEKIT_OK")
    r.add(f"{reason} = {call}{f', {capacity}' if way.has_room else ''}, &{opened}.end, &{bad});")
    r.when(f"{reason} == FRAMEKIT_NO_ROOM", "notes->no_room = true;", r.leave())
    if isinstance(coding, Blocks):
        wrong = r.file.helper("wrong_check")
        r.when(f"{reason} == FRAMEKIT_CHECK", f"{wrong}_at({r.n}, fk_wire({r.n}, {opened}.start + {bad}));")
        other = f"else if ({reason} != FRAMEKIT_OK)"
    else:
        other = f"if ({reason} != FRAMEKIT_OK)"
    with r.block(other):
        r.add(f"{has_content} = false;", f"fk_note({r.n}, {reason}, {opened}.start + {bad}, -1);")
    return True


@dataclass(frozen=True, slots=True)
class Way:
    """The decoding of a content."""

    map: str
    """The helper that maps offsets of the content to offsets of the encoded bytes."""
    function: str
    """The decoding function, a helper or a function of the file."""
    arguments: str = ""
    """Its arguments after the bytes."""
    how: str = ""
    """The values that the map needs (`struct fk_coding`)."""
    is_helper: bool = True
    has_room: bool = True
    """Whether the decoding function takes the size of the buffer."""


def _doubled(r: Any, coding: Doubled, fixed: int | None) -> Way:
    how = f"{coding.escape}, NULL, 0, 0, 0, 0, {r.embedded}"
    return Way("map_escaped", "open_doubled", f", {coding.escape}, {r.embedded}", how)


def _inserted(r: Any, coding: Inserted, fixed: int | None) -> Way:
    pieces = f", {string(coding.after)}, {len(coding.after)}, {string(coding.insert)}, {len(coding.insert)}"
    how = f"0, (const uint8_t *){string(coding.after)}, {len(coding.after)}, {len(coding.insert)}, 0, 0, NULL, 0"
    return Way("map_inserted", "open_inserted", pieces, how)


def _short(r: Any, coding: Short, fixed: int | None) -> Way:
    return Way("map_short", "open_short", f", {coding.fill}, {coding.least}, {fixed or 0}", has_room=False)


def _escaped(r: Any, coding: Escaped, fixed: int | None) -> Way:
    name = f"fk_open_escaped_{coding.escape:02x}_" + "_".join(f"{byte:02x}{code:02x}" for byte, code in coding.codes)
    name += "" if coding.flip is None else f"_{coding.flip:02x}"
    code = CSource()
    header = (
        f"static enum framekit_reason {name}(const uint8_t *raw, size_t size, uint8_t *to, size_t room, size_t *got,"
        " size_t *bad)"
    )
    with code.block(header):
        code.add("size_t at = 0;", "*got = 0;")
        with code.block("while (at < size)"):
            code.add("uint8_t byte = raw[at];", "bool right = true;", "*bad = at;")
            code.when("*got >= room", "return FRAMEKIT_NO_ROOM;")
            with code.block(f"if (byte == {coding.escape})"):
                code.when("++at >= size", "*got = 0;", "return FRAMEKIT_CONSTANT;")
                with code.block("switch (raw[at])"):
                    for plain, wire in coding.codes:
                        code.add(f"case {wire}: byte = {plain}; break;")
                    if coding.flip is None:
                        code.add("default: right = false; break;")
                    else:
                        code.add(f"default: byte = (uint8_t)(raw[at] ^ {coding.flip}); break;")
                never = sorted(coding.never)
                if never:  # such a byte is forbidden, even after the escape byte
                    tests = " || ".join(f"raw[at] == {one}" for one in never)
                    code.when(tests, "right = false;")
            never = sorted(coding.never)
            if never:
                tests = " || ".join(f"byte == {one}" for one in never)
                with code.block(f"else if ({tests})"):
                    code.add("right = false;")
            code.when("!right", "*got = 0;", "return FRAMEKIT_CONSTANT;")
            code.add("to[(*got)++] = byte;", "at++;")
        code.add("return FRAMEKIT_OK;")
    r.file.function(name, code)
    return Way("map_escaped", name, how=f"{coding.escape}, NULL, 0, 0, 0, 0, NULL, 0", is_helper=False)


def _blocks(r: Any, coding: Blocks, fixed: int | None) -> Way:
    check = coding.check_code
    function, initial = r.file.checks.of(check.method, check.at)
    name = f"fk_open_blocks_{coding.size}_{function.removeprefix('fk_check_')}_{check.form}_{check.order}_{check.size}"
    code = CSource()
    header = (
        f"static enum framekit_reason {name}(const uint8_t *raw, size_t size, uint8_t *to, size_t room, size_t *got,"
        " size_t *bad)"
    )
    with code.block(header):
        code.add("size_t at = 0;", "enum framekit_reason found = FRAMEKIT_OK;", "*got = 0;")
        with code.block("while (at < size)"):
            whole = coding.size + check.size
            code.add(f"uint8_t right[{check.size}];", "uint64_t code;")
            code.add(f"size_t block = size - at < {whole} ? size - at : {whole};")
            code.when(f"block <= {check.size}", "*got = 0;", "*bad = at;", "return FRAMEKIT_SHORT;")
            code.add(f"block -= {check.size};")
            code.when("*got + block > room", "return FRAMEKIT_NO_ROOM;")
            code.add(f"code = {function}(UINT64_C({initial}), 0, raw + at, block);")
            writer = _Lines(r.file, code)
            code.add(f"code = {r.file.checks.finished(check.method, 'code')};")
            put_code(writer, check, "code", "right")
            same = f"memcmp(right, raw + at + block, {check.size}) != 0"
            if check.form in ("hex", "HEX"):
                same = f"!{r.file.helper('same_digits')}(right, raw + at + block, {check.size})"
            code.when(f"found == FRAMEKIT_OK && {same}", "found = FRAMEKIT_CHECK;", "*bad = at + block;")
            code.add("memcpy(to + *got, raw + at, block);", "*got += block;", f"at += block + {check.size};")
        code.add("return found;")
    r.file.function(name, code)
    return Way("map_blocks", name, how=f"0, NULL, 0, 0, {coding.size}, {check.size}, NULL, 0", is_helper=False)


class _Lines:
    """A separate function, as far as the writers of check codes need it."""

    def __init__(self, file: Any, code: CSource) -> None:
        self.file = file
        self.add = code.add
        self.block = code.block
        self.when = code.when


_OPEN: dict[type[Coding], Callable[[Any, Any, int | None], Way]] = {
    Hex: lambda r, coding, fixed: Way("map_hex", "open_hex"),
    Doubled: _doubled,
    Escaped: _escaped,
    Cobs: lambda r, coding, fixed: Way("map_cobs", "open_cobs"),
    Inserted: _inserted,
    Short: _short,
    Blocks: _blocks,
}


# ---- content put on the wire --------------------------------------------------------------------------------


def wrap_up(w: Any, segment: Wrap, inside: str) -> None:
    """Write the encoding of the content of `inside`."""
    coding, content = segment.coding, f"{inside}.data, {inside}.at"
    match coding:
        case Hex():
            w.add(f"{w.file.helper('wrap_hex')}({w.n}, {content});")
        case Doubled():
            w.add(f"{w.file.helper('wrap_doubled')}({w.n}, {content}, {coding.escape});")
        case Cobs():
            w.add(f"{w.file.helper('wrap_cobs')}({w.n}, {content});")
        case Inserted():
            pieces = f"{string(coding.after)}, {len(coding.after)}, {string(coding.insert)}, {len(coding.insert)}"
            w.add(f"{w.file.helper('wrap_inserted')}({w.n}, {content}, {pieces});")
        case Short():
            w.add(f"{w.file.helper('wrap_short')}({w.n}, {content}, {coding.fill}, {coding.least});")
        case Escaped():
            place = w.local("size_t", "plain_place")
            loop = f"for ({place} = 0; {place} < {inside}.at; {place}++)"
            with w.block(loop), w.block(f"switch ({inside}.data[{place}])"):
                put = w.file.helper("put_bytes")
                for plain, wire in coding.codes:
                    pair = string(bytes((coding.escape, wire)))
                    w.add(f"case {plain}:", f"    {put}({w.n}, {pair}, 2);", "    break;")
                w.add("default:", f"    {put}({w.n}, {inside}.data + {place}, 1);", "    break;")
        case Blocks():
            _wrap_blocks(w, coding, inside)
        case _:
            raise CannotSayError(segment.at, f"a wrap of the kind {coding.shown}")


def _wrap_blocks(w: Any, coding: Blocks, inside: str) -> None:
    check = coding.check_code
    function, initial = w.file.checks.of(check.method, check.at)
    place, size, code = (w.local("size_t", "block_place"), w.local("size_t", "block_size"), w.local("uint64_t", "code"))
    to = w.pointer()
    with w.block(f"for ({place} = 0; {place} < {inside}.at; {place} += {size})"):
        left = f"{inside}.at - {place}"
        w.add(f"{size} = {left} < {coding.size} ? {left} : {coding.size};")
        w.add(f"{w.file.helper('put_bytes')}({w.n}, {inside}.data + {place}, {size});")
        w.add(f"{code} = {function}(UINT64_C({initial}), 0, {inside}.data + {place}, {size});")
        w.add(f"{code} = {w.file.checks.finished(check.method, code)};")
        w.add(f"{to} = {w.file.helper('put')}({w.n}, {check.size});")
        with w.block(f"if ({to} != NULL)"):
            put_code(w, check, code, to)
