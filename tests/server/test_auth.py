"""The token over TCP: programs send it as a bearer token, browsers get a cookie; other pages get nothing."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping

import httpx
import pytest
from starlette.responses import PlainTextResponse

from midstride.server.auth import TokenAuth

HERE = "http://127.0.0.1:7420"
TOKEN = "the-token"


def send(
    path: str = "/api/v1",
    headers: Mapping[str, str] = {},
    method: str = "GET",
    base: str = HERE,
    host: str = "127.0.0.1",
) -> httpx.Response:
    app = TokenAuth(PlainTextResponse("passed on"), TOKEN, host=host, port=7420)

    async def request() -> httpx.Response:
        async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url=base) as client:
            return await client.request(method, path, headers=headers)

    return asyncio.run(request())


COOKIE = {"Cookie": f"midstride_7420={TOKEN}"}


def test_a_bearer_token_is_enough_under_any_name() -> None:
    bearer = {"Authorization": f"Bearer {TOKEN}"}
    assert send(headers=bearer).text == "passed on"
    assert send(headers=bearer, method="POST").text == "passed on"
    assert send(headers=bearer, base="http://robot.example").text == "passed on"  # by a proxy


@pytest.mark.parametrize(
    "headers",
    [
        {},
        {"Authorization": TOKEN},
        {"Authorization": "Bearer wrong"},
        {"Authorization": f"Basic {TOKEN}"},
        {"Authorization": "Bearer é"},
        {"Cookie": "midstride_7420=wrong"},
        {"Cookie": f"midstride_7421={TOKEN}"},
        {"Cookie": "\x00;=;;midstride_7420"},
    ],
)
def test_without_the_token_nothing_is_passed_on(headers: dict[str, str]) -> None:
    raw = {name: value.encode() for name, value in headers.items()}
    for path in ("/", "/dashboard/", "/api/v1", "/?token=wrong", f"/api/v1?token={TOKEN}"):
        refused = send(path, raw)  # type: ignore[arg-type]  # httpx takes bytes as they are
        assert (refused.status_code, refused.json()["error"]["kind"]) == (401, "Unauthorized"), path
        assert "set-cookie" not in refused.headers


def test_the_url_gives_a_browser_the_cookie_once() -> None:
    opened = send(f"/?token={TOKEN}")
    assert opened.status_code == 200 and "url=/dashboard/" in opened.text
    name, _, rest = opened.headers["set-cookie"].partition("=")
    value, *attributes = (part.strip().lower() for part in rest.split(";"))
    assert (name, value) == ("midstride_7420", TOKEN)
    assert {"httponly", "samesite=strict", "path=/"} == set(attributes)
    assert opened.headers["cache-control"] == "no-store" and opened.headers["referrer-policy"] == "no-referrer"
    assert TOKEN not in opened.text
    assert send(headers=COOKIE).text == "passed on"


@pytest.mark.parametrize("other", ['layout={"open":true}', "title=two words", "grafana[1]=x", "a,b=c", "flag"])
def test_the_cookies_of_other_servers_on_this_host_are_passed_over(other: str) -> None:
    """A browser sends them, too: cookies do not know ports."""
    for cookies in (f"{other}; midstride_7420={TOKEN}", f"midstride_7420={TOKEN}; {other}"):
        assert send(headers={"Cookie": cookies}).text == "passed on", cookies


@pytest.mark.parametrize("base", ["http://evil.example:7420", "http://evil.example", "http://127.0.0.1.evil.example"])
def test_another_host_name_is_refused(base: str) -> None:
    for path in ("/api/v1", f"/?token={TOKEN}"):
        refused = send(path, COOKIE, base=base)
        assert (refused.status_code, refused.json()["error"]["kind"]) == (403, "Forbidden")
        assert "set-cookie" not in refused.headers


@pytest.mark.parametrize(
    "base", [HERE, "http://localhost:7420", "http://[::1]:7420", "http://192.168.1.7", "http://LOCALHOST"]
)
def test_an_address_and_localhost_are_this_host(base: str) -> None:
    assert send(headers=COOKIE, base=base).text == "passed on"


def test_the_name_that_is_listened_on_is_this_host() -> None:
    assert send(headers=COOKIE, base="http://robot.local:7420", host="robot.local").text == "passed on"
    assert send(headers=COOKIE, base="http://robot.local:7420").status_code == 403


@pytest.mark.parametrize(
    "origin", [None, "null", "http://127.0.0.1:9999", "https://127.0.0.1:7420", "http://evil.example"]
)
def test_a_change_must_come_from_the_page(origin: str | None) -> None:
    headers = COOKIE if origin is None else {**COOKIE, "Origin": origin}
    for method in ("POST", "PUT", "DELETE"):
        assert send(headers=headers, method=method).status_code == 403
    assert send(headers={**COOKIE, "Origin": HERE}, method="POST").text == "passed on"
