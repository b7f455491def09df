"""Keep a line in step: decide when a request may be sent, and whether a reply may be stored (docs/internals/engine.md).

Most protocols give their replies no number, so a late reply looks like the reply to the next request. Every request
that got no reply in time stays *open* until its reply comes or until no reply can come any more. The states:

    in step          no request is open
      | a time limit ends without the reply
    holding          no request is sent until the open replies have come or are later than any reply before
      | the hold ends and requests are still open
    out of step      requests are sent; a reply is stored when it has come more often than open requests can bring it
      | the replies differ, or come slowly
    draining         no request is sent until the open replies have come, or none of them is expected any more

No request open: in step again, from every state. Sans-I/O: the engine calls these functions with its clock.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable
from contextlib import suppress
from itertools import islice
from typing import Any

from framekit.codec.errors import FrameError
from framekit.definition.model.protocol import Protocol
from framekit.link.ahead import Ahead
from framekit.link.arrivals import BadFrame
from framekit.link.awaited_replies import Replies
from framekit.link.doubts import Doubt, content_of, is_begun_again, short_silence, silence
from framekit.link.events import Exchange
from framekit.link.frame_table import FrameTable
from framekit.link.holds import LINE, Holds
from framekit.link.overdue import HORIZON, LONGEST, MOST_OPEN, Latest, NumberedRequests, OpenRequest, request_of
from framekit.link.scope import Scope
from framekit.link.sequences.state import Run
from framekit.link.slow import Prompt, SlowStations, key_of
from framekit.link.values import CODEC_ERRORS, EVALUATION_ERRORS, FrameValue, Names, compile_optional

LOSSES, SHORT_HORIZON = 5, 4
"""After so many requests without any reply and without a late reply the line loses frames: a shorter horizon."""

MOST_HOLDS = 5
"""A request fails after so many times the usual hold: frames without a request arrive without end."""

MOST_CHANGES = 6
"""So many proofs in sequence may begin with the bytes proved before because a value changes just then."""

MOST_RESTARTS = 2
"""An exchange in doubt gathers replies again so many times, after holds and lost requests; then the line drains."""

FORGET = 600_000_000_000
"""A measured lateness loses its effect linearly within this time (ns)."""

NO_REPLIES = Replies(frozenset(), frozenset(), ())


class LateReplies:
    """Track the open requests of a line; decide about sending and storing."""

    __slots__ = (
        "_doubts", "_expected", "_greatest", "_is_stream", "_late", "_proved", "_scope", "_seen", "_served", "_shifted",
        "_table", "ahead", "count", "heard_until", "holds", "is_shared", "items", "last", "latest", "lost", "noisy",
        "numbered", "on_end", "on_wait", "open", "slow", "strange_since", "within",
    )  # fmt: skip

    def __init__(self, protocol: Protocol, scope: Scope, table: FrameTable) -> None:
        self._late = compile_optional(protocol.line.late)
        self._is_stream = protocol.line.kind == "stream"
        self._scope, self._table = scope, table
        self.open: list[OpenRequest] = []
        """Requests without a reply, oldest first."""
        self.holds = Holds()
        self.within = 0
        """Time limit of the last wait for a reply (ns)."""
        self.count = 0
        """Number of requests that were ever open."""
        self.last = 0
        """Time of the last late reply (ns)."""
        self._seen: dict[Hashable, int] = {}
        """For each station the time of its last late reply; `LINE`: of a reply to an unknown request (ns)."""
        self.lost = 0
        """Number of requests that no reply came to up to the horizon, since the last late reply."""
        self._expected = NO_REPLIES
        self.ahead: Ahead | None = None
        """Reads the bytes after a reply; None: they are not read."""
        self.items: list[Callable[[], None]] = []
        """Frames sent without an exchange that wait for the end of the hold."""
        self.slow = SlowStations()
        self.numbered = NumberedRequests(table, self.slow)
        self.latest: Latest = 0, None
        self.on_wait: Callable[[Any, int], None] = lambda station, until: None
        """Called when a request to a station has to wait for late replies, with the end of the wait (ns)."""
        self.on_end: Callable[[], None] = lambda: None
        """Called when requests no longer have to wait for late replies."""
        self.is_shared: Callable[[], bool] = lambda: False
        """Called when an exchange would keep the line: whether requests to other stations wait for their turn."""
        self._doubts: dict[Hashable, Doubt] = {}
        """The doubts of exchanges that were postponed, by station."""
        self._greatest: dict[Hashable, tuple[int, int]] = {}
        """For each station the greatest lateness, and when it was measured."""
        self._proved: bytes | None = None
        """Bytes of the reply that was proved last."""
        self._shifted = 0
        """Number of proofs in sequence that began with these bytes, and ended with others."""
        self.strange_since = 0
        """Time of the first frame in this hold that answers no open request; 0: none came."""
        self.noisy = -1
        """Time of the last noise, or bad frame, on the line (ns); -1: none came."""
        self._served: dict[Hashable, tuple[int, int]] = {}
        """For each station with open requests that has answered some late: when it did so last, and the greatest time
        that it took for one of them, its requests before that not counted (ns)."""
        self.heard_until = scope.now
        """Time up to which every byte that arrived has been handled; later bytes may wait in the port (ns)."""

    @property
    def expected(self) -> Replies:
        """The replies that the exchanges of the role wait for."""
        return self._expected

    @expected.setter
    def expected(self, expected: Replies) -> None:
        self._expected, self.holds.is_by_station = expected, expected.name_stations

    @property
    def until(self) -> int:
        """Return the end of the longest hold (ns); 0: no hold."""
        return self.holds.until

    def seen_at(self, station: Any) -> int:
        """Return the time of the last late reply, or of a frame that may answer an unknown request (ns); -1: none."""
        return max(self._seen.get(LINE, -1), self._seen.get(self.holds.key(station), -1))

    # ---- requests become open -----------------------------------------------------------------------------

    def time(self, names: Names, within: int) -> int:
        """Return how long after its time limit `within` a reply may come: `late` of the line, else as long again."""
        more = within
        if self._late is not None:
            try:
                more = int(self._late(names))
            except EVALUATION_ERRORS:
                more = within
        return min(max(0, more), LONGEST)

    def miss(self, run: Run, x: Exchange) -> None:
        """Note that the wait of a run ended, or that its request is repeated, and no reply has come."""
        numbered, unusable = is_numbered(run), run.unusable
        more = 0 if numbered else self.time(x.names, run.longest)
        if not (numbered or more):
            return
        request = request_of(run, x)
        if unusable is not None and unusable.take_new():
            if unusable.is_reply and not self.open:
                return  # its reply has come, damaged
            request.is_met = True
        if numbered:
            self.numbered.add(request, self._scope.now)
            return
        self._add(request)
        self._hold(x.station, run.started, run.longest, more)

    def is_damaged_reply(self, bad: BadFrame, run: Run, x: Exchange) -> bool:
        """Return whether a bad frame is the only frame of the reply to a request, right but for its check code."""
        info = self._table.infos.get(bad.frame)
        if self.open or not self.expected.is_single or info is None or bad.cause != "check":
            return False
        try:
            info.decode(bad.raw, self._scope)
        except FrameError as error:
            if error.cause == "check" and error.also is None:
                with suppress(CODEC_ERRORS):
                    return request_of(run, x).fits(info.make(error.fields, bad.raw, None), self._table)
        except CODEC_ERRORS:
            pass
        return False

    def took(self, run: Run, x: Exchange) -> None:
        """Note a reply to a request that was repeated: it answers the first of the equal requests, others are open."""
        if is_numbered(run):
            self.numbered.took(request_of(run, x), self._scope.now)
            return
        raw = x.last_sent.raw if x.last_sent is not None else None
        own = [
            one for one in self.open if one.number >= run.first_open and one.sent is not None and one.sent.raw == raw
        ]
        if own:
            self._add(request_of(run, x))
            self._close(own[0])
        else:
            self.slow.answered_in_time(x.station, self._scope.now)
        if not own and all(one.station == x.station for one in self.open):
            self.last = 0  # this reply came in time: a reply before it did not wait for another one
            self._served.pop(key_of(x.station), None)
        if own and self._is_prompt(run, x, own[0]):
            self.holds.replace(x.station, self._scope.now + silence(self._scope.now - run.started, run.longest))
        elif own or (self.held_until(x.station) > self._scope.now and self._may_be_another(x.taken)):
            more = self.time(x.names, run.longest)
            self._hold(x.station, own[0].at if own else run.started, run.longest, more)
            self._hold(x.station, run.started, run.longest, more)

    def _is_prompt(self, run: Run, x: Exchange, first: OpenRequest) -> bool:
        """Return whether the reply to a repeated request came quickly, and no late reply of the station is known.

        Then the first request, or its reply, was probably lost. The line is out of step all the same.
        """
        is_late = self.strange_since or self.seen_at(x.station) >= first.at or self._greatest_of(x.station)
        return not is_late and self._scope.now - run.started <= run.longest // 8

    def _may_be_another(self, reply: FrameValue | None) -> bool:
        """Return whether a reply in time may be the reply to an open request, or to an unknown request."""
        return not self.open or any(reply is None or one.fits(reply, self._table) for one in self.open)

    def sent_alone(self, value: FrameValue, is_asking: bool) -> bool:
        """Return whether a frame without an exchange has to wait; if not, and a service asks with it, it is open now.

        No reply is due to a broadcast. `is_asking`: an exchange waits for its reply.
        """
        scope = self._scope
        asks = value.frame in self.expected.requests and not self.expected.is_broadcast(value, scope)
        if self.until > self.heard_until:
            return True
        if not asks:
            return False
        within = self.longest()
        more = self.time(scope, within)
        if more and is_asking:
            self.holds.extend(None, scope.now + within)
            return True
        if more:
            request = OpenRequest(None, value, scope, scope.now, within)
            request.by_itself = True
            self._add(request)
            self._hold(None, scope.now, within, more)
        return False

    def longest(self) -> int:
        """Return the longest time limit of the steps that wait for a reply, as far as it needs no exchange."""
        found = 0
        for wait in self.expected.waits:
            try:
                found = max(found, int(wait(self._scope)))
            except EVALUATION_ERRORS:
                continue
        return found

    def _add(self, request: OpenRequest) -> None:
        request.number, self.count = self.count, self.count + 1
        request.within = min(request.within, LONGEST)
        times = HORIZON if self.lost < LOSSES else SHORT_HORIZON
        request.ends = max(request.at, self._scope.now) + min(times * max(request.within, self.longest()), LONGEST)
        self.open.append(request)
        if len(self.open) > MOST_OPEN:
            del self.open[0]

    def _hold(self, station: Any, started: int, within: int, more: int) -> None:
        """Hold requests back: for the time limit and `late`, or for the greatest lateness and a quarter of it."""
        now = self._scope.now
        learned = self._greatest_of(station)
        end = max(max(now, started + within) + more, started + learned + learned // 4)
        self.holds.extend(station, min(end, now + LONGEST + more))

    def is_late(self, station: Any) -> bool:
        """Return whether a reply of a station was late, some minutes ago at the earliest."""
        return self._greatest_of(station) > 0

    def _greatest_of(self, station: Any) -> int:
        """Return the greatest lateness of a station, reduced with its age."""
        measured, at = self._greatest.get(key_of(station), (0, 0))
        age = self._scope.now - at
        return measured if age < FORGET // 2 else max(0, measured - measured * (age - FORGET // 2) // (FORGET // 2))

    # ---- may a request be sent? ---------------------------------------------------------------------------

    def prepare(self, x: Exchange) -> None:
        """Hold the line before an exchange that must not be repeated, until no reply to a similar request can come.

        Hold it before each exchange if open requests are too old by now, but their replies may wait in the port.
        """
        self.expire()
        if self._doubts:
            self._go_on_with(x)
        if any(self._is_too_old(one, self._scope.now) for one in self.open):
            self.holds.extend(None, self._scope.now)
        if not self.open or x.may_repeat():
            return
        kind = None if x.request is None else x.request.frame
        for one in self.open:
            if kind is None or one.asked is None or one.asked.frame == kind:
                self.holds.extend(x.station, one.ends)
                one.is_passed = True

    def _go_on_with(self, x: Exchange) -> None:
        """Go on with the doubt of the exchange that was postponed; another exchange with the station ends the doubt.

        End a drain if no late reply can come any more.
        """
        key, now = key_of(x.station), self.heard_until
        doubt = self._doubts.get(key)
        if doubt is None or self.held_until(x.station) > now:
            return
        if doubt.asks and not is_begun_again(x, doubt.asks[-1][0]):
            del self._doubts[key]
            self._settle(doubt)
        elif doubt.is_draining:
            fitting = self._fitting(doubt)
            if all(one.ends <= now for one in fitting) and self._end_drain(doubt, fitting):
                del self._doubts[key]

    def held_until(self, station: Any) -> int:
        """Return until when no request is sent to a station (ns); 0: it has no hold.

        Where replies name their station, that is no later than now if no open request is for this station.
        """
        if not self.expected.name_stations or not self.open:
            return self.until
        if any(one.station is None for one in self.open):
            return self.until
        return self.holds.end_of(station) if any(one.station == station for one in self.open) else 0

    @property
    def has_stations(self) -> bool:
        """Return whether the hold is for requests to certain stations only."""
        return self.expected.name_stations and bool(self.open) and all(one.station is not None for one in self.open)

    def state_at(self, now: int) -> str:
        """Return `in step`, `holding` or `out of step`; requests whose replies can no longer come do not count."""
        if not any(one.ends > now for one in self.open):
            return "in step"
        return "holding" if self.until > now else "out of step"

    def time_over(self) -> None:
        """End the holds whose time is over. Requests that are still open make the line out of step."""
        self.holds.drop_over(self._scope.now)
        if not self.until:
            self.strange_since = 0

    def is_without_end(self, since: int) -> bool:
        """Return whether a request was held back for too long by frames that answer no open request."""
        now, usual = self._scope.now, self.within + self.time(self._scope, self.within)
        strange = self.strange_since and now - max(since, self.strange_since) >= MOST_HOLDS * usual
        return bool(strange) or now - since > MOST_HOLDS * LONGEST

    def disconnected(self) -> None:
        """Drop the frames that wait, and on a stream the open requests: their replies go to the old connection.

        On a serial line, and through a gateway to a serial line, a reply may come after the port is opened again.
        """
        self.items.clear()
        if self._is_stream:
            self.numbered.clear()
            self.open.clear()
            self._served.clear()
            self._doubts.clear()
            self.last = self.strange_since = 0
            self.holds.clear()

    def take_over(self, before: LateReplies, *, is_same: bool) -> None:
        """Wait for the late replies that a previous engine of the same line waits for; on a stream none can come.

        `is_same`: it had the same protocol and role. Else each of its requests is foreign here.
        """
        if self._is_stream or before._is_stream or not self.time(self._scope, max(1, before.within)):
            return
        for doubt in before._doubts.values():
            before._settle(doubt)
        before._doubts.clear()
        added = before.open if is_same else [self._foreign(one) for one in before.open]
        self.open += [one for one in added if one not in self.open]
        self.open.sort(key=lambda one: one.at)
        del self.open[:-MOST_OPEN]
        self.count = max(self.count, before.count)
        self.holds.extend(None, before.until)
        self.within, self.last = max(self.within, before.within), max(self.last, before.last)
        self._seen[LINE] = max(self._seen.get(LINE, -1), *before._seen.values(), -1)
        for station, (lateness, at) in before._greatest.items():
            if lateness > self._greatest_of(station):
                self._greatest[station] = lateness, at

    def _foreign(self, request: OpenRequest) -> OpenRequest:
        """Return an open request of another protocol as far as it counts here."""
        made = OpenRequest(None, None, self._scope, request.at, request.within)
        made.ends, made.number, made.is_foreign = request.ends, request.number, True
        return made

    def is_over(self, now: int) -> bool:
        """Return whether no open request, hold or lateness is left for a later engine on the line."""
        waits = self.until > now or self._doubts or any(one.ends > now for one in self.open)
        return not waits and all(at + FORGET <= now for _, at in self._greatest.values())

    # ---- replies that no row takes ------------------------------------------------------------------------

    def came(self, value: FrameValue, is_awaited: bool) -> OpenRequest | None:
        """Return the open request that a frame answers which no row takes, or None.

        Without one the frame is a sign of unknown requests, and holds the line; not if `is_awaited`: such frames come
        by themselves too, so only a hold makes one of them a late reply, and a number never does. A frame that noise
        can look like is no sign of anything if noise came since the request: the request stays open.
        """
        now = self._scope.now
        if self.numbered.is_watching and (found := self.answers_overdue(value)) is not None:
            return None if is_awaited else found
        if value.frame not in self.expected.frames and not any(value.frame in one.frames for one in self.open):
            return None
        self.expire()
        if is_awaited and not self.until:
            return None
        found = self._answered_by(value)
        if value.frame in self.expected.unproven and self.noisy >= (now if found is None else found.at):
            return None
        if found is not None:
            service = self._match(found)
            if not self.expected.is_single:  # it may be one of several frames that answer the request
                self.open.insert(0, found)
            if not self._is_awaited(found.station):
                self.holds.replace(found.station, 0)
            if not self.open:
                self.holds.clear()
                return found
        elif is_awaited:
            return None
        else:
            service, self._seen[LINE] = 0, now
            self.strange_since = self.strange_since or now
        more = self.time(self._scope, self.within)
        if more and not (found is not None and self._is_prompted(found)):
            self._extend_for(found, now + max(more, min(service + service // 4, LONGEST)))
        return found

    def _is_prompted(self, request: OpenRequest) -> bool:
        """Return whether a late reply came with a later request: a device or a gateway has kept it until then.

        A wait does not bring such replies, and the time since their request is no lateness.
        """
        return request.prompt(self.latest, self._scope.now).by == "request"

    def _is_awaited(self, station: Any) -> bool:
        """Return whether an open request can have a reply for which requests to a station wait."""
        by_station = self.expected.name_stations
        return any(not by_station or one.station is None or one.station == station for one in self.open)

    def _extend_for(self, found: OpenRequest | None, end: int) -> None:
        """Extend the hold after a late reply to `found`, or after a reply to an unknown request."""
        if found is None:
            self.holds.extend(None, end)
        elif self._is_awaited(found.station):
            self.holds.extend(found.station, end)

    def answers_overdue(self, value: FrameValue) -> OpenRequest | None:
        """Return the overdue request whose number a frame has, or None."""
        return self.numbered.came(value, self.expected.limits, self.latest, self._scope.now)

    def _answered_by(self, reply: FrameValue) -> OpenRequest | None:
        """Return the open request that a late reply closes; None if it fits none.

        It is the oldest request that it fits, but rather a request that is not met. The oldest then stays open for as
        long as the request that is closed for it: the reply may nevertheless be its own.
        """
        fitting = [one for one in self.open if not one.is_foreign and one.fits(reply, self._table)]
        if not fitting:
            return None
        found = next((one for one in fitting if not one.is_met), fitting[0])
        fitting[0].ends = max(fitting[0].ends, found.ends)
        return found

    def _close(self, request: OpenRequest) -> int:
        """Close a request whose reply has come; return the time that the device took for it alone."""
        now = self._scope.now
        self.open.remove(request)
        service = now - max(request.at, self.last)
        self.last = now
        key = key_of(request.station)
        last, greatest = self._served.get(key, (0, 0))
        self._served[key] = now, max(greatest, now - max(request.at, last))
        return service

    def _match(self, request: OpenRequest) -> int:
        """Close a request whose reply was late; learn its lateness. Return the least time that it may have taken."""
        now, last = self._scope.now, self.last
        # a request that later replies have passed has probably lost its reply: this reply answers a newer request
        newer = (one.at for one in self.open if one.station == request.station and not one.is_passed)
        since = max(request.at, next(newer, request.at)) if request.is_passed else request.at
        lateness = min(now - since, HORIZON * max(1, request.within))  # later, it may be no reply to it
        station = key_of(request.station)
        before, _ = self._served.get(station, (0, 0))
        service = self._close(request)
        self.lost, self._seen[self.holds.key(request.station)] = 0, now
        prompt = request.prompt(self.latest, now)
        if lateness > self._greatest_of(station) and not request.by_itself and not self._is_prompted(request):
            self._greatest[station] = lateness, now
        newest = next((one for one in reversed(self.open) if key_of(one.station) == station), None)
        if newest is None:
            _, time = self._served.pop(station)
        else:  # the reply to an older request may be lost
            time = now - max(newest.at, before)
        if time > request.within and not request.by_itself:
            limit = request.limit(self.expected.limits)
            if newest is None or self.slow.is_likely(request.station, is_prompted=bool(prompt.by)):
                self.slow.answered_late(request.station, time, limit, now, prompt)
        for one in self.open:
            one.ends = max(one.ends, now + min(service + service // 4 + one.within, LONGEST))
        return now - max(since, last)

    def _may_be_of(self, request: OpenRequest, reply: FrameValue, station: Any) -> bool:
        """Return whether a reply to a station may be the reply to an open request."""
        is_other = self.expected.name_stations and request.station not in (None, station)
        return not is_other and self._could_answer(reply, request)

    def _could_answer(self, reply: FrameValue, request: OpenRequest) -> bool:
        """Return whether a reply fits a request: it repeats everything that its definition says."""
        return self._table.repeats(reply, request.asked, request.sent, request.names)

    def expire(self) -> None:
        """Drop open requests that no reply is expected for any more."""
        now = self.heard_until
        if any(one.ends <= now for one in self.open):
            too_old = [one for one in self.open if self._is_too_old(one, now)]
            self._lose([one for one in too_old if self.held_until(one.station) <= now])

    def _is_too_old(self, request: OpenRequest, now: int) -> bool:
        """Return whether no reply to an open request is expected any more.

        The end of a request is not enough: a device may keep a reply until it is asked again, however long that takes.
        So the reply to a later request has to be proved first.
        """
        return request.ends <= now and (request.is_passed or not self.expected.is_single)

    def _lose(self, requests: list[OpenRequest]) -> None:
        """Drop open requests that no reply came to; a request that is met is not lost."""
        self.lost += sum(not (one.is_foreign or one.is_met) for one in requests)
        self.open = [one for one in self.open if one not in requests]

    # ---- may a reply be stored? ---------------------------------------------------------------------------

    def gives_way(self, run: Run, until: int) -> bool:
        """Return whether an exchange ends that would wait, so that other stations are asked before `until` (ns).

        An exchange whose replies come quickly goes on.
        """
        doubt = run.doubt
        if until <= self._scope.now or not (self.has_stations and self.is_shared()):
            return False
        if doubt is None:
            return True
        if doubt.asks and not doubt.is_held:
            return False
        if doubt.is_draining:
            until = max([until, *(one.ends for one in self._fitting(doubt))])
        self.holds.extend(doubt.station, until)
        self._doubts[key_of(doubt.station)], run.doubt = doubt, None
        return True

    def _fitting(self, doubt: Doubt) -> list[OpenRequest]:
        """Return the open requests that the last reply in doubt may answer."""
        reply = doubt.reply
        return [one for one in self.open if reply is None or self._could_answer(reply, one)]

    def _end_drain(self, doubt: Doubt, fitting: list[OpenRequest]) -> bool:
        """Drop the requests that no reply has come to while the line was draining; return whether the doubt is over."""
        if doubt.was_drained or not fitting:
            self._lose(fitting)
            return True
        self._lose(fitting[:-1])  # a device may keep a reply until it is asked again
        doubt.is_draining, doubt.was_drained = False, True
        doubt.restart(self._scope.now)
        return False

    def note_excess(self, run: Run, x: Exchange, runs: Iterable[Run]) -> None:
        """Note the further replies that have come together with the reply to an exchange.

        A request has a single reply. So a reply that no open request and no other of the `runs` explains shows a
        request that is not known any more, and each reply of this read may belong to it: an open request of unknown
        kind. Something has come for it, so it counts as met.
        """
        expected, now, reply, ahead = self.expected, self._scope.now, x.taken, self.ahead
        if reply is None or ahead is None or reply.frame not in expected.frames or not expected.is_single:
            return
        more = self.time(x.names, self.within)
        if not more:
            return
        self.expire()
        own = request_of(run, x)
        waiting = [request_of(one, one.asked) for one in runs if one is not run and one.asked is not None]
        known = [*self.open, *waiting]
        names = tuple(name for name in self._table.on_line if name in expected.frames)
        for value in islice(ahead.frames(names, now), MOST_OPEN):
            found = next((one for one in known if self._explains(one, value, own, reply)), None)
            if found is not None:
                known.remove(found)
                continue
            fits_own = expected.name_stations and own.fits(value, self._table)
            added = OpenRequest(None, None, self._scope, now, self.within)
            added.is_foreign, added.is_met, added.station = True, True, own.station if fits_own else None
            self._add(added)
            added.number = run.first_open - 1
            self.holds.extend(added.station, now + more)

    def _explains(self, request: OpenRequest, value: FrameValue, own: OpenRequest, reply: FrameValue) -> bool:
        """Return whether a further reply may be due to a request; equal requests of an exchange bring equal replies."""
        if request.is_foreign or not request.fits(value, self._table):
            return request.is_foreign
        return not request.is_repeated_by(own) or value.raw == reply.raw

    def doubts(self, run: Run, x: Exchange, results: dict[str, Any]) -> int:
        """Return 0 if the reply to an exchange belongs to it, else until when to keep silent before it runs again.

        A reply belongs to the exchange if no open request could have brought it, or if it came in more equal copies
        than open requests can bring. Two requests without a reply are a time limit apart, and so are their late
        replies: faster copies are more than they can bring.
        """
        self.expire()
        reply = x.taken
        if reply is None or not self.open:
            return self._believe(run)
        others = [one for one in self.open if one.number < run.first_open and self._may_be_of(one, reply, x.station)]
        if not others:
            return self._believe(run)
        now, within = self._scope.now, max(1, min(self.within, LONGEST))
        doubt = run.doubt
        if doubt is None:
            doubt = run.doubt = self._doubts.pop(key_of(x.station), None) or Doubt(x.station, now)
            doubt.go_on(now)
        if doubt.is_held and self._may_restart(doubt, others):
            self._restart(run, doubt, now)
        doubt.asks.append((request_of(run, x), now))
        doubt.is_held = self.held_until(x.station) > now + silence(now - run.started, within)
        content, took = content_of(results, reply), now - run.asked_at
        if self.seen_at(x.station) < min(one.at for one in others) and not self._greatest_of(x.station):
            took = now - run.started  # no reply was late: the last of the repeated requests was answered, presumably
        doubt.note(content, reply, took, now)
        possible = len(others) if doubt.is_hurried else min(len(others), 1 + 2 * (now - doubt.since) // within)
        if doubt.equal > possible:
            self._note_kept(doubt, others[0], x, reply)
            self._shift(doubt, others)
            own = request_of(run, x)
            return self._believe(run, [one for one in others if not one.is_repeated_by(own)])
        if self.expected.is_single and x.may_repeat() and doubt.can_hurry(len(others), took, within):
            doubt.hurried, doubt.extra = doubt.hurried + 1, 0
            return now + short_silence(took, within)
        gathered, number = now - doubt.gathers_from, len(doubt.asks)
        is_usual = gathered < within and took <= 2 * doubt.quickest + within // 50
        if number - doubt.hurried > 3 and doubt.changes and is_usual:
            return self._believe(run, others)  # the value itself changes; each reply came at its usual time
        if gathered < within and number < MOST_OPEN:
            doubt.extra = 0
            return now + silence(took, within)
        if any(one.number >= run.first_open for one in self.open) and self._may_restart(doubt, others):
            end = max(self.held_until(x.station), now + silence(now - run.started, within))
            self._restart(run, doubt, end)  # one of the requests that gather replies was lost
            return end
        return self._drain(run, doubt)

    def _restart(self, run: Run, doubt: Doubt, begin: int) -> None:
        """Gather replies again from `begin` on (ns): those before are late replies."""
        self._count(doubt)
        run.first_open = self.count
        doubt.restart(begin)

    def _may_restart(self, doubt: Doubt, others: list[OpenRequest]) -> bool:
        """Return whether a device that answers quickly may be well: no open request shows the contrary.

        Either no late reply has come since the first of them, or something has come for each.
        """
        if doubt.restarts >= MOST_RESTARTS:
            return False
        return self.seen_at(doubt.station) < min(one.at for one in others) or all(one.is_met for one in others)

    def _believe(self, run: Run, others: Iterable[OpenRequest] = ()) -> int:
        """Return 0: the reply belongs to the exchange, although it could be the reply to `others`."""
        for one in others:
            one.is_passed = True
        run.doubt = None
        return 0

    def _note_kept(self, doubt: Doubt, oldest: OpenRequest, x: Exchange, reply: FrameValue) -> None:
        """Note a proof that began with the reply to the last request of the proof before: a device keeps replies."""
        is_shifted = doubt.first is not None and doubt.first != reply.raw and doubt.first == self._proved
        if doubt.first == reply.raw:
            self._shifted = 0
            self.slow.answered_itself(x.station)
        self._shifted += is_shifted
        if is_shifted and self._shifted >= MOST_CHANGES:
            time, limit = self._scope.now - oldest.at, oldest.limit(self.expected.limits)
            self.slow.answered_late(x.station, time, limit, self._scope.now, Prompt("request", is_just_late=False))
        self._proved = reply.raw

    def _shift(self, doubt: Doubt, others: list[OpenRequest]) -> None:
        """Keep the last requests of a proof open for the replies of another content, which answered earlier requests.

        A device that keeps a reply until the next request stays one request behind.
        """
        number = min(len(doubt.asks) - doubt.equal, len(others))
        for one in others[:number]:
            self.open.remove(one)
        for request, _ in doubt.asks[len(doubt.asks) - number :]:
            self._add(request)

    def _drain(self, run: Run, doubt: Doubt) -> int:
        """Stop asking until no reply to an open request is expected any more (`silent`)."""
        doubt.is_draining = True
        for one in self.open:
            if one.ends <= self._scope.now:
                one.ends = self._scope.now + min(HORIZON * max(1, self.within), LONGEST)
        self._settle(doubt)
        run.first_open = self.count
        return self.held_until(doubt.station)

    def _settle(self, doubt: Doubt) -> None:
        """Count the replies of an exchange that are not believed; hold the line for as long as they were late."""
        now, lateness = self._scope.now, self._count(doubt)
        if self.open:
            lateness = min(lateness, HORIZON * max(1, self.within))
            self.holds.extend(doubt.station, min(now + lateness + lateness // 4, now + LONGEST))
        for one in self.open:
            one.ends = max(one.ends, self.held_until(one.station))

    def _count(self, doubt: Doubt) -> int:
        """Close the requests that the replies of an exchange in doubt answer, as late replies; return how late."""
        reply, lateness = doubt.reply, 0
        for request, _ in doubt.asks:
            self._add(request)
        for _, at in doubt.asks:
            found = None if reply is None else self._answered_by(reply)
            if found is not None:
                self.open.remove(found)
                lateness = max(lateness, at - found.at)
                self.last = at
                key = key_of(found.station)
                self._served[key] = at, self._served.get(key, (0, 0))[1]
        self.open.sort(key=lambda one: one.at)
        doubt.asks.clear()
        return lateness

    def ended(self, run: Run) -> None:
        """Note that an exchange ended while its replies were in doubt."""
        doubt, run.doubt = run.doubt, None
        if doubt is not None:
            self._settle(doubt)

    def silent(self, run: Run) -> int:
        """Return 0 if an exchange in doubt may run again, else until when the silence has to last.

        While the line is draining, that is the end of the last open request. A shorter silence shows only that no reply
        is as late as the last late reply; even later replies are possible: where a device works on several requests at
        once, replies overtake each other.
        """
        doubt, now = run.doubt, self._scope.now
        if doubt is None:
            return 0
        if not doubt.is_draining:
            if not doubt.extra:
                return 0
            doubt.equal, end = 0, doubt.extra + silence(now - doubt.extra, max(1, self.within))
            doubt.extra = 0
            return end if end > now else 0
        if (end := self.held_until(doubt.station)) > now:
            return end
        fitting = self._fitting(doubt)
        end = max((one.ends for one in fitting), default=0)
        if end > now:
            self.holds.extend(doubt.station, end)
            return end
        if self._end_drain(doubt, fitting):
            run.doubt = None
        return 0

    def is_endless(self, run: Run) -> bool:
        """Return whether an exchange has been in doubt for so long that it fails."""
        limit = min(MOST_HOLDS * HORIZON * max(1, self.within), 3 * LONGEST)
        return run.doubt is not None and self._scope.now - run.doubt.began > limit


def fresh(value: Any) -> Any:
    """Return a request as it was before it was sent, to be sent once more."""
    if type(value) is FrameValue:
        fields = {name: fresh(one) for name, one in value.fields.items()}
        made = FrameValue(value.frame, fields, None, value.refusal, value.declared, value.unset)
        made.built = value.built
        return made
    if type(value) is dict:
        return {name: fresh(one) for name, one in value.items()}
    return [fresh(one) for one in value] if type(value) is list else value


# ---- functions for generators of sequences --------------------------------------------------------------------------


def missed(run: Run) -> None:
    """Note that the run waits no longer for the reply it has asked for."""
    still_due(run)
    run.asked = None


def still_due(run: Run) -> None:
    """Note that the reply has not come and that the run asks again, or does something else."""
    if run.asked is not None:
        run.machine.late.miss(run, run.asked)


def replied(run: Run) -> None:
    """Note that a row takes the frame that came."""
    asked = run.asked
    run.asked = None
    late = run.machine.late
    if asked is not None and (late.open or late.holds.until or late.slow.number or late.numbered.is_watching):
        late.took(run, asked)


def expect_reply_to_unsent(run: Run) -> None:
    """Note that the reply to a request that has not left yet may come, although the exchange fails now.

    A frame that comes before its request has left is no reply to it.
    """
    first = run.base.x
    if run.clock_waits and first.checks_echo and first.last_sent is not None:
        run.asked = first


def is_numbered(run: Run) -> bool:
    """Return whether the reply that a run waits for carries the number of its request."""
    return run.plan is not None and run.plan.is_numbered


def is_held(machine: Any, run: Run, x: Exchange, value: Any, names: Names | None = None) -> bool:
    """Return whether an exchange has to wait before it sends `value`, or a break.

    A repeat of the bytes that it sent last need not wait: every reply to them is a reply to this request.
    """
    late = machine.late
    if not x.checks_echo or late.held_until(x.station) <= late.heard_until:
        return False
    last = x.last_sent
    is_same = last is not None and type(value) is FrameValue and machine.table.encode(value, names) == last.raw
    return not is_same
