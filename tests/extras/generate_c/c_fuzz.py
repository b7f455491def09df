"""Fuzz the parsers of generated C with damaged streams, under AddressSanitizer and UBSan.

    python tests/extras/generate_c/c_fuzz.py --bytes 100000000 [PROTOCOL …]

Python draws frames of each protocol; a C program cuts, joins and damages them, and feeds the bytes to the parser in
pieces, with silences between them. Each frame that the parser finds is built again, and the bytes are read once more.
The bytes are divided among the protocols. Exits with status 1 if a program stops early.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

if __name__ == "__main__":
    HERE = Path(__file__).resolve().parent
    sys.path[:0] = [str(HERE.parents[1])]

from extras.generate_c.c_harness import SANITIZERS, gcc, object_of
from shipped import PROTOCOLS

from framekit.codec.codec import Codec, compile_protocol
from framekit.codec.samples import Sampler
from framekit.definition.kinds.base import constant_number
from framekit.definition.load.protocol import load_protocol
from framekit.extras.generate_c.generate import Generated, generate
from framekit.extras.generate_c.layout import inner_name
from framekit.extras.generate_c.source import CSource, identifier, string

SIDES = {"client": 1, "server": 2, "both": 3}
MOST_SEEDS, MOST_SEED = 400, 4000
"""Number of frames per stream, and of bytes per frame: the limit of a C string literal."""


@dataclass(frozen=True, slots=True)
class Fuzzed:
    """The result of a fuzz program: bytes fed, good and bad frames found, and `fault` if it stopped early."""

    name: str
    bytes: int
    good: int
    bad: int
    built: int
    fault: str = ""


def fuzz(name: str, size: int, seed: int, folder: Path) -> Fuzzed | None:
    """Feed about `size` bytes to the parsers of both sides of a protocol; None if it has no parser."""
    definition = load_protocol(name)
    made = generate(definition)
    if not made.in_streams:
        return None
    codec = compile_protocol(definition)
    fixed = {parameter.name: constant_number(parameter.is_) for parameter in definition.params.values()}
    context = {**codec.defaults, **{name: one for name, one in fixed.items() if one is not None}}
    (folder / "fuzz.c").write_text(_program(made, _seeds(made, codec, context)))
    quick = "-O1" if size > 1_000_000 else "-O0"  # optimizing takes longer than it saves with fewer bytes
    flags = ["-std=c99", quick, *SANITIZERS]
    done = gcc([*flags, "fuzz.c", object_of(made, folder, flags), "-o", "fuzz"], folder)
    assert done.returncode == 0, done.stderr[:4000]
    done = subprocess.run([str(folder / "fuzz"), str(size), str(seed)], capture_output=True, text=True)
    if done.returncode:
        return Fuzzed(name, 0, 0, 0, 0, done.stderr[-6000:] or f"status {done.returncode}")
    return Fuzzed(name, *map(int, re.findall(r"\d+", done.stdout)))


def _seeds(made: Generated, codec: Codec, context: dict[str, object]) -> list[bytes]:
    """Return some samples of each frame that is found in streams."""
    found: list[bytes] = []
    for frame in made.in_streams:
        samples = Sampler(codec, context).samples(frame, max(2, MOST_SEEDS // len(made.in_streams)))
        found += [sample.data for sample in samples if 0 < len(sample.data) <= MOST_SEED]
    return list(dict.fromkeys(found))[:MOST_SEEDS]


def _program(made: Generated, seeds: list[bytes]) -> str:
    out = CSource()
    prefix, context = made.prefix, f", &{made.prefix}_defaults" if "_defaults;" in made.header else ""
    out.add(f'#include "{made.name}.h"', "#include <stdio.h>", "#include <stdlib.h>", "#include <string.h>", "")
    for number, data in enumerate(seeds):
        out.add(f"static const char seed{number}[] = {string(data)};")
    with out.block("static const struct", " seeds[] = {"):
        out.add("const char *data;", "size_t size;")
    out.add(*(f"    {{ seed{number}, {len(data)} }}," for number, data in enumerate(seeds)), "};")
    out.add(f"#define SEEDS {len(seeds)}", f"#define PARSER struct {prefix}_parser", "", *_DAMAGE.splitlines(), "")
    not_built = dict(made.not_built)
    with out.block("static void look(PARSER *parser)"):
        out.add("uint8_t *to = malloc(parser->length + 64);", "int32_t size = -1;", "struct framekit_fault fault;")
        out.add("(void)fault;")
        with out.block("switch ((int)parser->frame)"):
            for frame in made.in_streams:
                if frame in not_built:
                    continue
                name = identifier(frame)
                out.add(f"case {prefix.upper()}_FRAME_{name}: {{", f"    static struct {prefix}_{name} again;")
                call = f"{prefix}_encode_{name}(&parser->of.{inner_name(frame)}{context}, to, parser->length + 64)"
                out.add(f"    size = {call};", "    if (size >= 0) {", "        to = cut(to, (size_t)size);")
                out.add(f"        (void){prefix}_decode_{name}(to, (size_t)size{context}, &again, &fault);", "    }")
                out.add("    break;", "}")
            out.add("default: break;")
        out.add("built += size >= 0;", "free(to);")
    out.add("")
    with out.block("static void take(PARSER *parser)"):
        out.add("enum framekit_event event;", "size_t before = parser->noise, turns = 0;")
        with out.block(f"while ((event = {prefix}_parser_next(parser{context})) != FRAMEKIT_MORE)"):
            out.add("must(++turns <= 2 * sizeof parser->buffer + 2);", "good += event == FRAMEKIT_FRAME;")
            out.add("bad += event == FRAMEKIT_BAD;", "must(parser->length <= sizeof parser->buffer);")
            with out.block("if (event == FRAMEKIT_FRAME)"):
                out.add("must(parser->length > 0);", "look(parser);")
        out.add("must(parser->size <= sizeof parser->buffer && parser->noise >= before);")
    out.add("", *_STREAM.replace("PREFIX", prefix).splitlines())
    return out.text()


_DAMAGE = """\
static uint64_t state, good, bad, built;

static void must(bool holds)
{
    if (!holds) {
        abort();
    }
}

static size_t draw(size_t below)
{
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return (size_t)(state >> 11) % below;
}

/* The first bytes in a block of just that size, so that the sanitizer sees what is read behind them. */
static uint8_t *cut(uint8_t *data, size_t size)
{
    uint8_t *found = malloc(size > 0 ? size : 1);
    memcpy(found, data, size);
    free(data);
    return found;
}

static uint8_t drawn_byte(void)
{
    static const uint8_t usual[] = { 0, 1, 2, 3, 0x0A, 0x0D, 0x10, 0x7E, 0x7F, 0x80, 0xFE, 0xFF, '0', '9', 'A', 'f' };
    return draw(2) == 0 ? usual[draw(sizeof usual)] : (uint8_t)draw(256);
}

/* Puts a frame behind what there is, most of them with a change; gives the new size. */
static size_t damaged(uint8_t *to, size_t size)
{
    size_t seed = draw(SEEDS), length = seeds[seed].size, changes = draw(4), place, count;
    uint8_t *frame = to + size;
    memcpy(frame, seeds[seed].data, length);
    for (; changes > 0 && length > 0; changes--) {
        place = draw(length);
        switch (draw(8)) {
        case 0: frame[place] = drawn_byte(); break;
        case 1: frame[place] ^= (uint8_t)(1u << draw(8)); break;
        case 2: frame[place] = (uint8_t)(frame[place] + draw(5) - 2); break;
        case 3: length = place; break;
        case 4:
            count = 1 + draw(length - place < 4 ? length - place : 4);
            memmove(frame + place, frame + place + count, length - place - count);
            length -= count;
            break;
        case 5:
            count = 1 + draw(draw(8) == 0 ? 64 : 3);
            memmove(frame + place + count, frame + place, length - place);
            memset(frame + place, drawn_byte(), count);
            length += count;
            break;
        case 6:
            seed = draw(SEEDS);
            count = draw(seeds[seed].size);
            memcpy(frame + place, seeds[seed].data + count, seeds[seed].size - count);
            length = place + seeds[seed].size - count;
            break;
        default:
            for (count = draw(6); place < length && count > 0; count--) {
                frame[place++] = drawn_byte();
            }
        }
    }
    return size + length;
}
"""
_STREAM = """\
int main(int argc, char **argv)
{
    static PARSER parser;
    static uint8_t stream[1 << 20];
    uint64_t wanted = strtoull(argv[1], NULL, 10), done = 0;
    state = argc > 2 ? strtoull(argv[2], NULL, 10) * 0x9E3779B97F4A7C15u + 1 : 1;
    while (done < wanted) {
        size_t size = 0, frames = 1 + draw(12), at = 0, piece, taken, most = draw(3) == 0 ? 1 : 1 + draw(300);
        uint8_t *data;
        memset(&parser, 0xA5, sizeof parser);
        PREFIX_parser_begin(&parser, 1 + (unsigned)draw(3));
        for (; frames > 0; frames--) {
            size = damaged(stream, size);
        }
        data = malloc(size > 0 ? size : 1);
        memcpy(data, stream, size);
        while (at < size) {
            piece = 1 + draw(most);
            piece = piece < size - at ? piece : size - at;
            taken = PREFIX_parser_put(&parser, data + at, piece);
            must(taken <= piece && (taken > 0 || parser.size == sizeof parser.buffer));
            at += taken;
            take(&parser);
            must(parser.size < sizeof parser.buffer);
            if (draw(200) == 0) {
                PREFIX_parser_silence(&parser);
                take(&parser);
                must(parser.size == 0);
            }
        }
        PREFIX_parser_silence(&parser);
        take(&parser);
        must(parser.size == 0 && parser.noise <= size);
        free(data);
        done += size;
    }
    printf("%llu %llu %llu %llu\\n", (unsigned long long)done, (unsigned long long)good, (unsigned long long)bad,
           (unsigned long long)built);
    return 0;
}
"""


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python tests/extras/generate_c/c_fuzz.py", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("protocols", nargs="*", metavar="PROTOCOL", help="all shipped ones if none is named")
    parser.add_argument("--bytes", type=int, default=1_000_000, metavar="N", help="so many bytes in total")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    names = arguments.protocols or PROTOCOLS
    begin, total, faults = time.perf_counter(), 0, 0
    for number, name in enumerate(names):
        share, since = -(-max(arguments.bytes - total, 0) // (len(names) - number)), time.perf_counter()
        with tempfile.TemporaryDirectory() as folder:
            found = fuzz(name, share, arguments.seed, Path(folder))
        if found is None:
            print(f"{name}: no frames are looked for", flush=True)
            continue
        total += found.bytes
        faults += bool(found.fault)
        summary = f"{found.bytes} bytes, {found.good} frames, {found.bad} bad, {found.built} built again"
        print(f"{name}: {found.fault or summary} ({time.perf_counter() - since:.0f} s)", flush=True)
    print(f"{total} bytes in {time.perf_counter() - begin:.0f} s, {faults} programs stopped")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
