"""A guess with the names that people give its fields: with each of them the definition is made anew, checked, and
written, if it has a file.

A name with which the definition would be wrong is refused, and what was there stays as it was.
"""

from __future__ import annotations

from pathlib import Path

from framekit.api.draft import Draft, drafted
from framekit.guess.model import Guess
from framekit.guess.naming import FieldNaming, NamingError, named, overlaps


class NamedGuess:
    """`guess` and `draft` are as they are with all names; `path` is the definition's file, None if it has none."""

    def __init__(self, base: Guess, name: str, source: str, path: Path | None = None) -> None:
        """The file has been written from this very guess. Raises DraftError."""
        self.path = path
        self.source = source
        self.namings: list[FieldNaming] = []
        self.guess = self._base = base
        self.draft = drafted(base, name, source)
        self._troubles = len(self.draft.problems)

    def give(self, naming: FieldNaming) -> None:
        """Names bytes of all frames of a kind; names that they have already go. Raises NamingError."""
        self._use(
            [*(one for one in self.namings if not overlaps(one, naming) and not self._shared(one, naming)), naming]
        )

    def forget(self, kind: str, offset: int) -> None:
        """The bytes there have no name any more. Raises NamingError."""
        own = next((one for one in self.guess.kinds if one.name == kind), None)
        field = next((one for one in own.fields if one.wire and one.offset == offset), None) if own else None
        if field is None:
            raise NamingError("these bytes have no name")
        named_so = (field.offset, field.size, field.name)
        self._use(
            [
                one
                for one in self.namings
                if (one.offset, one.size, one.name) != named_so or (one.kind != kind and field.kind != "copy")
            ]
        )

    def _shared(self, one: FieldNaming, new: FieldNaming) -> bool:
        """Whether an earlier name, given to the other side, is that of these bytes: a reply repeats its request."""
        own = next((kind for kind in self.guess.kinds if kind.name == new.kind), None)
        return own is not None and any(
            (field.name, field.offset, field.size)
            == (one.name, one.offset, one.size)
            == (one.name, new.offset, new.size)
            and field.kind == "copy"
            for field in own.fields
        )

    def _use(self, namings: list[FieldNaming]) -> None:
        guess = named(self._base, namings)
        draft = drafted(guess, self.draft.name, self.source)
        if len(draft.problems) > self._troubles:
            raise NamingError(draft.problems[0])
        if self.path is not None and not draft.problems:
            self._put(self.path, draft)
        self.namings, self.guess, self.draft = namings, guess, draft

    def _put(self, path: Path, draft: Draft) -> None:
        try:
            if path.read_text("utf-8") != self.draft.text:
                raise NamingError(f"{path.name} has been changed since it was written – keep that, and start again")
            draft.put(path)
        except FileNotFoundError:
            raise NamingError(f"{path.name} is gone – start again") from None
        except (OSError, UnicodeDecodeError) as error:
            raise NamingError(f"{path.name} cannot be written: {error}") from None
