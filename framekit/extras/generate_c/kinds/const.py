"""Write `const`, `skip` and `fill` in C: bytes without a value."""

from __future__ import annotations

from framekit.codec.python.measure import Finished
from framekit.definition.model.segments import Const, Fill, Skip
from framekit.definition.problems import CannotSayError
from framekit.extras.generate_c.expressions import CScope
from framekit.extras.generate_c.functions import CKind
from framekit.extras.generate_c.measure import CMeasureWriter, Pairs
from framekit.extras.generate_c.reader import Behind, Here, ReadWriter
from framekit.extras.generate_c.source import string
from framekit.extras.generate_c.writer import Taken, WriteWriter

# ---- read -----------------------------------------------------------------------------------------------------


def _read_const(r: ReadWriter, segment: Const, here: Here, behind: Behind) -> None:
    helper = r.file.helper("constant")
    call = f"{helper}({r.n}, {string(segment.data)}, {len(segment.data)}, {r.refuse(segment)})"
    r.when(f"!{call}", r.leave())
    r.stands(segment.path)


def _read_skip(r: ReadWriter, segment: Skip, here: Here, behind: Behind) -> None:
    r.begin()
    r.take(str(segment.size))
    r.stands(segment.path)


def _read_fill(r: ReadWriter, segment: Fill, here: Here, behind: Behind) -> None:
    r.begin()
    r.take(r.rest(behind))
    r.stands(segment.path)
    r.when(f"{r.inn}.end < {segment.total}", r.note("short", f"{r.inn}.end"))
    r.when(f"{r.inn}.end > {segment.total}", r.note("surplus", str(segment.total)))


# ---- built ----------------------------------------------------------------------------------------------------


def _put_const(w: WriteWriter, segment: Const, taken: Taken) -> None:
    w.add(f"{w.file.helper('put_bytes')}({w.n}, {string(segment.data)}, {len(segment.data)});")


def _put_skip(w: WriteWriter, segment: Skip, taken: Taken) -> None:
    helper = w.file.helper("put_fill")
    w.add(f"{helper}({w.n}, {string(segment.fill)}, {len(segment.fill)}, {segment.size});")


def _put_fill(w: WriteWriter, segment: Fill, taken: Taken) -> None:
    behind = 0
    order = list(w.segments)
    for one in order[order.index(segment) + 1 :]:
        size = w.static.present(one).fixed or 0
        if one.when is not None and size:
            raise CannotSayError(one.at, "what fills a frame up, before a part that may be absent")
        behind += size
    room = f"{segment.total - behind} - (int64_t){w.inn}.at"
    w.fail_if(f"{room} < 0", "too_long")
    helper = w.file.helper("put_fill")
    w.add(f"{helper}({w.n}, {string(bytes((segment.byte,)))}, 1, {room} < 0 ? 0 : {room});")


# ---- measured -------------------------------------------------------------------------------------------------


def _measure_fill(m: CMeasureWriter, segment: Fill, scope: CScope, after: Pairs) -> None:
    m.place = segment.total
    m.return_total()
    raise Finished


KINDS = (
    CKind(Const, read=_read_const, put=_put_const),
    CKind(Skip, read=_read_skip, put=_put_skip),
    CKind(Fill, read=_read_fill, put=_put_fill, measure=_measure_fill),
)
