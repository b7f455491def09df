"""Generated C in a process of its own: driven line by line, with sanitizers, and compared with Python.

The values of a frame are transmitted as a row of words in the order of the struct. The harness knows only the members
that the generator reports.
"""

from __future__ import annotations

import functools
import hashlib
import os
import random
import re
import shutil
import struct as packing
import subprocess
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from decimal import Decimal
from pathlib import Path
from typing import Any

from framekit.codec.cache import cache_folder
from framekit.codec.codec import compile_protocol
from framekit.codec.errors import EncodeError, FrameError
from framekit.codec.samples import Sampler
from framekit.definition.kinds.base import constant_number
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import PLAIN
from framekit.extras.generate_c.generate import Generated, generate
from framekit.extras.generate_c.layout import CMember, CStruct, inner_name
from framekit.extras.generate_c.source import identifier

GCC = shutil.which("gcc")
WARNINGS = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-Wconversion"]
SANITIZERS = [
    "-fsanitize=address,undefined", "-fsanitize-undefined-trap-on-error", "-fno-sanitize=null,object-size",
    "--param", "asan-instrumentation-with-call-threshold=0",
]  # fmt: skip
"""Flags of AddressSanitizer and UBSan.

Undefined behaviour ends the program with SIGILL instead of a message, which halves the compile time of gcc. To find the
place, compile the remaining C file with `-fno-sanitize-recover=all -g` instead. A quarter is saved by calls in place of
inlined checks, and without those that AddressSanitizer makes anyway (null) or only optimized code has (object-size).
"""
_REASONS = [
    "ok",
    "check",
    "constant",
    "where",
    "digits",
    "value",
    "range",
    "require",
    "short",
    "too_long",
    "length",
    "surplus",
    "cut",
    "no_room",
]


def gcc(words: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    assert GCC is not None
    return subprocess.run([GCC, *words], cwd=folder, capture_output=True, text=True)


MOST_OBJECTS = 600
"""How many object files are kept for the next test process; the oldest ones are deleted."""


@functools.cache
def kept_objects() -> Path | None:
    """Return the folder in the user's cache with the object files of earlier test processes; None without a cache."""
    cache = cache_folder()
    if cache is None:
        return None
    folder = cache.with_name(f"{cache.name}-c-tests")
    folder.mkdir(parents=True, exist_ok=True)
    for old in sorted(folder.glob("*.o"), key=lambda path: path.stat().st_mtime, reverse=True)[MOST_OBJECTS:]:
        old.unlink(missing_ok=True)
    return folder


@functools.cache
def gcc_version() -> str:
    return gcc(["--version"], Path()).stdout


def compiled(name: str, folder: Path, flags: list[str]) -> str:
    """Compile a C file of `folder`, and return the name of its object file.

    The object file of equal sources, flags and compiler is taken from the user's cache: gcc takes most of the time of
    these tests.
    """
    texts = [path.read_text() for path in (folder / f"{name}.c", *sorted(folder.glob("*.h")))]
    key = hashlib.sha256("\0".join([gcc_version(), *flags, *texts]).encode()).hexdigest()
    found, kept = folder / f"{name}.o", kept_objects()
    if kept is not None and (kept / f"{key}.o").exists():
        shutil.copy(kept / f"{key}.o", found)
        return found.name
    done = gcc([*flags, "-c", f"{name}.c", "-o", found.name], folder)
    assert done.returncode == 0, f"{done.stderr[:4000]}"
    if kept is not None:
        with tempfile.NamedTemporaryFile(dir=kept, delete=False) as file:
            file.write(found.read_bytes())
        os.replace(file.name, kept / f"{key}.o")
    return found.name


def object_of(made: Generated, folder: Path, flags: list[str]) -> str:
    """Write the C of a protocol to `folder`, compile it unless already done, and return the name of its object file."""
    found = folder / f"{made.name}.o"
    if not found.exists():
        (folder / f"{made.name}.h").write_text(made.header)
        (folder / f"{made.name}.c").write_text(made.source)
        compiled(made.name, folder, flags)
    return found.name


class CProtocol:
    """The C of a protocol, compiled and running."""

    def __init__(self, definition: Protocol, folder: Path, most: int = 1024, sanitized: bool = True) -> None:
        self.definition = definition
        self.codec = compile_protocol(definition)
        fixed = {parameter.name: constant_number(parameter.is_) for parameter in definition.params.values()}
        self.context = {**self.codec.defaults, **{name: one for name, one in fixed.items() if one is not None}}
        self.generated = generate(definition, most)
        made = self.generated
        (folder / "main.c").write_text(_main(made))
        program = folder / "asked"
        flags = [*WARNINGS, "-O0", *(SANITIZERS if sanitized else [])]
        own = object_of(made, folder, flags)
        done = gcc([*flags, compiled("main", folder, flags), own, "-o", program.name], folder)
        assert done.returncode == 0, f"{done.stderr[:4000]}"
        self.program = program

    def ask(self, lines: list[str]) -> list[str]:
        """Send lines and return the answers."""
        done = subprocess.run([str(self.program)], input="\n".join([*lines, ""]), capture_output=True, text=True)
        assert done.returncode == 0, f"status {done.returncode} {done.stderr[:4000]}"
        found = done.stdout.split("\n")[:-1]
        assert len(found) == len(lines), (len(found), len(lines))
        return found

    # ---- what Python says -------------------------------------------------------------------------------------

    def expected(self, frame: str, data: bytes) -> str:
        try:
            values = self.codec.decode(frame, data, self.context)
        except FrameError as error:
            return f"! {error.cause} {error.offset} {-1 if error.refuse is None else error.refuse}"
        return " ".join(["=", *tokens(values, self.generated.structs[frame], self.generated)])

    def samples(self, frame: str, count: int = 8) -> list[bytes]:
        return [sample.data for sample in Sampler(self.codec, self.context).samples(frame, count)]


def mutated(random_: random.Random, data: bytes, count: int) -> Iterator[bytes]:
    """Yield copies of the bytes with a few changes."""
    for _ in range(count):
        found = bytearray(data)
        for _ in range(random_.choice((1, 1, 1, 2, 3))):
            place = random_.randrange(len(found) + 1)
            match random_.randrange(5):
                case 0 if found:
                    found[place % len(found)] = random_.randrange(256)
                case 1 if found:
                    found[place % len(found)] ^= 1 << random_.randrange(8)
                case 2:
                    found[place:place] = bytes((random_.randrange(256),))
                case 3:
                    del found[place : place + random_.randrange(1, 4)]
                case _:
                    del found[place:]
        yield bytes(found)


# ---- values as words --------------------------------------------------------------------------------------------


def tokens(values: Mapping[str, Any], struct: CStruct, made: Generated) -> list[str]:
    """Return the values of a frame in the order of its struct."""
    found: list[str] = []
    for name, member in struct.members.items():
        value = values.get(name)
        if value is None and member.has:
            found.append("-")
            continue
        if value is None:  # computed values may be left out
            found += _nothing_of(member)
            continue
        found += _tokens_of(value, member, made)
    return found


def _nothing_of(member: CMember) -> list[str]:
    match member.kind:
        case "record":
            assert member.inside is not None
            return [
                token
                for inside in member.inside.members.values()
                for token in (["-"] if inside.has else _nothing_of(inside))
            ]
        case "bytes":
            return ["x"]
        case "decimal":
            return ["0", "0"]
        case "float":
            return ["f" + "00" * member.size]
        case "inner":
            return ["?", "x"]
    return ["0"]


def _parts(value: Any) -> tuple[int, int]:
    """Return the digits of a decimal number as an integer, and the number of decimal places."""
    sign, digits, exponent = Decimal(str(value)).as_tuple()
    number = int("".join(map(str, digits)))
    return -number if sign else number, -int(exponent)


def _tokens_of(value: Any, member: CMember, made: Generated) -> list[str]:
    match member.kind:
        case "number":
            if member.places:
                return [str(int(Decimal(str(value)) * 10**member.places))]
            return [str(int(value))]
        case "decimal":
            number, places = _parts(value)
            return [str(number), str(places)]
        case "float":
            code = ">f" if member.size == 4 else ">d"
            return [f"f{packing.pack(code, value).hex()}"]
        case "bytes":
            data = value.encode("latin-1") if isinstance(value, str) else bytes(value)
            return [f"x{data.hex()}"]
        case "record":
            assert member.inside is not None
            return tokens(value, member.inside, made)
        case "list":
            assert member.inside is not None
            items = [{PLAIN: item} if member.is_single else item for item in value]
            return [str(len(value)), *(token for item in items for token in tokens(item, member.inside, made))]
        case "values":
            assert member.item is not None
            return [str(len(value)), *(token for item in value for token in _tokens_of(item, member.item, made))]
    ((frame, fields),) = value.items()
    if frame == "unknown":
        return ["?", f"x{bytes(fields['data']).hex()}"]
    return [f"@{identifier(frame)}", *tokens(fields, made.structs[frame], made)]


# ---- the program ------------------------------------------------------------------------------------------------


def _main(made: Generated) -> str:
    """Write a program that reads lines and answers."""
    from framekit.extras.generate_c.source import CSource

    out = CSource()
    prefix = made.prefix
    out.add(f'#include "{made.name}.h"', "#include <stdio.h>", "#include <stdlib.h>", "#include <string.h>", "")
    out.add(*_COMMON.splitlines(), "")
    context = f", &{prefix}_defaults" if "_defaults;" in made.header else ""
    for frame in _ordered(made):
        name = identifier(frame)
        struct = made.structs[frame]
        with out.block(f"static void show_{name}(const struct {prefix}_{name} *v)"):
            out.add("(void)v;")
            _show(out, struct, "v->", made)
        out.add("")
        out.add(f"void take_{name}(struct {prefix}_{name} *v);")
        with out.block(f"void take_{name}(struct {prefix}_{name} *v)"):
            out.add("(void)v;")
            _scan(out, struct, "v->", made)
        out.add("")
    not_measured, not_built = dict(made.not_measured), dict(made.not_built)
    with out.block("static void answer(char *line)"):
        out.add("static uint8_t data[70000];", "char *what = strtok(line, \" \"), *frame = strtok(NULL, \" \");",
                "if (what == NULL || frame == NULL) {", "    puts(\"no line\");", "    return;", "}")  # fmt: skip
        for frame in made.frames:
            name = identifier(frame)
            with out.block(f'if (strcmp(what, "d") == 0 && strcmp(frame, "{name}") == 0)'):
                out.add(f"static struct {prefix}_{name} v;", "struct framekit_fault fault;",
                        "size_t size = unhex(strtok(NULL, \" \"), data);")  # fmt: skip
                out.add("uint8_t *copy = malloc(size + 1);", "memcpy(copy, data, size);",
                        "copy = realloc(copy, size > 0 ? size : 1);", "memset(&v, 0xA5, sizeof v);")  # fmt: skip
                with out.block(f"if ({prefix}_decode_{name}(copy, size{context}, &v, &fault) == FRAMEKIT_OK)"):
                    out.add('printf("=");', f"show_{name}(&v);", 'puts("");')
                with out.block("else"):
                    out.add('printf("! %s %zu %lld\\n", reasons[fault.reason], fault.offset, (long long)fault.refuse);')
                out.add("free(copy);", "return;")
            if frame not in not_measured:
                with out.block(f'if (strcmp(what, "m") == 0 && strcmp(frame, "{name}") == 0)'):
                    out.add('size_t size = unhex(strtok(NULL, " "), data);', "uint8_t *copy = malloc(size + 1);")
                    out.add("memcpy(copy, data, size);", "copy = realloc(copy, size > 0 ? size : 1);")
                    out.add(f'printf("%ld\\n", (long){prefix}_measure_{name}(copy, size{context}));')
                    out.add("free(copy);", "return;")
            if frame in not_built:
                continue
            with out.block(f'if (strcmp(what, "e") == 0 && strcmp(frame, "{name}") == 0)'):
                out.add(f"static struct {prefix}_{name} v;", "int32_t size;", "size_t i, room = next_number();")
                out.add("uint8_t *to = malloc(room + 1);", "to = realloc(to, room > 0 ? room : 1);", "stored = 0;")
                out.add("memset(&v, 0, sizeof v);", f"take_{name}(&v);")
                out.add(f"size = {prefix}_encode_{name}(&v{context}, to, room);")
                with out.block("if (size < 0)"):
                    out.add('printf("- %s\\n", reasons[-size]);')
                with out.block("else"):
                    out.add('printf("+ ");')
                    with out.block("for (i = 0; i < (size_t)size; i++)"):
                        out.add('printf("%02x", to[i]);')
                    out.add('puts("");')
                out.add("free(to);", "return;")
        if made.in_streams:
            _stream(out, made, context)
        out.add('puts("no frame");')
    out.add("", *_LOOP.splitlines())
    return out.text()


def _stream(out: Any, made: Generated, context: str) -> None:
    """Write the command that feeds bytes to a parser and prints the frames, the faults and the noise."""
    p = made.prefix
    with out.block('if (strcmp(what, "s") == 0)'):
        out.add(f"static struct {p}_parser parser;", 'size_t size = unhex(strtok(NULL, " "), data), at = 0, i;')
        out.add('char *piece = strtok(NULL, " ");', "size_t most = piece == NULL ? 0 : strtoul(piece, NULL, 10);")
        out.add("enum framekit_event event;", "bool silent = false;")
        out.add("memset(&parser, 0xA5, sizeof parser);", f"{p}_parser_begin(&parser, frame[0] == 'c' ? 1 : 2);")
        with out.block("for (;;)"):
            with out.block(f"while ((event = {p}_parser_next(&parser{context})) != FRAMEKIT_MORE)"):
                with out.block("if (event == FRAMEKIT_FRAME)"):
                    out.add('printf("F %u ", (unsigned)parser.frame);')
                    with out.block("for (i = 0; i < parser.length; i++)"):
                        out.add('printf("%02x", parser.data[i]);')
                    out.add('printf(" ");')
                with out.block("else"):
                    out.add('printf("B %u %s ", (unsigned)parser.frame, reasons[parser.fault.reason]);')
            with out.block("if (at < size)"):
                out.add("i = size - at < most ? size - at : most;", f"at += {p}_parser_put(&parser, data + at, i);")
                out.add("continue;")
            with out.block("if (silent)"):
                out.add("break;")
            out.add("silent = true;", f"{p}_parser_silence(&parser);")
        out.add('printf("N %zu\\n", parser.noise);', "return;")


def _ordered(made: Generated) -> list[str]:
    """Return the frames, inner frames first."""
    found: list[str] = []

    def add(frame: str) -> None:
        for one in _inside(made.structs[frame]):
            if one not in found:
                add(one)
        if frame not in found:
            found.append(frame)

    for frame in made.frames:
        add(frame)
    return found


def _inside(struct: CStruct) -> Iterator[str]:
    for member in struct.members.values():
        yield from member.frames
        if member.inside is not None:
            yield from _inside(member.inside)


def _show(out: Any, struct: CStruct, path: str, made: Generated, depth: int = 0) -> None:
    for member in struct.members.values():
        at = f"{path}{member.cname}"
        if member.has:
            with out.block(f"if (!{path}{member.flag})"):
                if member.always_valued:
                    out.add('printf(" ~");')
                    _show_one(out, member, at, made, depth)
                else:
                    out.add('printf(" -");')
            with out.block("else"):
                _show_one(out, member, at, made, depth)
        else:
            _show_one(out, member, at, made, depth)


def _show_one(out: Any, member: CMember, at: str, made: Generated, depth: int) -> None:
    match member.kind:
        case "number" if member.low >= 0:
            out.add(f'printf(" %llu", (unsigned long long){at});')
        case "number":
            out.add(f'printf(" %lld", (long long){at});')
        case "decimal":
            out.add(f'printf(" %lld %d", (long long){at}.number, {at}.places);')
        case "float":
            out.add(f"show_float(&{at}, {member.size});")
        case "bytes":
            out.add(f"show_bytes({at});")
        case "record":
            assert member.inside is not None
            _show(out, member.inside, f"{at}.", made, depth)
        case "list" | "values":
            out.add(f'printf(" %zu", {at}.count);')
            with out.block(""):
                out.add(f"size_t i{depth};")
                with out.block(f"for (i{depth} = 0; i{depth} < {at}.count; i{depth}++)"):
                    if member.kind == "values":
                        assert member.item is not None
                        _show_one(out, member.item, f"{at}.items[i{depth}]", made, depth + 1)
                    else:
                        assert member.inside is not None
                        _show(out, member.inside, f"{at}.items[i{depth}].", made, depth + 1)
        case "inner":
            upper = made.prefix.upper()
            with out.block(f"switch ((int){at}.frame)"):
                for frame in member.frames:
                    name = identifier(frame)
                    show = f"show_{name}(&{at}.of.{inner_name(frame)})"
                    out.add(f'case {upper}_FRAME_{name}: printf(" @{name}"); {show}; break;')
                out.add(f'default: printf(" ?"); show_bytes({at}.of.unknown); break;')


def _scan(out: Any, struct: CStruct, path: str, made: Generated, depth: int = 0) -> None:
    for member in struct.members.values():
        at = f"{path}{member.cname}"
        if member.has:
            with out.block("if (!is_absent())"):
                out.add(f"{path}{member.flag} = true;")
                _scan_one(out, member, at, made, depth)
        else:
            _scan_one(out, member, at, made, depth)


def _scan_one(out: Any, member: CMember, at: str, made: Generated, depth: int) -> None:
    match member.kind:
        case "number":
            out.add(f"{at} = ({member.ctype})next_number();")
        case "decimal":
            out.add(f"{at}.number = (int64_t)next_number();", f"{at}.places = (int16_t)next_number();")
        case "float":
            out.add(f"next_float(&{at}, {member.size});")
        case "bytes":
            out.add(f"{at} = next_bytes();")
        case "record":
            assert member.inside is not None
            _scan(out, member.inside, f"{at}.", made, depth)
        case "list" | "values":
            with out.block(""):
                out.add(f"size_t i{depth};", f"{at}.count = next_number();")
                with out.block(f"for (i{depth} = 0; i{depth} < {at}.count; i{depth}++)"):
                    if member.kind == "values":
                        assert member.item is not None
                        _scan_one(out, member.item, f"{at}.items[i{depth}]", made, depth + 1)
                    else:
                        assert member.inside is not None
                        _scan(out, member.inside, f"{at}.items[i{depth}].", made, depth + 1)
        case "inner":
            upper = made.prefix.upper()
            with out.block(""):
                out.add("const char *frame = next();")
                for frame in member.frames:
                    name = identifier(frame)
                    with out.block(f'if (strcmp(frame, "@{name}") == 0)'):
                        out.add(f"{at}.frame = {upper}_FRAME_{name};", f"take_{name}(&{at}.of.{inner_name(frame)});")
                with out.block('if (strcmp(frame, "?") == 0)'):
                    out.add(f"{at}.frame = {upper}_FRAME_UNKNOWN;", f"{at}.of.unknown = next_bytes();")


_COMMON = (
    """\
static const char *const reasons[] = { """
    + ", ".join(f'"{reason}"' for reason in _REASONS)
    + """ };

static size_t unhex(const char *text, uint8_t *to)
{
    size_t size = 0;
    while (text != NULL && text[0] == 'x') {
        text++;
    }
    for (; text != NULL && text[0] != 0 && text[1] != 0; text += 2) {
        char pair[3] = { text[0], text[1], 0 };
        to[size++] = (uint8_t)strtoul(pair, NULL, 16);
    }
    return size;
}

static void show_bytes(struct framekit_bytes b)
{
    size_t i;
    printf(" x");
    for (i = 0; i < b.size; i++) {
        printf("%02x", b.data[i]);
    }
}

void show_float(const void *value, size_t size);
void show_float(const void *value, size_t size)
{
    unsigned char bytes[8];
    size_t i;
    memcpy(bytes, value, size);
    printf(" f");
    for (i = 0; i < size; i++) {
        printf("%02x", bytes[size - 1 - i]);
    }
}

void show_nothing(struct framekit_bytes b);
void show_nothing(struct framekit_bytes b)
{
    show_bytes(b);
}

static uint8_t store[400000];
static size_t stored;
static char *waiting;

static char *next(void)
{
    char *found = waiting != NULL ? waiting : strtok(NULL, " ");
    waiting = NULL;
    return found != NULL ? found : (char *)"";
}

bool is_absent(void);
bool is_absent(void)
{
    char *word = next();
    if (strcmp(word, "-") == 0) {
        return true;
    }
    waiting = word;
    return false;
}

static unsigned long long next_number(void)
{
    char *word = next();
    return word[0] == '-' ? (unsigned long long)strtoll(word, NULL, 10) : strtoull(word, NULL, 10);
}

struct framekit_bytes next_bytes(void);
struct framekit_bytes next_bytes(void)
{
    struct framekit_bytes found;
    found.data = store + stored;
    found.size = unhex(next(), store + stored);
    stored += found.size;
    return found;
}

void next_float(void *to, size_t size);
void next_float(void *to, size_t size)
{
    unsigned char bytes[8], turned[8];
    size_t i;
    char *word = next();
    unhex(word + (word[0] == 'f'), bytes);
    for (i = 0; i < size; i++) {
        turned[size - 1 - i] = bytes[i];
    }
    memcpy(to, turned, size);
}
"""
)
_LOOP = """\
int main(void)
{
    static char line[400000];
    while (fgets(line, sizeof line, stdin) != NULL) {
        line[strcspn(line, "\\r\\n")] = 0;
        answer(line);
    }
    return 0;
}
"""


def differences(c: CProtocol, cases: Iterable[tuple[str, bytes]]) -> list[str]:
    """Return the frames and bytes that C and Python decode differently."""
    pairs = list(dict.fromkeys(cases))
    found = []
    answers = c.ask([f"d {identifier(frame)} x{data.hex()}" for frame, data in pairs])
    for (frame, data), answer in zip(pairs, answers, strict=True):
        wanted = c.expected(frame, data)
        if not agree(wanted, answer) and not answer.startswith("! no_room"):
            found.append(f"{frame} {data.hex(' ').upper()}: Python {wanted[:200]}, C {answer[:200]}")
    return found


def agree(wanted: str, answer: str) -> bool:
    """Return whether C and Python agree.

    The default of an absent value, which C prints as `~` and the default, may be a value or None in Python.
    """
    if "~" not in answer:
        return wanted == answer
    ours, theirs = wanted.split(), answer.split()
    place = 0
    for one in ours:
        if place < len(theirs) and theirs[place] == "~":
            place += 1
            if one == "-":
                place += 1
                continue
        if place >= len(theirs) or theirs[place] != one:
            return False
        place += 1
    return place == len(theirs)


def encoded_alike(c: CProtocol, cases: list[tuple[str, Mapping[str, Any]]]) -> list[str]:
    """Return the frames and values that C and Python encode differently, or that only one of them refuses."""
    made = c.generated
    lines, wanted = [], []
    for frame, values in cases:
        try:
            words = tokens(values, made.structs[frame], made)
        except (TypeError, ValueError, KeyError, AttributeError, OverflowError, packing.error):
            continue
        if not _holdable(values, made.structs[frame], made):
            continue
        try:
            ours = "+ " + c.codec.encode(frame, values, c.context).hex()
        except EncodeError as error:
            if "missing" in str(error) or "is computed as" in str(error):  # a struct has every member
                continue
            ours = f"- {error}"
        lines.append(" ".join([f"e {identifier(frame)} 70000", *words]))
        wanted.append((frame, values, ours))
    found = []
    for (frame, values, ours), theirs in zip(wanted, c.ask(lines), strict=True):
        if ours != theirs and not (ours[0] == "-" and theirs[0] == "-") and theirs != "- no_room":
            found.append(f"{frame} {values}: Python {ours[:300]}, C {theirs[:300]}")
    return found


def _holdable(values: Mapping[str, Any], struct: CStruct, made: Generated) -> bool:
    """Return whether the struct can hold the values; other values are not tested."""
    for name, value in values.items():
        member = struct.members.get(name)
        if member is None:
            return False
        if value is None:
            continue
        if not _holds(value, member, made):
            return False
    return True


def _holds(value: Any, member: CMember, made: Generated) -> bool:
    match member.kind:
        case "number":
            number = int(Decimal(str(value)) * 10**member.places) if member.places else value
            if member.places and Decimal(number).scaleb(-member.places) != Decimal(str(value)):
                return False
            bits = int(re.findall(r"\d+", member.ctype)[0])
            low, high = (0, (1 << bits) - 1) if member.ctype[0] == "u" else (-(1 << bits - 1), (1 << bits - 1) - 1)
            return isinstance(number, int) and low <= number <= high
        case "decimal":
            number, places = _parts(value)
            is_minus_zero = number == 0 and str(value).startswith("-")
            return not is_minus_zero and abs(number) < 1 << 63 and abs(places) < 1 << 15
        case "record":
            assert member.inside is not None
            return _holdable(value, member.inside, made)
        case "list":
            assert member.inside is not None
            inside = member.inside
            items = [{PLAIN: item} if member.is_single else item for item in value]
            return len(value) <= member.capacity and all(_holdable(item, inside, made) for item in items)
        case "values":
            assert member.item is not None
            one = member.item
            return len(value) <= member.capacity and all(_holds(item, one, made) for item in value)
        case "inner":
            ((frame, fields),) = value.items()
            return frame == "unknown" or _holdable(fields, made.structs[frame], made)
    return True


def changed_values(random_: random.Random, value: Any) -> Any:
    """Return values with a change at a random place."""
    if isinstance(value, Mapping) and value:
        name = random_.choice(sorted(value))
        if random_.random() < 0.1 and len(value) > 1:
            return {one: inside for one, inside in value.items() if one != name}
        return {**value, name: changed_values(random_, value[name])}
    if isinstance(value, list) and value:
        place = random_.randrange(len(value))
        match random_.randrange(4):
            case 0:
                return value[:place] + value[place + 1 :]
            case 1:
                return [*value, value[place]]
        return [*value[:place], changed_values(random_, value[place]), *value[place + 1 :]]
    if isinstance(value, (str, bytes)):
        extra: Any = value[:1] or ("A" if isinstance(value, str) else b"A")
        match random_.randrange(3):
            case 0:
                return value + extra
            case 1:
                return value[:-1]
        other: Any = chr(random_.randrange(256)) if isinstance(value, str) else bytes((random_.randrange(256),))
        return other + value[1:]
    if isinstance(value, bool) or value is None:
        return value
    if isinstance(value, int):
        return random_.choice((value + 1, value - 1, 0, value ^ 0x80, 255, 256, 65535, value * 2))
    return value


def encode_trial(c: CProtocol, seed: int, samples: int = 6, changes: int = 8) -> list[str]:
    """Compare the encoding of drawn values and changed values, for every frame of the C."""
    random_ = random.Random(seed)
    cases: list[tuple[str, Mapping[str, Any]]] = []
    only = {frame for frame, _, _ in c.generated.to_give}
    for frame in _ordered(c.generated):  # also the outer frames of such a frame
        if only & set(_inside(c.generated.structs[frame])):
            only.add(frame)
    not_built = dict(c.generated.not_built)
    for frame in c.generated.frames:
        if frame in not_built:
            continue
        for sample in Sampler(c.codec, c.context).samples(frame, samples):
            cases.append((frame, sample.read))
            if frame not in only:
                cases.append((frame, sample.values))
                cases += ((frame, changed_values(random_, sample.values)) for _ in range(changes))
    return encoded_alike(c, cases)


def measure_trial(c: CProtocol, seed: int, samples: int = 4, changes: int = 3) -> list[str]:
    """Return the prefixes of frames that C and Python measure differently."""
    random_ = random.Random(seed)
    cases: list[tuple[str, bytes]] = []
    left = dict(c.generated.not_measured)
    for frame in c.generated.frames:
        if frame in left:
            continue
        for data in c.samples(frame, samples):
            for one in (data, *mutated(random_, data, changes)):
                ends = range(len(one) + 1) if len(one) < 60 else sorted(random_.sample(range(len(one) + 1), 40))
                cases += ((frame, one[:end]) for end in ends)
            cases.append((frame, data + bytes(random_.randrange(256) for _ in range(3))))
    pairs = list(dict.fromkeys(cases))
    found = []
    answers = c.ask([f"m {identifier(frame)} x{data.hex()}" for frame, data in pairs])
    for (frame, data), answer in zip(pairs, answers, strict=True):
        size = c.codec.measure(frame, data, ctx=c.context)
        wanted = {c.codec.QUIET: "-2147483646", c.codec.LOST: "-2147483647"}.get(size, str(size))
        if answer != wanted:
            found.append(f"{frame} {data.hex(' ').upper()}: Python {wanted}, C {answer}")
    return found


def found_by_python(c: CProtocol, side: str, data: bytes) -> list[tuple[str, bytes]]:
    """Return the frames of a stream that Python finds: good frames and frames to be refused."""
    from link.link_world import feed, line_of

    from framekit.link.receiver import Receiver
    from framekit.link.scope import Scope

    protocol = c.definition
    receiver = Receiver(c.codec, protocol, Scope(protocol, line=line_of(protocol)))
    frames = [protocol.frames[stream] for stream in c.generated.in_streams]
    expected = tuple(frame.name for frame in frames if frame.side in (side, "both"))
    expected = tuple(sorted(expected, key=lambda one: protocol.frames[one].refuse is not None))
    found = feed(receiver, [data], expected) if expected else []
    return [(event[1], event[2]) for event in found if event[0] == "frame"]


def found_by_c(c: CProtocol, side: str, streams: list[bytes], piece: int) -> list[list[tuple[str, bytes]]]:
    """Return the frames that the C parser finds; it gets `piece` bytes at once."""
    numbers = dict(enumerate(c.generated.frames, 1))
    found = []
    for answer in c.ask([f"s {side} x{data.hex()} {piece}" for data in streams]):
        words = iter(answer.split())
        frames = []
        for word in words:
            if word == "F":
                frames.append((numbers[int(next(words))], bytes.fromhex(next(words))))
        found.append(frames)
    return found


def streams_of(c: CProtocol, side: str, seed: int, noisy: bool, count: int = 6) -> list[bytes]:
    """Return streams of a side: frames, noise, and frames with a change between them."""
    random_ = random.Random(seed)
    frames = [stream for stream in c.generated.in_streams if c.definition.frames[stream].side in (side, "both")]
    every = [sample for frame in frames for sample in c.samples(frame, 4) if sample]
    found = []
    for _ in range(count if every else 0):
        stream = b""
        for _ in range(random_.randrange(2, 9)):
            data = random_.choice(every)
            if noisy and random_.random() < 0.4:
                data = next(mutated(random_, data, 1))
            if noisy and random_.random() < 0.3:
                data = bytes(random_.randrange(256) for _ in range(random_.randrange(1, 6))) + data
            stream += data
        found.append(stream)
    return found


def stream_trial(c: CProtocol, seed: int, noisy: bool, count: int = 6) -> tuple[list[str], int]:
    """Return the streams in which the C parser and the receiver find different frames, and the number of streams."""
    found, stream_count = [], 0
    for side in ("client", "server"):
        streams = streams_of(c, side, seed, noisy, count)
        stream_count += len(streams)
        at_once = found_by_c(c, side, streams, 70000)
        for data, theirs, one_by_one in zip(streams, at_once, found_by_c(c, side, streams, 1), strict=True):
            assert theirs == one_by_one, data.hex(" ")
            ours = found_by_python(c, side, data)
            if ours != theirs:
                found.append(f"{side} {data.hex(' ').upper()}: Python {ours}, C {theirs}"[:900])
    return found, stream_count


def trial(c: CProtocol, seed: int, samples: int = 6, changes: int = 12) -> list[str]:
    """Compare drawn frames and changed frames, for every frame of the C."""
    random_ = random.Random(seed)
    cases: list[tuple[str, bytes]] = []
    for frame in c.generated.frames:
        for data in c.samples(frame, samples):
            cases.append((frame, data))
            cases += ((frame, changed) for changed in mutated(random_, data, changes))
        cases += ((frame, bytes(random_.randrange(256) for _ in range(random_.randrange(12)))) for _ in range(6))
    return differences(c, cases)
