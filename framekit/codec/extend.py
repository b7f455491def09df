"""What programs bring by themselves: types of fields and check methods. Kinds of segments: `codec.kinds.register`.

Functions given here stand in a module of the program. Generated code carries them with it as they stand there, with the
functions and classes of the module that they use, and its imports; they use no constant of the module.
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
    """A word that `type:` may have from now on: a whole number from `least` to `most`, of so many bytes.

    `parse` makes the number of the bytes, `build` the bytes of a number and the size. Raises ValueError for a word that
    another module has.
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
    """A check method of that name, for `check:` and for `method:` of the section `checks`: a code of `width` bits.

    `function` makes the code of the bytes; complement and mask are put on what it gives. Raises ValueError for a word
    that another module has, and for a width that is not possible.
    """
    module = module_of_function(function)
    add_method(CheckMethod(name=word, kind=word, width=width), module)
    add_helpers(bring(module))
    checks.add_function(word, function)
