"""What running sequences do to the world around them: send, serve, set the session, queues, memory, show.

The machine that moves sequences stands on it. Nothing here knows steps.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from framekit.link.clocks import begin_clock
from framekit.link.codes import code_text
from framekit.link.evaluate import Names
from framekit.link.exchange import Ask, Exchange, MemoryAccess, Outcome, Server
from framekit.link.frame_table import FrameTable
from framekit.link.late import LateReplies
from framekit.link.observe import Monitor, Seen
from framekit.link.output import Item, Output
from framekit.link.program import CompiledSequence
from framekit.link.queues import Queues
from framekit.link.runs import Activation, Run, State
from framekit.link.scope import Scope
from framekit.link.sessions import SessionState
from framekit.link.values import FrameValue, plain


class Environment:
    """What all runs of an engine share.

    `changed`: what runs wait for may be other than before; `stirred`: a lane may have room for something to begin.
    `monitor` is shown everything. `on_fault` is shown everything but frames, `on_send` is told of each frame that goes
    out: with these alone no frame is read for being shown. `last_frame`: when the last good frame came or went.
    `delivered`: frames to be offered as if they had arrived. `callbacks`: to be called when everything else is done.
    """

    def __init__(self, scope: Scope, table: FrameTable, sequences: dict[str, CompiledSequence], output: Output) -> None:
        self.scope = scope
        self.table = table
        self.sequences = sequences
        self.output = output
        self.late = LateReplies(scope.protocol, scope)
        self.queues = Queues(scope.protocol)
        self.has_queues = bool(scope.protocol.queues)
        self.session = SessionState(None, scope)
        self.server: Server | None = None
        self.memory: MemoryAccess | None = None
        self.ask_service: Ask | None = None
        self.monitor: Monitor | None = None
        self.on_fault: Monitor | None = None
        self.on_send: Callable[[], None] | None = None
        self.last_frame = scope.now
        self.flush: Callable[[], None] | None = None
        self.delivered: deque[FrameValue] = deque()
        self.callbacks: deque[Callable[[], None]] = deque()
        self.ended: deque[Run] = deque()
        self.changed = True
        self.stirred = True
        self.asking: Run | None = None
        self.has_bytes: Callable[[], bool] = lambda: False
        self.stream_place: Callable[[], int] = lambda: 0
        self.drop_stale: Callable[[], None] = lambda: None

    # ---- sending ------------------------------------------------------------------------------------------

    def send(self, run: Run, activation: Activation, value: Any) -> tuple[bytes, FrameValue] | None:
        """Sends a frame value; None sends nothing. Raises ValueError for values that the frame cannot carry."""
        if value is None:
            return None
        if type(value) is not FrameValue:
            raise TypeError(f"{value!r} is no frame and cannot be sent")
        dealing = activation.dealing
        if not dealing.checks_echo:
            self.table.fill_echo(value, dealing.answering, dealing.last_taken)
        data = self.table.encode(value, activation.names)
        self.announce(value)
        dealing.last_sent = value
        self.put_out(run, data, value, repeated=False)
        return data, value

    def announce(self, value: FrameValue) -> None:
        """What a frame says about later ones, when it is accepted or first sent."""
        info = self.table.infos.get(value.frame)
        if info is not None and info.announces:
            names = Names(value.complete(), self.scope)
            for variable, evaluate in info.announces:
                self.scope.set(variable, evaluate(names))

    def put_out(self, run: Run, data: bytes, value: FrameValue, repeated: bool) -> None:
        self.last_frame = self.scope.now
        if self.on_send is not None:
            self.on_send()
        if self.monitor is not None:
            self.show("frame", "out", data, value.frame, value.complete(), repeated=repeated)
        if self.output.put(Item(run, data, info=self.table.infos[value.frame])):
            run.unsent += 1

    def hold_break(self, run: Run, duration: int) -> None:
        if duration > 0 and self.output.put(Item(run, duration=duration)):
            run.unsent += 1
            if self.monitor is not None:
                self.show("break", "out")

    def left(self, run: Run) -> None:
        """The last bit of something the run sent has left the line: its clock may begin."""
        run.unsent = max(0, run.unsent - 1)
        if not run.unsent and run.clock_waits and run.state is not State.DONE:
            begin_clock(run, self.scope.now)

    # ---- queues, memory -----------------------------------------------------------------------------------

    def put(self, queue: str, item: dict[str, Any]) -> None:
        self.queues.put(queue, item)
        self.changed = True
        self.stirred = True

    def take_item(self, queue: str) -> Any:
        self.changed = True
        self.stirred = True
        return self.queues.take(queue)

    def complete(self, value: FrameValue, activation: Activation) -> None:
        """A frame that goes into a queue gets its computed fields now."""
        if value.raw is None:
            self.table.encode(value, activation.names)
            value.complete()

    def deliver(self, value: Any) -> None:
        if type(value) is not FrameValue:
            raise TypeError("only a frame can be delivered")
        self.delivered.append(value)
        self.changed = True
        self.stirred = True

    def store(self, address: str, data: bytes) -> None:
        if self.memory is None:
            raise ValueError("there is no memory to store into")
        self.memory.write(address, bytes(data))

    def number_named(self, frame: str, field: str, value: Any) -> Any:
        """The number behind a name of a field's values."""
        numbers = self.table.infos[frame].numbers.get(field) if frame in self.table.infos else None
        return numbers.get(value, value) if numbers and isinstance(value, str) else value

    # ---- showing ------------------------------------------------------------------------------------------

    def show(
        self, kind: Any, direction: Any = "", raw: bytes = b"", frame: str = "", fields: dict[str, Any] | None = None,
        **more: Any,
    ) -> None:  # fmt: skip
        on_fault = None if kind == "frame" else self.on_fault
        if on_fault is None and self.monitor is None:
            return
        shown = {name: plain(value) for name, value in fields.items()} if fields else {}
        seen = Seen(direction, kind, self.scope.now, raw, frame, shown, **more)
        if on_fault is not None:
            on_fault(seen)
        if self.monitor is not None:
            self.monitor(seen)

    def show_received(self, value: FrameValue, raw: bytes, started_at: int) -> None:
        """A good frame, or one that is to be refused, whose first byte came at `started_at`."""
        self.last_frame = self.scope.now
        if self.monitor is not None:
            reason = "" if value.refusal is None else f"refused with {code_text(value.refusal)}"
            self.show("frame", "in", raw, value.frame, value.fields, reason=reason, started_at=started_at)

    # ---- serving ------------------------------------------------------------------------------------------

    def serve(self, activation: Activation, request: Any, buffer: bytes, station: Any, check_only: bool) -> None:
        """Has a request done; its answer stands in `reply`, `reply_buffer` and `refusal` then."""
        if self.server is None:
            raise ValueError("nobody here serves requests")
        if type(request) is not FrameValue:
            raise TypeError("only a frame can be served")
        served = self.server.serve(request, buffer, station, check_only, activation.names)
        if served.trouble:
            self.show("trouble", frame=request.frame, reason=served.trouble)
        dealing = activation.dealing
        dealing.names.update(reply=served.reply, reply_buffer=served.reply_buffer, refusal=served.refusal)
        dealing.answers(request)
        if not check_only:
            dealing.names["buffer"] = served.reply_buffer

    def set_session(self, new: bool) -> None:
        self.session.end()
        if new:
            self.session.opened()

    def tell(self, exchange: Exchange, outcome: Outcome) -> None:
        """Calls back when everything that follows at this point has been done."""
        self.callbacks.append(lambda: exchange.on_done(outcome))
