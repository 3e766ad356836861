"""`midstride dashboard` in a browser: a token in the URL once, then a cookie, and a manager that goes away."""

from __future__ import annotations

import re
import signal
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest
from playwright.sync_api import Browser, BrowserContext, Page, expect

from tests.browser.conftest import PATIENCE, System
from tests.browser.test_changes import choose, components, press
from tests.cli.conftest import EXAMPLES, running
from tests.server.support import free_port

pytestmark = [pytest.mark.browser, pytest.mark.full]


@dataclass
class Gateway:
    """A system whose manager listens on its Unix socket alone, and the command that leads to it."""

    system: System
    process: subprocess.Popen[str]
    url: str

    @property
    def address(self) -> str:
        return self.url.partition("/?")[0]

    @property
    def token(self) -> str:
        return self.url.partition("token=")[2]


def opened_gateway(system: System) -> Gateway:
    process = system.midstride.start("dashboard", "talker", "--no-browser", "--port", str(system.port))
    assert process.stdout is not None
    line = process.stdout.readline()
    found = re.search(r"http://\S+", line)
    assert found is not None, line
    return Gateway(system, process, found[0])


def ended(gateway: Gateway) -> None:
    gateway.process.send_signal(signal.SIGINT)
    try:
        gateway.process.wait(20)
    finally:
        gateway.process.kill()
        gateway.process.wait()
        assert gateway.process.stdout is not None
        gateway.process.stdout.close()


@pytest.fixture
def gateway() -> Iterator[Gateway]:
    for midstride in running():
        system = System(midstride, "talker", EXAMPLES / "talker" / "talker.stride", free_port(), http=False)
        system.up()
        found = opened_gateway(system)
        yield found
        if found.process.poll() is None:
            ended(found)


@pytest.fixture
def window(browser: Browser) -> Iterator[BrowserContext]:
    """A browser's window that has been given nothing."""
    context = browser.new_context(viewport={"width": 1280, "height": 800})
    context.set_default_timeout(PATIENCE)
    faults: list[str] = []
    context.on("weberror", lambda error: faults.append(str(error.error)))
    yield context
    context.close()
    assert faults == []


class Elsewhere(BaseHTTPRequestHandler):
    """A page of another program of this machine."""

    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        self.wfile.write(b"<p>elsewhere</p>")

    def log_message(self, *_: object) -> None:
        pass


@contextmanager
def another_server() -> Iterator[str]:
    with HTTPServer(("127.0.0.1", 0), Elsewhere) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_port}/"
        finally:
            server.shutdown()
            thread.join()


def tab(window: BrowserContext, url: str) -> Page:
    page = window.new_page()
    page.goto(url)
    expect(page.locator(".component")).to_have_count(2)
    return page


def test_the_token_is_in_the_url_once_and_then_in_a_cookie_that_no_script_reads(
    gateway: Gateway, window: BrowserContext, browser: Browser
) -> None:
    page = tab(window, gateway.url)
    expect(page.locator("#connection")).to_have_text("● live")
    assert page.url == f"{gateway.address}/dashboard/"
    assert gateway.token not in page.content()
    assert page.evaluate("document.cookie") == ""
    assert (
        page.evaluate("[...Object.values(localStorage), ...Object.values(sessionStorage)].join()").find(gateway.token)
        == -1
    )
    [cookie] = window.cookies()
    assert (cookie["value"], cookie["httpOnly"], cookie["sameSite"]) == (gateway.token, True, "Strict")

    other = tab(window, f"{gateway.address}/dashboard/")  # the second tab needs no token
    choose(page, "talker", "NewTalker")
    press(page, "Plan")
    press(page, "Execute")
    expect(page.locator("#change .outcome")).to_contain_text("Done in")
    expect(other.locator('.component[data-name="talker_2"]')).to_be_visible()
    assert components(gateway.system)["talker"] == "NewTalker"

    stranger = browser.new_context()
    answer = stranger.new_page().goto(f"{gateway.address}/dashboard/")
    assert answer is not None and answer.status == 401
    stranger.close()


def test_a_page_of_another_port_changes_nothing_although_the_browser_sends_the_cookie(
    gateway: Gateway, window: BrowserContext
) -> None:
    """To a browser, all ports of an address are one site, so that `SameSite` does not keep the cookie back."""
    tab(window, gateway.url)
    page = window.new_page()
    send = """(url) => fetch(url, {method: "POST", mode: "no-cors", credentials: "include",
        body: JSON.stringify({request: {remove: ["talker"]}})}).then(() => null)"""
    with another_server() as elsewhere:
        page.goto(elsewhere)
        with page.expect_response("**/api/v1/change") as refused:
            page.evaluate(send, f"{gateway.address}/api/v1/change")
    assert refused.value.status == 403, "without the cookie it would be 401"
    assert components(gateway.system) == {"talker": "Talker", "listener": "Listener"}


def test_two_tabs_say_that_the_manager_is_away_and_go_on_when_it_is_back(
    gateway: Gateway, window: BrowserContext
) -> None:
    pages = [tab(window, gateway.url), tab(window, f"{gateway.address}/dashboard/")]
    for page in pages:
        page.evaluate("window.notReloaded = true")
    gateway.system.kill_manager()
    for page in pages:
        expect(page.locator("#connection")).to_have_text("✕ connection lost")
        expect(page.locator("#stale")).to_contain_text("no manager of talker answers; `midstride up FILE` starts one")
        expect(page.locator(".component")).to_have_count(2)
    late = window.new_page()  # the page itself comes from the command
    late.goto(f"{gateway.address}/dashboard/")
    expect(late.locator("#stale")).to_contain_text("no manager of talker answers")
    gateway.system.up()
    for page in pages:
        expect(page.locator("#connection")).to_have_text("● live")
        expect(page.locator("#stale")).to_be_hidden()
        assert page.evaluate("window.notReloaded") is True
    expect(late.locator(".component")).to_have_count(2)
    choose(late, "talker", "NewTalker")
    press(late, "Plan")
    expect(late.locator("#change .change-result .step")).to_have_count(4)


def test_a_page_of_an_earlier_command_says_that_it_is_refused(gateway: Gateway, window: BrowserContext) -> None:
    page = tab(window, gateway.url)
    ended(gateway)
    expect(page.locator("#connection")).to_have_text("✕ connection lost")
    later = opened_gateway(gateway.system)
    try:
        expect(page.locator("#connection")).to_have_text("✕ refused")
        expect(page.locator("#stale")).to_contain_text("midstride dashboard")
        page.goto(later.url)
        expect(page.locator("#connection")).to_have_text("● live")
    finally:
        ended(later)
