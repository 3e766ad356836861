"""Rich's console and table, on which control characters in what is shown appear escaped."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from midstride.model.printable import printable


class PrintableConsole(Console):
    """Escapes text after it is rendered; the console's own codes, for colours and cursor, are added later."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        for segment in super().render(renderable, options):
            yield segment if segment.control else segment._replace(text=printable(segment.text))


class PrintableTable(Table):
    """Escapes its cells before they are measured, since escaped text is longer."""

    def add_row(self, *cells: RenderableType | None, **options: Any) -> None:
        for cell in cells:
            if isinstance(cell, Text):
                cell.plain = printable(cell.plain)
        super().add_row(*(printable(cell) if isinstance(cell, str) else cell for cell in cells), **options)
