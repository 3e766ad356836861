"""What a manager asks of a node without Midstride's API, where rclpy itself fails."""

from __future__ import annotations

import asyncio
import sys
from itertools import pairwise
from types import ModuleType
from typing import Any
from unittest.mock import MagicMock, Mock

import pytest

from midstride.backends.simulator.virtual_loop import run
from midstride.errors import BackendError
from midstride.foreign.services import NoAnswer

pytestmark = pytest.mark.ros2


@pytest.mark.parametrize("fails", ["create", "ready", "send", "take"])
def test_what_rclpy_raises_is_no_answer(fails: str) -> None:
    """Those that ask expect that, and go on asking."""
    from midstride.backends.ros2.manager.node_services import RosNodeServices

    error, client, node = RuntimeError("error not set"), MagicMock(), Mock()
    node.create_client = Mock(return_value=client, side_effect=error if fails == "create" else None)
    client.service_is_ready.side_effect = error if fails == "ready" else None
    client.handle.send_request.side_effect = error if fails == "send" else None
    client.handle.take_response.side_effect = error if fails == "take" else None
    with pytest.raises(NoAnswer, match="/camera/get_state cannot be asked: error not set"):
        asyncio.run(RosNodeServices(node, "/camera").lifecycle_state(1.0))


def test_of_two_nodes_of_one_name_no_parameter_is_read() -> None:
    """Either may answer, and the other one's values are not those of the node."""
    from midstride.backends.ros2.manager.node_services import RosNodeServices

    node = Mock()
    node.get_node_names_and_namespaces.return_value = [("talk", "/"), ("talk", "/front"), ("talk", "/")]
    with pytest.raises(NoAnswer, match="more than one node is called /talk"):
        asyncio.run(RosNodeServices(node, "/talk").parameters(1.0))
    node.create_client.assert_not_called()


@pytest.mark.parametrize("damaged", ["bytes", "type"])
def test_a_noted_request_that_cannot_be_read_is_named_so(damaged: str) -> None:
    """A fault of rclpy's kind would end what watches the node."""
    from rcl_interfaces.msg import Parameter, ParameterValue
    from rcl_interfaces.srv import SetParameters
    from rclpy.serialization import serialize_message

    from midstride.backends.ros2.manager.node_services import RosNodeServices

    parameters = [Parameter(name="gain", value=ParameterValue(type=99))]
    request = b"\0\1\0\0\1" if damaged == "bytes" else serialize_message(SetParameters.Request(parameters=parameters))
    with pytest.raises(BackendError, match="a request to set parameters of /camera cannot be read"):
        RosNodeServices(Mock(), "/camera").settings_in(request)


class Container:
    """The clients of a container's services: ``loads`` seconds after a request it has the node, and does not respond.

    It goes on to list its nodes meanwhile, as one with several threads does.
    """

    def __init__(self, loads: float) -> None:
        self.loads = loads
        self.asked: list[float] = []

    def client(self, type_: str, name: str, callback_group: Any = None) -> MagicMock:
        client, responses = MagicMock(), list[tuple[Any, Any]]([(None, None)])

        def send(_: Any) -> int:
            now = asyncio.get_running_loop().time()
            if name.endswith("load_node"):
                self.asked.append(now)
            else:
                there = ["/front/talker"] if self.asked and now >= self.asked[0] + self.loads else []
                responses.insert(
                    0,
                    (
                        Mock(request_id=Mock(sequence_number=7)),
                        Mock(full_node_names=there, unique_ids=[1][: len(there)]),
                    ),
                )
            return 7

        client.handle.send_request.side_effect = send
        client.handle.take_response.side_effect = lambda _: responses.pop(0) if len(responses) > 1 else responses[0]
        return client


@pytest.mark.parametrize("loads", [0.5, 2.5, 9.0])
def test_a_container_is_asked_once_to_load_a_node(loads: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where its response is late or lost, it is asked which nodes it has: twice would be two nodes of one name."""
    from midstride.backends.ros2.manager import component_containers, container_services

    interfaces: Any = ModuleType("composition_interfaces.srv")
    interfaces.LoadNode, interfaces.ListNodes = MagicMock(), MagicMock()
    monkeypatch.setitem(sys.modules, "composition_interfaces", ModuleType("composition_interfaces"))
    monkeypatch.setitem(sys.modules, "composition_interfaces.srv", interfaces)
    container = Container(loads)
    node = Mock(create_client=container.client)
    services = container_services.ContainerServices(node, "/box")
    request = component_containers.LoadRequest("/box", "demo", "demo::Talker", "/front/talker")
    loaded = services.load(request, 5.0)
    if loads < 5.0:
        run(loaded)
    else:
        with pytest.raises(BackendError, match=r"demo::Talker of package demo is not loaded: .* not answered within 5"):
            run(loaded)
    assert len(container.asked) == 1


@pytest.mark.parametrize("offers", [True, False], ids=["sent", "not sent"])
@pytest.mark.parametrize("fails", [True, False], ids=["fails", "silent"])
def test_an_unload_that_was_sent_and_is_not_answered_may_still_be_carried_out(
    offers: bool, fails: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    from midstride.backends.ros2.manager import container_services

    interfaces: Any = ModuleType("composition_interfaces.srv")
    interfaces.UnloadNode, interfaces.ListNodes = MagicMock(), MagicMock()
    monkeypatch.setitem(sys.modules, "composition_interfaces", ModuleType("composition_interfaces"))
    monkeypatch.setitem(sys.modules, "composition_interfaces.srv", interfaces)
    container = Container(0.0)
    container.asked.append(0.0)

    def client(type_: str, name: str, callback_group: Any = None) -> MagicMock:
        found = container.client(type_, name)
        if name.endswith("unload_node"):
            found.handle.send_request.side_effect = lambda _: 7
            found.handle.take_response.side_effect = RuntimeError("no memory") if fails else lambda _: None
            found.service_is_ready.return_value = offers
        return found

    services = container_services.ContainerServices(Mock(create_client=client), "/box")
    with pytest.raises(BackendError, match="/front/talker is not unloaded: ") as raised:
        run(services.unload("/front/talker", 2.0))
    assert isinstance(raised.value, container_services.UnloadUnanswered) == offers


@pytest.mark.parametrize("loads", [0.5, 4.0])
def test_a_node_is_gone_once_its_container_says_so(loads: float, monkeypatch: pytest.MonkeyPatch) -> None:
    from midstride.backends.ros2.manager import container_services

    services = container_services.ContainerServices(Mock(), "/box")

    async def body() -> float:
        loop = asyncio.get_running_loop()

        async def nodes(timeout: float) -> dict[int, str]:
            if loop.time() < loads / 2:
                raise NoAnswer("busy")
            return {1: "/front/talker"} if loop.time() < loads else {}

        monkeypatch.setattr(services, "_nodes", nodes)
        await services.until_gone("/front/talker")
        return loop.time()

    assert loads <= run(body()) < loads + 1.1


def test_the_shown_command_gives_texts_as_texts() -> None:
    """Of `5`, `ros2 component load` would make an integer, and of `true` a truth value."""
    import yaml  # type: ignore[import-untyped, unused-ignore]  # with its stubs or without

    from midstride.backends.ros2.manager.component_containers import LoadRequest

    values = {"serial": "5", "on": "true", "none": "", "odd": "a: [", "day": "2024-13-01", "plain": "/dev/x", "n": 2}
    command = LoadRequest("/box", "demo", "demo::Talker", "/talker", parameters=values).command()
    given = dict(word.split(":=", 1) for option, word in pairwise(command) if option == "-p")
    assert {name: yaml.safe_load(word) for name, word in given.items()} == values
    assert (given["serial"], given["plain"]) == ('"5"', "/dev/x")


@pytest.mark.parametrize(("asks", "expected"), [("list", [0.0, 0.1, 0.3, 0.7, 1.5]), ("unload", [0.0, 1.0, 2.0])])
def test_a_lost_request_is_sent_again_soon_where_it_changes_nothing(
    asks: str, expected: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    from midstride.backends.ros2.manager import container_services

    interfaces: Any = ModuleType("composition_interfaces.srv")
    interfaces.UnloadNode, interfaces.ListNodes = MagicMock(), MagicMock()
    monkeypatch.setitem(sys.modules, "composition_interfaces", ModuleType("composition_interfaces"))
    monkeypatch.setitem(sys.modules, "composition_interfaces.srv", interfaces)
    sent: list[float] = []

    def client(type_: str, name: str, callback_group: Any = None) -> MagicMock:
        found = MagicMock()
        found.handle.send_request.side_effect = lambda _: sent.append(asyncio.get_running_loop().time())
        found.handle.take_response.side_effect = lambda _: None
        return found

    services = container_services.ContainerServices(Mock(create_client=client), "/box")
    with pytest.raises(NoAnswer):
        run(
            services._nodes(2.4)
            if asks == "list"
            else services._call(interfaces.UnloadNode, "_container/unload_node", 2.4, None)
        )
    assert [round(at - sent[0], 1) for at in sent] == expected
