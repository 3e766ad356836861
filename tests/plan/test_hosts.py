"""Nodes that move from one host to another: their plans, and the differences between specifications."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import pytest
from immutables import Map

from midstride.errors import PlanRefused
from midstride.model.component import ComponentSpec, Connector, ContainerProgram, Resource
from midstride.model.hosts import HostSpec
from midstride.model.specification import Node, Specification, initial
from midstride.plan.change_builder import change_between, requested_change
from midstride.plan.estimate import Estimate
from midstride.plan.forms.plan_forms import decode_plan, encode_plan
from midstride.plan.plan import Plan
from midstride.plan.request import PlanRequest
from midstride.plan.specification_diff import differences
from midstride.plan.strategies.registry import planner
from tests.model.build import at, source
from tests.replay.plan_replay import replay

WORKER = replace(source("Worker"), run="worker", resource_usage=Map(gpu=2.0))
HOSTS = Map({name: HostSpec(name, f"robot@{name}") for name in ("arm", "base")})


def system(*, gpu: Mapping[str, float], on: str = "arm", component: ComponentSpec = WORKER) -> Specification:
    """One worker, on a host; ``gpu``: the capacity of each host's."""
    resources = [Resource("gpu", capacity, host) for host, capacity in gpu.items()]
    return Specification(
        "two",
        connectors=Map({"/x": Connector("/x", at(10.0))}),
        components=Map({component.name: component}),
        nodes=Map(worker=Node("worker", component.name, Map(out=("/x",)), host=on)),
        resources=Map({each.key: each for each in resources}),
        hosts=HOSTS,
    )


def planned(specification: Specification, request: PlanRequest, measured: Mapping[str, Estimate] | None = None) -> Plan:
    target = request.target(specification)
    change = requested_change(initial(specification), specification, request, target, measured)
    plan = planner("minimal")(change)
    assert replay(plan).holds
    return plan


def words(plan: Plan) -> list[str]:
    return [step.describe() for step in plan.steps]


def test_a_move_holds_the_resources_of_both_hosts_and_hands_over() -> None:
    specification = system(gpu={"arm": 2.0, "base": 2.0})
    plan = planned(specification, PlanRequest(on=(("worker", "base"),)))
    assert words(plan) == [
        "create worker_2 (Worker) on base",
        "upgrade worker_2.work from degraded to normal",
        "hand over /x from worker.out to worker_2.out",
        "remove worker",
    ]
    assert plan.disruption == 0 and plan.change.final.instances["worker_2"].host == "base"
    held = [dict(each.held) for each in plan.configurations()]
    assert {"gpu on arm": 2, "gpu on base": 2} in held and held[-1] == {"gpu on base": 2}
    assert decode_plan(encode_plan(plan)).steps == plan.steps
    (remark,) = plan.remarks
    assert remark.startswith("worker moves from host arm to host base: worker_2 is a new process of the same program")
    assert remark.endswith("how long Worker takes to start there has not been measured")


def test_on_one_host_the_same_replacement_has_to_let_go_first() -> None:
    specification = system(gpu={"arm": 2.0, "base": 2.0})
    plan = planned(specification, PlanRequest(restart=("worker",)))
    assert words(plan).index("remove worker") < words(plan).index("create worker_2 (Worker) on arm")
    assert plan.disruption > 0 and not plan.remarks


def test_what_a_start_took_on_another_host_is_not_expected_here() -> None:
    specification = system(gpu={"arm": 2.0, "base": 2.0})
    measured = {"create Worker on arm": Estimate.exactly(7.0), "create Worker on base": Estimate.exactly(3.0)}
    request = PlanRequest(on=(("worker", "base"),))
    assert planned(specification, request, measured).steps[0].seconds == 3.0
    measured.pop("create Worker on base")
    plan = planned(specification, request, measured)
    assert plan.steps[0].seconds == 1.0 and "has not been measured" in plan.remarks[0]
    assert (
        "has not been measured"
        not in planned(specification, request, {**measured, "create Worker on base": Estimate.exactly(3.0)}).remarks[0]
    )


@pytest.mark.parametrize(
    ("request_", "because"),
    [
        (
            PlanRequest(on=(("worker", "arm"),)),
            "worker is on host arm already; `midstride restart worker` starts it again there",
        ),
        (PlanRequest(on=(("worker", "bsae"),)), "there is no host `bsae`; did you mean `base`?"),
        (
            PlanRequest(on=(("worker", "manager"),)),
            "worker is on the host of the manager and holds gpu, which only host arm and host base have: a process "
            "cannot use the resources of another host",
        ),
    ],
)
def test_moves_that_cannot_be_are_refused(request_: PlanRequest, because: str) -> None:
    with pytest.raises(PlanRefused) as refused:
        planned(system(gpu={"arm": 2.0, "base": 2.0}), request_)
    assert because in str(refused.value)


def test_a_node_of_a_container_moves_with_it() -> None:
    component = replace(WORKER, container=ContainerProgram(), package="demo", gate="preload", topics=Map(out="x"))
    specification = system(gpu={"arm": 4.0, "base": 4.0}, component=component)
    node = replace(specification.nodes["worker"], container="box")
    specification = replace(specification, nodes=Map(worker=node), containers=Map(box=ContainerProgram(host="arm")))
    with pytest.raises(PlanRefused, match="is loaded by container box, which is on host arm, and moves with it"):
        PlanRequest(on=(("worker", "base"),)).target(specification)
    moved = replace(
        specification,
        nodes=Map(worker=replace(node, host="base")),
        containers=Map(box=ContainerProgram(host="base")),
    )
    plan = planned(specification, PlanRequest(to=moved))
    assert words(plan)[0] == "create worker_2 (Worker) on base"
    assert [str(each) for each in differences(specification, moved)] == [
        "container box: changed\n  on: arm -> base",
        "node worker: replaced\n  moves from host arm to host base",
    ]


def test_another_component_on_another_host() -> None:
    specification = system(gpu={"arm": 2.0, "base": 2.0})
    other = replace(WORKER, name="Other", run="other")
    specification = replace(specification, components=specification.components.set("Other", other))
    request = PlanRequest(replace=(("worker", "Other"),), on=(("worker", "base"),))
    assert request.describe() == "replace worker with Other on base"
    assert PlanRequest(on=(("worker", "base"),)).describe() == "move worker to base"
    plan = planned(specification, request)
    assert words(plan)[0] == "create worker_2 (Other) on base"
    assert "a new process of the program of Other there" in plan.remarks[0]


def test_a_host_that_runs_nodes_is_not_declared_differently() -> None:
    specification = system(gpu={"arm": 2.0, "base": 2.0})
    other = replace(specification, hosts=HOSTS.set("base", HostSpec("base", "robot@10.0.0.2")))
    assert not change_between(initial(specification), specification, other).coming
    assert [str(each) for each in differences(specification, other)] == [
        "host base: changed\n  ssh: robot@base -> robot@10.0.0.2"
    ]
    other = replace(specification, hosts=HOSTS.set("arm", HostSpec("arm", "robot@arm", folder="/opt")))
    with pytest.raises(PlanRefused) as refused:
        change_between(initial(specification), specification, other)
    assert str(refused.value).startswith(
        "host arm, on which worker runs, is declared differently (folder: not stated -> /opt): declare it under "
        "another name"
    )


def test_the_plan_of_a_system_without_hosts_says_nothing_of_them() -> None:
    specification = replace(system(gpu={"": 4.0}, on=""), hosts=Map())
    plan = planned(specification, PlanRequest(restart=("worker",)))
    assert "host" not in str(encode_plan(plan)) and not plan.remarks
