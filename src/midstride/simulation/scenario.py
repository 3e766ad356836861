"""The scenario of a seed: a system, and a change of it."""

from __future__ import annotations

import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Final

from immutables import Map

from midstride.lang.load import load_text
from midstride.model.component import DEFAULT_CONTAINER
from midstride.model.hosts import OWN_HOST, HostSpec, word_of_host
from midstride.model.respawn import RespawnPolicy
from midstride.model.specification import Node, Specification, initial
from midstride.plan.change_builder import change_between
from midstride.plan.request import PlanRequest
from midstride.plan.strategies.registry import planner
from midstride.simulation.stand_in import with_stand_ins

# Rate-driven, message-driven and transient-local topics, a chain of three modes, two functionalities in one component,
# an exclusive topic, and a parameter: every kind of step occurs.
_ROVER: Final = """
system rover

contract Data = std_msgs/msg/String @ 10 Hz
contract Once = std_msgs/msg/String qos(durability = transient_local)

topic /scan     : std_msgs/msg/String @ 10 Hz
topic /objects  : Data
topic /map      : Once
topic /alarms   : std_msgs/msg/String
topic /path     : Data
topic /velocity : std_msgs/msg/String @ 10 Hz { publishers <= 1 }

component Lidar {
  run "lidar"
  output out
  functionality scan { produces out  mode normal { guarantee out : std_msgs/msg/String @ 10 Hz }  mode off { } }
}
component FastLidar {
  run "lidar"
  output out
  functionality scan { produces out  mode normal { guarantee out : std_msgs/msg/String @ 12.5 Hz }  mode off { } }
}
component Detector {
  run "detector"
  input in : Data
  output out
  functionality detect { uses in  produces out  mode normal { assume in  guarantee out : Data }  mode off { } }
}
component NewDetector {
  run "detector"
  parameters { changeable gain = 1 }
  input in : Data
  output out
  functionality detect { uses in  produces out  mode normal { assume in  guarantee out : Data }  mode off { } }
}
component Mapper {
  run "mapper"
  input in : Data
  output out
  functionality chart { uses in  produces out  mode normal { assume in  guarantee out : Once }  mode off { } }
}
component Guard {
  run "guard"
  input in : std_msgs/msg/String
  output out
  functionality watch {
    uses in  produces out
    mode normal { assume in  guarantee out : std_msgs/msg/String }
    mode off { }
  }
}
component Planner {
  run "planner"
  input objects : Data
  input map : Once
  output out
  functionality plan {
    uses objects, map  produces out
    mode normal  { assume objects  assume map  guarantee out : Data }
    mode blind   { assume map  guarantee out : Data }
    mode off     { }
  }
}
component NewPlanner {
  run "planner"
  input objects : Data
  input map : Once
  output out
  functionality plan {
    uses objects, map  produces out
    mode normal  { assume objects  assume map  guarantee out : std_msgs/msg/String @ 12.5 Hz }
    mode blind   { assume map  guarantee out : Data }
    mode off     { }
  }
}
component Driver {
  run "driver"
  parameters { changeable speed = 1 }
  input path : Data
  input alarms : std_msgs/msg/String
  output out
  functionality drive weight 10 {
    uses path  produces out
    mode normal { assume path  guarantee out : std_msgs/msg/String @ 10 Hz }
    mode stop   { guarantee out : std_msgs/msg/String @ 10 Hz }
  }
  functionality listen { uses alarms  mode normal { assume alarms }  mode off { } }
}

node lidar    : Lidar    { out -> /scan }
node detector : Detector { in <- /scan  out -> /objects }
node mapper   : Mapper   { in <- /scan  out -> /map }
node guard    : Guard    { in <- /objects  out -> /alarms }
node planner  : Planner  { objects <- /objects  map <- /map  out -> /path }
node driver   : Driver   { path <- /path  alarms <- /alarms  out -> /velocity }
"""

# Servers and clients: a service that depends on a topic, a ROS action, a client that can do without one of the two, and
# one of the same service beside it. Its `guard` and `driver` are changed as those of the rover.
_DOCKING: Final = """
system docking

contract GetMap = docking_msgs/srv/GetMap responds within 0.2 s
contract Dock   = docking_msgs/action/Dock accepts within 0.2 s

topic   /scan    : std_msgs/msg/String @ 5 Hz
service /get_map : GetMap
action  /dock    : Dock
topic   /alarms  : std_msgs/msg/String @ 5 Hz
topic   /goals   : std_msgs/msg/String @ 10 Hz

component Lidar {
  run "lidar"
  output out
  functionality scan { produces out  mode normal { guarantee out : std_msgs/msg/String @ 5 Hz }  mode off { } }
}
component MapServer {
  run "map_server"
  input in : std_msgs/msg/String @ 5 Hz
  server map
  functionality serve { uses in  produces map  mode normal { assume in  guarantee map : GetMap }  mode off { } }
}
component NewMapServer like MapServer { run "map_server" }
component Charger {
  run "charger"
  action server dock
  functionality charge { produces dock  mode normal { guarantee dock : Dock }  mode off { } }
}
component NewCharger like Charger { run "charger" }
component Guard {
  run "guard"
  client map : GetMap
  output out
  functionality watch {
    uses map  produces out
    mode normal { assume map  guarantee out : std_msgs/msg/String @ 5 Hz }
    mode off { }
  }
}
component Driver {
  run "driver"
  parameters { changeable speed = 1 }
  client map : GetMap
  action client dock : Dock
  output out
  functionality drive weight 10 {
    uses map, dock  produces out
    mode normal   { assume map  assume dock  guarantee out : std_msgs/msg/String @ 10 Hz }
    mode undocked { assume map  guarantee out : std_msgs/msg/String @ 10 Hz }
    mode off      { }
  }
}

node lidar      : Lidar     { out -> /scan }
node map_server : MapServer { in <- /scan  map -> /get_map }
node charger    : Charger   { dock -> /dock }
node guard      : Guard     { map <- /get_map  out -> /alarms }
node driver     : Driver    { map <- /get_map  dock <- /dock  out -> /goals }
"""


@dataclass(frozen=True)
class Scenario:
    """``changes`` are requested one after the other, each while the one before is measured.

    ``steps``: the kinds of their steps, as often as they occur; those of a hand-over count three times.
    """

    specification: Specification
    changes: Sequence[PlanRequest]
    steps: Sequence[str]

    def specifications(self) -> list[Specification]:
        """Every specification that the system may have."""
        targets = (request.to for request in self.changes)
        return [self.specification, *(target for target in targets if target is not None)]


def _steps(specification: Specification, request: PlanRequest) -> list[str]:
    request = request.for_members(request.to or specification)
    target = request.target(specification)
    change = change_between(initial(specification), specification, target, renewed=request.renewed(target))
    kinds = [step.action.kind for step in planner(request.strategy, detours=request.detours)(change).steps]
    return kinds + 2 * [kind for kind in kinds if kind == "handover"]


# The built-in systems, and the components that have no state: while a state moves, nothing is called that could write,
# and without one, only the gates keep two from being heard.
_BUILT_IN: Final = {
    "rover": (_ROVER, ("Lidar", "FastLidar")),
    "docking": (_DOCKING, ("Lidar", "Charger", "NewCharger")),
}


@cache
def _built_in(name: str) -> Specification:
    if name == "composed":
        return _composed(_built_in("rover"))
    if name == "spread":
        return _spread(_built_in("rover"))
    if name == "leased":
        return _leased(_built_in("spread"))
    text, stateless = _BUILT_IN[name]
    return with_stand_ins(load_text(text).require(), stateless)


# The rover with these nodes in one process: a crash of one is a crash of all.
_SHARED: Final = ("detector", "mapper", "planner")


def _composed(rover: Specification) -> Specification:
    nodes = {role: replace(node, container="box" if role in _SHARED else None) for role, node in rover.nodes.items()}
    return replace(rover, name="composed", nodes=Map(nodes), containers=Map({"box": DEFAULT_CONTAINER}))


# The rover on three hosts: its messages and its plans cross each of the lines between them.
_HOSTS: Final = ("arm", "base")
_ON: Final = {"lidar": "base", "detector": "arm", "guard": "arm", "driver": "base"}


def _spread(rover: Specification) -> Specification:
    nodes = {role: replace(node, host=_ON.get(role, OWN_HOST)) for role, node in rover.nodes.items()}
    hosts = {name: HostSpec(name, name) for name in _HOSTS}
    return replace(rover, name="spread", nodes=Map(nodes), hosts=Map(hosts))


# The hosts of the fallbacks of these, which are other instances of the same components, and their leases (s): one is
# over before a link that fails is noticed, another one later.
_FALLBACKS: Final = {"lidar": ("arm", 2.0), "detector": ("base", 10.0), "driver": (OWN_HOST, 5.0)}


def _leased(spread: Specification) -> Specification:
    nodes = spread.nodes
    for role, (host, lease) in _FALLBACKS.items():
        policy = RespawnPolicy(fallback=nodes[role].component, fallback_host=host, lease=lease)
        nodes = nodes.set(role, replace(nodes[role], respawn=policy))
    return replace(spread, name="leased", nodes=nodes)


# What may take the place of what.
_REPLACEABLE: Final = {
    "rover": {
        "lidar": ("Lidar", "FastLidar"),
        "detector": ("Detector", "NewDetector"),
        "planner": ("Planner", "NewPlanner"),
    },
    "docking": {
        "map_server": ("MapServer", "NewMapServer"),
        "charger": ("Charger", "NewCharger"),
    },
}
# Without waits, and with such that faults strike in them; the specification keeps them for the next seeds.
_TIMINGS: Final[Sequence[Mapping[str, float]]] = (
    {},
    {"probation": 0.5, "probation_timeout": 1.0, "watch_after": 0.7},
)
# By the roles with their components, and the change.
_built_in_steps: Final[dict[tuple[object, ...], list[str]]] = {}


def built_in(random: random.Random, current: Specification | None = None, name: str = "rover") -> Scenario:
    """A built-in system, as it is or as earlier changes have left it, with a drawn change of one or two nodes.

    A node that an earlier change has removed is added again before anything else. ``name``: `rover`; `docking`, which
    has services and ROS actions; `composed`, the rover with three nodes in a container; `spread`, the rover on three
    hosts; or `leased`, the same with fallbacks on other hosts.
    """
    specification = current or _built_in(name)
    request = _built_in_change(random, specification)
    shape = sorted((role, node.component, node.container, node.host) for role, node in specification.nodes.items())
    key = (*shape, request.strategy, request.describe())
    if key not in _built_in_steps:
        _built_in_steps[key] = _steps(specification, request)
    return Scenario(specification, (request,), _built_in_steps[key])


def _built_in_change(random: random.Random, specification: Specification) -> PlanRequest:
    strategy = random.choice(["minimal"] * 4 + ["paper", "quiesce"])
    kind = random.choice(
        ["replace", "replace", "replace", "two", "restart", "restart", "several", "several", "remove", "add", "set"]
    )
    roles = sorted(specification.nodes)
    nodes = _built_in(specification.name).nodes
    replaceable = _REPLACEABLE["docking" if specification.name == "docking" else "rover"]
    if missing := sorted(set(nodes) - set(roles)):
        return PlanRequest(add=(nodes[missing[0]],), strategy=strategy)
    if specification.hosts and random.random() < 0.25:
        return PlanRequest(on=(_moved(random, specification),), strategy=strategy)
    members = specification.members_of("box")
    if members and random.random() < 0.2:
        return PlanRequest(restart=tuple(members), strategy=strategy)
    match kind:
        case "replace" | "two":
            chosen = random.sample(sorted(replaceable), 2 if kind == "two" else 1)
            replaced = tuple((role, _other(specification, role, *replaceable[role])) for role in chosen)
            return PlanRequest(replace=replaced, strategy=strategy)
        case "restart":
            return PlanRequest(restart=(random.choice(roles),), strategy=strategy)
        case "several":  # those of them that commute are handed over side by side
            several = tuple(sorted(random.sample(roles, random.randint(2, 4))))
            timed = replace(specification, timing=Map(random.choice(_TIMINGS)))
            return PlanRequest(to=timed, restart=several, strategy=strategy)
        case "remove":
            return PlanRequest(remove=(random.choice(roles),), strategy=strategy)
        case "add" if "second_guard" in specification.nodes:
            return PlanRequest(remove=("second_guard",), strategy=strategy)
        case "add":
            attachments = specification.nodes["guard"].attachments.delete("out")
            return PlanRequest(add=(Node("second_guard", "Guard", attachments),), strategy=strategy)
    node = specification.nodes["driver"]
    speed = random.choice([speed for speed in range(1, 10) if speed != node.parameters.get("speed", 1)])
    parameters = node.parameters.set("speed", speed)
    return PlanRequest(to=specification.with_node(replace(node, component="Driver", parameters=parameters)))


def _moved(random: random.Random, specification: Specification) -> tuple[str, str]:
    """A node, and another host for it."""
    role = random.choice(sorted(specification.nodes))
    others = [host for host in (OWN_HOST, *_HOSTS) if host != specification.nodes[role].host]
    return role, word_of_host(random.choice(others))


def _other(specification: Specification, role: str, one: str, other: str) -> str:
    """The one of the two components that takes the place of ``role``."""
    return other if specification.nodes[role].component == one else one


def rehearsed(specification: Specification, request: PlanRequest) -> Scenario:
    """A user's own change, with stand-ins for the programs. Raises PlanRefused if nothing can be planned for it."""
    target = with_stand_ins(request.target(specification))
    changed = replace(request, to=None if request.to is None else target)
    specification = with_stand_ins(specification)
    return Scenario(specification, (changed,), _steps(specification, changed))
