"""For tests of what runs inside a component: a callback that raises fails the test, since nothing else notices it."""

from __future__ import annotations

import logging
from collections.abc import Iterator

import pytest


class _Raised(logging.Handler):
    """Collects what asyncio logs of callbacks that have raised."""

    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self.words: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        if record.getMessage().startswith("Exception in callback"):
            self.words.append(self.format(record))


@pytest.fixture(autouse=True)
def callbacks_do_not_raise() -> Iterator[None]:
    handler = _Raised()
    logging.getLogger("asyncio").addHandler(handler)
    yield
    logging.getLogger("asyncio").removeHandler(handler)
    assert not handler.words, "\n".join(handler.words)
