"""Add field types and check methods of a program. Kinds of segments: `codec.kinds.register`.

The functions given here belong to a module of the program. Generated code contains a copy of them, of the functions and
classes of their module that they use, and of its imports; they may use no constants of the module.
"""

from __future__ import annotations

from collections.abc import Callable

from framekit.codec import checks
from framekit.codec.python import forms
from framekit.codec.python.module import add_helpers
from framekit.definition.brought import bring, bring_word, module_of_function
from framekit.definition.model.checks import CheckMethod, add_method
from framekit.definition.schema import add_word
from framekit.definition.wire_types import TYPE_KINDS, TYPES, FieldType, TypeKind


def add_type(
    word: str,
    size: int,
    parse: Callable[[bytes], int],
    build: Callable[[int, int], bytes],
    *,
    least: int = 0,
    most: int,
) -> None:
    """Register a field type: a whole number from `least` to `most` in `size` bytes.

    `parse` converts the bytes to the number; `build` converts the number and the size to the bytes. Raises ValueError
    for a word that another module has registered.
    """
    modules = [module_of_function(one) for one in (parse, build)]
    bring_word("type", word, modules[0], word in TYPES or word in TYPE_KINDS)
    for module in modules:
        add_helpers(bring(module))
    TYPE_KINDS[word] = TypeKind("number", True, lambda type_, size: (least, most))
    TYPES[word] = lambda given: FieldType(word, size)
    forms.WIRE_FORMS[word] = forms.WireForm(
        lambda functions, type_, raw: f"{functions.function(parse)}({raw})",
        lambda functions, type_, wire, size: f"{functions.function(build)}({wire}, {size})",
    )
    add_word("common", "type_name", word)


def add_check(word: str, function: Callable[[bytes], int], *, width: int = 8) -> None:
    """Register a check method for `check:` and for `method:` in the section `checks`: a code of `width` bits.

    `function` computes the code of the bytes; complement and mask are applied to its result. Raises ValueError for a
    word that another module has registered, and for an invalid width.
    """
    module = module_of_function(function)
    add_method(CheckMethod(name=word, kind=word, width=width), module)
    add_helpers(bring(module))
    checks.add_function(word, function)
