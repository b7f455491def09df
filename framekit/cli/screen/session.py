"""What the live display shows: a session. Each verb that can be shown makes one of its own kind."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from framekit.api.monitor import LiveView


class LiveSession:
    """Something that can be watched. `begin` is called inside the loop and gives what is to be shown."""

    title = ""
    problems: list[str]
    """What is told when it is over."""
    lost = False
    """Whether something is lost that should have been kept."""
    failure: Exception | None = None
    """Why it could not go on."""
    controls = False
    """Whether it takes control lines."""

    def control(self, line: str) -> str:
        """Carries a control line out; why not, when it cannot be."""
        raise NotImplementedError

    def begin(self) -> LiveView:
        raise NotImplementedError

    def step(self, duration: int) -> None:
        """So much real time (ns) has passed."""

    @property
    def is_over(self) -> bool:
        """Whether its time is up."""
        return False

    async def end(self) -> None:
        raise NotImplementedError
