"""The conflict core: caps, capacities and devices that old and new cannot both have."""

from __future__ import annotations

from dataclasses import replace

import pytest
from immutables import Map

from midstride.model.action import Create, Handover, Remove
from midstride.model.component import FunctionalitySpec, InputAlternatives, Mode
from midstride.model.contract import Predicate
from midstride.model.specification import Node, Specification
from tests.plan.cases import NEED, SLOW, changed, component, functionality, replaced, sound, system, told, work

# -- caps, capacities, devices -------------------------------------------------------------------------


def device() -> Specification:
    """Old and new both hold the one device: break before make is forced."""
    camera = work("Camera", outputs=["out"], resource_usage={"/dev/video0": 1.0}, startup_seconds=2.0)
    better = work("Better", outputs=["out"], resource_usage={"/dev/video0": 1.0}, startup_seconds=2.0)
    nodes = {"camera": ("Camera", {"out": "/image"}), "viewer": ("Viewer", {"in": "/image"})}
    return system([camera, better, work("Viewer", ["in"])], nodes, resources={"/dev/video0": 1.0})


def test_device_held_by_both_breaks_before_it_makes() -> None:
    plan = sound(replaced(device(), "camera", "Better", "minimal"))
    assert told(plan) == [
        "degrade viewer.work from normal to degraded",
        "detach camera.out from /image",
        "remove camera",
        "create camera_2 (Better)",
        "upgrade camera_2.work from degraded to normal",
        "attach camera_2.out to /image",
        "upgrade viewer.work from degraded to normal",
    ]
    # The viewer is a level below while the one goes (0.5 s) and the other comes (2 s), the camera two.
    assert plan.disruption == pytest.approx(2.5 * (1 + 2))
    assert (plan.proved_minimal, plan.lower_bound) == (True, plan.disruption)


def test_only_what_holds_the_device_breaks() -> None:
    start = device()
    viewer = work("NewViewer", ["in"])
    target = replace(start.with_replaced("camera", "Better"), components=start.components.set("NewViewer", viewer))
    target = target.with_replaced("viewer", "NewViewer")
    plan = sound(changed(start, target, "minimal"))
    # The new viewer is made beforehand, and what else is removed is removed afterwards.
    assert plan.disruption == pytest.approx(2.5 * (1 + 2))
    creates = [step.describe() for step in plan.steps if isinstance(step.action, Create)]
    assert creates == ["create viewer_2 (NewViewer)", "create camera_2 (Better)"]


def test_three_devices_are_exchanged_one_after_the_other() -> None:
    names = ("a", "b", "c")
    parts = [
        work(f"{kind}{name.upper()}", outputs=["out"], resource_usage={name: 1.0})
        for name in names
        for kind in ("Old", "New")
    ]
    nodes = {name: (f"Old{name.upper()}", {"out": f"/{name}"}) for name in names}
    start = system(parts, nodes, resources=dict.fromkeys(names, 1.0))
    target = start
    for name in names:
        target = target.with_replaced(name, f"New{name.upper()}")
    plan = sound(changed(start, target, "minimal"))
    assert plan.disruption == pytest.approx(3 * 1.5 * 2)
    assert sound(changed(start, target, "paper")).disruption > plan.disruption


def test_room_for_one_more_is_used_for_one_after_the_other() -> None:
    """Memory for two of three: the first replacement goes in beside the old ones, its place then serves the next."""
    parts = [
        work(f"{kind}{name}", outputs=["out"], resource_usage={"memory": 1.0})
        for name in "ABC"
        for kind in ("Old", "New")
    ]
    nodes = {name.lower(): (f"Old{name}", {"out": f"/{name.lower()}"}) for name in "ABC"}
    start = system(parts, nodes, resources={"memory": 4.0})
    target = start
    for name in "ABC":
        target = target.with_replaced(name.lower(), f"New{name}")
    plan = sound(changed(start, target, "minimal"))
    assert (plan.disruption, plan.degraded) == (0.0, ())
    kinds = [step.action.kind for step in plan.steps if isinstance(step.action, (Create, Remove))]
    assert kinds == ["create", "remove"] * 3


def test_two_exchange_their_exclusive_topics() -> None:
    parts = [work(name, outputs=["out"]) for name in ("A", "B")]
    start = system(parts, {"a": ("A", {"out": "/x"}), "b": ("B", {"out": "/y"})}, caps={"/x": 1, "/y": 1})
    target = system(parts, {"a": ("A", {"out": "/y"}), "b": ("B", {"out": "/x"})}, caps={"/x": 1, "/y": 1})
    plan = sound(changed(start, target, "minimal"))
    assert len(plan.steps) <= 3
    assert plan.disruption == 0.0


def test_another_role_takes_an_exclusive_topic_over_without_a_gap() -> None:
    parts = [work(name, outputs=["out"]) for name in ("A", "B")] + [work("User", ["in"])]
    users = {"user": ("User", {"in": "/x"})}
    start = system(parts, {"a": ("A", {"out": "/x"}), **users}, caps={"/x": 1})
    target = system(parts, {"b": ("B", {"out": "/x"}), **users}, caps={"/x": 1})
    plan = sound(changed(start, target, "minimal"))
    assert "hand over /x from a.out to b.out" in told(plan)
    assert plan.degraded == ()


def test_all_outputs_of_a_role_change_hands_at_once() -> None:
    parts = [work(name, outputs=["one", "two"]) for name in ("Old", "New")]
    plan = sound(replaced(system(parts, {"n": ("Old", {"one": "/one", "two": "/two"})}), "n", "New", "minimal"))
    assert "hand over /one from n.one to n_2.one, /two from n.two to n_2.two" in told(plan)


def test_no_hand_over_to_one_that_is_not_good_enough() -> None:
    """The new one assumes what nobody gives: it comes silent, and its topic is attached, not handed over."""
    parts = [work("Old", outputs=["out"]), work("New", ["in"], ["out"]), work("User", ["in"])]
    start = system(parts, {"n": ("Old", {"out": "/x"}), "user": ("User", {"in": "/x"})})
    plan = sound(replaced(start, "n", "New", "minimal"))
    assert not any(isinstance(step.action, Handover) for step in plan.steps)
    assert told(plan)[:2] == ["create n_2 (New)", "attach n_2.out to /x"]
    # In the target nobody satisfies /x: that is the baseline, and nothing falls below it.
    assert (plan.disruption, plan.degraded) == (0.0, ())


def test_a_renamed_port_on_the_same_topic_is_handed_over() -> None:
    parts = [work("Old", outputs=["out"]), work("New", outputs=["scan"])]
    start = system(parts, {"n": ("Old", {"out": "/x"})})
    target = start.with_node(Node("n", "New", Map({"scan": ("/x",)})))
    assert "hand over /x from n.out to n_2.scan" in told(sound(changed(start, target, "minimal")))


# -- modes in between ------------------------------------------------------------------------------------


def test_a_finer_mode_is_used_by_minimal_and_passed_over_by_the_paper() -> None:
    between = [Mode("by_odometry", (InputAlternatives(("odom",)),), Map({"out": SLOW}))]
    drive = functionality("drive", ["scan", "odom"], ["out"], between=between)
    parts = [work(name, outputs=["out"], resource_usage={"lidar": 1.0}) for name in ("Lidar", "NewLidar")]
    nodes = {
        "lidar": ("Lidar", {"out": "/scan"}),
        "wheels": ("Wheels", {"out": "/odom"}),
        "driver": ("Driver", {"scan": "/scan", "odom": "/odom"}),
    }
    start = system(
        [*parts, work("Wheels", outputs=["out"]), component("Driver", drive)], nodes, resources={"lidar": 1.0}
    )
    finer = sound(replaced(start, "lidar", "NewLidar", "minimal"))
    coarse = sound(replaced(start, "lidar", "NewLidar", "paper"))
    assert "degrade driver.drive from normal to by_odometry" in told(finer)
    assert "degrade driver.drive from normal to degraded" in told(coarse)
    assert finer.disruption == pytest.approx(1.5 * (1 + 2))
    assert coarse.disruption == pytest.approx(1.5 * (2 + 2))


def test_an_exclusive_topic_never_has_two_publishers_on_the_wire() -> None:
    parts = [work("Old", outputs=["out"]), work("User", ["in"], needs={"in": SLOW})]
    nodes = {"n": ("Old", {"out": "/cmd"}), "user": ("User", {"in": "/cmd"})}
    start = system([*parts, work("New", outputs=["out"])], nodes, topics={"/cmd": SLOW}, caps={"/cmd": 1})
    target = replace(
        start.with_replaced("n", "New"), connectors=system([], {}, topics={"/cmd": NEED}, caps={"/cmd": 1}).connectors
    )
    plan = sound(changed(start, target, "minimal"))
    for configuration in plan.configurations():
        assert len(configuration.publishers_on("/cmd")) + len(configuration.publishers_on("/cmd@2")) <= 1
    assert plan.disruption == 0.0


# -- more than can be tried ------------------------------------------------------------------------------


def many(number: int, resources: dict[str, float], holds: dict[str, str]) -> tuple[Specification, Specification]:
    """So many sources, each with a user of its own, all replaced at once; ``holds`` says which resource each takes."""
    names = [f"n{index}" for index in range(number)]
    parts = [
        work(f"{kind}_{n}", outputs=["out"], resource_usage={holds[n]: 1.0}) for n in names for kind in ("Old", "New")
    ]
    nodes: dict[str, tuple[str, dict[str, str]]] = {name: (f"Old_{name}", {"out": f"/{name}"}) for name in names}
    nodes |= {f"user_{name}": ("User", {"in": f"/{name}"}) for name in names}
    start = system([*parts, work("User", ["in"])], nodes, resources=resources)
    target = start
    for name in names:
        target = target.with_replaced(name, f"New_{name}")
    return start, target


def test_many_devices_are_exchanged_one_by_one() -> None:
    names = [f"n{index}" for index in range(20)]
    start, target = many(20, dict.fromkeys(names, 1.0), {name: name for name in names})
    plan = sound(changed(start, target, "minimal"))
    # Of each, the role is two levels below and its user one, while the old goes (0.5 s) and the new comes (1 s).
    assert plan.disruption == pytest.approx(20 * 1.5 * (2 + 1))


def test_room_for_one_more_serves_them_all() -> None:
    start, target = many(20, {"memory": 21.0}, {f"n{index}": "memory" for index in range(20)})
    plan = sound(changed(start, target, "minimal"))
    assert (plan.disruption, plan.degraded) == (0.0, ())


def test_a_place_is_given_up_rather_than_handed_on_where_another_needs_it_more() -> None:
    """Two publishers fill /x. What replaces b comes silent, and so needs a place beside b; a can spare its own."""
    old, blind = work("Old", outputs=["out"]), work("Blind", ["lamp"], ["out"])
    split = component("Split", functionality("work"), functionality("speak", outputs=["out"]))
    start = system([old, blind, split], {"a": ("Old", {"out": "/x"}), "b": ("Old", {"out": "/x"})}, caps={"/x": 2})
    target = start.with_replaced("a", "Split").with_replaced("b", "Blind")
    plan = sound(changed(start, target, "minimal"))
    assert (plan.disruption, plan.degraded) == (0.0, ())
    order = ["detach a.out from /x", "attach b_2.out to /x", "hand over /x from b.out to a_2.out"]
    assert [step for step in told(plan) if step in order] == order


def test_amounts_are_compared_as_they_are_written() -> None:
    """Half a part in a thousand million too much is too much, and three tenths are three tenths."""
    for old, new, together in ((0.5, 0.5000000005, False), (0.1, 0.2, True)):
        parts = [
            work("Old", outputs=["out"], resource_usage={"gpu": old}),
            work("New", outputs=["out"], resource_usage={"gpu": new}),
        ]
        capacity = 1.0 if not together else 0.3
        start = system(parts, {"n": ("Old", {"out": "/x"})}, resources={"gpu": capacity})
        plan = sound(replaced(start, "n", "New", "minimal"))
        assert (plan.disruption == 0.0) == together


def test_a_replacement_that_stands_only_by_itself_is_attached_beside_the_old_one() -> None:
    """The new one needs what it writes itself: worse than the old one before it is on its topic, and better then."""
    lamp, writes = Predicate(NEED.type, 20.0), Map({"out": NEED})  # nobody has a lamp
    old = component("Old", FunctionalitySpec("work", (Mode("m", (lamp,), writes), Mode("d")), (), ("out",)))
    loop = (Mode("m", (InputAlternatives(("in",)),), writes), Mode("w", (lamp,), writes))
    new = component("New", FunctionalitySpec("work", (*loop, Mode("d", (), writes)), ("in",), ("out",)))
    start = system([old, new], {"n": ("Old", {"out": "/x"})})
    target = start.with_node(Node("n", "New", Map({"out": ("/x",), "in": ("/x",)})))
    plan = sound(changed(start, target, "minimal"))
    assert plan.degraded == ()
    assert told(plan)[2:5] == ["attach n_2.out to /x", "upgrade n_2.work from d to m", "detach n.out from /x"]
