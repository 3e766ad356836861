"""In which ways an instance is not as specified, in the words of its status."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from immutables import Map
from msgspec import structs

from midstride.lang import load_text
from midstride.model.component import FunctionalityRef, PortRef
from midstride.model.configuration import Configuration, Instance, configure
from midstride.model.specification import Node, Specification
from midstride.runtime.records.status_forms import FunctionalityStatus, PortStatus
from midstride.runtime.view.condition import _faults, unmeasured_bounds
from midstride.runtime.view.instance_status import _deviations
from midstride.runtime.view.watched_system import Baseline
from midstride.wire.state import LinkState, MeasuredResponses
from tests.model.build import work
from tests.runtime.scripted import TALKER, instance, reported
from tests.wire.bare_state import bare_state

RUNNING = instance("talker_2", TALKER, "talker")
STATE = reported(RUNNING)
NOTHING = Configuration()
WORK = FunctionalityStatus(
    name="work",
    mode="normal",
    modes=["normal", "degraded"],
    modelled="normal",
    normal=True,
    because=None,
    reflex=False,
    restoring=None,
    since=None,
)
OUT = PortStatus(
    name="out",
    direction="out",
    functionalities=["work"],
    topic="/chatter",
    type=None,
    gate="open",
    declared=10.0,
    rate=10.0,
    met=True,
    age=0.0,
    jitter=0.0,
    longest=0.1,
)


def specified(component: str = "Talker", role: str = "talker", level: int = 0) -> Baseline:
    specification = Specification("chat", nodes=Map({role: Node(role, component, Map())}))
    modes: dict[FunctionalityRef, int] = {work(role): level}
    return Baseline(specification, Configuration(modes=Map(modes)))


def deviations(baseline: Baseline, state: Any = STATE, work: Any = WORK, port: Any = OUT) -> list[str]:
    return list(_deviations(RUNNING, state, [work], [port], baseline))


def test_one_that_is_as_specified_does_not_deviate() -> None:
    assert deviations(specified()) == []


@pytest.mark.parametrize(
    ("baseline", "changes", "words"),
    [
        (specified(), {"state": None}, "it does not answer"),
        (specified(), {"state": structs.replace(STATE, waiting="for /clock")}, "it is waiting: for /clock"),
        (specified(role="other"), {}, "the specification does not have it"),
        (specified("Camera"), {}, "the specification has Camera there"),
        (specified(), {"state": structs.replace(STATE, differences=["it has no out"])}, "it has no out"),
        (specified(), {"work": structs.replace(WORK, mode="degraded")}, "work is in mode degraded"),
        (specified(level=1), {"work": structs.replace(WORK, mode="unknown")}, "work is in mode unknown"),
        (specified(), {"port": structs.replace(OUT, met=False)}, "out publishes less than declared"),
        (specified(), {"port": structs.replace(OUT, met=False, direction="in")}, "out receives less than declared"),
    ],
)
def test_each_way_in_which_it_deviates_is_said(baseline: Baseline, changes: dict[str, Any], words: str) -> None:
    assert deviations(baseline, **changes) == [words]


@pytest.mark.parametrize(
    ("level", "changes"),
    [
        (1, {"work": structs.replace(WORK, mode="degraded")}),  # the system does not allow a better one
        (0, {"port": structs.replace(OUT, met=None)}),  # nothing is known yet
        (0, {"port": structs.replace(OUT, met=False, gate="closed")}),  # it waits for its cut
    ],
)
def test_what_is_as_good_as_it_can_be_is_no_deviation(level: int, changes: dict[str, Any]) -> None:
    assert deviations(specified(level=level), **changes) == []


@pytest.mark.parametrize(("mode", "level", "said"), [("degraded", 0, True), ("degraded", 1, False), ("gone", 1, True)])
def test_a_mode_below_the_baseline_or_unknown_is_a_fault(mode: str, level: int, said: bool) -> None:
    watched: Any = SimpleNamespace(
        baseline=lambda: specified(level=level), system=SimpleNamespace(configuration=NOTHING)
    )
    functionality = structs.replace(WORK, mode=mode)
    status: Any = SimpleNamespace(
        name="talker_2",
        role="talker",
        reachable=True,
        waiting=None,
        differences=[],
        functionalities=[functionality],
        ports=[],
    )
    assert bool(list(_faults(watched, status))) is said


SERVED = """system maps
contract Map = nav_msgs/srv/GetMap responds within 50 ms
service /map : Map
component Maps {{
  run "maps" gate {gate}
  server map
  functionality serve {{ produces map  mode normal {{ guarantee map : Map }}  mode off {{ }} }}
}}
node maps : Maps {{ map -> /map }}
"""


@pytest.mark.parametrize(
    ("gate", "simulated", "measured", "because"),
    [
        ("none", False, False, "nothing counts requests (`gate none`)"),
        ("preload", True, False, "nothing that measures rates follows `/clock`"),
        ("preload", True, True, None),
        ("preload", False, False, None),  # it has just been started
    ],
)
def test_whether_a_server_is_in_time_is_not_known_where_nothing_measures_it(
    gate: str, simulated: bool, measured: bool, because: str | None
) -> None:
    specification = load_text(SERVED.format(gate=gate)).require()
    port = PortRef("maps", "map")
    configuration = configure(
        specification.context,
        [Instance("maps", "maps", specification.components["Maps"])],
        specification.attachments_of("maps"),
        {FunctionalityRef("maps", "serve"): 0},
    )
    link = LinkState(gate="open", count=0, responses=MeasuredResponses(within=0.05, tolerated=5) if measured else None)
    state = bare_state("maps", ports={"map": {"/map": link}}, simulated_time=simulated)
    system: Any = SimpleNamespace(configuration=configuration, life=SimpleNamespace(responsive=lambda name: state))
    words = [] if because is None else [f"whether {port} answers on /map in time ({because})"]
    assert list(unmeasured_bounds(system, "maps")) == words
    system.life.responsive = lambda name: None
    assert list(unmeasured_bounds(system, "maps")) == []
