"""What a seed rehearses: a system, and a change of it."""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Final

from midstride.lang.load import load_text
from midstride.model.specification import Node, Specification, initial
from midstride.plan.change_builder import change_between
from midstride.plan.registry import planner
from midstride.plan.request import PlanRequest
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


@dataclass(frozen=True)
class Scenario:
    """``changes`` are requested one after the other, each while the one before is measured."""

    specification: Specification
    changes: Sequence[PlanRequest]

    def steps(self) -> list[str]:
        """The kinds of the steps of the changes, as often as they occur; those of a hand-over count three times."""
        key = (id(self.specification), *(f"{request.strategy} {request.describe()}" for request in self.changes))
        if key not in _steps:
            _steps[key] = [kind for request in self.changes for kind in _steps_of(self.specification, request)]
        return _steps[key]

    def specifications(self) -> list[Specification]:
        """Every specification that the system may have."""
        targets = (request.to for request in self.changes)
        return [self.specification, *(target for target in targets if target is not None)]


_steps: dict[tuple[object, ...], list[str]] = {}


def _steps_of(specification: Specification, request: PlanRequest) -> list[str]:
    target = request.target(specification)
    change = change_between(initial(specification), specification, target, renewed=request.renewed(target))
    kinds = [step.action.kind for step in planner(request.strategy)(change).steps]
    return kinds + 2 * [kind for kind in kinds if kind == "handover"]


@cache
def _rover() -> Specification:
    # While a state moves, nothing is called that could write: without one, only the gates keep two from being heard.
    return with_stand_ins(load_text(_ROVER).require(), stateless=("Lidar", "FastLidar"))


def rover(random: random.Random) -> Scenario:
    """The built-in system, with a drawn change of one or two of its nodes."""
    specification = _rover()
    strategy = random.choice(["minimal"] * 4 + ["paper", "quiesce"])
    replaceable = {"lidar": "FastLidar", "detector": "NewDetector", "planner": "NewPlanner"}
    roles = sorted(specification.nodes)
    match random.choice(["replace", "replace", "replace", "two", "restart", "restart", "remove", "add", "set"]):
        case "replace":
            role = random.choice(sorted(replaceable))
            request = PlanRequest(replace=((role, replaceable[role]),), strategy=strategy)
        case "two":
            first, second = random.sample(sorted(replaceable), 2)
            pairs = ((first, replaceable[first]), (second, replaceable[second]))
            request = PlanRequest(replace=pairs, strategy=strategy)
        case "restart":
            request = PlanRequest(restart=(random.choice(roles),), strategy=strategy)
        case "remove":
            request = PlanRequest(remove=(random.choice(roles),), strategy=strategy)
        case "add":
            attachments = specification.nodes["guard"].attachments.delete("out")
            request = PlanRequest(add=(Node("second_guard", "Guard", attachments),), strategy=strategy)
        case _:
            node = specification.nodes["driver"]
            parameters = node.parameters.set("speed", random.randint(2, 9))
            request = PlanRequest(to=specification.with_node(Node("driver", "Driver", node.attachments, parameters)))
    return Scenario(specification, (request,))


def rehearsed(specification: Specification, request: PlanRequest) -> Scenario:
    """A user's own change, with stand-ins for the programs. Raises PlanRefused if nothing can be planned for it."""
    target = with_stand_ins(request.target(specification))
    to = None if request.to is None else target
    return Scenario(with_stand_ins(specification), (replace(request, to=to),))
