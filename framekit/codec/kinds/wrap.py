"""`wrap`: a region that is converted as a whole."""

from __future__ import annotations

from framekit.codec.kinds.base import SegmentKind
from framekit.codec.python.diagnosis import Behind, DiagnosisWriter, checks_option
from framekit.codec.python.expressions import Scope
from framekit.codec.python.source import quoted
from framekit.definition.expression.emit import BIT_OR
from framekit.definition.model.segments import (
    Wrap,
)


class WrapKind(SegmentKind[Wrap]):
    model = Wrap

    def diagnose(self, d: DiagnosisWriter, segment: Wrap, scope: Scope, behind: Behind) -> None:
        fixed = d.shapes.all(segment.of).fixed
        option = ""
        if segment.how == "hex":
            open_up = d.module.function("hex_content")
            size = "None" if fixed is None else str(2 * fixed)
            option = d.behind_option(fixed is None, behind)
        else:
            escape = f"{segment.escape or 0:#04x}"
            open_up = f"lambda raw: {d.module.function('doubled_content')}(raw, {escape})"
            size = "None"
            inside = d.module.embedded(segment)
            if inside:
                open_up = f"lambda raw: {d.module.function('doubled_content')}(raw, {escape}, {inside})"
            if fixed is not None:
                size = f"lambda n: {d.module.function('end_of_doubled')}(n.data, n.at, {escape}, {fixed}) - n.at"
            elif any(d.shapes.present(one).fixed != 0 for one, _ in behind):
                more = f", {inside}" if inside else ""
                size = f"lambda n: {d.module.function('end_of_region')}(n.data, n.at, {escape}{more}) - n.at"
        option += checks_option(segment.of)
        with d.out.block(f"with n.inside({d.named(segment)}, {size}, {open_up}{option}):"):
            _diagnose_limits(d, segment, scope)
            outside, d.deferred = d.deferred, []
            d.region(segment.of, scope)
            d.deferred = outside


def _diagnose_limits(d: DiagnosisWriter, wrap: Wrap, scope: Scope) -> None:
    refuse = d.refuse(wrap)
    if wrap.least:
        rule = f'"short", {d.named(wrap)}, 0, {quoted(f"at least {wrap.least} bytes")}'
        d.out.add(f"n.expect({rule}, lambda n: n.end >= {wrap.least}{refuse})")
    if wrap.most is not None:
        most = str(wrap.most) if isinstance(wrap.most, int) else d.writer(scope).text(wrap.most, BIT_OR)
        rule = f'"too_long", {d.named(wrap)}, 0, "fewer bytes"'
        d.out.add(f"n.expect({rule}, lambda n: n.end <= {most}{refuse})")
