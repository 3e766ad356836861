"""What the HTTP API makes of requests, answers and failures."""

from __future__ import annotations

import asyncio
import json
import re
import threading
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from pathlib import Path
from typing import Any

import httpx
import jsonschema  # type: ignore[import-untyped, unused-ignore]  # with its stubs or without
import msgspec
import pytest

from midstride import errors
from midstride.backends.simulator import Simulator
from midstride.codec.form import encode
from midstride.codec.reading import parse_json
from midstride.codec.specification_form import SpecificationForm
from midstride.model.specification import initial
from midstride.plan.forms.plan_forms import encode_plan
from midstride.plan.strategies.registry import STRATEGIES
from midstride.runtime.manager import Manager
from midstride.runtime.records.reports import DownReport, PlannedChange
from midstride.server import requests
from midstride.server.http_app import create_app
from midstride.server.manager_lifecycle import Lifecycle
from midstride.server.openapi import FORMS
from midstride.server.requests import LARGEST_BODY
from midstride.server.view.live import LiveView
from tests.plan.cases import replacing
from tests.planting import plant
from tests.runtime.systems import managed, replace
from tests.server.scripted import ScriptedManager

Test = Callable[[httpx.AsyncClient, ScriptedManager, Lifecycle], Coroutine[Any, Any, None]]


def served(test: Test, *, up: bool = True) -> None:
    """Run ``test`` against the application, without sockets."""

    async def run() -> None:
        manager = ScriptedManager()
        lifecycle = Lifecycle(manager.as_manager)
        app = create_app(LiveView(lifecycle))
        transport = httpx.ASGITransport(app, raise_app_exceptions=False)
        async with httpx.AsyncClient(transport=transport, base_url="http://manager/api/v1") as client:
            if up:
                await lifecycle.bring_up()
            await test(client, manager, lifecycle)

    asyncio.run(run())


def error_of(response: httpx.Response) -> tuple[int, str, str]:
    told = response.json()["error"]
    return response.status_code, told["kind"], told["message"]


def test_who_answers() -> None:
    async def test(client: httpx.AsyncClient, _: ScriptedManager, lifecycle: Lifecycle) -> None:
        assert (await client.get("http://manager/api/v1")).json()["phase"] == "starting"
        await lifecycle.bring_up()
        document = (await client.get("http://manager/api/v1")).json()
        assert (document["system"], document["backend"], document["phase"]) == ("talker", "scripted", "up")

    served(test, up=False)


CHANGING = ("/check", "/plan", "/rehearsal", "/change", "/parameters", "/lock", "/unlock", "/dead", "/down")


def test_the_openapi_document_has_every_operation() -> None:
    async def test(client: httpx.AsyncClient, _: ScriptedManager, __: Lifecycle) -> None:
        document = (await client.get("/openapi.json")).json()
        assert {f"/api/v1{path}" for path in CHANGING} == {
            path for path, operations in document["paths"].items() if "post" in operations
        }
        reading = ("", "/up", "/programs", "/configuration", "/specification", "/parameters", "/why", "/log")
        viewing = ("/view", "/view/stream", "/view/timeline", "/view/at")
        assert {
            f"/api/v1{path}"
            for path in (*reading, *viewing, "/change", "/history", "/report", "/specification/earlier")
        } | {"/metrics"} == {path for path, operations in document["paths"].items() if "get" in operations}
        strategies = document["components"]["schemas"]["ChangeRequest"]["properties"]["strategy"]["enum"]
        assert strategies == ["minimal", "paper", "quiesce", "stop"]

    served(test)


def references(value: Any) -> Iterator[str]:
    if isinstance(value, dict):
        if isinstance(value.get("$ref"), str):
            yield value["$ref"]
        value = list(value.values())
    if isinstance(value, list):
        for item in value:
            yield from references(item)


TEXTS = {
    "/api/v1/view/stream": "text/event-stream",
    "/api/v1/report": "text/html",
    "/metrics": "text/plain",
}


def test_the_openapi_document_describes_every_body_and_refers_to_nothing_else() -> None:
    async def test(client: httpx.AsyncClient, _: ScriptedManager, __: Lifecycle) -> None:
        document = (await client.get("/openapi.json")).json()
        schemas = document["components"]["schemas"]
        assert {reference.rpartition("/")[2] for reference in references(document)} <= set(schemas)
        for path, operations in document["paths"].items():
            for method, operation in operations.items():
                (media,) = operation["responses"]["200"]["content"]
                expected = TEXTS.get(path, "application/json")
                assert media == expected, (method, path)
                assert path in TEXTS or list(references(operation["responses"]["200"])), (method, path)
                assert {"401", "409", "422", "500", "502", "504"} <= set(operation["responses"])
                for status, response in operation["responses"].items():
                    assert status == "200" or list(references(response)) == ["#/components/schemas/Failure"]
        bodies = {
            path: list(references(operations["post"].get("requestBody")))
            for path, operations in document["paths"].items()
            if "post" in operations
        }
        assert bodies == {
            "/api/v1/plan": ["#/components/schemas/ChangeRequest"],
            "/api/v1/check": ["#/components/schemas/SubmittedText"],
            "/api/v1/rehearsal": ["#/components/schemas/SubmittedRehearsal"],
            "/api/v1/change": ["#/components/schemas/SubmittedChange"],
            "/api/v1/parameters": ["#/components/schemas/ParameterSetting"],
            "/api/v1/lock": ["#/components/schemas/LockRequest"],
            "/api/v1/unlock": ["#/components/schemas/UnlockRequest"],
            "/api/v1/dead": ["#/components/schemas/DeathRequest"],
            "/api/v1/down": [],
        }
        for name, needed in {"Outcome": "plan", "SystemView": "crashed", "Event": "words"}.items():
            assert needed in schemas[name]["properties"]
        for schema in schemas.values():
            jsonschema.Draft202012Validator.check_schema(schema)

    served(test)


def test_what_the_manager_reports_is_what_the_openapi_document_describes(tmp_path: Path) -> None:
    """Every answer of a system in the simulator, through a change that degrades and one that is refused."""

    async def body(manager: Manager, _: Simulator) -> dict[str, list[bytes]]:
        plan = await manager.plan(replace("talker", "NewTalker"))
        outcome = await manager.change(replace("talker", "NewTalker", "paper"), id="mine")
        refused = await manager.change(replace("talker", "NewTalker"), expected=-1)
        return {
            "PlannedChange": [msgspec.json.encode(PlannedChange.of(plan, revision=7))],
            "Outcome": [msgspec.json.encode(outcome), msgspec.json.encode(refused)],
            "SystemView": [msgspec.json.encode(LiveView(Lifecycle(manager)).view(await manager.status()))],
            "LiveConfiguration": [msgspec.json.encode(await manager.live())],
            "Why": [msgspec.json.encode(await manager.why("listener.listen"))],
            "Event": [msgspec.json.encode(event) for event in manager.log()],
            "SpecificationForm": [msgspec.json.encode(SpecificationForm.of(manager.specification))],
        }

    app = create_app(LiveView(Lifecycle(ScriptedManager().as_manager)))
    components = app.openapi()["components"]
    for name, bodies in managed("talker", tmp_path, body).items():
        schema = {"$ref": f"#/components/schemas/{name}", "components": components}
        form = next(form for form in FORMS if form.__name__ == name)
        for text in bodies:
            jsonschema.Draft202012Validator(schema).validate(json.loads(text))
            again = msgspec.json.encode(msgspec.json.decode(text, type=form))
            assert json.loads(again) == json.loads(text)


def test_every_operation_is_in_the_documentation() -> None:
    app = create_app(LiveView(Lifecycle(ScriptedManager().as_manager)))
    served = {(method.upper(), path) for path, methods in app.openapi()["paths"].items() for method in methods}
    page = (Path(__file__).parents[2] / "docs" / "http.md").read_text(encoding="utf-8")
    assert set(re.findall(r"^- `([A-Z]+) (/api/v1[a-z/]*|/metrics)", page, re.MULTILINE)) == served


def test_answers_pass_through_whole() -> None:
    async def test(client: httpx.AsyncClient, manager: ScriptedManager, _: Lifecycle) -> None:
        manager.answers["programs"] = [{"a field of next year": [None, 0.25]}]
        assert (await client.get("/programs")).json() == manager.answers["programs"]
        manager.answers["why"] = {"functionality": "listener.listen", "chain": []}
        assert (await client.get("/why", params={"functionality": "listener.listen"})).json() == manager.answers["why"]
        assert manager.asked[-1] == ("why", "listener.listen")

    served(test)


def test_the_specification_is_the_running_one() -> None:
    async def test(client: httpx.AsyncClient, _: ScriptedManager, __: Lifecycle) -> None:
        document = (await client.get("/specification")).json()
        assert document["nodes"]["talker"] == {"component": "Talker", "attachments": {"out": ["/chatter"]}}

    served(test)


def test_a_plan_comes_with_the_revision_it_was_made_for() -> None:
    async def test(client: httpx.AsyncClient, manager: ScriptedManager, _: Lifecycle) -> None:
        change = replacing(initial(manager.specification), manager.specification, "talker", "NewTalker")
        manager.answers["plan"] = plan = STRATEGIES["paper"](change)
        response = await client.post("/plan", json={"replace": [["talker", "NewTalker"]], "strategy": "paper"})
        assert response.json() == {**encode_plan(plan), "revision": 7}
        request = manager.asked[-1][1]
        assert (request.replace, request.strategy) == ((("talker", "NewTalker"),), "paper")

    served(test)


def test_a_change_is_asked_with_the_revision_it_was_shown_at() -> None:
    async def test(client: httpx.AsyncClient, manager: ScriptedManager, _: Lifecycle) -> None:
        manager.answers["change"] = {"outcome": "done", "swaps": [{"gap": None}]}
        added = {"role": "second", "component": "Listener", "attachments": {"in": ["/chatter"]}}
        response = await client.post("/change", json={"request": {"add": [added]}, "expected": 3, "verify": True})
        assert response.json() == manager.answers["change"]
        request, expected, verify = manager.asked[-1][1]
        assert (expected, verify) == (3, True)
        assert (request.add[0].role, request.add[0].attachments["in"]) == ("second", ("/chatter",))

    served(test)


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ({"replce": []}, ["/replce", "did you mean `replace`?"]),
        ({"strategy": "fast"}, ["/strategy", "minimal, paper, quiesce"]),
        ({"replace": [["talker"]], "remove": "talker"}, ["/replace/0/1", "/remove"]),
        ({"add": [{"role": "second"}]}, ["/add/0", "needs the key `component`"]),
        ({"to": {"system": "talker", "topcs": {}}}, ["/to/topcs", "did you mean `topics`?"]),
        ([], ["/: a request is expected"]),
    ],
)
def test_what_is_no_request_is_told_fault_by_fault(body: Any, words: list[str]) -> None:
    async def test(client: httpx.AsyncClient, manager: ScriptedManager, _: Lifecycle) -> None:
        before = list(manager.asked)
        status, kind, message = error_of(await client.post("/plan", json=body))
        assert (status, kind) == (422, "SpecificationError")
        assert all(word in message for word in words), message
        assert manager.asked == before

    served(test)


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (b"", "not JSON: Expecting value at line 1, column 1"),
        (b"replace", "not JSON: Expecting value at line 1, column 1"),
        (b"\xff", "not JSON: 'utf-8' codec can't decode byte 0xff"),
        (rb'{"request": {"remove": ["\ud800"]}}', r"\ud800 is half of a surrogate pair at line 1, column 26"),
        (rb'{"request": {}, "id": "\\\uDFFF"}', r"\uDFFF is half of a surrogate pair at line 1, column 26"),
        (rb'{"\ud83d\ud83d": 0}', r"\ud83d is half of a surrogate pair at line 1, column 3"),
        (b'{"request": {}, "verify": 0}', "/verify: true or false is expected"),
        (b'{"request": {}, "expected": true}', "/expected: a number (a whole number) is expected"),
    ],
)
def test_a_body_that_cannot_be_read_is_a_documented_refusal(body: bytes, words: str) -> None:
    async def test(client: httpx.AsyncClient, manager: ScriptedManager, _: Lifecycle) -> None:
        manager.answers["change"] = {}
        status, kind, message = error_of(await client.post("/change", content=body))
        assert (status, kind) == (422, "SpecificationError")
        assert words in message
        document = (await client.get("/openapi.json")).json()
        assert "not JSON" in document["paths"]["/api/v1/change"]["post"]["responses"]["422"]["description"]

    served(test)


def test_a_whole_pair_of_surrogates_is_a_character() -> None:
    async def test(client: httpx.AsyncClient, manager: ScriptedManager, _: Lifecycle) -> None:
        manager.answers["change"] = {}
        body = rb'{"request": {"remove": ["\ud83e\udd16 \\ud800"]}}'
        assert (await client.post("/change", content=body)).status_code == 200
        assert manager.asked[-1][1][0].remove == ("\U0001f916 \\ud800",)

    served(test)


def test_a_large_body_is_refused_before_all_of_it_is_read() -> None:
    async def test(client: httpx.AsyncClient, manager: ScriptedManager, _: Lifecycle) -> None:
        before, sent = list(manager.asked), 0

        async def endless() -> AsyncIterator[bytes]:
            nonlocal sent
            while True:
                sent += 65536
                yield b" " * 65536

        status, kind, message = error_of(await client.post("/plan", content=endless()))
        assert (status, kind) == (413, "TooLarge")
        assert message == "the body has more than 1048576 bytes"
        assert sent < 2 * LARGEST_BODY
        assert manager.asked == before
        document = (await client.get("/openapi.json")).json()
        assert "1048576" in document["paths"]["/api/v1/plan"]["post"]["responses"]["413"]["description"]

    served(test)


def test_bodies_are_read_while_other_requests_are_answered(monkeypatch: pytest.MonkeyPatch) -> None:
    """A body whose reading waits for the answer to another request."""
    answered = threading.Event()

    def parse(text: str) -> Any:
        assert answered.wait(60)
        return parse_json(text)

    plant(monkeypatch, requests, "parse_json", parse)

    async def test(client: httpx.AsyncClient, manager: ScriptedManager, _: Lifecycle) -> None:
        asking = asyncio.ensure_future(client.post("/plan", content=b"{"))
        await asyncio.sleep(0)
        assert (await client.get("/programs")).status_code == 200
        assert not asking.done()
        answered.set()
        assert (await asking).status_code == 422

    served(test)


def test_a_plan_is_written_in_a_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    threads: list[int] = []
    plant(monkeypatch, PlannedChange, "of", lambda *_, **__: threads.append(threading.get_ident()))

    async def test(client: httpx.AsyncClient, manager: ScriptedManager, _: Lifecycle) -> None:
        manager.answers["plan"] = None
        assert (await client.post("/plan", json={"remove": ["talker"]})).status_code == 200

    served(test)
    assert threads
    assert threading.get_ident() not in threads


def test_a_client_that_leaves_before_its_body_has_arrived_is_no_error() -> None:
    async def test() -> None:
        app = create_app(LiveView(Lifecycle(ScriptedManager().as_manager)))
        messages = iter([{"type": "http.request", "body": b"{", "more_body": True}, {"type": "http.disconnect"}])

        async def receive() -> Any:
            return next(messages)

        async def send(_: Any) -> None:
            pass

        scope = {"type": "http", "method": "POST", "path": "/api/v1/plan", "query_string": b"", "headers": []}
        await app(scope, receive, send)

    asyncio.run(test())


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (errors.PlanRefused("there is no node talkr; did you mean talker?"), 409),
        (errors.ManagerBusy("another command is running"), 409),
        (errors.ManagerError("the disk is full"), 409),
        (errors.StartFailed("talker_2 exited with status 1"), 502),
        (errors.CallTimeout("talker did not answer"), 504),
        (errors.AlloyMissing("there is no Alloy Analyzer"), 409),
        (errors.StepFailed("it failed", "rolled_back"), 500),
    ],
)
def test_a_refusal_keeps_its_kind_and_its_words(error: errors.MidstrideError, status: int) -> None:
    async def test(client: httpx.AsyncClient, manager: ScriptedManager, _: Lifecycle) -> None:
        manager.answers["change"] = error
        response = await client.post("/change", json={"request": {"remove": ["talker"]}})
        assert error_of(response) == (status, type(error).__name__, str(error.args[0]))

    served(test)


def test_an_unforeseen_failure_is_told_as_one() -> None:
    async def test(client: httpx.AsyncClient, manager: ScriptedManager, _: Lifecycle) -> None:
        manager.answers["programs"] = ZeroDivisionError("by zero")
        status, kind, message = error_of(await client.get("/programs"))
        assert (status, kind) == (500, "InternalError")
        assert "by zero" in message

    served(test)


@pytest.mark.parametrize(("method", "path", "status"), [("GET", "/stauts", 404), ("PUT", "/change", 405)])
def test_what_is_no_operation_is_told_as_every_other_failure(method: str, path: str, status: int) -> None:
    async def test(client: httpx.AsyncClient, _: ScriptedManager, __: Lifecycle) -> None:
        response = await client.request(method, path)
        assert error_of(response)[:2] == (status, "NoOperation")
        assert f"{method} /api/v1{path}" in error_of(response)[2]

    served(test)


def test_nothing_is_changed_before_the_system_is_up() -> None:
    async def test(client: httpx.AsyncClient, manager: ScriptedManager, lifecycle: Lifecycle) -> None:
        body: dict[str, Any] = {"request": {"remove": ["talker"]}}
        status, kind, message = error_of(await client.post("/change", json=body))
        assert (status, kind) == (409, "ManagerError")
        assert "still being brought up" in message
        manager.answers["up"] = errors.StartFailed("talker exited with status 1")
        await lifecycle.bring_up()
        assert "talker exited with status 1" in error_of(await client.post("/change", json=body))[2]
        assert error_of(await client.get("/up")) == (502, "StartFailed", "talker exited with status 1")
        assert [operation for operation, _ in manager.asked] == ["up"]

    served(test, up=False)


def test_a_fault_of_ours_while_coming_up_ends_in_an_answer(caplog: pytest.LogCaptureFixture) -> None:
    async def test(client: httpx.AsyncClient, manager: ScriptedManager, lifecycle: Lifecycle) -> None:
        manager.answers["up"] = KeyError("gone")
        await lifecycle.bring_up()
        status, kind, message = error_of(await client.get("/up"))
        assert (status, kind) == (409, "ManagerError")
        assert "internal error" in message
        assert "gone" in caplog.text

    served(test, up=False)


def test_up_is_answered_when_it_is_known() -> None:
    async def test(client: httpx.AsyncClient, manager: ScriptedManager, lifecycle: Lifecycle) -> None:
        manager.holds["up"] = asyncio.Event()
        bringing = asyncio.ensure_future(lifecycle.bring_up())
        asking = asyncio.ensure_future(client.get("/up"))
        done, _ = await asyncio.wait({asking}, timeout=0.05)
        assert not done
        manager.holds["up"].set()
        up = {"outcome": "done", "instances": ["listener", "talker"], "degraded": [], "missing": {}, "half_done": []}
        assert (await asking).json() == up
        await bringing

    served(test, up=False)


def test_a_change_goes_on_when_its_client_goes_away() -> None:
    async def test(client: httpx.AsyncClient, manager: ScriptedManager, _: Lifecycle) -> None:
        manager.holds["change"] = asyncio.Event()
        manager.answers["change"] = {"outcome": "done"}
        asking = asyncio.ensure_future(client.post("/change", json={"request": {"remove": ["talker"]}}))
        while manager.asked[-1][0] != "change":
            await asyncio.sleep(0)
        asking.cancel()
        with pytest.raises(asyncio.CancelledError):
            await asking
        manager.holds["change"].set()
        while not any(event.kind == "change" for event in manager.log()):
            await asyncio.sleep(0)

    served(test)


def test_down_is_the_end() -> None:
    async def test(client: httpx.AsyncClient, manager: ScriptedManager, lifecycle: Lifecycle) -> None:
        manager.answers["down"] = errors.ManagerError("talker: does not end")
        assert error_of(await client.post("/down"))[0] == 409
        assert not lifecycle.ended.is_set()
        manager.answers["down"] = DownReport()
        assert (await client.post("/down")).json() == {"outcome": "done", "killed": []}
        await lifecycle.until_over()
        assert (await client.get("http://manager/api/v1")).json()["phase"] == "down"

    served(test)


def test_the_log_from_an_earlier_managers_number_on_is_the_whole_log() -> None:
    """A client that comes back to the next manager, which counts from 1 again, must not wait for number 500."""

    async def test(client: httpx.AsyncClient, manager: ScriptedManager, _: Lifecycle) -> None:
        manager.events.add("step", "one")
        whole = (await client.get("/log")).json()
        assert (await client.get("/log?since=500")).json() == whole
        assert encode(await anext(manager.subscribe(500))) == whole[0]

    served(test)


def test_the_log_from_a_number_on() -> None:
    async def test(client: httpx.AsyncClient, manager: ScriptedManager, _: Lifecycle) -> None:
        for number in range(3):
            manager.events.add("note", f"note {number}")
        told = (await client.get("/log", params={"since": 2})).json()
        assert [(event["n"], event["words"]) for event in told] == [(3, "note 1"), (4, "note 2")]

    served(test)


def test_a_method_that_a_path_does_not_have_is_answered_with_those_that_it_has() -> None:
    async def test(client: httpx.AsyncClient, _: ScriptedManager, __: Lifecycle) -> None:
        for path, allowed in (("/change", {"GET", "POST"}), ("/plan", {"POST"}), ("/programs", {"GET"})):
            refused = await client.put(path)
            assert refused.status_code == 405
            assert set(refused.headers["allow"].split(", ")) == allowed

    served(test)
