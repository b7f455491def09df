"""A module of one builder, for protocols whose module is loaded already.

Made when somebody asks for the builder, so that loading a protocol costs nothing for it. The names that the module
finds where it runs: `ctx`, `EncodeError`, and the encoder of the outermost frame.
"""

from __future__ import annotations

from collections.abc import Iterable

from framekit.codec.python.flat import write_builder
from framekit.codec.python.module import Module
from framekit.codec.python.module_text import MISFITS, constants, helpers, late_constants, sorted_imports
from framekit.codec.python.names import identifier
from framekit.codec.python.normal import normal_protocol
from framekit.codec.python.parameters import levels_of
from framekit.codec.python.source import Source
from framekit.definition.model.protocol import Protocol

ENCODER = "encode_outermost"
"""What the encoder of the outermost frame is called."""


class BuilderModules:
    """Writes builders of one protocol."""

    def __init__(self, protocol: Protocol) -> None:
        self.protocol = normal_protocol(protocol)

    def source(self, frames: Iterable[str]) -> tuple[str, str]:
        """The name of the builder of these frames, each inside the one before it, and the text of its module."""
        levels = levels_of(self.protocol.frames, frames)
        name = builder_name(level.frame.name for level in levels)
        module = Module(self.protocol, standalone=False)
        builder = write_builder(module, name, ENCODER, levels)
        folds = [module.fold(name, method) for name, method in list(module.folds.values())]
        imports = {"from collections.abc import Mapping", "from struct import error as struct_error"}
        imports |= {"from typing import Any", *module.imports}
        head = Source()
        head.lines += ["from __future__ import annotations", *sorted_imports(imports), "Context = Mapping[str, Any]"]
        head.add(MISFITS)
        parts = [head, constants(module), *folds, *helpers(module, set()), late_constants(module), builder]
        return name, "\n".join(part.text() for part in parts)


def builder_name(frames: Iterable[str]) -> str:
    """`build_reply_adu_with_read_holding_reply`."""
    return f"build_{'_with_'.join(identifier(frame).strip('_') for frame in frames)}"
