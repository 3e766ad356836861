"""The whole API, generated from its OpenAPI document: no internal error, no undocumented answer, each as described."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import jsonschema  # type: ignore[import-untyped, unused-ignore]  # with its stubs or without
import pytest

from tests.cli.conftest import EXAMPLES, running
from tests.server.support import free_port

# Operations that do not end, or end the manager, or take seconds each time: the other tests are about them.
EXCLUDED = ("/api/v1/view/stream", "/api/v1/down", "/api/v1/rehearsal")
# A schema cannot say that names are declared and that a command is not empty (`midstride check` does).
UNSTATED = "positive_data_acceptance"


@pytest.fixture
def api() -> Iterator[httpx.Client]:
    """A client of the API of the talker on the simulator, over TCP."""
    for midstride in running():
        port = free_port()
        specification = str(EXAMPLES / "talker" / "talker.stride")
        done = midstride("up", specification, "--backend", "sim", "--detach", "--http", str(port))
        assert done.status == 0, done.err
        token = (midstride.runtime / "midstride" / "talker" / "token").read_text()
        headers = {"Authorization": f"Bearer {token}"}
        with httpx.Client(base_url=f"http://127.0.0.1:{port}/api/v1", headers=headers, timeout=60) as client:
            yield client


@pytest.mark.parametrize(
    ("phases", "examples"),
    [
        pytest.param("examples,fuzzing", 30, marks=pytest.mark.full, id="drawn"),
        pytest.param("examples,coverage,fuzzing", 300, marks=pytest.mark.long, id="with every boundary of a schema"),
    ],
)
@pytest.mark.timeout(600)
def test_every_answer_is_a_documented_one(phases: str, examples: int, api: httpx.Client, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "schemathesis.cli", "--no-color", "run", f"{api.base_url}openapi.json"]
    command += ["--header", f"Authorization: {api.headers['Authorization']}", "--request-timeout", "60"]
    command += ["--phases", phases, "--max-examples", str(examples), "--generation-deterministic"]
    command += ["--exclude-checks", UNSTATED]
    for path in EXCLUDED:
        command += ["--exclude-path", path]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=580, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "23 selected / 26 total" in done.stdout


def conforms(response: httpx.Response, document: dict[str, Any], path: str, method: str) -> None:
    """The status is documented, and the body is what is documented for it."""
    described = document["paths"][f"/api/v1{path}"][method]["responses"][str(response.status_code)]["content"]
    media_type = response.headers["content-type"].partition(";")[0]
    schema = {**described[media_type].get("schema", {}), "components": document["components"]}
    if media_type == "application/json":
        jsonschema.Draft202012Validator(schema).validate(response.json())


@pytest.mark.full
def test_a_rehearsal_is_as_documented(api: httpx.Client) -> None:
    document = api.get("/openapi.json").json()
    swap = {"replace": [["talker", "NewTalker"]]}
    rehearsals: list[tuple[int, object]] = [
        (200, {"request": swap, "seeds": 1}),
        (409, {"request": {"remove": ["nobody"]}, "seeds": 1}),
        (422, {"request": swap, "seeds": 0}),
        (422, {"request": swap, "seconds": 1e9}),
        (422, {"seeds": 1}),
        (422, []),
    ]
    for status, rehearsal in rehearsals:
        response = api.post("/rehearsal", json=rehearsal)
        assert response.status_code == status, response.text
        conforms(response, document, "/rehearsal", "post")


@pytest.mark.full
def test_the_event_stream_and_the_end_are_as_documented(api: httpx.Client) -> None:
    document = api.get("/openapi.json").json()
    event = {"$ref": "#/components/schemas/Event", "components": document["components"]}
    numbers = ("", "0", "1", "-1", "x", "1.5", "9" * 30, "9" * 5000, "\u00e9")
    for number in numbers:
        only = {"only": "event"}
        for params, headers in ((only | {"since": number}, {}), (only, {b"Last-Event-ID": number.encode()})):
            with api.stream("GET", "/view/stream", params=params, headers=headers) as response:
                if response.status_code != 200:
                    response.read()
                    conforms(response, document, "/view/stream", "get")
                    continue
                conforms(response, document, "/view/stream", "get")
                data = (line for line in response.iter_lines() if line.startswith("data: "))
                jsonschema.Draft202012Validator(event).validate(json.loads(next(data).removeprefix("data: ")))
    down = api.post("/down")
    assert down.status_code == 200
    conforms(down, document, "/down", "post")
