"""Components without Midstride's API: in the language, in JSON, in plans, and how they are started."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from immutables import Map
from msgspec import structs

from midstride.backends.ros2.manager.component_containers import LoadRequest
from midstride.backends.ros2.manager.foreign_nodes import ForeignNodes
from midstride.backends.ros2.manager.own_names import OwnNames, StartName
from midstride.backends.ros2.manager.start_arguments import ros_arguments
from midstride.codec.specification_form import decode_specification, encode_specification
from midstride.errors import BackendError, NodeError, PlanRefused, StepFailed
from midstride.foreign.page import Page
from midstride.foreign.preloading import StartedPrograms
from midstride.foreign.record import ForeignRecord
from midstride.foreign.relayed_program import RelayOrder
from midstride.generate.project import project
from midstride.lang.load import load
from midstride.model.action import Swap
from midstride.model.component import PortRef
from midstride.model.configuration import Configuration
from midstride.model.hosts import HostSpec
from midstride.model.instance_names import full_name
from midstride.model.specification import Node, Specification, initial
from midstride.plan.change_builder import change_between
from midstride.plan.specification_diff import differences
from midstride.plan.strategies.registry import planner
from midstride.runtime.backend_protocol import Handle, Launch
from midstride.runtime.handover.agreed_cut import early_publishers, publishers_found, require_found
from midstride.runtime.handover.arbiter_choice import BATON, LOCK, choose_arbiter, require_arbiters
from midstride.runtime.instance_life import LifeTable
from midstride.runtime.manager_clock import SystemClock
from midstride.wire.commands import AwaitMatchCommand
from midstride.wire.replies import Attached
from midstride.wire.sockets import SocketFolder
from tests.wire.bare_state import bare_state

TEXT = """system chat

topic /chat : std_msgs/msg/String @ 50 Hz
topic /talk : std_msgs/msg/String @ 50 Hz

component Talker {
  run "python3 talker.py" takes 1 s gate preload
  parameters { word = "hello", levels = [1, 2] }
  output out as chatter
  output log as ~/log
  functionality talk {
    produces out, log
    mode normal {
      guarantee out : std_msgs/msg/String @ 50 Hz
      guarantee log : std_msgs/msg/String
    }
    mode degraded { }
  }
}

component Other like Talker {
  run "python3 other.py"
  output out as chat
}

node talker : Talker { out -> /chat }
"""


def parsed(text: str, folder: Path) -> Specification:
    path = folder / "chat.stride"
    path.write_text(text, encoding="utf-8")
    return load(path).require()


def test_the_gate_and_the_names_of_topics_are_read_and_written(tmp_path: Path) -> None:
    specification = parsed(TEXT.replace('other.py"', 'other.py" gate none'), tmp_path)
    talker, other = specification.components["Talker"], specification.components["Other"]
    assert (talker.gate, talker.topics, talker.startup_seconds) == ("preload", Map(out="chatter", log="~/log"), 1)
    assert (other.gate, other.topics) == ("none", Map(out="chat", log="~/log"))
    assert not talker.same_body(other)
    assert decode_specification(encode_specification(specification)) == specification


def test_a_program_of_another_kind_has_no_gate_but_its_own(tmp_path: Path) -> None:
    path = tmp_path / "chat.stride"
    path.write_text(TEXT, encoding="utf-8")
    found = [(each.code, each.message) for each in load(path).diagnostics if each.severity == "error"]
    assert found == [
        ("E027", f"port {port} of Other states what the program calls its topic, but Other has no gate")
        for port in ("log", "out")
    ]


def test_an_unknown_gate_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "chat.stride"
    path.write_text(TEXT.replace("gate preload", "gate open"), encoding="utf-8")
    assert any("`open` is not a kind of gate" in each.message for each in load(path).diagnostics)


def test_another_topic_means_another_instance(tmp_path: Path) -> None:
    before = parsed(TEXT.partition("component Other")[0] + "node talker : Talker { out -> /chat }\n", tmp_path)
    after = before.with_node(Node("talker", "Talker", Map(out=("/talk",))))
    change = change_between(initial(before), before, after)
    assert change.replaced == Map(talker="talker_2")
    assert [str(each).partition("\n")[0] for each in differences(before, after)] == ["node talker: replaced"]
    assert not change_between(initial(before), before, before).replaced


def test_a_component_with_a_gate_gets_no_skeleton(tmp_path: Path) -> None:
    specification = parsed(TEXT.partition("component Other")[0] + "node talker : Talker\n", tmp_path)
    found = project(specification, "chat.stride", {})
    assert found.skipped == {"Talker": "its program does not use Midstride's API: it has a gate"}


def launched(component: str, specification: Specification, namespace: str) -> Launch:
    return Launch(
        f"{namespace}/talker".lstrip("/"),
        namespace,
        ("talker",),
        "token",
        Path("/"),
        {"word": "it's", "use_sim_time": True},
        {"word": "bye"},
        foreign=specification.components[component],
        topics={"out": "/chat"},
    )


def test_what_the_program_is_started_with(tmp_path: Path) -> None:
    specification = parsed(TEXT.partition("component Other")[0], tmp_path)
    launch = launched("Talker", specification, "robot1")
    component = specification.components["Talker"]
    node = full_name(launch.instance, launch.namespace)
    name = ["-r", "__node:=talker"]
    assert ros_arguments(launch, component, StartName(node), Path("/run/p.yaml")) == [
        "--ros-args",
        *(*name, "-r", "__ns:=/robot1", "-r", "chatter:=/chat", "--params-file", "/run/p.yaml"),
    ]
    # Without a namespace, none is stated: a further node in the process may have one of its own.
    assert ros_arguments(replace(launch, topics={}), component, StartName("/talker")) == ["--ros-args", *name]


def test_a_relay_says_how_a_program_calls_its_node_and_a_replacement_is_renamed(tmp_path: Path) -> None:
    text = TEXT.partition("component Other")[0].replace("gate preload", "gate relay unnamed")
    specification = parsed(text, tmp_path)
    launch, component = launched("Talker", specification, "robot1"), specification.components["Talker"]
    launch = replace(launch, role="robot1/talker")
    state = bare_state("robot1/talker", revision=0)

    async def scenario() -> None:
        made = partial(ForeignNodes, tmp_path / "gates", SocketFolder(tmp_path / "components"), lambda _: None)
        nodes = made()
        name = nodes.start_name(launch, component, lambda _: False)
        path = nodes.prepare_relay(launch, component, name, ["program"], {})
        order = RelayOrder.read(path)
        assert (order.node, order.unnamed, order.enclave) == (
            "",
            True,
            order.command[order.command.index("--enclave") + 1],
        )
        assert not any("__node" in word for word in order.command)
        assert nodes.node_of("robot1/talker") == ""
        structs.replace(order, node="/robot1/talk").write(path)  # as the relay does
        nodes.note(state)
        assert nodes.runs("/robot1/talk") and nodes.node_of("robot1/talker") == "/robot1/talk"
        await nodes.close()
        # The next manager knows it as well; the second instance is renamed alone, and is found by that name.
        another = made()
        await another.adopt("robot1/talker")
        assert another.runs("/robot1/talk")
        second = replace(launch, instance="robot1/talker_2")
        name = another.start_name(second, component, another.runs)
        assert name == StartName("/robot1/talk_2", original="/robot1/talk")
        order = RelayOrder.read(another.prepare_relay(second, component, name, ["program"], {}))
        assert order.command[2:4] == ["-r", "talk:__node:=talk_2"]
        assert (order.node, order.unnamed, bool(order.enclave)) == ("/robot1/talk_2", False, True)
        another.note(structs.replace(state, instance="robot1/talker_2"))
        assert OwnNames(tmp_path / "gates").known("robot1/talker") == "/robot1/talk"
        await another.close()

    asyncio.run(scenario())


def test_a_relayed_program_gets_private_topics_for_its_outputs(tmp_path: Path) -> None:
    specification = parsed(TEXT.partition("component Other")[0].replace("gate preload", "gate relay"), tmp_path)
    launch, component = launched("Talker", specification, "robot1"), specification.components["Talker"]

    async def scenario() -> None:
        nodes = ForeignNodes(tmp_path / "gates", SocketFolder(tmp_path / "components"), lambda _: None)
        path = nodes.prepare_relay(launch, component, StartName("/robot1/talker"), ["program", "--loud"], {"A": "1"})
        order = RelayOrder.read(path)
        private = {port: f"/_midstride/relay/robot1/talker/{port}" for port in ("out", "log")}
        assert (order.node, order.topics, order.environment) == ("/robot1/talker", private, {"A": "1"})
        assert order.command[:9] == [
            *("program", "--loud", "--ros-args", "-r", "__node:=talker", "-r", "__ns:=/robot1", "-r"),
            f"chatter:={private['out']}",
        ]
        assert f"~/log:={private['log']}" in order.command  # although its port is attached to nothing
        assert nodes.runs("/robot1/talker")
        await nodes.close()
        # The next manager knows the node of the program as well.
        another = ForeignNodes(tmp_path / "gates", SocketFolder(tmp_path / "components"), lambda _: None)
        await another.adopt("robot1/talker")
        assert another.runs("/robot1/talker") and another.names == {"/robot1/talker"}
        another.gone("robot1/talker")
        assert not another.runs("/robot1/talker") and not path.exists()

    asyncio.run(scenario())


@pytest.mark.parametrize(
    "error", [BackendError("no such class"), NodeError("no such mode"), OverflowError("too large")]
)
def test_whatever_keeps_a_node_from_being_loaded_is_said_at_once(error: Exception, tmp_path: Path) -> None:
    specification = parsed(TEXT.partition("component Other")[0].replace("gate preload", "gate none"), tmp_path)
    launch, component = launched("Talker", specification, "robot1"), specification.components["Talker"]
    said = list[tuple[str, str]]()

    async def scenario() -> None:
        failed = asyncio.Event()

        async def load(record: ForeignRecord, request: LoadRequest, timeout: float) -> None:
            raise error

        async def note(instance: str, because: str) -> None:
            said.append((instance, because))
            failed.set()

        folder, transport = tmp_path / "gates", SocketFolder(tmp_path / "components")
        nodes = ForeignNodes(folder, transport, lambda _: None, load=load, failed=note)
        _, record = await nodes.prepare(launch, component, "/robot1/talker", StartedPrograms((), {}))
        request = LoadRequest("/robot1/talker_container", "demo", "demo::Talker", "/robot1/talker")
        await nodes.started(record, Handle("robot1/talker", 1), request)
        await asyncio.wait_for(failed.wait(), 60)
        await nodes.close()

    asyncio.run(scenario())
    assert said == [("robot1/talker", str(error))]


def test_the_page_of_a_node_is_prepared_before_it_starts(
    tmp_path: Path, gate_library: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(gate_library.parents[1]))
    specification = parsed(TEXT.partition("component Other")[0], tmp_path)
    launch, component = launched("Talker", specification, "robot1"), specification.components["Talker"]

    async def scenario() -> None:
        nodes = ForeignNodes(tmp_path / "gates", SocketFolder(tmp_path / "components"), lambda _: None)
        base = {"XDG_CACHE_HOME": str(gate_library.parents[1]), "PATH": "/usr/bin:/bin", "LD_PRELOAD": "/lib/other.so"}
        variables, record = await nodes.prepare(launch, component, "/robot1/talker", StartedPrograms((), base))
        assert variables["LD_PRELOAD"] == f"{gate_library}:/lib/other.so"
        assert record.topics == {"out": "/chat", "log": "/robot1/talker/log"}
        page = Page(Path(variables["MIDSTRIDE_GATE_PAGE"]), gate_library)
        index = int(variables["MIDSTRIDE_GATE_NODE"])
        assert [(port.topic, port.gate) for port in page.ports(index)] == [(b"/chat", 0), (b"/robot1/talker/log", 0)]
        nodes.discard(record)
        assert not page.layout.nodes[index].used and page.ports(index) == []
        await nodes.close()

    asyncio.run(scenario())


def test_a_hand_over_is_between_two_that_can_be_held_back(tmp_path: Path) -> None:
    specification = parsed(TEXT.replace('other.py"', 'other.py" gate none'), tmp_path)
    unmodified = specification.instance("talker")
    other = specification.with_replaced("talker", "Other").instance("talker", "talker_2")
    both = Configuration(specification.context).with_instance(unmodified).with_instance(other)
    assert choose_arbiter(both.component, "talker", "talker") is BATON
    words = "talker has `gate preload` and talker_2 has `gate none`, so talker_2 cannot be held back for the other; use"
    with pytest.raises(StepFailed, match=words):
        choose_arbiter(both.component, "talker", "talker_2")
    ours = replace(unmodified, name="talker_3", component=replace(unmodified.component, gate=None))
    relayed = replace(unmodified, name="talker_4", component=replace(unmodified.component, gate="relay"))
    mixed = both.with_instance(ours).with_instance(relayed)
    for pair in pairwise(("talker", "talker_3", "talker_4", "talker", "talker_4", "talker_3", "talker")):
        assert choose_arbiter(mixed.component, *pair) is (BATON if "talker" in pair else LOCK)
    with pytest.raises(StepFailed, match="talker_3 uses Midstride's API and talker_2 has `gate none`"):
        choose_arbiter(mixed.component, "talker_3", "talker_2")
    with pytest.raises(StepFailed, match="talker_4 has `gate relay`, so talker_2 cannot be held back for the other"):
        choose_arbiter(mixed.component, "talker_2", "talker_4")
    port = initial(specification).attached_ports("talker")[0][0]
    assert early_publishers(both, [port]) == 1
    assert early_publishers(mixed, [PortRef("talker_4", "out")]) == 0


class Counting:
    """Subscribers that count so many publishers."""

    def __init__(self, matched: int) -> None:
        self.matched = matched
        self.life = LifeTable(SystemClock())
        self.wanted: list[int] = []

    async def publisher_ids(self, topic: str, instance: str) -> None:
        return None

    async def read(self, instance: str, command: AwaitMatchCommand) -> Attached:
        self.wanted.append(command.peers)
        return Attached(matched=self.matched)


@pytest.mark.parametrize(("matched", "found"), [(1, False), (2, True), (3, True)])
def test_a_publisher_that_exists_before_it_is_attached_is_counted_once(
    tmp_path: Path, matched: int, found: bool
) -> None:
    """The subscriber may count the new one already, and one that has left without a word."""
    listener = """component Listener {
  run "python3 listener.py"
  input in : std_msgs/msg/String @ 50 Hz
  functionality listen {
    uses in
    mode normal { assume in }
    mode degraded { }
  }
}
node listener : Listener { in <- /chat }
"""
    specification = parsed(
        TEXT.partition("component Other")[0] + listener + "node talker : Talker { out -> /chat }\n", tmp_path
    )
    configuration = initial(specification).with_instance(specification.instance("talker", "talker_2"))
    old, new = PortRef("talker", "out"), PortRef("talker_2", "out")

    async def scenario() -> None:
        client: Any = Counting(matched)
        backend: Any = client
        before = await publishers_found(client, configuration, "/chat", early=1)
        assert client.wanted == [0]
        await require_found(client, backend, configuration, [Swap("/chat", old, new)], "/chat", before)
        assert client.wanted == [0, 2]

    if found:
        asyncio.run(scenario())
    else:
        with pytest.raises(StepFailed, match="has found only 1 of 2 publishers"):
            asyncio.run(scenario())


def test_a_plan_is_refused_if_it_hands_over_to_one_that_cannot_be_held_back(tmp_path: Path) -> None:
    specification = parsed(TEXT.replace('other.py"', 'other.py" gate none'), tmp_path)
    change = change_between(initial(specification), specification, specification.with_replaced("talker", "Other"))
    with pytest.raises(PlanRefused, match="talker_2 has `gate none`, so talker_2 cannot be held back for the other"):
        require_arbiters(planner("minimal")(change))
    require_arbiters(planner("paper")(change))
    ungated = parsed(TEXT.replace("gate preload", "gate none").replace('other.py"', 'other.py" gate none'), tmp_path)
    change = change_between(initial(ungated), ungated, ungated.with_replaced("talker", "Other"))
    with pytest.raises(PlanRefused, match="both have `gate none`, so neither can be held back"):
        require_arbiters(planner("minimal")(change))


@pytest.mark.parametrize(("gate", "refused"), [("preload", True), ("none", True), ("relay", False)])
def test_between_hosts_only_nodes_with_an_agent_hand_over(gate: str, refused: bool, tmp_path: Path) -> None:
    both = TEXT.replace('other.py"', 'other.py" gate none').replace("gate preload", f"gate {gate}")
    specification = parsed(both, tmp_path)
    moved = specification.with_node(replace(specification.nodes["talker"], host="arm"))
    moved = replace(moved, hosts=Map(arm=HostSpec("arm", "arm")))
    change = change_between(initial(specification), specification, moved)
    if not refused:
        require_arbiters(planner("minimal")(change))
        return
    words = (
        rf"talker cannot hand over /chat from the host of the manager to host arm: talker has `gate {gate}`, which "
        "works within one host; use `gate relay`, Midstride's API, or `--strategy paper`"
    )
    with pytest.raises(PlanRefused, match=words):
        require_arbiters(planner("minimal")(change))
    require_arbiters(planner("paper")(change))
