"""The dashboard's files: types, policy, revalidation, and nothing outside of their folder."""

from __future__ import annotations

import asyncio
import os
from pathlib import Path

import httpx
import pytest
from fastapi import FastAPI

from midstride.server.static import FOLDER, dashboard

CSP = "content-security-policy"


class Client:
    """Of an application that serves nothing but the files of ``folder``."""

    def __init__(self, folder: Path) -> None:
        app = FastAPI()
        app.include_router(dashboard(folder))
        self._transport = httpx.ASGITransport(app)

    def get(self, path: str, headers: dict[str, str] | None = None, method: str = "GET") -> httpx.Response:
        async def send() -> httpx.Response:
            async with httpx.AsyncClient(transport=self._transport, base_url="http://manager") as client:
                return await client.request(method, path, headers=headers)

        return asyncio.run(send())


@pytest.fixture
def client(tmp_path: Path) -> Client:
    folder = tmp_path / "dashboard"
    (folder / "graph").mkdir(parents=True)
    (folder / "index.html").write_text("<!doctype html>")
    (folder / "graph" / "layout.js").write_text("export {};")
    (tmp_path / "secret.js").write_text("secret")
    (folder / "link.js").symlink_to(tmp_path / "secret.js")
    return Client(folder)


def test_the_start_leads_to_the_page(client: Client) -> None:
    for path in ("/", "/dashboard"):
        response = client.get(path)
        assert (response.status_code, response.headers["location"]) == (307, "/dashboard/")
    assert client.get("/dashboard/").text == "<!doctype html>"


def test_types_and_policy(client: Client) -> None:
    page, script = client.get("/dashboard/"), client.get("/dashboard/graph/layout.js")
    assert page.headers["content-type"] == "text/html; charset=utf-8"
    assert script.headers["content-type"] == "text/javascript; charset=utf-8"
    for response in (page, script):
        policy = {
            name: rest for name, _, rest in (part.strip().partition(" ") for part in response.headers[CSP].split(";"))
        }
        assert policy["default-src"] == "'none'"
        assert policy["script-src"] == policy["worker-src"] == policy["connect-src"] == policy["style-src"] == "'self'"
        assert "unsafe" not in response.headers[CSP] and "*" not in response.headers[CSP]
        assert response.headers["x-content-type-options"] == "nosniff"


def test_a_file_is_sent_again_only_if_it_has_changed(client: Client, tmp_path: Path) -> None:
    first = client.get("/dashboard/")
    assert first.headers["cache-control"] == "no-cache"
    again = client.get("/dashboard/", headers={"If-None-Match": f'W/"x", {first.headers["etag"]}'})
    assert (again.status_code, again.content, again.headers["etag"]) == (304, b"", first.headers["etag"])
    assert CSP in again.headers
    (tmp_path / "dashboard" / "index.html").write_text("<!DOCTYPE html>")  # of the same length
    changed = client.get("/dashboard/", headers={"If-None-Match": first.headers["etag"]})
    assert (changed.status_code, changed.text) == (200, "<!DOCTYPE html>")


def test_the_script_is_made_of_the_modules_as_they_are(client: Client, tmp_path: Path) -> None:
    assert client.get("/dashboard/page.js").status_code == 404  # there is no module that it begins with
    folder = tmp_path / "dashboard"
    (folder / "main.js").write_text('import { one } from "./graph/one.js";\nconsole.log(one);\n')
    (folder / "graph" / "one.js").write_text("export const one = 1;\n")
    first = client.get("/dashboard/page.js")
    assert first.headers["content-type"] == "text/javascript; charset=utf-8" and CSP in first.headers
    assert first.text.index("const one = 1;") < first.text.index("console.log(one);") and "import" not in first.text
    (folder / "graph" / "one.js").write_text("export const one = 2;\n")
    os.utime(folder / "graph" / "one.js", (2_000_000_000, 2_000_000_000))
    changed = client.get("/dashboard/page.js", headers={"If-None-Match": first.headers["etag"]})
    assert changed.status_code == 200 and "const one = 2;" in changed.text


def test_head_has_the_headers_alone(client: Client) -> None:
    response = client.get("/dashboard/", method="HEAD")
    assert response.status_code == 200 and response.content == b""
    assert response.headers["content-length"] == str(len("<!doctype html>"))


@pytest.mark.parametrize(
    "name",
    "../secret.js %2e%2e/secret.js ..%2fsecret.js graph/..%2f..%2fsecret.js /etc/passwd link.js graph a%00b".split(),
)
def test_there_is_no_other_file(client: Client, name: str) -> None:
    response = client.get(f"/dashboard/{name}")
    assert response.status_code == 404 and "secret" not in response.text


def test_the_layout_engine_is_there_with_its_licence() -> None:
    vendored = FOLDER / "vendor" / "elkjs"
    assert (vendored / "LICENSE.md").read_text(encoding="utf-8").startswith("# Eclipse Public License - v 2.0")
    assert '"version": "0.12.1"' in (vendored / "package.json").read_text(encoding="utf-8")
    assert (vendored / "elk-worker.min.js").stat().st_size > 1_000_000
