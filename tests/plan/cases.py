"""Small systems that have names: what the tests of the planners speak of."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from immutables import Map

from midstride.model.component import (
    Assumption,
    ComponentSpec,
    Connector,
    EnvironmentGuarantee,
    FunctionalitySpec,
    InputAlternatives,
    Mode,
    ParameterSpec,
    Resource,
)
from midstride.model.configuration import Configuration
from midstride.model.contract import Predicate
from midstride.model.rules import violations
from midstride.model.specification import Constraint, Node, Specification, initial
from midstride.plan.change import Change
from midstride.plan.change_builder import change_between, requested_change
from midstride.plan.plan import Plan
from midstride.plan.request import PlanRequest
from midstride.plan.strategies.registry import STRATEGIES
from tests.replay.plan_replay import replay

TYPE = "std_msgs/msg/String"
NEED = Predicate(TYPE, 10.0)
SLOW = Predicate(TYPE, 5.0)

# Round numbers, so that the tests can say what comes out.
TIMING = {
    "create": 1.0, "remove": 0.5, "attach": 0.1, "detach": 0.1,
    "degrade": 0.01, "upgrade": 0.01, "handover": 0.1, "set": 0.01, "probation": 0.0,
}  # fmt: skip


def functionality(
    name: str,
    inputs: Iterable[str] = (),
    outputs: Iterable[str] = (),
    *,
    assumes: Iterable[Assumption] | None = None,
    weight: float = 1.0,
    between: Iterable[Mode] = (),
    degraded: Mapping[str, Predicate] | None = None,
) -> FunctionalitySpec:
    """Normal: assumes every input, guarantees NEED on every output. Degraded: nothing, unless said otherwise."""
    used, made = tuple(inputs), tuple(outputs)
    assumed = tuple(InputAlternatives((port,)) for port in used) if assumes is None else tuple(assumes)
    modes = (
        Mode("normal", assumed, Map(dict.fromkeys(made, NEED))),
        *between,
        Mode("degraded", (), Map(degraded or {})),
    )
    return FunctionalitySpec(name, modes, used, made, weight)


def component(
    name: str,
    *functionalities: FunctionalitySpec,
    needs: Mapping[str, Predicate] | None = None,
    resource_usage: Mapping[str, float] | None = None,
    parameters: Mapping[str, ParameterSpec] | None = None,
    startup_seconds: float | None = None,
    run: str | None = None,
) -> ComponentSpec:
    """A component of these functionalities; its ports are theirs, its inputs need NEED unless said otherwise."""
    inputs = {port: NEED for f in functionalities for port in f.inputs} | dict(needs or {})
    outputs = tuple(port for f in functionalities for port in f.outputs)
    return ComponentSpec.of(
        name,
        inputs=inputs,
        outputs=outputs,
        functionalities=functionalities,
        resource_usage=resource_usage,
        parameters=parameters,
        run=run or f"python3 {name}.py",
        startup_seconds=startup_seconds,
    )


def work(name: str, inputs: Iterable[str] = (), outputs: Iterable[str] = (), **others: object) -> ComponentSpec:
    """A component of one functionality, ``work``."""
    return component(name, functionality("work", inputs, outputs), **others)  # type: ignore[arg-type]


def system(
    components: Iterable[ComponentSpec],
    nodes: Mapping[str, tuple[str, Mapping[str, str | tuple[str, ...]]]],
    *,
    caps: Mapping[str, int] | None = None,
    environment: Iterable[EnvironmentGuarantee] = (),
    resources: Mapping[str, float] | None = None,
    constraints: Iterable[Constraint] = (),
    topics: Mapping[str, Predicate] | None = None,
) -> Specification:
    """A specification; its topics are those that its nodes name, each with the guarantee NEED unless said otherwise."""
    table = {}
    for role, (of, attachments) in nodes.items():
        own = {port: (names,) if isinstance(names, str) else names for port, names in attachments.items()}
        table[role] = Node(role, of, Map(own))
    named = {name for node in table.values() for names in node.attachments.values() for name in names} | set(
        topics or {}
    )
    return Specification(
        "case",
        connectors=Map({n: Connector(n, (topics or {}).get(n, NEED), (caps or {}).get(n)) for n in sorted(named)}),
        components=Map({each.name: each for each in components}),
        nodes=Map(table),
        environment=tuple(environment),
        resources=Map({name: Resource(name, capacity) for name, capacity in (resources or {}).items()}),
        constraints=tuple(constraints),
        timing=Map(TIMING),
    )


def talker() -> Specification:
    """The paper's section 5.2."""
    listen = component("Listener", functionality("listen", ["in"]))
    talkers = [component(name, functionality("talk", outputs=["out"])) for name in ("Talker", "NewTalker")]
    nodes = {"talker": ("Talker", {"out": "/chatter"}), "listener": ("Listener", {"in": "/chatter"})}
    return system([*talkers, listen], nodes)


def requested(configuration: Configuration, specification: Specification, request: PlanRequest) -> Change:
    return requested_change(configuration, specification, request, request.target(specification))


def replacing(configuration: Configuration, specification: Specification, role: str, component: str) -> Change:
    return requested(configuration, specification, PlanRequest(replace=((role, component),)))


def adding(configuration: Configuration, specification: Specification, node: Node) -> Change:
    return requested(configuration, specification, PlanRequest(add=(node,)))


def removing(configuration: Configuration, specification: Specification, role: str) -> Change:
    return requested(configuration, specification, PlanRequest(remove=(role,)))


def replaced(specification: Specification, role: str, component: str, strategy: str) -> Plan:
    change = replacing(initial(specification), specification, role, component)
    return STRATEGIES[strategy](change)


def changed(start: Specification, target: Specification, strategy: str) -> Plan:
    return STRATEGIES[strategy](change_between(initial(start), start, target))


def told(plan: Plan) -> list[str]:
    """The steps in words."""
    return [step.describe() for step in plan.steps]


def sound(plan: Plan) -> Plan:
    """The plan, once its replay has found nothing and every configuration on the way is valid."""
    result = replay(plan)
    assert result.holds, str(result)
    assert str(result).startswith(f"the plan holds: {len(plan.steps)} steps replayed")
    for configuration in plan.configurations():
        assert violations(configuration) == []
    return plan


def fallen(plan: Plan) -> list[str]:
    return [str(ref) for ref in plan.degraded]
