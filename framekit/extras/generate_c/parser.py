"""Write the parser of streams in C: it takes bytes and returns frames, with a buffer of the size of the longest frame.

It searches like the receiver (`link/receiver.py`): at each offset it measures the frames of one side, takes the
shortest frame that fits, waits while a frame needs more bytes, and reports a bad frame once. `docs/generate-c.md` lists
the differences.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from framekit.definition.model.frames import Frame, everything
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.sections import Receiver
from framekit.extras.generate_c.layout import inner_name
from framekit.extras.generate_c.source import CSource, identifier

SIDES: Mapping[str, int] = {"client": 1, "server": 2, "both": 3}
"""Bits of the sides that may send a frame."""


class ParserWriter:
    """Write the parser of a protocol; `frames`: the frames on the line that can be measured."""

    def __init__(
        self, prefix: str, context: str, hand_on: str, frames: list[Frame], most: int, rules: Receiver
    ) -> None:
        self.prefix, self.upper = prefix, prefix.upper()
        self.context, self.hand_on = context, hand_on
        self.frames = sorted(frames, key=lambda one: one.refuse is not None)
        self.most, self.rules = most, rules

    def header(self, out: CSource) -> None:
        """Write the struct and the declarations."""
        p, upper = self.prefix, self.upper
        out.add("/* Frames in a stream: what came is put in, and told by `next`, which drops what it told before. */")
        out.add(f"#define {upper}_MAX_STREAM {self.most} /* bytes of the greatest frame that is looked for */")
        with out.block(f"struct {p}_parser", ";"):
            out.add(
                f"uint8_t buffer[{upper}_MAX_STREAM + 1]; /* one more tells that a frame is too long */",
                "size_t size, told, wanted, bad_left;",
            )
            out.add("unsigned from;", "bool is_silent, is_skipping, is_broken;")
            out.add("size_t noise; /* bytes so far that belong to no frame */")
            out.add(f"enum {p}_frame frame; /* what was found */")
            out.add("const uint8_t *data; /* its bytes */", "size_t length;", "struct framekit_fault fault;")
            with out.block("union", " of; /* the values of a good frame, or of one that is to be refused */"):
                for frame in self.frames:
                    out.add(f"struct {p}_{identifier(frame.name)} {inner_name(frame.name)};")
        out.add("", f"void {p}_parser_begin(struct {p}_parser *parser, unsigned from);")
        out.add(f"size_t {p}_parser_put(struct {p}_parser *parser, const uint8_t *data, size_t size);")
        out.add(f"enum framekit_event {p}_parser_next(struct {p}_parser *parser{self.context});")
        out.add(f"void {p}_parser_silence(struct {p}_parser *parser);", "")

    def source(self, out: CSource) -> None:
        """Write the public functions."""
        p = self.prefix
        with out.block(f"void {p}_parser_begin(struct {p}_parser *parser, unsigned from)"):
            out.add("parser->size = parser->told = parser->wanted = parser->bad_left = 0;", "parser->noise = 0;")
            out.add("parser->is_silent = parser->is_skipping = parser->is_broken = false;", "parser->from = from;")
        out.add("")
        with out.block(f"size_t {p}_parser_put(struct {p}_parser *parser, const uint8_t *data, size_t size)"):
            out.add("size_t room;")
            out.when("parser->told > 0", f"{p}_fk_drop(parser, parser->told);", "parser->told = 0;")
            out.add("room = sizeof parser->buffer - parser->size;", "size = size < room ? size : room;")
            with out.block("if (size > 0)"):
                out.add("memcpy(parser->buffer + parser->size, data, size);", "parser->size += size;")
                out.add("parser->is_silent = false;")
            out.add("return size;")
        out.add("")
        with out.block(f"void {p}_parser_silence(struct {p}_parser *parser)"):
            out.add("parser->is_silent = true;")
        out.add("")
        self._next(out)

    def functions(self, out: CSource) -> None:
        """Write the static functions that the parser calls."""
        p = self.prefix
        with out.block(f"static void {p}_fk_drop(struct {p}_parser *parser, size_t count)"):
            out.add("count = count < parser->size ? count : parser->size;")
            out.add("memmove(parser->buffer, parser->buffer + count, parser->size - count);", "parser->size -= count;")
            out.add("parser->bad_left -= count < parser->bad_left ? count : parser->bad_left;", "parser->wanted = 0;")
        out.add("")
        with out.block(f"static int64_t {p}_fk_size(const struct {p}_parser *parser, unsigned frame{self.context})"):
            out.add("const uint8_t *data = parser->buffer;", "size_t size = parser->size;")
            if self.context:
                out.add("(void)context;")
            with out.block("switch (frame)"):
                for place, frame in enumerate(self.frames):
                    call = f"{p}_fk_measure_{identifier(frame.name)}(data, size{self.hand_on})"
                    out.add(f"case {place}: return (parser->from & {SIDES[frame.side]}u) != 0 ? {call} : 0;")
                out.add("default: return 0;")
        out.add("")
        with out.block(
            f"static void {p}_fk_look(struct {p}_parser *parser, unsigned frame, size_t size{self.context})"
        ):
            out.add("struct fk_notes notes;", "memset(&notes, 0, sizeof notes);")
            if self.context:
                out.add("(void)context;")
            with out.block("switch (frame)"):
                for place, frame in enumerate(self.frames):
                    name = identifier(frame.name)
                    out.add(f"case {place}:")
                    out.add(
                        f"    {p}_fk_read_{name}(parser->buffer, size{self.hand_on},"
                        f" &parser->of.{inner_name(frame.name)}, &notes);"
                    )
                    out.add(f"    parser->frame = {self.upper}_FRAME_{name};", "    break;")
                out.add("default:", "    break;")
            out.add("fk_told(&notes, &parser->fault);", "parser->data = parser->buffer;", "parser->length = size;")
        out.add("")

    def _next(self, out: CSource) -> None:
        p, count = self.prefix, len(self.frames)
        with out.block(f"enum framekit_event {p}_parser_next(struct {p}_parser *parser{self.context})"):
            out.add(f"int64_t sizes[{count}];", "unsigned i;")
            if self.context:
                out.add("(void)context;")
            out.when("parser->told > 0", f"{p}_fk_drop(parser, parser->told);", "parser->told = 0;")
            with out.block("for (;;)"):
                self._one_place(out, count)
        out.add("")

    def _one_place(self, out: CSource, count: int) -> None:
        p = self.prefix
        out.add("bool wants = false, quiet = false, is_bad = false, cut = false;")
        out.add("size_t least = SIZE_MAX, bad_size = 1, bad_at = 0;", "unsigned bad = 0;")
        out.add("enum framekit_reason reason = FRAMEKIT_LENGTH;")
        with out.block("if (parser->is_broken || parser->is_skipping)"):
            out.when("parser->is_skipping && parser->is_silent", "parser->is_skipping = false;")
            out.add("parser->size = 0;")
        if self.rules.delimiter is not None:
            byte = self.rules.delimiter
            with out.block(f"while (parser->size > 1 && parser->buffer[0] == {byte} && parser->buffer[1] == {byte})"):
                out.add(f"{p}_fk_drop(parser, 1);")
        out.when("parser->size == 0", "parser->is_silent = false;", "return FRAMEKIT_MORE;")
        out.when("!parser->is_silent && parser->size < parser->wanted", "return FRAMEKIT_MORE;")
        with out.block(f"for (i = 0; i < {count}; i++)"):
            out.add(f"sizes[i] = {p}_fk_size(parser, i{self.hand_on});")
            out.add("/* what has no room here is bad: nothing else would come of it */")
            room = "(int64_t)(sizeof parser->buffer - parser->size)"
            full = (
                f"(sizes[i] < 0 && sizes[i] > FK_QUIET && -sizes[i] > {room}) || (sizes[i] == FK_QUIET && {room} == 0)"
            )
            with out.block(f"if (sizes[i] == FK_LOST || {full})"):
                out.add("reason = is_bad || sizes[i] == FK_LOST ? reason : FRAMEKIT_NO_ROOM;")
                out.add("bad = is_bad ? bad : i;", "is_bad = true;", "sizes[i] = 0;")
            with out.block("else if (sizes[i] == FK_QUIET)"):
                out.add("quiet = true;")
            with out.block("else if (sizes[i] < 0)"):
                out.add("least = (size_t)-sizes[i] < least ? (size_t)-sizes[i] : least;", "wants = true;")
        out.add("/* the shortest that fits; a bad one is told if none does, the one that got furthest */")
        with out.block("for (;;)"):
            out.add(f"unsigned next = {count};")
            shorter = f"if (sizes[i] > 0 && (next == {count} || sizes[i] < sizes[next]))"
            with out.block(f"for (i = 0; i < {count}; i++)"), out.block(shorter):
                out.add("next = i;")
            out.when(f"next == {count}", "break;")
            out.add(f"{p}_fk_look(parser, next, (size_t)sizes[next]{self.hand_on});")
            self._taken(out, "(size_t)sizes[next]")
            with out.block("if (!is_bad || parser->fault.offset > bad_at)"):
                out.add("bad = next;", "bad_at = parser->fault.offset;", "bad_size = (size_t)sizes[next];")
                out.add("reason = parser->fault.reason;")
            out.add("is_bad = true;", "sizes[next] = 0;")
        out.when("wants && !parser->is_silent", "parser->wanted = parser->size + least;", "return FRAMEKIT_MORE;")
        out.when("!is_bad && quiet && !parser->is_silent", "return FRAMEKIT_MORE;")
        with out.block("if (parser->is_silent && (wants || quiet) && !is_bad)"):
            with out.block(f"for (i = 0; i < {count}; i++)"):
                with out.block("if (sizes[i] == FK_QUIET)"):
                    out.add(f"{p}_fk_look(parser, i, parser->size{self.hand_on});")
                    self._taken(out, "parser->size")
                    out.add(
                        "reason = parser->fault.reason;", "bad_at = parser->fault.offset;", "bad = i;", "is_bad = true;"
                    )
                with out.block("else if (sizes[i] < 0 && !is_bad)"):
                    out.add("bad = i;", "cut = true;")
            out.when("!is_bad && cut", "is_bad = true;", "reason = FRAMEKIT_CUT;", "bad_at = parser->size;")
            out.add("bad_size = parser->size;")
        self._unusable(out)

    def _taken(self, out: CSource, size: str) -> None:
        """Write the return of a frame that fits, or that is to be refused."""
        with out.block("if (parser->fault.reason == FRAMEKIT_OK || parser->fault.refuse >= 0)"):
            out.add(f"parser->told = {size};", "parser->bad_left = 0;")
            if self.rules.delimiter is not None:
                test = f"parser->told > 1 && parser->buffer[parser->told - 1] == {self.rules.delimiter}"
                out.add(f"parser->told -= {test} ? 1 : 0;")
            out.add("return FRAMEKIT_FRAME;")

    def _unusable(self, out: CSource) -> None:
        """Write the handling of a bad frame, and of bytes that belong to no frame."""
        p = self.prefix
        one = "1"
        if self.rules.symbols is not None:
            one = f"(parser->buffer[0] == {self.rules.symbols} && parser->size > 1 ? 2u : 1u)"
        with out.block("if (is_bad && parser->bad_left == 0)"):
            out.add("parser->data = parser->buffer;", "parser->length = bad_size;", "parser->bad_left = bad_size;")
            out.add("parser->frame = (enum " + p + "_frame)0;")
            with out.block("switch (bad)"):
                for place, frame in enumerate(self.frames):
                    out.add(f"case {place}: parser->frame = {self.upper}_FRAME_{identifier(frame.name)}; break;")
                out.add("default: break;")
            out.add("parser->fault.reason = reason;", "parser->fault.offset = bad_at;", "parser->fault.refuse = -1;")
            match self.rules.resync:
                case "never":
                    out.add("parser->told = parser->size;", "parser->is_broken = true;")
                case "after_quiet":
                    out.add("parser->told = parser->size;", "parser->is_skipping = !parser->is_silent;")
                case "after_frame":
                    out.add("parser->told = bad_size;")
                    if self.rules.delimiter is not None:
                        test = f"bad_size > 1 && parser->buffer[bad_size - 1] == {self.rules.delimiter}"
                        out.add(f"parser->told -= {test} ? 1 : 0;")
                case _:
                    out.add(f"parser->told = {one};")
            out.add("return FRAMEKIT_BAD;")
        if self.rules.symbols is not None:
            with out.block(
                f"if (parser->size == 1 && parser->buffer[0] == {self.rules.symbols} && !parser->is_silent)"
            ):
                out.add("return FRAMEKIT_MORE;")
        if self.rules.resync == "never":
            out.add("parser->noise += parser->size;", "parser->is_broken = true;", "continue;")
            return
        out.add(f"parser->noise += parser->bad_left > 0 ? 0 : {one};", f"{p}_fk_drop(parser, {one});")


def line_frames(protocol: Protocol, frames: list[Frame], left: Mapping[str, Any]) -> list[Frame]:
    """Return the frames to search for in a stream: those that a side sends directly; none for an application."""
    every = protocol.frames.values()
    inside = {name for one in every for segment in everything(one.segments) for name in segment.frames_inside}
    if protocol.kind == "application":
        return []
    return [
        one for one in frames if not one.inner and one.name not in inside and one.side in SIDES and one.name not in left
    ]
