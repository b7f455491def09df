"""Compile the model of a protocol to constructs: one for every frame and every layout, and a codec of them."""

from __future__ import annotations

from construct import Container

from construct_oracle.base import SegmentConstruct, named_segments, value_names
from construct_oracle.check_codes import CheckConstruct
from construct_oracle.codec import ConstructCodec
from construct_oracle.counts import CountConstruct, LengthConstruct
from construct_oracle.fields import BitsConstruct, FieldConstruct
from construct_oracle.filling import Condition, Filling, Part, Plan
from construct_oracle.frame import FrameConstruct
from construct_oracle.holders import (
    ChooseConstruct,
    Fields,
    ItemEndConstruct,
    OptionalConstruct,
    RecordConstruct,
    RepeatConstruct,
    Segments,
)
from construct_oracle.inner import InnerConstruct, NestedConstruct
from construct_oracle.names import Names
from construct_oracle.pieces import (
    ConstantConstruct,
    DataConstruct,
    DerivedConstruct,
    RequireConstruct,
    SkipConstruct,
)
from construct_oracle.regions import CodedConstruct, EscapeConstruct, HexConstruct
from construct_oracle.sizes import KnownSizes
from framekit.codec.evaluate import start_values
from framekit.definition.codings import Hex
from framekit.definition.model import segments as model
from framekit.definition.model.frames import Frame, Layout
from framekit.definition.model.protocol import Protocol

_PLAIN: dict[type[model.Segment], type[SegmentConstruct]] = {
    model.Const: ConstantConstruct,
    model.Field: FieldConstruct,
    model.Bits: BitsConstruct,
    model.Data: DataConstruct,
    model.Length: LengthConstruct,
    model.Count: CountConstruct,
    model.Skip: SkipConstruct,
    model.Value: DerivedConstruct,
    model.Require: RequireConstruct,
    model.Check: CheckConstruct,
    model.ItemEnd: ItemEndConstruct,
}


def compile_construct(protocol: Protocol) -> ConstructCodec:
    """Return constructs for all frames and layouts of the protocol."""
    compiler = _Compiler(protocol)
    for frame in protocol.frames.values():
        compiler.frames[frame.name] = compiler.frame(frame)
    layouts = {layout.name: compiler.frame(_as_frame(layout)) for layout in protocol.layouts.values()}
    return ConstructCodec(compiler.frames, layouts)


def _as_frame(layout: Layout) -> Frame:
    return Frame(
        name=layout.name,
        at=layout.at,
        groups=(),
        side="none",
        head=(),
        body=layout.segments,
        tail=(),
        inner=True,
        echo={},
        announces={},
    )


class _Compiler:
    def __init__(self, protocol: Protocol) -> None:
        self.models = protocol.frames
        self.sizes = KnownSizes(protocol.frames)
        self.known = start_values(protocol)
        self.frames: dict[str, FrameConstruct] = {}

    def frame(self, frame: Frame) -> FrameConstruct:
        plan = Plan()
        sections = tuple(self.list(segments, plan, ()) for segments in (frame.head, frame.body, frame.tail))
        return FrameConstruct(frame, (sections[0], sections[1], sections[2]), plan, self.sizes, self.known)

    def list(self, segments: tuple[model.Segment, ...], plan: Plan, conditions: tuple[Condition, ...]) -> Segments:
        """Return constructs of segments that belong to the record of `plan` while `conditions` are true."""
        return Segments(tuple(self.segment(segment, plan, conditions) for segment in segments))

    def segment(self, segment: model.Segment, plan: Plan, conditions: tuple[Condition, ...]) -> SegmentConstruct:
        construct = self._holder(segment, plan, conditions)
        part = Part(construct, conditions, None if segment.when is None else construct.holds)
        if segment.name is not None:
            plan.segments.setdefault(segment.name, []).append(part)
        for name in value_names(segment):
            plan.values.setdefault(name, []).append(part)
        return construct

    def _holder(self, segment: model.Segment, plan: Plan, conditions: tuple[Condition, ...]) -> SegmentConstruct:
        """Return the construct of a segment that contains segments, with the constructs of these."""
        match segment:
            case model.Repeat(of=model.FieldType()):
                return RepeatConstruct(segment, None)
            case model.Repeat(of=of):
                assert isinstance(of, tuple)
                return RepeatConstruct(segment, self._fields(of))
            case model.Record():
                return RecordConstruct(segment, self._fields(segment.of))
            case model.Choose():
                return self._choose(segment, plan, conditions)
            case model.Optional():
                return self._optional(segment, plan, conditions)
            case model.Wrap():
                return self._wrap(segment, plan, conditions)
            case model.Nested():
                return NestedConstruct(segment, self.frames)
            case model.Inner():
                return InnerConstruct(segment, self.frames, self.models)
        return _PLAIN[type(segment)](segment)

    def _fields(self, segments: tuple[model.Segment, ...]) -> Fields:
        plan = Plan()
        return Fields(self.list(segments, plan, ()), plan)

    def _choose(self, segment: model.Choose, plan: Plan, conditions: tuple[Condition, ...]) -> SegmentConstruct:
        def case(of: tuple[model.Segment, ...]) -> Segments:
            def is_chosen(filling: Filling) -> bool:
                return construct.holds(filling) and construct.chosen(filling) is segments

            segments = self.list(of, plan, (*conditions, is_chosen))
            return segments

        cases = tuple(case(of) for _, of in segment.cases)
        construct = ChooseConstruct(segment, cases, None if segment.otherwise is None else case(segment.otherwise))
        return construct

    def _optional(self, segment: model.Optional, plan: Plan, conditions: tuple[Condition, ...]) -> SegmentConstruct:
        def is_there(filling: Filling) -> bool:
            return construct.holds(filling) and construct.is_wanted(filling)

        segments = self.list(segment.of, plan, (*conditions, is_there))
        names = tuple(name for part in named_segments(segment.of) for name in value_names(part))
        construct = OptionalConstruct(segment, segments, names)
        return construct

    def _wrap(self, segment: model.Wrap, plan: Plan, conditions: tuple[Condition, ...]) -> SegmentConstruct:
        def is_there(filling: Filling) -> bool:
            return construct.holds(filling)

        segments = self.list(segment.of, plan, (*conditions, is_there))
        construct: SegmentConstruct
        if isinstance(segment.coding, Hex) and segment.size is None:
            construct = HexConstruct(segment, segments)
        elif segment.escape is None:
            construct = CodedConstruct(segment, segments)
        else:
            construct = EscapeConstruct(segment, segments, lambda data, names: self._embedded(segment, data, names))
        return construct

    def _embedded(self, wrap: model.Wrap, data: bytes, names: Names) -> int | None:
        """Return the size of the frame at the start of `data`, if it is a frame allowed inside the wrap."""
        for name in wrap.inside:
            outcome = self.frames[name].read(data, names, Container(), name, exact=False)
            if outcome.fault is None:
                return outcome.size
        return None
