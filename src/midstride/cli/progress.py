"""Events as they come: a line each, and on a terminal the step under way with the time it has taken."""

from __future__ import annotations

from types import TracebackType
from typing import Any

from rich.console import Console
from rich.markup import escape

from midstride.cli.render import event as event_line
from midstride.cli.render import seconds, step_words

# Told at the end, or of no interest to people while it runs.
_QUIET = frozenset({"plan", "outcome", "measured", "command", "up_failed"})


class Progress:
    """Shows a command's progress on a console. Use as a context; feed it the events."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._status = console.status("") if console.is_terminal else None
        self._begun: dict[int, float] = {}
        self._words = self._aside = ""

    def __enter__(self) -> Progress:
        if self._status is not None:
            self._status.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._status is not None:
            self._status.stop()

    def show(self, event: dict[str, Any]) -> None:
        kind = event["kind"]
        if kind == "step":
            self._begun[event["index"]] = event["at"]
            self._doing(f"{event['index'] + 1}/{event['of']} {_words(event)}")
        elif kind == "step_done":
            took = event["at"] - self._begun.get(event["index"], event["at"])
            done = f"  [green]✓[/green] [dim]{event['index'] + 1}/{event['of']}[/dim]"
            self._console.print(f"{done} {escape(_words(event))} [dim]{seconds(took)}[/dim]")
        elif kind == "step_failed":
            place = f"[dim]{event['index'] + 1}/{event['of']}[/dim]"
            self._console.print(f"  [red]✗[/red] {place} {escape(_words(event))}")
        elif kind in {"measuring", "verifying", "waiting"}:
            self._doing(event["words"])
            if self._status is None:
                self._console.print(f"  {escape(event['words'])}")
        elif kind not in _QUIET:
            self._console.print("  ", event_line(event), sep="")

    def aside(self, words: str) -> None:
        """Something to stand beside the step under way, on a terminal: what a component has just said."""
        self._aside = words
        self._doing(self._words)

    def _doing(self, words: str) -> None:
        self._words = words
        if self._status is not None:
            beside = f"   [dim]{escape(self._aside)}[/dim]" if self._aside else ""
            self._status.update(escape(words) + beside)


def _words(event: dict[str, Any]) -> str:
    step = event.get("step")
    return step_words(step) if step else str(event["words"]).partition(" ")[2]
