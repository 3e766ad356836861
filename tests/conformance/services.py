"""Servers and clients as ports: requests, goals, their hand-over, and a client whose server has gone."""

from __future__ import annotations

from typing import Any

from tests.conformance import puppets
from tests.conformance.lab import Lab, assert_unbroken, service_check


async def _ask(lab: Lab, description: puppets.Description, name: str = "/answer") -> None:
    await lab.start("asker", description)
    await lab.attach("asker", "ask", name)
    await lab.mode("asker", "ask", "normal")


async def _serve(lab: Lab, instance: str, description: puppets.Description, replaces: str = "") -> None:
    await lab.start(instance, description, replaces)
    await lab.attach(instance, "answer", "/answer")
    await lab.mode(instance, "serve", "normal")


async def _responses(lab: Lab) -> list[str]:
    return list((await lab.exported("asker"))["responded"].get("ask", []))


async def _settled(lab: Lab) -> dict[str, Any]:
    """What the client has exported, once it has stopped and nothing is under way."""
    await lab.mode("asker", "ask", "degraded")

    def is_settled(exported: dict[str, Any]) -> bool:
        ended = len(exported["responded"].get("ask", [])) + exported["unanswered"].get("ask", 0)
        return bool(exported["asked"]["ask"] == ended)

    settled: dict[str, Any] = await lab.eventually("each request has ended", lambda: lab.exported("asker"), is_settled)
    return settled


async def _handed_over(lab: Lab, kind: str) -> dict[str, Any]:
    """Requests from before a change-over until after it; what the client has exported then."""
    await _serve(lab, "old", puppets.server(kind=kind))
    await _ask(lab, puppets.asker(kind))
    await lab.eventually("the old one responds", lambda: _responses(lab))
    await _serve(lab, "new", puppets.server(kind=kind), replaces="old")
    assert (await lab.port("old", "answer", "/answer"))["gate"] == "open"
    assert (await lab.port("new", "answer", "/answer"))["gate"] == "closed"
    await lab.sleep(2.0)  # goals are not passed on: the client has to know the new server
    before = len(await _responses(lab))
    await lab.change("new", "answer", peer="old")
    assert (await lab.port("new", "answer", "/answer"))["gate"] == "open"
    await lab.eventually("the old one reports that", lambda: _is_closed(lab, "old"))
    await lab.eventually("the new one responds", lambda: _responses(lab), lambda words: len(words) > before + 3)
    exported = await _settled(lab)
    assert exported["unanswered"] == {}, exported
    served = [(await lab.exported(name))["served"]["answer"] for name in ("old", "new")]
    assert sum(served) == exported["asked"]["ask"] and min(served) > 0, (served, exported)
    return exported


async def _is_closed(lab: Lab, instance: str) -> bool:
    return bool((await lab.port(instance, "answer", "/answer"))["gate"] == "closed")


def assert_executed_once(words: list[str]) -> None:
    """A server numbers what it executes. Of several requests under way, ROS promises no order of the responses."""
    assert_unbroken(sorted(words, key=lambda word: int(word.rsplit(" ", 1)[1])))


@service_check
async def answers_each_request_once(lab: Lab) -> None:
    """What is sent before the server is discovered, too."""
    await _ask(lab, puppets.asker())
    await _serve(lab, "server", puppets.server())
    await lab.eventually("responses come", lambda: _responses(lab), lambda words: len(words) > 10)
    exported = await _settled(lab)
    words = exported["responded"]["ask"]
    assert exported["unanswered"] == {} and len(words) == exported["asked"]["ask"]
    assert_executed_once(words)
    assert {"server 1", f"server {len(words)}"} <= set(words)


@service_check
async def hands_over_requests(lab: Lab) -> None:
    """Each is answered once, by the old server or by the new one."""
    words = (await _handed_over(lab, puppets.TRIGGER))["responded"]["ask"]
    for server in ("old ", "new "):
        assert_executed_once([word for word in words if word.startswith(server)])


@service_check
async def hands_over_goals(lab: Lab) -> None:
    """Each goal is executed once and succeeds, also the one that is in progress."""
    statuses = (await _handed_over(lab, puppets.FIBONACCI))["responded"]["ask"]
    assert set(statuses) == {"status 4"}, statuses


async def _with_a_goal(lab: Lab, seconds: float) -> None:
    """Two servers, and a client that has a goal accepted by the old one, and does nothing about it at present."""
    await _serve(lab, "old", puppets.server(kind=puppets.FIBONACCI, goals=seconds))
    await _serve(lab, "new", puppets.server(kind=puppets.FIBONACCI, goals=seconds), replaces="old")
    later = {"cancel": 1 if seconds > 1 else 1000, "fetch": [0]}
    await _ask(lab, puppets.asker(puppets.FIBONACCI, rate=0.5, later=later))

    async def served() -> int:
        return int((await lab.exported("old"))["served"].get("answer", 0))

    await lab.eventually("the old one has a goal", served)
    await lab.mode("asker", "ask", "degraded")
    assert await _responses(lab) == []


@service_check
async def cancels_a_goal_where_it_is(lab: Lab) -> None:
    """A client cancels a goal, and asks for its result, after the change-over: the old server has it."""
    await _with_a_goal(lab, 5.0)
    await lab.change("new", "answer", peer="old")
    await lab.mode("asker", "ask", "normal")
    words = await lab.eventually("it has ended", lambda: _responses(lab))
    assert words[0] == "status 5", words
    assert (await lab.exported("old"))["served"] == {"answer": 1}


@service_check
async def has_the_results_that_its_predecessor_has_left(lab: Lab) -> None:
    """A client asks for the result of a goal when the server that had it has ended."""
    await _with_a_goal(lab, 0.3)
    await lab.sleep(0.5)
    await lab.change("new", "answer", peer="old")
    await lab.eventually("the old one reports that", lambda: _is_closed(lab, "old"))
    await lab.change("old", "stop")
    await lab.sleep(2.0)
    await lab.mode("asker", "ask", "normal")
    words = await lab.eventually("it has the result", lambda: _responses(lab))
    assert words[0] == "status 4", words


@service_check
async def degrades_where_its_server_is_gone(lab: Lab) -> None:
    """As the server leaves the graph with its mode, and again as its process dies; requests end with it."""
    await _serve(lab, "server", puppets.server())
    await _ask(lab, puppets.asker())
    await lab.eventually("responses come", lambda: _responses(lab))
    await lab.mode("server", "serve", "degraded")
    await lab.eventually("the client degrades", lambda: lab.in_mode("asker", "ask", "degraded"))
    because = (await lab.functionality("asker", "ask"))["because"]
    assert "client ask" in because and "has had no server" in because, because
    await lab.mode("server", "serve", "normal")
    before = len(await _responses(lab))
    await lab.mode("asker", "ask", "normal")
    await lab.eventually("responses come again", lambda: _responses(lab), lambda words: len(words) > before)
    await lab.change("server", "stop")
    await lab.eventually("the client degrades", lambda: lab.in_mode("asker", "ask", "degraded"))
    await _settled(lab)


@service_check
async def degrades_where_its_requests_are_not_answered(lab: Lab) -> None:
    """The server is there, and silent: the client waits for its bound and 2 s more."""
    await _serve(lab, "server", puppets.server({"silent": True}))
    await _ask(lab, puppets.asker())
    await lab.eventually("the client degrades", lambda: lab.in_mode("asker", "ask", "degraded"))
    because = (await lab.functionality("asker", "ask"))["because"]
    assert "has not been answered for" in because and "within 1 s is assumed" in because, because
    assert (await _settled(lab))["responded"] == {}


@service_check
async def degrades_where_a_server_raises(lab: Lab) -> None:
    await _serve(lab, "server", puppets.server({"raise": "out of order"}))
    await _ask(lab, puppets.asker())
    await lab.eventually("the server degrades", lambda: lab.in_mode("server", "serve", "degraded"))
    assert "out of order" in (await lab.functionality("server", "serve"))["because"]
    await lab.eventually("the client degrades", lambda: lab.in_mode("asker", "ask", "degraded"))
