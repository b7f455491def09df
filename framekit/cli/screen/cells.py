"""What stands in the cells of the live display: texts made of statuses, frames and fields, and the filter's syntax."""

from __future__ import annotations

from typing import TYPE_CHECKING

from framekit.cli.seen_output import shown_bytes, what_was_seen
from framekit.cli.status_output import block_row
from framekit.service.frame_log import FAULTY, FrameFilter

if TYPE_CHECKING:
    from framekit.blocks.block_status import BlockStatus
    from framekit.service.frame_log import FieldRow, FrameEntry
    from framekit.service.live_view import ChannelView, LiveView

FRAME_HEAD = ("no.", "time", "ch", "", "size", "result", "frame", "bytes")
FIELD_HEAD = ("field", "offset", "bytes", "value")
LONGEST = 48
BAR = 20


def frame_cells(view: LiveView, entry: FrameEntry, as_ascii: bool) -> tuple[str, ...]:
    """One thing seen; a bad one is marked."""
    seen = entry.seen
    arrow = {"in": "←", "out": "→"}.get(seen.direction, "")
    mark = "! " if seen.kind in FAULTY else ""
    size = str(len(seen.raw)) if seen.raw else ""
    return (
        str(entry.number), f"{view.seconds(seen.at):.3f}", str(entry.channel), arrow, size, entry.result,
        mark + what_was_seen(seen), shown_bytes(seen.raw, as_ascii, LONGEST),
    )  # fmt: skip


def field_cells(row: FieldRow, as_ascii: bool) -> tuple[str, ...]:
    return row.path, str(row.offset), shown_bytes(row.data, as_ascii, LONGEST), row.value


def block_cells(block: BlockStatus) -> tuple[str, ...]:
    return block_row(block)


def channel_line(channel: ChannelView) -> str:
    """`ch 1 PROTOCOL client, open  ████····  31.0 % (average 12.4 %)`."""
    start = f"ch {channel.number} {channel.name}, {channel.state}"
    if channel.load_now is None or channel.load is None:
        return start
    full = min(BAR, round(BAR * channel.load_now))
    bar = "█" * full + "·" * (BAR - full)
    return f"{start}  {bar} {100 * channel.load_now:5.1f} % (average {100 * channel.load:.1f} %)"


def parse_filter(text: str, bad_only: bool) -> FrameFilter:
    """`ch:1 frame:read text …`: a channel, a part of a frame's name, and what else is to be found."""
    channel: int | None = None
    frame, rest = "", []
    for word in text.split():
        key, colon, value = word.partition(":")
        if colon and key == "ch" and value.isdigit():
            channel = int(value)
        elif colon and key == "frame":
            frame = value
        else:
            rest.append(word)
    return FrameFilter(channel, frame, bad_only, " ".join(rest))
