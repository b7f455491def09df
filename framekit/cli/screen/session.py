"""What the live display shows: a session that can be watched; each verb with a display has one of its own."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from framekit.api.monitor import LiveView


class LiveSession:
    """Something that can be watched, for `duration` ns or until it is ended.

    `problems` is told when it is over; `lost`: something is lost that should have been kept; `failure`: why it could
    not go on; `controls`: it takes control lines.
    """

    lost = False
    failure: Exception | None = None
    controls = False

    def __init__(self, title: str, duration: int | None) -> None:
        self.title = title
        self.duration = duration
        self.problems: list[str] = []
        self.view: LiveView | None = None

    def control(self, line: str) -> str:
        """Carries a control line out; why not, when it cannot be."""
        raise NotImplementedError

    def begin(self) -> LiveView:
        """Called inside the loop; what is to be shown, which is `view` from then on."""
        raise NotImplementedError

    def step(self, duration: int) -> None:
        """So much real time (ns) has passed."""

    @property
    def is_over(self) -> bool:
        """Return whether its time is up, or it could not go on."""
        late = self.duration is not None and self.view is not None and self.view.elapsed >= self.duration
        return late or self.failure is not None

    async def end(self) -> None:
        raise NotImplementedError
