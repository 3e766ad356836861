"""Events as they come: one line each, and on a terminal the current step and how long it has taken."""

from __future__ import annotations

from typing import Any

from rich.console import Console
from rich.markup import escape

from midstride.cli.render import event as event_line
from midstride.cli.render import seconds, step_text

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

    def show(self, event: dict[str, Any]) -> None:
        kind = event["kind"]
        if kind == "step":
            self._started[event["index"]] = event["at"]
            self._set_current(f"{event['index'] + 1}/{event['total']} {_step(event)}")
        elif kind == "step_done":
            took = event["at"] - self._started.get(event["index"], event["at"])
            done = f"  [green]✓[/green] [dim]{event['index'] + 1}/{event['total']}[/dim]"
            self._console.print(f"{done} {escape(_step(event))} [dim]{seconds(took)}[/dim]")
        elif kind == "step_failed":
            number = f"[dim]{event['index'] + 1}/{event['total']}[/dim]"
            self._console.print(f"  [red]✗[/red] {number} {escape(_step(event))}")
        elif kind in {"measuring", "verifying", "waiting"}:
            self._set_current(event["words"])
            if self._status is None:
                self._console.print(f"  {escape(event['words'])}")
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


def _step(event: dict[str, Any]) -> str:
    step = event.get("step")
    return step_text(step) if step else str(event["words"]).partition(" ")[2]
