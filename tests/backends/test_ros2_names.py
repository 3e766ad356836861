"""Names of control nodes: whose they are, and which nodes are the instances of a role."""

from __future__ import annotations

import pytest

from midstride.backends.ros2 import names
from midstride.model.instance_names import full_name, split_name

HERE, ELSEWHERE = names.system_tag("the token of this system"), names.system_tag("that of another")


def control(instance: str, system: str = HERE) -> str:
    return full_name(names.control(instance, "counter", system), "/front")


@pytest.mark.parametrize(
    ("in_graph", "system", "instances"),
    [
        ([control("counter"), control("counter_2")], HERE, 2),
        ([control("counter_2"), control("counter_2")], HERE, 2),  # one has ended, and the graph still has it
        ([control("counter"), control("counter_2", ELSEWHERE)], HERE, 1),
        ([control("counter"), control("counter_2", ELSEWHERE)], "", 2),
        ([control("counter", system="")], HERE, 1),
        (["/front/counter", "/front/_ros2cli_daemon"], HERE, 0),
    ],
)
def test_how_many_instances_a_role_has(in_graph: list[str], system: str, instances: int) -> None:
    assert names.instances_of("/front/counter", ["/front/counter", *in_graph], system) == instances


@pytest.mark.parametrize(
    ("enclave", "system", "outside"),
    [
        ("/", HERE, 2),
        (names.enclave_of(HERE, "/front/counter_2"), HERE, 1),
        (names.enclave_of(ELSEWHERE, "/front/counter_2"), HERE, 2),
        (names.enclave_of(HERE, "/front/counter_2"), "", 2),  # of a component that was started by hand
    ],
)
def test_nodes_that_the_system_has_started_are_not_taken_for_others(enclave: str, system: str, outside: int) -> None:
    in_graph = [("/front/counter", "/"), ("/front/counter", enclave), ("/counter", "/")]
    assert names.outside("/front/counter", in_graph, system) == outside


@pytest.mark.parametrize("instance", ["/camera", "/front/camera", "/a/b/camera_2"])
def test_a_control_node_says_whose_it_is(instance: str) -> None:
    name, inside = split_name(instance)
    for node, system in ((name, ""), (name, HERE), ("other", HERE)):
        control = full_name(names.control(name, node, system), inside)
        assert names.is_hidden(control)
        assert names.controlled(control) == (instance, full_name(node, inside), system)
    assert names.controlled(instance) is None
    assert not names.is_hidden(instance)
