"""Write a whole module: header, constants, the functions of every frame and layout, helpers, tables."""

from __future__ import annotations

import inspect
import re
import textwrap
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import islice
from typing import Any

import framekit
import framekit.codec.kinds
from framekit.codec import errors
from framekit.codec.evaluate import start_values
from framekit.codec.python.choices import choice_text, tree_of
from framekit.codec.python.decode import write_decoder, write_pairs
from framekit.codec.python.diagnosis import write_diagnosis
from framekit.codec.python.encode import write_encoder
from framekit.codec.python.flat import (
    NestingLevel,
    inner_frames,
    levels_of,
    rows_of,
    write_builder,
    write_plain_builder,
)
from framekit.codec.python.measure import write_extent, write_measurer
from framekit.codec.python.module import BUILT_IN, Module, inlined_names, used_methods
from framekit.codec.python.reader import not_possible
from framekit.codec.python.runtime_diagnosis import Diagnosis
from framekit.codec.python.source import Source, UniqueNames, identifier, literal, quoted
from framekit.definition.expression import Conditional, Expression, Number
from framekit.definition.kinds.repeat import ITEM_WORDS
from framekit.definition.model.frames import Frame, Layout, everything, names_read
from framekit.definition.model.protocol import Protocol
from framekit.definition.model.segments import Check, Choose, Length, Segment


def default_values(protocol: Protocol, names: Iterable[str]) -> dict[str, Any]:
    """Return the constant start values of the named parameters and variables."""
    known = start_values(protocol)
    return {name: known[name] for name in sorted(names) if name in known and name not in protocol.tables}


MISMATCHES = "MISMATCHES = (ValueError, LookupError, TypeError, ArithmeticError, AttributeError, struct_error)"
"""The line with the errors that functions raise for data that do not fit; `struct_error` is `struct.error`."""

_MADE = "RangeTable("
"""The beginning of tables that need a helper."""
MEASURE_NOTE = """\
`measure_…(data, start, end)` returns the length of the frame at data[start] if it is complete; 0 if no such frame
begins there; -n if at least n more bytes are needed; QUIET if only silence ends the frame; LOST if its end cannot be
found because the bytes are damaged."""
"""The explanation of measuring functions in the docstring of the module."""


def constants(module: Module) -> Source:
    """Return the source of tables, structs and sets, which need no helper."""
    out = Source()
    for name, text in module.tables.values():
        if not text.startswith(_MADE):
            out.add(f"{name}: Mapping[Any, Any] = {text}")
    for text, name in module.structs.items():
        out.add(f"{name} = Struct({quoted(text)})")
    for text, name in module.sets.items():
        out.add(f"{name} = {text}")
    return out


def late_constants(module: Module) -> Source:
    """Return the source of constants that helpers compute."""
    out = Source()
    for name, text in module.tables.values():
        if text.startswith(_MADE):
            out.add(f"{name}: Mapping[Any, Any] = {text}")
    for text, name in module.structs_of_lists.items():
        out.add(f"{name} = {text}")
    for name, (text, about) in module.late.items():
        out.add(f"{name} = {text}", about)
    return out


def helpers(module: Module, methods: set[str]) -> list[Source]:
    """Return the inlined helpers; `methods`: the methods of `Diagnosis` that are used."""
    found = []
    for name in module.functions:
        if name == "Defaults":
            continue
        part = Source()
        only = methods if name.startswith("Diagnosis") else None
        part.lines.extend(module.source_of(name, only).rstrip().splitlines())
        found.append(part)
    return found


def sorted_imports(lines: Iterable[str]) -> list[str]:
    """Return import lines in order, merged by module, except renamed imports."""
    plain = sorted(line for line in lines if line.startswith("import "))
    wanted: dict[str, set[str]] = {}
    for line in lines:
        if line.startswith("from "):
            source, names = line.removeprefix("from ").split(" import ")
            wanted.setdefault(source, set()).update(name.strip() for name in names.split(","))
    found = []
    for source, every in sorted(wanted.items()):
        simple = sorted((name for name in every if " as " not in name), key=lambda name: (name[0].islower(), name))
        found += [f"from {source} import {', '.join(simple)}"] if simple else []
        found += [f"from {source} import {name}" for name in sorted(every) if " as " in name]
    return [*plain, *found]


def normal_protocol(protocol: Protocol) -> Protocol:
    """Return the protocol in normal form: every segment has a name, and segments with blocks have no condition."""
    numbers = iter(range(1, 1 << 30))
    frames = {
        name: replace(
            frame,
            head=_all(frame.head, numbers),
            body=_all(frame.body, numbers),
            tail=_all(frame.tail, numbers),
        )
        for name, frame in protocol.frames.items()
    }
    layouts = {
        name: replace(layout, segments=_all(layout.segments, numbers)) for name, layout in protocol.layouts.items()
    }
    return replace(protocol, frames=frames, layouts=layouts)


def _all(segments: tuple[Segment, ...], numbers: Iterator[int]) -> tuple[Segment, ...]:
    return tuple(_one(segment, numbers) for segment in segments)


def _one(segment: Segment, numbers: Iterator[int]) -> Segment:
    if segment.name is None:
        segment = replace(segment, name=_name(segment, numbers))
    segment = segment.with_lists(lambda inside: _all(inside, numbers))
    return _chosen(segment, numbers) if segment.blocks and segment.when is not None else segment


def _chosen(segment: Segment, numbers: Iterator[int]) -> Segment:
    """Return a conditional segment that holds segments of the frame itself as a choice of two cases."""
    assert segment.when is not None
    root = segment.when.root
    on = Conditional(root.at, root, Number(root.at, 1), Number(root.at, 0))
    return Choose(
        at=segment.at,
        name=_name(segment, numbers),
        on=Expression(f"1 if {segment.when} else 0", on),
        cases=(((1,), (replace(segment, when=None),)),),
        otherwise=(),
    )


def _name(segment: Segment, numbers: Iterator[int]) -> str:
    return f"_{type(segment).__name__.lower()}_n{next(numbers)}"


ENCODER = "encode_outermost"
"""The name of the encoder of the outermost frame."""


class BuilderModules:
    """Write builders of a protocol."""

    def __init__(self, protocol: Protocol) -> None:
        self.protocol = normal_protocol(protocol)

    def source(self, frames: Iterable[str]) -> tuple[str, str]:
        """Return the name of the builder of nested frames, outermost first, and the source of its module."""
        levels = levels_of(self.protocol.frames, frames)
        name = builder_name(level.frame.name for level in levels)
        module = Module(self.protocol, standalone=False)
        builder = write_builder(module, name, ENCODER, levels)
        folds = [module.fold(name, method) for name, method in list(module.folds.values())]
        imports = {"from collections.abc import Mapping", "from struct import error as struct_error"}
        imports |= {"from typing import Any", *module.imports}
        head = Source()
        head.lines += ["from __future__ import annotations", *sorted_imports(imports), "Context = Mapping[str, Any]"]
        head.add(MISMATCHES)
        parts = [head, constants(module), *folds, *helpers(module, set()), late_constants(module), builder]
        return name, "\n".join(part.text() for part in parts)


def builder_name(frames: Iterable[str]) -> str:
    """Return the name of a builder, such as `build_reply_adu_with_read_holding_reply`."""
    return f"build_{'_with_'.join(identifier(frame).strip('_') for frame in frames)}"


_FUNCTIONS = ("encode", "decode", "measure", "diagnose")
"""The functions of every frame; some frames also have `extent_…`."""
MOST_BUILDERS = 100
"""Limit of the builders of a frame; each row of nested frames has a builder."""
_RULE = "-" * 98


def generate_source(protocol: Protocol, standalone: bool = True) -> str:
    """Return the module of a protocol as text.

    A standalone module needs only Python 3.11 or later; others share the error classes of framekit. Raises
    DefinitionError for a frame whose parts cannot be located.
    """
    return ModuleWriter(protocol, standalone).text()


class ModuleWriter:
    """Write a module."""

    def __init__(self, protocol: Protocol, standalone: bool) -> None:
        protocol = normal_protocol(protocol)
        self.protocol = protocol
        self.standalone = standalone
        self.module = Module(protocol, standalone)
        self.helpers = inlined_names()
        self.identifiers: dict[str, str] = {}
        parts = [helper.partition("_") for helper in self.helpers]
        self.names = UniqueNames(name for what, _, name in parts if what in (*_FUNCTIONS, "extent"))
        self.layouts: dict[str, str] = {}
        self.frames_part: list[Source] = []
        self.diagnose_part: list[Source] = []
        self.extents: set[str] = set()
        self.fused: dict[str, tuple[str, int]] = {}
        self.builders: dict[tuple[str, ...], str] = {}
        self.builder_names = UniqueNames(self.helpers)

    def text(self) -> str:
        """Return the source of the module."""
        for name, frame in self.protocol.frames.items():
            self.identifiers[name] = self._identifier(name)
            self._frame(name, frame)
        if self.standalone:  # framekit itself makes builders on demand
            self._builders()
        for name, layout in self.protocol.layouts.items():
            if self._stands_alone(layout):
                self.layouts[name] = self._identifier(f"layout_{name}")
                self._layout(name, layout)
        for name in ("Frame", "Diagnosis", "Defaults"):
            self.module.function(name)
        folds = [self.module.fold(name, method) for name, method in list(self.module.folds.values())]
        tables = self._tables()
        helpers = self._helpers()
        parts = self._section("frames", self.frames_part)
        parts += self._section("faults of frames that do not fit", self.diagnose_part)
        parts += self._section("check codes", folds) if folds else []
        parts += self._section("helpers", helpers)
        parts += self._section("tables", [tables])
        head = self._header()
        head.add("")
        head.extend(self._constants(aliases_used("".join(part.text() for part in parts))))
        parts.insert(0, head)
        return "\n\n".join(part.text().rstrip("\n") + "\n" for part in parts)

    def _identifier(self, name: str) -> str:
        return self.names.take(identifier(name).strip("_"))

    # ---- frames and layouts -------------------------------------------------------------------------------

    def _frame(self, name: str, frame: Frame) -> None:
        known, segments = self.identifiers[name], self.module.static.segments(frame)
        refuse_vague_checks(segments)
        self.frames_part.append(write_encoder(self.module, known, name, segments, frame))
        pairs, fused = write_pairs(self.module, known, frame)
        if fused is not None:
            self.fused[name] = fused
        self.frames_part.extend(pairs)
        self.frames_part.append(write_decoder(self.module, known, name, segments, frame, fused))
        before = len(self.module.extra)
        self.frames_part.append(write_measurer(self.module, known, frame, segments))
        self.frames_part.extend(self.module.extra[before:])
        extent = write_extent(self.module, known, frame, segments)
        if extent is not None:
            self.extents.add(known)
            self.frames_part.append(extent)
        self.diagnose_part.append(write_diagnosis(self.module, known, name, segments, frame))

    def _builders(self) -> None:
        """Write builders of the frames that stand in no other frame, for each row of frames inside them."""
        inside = {name for frame in self.protocol.frames.values() for name in inner_frames(frame)}
        for name in self.protocol.frames:
            if name not in inside:
                for levels in islice(rows_of(self.protocol.frames, name), MOST_BUILDERS):
                    self._builder(levels)

    def _builder(self, levels: tuple[NestingLevel, ...]) -> None:
        frames = tuple(level.frame.name for level in levels)
        found = self.builder_names.take(builder_name(frames))
        encoder, context = f"encode_{self.identifiers[frames[0]]}", "ctx: Context = DEFAULTS"
        builder = write_plain_builder(self.module, found, encoder, levels, context)
        if builder is not None:
            self.builders[frames] = found
            self.frames_part.append(builder)

    def _layout(self, name: str, layout: Layout) -> None:
        known, segments = self.layouts[name], layout.segments
        refuse_vague_checks(segments)
        self.frames_part.append(write_encoder(self.module, known, name, segments, None))
        self.frames_part.append(write_decoder(self.module, known, name, segments, None))
        self.diagnose_part.append(write_diagnosis(self.module, known, name, segments, None))

    def _stands_alone(self, layout: Layout) -> bool:
        """Return whether a layout reads only names of its own and of the protocol."""
        segments = layout.segments
        if not segments:
            return False
        own = {segment.name for segment in everything(segments)}
        own |= {name for segment in everything(segments) for name in segment.value_names}
        for segment in everything(segments):
            if isinstance(segment, Check) and {*segment.names, *segment.edges} - own:
                return False
            if isinstance(segment, Length) and set(segment.of) - own:
                return False
        known = {*self.protocol.params, *self.protocol.state, *self.protocol.tables}
        known |= BUILT_IN | set(ITEM_WORDS.values())
        return not names_read(segments) - own - known

    # ---- parts of the text --------------------------------------------------------------------------------

    def _section(self, title: str, parts: Iterable[Source]) -> list[Source]:
        head = Source()
        head.comment(_RULE)
        head.comment(title)
        return [head, *parts]

    def _header(self) -> Source:
        protocol, out = self.protocol, Source()
        lines = [f"Frames of {protocol.name}: build, read, and find them in a stream of bytes."]
        if protocol.about:
            lines += ["", *textwrap.wrap(protocol.about, 110)]
        sources = (
            ", ".join(source.replace("\\", "/").rsplit("/", 1)[-1] for source in protocol.sources) or protocol.name
        )
        made = f"Generated by framekit {framekit.__version__} from {sources}; change those and generate it again."
        lines += ["", *textwrap.wrap(made, 110), "", *self._usage(), "", *MEASURE_NOTE.splitlines()]
        out.docstring(*lines)
        out.add()
        imports = {
            "from collections.abc import Mapping",
            "from struct import error as struct_error",
            "from typing import Any",
        }
        imports |= self.module.imports
        out.lines += ["from __future__ import annotations", "", *sorted_imports(imports)]
        if not self.standalone:
            out.lines += ["", "from framekit.codec.errors import EncodeError, FrameError, Misread"]
        return out

    def _usage(self) -> list[str]:
        name = next(iter(self.identifiers), None)
        if name is None:
            return ["It has no frames."]
        known = self.identifiers[name]
        builder = next(iter(self.builders.values()), None)
        built = [] if builder is None else [f"    data = {builder}(…)  # bytes of named values"]
        return [
            "Use it like this (`ctx`: parameters and state that frames depend on; default: DEFAULTS):",
            "",
            f"    data = encode_{known}(values)      # bytes; raises EncodeError",
            *built,
            f"    values = decode_{known}(data)      # a dict; raises FrameError",
            f"    FRAMES[{quoted(name)}].decode(data)".ljust(len(f"    values = decode_{known}(data)      "))
            + "# the same by the definition's name",
        ]

    def _constants(self, aliases: list[str]) -> Source:
        out = Source()
        for alias in aliases:
            out.add(alias)
        out.add("QUIET = -(1 << 40)")
        out.add("LOST = QUIET - 1")
        out.add("")
        if self.standalone:
            for error in (errors.FrameError, errors.Misread, errors.EncodeError):
                out.lines += ["", *inspect.getsource(error).rstrip().splitlines(), ""]
        out.lines += ["", *self.module.source_of("Defaults").rstrip().splitlines(), "", ""]
        values = default_values(self.protocol, self.module.context)
        out.add(f"DEFAULTS = Defaults({literal(values) if values else ''})")
        if self.module.context - set(values):
            others = ", ".join(sorted(self.module.context - set(values)))
            out.comment(f"Frames also depend on {others}, which ctx must hold.")
        out.extend(constants(self.module))
        return out

    def _helpers(self) -> list[Source]:
        calls = "".join(part.text() for part in self.diagnose_part)
        return helpers(self.module, used_methods((Diagnosis,), calls))

    def _tables(self) -> Source:
        out = Source()
        out.add(MISMATCHES)
        if "Diagnosis" in self.module.functions:
            out.add("EVALUATION_ERRORS = (ValueError, LookupError, TypeError, ArithmeticError, AttributeError)")
        out.extend(late_constants(self.module))
        for name, text in self.module.rule_tables.items():
            out.add(f"{name}: Rules = {text}")
        out.add("FRAMES: dict[str, Frame] = {")
        for name, known in self.identifiers.items():
            functions = ", ".join(f"{what}_{known}" for what in _FUNCTIONS)
            refuse = self.protocol.frames[name].refuse
            more = "" if refuse is None else f", refuse={refuse:#x}"
            more += f", extent=extent_{known}" if known in self.extents else ""
            out.depth = 1
            out.add(f"{quoted(name)}: Frame({quoted(name)}, {functions}{more}),")
            out.depth = 0
        out.add("}")
        layouts = ", ".join(f"{quoted(name)}: (encode_{known}, decode_{known})" for name, known in self.layouts.items())
        out.add(f"LAYOUTS: dict[str, tuple[Callable[..., bytes], Callable[..., dict[str, Any]]]] = {{{layouts}}}")
        for frames, name in self.module.choices.items():
            out.add(f"{name} = {choice_text(tree_of(self.module.static, frames))}")
        for name, text in self.module.fused_tables.items():
            out.add(f"{name} = {text}")
        if not self.standalone:
            fused = ", ".join(f"{quoted(name)}: ({at}, {table})" for name, (table, at) in self.fused.items())
            out.add(f"FUSED: dict[str, tuple[int, list[Any]]] = {{{fused}}}")
        return out


def refuse_vague_checks(segments: tuple[Segment, ...]) -> None:
    """Raise DefinitionError for a check over 'everything before' in a list, or in a record that may be absent.

    'Everything before' could mean the list or record there, or the frame.
    """
    for holder in everything(segments):
        if holder.is_list:
            _refuse_vague(holder.inner_record or (), "a list")
        elif holder.is_record and holder.when is not None:
            _refuse_vague(holder.members, "a record under a condition")
        for case in holder.blocks if holder.has_cases else ():
            for record in everything(case):
                if record.is_record:
                    _refuse_vague(record.members, "a record of a case")


def _refuse_vague(segments: tuple[Segment, ...], where: str) -> None:
    for check in everything(segments):
        if isinstance(check, Check) and check.covers is None:
            raise not_possible(check, f"a check in {where} has to say what it covers", "name it in over:")


_ALIASES = {
    "Ask": "Callable[[Any], Any]",
    "Context": "Mapping[str, Any]",
    "Reads": "Callable[..., dict[str, Any]]",
    "Opened": "tuple[bytes, Sequence[int], *tuple[str, ...]]",
    "Rules": "Mapping[str, Any]",
    "Span": "tuple[str, int, int, Any]",
}


def aliases_used(text: str) -> list[str]:
    """Return the lines that define the type aliases used in a module's source."""
    used = {*re.findall(rf"\b(?:{'|'.join(_ALIASES)})\b", text)}
    return [f"{name} = {meaning}" for name, meaning in _ALIASES.items() if name in used]
