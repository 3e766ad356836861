"""Events as they come: one line each, and on a terminal the current step and how long it has taken."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape

from midstride.cli.render import event as event_line
from midstride.cli.render import seconds, step_text

if TYPE_CHECKING:
    from midstride.runtime.records.reports import Event

# Shown at the end of the command, or not worth a line while it runs.
_HIDDEN = frozenset({"plan", "outcome", "measured", "command", "up_failed"})


class Progress:
    """Shows a command's progress on a console. Use it as a context and pass it the events."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._status = console.status("") if console.is_terminal else None
        self._started: dict[int, float] = {}
        self._current = self._note = ""

    def __enter__(self) -> Progress:
        if self._status is not None:
            self._status.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._status is not None:
            self._status.stop()

    def show(self, event: Event) -> None:
        kind, index = event.kind, event.index or 0
        number = f"{index + 1}/{event.total}"
        if kind == "step":
            self._started[index] = event.at
            self._set_current(f"{number} {_step(event)}")
        elif kind == "step_done":
            took = event.at - self._started.get(index, event.at)
            done = f"  [green]✓[/green] [dim]{number}[/dim]"
            self._console.print(f"{done} {escape(_step(event))} [dim]{seconds(took)}[/dim]")
        elif kind == "step_failed":
            self._console.print(f"  [red]✗[/red] [dim]{number}[/dim] {escape(_step(event))}")
        elif kind in {"measuring", "verifying", "waiting"}:
            self._set_current(event.words)
            if self._status is None:
                self._console.print(f"  {escape(event.words)}")
        elif kind not in _HIDDEN:
            self._console.print("  ", event_line(event), sep="")

    def set_note(self, note: str) -> None:
        """Show a note beside the current step, on a terminal: the latest log line of a component."""
        self._note = note
        self._update()

    def _set_current(self, step: str) -> None:
        self._current = step
        self._update()

    def _update(self) -> None:
        if self._status is not None:
            note = f"   [dim]{escape(self._note)}[/dim]" if self._note else ""
            self._status.update(escape(self._current) + note)


def _step(event: Event) -> str:
    return step_text(event.step) if event.step else event.words.partition(" ")[2]
