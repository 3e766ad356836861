"""Servers and clients as ports: declarations, when a service is in the graph, and when a client lacks its server."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, cast

import pytest

from midstride import Component, NodeError, Unanswered, any_of
from midstride.backends.simulator.virtual_loop import run
from midstride.model.contract import Predicate
from midstride.node.author.client_ports import ABSENT, NEVER_SEEN, OVERDUE, ClientLink, ClientPort
from midstride.node.author.server_ports import ServerLink
from midstride.node.component_host import Host
from midstride.node.control.component_reflex import Watch
from midstride.node.data.functionality_runner import FunctionalityRunner
from midstride.node.request_admission import RequestAdmission
from tests.node.author import String

TRIGGER = "std_srvs/srv/Trigger"


class Response:
    """A response, as rclpy makes one for each request."""

    def __init__(self) -> None:
        self.said = ""


class Trigger:
    """A service's type, as rclpy has them."""

    __module__ = "std_srvs.srv._trigger"
    Request = type("Request", (), {})
    Response = Response


@dataclass(eq=False)
class Service:
    """A service in the graph, or a client's side of it."""

    answer: Callable[[Any, Any], Any] | None = None
    there: bool = True
    calls: list[Any] = field(default_factory=list)

    def retire(self) -> None:
        self.there = False

    destroy = retire

    def call(self, request: Any, feedback: Callable[[Any], object] | None = None) -> asyncio.Future[Any]:
        self.calls.append(asyncio.get_running_loop().create_future())
        return cast(asyncio.Future[Any], self.calls[-1])

    def unsent(self) -> asyncio.Future[Any]:
        return asyncio.get_running_loop().create_future()

    def abandon(self, future: Any, error: Exception) -> None:
        if not future.done():
            future.set_exception(error)

    def matched(self) -> int:
        return int(self.there)


class ServiceHost:
    """A host whose clock a test sets (s), with the services that were made."""

    def __init__(self) -> None:
        self.time = 0.0
        self.busy = False
        self.waiting: list[tuple[Callable[[], None], asyncio.Future[None]]] = []
        self.made: list[Service] = []
        self.logged: list[str] = []
        self.admission = RequestAdmission(self.steady)
        self.logger = SimpleNamespace(error=self.logged.append, warning=self.logged.append)

    def steady(self) -> int:
        return round(self.time * 1e9)

    now = steady

    def on_data(self, function: Callable[[], None]) -> asyncio.Future[None]:
        """At once, but while the data thread is busy."""
        done: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.waiting.append((function, done))
        if not self.busy:
            self.free()
        return done

    def free(self) -> None:
        """The data thread does what has waited for it."""
        self.busy, waiting, self.waiting = False, self.waiting, []
        for function, done in waiting:
            function()
            done.set_result(None)

    def create_server(self, name: str, type_: type, answer: Callable[[Any, Any], Any]) -> Service:
        self.made.append(Service(answer))
        return self.made[-1]

    def create_action_client(self, name: str, type_: type, accepted: Callable[[Any], None]) -> Service:
        return self.create_client(name, type_)

    def create_client(self, name: str, type_: type) -> Service:
        self.made.append(Service())
        return self.made[-1]

    @property
    def host(self) -> Host:
        return cast(Host, self)


def nothing() -> None:
    """A mode that only serves."""


# -- what is declared --------------------------------------------------------------------------------------


def test_a_server_is_an_output_and_a_client_an_input() -> None:
    comp = Component("Docking")
    dock = comp.create_server("dock", Trigger, lambda request, response: None, within=0.5)
    maps = comp.create_client("map", Trigger, within=0.1)
    work = comp.create_functionality("work", inputs=[maps], outputs=[dock])
    work.set_normal_mode(nothing, inputs=[maps], outputs=[dock])
    work.set_degraded_mode(nothing)
    declared = comp.declaration()
    assert declared.inputs["map"] == Predicate(TRIGGER, within=0.1)
    assert declared.functionalities["work"].modes[0].guarantee("dock") == Predicate(TRIGGER, within=0.5)
    assert declared.service_ports() == ["dock", "map"]
    assert not declared.conditions


def test_messages_drive_a_mode_and_clients_do_not() -> None:
    comp = Component("Docking")
    maps, scan = comp.create_client("map", Trigger), comp.create_input("scan", String)
    out = comp.create_output("out", String)
    work = comp.create_functionality("work", inputs=[maps, scan], outputs=[out])
    work.set_normal_mode(lambda message: None, inputs=[maps, scan], outputs=[out])
    work.set_mode("timed", nothing, rate=10, inputs=[maps], outputs=[out])
    work.set_mode("once", nothing, inputs=[maps])
    work.set_degraded_mode(nothing)
    normal, timed, once, _ = work.chain()
    assert [port for port, _ in normal.handlers] == [scan]
    assert normal.assumptions == ((maps,), (scan,))
    assert (timed.driven, once.driven) == ("rate", "none")
    with pytest.raises(NodeError, match="does not fit"):
        work.set_mode("more", lambda message: None, inputs=[maps])


def test_the_rate_of_a_mode_is_not_that_of_its_server() -> None:
    comp = Component("Talker")
    out, count = comp.create_output("out", String), comp.create_server("count", Trigger, lambda *_: None)
    work = comp.create_functionality("work", outputs=[out, count])
    work.set_normal_mode(nothing, rate=10, outputs=[out, count])
    work.set_degraded_mode(nothing)
    mode = comp.declaration().functionalities["work"].modes[0]
    assert (mode.guarantee("out"), mode.guarantee("count")) == (
        Predicate("std_msgs/msg/String", 10),
        Predicate(TRIGGER),
    )


class OfRos1:
    """A service's type of ROS 1."""

    _request_class = Response


@pytest.mark.parametrize(
    ("declare", "message"),
    [
        (
            lambda comp: comp.create_server("a", String, nothing),
            "server a: .* is not the class of a service; write e.g.",
        ),
        (lambda comp: comp.create_client("a", "Trigger"), "client a: 'Trigger' is not the class of a service"),
        (lambda comp: comp.create_server("a", OfRos1, nothing), "server a: only ROS 2 has services as ports"),
        (lambda comp: comp.create_server("a", Trigger, 3), "server a: 3 is not a function"),
        (lambda comp: comp.create_server("a", Trigger, nothing, refusal="no"), "server a: 'no' is not a function"),
        (lambda comp: comp.create_client("a", Trigger, within=0), "client a, within=: 0 is not a duration"),
        (lambda comp: comp.create_output("a", Trigger), "Trigger is not a ROS message class"),
        (lambda comp: comp.create_server("a", Trigger, nothing).write("x"), "server a has no messages to write"),
        (lambda comp: comp.create_client("a", Trigger).call_async("x"), "client a takes std_srvs/srv/Trigger, not str"),
        (
            lambda comp: comp.create_client("a", Trigger).call_async(Trigger.Request()),
            "client a is attached to no service",
        ),
        (lambda comp: (comp.create_server("a", Trigger, nothing), comp.declaration()), "server a belongs to no"),
    ],
)
def test_wrong_use_says_what_to_write(declare: Callable[[Component], object], message: str) -> None:
    comp = Component("wrong")
    work = comp.create_functionality("work")
    work.set_normal_mode(nothing)
    work.set_degraded_mode(nothing)
    with pytest.raises(NodeError, match=message):
        declare(comp)


def test_a_component_with_servers_does_not_start_where_there_are_no_services(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on ROS 1."""
    comp = Component("Docking")
    dock = comp.create_server("dock", Trigger, lambda request, response: None)
    work = comp.create_functionality("work", outputs=[dock])
    work.set_normal_mode(nothing, outputs=[dock])
    work.set_degraded_mode(nothing)
    host = SimpleNamespace(has_services=False)
    monkeypatch.setattr(
        "midstride.node.author.component_class.host_factory", lambda context: lambda name, namespace: host
    )
    words = r"component Docking has servers or clients \(dock\), which need ROS 2: run it there"
    with pytest.raises(NodeError, match=words):
        comp.start()


def test_the_bound_of_a_server_is_not_stated_by_a_mode() -> None:
    comp = Component("wrong")
    count = comp.create_server("count", Trigger, lambda request, response: None)
    work = comp.create_functionality("work", outputs=[count])
    with pytest.raises(NodeError, match=r"its bound is stated in create_server\(within=\)"):
        work.set_normal_mode(nothing, outputs=[count], guarantees={count: 10})


# -- servers -------------------------------------------------------------------------------------------------


class Served:
    """A server that runs, attached, in the mode ``normal``, which serves, or ``off``."""

    def __init__(self, function: Callable[[Any, Any], Any], refusal: Callable[[Any, Any], Any] | None = None) -> None:
        self.host = ServiceHost()
        comp = Component("Server")
        self.port = comp.create_server("count", Trigger, function, refusal=refusal)
        work = comp.create_functionality("work", outputs=[self.port])
        work.set_normal_mode(nothing, outputs=[self.port])
        work.set_degraded_mode(nothing, name="off")
        self.degraded: list[str] = []
        self.runner = FunctionalityRunner(work, self.host.host, lambda runner: self.degraded.append(runner.because))
        self.port.owner, self.port.call = self.runner, self.runner.answer
        self.link = ServerLink(self.port, "/count", self.host.host)
        self.port.show(self.link)
        self.port.links = (self.link,)

    def enter(self, index: int) -> None:
        self.runner.stop_calls()
        self.runner.enter_mode(index, "a test")
        self.runner.start_calls()

    def in_graph(self) -> bool:
        return any(service.there for service in self.host.made)

    def answers(self) -> Any:
        """What a request is answered, None if it is not."""
        (service,) = (each for each in self.host.made if each.there)
        assert service.answer is not None
        result = service.answer(Trigger.Request(), Response())
        result = run(result) if asyncio.iscoroutine(result) else result
        return None if result is None else result.said


def say(words: str) -> Callable[[Any, Any], Any]:
    def function(request: Any, response: Any) -> Any:
        response.said = words
        return response

    return function


def fail(request: Any, response: Any) -> Any:
    raise ValueError("no")


async def fail_later(request: Any, response: Any) -> Any:
    raise ValueError("no")


async def fill_later(request: Any, response: Any) -> None:
    response.said = "later"


def test_a_mode_that_does_not_serve_has_no_server_in_the_graph() -> None:
    served = Served(say("here"))
    assert not served.in_graph()
    served.enter(0)
    assert served.in_graph() and served.answers() == "here"
    served.enter(1)
    assert not served.in_graph()
    served.enter(0)
    assert served.in_graph()
    served.link.destroy()
    assert not served.in_graph() and not served.port.links


def test_a_server_that_refuses_stays_in_the_graph() -> None:
    served = Served(say("here"), refusal=say("refused"))
    assert served.in_graph() and served.answers() == "refused"
    served.enter(0)
    assert served.answers() == "here"
    served.enter(1)
    assert served.answers() == "refused" and len(served.host.made) == 1


@pytest.mark.parametrize("function", [fail, fail_later, lambda request, response: "no response"])
def test_a_function_that_fails_degrades_its_functionality(function: Callable[[Any, Any], Any]) -> None:
    silent, refusing = Served(function), Served(function, refusal=say("refused"))
    for served, answer in ((silent, None), (refusing, "refused")):
        served.enter(0)
        assert served.answers() == answer
        assert served.runner.mode.name == "off" and len(served.degraded) == 1
    assert not silent.in_graph() and refusing.answers() == "refused"


def test_a_function_that_fails_beside_an_async_call_shows_that_at_once() -> None:
    served = Served(fail)
    served.enter(0)
    served.runner.asynchronous = True
    assert served.answers() is None
    state = served.runner.state()
    assert (state.mode, served.in_graph()) == ("off", False)
    assert "a server raised: ValueError: no" in state.because
    served.runner._returned()
    assert served.runner.mode.name == "off" and "mode normal raised: ValueError: no" in served.runner.because


def test_what_has_arrived_is_answered_before_a_server_leaves() -> None:
    served = Served(say("here"))
    served.enter(0)
    served.port.serving = False  # as its service is asked to leave
    assert served.answers() == "here"


def test_a_function_may_be_async_and_need_not_return_the_response() -> None:
    served = Served(fill_later)
    served.enter(0)
    assert served.answers() == "later"


def test_the_gate_is_open_while_its_instance_answers() -> None:
    served = Served(say("here"))

    def gate() -> tuple[str | None, bool]:
        return served.port.states()["/count"].gate, served.link.is_live

    served.link.set_gate(True)
    assert gate() == ("open", True)
    served.host.admission.close()
    assert gate() == ("closed", False)
    served.host.admission.open([])
    assert gate() == ("open", True)


# -- clients -------------------------------------------------------------------------------------------------


def attached(host: ServiceHost, name: str = "map", within: float | None = 0.1) -> ClientPort:
    client = Component("Client").create_client(name, Trigger, within)
    client.links = (ClientLink(client, f"/{name}", host.host),)
    client.begin(host.host)
    return client


def looked(client: ClientPort, host: ServiceHost, at: float) -> str | None:
    host.time = at
    client.look()
    return client.gone


def test_a_client_lacks_a_server_that_has_left_the_graph() -> None:
    host = ServiceHost()
    client = attached(host)
    assert looked(client, host, 1.0) is None
    host.made[0].there = False
    assert looked(client, host, 2.0) is None
    assert looked(client, host, 2.0 + ABSENT) is None
    assert looked(client, host, 2.1 + ABSENT) == "client map: /map has had no server for 0.6 s"
    assert client.denied
    host.made[0].there = True
    assert looked(client, host, 3.0) is None


def test_a_server_that_has_not_been_seen_yet_may_take_longer_to_be_discovered() -> None:
    host = ServiceHost()
    client = attached(host)
    host.made[0].there = False
    assert looked(client, host, 0.0) is None
    assert looked(client, host, NEVER_SEEN) is None
    assert looked(client, host, NEVER_SEEN + 0.1) is not None
    client.restart()
    assert not client.denied and looked(client, host, NEVER_SEEN + 0.2) is None


def test_a_request_that_takes_longer_than_its_bound_ends() -> None:
    async def scenario() -> None:
        host = ServiceHost()
        client = attached(host)
        client.look()
        first, second = client.call_async(Trigger.Request()), client.call_async(Trigger.Request())
        first.set_result("map")
        await asyncio.sleep(0)
        assert client.count == 2  # its server, and one response
        assert looked(client, host, 0.1 + OVERDUE) is None
        host.busy = True  # a response may wait behind a call of its own
        assert looked(client, host, 0.15 + OVERDUE) is None
        host.free()
        gone = looked(client, host, 0.2 + OVERDUE)
        expected = "client map: a request to /map has not been answered for 2.2 s (a response within 0.1 s is assumed)"
        assert gone == expected
        with pytest.raises(Unanswered, match="has not been answered"):
            await second
        assert looked(client, host, 0.3 + OVERDUE) is None  # it is not asked any more

    run(scenario())


def test_a_request_of_an_earlier_mode_ends_and_breaks_nothing() -> None:
    """Its server has died with it; a new one is there, and the mode that relies on that has been entered again."""

    async def scenario() -> None:
        host = ServiceHost()
        client = attached(host)
        client.look()
        lost = client.call_async(Trigger.Request())
        host.time = 1.0
        client.enter_mode()
        client.restart()
        second = client.call_async(Trigger.Request())
        assert looked(client, host, 0.2 + OVERDUE) is None
        assert looked(client, host, 0.3 + OVERDUE) is None  # the data thread has been free meanwhile
        with pytest.raises(Unanswered, match=r"has not been answered for 2\.2 s"):
            await lost
        assert not second.done()
        assert looked(client, host, 1.1 + OVERDUE) is None
        assert (looked(client, host, 1.2 + OVERDUE) or "").startswith("client map: a request to /map has not been")
        with pytest.raises(Unanswered):
            await second

    run(scenario())


def test_requests_wait_until_their_server_has_been_discovered() -> None:
    async def scenario() -> None:
        host = ServiceHost()
        client = attached(host)
        [service] = host.made
        service.there = False
        calls = [client.call_async(Trigger.Request()) for _ in range(2)]
        assert looked(client, host, 2.0 + OVERDUE) is None and not service.calls  # their bound has not begun
        service.there = True
        calls.append(client.call_async(Trigger.Request()))
        assert not service.calls, "it does not overtake those before it"
        assert looked(client, host, 4.5) is None and len(service.calls) == 3
        for number, response in enumerate(service.calls[:2]):
            response.set_result(number)
        assert [await call for call in calls[:2]] == [0, 1]
        assert looked(client, host, 4.7 + OVERDUE) is not None
        with pytest.raises(Unanswered, match=r"has not been answered for 2\.2 s"):
            await calls[2]
        assert service.calls[2].exception() is not None

    run(scenario())


def test_a_request_whose_server_never_comes_ends_unsent() -> None:
    async def scenario() -> None:
        host = ServiceHost()
        client = attached(host)
        host.made[0].there = False
        call = client.call_async(Trigger.Request())
        assert looked(client, host, 0.0) is None
        assert looked(client, host, NEVER_SEEN + 0.1) is not None
        with pytest.raises(Unanswered, match="has had no server"):
            await call
        host.made[0].there = True
        assert looked(client, host, NEVER_SEEN + 0.2) is None and not host.made[0].calls

    run(scenario())


def test_what_a_stopped_process_has_waited_for_does_not_count() -> None:
    async def scenario() -> None:
        host = ServiceHost()
        client = attached(host)
        client.look()
        client.call_async(Trigger.Request())
        host.time = 10.0
        client.pardon()
        assert looked(client, host, 10.0) is None
        assert looked(client, host, 10.2 + OVERDUE) is not None

    run(scenario())


def test_without_a_bound_a_request_may_take_as_long_as_its_server_is_there() -> None:
    async def scenario() -> None:
        host = ServiceHost()
        client = attached(host, within=None)
        call = client.call_async(Trigger.Request())
        assert looked(client, host, 1e6) is None
        host.made[0].there = False
        assert looked(client, host, 1e6 + 1) is None
        assert looked(client, host, 1e6 + 2) is not None
        with pytest.raises(Unanswered, match="has had no server"):
            await call

    run(scenario())


def test_requests_end_when_the_client_is_detached() -> None:
    async def scenario() -> None:
        client = attached(ServiceHost())
        call = client.call_async(Trigger.Request())
        client.remove(client.links[0])
        with pytest.raises(Unanswered, match="was detached"):
            await call
        assert not client.attached

    run(scenario())


class Fibonacci:
    """A ROS action's type, as rclpy has them."""

    __module__ = "demo_msgs.action._fibonacci"
    Goal = type("Goal", (), {})


class Executing:
    """An action server that runs, in the mode ``normal``, which serves, or ``off``."""

    def __init__(self, function: Callable[[Any], Any], accepts: Callable[[Any], Any] | None = None) -> None:
        self.host = ServiceHost()
        comp = Component("Server")
        self.port = comp.create_action_server("count", Fibonacci, function, 0.5, accepts)
        work = comp.create_functionality("work", outputs=[self.port])
        work.set_normal_mode(nothing, outputs=[self.port])
        work.set_degraded_mode(nothing, name="off")
        assert comp.declaration().functionalities["work"].modes[0].guarantee("count") == Predicate(
            "demo_msgs/action/Fibonacci", within=0.5
        )
        self.runner = FunctionalityRunner(work, self.host.host, lambda _: None)
        self.port.failed, self.port.entered = self.runner.request_failed, lambda: self.runner.entered
        self.runner.enter_mode(0, "a test")


def test_goals_are_rejected_in_a_mode_that_does_not_serve_and_where_the_author_says_so() -> None:
    async def scenario() -> None:
        async def later(goal: Any) -> bool:
            return str(goal) != "no"

        one = Executing(lambda goal: "done")
        assert await one.port.accepts("any") and await one.port.cancels("any")
        for decides in (lambda goal: goal != "no"), later:
            choosy = Executing(lambda goal: "done", accepts=decides)
            assert await choosy.port.accepts("yes") and not await choosy.port.accepts("no")
        one.runner.enter_mode(1, "a test")
        assert not await one.port.accepts("any") and one.port.stays

    asyncio.run(scenario())


def test_a_goal_whose_execution_raises_degrades_the_functionality() -> None:
    async def scenario() -> None:
        async def fails(goal: Any) -> Any:
            raise ValueError("no")

        served = Executing(fails)
        with pytest.raises(ValueError, match="no"):
            await served.port.execute("goal")
        assert served.runner.mode.name == "off"
        assert await Executing(lambda goal: "done").port.execute("goal") == "done"

    run(scenario())


def test_the_result_of_a_goal_ends_with_its_server_and_has_no_bound() -> None:
    async def scenario() -> None:
        host = ServiceHost()
        client = Component("Client").create_action_client("count", Fibonacci, within=0.1)
        client.links = (ClientLink(client, "/count", host.host),)
        client.begin(host.host)
        client.look()
        sent = client.send_goal_async(Fibonacci.Goal())
        result: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
        handle = SimpleNamespace(accepted=True, get_result_async=lambda: result)
        client._note_accepted(handle)
        sent.set_result(handle)
        asked = handle.get_result_async()
        await asyncio.sleep(0)
        assert looked(client, host, 100.0) is None
        host.made[0].there = False
        looked(client, host, 101.0)
        assert looked(client, host, 102.0) == "client count: /count has had no server for 1 s"
        with pytest.raises(Unanswered):
            await asked
        with pytest.raises(NodeError, match=r"action client count sends goals; write count.send_goal_async"):
            client.call_async(Fibonacci.Goal())

    run(scenario())


def test_of_alternative_clients_all_have_to_break() -> None:
    host = ServiceHost()
    one, other = attached(host, "one"), attached(host, "other")
    comp = Component("Client")
    work = comp.create_functionality("work")
    work.inputs = (one, other)
    work.set_normal_mode(nothing, inputs=[any_of(one, other)])
    work.set_mode("second", nothing, inputs=[other])
    work.set_degraded_mode(nothing)
    runner = FunctionalityRunner(work, host.host, lambda _: None)
    runner.enter_mode(0, "a test")
    watch = Watch(runner)

    def broken(at: float) -> list[str]:
        host.time = at
        for client in (one, other):
            client.look()
        watch.advance(0.1)
        return [port.name for port in watch.broken_assumption(1.0)]

    assert broken(1.0) == []
    host.made[0].there = False
    broken(1.1)
    assert broken(2.0) == [] and one.denied
    assert watch.next_mode(1.0) == 1
    host.made[1].there = False
    broken(2.1)
    assert broken(3.0) == ["one", "other"]
    assert watch.next_mode(1.0) == 2
    assert watch.why(one, 1.0) == "client one: /one has had no server for 1.9 s"
