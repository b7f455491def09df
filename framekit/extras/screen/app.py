"""The live display: channels with their load, blocks, scrolling frames, the fields of the selected frame."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, ClassVar

from rich.text import Text
from textual.app import App, ComposeResult
from textual.binding import Binding
from textual.coordinate import Coordinate
from textual.widgets import DataTable, Footer, Header, Input, Static

from framekit.api.monitor import parse_filter
from framekit.api.rows import BLOCK_HEAD, FIELD_HEAD, FRAME_HEAD, POINT_HEAD, block_row, field_row, frame_row
from framekit.api.run import COMMANDS
from framekit.cli.common import VerbError
from framekit.definition.problems import plural, printable

if TYPE_CHECKING:
    from framekit.api.monitor import LineOf, LiveView
    from framekit.api.rows import FrameEntry
    from framekit.cli.live_session import LiveSession


MOST_ROWS = 500
"""Largest number of frames in the table; a filter finds older frames again."""
DRAW_EVERY = 0.1
STATUS_EVERY = 10
"""Channels and blocks are drawn at every tenth time."""


class MonitorApp(App[None]):
    """Shows one session until its time is over or the user quits.

    Timers and messages still arrive while the display closes its widgets. Therefore each widget is an
    attribute here and never searched for; drawing on a closed widget has no effect.
    """

    CSS = """
    #channels { height: auto; padding: 0 1; }
    #blocks, #points { height: auto; max-height: 25%; }
    #frames { height: 1fr; }
    #about { height: 1; padding: 0 1; }
    #fields { height: auto; max-height: 35%; }
    #filter, #command { display: none; }
    """
    BINDINGS: ClassVar[list[Binding | tuple[str, str] | tuple[str, str, str]]] = [
        Binding("space", "pause", "pause"),
        Binding("x", "switch_bytes", "hex/ASCII"),
        Binding("b", "bad_only", "bad only"),
        Binding("slash", "find", "filter", key_display="/"),
        Binding("end", "follow", "newest"),
        Binding("colon", "command", "command", key_display=":"),
        Binding("q", "quit", "quit"),
    ]

    def __init__(self, session: LiveSession) -> None:
        super().__init__()
        self.session = session
        self.title = printable(f"framekit {session.title}")
        self.view: LiveView | None = None
        self.failure: Exception | None = None
        self.paused = False
        self.as_ascii = False
        self.bad_only = False
        self.filter_text = ""
        self._shown = 0
        self._drawn = 0
        self._last = time.monotonic_ns()
        self.channels = Static(id="channels", markup=False)
        self.blocks: DataTable[Text] = DataTable(id="blocks", show_cursor=False)
        self.points: DataTable[Text] = DataTable(id="points", show_cursor=False)
        self.frames: DataTable[Text] = DataTable(id="frames", cursor_type="row")
        self.about = Static(id="about", markup=False)
        self.fields: DataTable[Text] = DataTable(id="fields", show_cursor=False)
        self.filter_entry = Input(id="filter", placeholder="ch:1 frame:NAME text – Enter applies, Esc clears")
        self.command_entry = Input(id="command", placeholder=f"{COMMANDS} – Enter does it, Esc leaves")

    # ---- life ---------------------------------------------------------------------------------------------

    def compose(self) -> ComposeResult:
        yield Header()
        yield from (self.channels, self.blocks, self.points, self.frames, self.about, self.fields)
        yield from (self.filter_entry, self.command_entry)
        yield Footer()

    def on_mount(self) -> None:
        self.blocks.add_columns(*BLOCK_HEAD)
        self.points.add_columns(*POINT_HEAD)
        self.frames.add_columns(*FRAME_HEAD)
        self.fields.add_columns(*FIELD_HEAD)
        self.frames.focus()
        try:
            self.view = self.session.view = self.session.begin()
        except (VerbError, ValueError, OSError, RuntimeError) as error:
            self.failure = error
            self.exit()
            return
        self.blocks.display = bool(self.view.blocks())
        self.points.display = bool(self.view.points())
        self._last = time.monotonic_ns()
        self.set_interval(DRAW_EVERY, self.go_on)

    async def on_unmount(self) -> None:
        await self.session.end()

    def go_on(self) -> None:
        """Advance the session by the elapsed time, which is simulated time in a virtual run."""
        if not self.is_running:  # the display is being taken down
            return
        now = time.monotonic_ns()
        self.session.step(now - self._last)
        self._last = now
        self.draw()
        if self.session.is_over:
            self.exit()

    # ---- tables -------------------------------------------------------------------------------------------

    def draw(self) -> None:
        """Draw new frames, and the channels and blocks at longer intervals."""
        if self.view is None:
            return
        if self._drawn % STATUS_EVERY == 0:
            self.draw_status()
        self._drawn += 1
        if not self.paused:
            wanted = parse_filter(self.filter_text, self.bad_only)
            newer = self.view.log.since(self._shown)
            self._shown = self.view.log.last_number
            self._add([entry for entry in newer if wanted.takes(entry.channel, entry.seen)])

    def draw_status(self) -> None:
        """Show channels, troubles and blocks as they are now."""
        if self.view is None:
            return
        now = self.view.now()
        lines = [channel_line(number, line, now) for number, line in self.view.lines.items()]
        counts = self.view.log.counts
        frames = plural(counts["frame"], "frame")
        lines.append(f"{frames}, {counts['bad']} bad, {counts['noise']} noise{self._in_force()}")
        lines += [f"! {trouble}" for trouble in self.view.troubles()]
        self.channels.update("\n".join(map(printable, lines)))
        self.blocks.clear()
        for block in self.view.blocks():
            self.blocks.add_row(*_as_it_is(block_row(block)))
        _fill(self.points, self.view.points())

    def _in_force(self) -> str:
        modes = ["paused"] if self.paused else []
        modes += ["bad only"] if self.bad_only else []
        modes += [f"filter {self.filter_text}"] if self.filter_text else []
        return "".join(f" · {mode}" for mode in modes)

    def _add(self, entries: Iterable[FrameEntry]) -> None:
        """Append rows; the cursor follows if it was on the last row."""
        table, view = self.frames, self.view
        new = list(entries)[-MOST_ROWS:]
        if not new or view is None:
            return
        follows = table.cursor_row >= table.row_count - 1
        for entry in new:
            table.add_row(
                *_as_it_is(frame_row(entry, view.seconds(entry.seen.at), self.as_ascii)), key=str(entry.number)
            )
        for key in list(table.rows)[: max(0, table.row_count - MOST_ROWS)]:
            table.remove_row(key)
        if follows:
            table.move_cursor(row=table.row_count - 1)

    def refill(self) -> None:
        """Show the kept frames again after a change of the filter or of the form of bytes."""
        if self.view is not None:
            wanted = parse_filter(self.filter_text, self.bad_only)
            chosen = [entry for entry in self.view.log.chosen(wanted) if entry.number <= self._shown]
            self.frames.clear()
            self._add(chosen)
            self.draw_status()

    def on_data_table_row_highlighted(self, event: DataTable.RowHighlighted) -> None:
        """Show the fields of the highlighted frame."""
        if event.data_table.id == "frames" and event.row_key is not None and event.row_key.value is not None:
            self.show_fields(int(event.row_key.value))

    def show_fields(self, number: int) -> None:
        """Show the fields with their offsets, and the fault of a bad frame with its offset."""
        entry = None if self.view is None else self.view.log.entry(number)
        self.fields.clear()
        if entry is None or self.view is None:
            self.about.update("")
            return
        seen = entry.seen
        fault = f" – {seen.reason} at byte {seen.place}" if seen.kind == "bad" else ""
        self.about.update(printable(f"no. {number}: {seen.frame or seen.kind}, {plural(len(seen.raw), 'byte')}{fault}"))
        for row in self.view.log.fields(entry):
            self.fields.add_row(*_as_it_is(field_row(row, self.as_ascii)))

    # ---- keys ---------------------------------------------------------------------------------------------

    def action_pause(self) -> None:
        self.paused = not self.paused
        self.draw_status()

    def action_switch_bytes(self) -> None:
        self.as_ascii = not self.as_ascii
        self.refill()

    def action_bad_only(self) -> None:
        self.bad_only = not self.bad_only
        self.refill()

    def action_follow(self) -> None:
        self.frames.move_cursor(row=self.frames.row_count - 1)

    def action_find(self) -> None:
        entry = self.filter_entry
        entry.display = True
        entry.value = self.filter_text
        entry.focus()

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Return whether an action is available: commands only if the session accepts them."""
        return action != "command" or self.session.controls

    def action_command(self) -> None:
        entry = self.command_entry
        entry.display = True
        entry.value = ""
        entry.focus()

    def on_input_submitted(self, event: Input.Submitted) -> None:
        if event.input.id == "command":
            self._leave_command(self.session.control(event.value))
        else:
            self._filter(event.value)

    def on_key(self, event: object) -> None:
        if getattr(event, "key", "") != "escape":
            return
        if self.command_entry.display:
            self._leave_command("")
        elif self.filter_entry.display:
            self._filter("")

    def _leave_command(self, trouble: str) -> None:
        """Return to the frames, and show why a command could not be carried out in place of the frame."""
        self.command_entry.display = False
        self.frames.focus()
        self.draw_status()
        if trouble:
            self.about.update(printable(trouble))

    def _filter(self, text: str) -> None:
        self.filter_text = text
        self.filter_entry.display = False
        self.frames.focus()
        self.refill()


def _fill(table: DataTable[Text], rows: Sequence[Sequence[str]]) -> None:
    """Show the rows; of the same number of rows only changed cells are drawn, and the scroll position stays."""
    if table.row_count != len(rows):
        table.clear()
        for row in rows:
            table.add_row(*_as_it_is(row))
        return
    for number, row in enumerate(rows):
        for column, (cell, before) in enumerate(zip(row, table.get_row_at(number), strict=True)):
            if before.plain != printable(cell):
                table.update_cell_at(Coordinate(number, column), _literal(cell), update_width=True)


def _as_it_is(cells: Iterable[str]) -> Iterator[Text]:
    """Return literal cells: text of a line is never markup, and its invisible characters are escapes."""
    return map(_literal, cells)


def _literal(cell: str) -> Text:
    return Text(printable(cell), no_wrap=True, end="")


BAR = 20


def channel_line(number: int, line: LineOf, now: int) -> str:
    """Return `ch 1 PROTOCOL client, open ████···· 31.0 % (average 12.4 %)`; the first number is since the last call."""
    start = f"ch {number} {line.name}, {line.state()}"
    load_now, load = line.load.since_last(now), line.load.share(now)
    if load_now is None or load is None:
        return start
    full = min(BAR, round(BAR * load_now))
    bar = "█" * full + "·" * (BAR - full)
    return f"{start}  {bar} {100 * load_now:5.1f} % (average {100 * load:.1f} %)"
