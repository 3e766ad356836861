"""A browser on the dashboard of a real manager, whose system runs on the simulator."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, BrowserContext, Error, Page, expect, sync_playwright

from tests.cli.conftest import EXAMPLES, Midstride, running
from tests.server.support import free_port

CHROMIUM = "/usr/bin/chromium"
# How long a page may take to show something on a busy machine (ms).
PATIENCE = 90_000
expect.set_options(timeout=PATIENCE)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Until the end of the module: while it lives, this thread has an event loop, and other tests need theirs."""
    with sync_playwright() as playwright:
        # As root, Chromium has no sandbox; the pages are ours.
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu"])
        yield browser
        browser.close()


@dataclass
class System:
    """A running system, and the address and token of its manager."""

    midstride: Midstride
    name: str
    file: Path
    port: int
    options: tuple[str, ...] = ()
    faults: list[str] = field(default_factory=list)
    http: bool = True

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}/dashboard/"

    @property
    def token(self) -> str:
        return (self.midstride.runtime / "midstride" / self.name / "token").read_text()

    def up(self) -> None:
        http = ("--http", str(self.port)) if self.http else ()
        done = self.midstride("up", str(self.file), "--backend", "sim", "--detach", *http, *self.options, timeout=100)
        assert done.status == 0, done.err

    def kill_manager(self) -> None:
        """As a crash ends it: the simulator's components live in its process, and go with it."""
        pid = self.midstride.manager(self.name)
        os.kill(pid, signal.SIGKILL)
        deadline = time.monotonic() + 20
        while Path(f"/proc/{pid}").exists() and time.monotonic() < deadline:
            time.sleep(0.05)

    def context(self, browser: Browser, **options: Any) -> BrowserContext:
        """A browser's window with the manager's token. Errors on its pages go to ``faults``."""
        context = browser.new_context(
            extra_http_headers={"Authorization": f"Bearer {self.token}"},
            **{"viewport": {"width": 1280, "height": 800}, **options},
        )
        context.set_default_timeout(PATIENCE)
        context.on("weberror", lambda error: self.faults.append(str(error.error)))
        context.on("console", lambda message: self._heard(message.type, message.text))
        return context

    def _heard(self, kind: str, text: str) -> None:
        if kind == "error" and "Failed to load resource" not in text:  # that is the manager going away
            self.faults.append(text)


@contextmanager
def system(name: str, file: Path, *options: str) -> Iterator[System]:
    for midstride in running():
        found = System(midstride, name, file, free_port(), options)
        found.up()
        yield found


@pytest.fixture(scope="module")
def talker() -> Iterator[System]:
    """The talker and its listener; tests leave them as they found them."""
    with system("talker", EXAMPLES / "talker" / "talker.stride") as found:
        yield found


@pytest.fixture
def own_talker() -> Iterator[System]:
    """The same for a test that changes them."""
    with system("talker", EXAMPLES / "talker" / "talker.stride") as found:
        yield found


Opened = Callable[..., Page]


@pytest.fixture
def opened(browser: Browser) -> Iterator[Opened]:
    """Opens the dashboard of a system in a new window, and waits for its graph. No page may have had an error."""
    contexts: list[tuple[BrowserContext, System]] = []

    def open_page(system: System, **options: Any) -> Page:
        context = system.context(browser, **options)
        contexts.append((context, system))
        page = context.new_page()
        page.goto(system.url)
        page.wait_for_selector(".graph .component[transform], .graph .collapsed[transform]")
        return page

    yield open_page
    for context, opened_system in contexts:
        with suppress(Error):  # the browser has gone
            context.close()
        assert opened_system.faults == []
