"""Services and ROS actions in the model and the language: connectors of a kind, with at most one server."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import pytest

from midstride.codec.specification_form import decode_specification, encode_specification
from midstride.errors import PlanRefused, SpecificationError
from midstride.generate.drawn_system import view
from midstride.generate.skeleton import skeleton
from midstride.lang.load import load_text
from midstride.model.component import Connector, FunctionalityRef, InputAlternatives
from midstride.model.contract import Predicate, explain, satisfies
from midstride.model.rules import Evaluator
from midstride.model.specification import Constraint, Order, Specification, initial
from midstride.plan.change_builder import change_between, requested_change
from midstride.plan.constraints import breaches
from midstride.plan.disruption import Levels
from midstride.plan.impact import impacts
from midstride.plan.plan import Plan
from midstride.plan.request import PlanRequest
from midstride.plan.specification_diff import differences
from midstride.plan.strategies.registry import planner
from midstride.runtime.handover.arbiter_choice import require_arbiters
from midstride.verify.alloy_atoms import AlloyAtoms
from midstride.verify.chain import chain
from midstride.verify.diagram import chain_lines
from tests.replay.plan_replay import replay

MAP = "nav_msgs/srv/GetMap"
TEXT = """system mapping
contract Map = nav_msgs/srv/GetMap responds within 50 ms
service /map : Map
action /dock : nav2_msgs/action/DockRobot accepts within 0.5 s
component Server {
  run "server" gate preload
  server map
  functionality serve { produces map  mode normal { guarantee map : Map }  mode off { } }
}
component Docking {
  run "docking" gate preload
  client map : nav_msgs/srv/GetMap responds within 0.1 s
  action server dock
  functionality docking {
    uses map
    produces dock
    mode normal { assume map  guarantee dock : nav2_msgs/action/DockRobot accepts within 0.5 s }
    mode off { }
  }
}
component Mission {
  run "mission" gate preload
  action client dock : nav2_msgs/action/DockRobot
  functionality drive { uses dock  mode normal { assume dock }  mode off { } }
}
node map_server : Server { map -> /map }
node docking : Docking { map <- /map  dock -> /dock }
node mission : Mission { dock <- /dock }
"""


def with_constraint(specification: Specification, constraint: Constraint) -> Specification:
    return replace(specification, constraints=(*specification.constraints, constraint))


def restarted(specification: Specification, role: str) -> Plan:
    request = PlanRequest(restart=(role,))
    return planner()(requested_change(initial(specification), specification, request, request.target(specification)))


@pytest.mark.parametrize(
    ("offered", "needed", "why"),
    [
        (0.05, 0.1, None),
        (0.1, 0.1, None),
        (0.05, None, None),
        (None, None, None),
        (0.2, 0.1, "bound: responds within 0.2 s is offered, at most 0.1 s is needed"),
        (None, 0.1, "bound: no bound is offered, at most 0.1 s is needed"),
    ],
)
def test_a_bound_satisfies_one_that_is_not_shorter(
    offered: float | None, needed: float | None, why: str | None
) -> None:
    pair = Predicate(MAP, within=offered), Predicate(MAP, within=needed)
    assert satisfies(*pair) == (why is None)
    assert explain(*pair) == ([] if why is None else [why])


def test_a_service_has_at_most_one_server() -> None:
    assert Connector("/map", Predicate(MAP)).max_publishers == 1
    assert Connector("/map", Predicate("nav_msgs/msg/Path")).max_publishers is None
    assert Connector("/map", Predicate(MAP), 3).max_publishers == 1, "whatever is stated"
    result = load_text(TEXT + "node second : Server { map -> /map }\n")
    assert [each.code for each in result.diagnostics] == ["E022"]


def test_what_relies_on_a_server_degrades_without_it() -> None:
    first = impacts(load_text(TEXT).require(), ("map_server",))[0]
    assert {(str(each.functionality), each.after) for each in first.impacted} >= {
        ("docking.docking", "off"),
        ("mission.drive", "off"),
    }
    specification = load_text(TEXT.replace("{ map -> /map }", "{ }", 1)).require()
    evaluator = Evaluator(initial(specification))
    assert "/map has no server" in evaluator.why_connector_unsatisfied("/map")
    configuration, ref = initial(specification), FunctionalityRef("docking", "docking")
    (*_, last) = chain_lines(chain(configuration, ref, InputAlternatives(("map",))))
    assert last.endswith("/map (nav_msgs/srv/GetMap responds within 0.05 s: no server): not satisfied")


def test_the_json_form_lists_each_kind_apart() -> None:
    specification = load_text(TEXT).require()
    document = encode_specification(specification)
    text = json.loads(json.dumps(document))
    assert text["services"] == {"/map": {"type": MAP, "within_seconds": 0.05}}
    assert text["actions"] == {"/dock": {"type": "nav2_msgs/action/DockRobot", "within_seconds": 0.5}}
    assert decode_specification(text) == specification


def test_a_difference_is_of_a_service_or_a_ros_action() -> None:
    before = load_text(TEXT).require()
    sooner = TEXT.replace("DockRobot accepts within 0.5 s", "DockRobot accepts within 0.4 s")
    (found, *_) = differences(before, load_text(sooner).require())
    assert str(found).replace("nav2_msgs/action/", "") == (
        "ROS action /dock: changed\n"
        "  contract: DockRobot accepts within 0.5 s -> DockRobot accepts within 0.4 s\n"
        "  a new contract makes a new ROS action: its ports are detached and attached again"
    )
    (other, *_) = differences(before, load_text(TEXT.replace("/map", "/maps")).require())
    assert str(other) == "service /map: removed"


def test_the_drawing_of_a_service_states_no_cap() -> None:
    notes = {each.name: each.note for each in view(load_text(TEXT).require(), annotate=True).topics}
    assert notes["/map"] == "nav_msgs/srv/GetMap responds within 0.05 s"


def test_where_two_servers_would_be_needed_at_once_the_refusal_says_so() -> None:
    """The new one cannot respond at first, so it cannot take over, and both at once are one too many."""
    start = load_text(TEXT).require()
    new = """component NewServer {
  run "new" gate preload
  client other : nav_msgs/srv/GetMap
  server map
  functionality serve {
    uses other
    produces map
    mode normal { assume other  guarantee map : Map }
    mode off { }
  }
}
limit map_server.serve below baseline 0 s
"""
    target = load_text(TEXT.replace("map_server : Server", "map_server : NewServer") + new).require()
    with pytest.raises(PlanRefused, match="do not fit at the same time: /map has at most one server"):
        planner()(change_between(initial(start), start, target))


@pytest.mark.parametrize(("first", "then"), [("spare", "map_server"), ("map_server", "spare")])
def test_a_hand_over_between_two_roles_belongs_to_both_so_no_order_of_them_has_it(first: str, then: str) -> None:
    """`/map` moves to another node: in one step, or given up first where that is the order asked for."""
    in_place = re.sub("  run .*\n", "", TEXT)
    start = load_text(in_place + "node spare : Server { }\n").require()
    moved = in_place.replace("map_server : Server { map -> /map }", "map_server : Server { }")
    target = load_text(moved + "node spare : Server { map -> /map }\n").require()
    free = planner()(change_between(initial(start), start, target))
    assert [(step.action.kind, step.roles) for step in free.steps if step.is_structural] == [
        ("handover", ("map_server", "spare"))
    ]
    order = Order(first, then)
    (breach,) = breaches(free.steps, Levels(free.change), [order])
    assert str(breach).endswith(" belongs to both")
    assert f"`{order}` is broken by step" in str(
        replay(replace(free, change=replace(free.change, target=with_constraint(free.change.target, order))))
    )
    ordered = change_between(initial(start), start, with_constraint(target, order))
    if first == "spare":
        with pytest.raises(PlanRefused, match="do not fit at the same time: /map has at most one server"):
            planner()(ordered)
    else:
        plan = planner()(ordered)
        assert replay(plan).holds
        assert "handover" not in {step.action.kind for step in plan.steps}


def test_a_server_is_handed_over_as_an_output_is() -> None:
    specification = load_text(TEXT).require()
    plan = restarted(specification, "map_server")
    assert [step.action.kind for step in plan.steps] == ["create", "upgrade", "handover", "remove"]
    assert not plan.degradations
    require_arbiters(plan)


def test_without_the_library_a_hand_over_of_a_server_is_refused_before_anything_starts() -> None:
    specification = load_text(TEXT.replace("gate preload", "gate none")).require()
    plan = restarted(specification, "map_server")
    with pytest.raises(PlanRefused, match="has `gate none`, so both would answer requests while both run"):
        require_arbiters(plan)


@pytest.mark.parametrize(("gate", "refused"), [("", []), (" gate relay", ["dock", "map"])])
def test_clients_behind_a_relay_are_refused(gate: str, refused: list[str]) -> None:
    result = load_text(TEXT.replace(" gate preload", gate))
    assert {each.code for each in result.diagnostics} <= {"E027"}
    named = [each.message.partition(" cannot be declared yet")[0].split()[-1] for each in result.diagnostics]
    assert sorted(named) == refused


def test_a_server_is_handed_over_between_components_with_the_api_and_nodes_with_the_library() -> None:
    own = TEXT.replace('run "server" gate preload', 'run "server"')
    specification = load_text(own).require()
    require_arbiters(restarted(specification, "map_server"))
    changed = load_text(own + 'component Plain like Server { run "plain" gate preload }\n').require()
    request = PlanRequest(replace=(("map_server", "Plain"),))
    plan = planner()(requested_change(initial(changed), changed, request, request.target(changed)))
    require_arbiters(plan)


@pytest.mark.parametrize(
    ("gate", "other", "advice"),
    [
        ("preload", "", "so both would execute each goal; use `gate relay` for Docking, or `--strategy paper`"),
        ("none", "", "while both run; use `gate relay` for Docking, or `--strategy paper`"),
        ("none", " gate relay", "while both run; use `gate relay` for Docking, or `--strategy paper`"),
        ("none", " gate preload", "while both run; use `gate preload`, or `--strategy paper`"),
    ],
)
def test_a_ros_action_is_not_handed_over_between_the_api_and_what_is_not_relayed(
    gate: str, other: str, advice: str
) -> None:
    """A way that the message advises is not refused."""
    system = TEXT.replace("  client map : nav_msgs/srv/GetMap responds within 0.1 s\n", "")
    system = system.replace("    uses map\n", "").replace("assume map  ", "")
    system = system.replace("Docking { map <- /map  dock", "Docking { dock")

    def plan_of(gate: str) -> Plan:
        text = system.replace('run "docking" gate preload', f'run "docking" gate {gate}')
        specification = load_text(text + f'component Own like Docking {{ run "own"{other} }}\n').require()
        request = PlanRequest(replace=(("docking", "Own"),))
        return planner()(
            requested_change(initial(specification), specification, request, request.target(specification))
        )

    with pytest.raises(PlanRefused, match=advice):
        require_arbiters(plan_of(gate))
    require_arbiters(plan_of("preload" if "preload`, or" in advice else "relay"))


def test_a_relay_is_not_advised_for_a_server_of_an_action_that_has_a_client() -> None:
    specification = load_text(TEXT + 'component Own like Docking { run "own" }\n').require()
    request = PlanRequest(replace=(("docking", "Own"),))
    plan = planner()(requested_change(initial(specification), specification, request, request.target(specification)))
    with pytest.raises(PlanRefused, match="so both would execute each goal; use `--strategy paper`"):
        require_arbiters(plan)


@pytest.mark.parametrize("other", ["", " gate relay", " gate preload"])
def test_a_server_is_handed_over_between_a_relay_and_what_admits_requests_as_it_does(other: str) -> None:
    system = TEXT.partition("component Docking")[0].replace(" gate preload", " gate relay")
    system += f'component Other like Server {{ run "other"{other} }}\nnode map_server : Server {{ map -> /map }}\n'
    specification = load_text(system).require()
    request = PlanRequest(replace=(("map_server", "Other"),))
    plan = planner()(requested_change(initial(specification), specification, request, request.target(specification)))
    require_arbiters(plan)


def test_what_cannot_be_done_yet_says_so() -> None:
    specification = load_text(TEXT).require()
    with pytest.raises(SpecificationError, match=r"the ROS actions of Docking \(dock\) cannot be generated yet"):
        skeleton(specification.components["Docking"], "docking")


def test_alloy_is_given_which_bounds_satisfy_which() -> None:
    atoms = AlloyAtoms()
    short, long = (atoms.predicate(Predicate(MAP, within=within)) for within in (0.05, 0.1))
    assert (short, long) in atoms.tuples["sat"]
    assert (long, short) not in atoms.tuples["sat"]
