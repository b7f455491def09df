"""Frames of which one stands somewhere, as generated modules carry them with them: pasted as those of `runtime` are.

Which frames these are, and by which byte they are told apart, is written by the generator.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from framekit.codec.errors import EncodeError, FrameError
from framekit.codec.python.runtime import LOST, QUIET, Context


class Frame(NamedTuple):
    """One frame's functions. `refuse`: the code it is always refused with; `extent`: None where it is `measure`."""

    name: str
    encode: Callable[..., bytes]
    decode: Callable[..., dict[str, Any]]
    measure: Callable[..., int]
    examine: Callable[..., Any]
    refuse: int | None = None
    extent: Callable[..., int] | None = None


class Choice:
    """Frames that may stand at one place, in the order they are tried, told apart by one byte.

    `named` holds them by name, `encoders` what builds them. `readers`: by the deciding byte, names with decoders in the
    order they are tried, or another choice; `all_readers`: those for when that byte is not there. `likely`: by the
    deciding byte, the first name and decoder where it leaves one or two; `sole`: how long the only frame is that it
    allows, None where there are several.
    """

    __slots__ = (
        "all_readers", "at", "cases", "encoders", "everything", "likely", "named", "others", "readers", "sole",
    )  # fmt: skip

    def __init__(self, everything: tuple[Frame, ...], at: int = 0, cases: Any = None, others: Any = None) -> None:
        self.everything = everything
        self.at = at
        self.cases: dict[int, Any] = cases or {}
        self.others: Any = everything if others is None else others
        self.named = {frame.name: frame for frame in everything}
        self.encoders = {frame.name: frame.encode for frame in everything}
        self.all_readers = readers_of(everything)
        self.readers = [readers_of(self.others)] * 256
        self.sole = [measure_of(self.others)] * 256
        for byte, found in self.cases.items():
            self.readers[byte] = readers_of(found)
            self.sole[byte] = measure_of(found)
        self.likely = [found[0] if type(found) is tuple and 1 <= len(found) <= 2 else None for found in self.readers]

    def frames(self, data: bytes | bytearray, start: int = 0, end: int | None = None) -> tuple[Frame, ...]:
        """The frames that the deciding byte allows; all, if it is not there."""
        place = start + self.at
        if place >= (len(data) if end is None else end):
            return self.everything
        found = self.cases.get(data[place], self.others)
        return found if type(found) is tuple else found.frames(data, start, end)


def readers_of(found: Any) -> Any:
    """Names and decoders of a row of frames; a choice stays what it is."""
    return tuple((frame.name, frame.decode) for frame in found) if type(found) is tuple else found


def measure_of(found: Any) -> Any:
    """What measures a row of frames if it is one or none."""
    if found == ():
        return no_frame
    return found[0].measure if type(found) is tuple and len(found) == 1 else None


def no_frame(data: bytes | bytearray, start: int, end: int, ctx: Context, seen: int = 0) -> int:
    """What measures where no frame may stand."""
    return 0


def readers_at_once(choice: Choice, readers: dict[str, Any]) -> list[Any]:
    """By the deciding byte: what reads the frame that is likely together with the one around it; None: nothing does."""
    return [None if one is None else readers.get(one[0]) for one in choice.likely]


def decode_first(choice: Choice, data: bytes, ctx: Context) -> dict[str, Any]:
    """The first frame that fits, as `{name: fields}`. Raises FrameError if that frame is to be refused."""
    try:
        found = choice.readers[data[choice.at]]
        while type(found) is Choice:
            choice = found
            found = choice.readers[data[choice.at]]
    except IndexError:
        found = choice.all_readers
    for name, decode in found:
        try:
            return {name: decode(data, ctx)}
        except FrameError as error:
            if error.refuse is not None:
                raise
    return {"unknown": {"data": data}}


def measure_first(
    choice: Choice, data: bytes | bytearray, start: int, end: int, ctx: Context, seen: int = 0, whole: bool = False
) -> int:
    """How long the frame is that stands here: the first that fits, else what is wanted at least.

    While one wants more, none behind it is taken: how the bytes come makes no difference. `whole`: no more come.
    """
    want, quiet, lost = 0, False, False
    for frame in choice.frames(data, start, end):
        size = frame.measure(data, start, end, ctx, seen)
        if size > 0:
            if (whole or not want) and fits(frame, bytes(data[start : start + size]), ctx):
                return size
        elif size > QUIET:
            if size:
                want = max(want, size) if want else size
        else:
            quiet, lost = quiet or size == QUIET, lost or size == LOST
    return want or (QUIET if quiet else LOST if lost else 0)


def extent_first(choice: Choice, data: bytes | bytearray, start: int, end: int, ctx: Context, seen: int = 0) -> int:
    """What `measure_first` says if a frame fits that is complete: none is read for that."""
    place = start + choice.at
    measure = choice.sole[data[place]] if place < end else None
    if measure is not None:
        size: int = measure(data, start, end, ctx, seen)
        return size
    want, quiet, lost = 0, False, False
    for frame in choice.frames(data, start, end):
        size = frame.measure(data, start, end, ctx, seen)
        if size > 0:
            if not want:
                return size
        elif size > QUIET:
            if size:
                want = max(want, size) if want else size
        else:
            quiet, lost = quiet or size == QUIET, lost or size == LOST
    return want or (QUIET if quiet else LOST if lost else 0)


def fits(frame: Frame, data: bytes, ctx: Context) -> bool:
    """Whether the bytes are this frame, good or to be refused."""
    try:
        frame.decode(data, ctx)
    except FrameError as error:
        return error.refuse is not None
    return True


def encode_one(choice: Choice, value: Any, name: str, ctx: Context) -> bytes:
    """The bytes of `{frame: fields}`. Raises EncodeError."""
    # a dict is by far the most frequent, and asking whether something is a Mapping costs as much as the rest
    one = (type(value) is dict or isinstance(value, Mapping)) and len(value) == 1
    ((wanted, fields),) = value.items() if one else (("", None),)
    if type(fields) is not dict and not isinstance(fields, Mapping):
        raise EncodeError(name, f"'{name}' must be one frame as {{name: fields}}")
    frame = choice.named.get(wanted)
    if frame is not None:
        try:
            return frame.encode(fields, ctx)
        except EncodeError as error:
            path = f"{name}.{wanted}."
            more = tuple(path + one for one in error.more)
            raise EncodeError(path + error.field if error.field else name, str(error), more) from None
    if wanted == "unknown":
        return bytes(b"" + fields["data"])
    raise EncodeError(name, f"'{name}' cannot be a '{wanted}'")


NEEDS: dict[str, tuple[str, ...]] = {
    "decode_first": ("Choice", "Frame"),
    "measure_first": ("Choice", "Frame", "fits"),
    "extent_first": ("measure_first",),
    "fits": ("Frame",),
    "encode_one": ("Choice", "Frame"),
    "Choice": ("Frame", "measure_of", "no_frame", "readers_of"),
    "readers_at_once": ("Choice",),
}
"""The names of this module that a helper uses itself."""

IMPORTS: dict[str, tuple[str, ...]] = {
    "Frame": ("from collections.abc import Callable", "from typing import NamedTuple"),
}
"""The import lines that a helper's source stands on."""
