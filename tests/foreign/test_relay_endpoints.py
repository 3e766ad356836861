"""What the program behind a relay has in the graph: waited for, and refused where it takes no notice of its names."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from msgspec import structs

from midstride.codec.component_form import NamedComponentForm
from midstride.errors import CallTimeout, NodeError
from midstride.foreign import own_node_search, relay_endpoints
from midstride.foreign.graph_check import ENDPOINTS_TIMEOUT, GraphEndpoint, NamedServer, Served
from midstride.foreign.relay_endpoints import ADVERTISES, ProgramEndpoints
from midstride.foreign.relayed_program import RelayOrder, private_topics
from midstride.lang.load import load
from midstride.model.contract import QoS

TEXT = """system thinning
topic /chat : std_msgs/msg/String
topic /slow : std_msgs/msg/String
component Throttle {
  run "throttle" gate relay
  input in : std_msgs/msg/String as source
  output out
  functionality thin {
    uses in
    produces out
    mode normal { assume in  guarantee out : std_msgs/msg/String }
    mode degraded { }
  }
}
node throttle : Throttle { in <- /chat  out -> /slow }
"""
PRIVATE = "/_midstride/relay/throttle/out"
Graph = Callable[[float], "Sequence[GraphEndpoint] | None"]


class Time:
    """In the place of the module `time`: nothing passes but what is slept."""

    def __init__(self) -> None:
        self.now = 0.0

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


@pytest.fixture
def time(monkeypatch: pytest.MonkeyPatch) -> Time:
    made = Time()
    monkeypatch.setattr(relay_endpoints, "time", made)
    monkeypatch.setattr(own_node_search, "time", made)
    return made


def published(topic: str) -> GraphEndpoint:
    return GraphEndpoint(True, topic, "std_msgs/msg/String", QoS())


def subscribed(topic: str) -> GraphEndpoint:
    return GraphEndpoint(False, topic, "std_msgs/msg/String", QoS())


def endpoints(
    folder: Path, time: Time, graph: Graph, *, late: bool = False, status: int | None = None
) -> ProgramEndpoints:
    """Of a program that has exited with ``status``; ``graph``: what is shown of it at a time (s)."""
    path = folder / "thinning.stride"
    path.write_text(TEXT, encoding="utf-8")
    component = load(path).require().components["Throttle"]
    order = RelayOrder(
        command=["throttle"],
        node="/throttle",
        declaration=NamedComponentForm.of(component),
        topics={"in": "/chat"} | private_topics(component, "throttle"),
        real={"out": "/slow"},
    )
    program: Any = SimpleNamespace(status=lambda: status, words="throttle")

    def matched() -> bool:
        return published(PRIVATE) in (graph(time.now) or ())

    return ProgramEndpoints(order, component, program, lambda: graph(time.now), {"out": matched}, late)


@pytest.mark.parametrize(
    ("expected", "shown", "node", "at"),
    [
        ("", {1: ["/talk"]}, "/talk", 1.0),
        ("", {1: ["/_hidden"], 2: ["/talk/costmap", "/talk", "/other"]}, "/talk", 2.0),
        ("/talk", {1: ["/a"], 2: ["/a", "/talk"]}, "/talk", 2.0),
        ("/talk", {1: ["/a"], 4: ["/a", "/talk"]}, "/a", 3.0),  # its program names it otherwise by now
        ("/talk_2", {1: ["/talk_2"]}, "/talk_2", 1.0),
    ],
)
def test_the_node_of_a_program_that_names_it_is_found(
    expected: str, shown: dict[int, list[str]], node: str, at: float, tmp_path: Path, time: Time
) -> None:
    def nodes() -> Sequence[str]:
        return next((names for since, names in reversed(shown.items()) if time.now >= since), ())

    made = endpoints(tmp_path, time, lambda _: None)
    order = structs.replace(made.order, node=expected, enclave="/midstride/e")
    assert replace(made, order=order, nodes=nodes).own_node() == node
    assert at <= time.now < at + 0.1


def test_a_program_that_has_no_node_in_its_enclave_is_refused(tmp_path: Path, time: Time) -> None:
    made = endpoints(tmp_path, time, lambda _: None)
    order = structs.replace(made.order, node="", enclave="/midstride/e")
    with pytest.raises(NodeError, match=r"no node in its enclave 20 s after `throttle` was started: .* the enclave am"):
        replace(made, order=order).own_node()
    with pytest.raises(NodeError, match="`throttle` has exited with status 3"):
        replace(endpoints(tmp_path, time, lambda _: None, status=3), order=order).own_node()


@pytest.mark.parametrize("late", [False, True])
def test_a_program_is_waited_for_until_it_has_all_endpoints(tmp_path: Path, time: Time, late: bool) -> None:
    def graph(now: float) -> Sequence[GraphEndpoint] | None:
        return None if now < 1 else [published(PRIVATE)] if now < 3 else [published(PRIVATE), subscribed("/chat")]

    endpoints(tmp_path, time, graph, late=late).wait()
    assert 3 <= time.now < 3.2


@pytest.mark.parametrize("late", [False, True])
@pytest.mark.parametrize(
    ("found", "words"),
    [
        (
            published("/out"),
            "publishes on /out itself, for output out of Throttle; it takes no notice of .* `out:=",
        ),
        (published("/slow"), "publishes on /slow itself, .*: did you mean `output out as /slow`"),
        (subscribed("/source"), "subscribes to /source itself, for input in .* no notice of .* `source:=/chat`"),
    ],
    ids=["its own name", "the real topic", "an input"],
)
def test_one_that_takes_no_notice_of_its_names_is_refused_as_soon_as_it_is_seen(
    tmp_path: Path, time: Time, late: bool, found: GraphEndpoint, words: str
) -> None:
    program = endpoints(tmp_path, time, lambda now: [] if now < 2 else [found], late=late)
    with pytest.raises(NodeError, match=f"^node /throttle {words}"):
        program.wait()
    assert 2 <= time.now < 2.2


@pytest.mark.parametrize("late", [False, True])
def test_one_that_takes_no_notice_of_its_name_is_refused(tmp_path: Path, time: Time, late: bool) -> None:
    with pytest.raises(
        NodeError, match="there is no node /throttle 20 s after `throttle` was started: a program behind"
    ):
        endpoints(tmp_path, time, lambda _: None, late=late).wait()
    assert ENDPOINTS_TIMEOUT <= time.now < ENDPOINTS_TIMEOUT + 0.2


@pytest.mark.parametrize(("startup", "waited"), [(None, 20), (40.0, 60)])
def test_an_endpoint_that_never_comes_is_named_with_how_long_it_was_waited_and_what_to_state(
    tmp_path: Path, time: Time, startup: float | None, waited: int
) -> None:
    program = endpoints(tmp_path, time, lambda _: [subscribed("/chat")])
    program = replace(program, component=replace(program.component, startup_seconds=startup))
    with pytest.raises(NodeError) as raised:
        program.wait()
    assert str(raised.value) == (
        f"node /throttle has no publisher on {PRIVATE}, the topic of output out of Throttle, {waited} s "
        "after its start; "
        f"if it takes longer to start, state `takes {2 * waited} s` after its `run` command; "
        "if the topic exists only while something subscribes to it, state `output out lazy`"
    )
    assert waited <= time.now < waited + 0.2


def test_an_endpoint_that_comes_within_the_time_that_is_stated_is_waited_for(tmp_path: Path, time: Time) -> None:
    def graph(now: float) -> Sequence[GraphEndpoint]:
        return [published(PRIVATE), subscribed("/chat")] if now > 25 else []

    program = endpoints(tmp_path, time, graph)
    replace(program, component=replace(program.component, startup_seconds=40.0)).wait()
    assert 25 < time.now < 25.2


def test_a_lazy_output_is_not_waited_for(tmp_path: Path, time: Time) -> None:
    program = endpoints(tmp_path, time, lambda _: [subscribed("/chat")])
    replace(program, component=replace(program.component, lazy=frozenset({"out"}))).wait()
    assert time.now < 0.2


def test_a_program_that_has_exited_is_not_waited_for(tmp_path: Path, time: Time) -> None:
    with pytest.raises(NodeError, match="`throttle` has exited with status 3"):
        endpoints(tmp_path, time, lambda _: None, status=3).wait()
    assert time.now == 0


@pytest.mark.parametrize("late", [False, True])
def test_a_graph_that_cannot_be_read_is_asked_again_and_its_reason_reported(
    tmp_path: Path, time: Time, late: bool
) -> None:
    def graph(now: float) -> Sequence[GraphEndpoint]:
        if now < 3:
            raise CallTimeout("the master did not answer")
        return [published(PRIVATE), subscribed("/chat")]

    program = endpoints(tmp_path, time, graph, late=late)
    replace(program, matched={}).wait()
    assert 3 <= time.now < 3.2
    never = replace(program, matched={}, graph=lambda: graph(0.0))
    with pytest.raises(NodeError, match=r"^what /throttle has is not known: the master did not answer$"):
        never.wait()


def test_a_graph_that_cannot_be_read_for_a_while_is_watched_all_the_same(
    tmp_path: Path, time: Time, capfd: pytest.CaptureFixture[str]
) -> None:
    def graph(now: float) -> Sequence[GraphEndpoint]:
        if now < 10:
            raise CallTimeout("the master did not answer")
        return [published("/out")]

    past: queue.Queue[str] = queue.Queue()
    endpoints(tmp_path, time, graph, late=True).watch(past.put)
    assert "publishes on /out itself" in past.get(timeout=60)
    said = "whether /throttle publishes past its relay is not known now: the master did not answer\n"
    assert capfd.readouterr().err == said


def test_where_programs_advertise_late_an_output_is_waited_for_shortly_and_then_watched(
    tmp_path: Path, time: Time
) -> None:
    def graph(now: float) -> Sequence[GraphEndpoint]:
        return [subscribed("/chat"), published("/out")] if now > 60 else [subscribed("/chat")]

    program = endpoints(tmp_path, time, graph, late=True)
    program.wait()
    assert ADVERTISES <= time.now < ADVERTISES + 0.2
    past: queue.Queue[str] = queue.Queue()
    program.watch(past.put)
    assert "publishes on /out itself" in past.get(timeout=60)


def test_a_program_is_watched_until_it_has_published_behind_its_relay(tmp_path: Path, time: Time) -> None:
    program = endpoints(
        tmp_path, time, lambda now: None if now < 5 else [published(PRIVATE)] if now > 60 else [], late=True
    )
    before = set(threading.enumerate())
    program.watch(lambda fault: pytest.fail(fault))
    for thread in set(threading.enumerate()) - before:
        thread.join(60)
        assert not thread.is_alive()
    assert time.now > 60


MAP = "nav_msgs/srv/GetMap"
PRIVATE_MAP = "/_midstride/relay/throttle/map"


@pytest.mark.parametrize(
    ("served", "matched", "said"),
    [
        ([NamedServer("service", PRIVATE_MAP, MAP)], True, None),
        ([NamedServer("service", PRIVATE_MAP, MAP)], False, "no request reaches map"),
        ([], False, r"node /throttle does not serve service /_mid\S+/map, for server map of Throttle"),
        (
            [NamedServer("service", PRIVATE_MAP, "std_srvs/srv/Empty")],
            False,
            r"serves service \S+ of type std_srvs/srv/Empty, and server map of Throttle is declared as nav_msgs",
        ),
        *(
            (
                [NamedServer("service", name, MAP), NamedServer("service", PRIVATE_MAP, MAP)],
                True,
                rf"serves service {name} itself, for server map of Throttle; it takes no notice of the remapping `map:",
            )
            for name in ("/map", "/static_map")
        ),
    ],
)
def test_a_program_answers_by_its_relay_only(
    served: list[NamedServer], matched: bool, said: str | None, tmp_path: Path, time: Time
) -> None:
    text = TEXT.replace("  output out", "  output out\n  server map", 1).replace("produces out", "produces out, map", 1)
    text = text.replace("guarantee out", f"guarantee map : {MAP}  guarantee out", 1)
    (tmp_path / "thinning.stride").write_text(text)
    component = load(tmp_path / "thinning.stride").require().components["Throttle"]
    made = endpoints(tmp_path, time, lambda _: [published(PRIVATE), subscribed("/chat")])
    order = structs.replace(
        made.order,
        declaration=NamedComponentForm.of(component),
        topics={"in": "/chat"} | private_topics(component, "throttle"),
        real={"out": "/slow", "map": "/static_map"},
    )
    made = replace(
        made,
        order=order,
        component=component,
        matched={**made.matched, "map": lambda: matched},
        served=lambda: Served(servers=frozenset(served)),
    )
    if said is None:
        made.wait()
    else:
        with pytest.raises(NodeError, match=said):
            made.wait()
