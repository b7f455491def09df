"""Where text may be read and written: not in elements that have a form of their own."""

from __future__ import annotations

import pytest

import framekit
from framekit.api.errors import RequestError
from framekit.api.typed import typed
from framekit.codec.codec import compile_protocol
from framekit.link.service_rows import ServiceRows


def test_text_does_not_go_into_structures() -> None:
    protocol = framekit.load("df1").definition
    grammar = ServiceRows(protocol, compile_protocol(protocol)).grammar
    assert typed(grammar, "N7:0", "string", None, 5).units == 3
    with pytest.raises(RequestError, match="ST9:0 is an element of 84 bytes with a form of its own"):
        typed(grammar, "ST9:0", "string", None, 5)
