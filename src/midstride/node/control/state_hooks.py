"""The author's functions that export and import the state of a component, run on the data thread in bounded time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, TypeVar

from midstride.errors import CommandRefused, ImportRefused
from midstride.node.author.declaration import Callbacks
from midstride.node.data.functionality_runner import CAUGHT, format_error
from midstride.node.data.mode_switch import DataExecutor
from midstride.wire import replies

T = TypeVar("T")


@dataclass
class StateHooks:
    """Raises CommandRefused with what the author's function raised, or where it does not return in time."""

    callbacks: Callbacks
    data: DataExecutor
    _imported: str = field(default="", init=False)  # whose state
    _asked: str = field(default="", init=False)  # whose state a program outside has been asked to import

    def exports(self, to_changes: bool) -> Literal["nothing", "whole", "changes"]:
        """The export at a cut to a component that can, or cannot, import changes."""
        if (outside := self.callbacks.outside_state) is not None:
            return "whole" if outside.exports else "nothing"
        if self.callbacks.export_state is None:
            return "nothing"
        return "changes" if to_changes and self.callbacks.export_changes is not None else "whole"

    @property
    def imports_changes(self) -> bool:
        return self.callbacks.import_changes is not None

    async def export(self, timeout: float, changes: bool = False) -> bytes | None:
        """The state, or what has changed since it was exported; None where the component keeps none."""
        if self.callbacks.outside_state is not None:
            found = await self.exported(timeout)
            if found.lost is not None:
                raise CommandRefused(f"the state has not been exported: {found.lost}")
            return found.state
        export = self.callbacks.export_changes if changes else self.callbacks.export_state
        if export is None:
            return None
        what = "on_export_changes" if changes else "on_export_state"
        state = await self._run(export, what, timeout)
        if not isinstance(state, (bytes, bytearray)):
            raise CommandRefused(f"{what} returned {type(state).__name__}, not bytes")
        return bytes(state)

    async def exported(self, timeout: float) -> replies.ExportedState:
        """The state of a component that is to end; it is lost where a program outside does not answer."""
        if (outside := self.callbacks.outside_state) is not None and outside.exports:
            return await outside.exported(timeout)
        return replies.ExportedState(state=None if outside is not None else await self.export(timeout))

    async def check_import(self) -> None:
        """Raises CommandRefused where the component cannot import state."""
        if (outside := self.callbacks.outside_state) is not None:
            await outside.require_import()
        elif self.callbacks.import_state is None:
            raise CommandRefused("the component cannot import state: it has no on_import_state")

    async def import_(self, state: bytes, timeout: float, changes: bool = False, exporter: str = "") -> None:
        """Import ``state``, that of the process ``exporter`` once: it may be sent again.

        A manager cannot know whether its last one has had it imported. That may not have ended, so it is looked up
        on the data thread.
        """
        await self.check_import()
        if (outside := self.callbacks.outside_state) is not None:
            if not exporter or exporter != self._imported:
                if exporter and exporter == self._asked:
                    raise CommandRefused(
                        "it was asked to import this state before, and has not done so; it may do so yet, so it is not "
                        "asked again"
                    )
                self._asked = exporter
                try:
                    await outside.import_(state, timeout)
                except ImportRefused:
                    self._asked = ""
                    raise
                self._imported = exporter
            return
        hook = self.callbacks.import_changes if changes else self.callbacks.import_state
        assert hook is not None

        def import_once() -> None:
            if not exporter or exporter != self._imported:
                hook(state)
                self._imported = exporter

        await self._run(import_once, "on_import_changes" if changes else "on_import_state", timeout)

    async def _run(self, function: Callable[[], T], what: str, timeout: float) -> T:
        def guarded() -> T:
            try:
                return function()
            except CAUGHT as error:
                raise CommandRefused(f"{what} raised: {format_error(error)}") from None

        return await self.data.run(guarded, timeout)
