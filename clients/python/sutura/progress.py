"""How a build goes, as progress bars on a terminal or in a notebook."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from tqdm.auto import tqdm

from .documents import Event


class ProgressBars:
    """One bar for each stage, in the order in which the stages come."""

    def __init__(self) -> None:
        """Show nothing yet."""
        self._stage: str | None = None
        self._bar: Any = None

    def __call__(self, event: Event) -> None:
        """Show an event."""
        if event.event != "stage" or event.stage is None:
            return
        if event.stage != self._stage:
            self.close()
            self._stage = event.stage
            form = "{desc:<14}{percentage:3.0f} % |{bar}| {elapsed}"
            self._bar = tqdm(total=1.0, desc=event.stage, bar_format=form)
        self._bar.update((event.progress or 0.0) - self._bar.n)

    def close(self) -> None:
        """Complete the bar of the current stage."""
        if self._bar is not None:
            self._bar.update(1.0 - self._bar.n)
            self._bar.close()
        self._bar, self._stage = None, None


def listener(progress: bool | Callable[[Event], None]) -> tuple[Callable[[Event], None], Any]:
    """What hears the events of a wait, and what to close behind it."""
    if progress is True:
        bars = ProgressBars()
        return bars, bars
    if progress is False:
        return lambda _: None, None
    return progress, None
