"""On ROS 2, what an outside recorder hears beside what plan, report, history and status say: a false word fails.

The faults are those of field reports: a lifecycle manager that takes nodes down (R3), a program that has to be killed
(R7), an activation that is slow and a process that is stopped (R12), a restart of what nothing measures and a new
program that is broken (R13). One robot has a node for every kind of gate, and suffers one fault after another.

Cells that cannot occur: R3 with the API, as such a component is no lifecycle node. R12, a slow activation: only `gate
lifecycle` and `gate lifecycle preload` activate anything; its like elsewhere is a new program that does not write,
which only a gate that counts can notice (preload, relay): with `gate none` and without ports, nothing measures that,
and that is what is said.
"""

from __future__ import annotations

import asyncio
import itertools
import os
import re
import signal
import time
from collections import defaultdict
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest

from midstride.errors import PlanRefused
from midstride.foreign import gated_agent, graph_watch, lifecycle_managers
from midstride.foreign.record import ForeignRecord
from midstride.lang.load import load
from midstride.plan.forms.plan_forms import PlanPreview
from midstride.plan.request import PlanRequest
from midstride.runtime.handover import probation
from midstride.runtime.manager import Manager
from midstride.runtime.records.reports import Outcome
from midstride.verdicts.assessment import Assessment, Assessments
from tests.acceptance.foreign_support import manager_of
from tests.acceptance.support import ended
from tests.backends.ros2_support import Bare, run

pytestmark = [pytest.mark.ros2, pytest.mark.full]

# What is no silence (s), ten periods, and how much a time that is stated may differ from what was heard: counts are
# reported twice a second. On a busy machine, as much more as the node is silent that no change concerns.
QUIET = 0.5
# A lifecycle node counts as silent, "at most", until it has answered that it is active, as late as so long after (s).
ANSWER = 3.0

# Each says on /said/ROLE who it is, and when: so a recorder that is late hears no silence. The file ROLE has its fault.
COMMON = """
import os, signal, sys, time

instance = os.environ["MIDSTRIDE_INSTANCE"]  # its name may stay

def fault(role):
    with open(role) as file:
        return file.read()

def is_to_end(*_):
    if fault(sys.argv[1]) != "stubborn":
        os._exit(0)

if fault(sys.argv[1]) == "broken":
    raise SystemExit("broken build")
for each in (signal.SIGINT, signal.SIGTERM):
    signal.signal(each, is_to_end)
"""

TALK = """
from common import *
import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import String
from std_srvs.srv import Trigger

role = sys.argv[1]
rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
node = Node("talk")
node.create_service(Trigger, f"/save/{role}", lambda request, response: response)
node.create_client(Trigger, f"/ask/{role}")
publisher = node.create_publisher(String, f"/said/{role}", 10)
mute = fault(role) == "mute"
node.create_timer(0.05, lambda: mute or publisher.publish(String(data=f"{instance} {time.monotonic()}")))
rclpy.spin(node)
"""

LIFE = """
from common import *
import rclpy
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import String

role = sys.argv[1]


class Life(LifecycleNode):
    def __init__(self):
        super().__init__("life")

    def on_configure(self, state):
        self.out = self.create_lifecycle_publisher(String, f"/said/{role}", 10)
        self.create_timer(0.05, self.say)
        return TransitionCallbackReturn.SUCCESS

    def say(self):
        if self.out.is_activated:
            self.out.publish(String(data=f"{instance} {time.monotonic()}"))

    def on_activate(self, state):
        if fault(role) == "slow":
            time.sleep(1.5)
        return super().on_activate(state)


rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
rclpy.spin(Life())
"""

OURS = """
from common import *
from midstride import Component
from std_msgs.msg import String

role = sys.argv[1]
comp = Component("Api")
out = comp.create_output("out", String)
f = comp.create_functionality("f", outputs=[out])
f.set_normal_mode(
    lambda: out.write(String(data=f"{comp.instance} {time.monotonic()}")), rate=20, outputs=[out]
)
f.set_degraded_mode(lambda: None)

def stop():
    while fault(role) == "stubborn":
        time.sleep(0.1)

comp.on_stop(stop, timeout=0.5)
comp.start()
"""

# Each role with its program and its gate.
GATES = {
    "api": ("ours.py", None),
    "preload": ("talk.py", "preload"),
    "relay": ("talk.py", "relay"),
    "life": ("life.py", "lifecycle"),
    "lifepre": ("life.py", "lifecycle preload"),
    "none": ("talk.py", "none"),
}
# Without ports: nothing measures what they do.
BARE = {"barepre": ("talk.py", "preload"), "barenone": ("talk.py", "none")}
# Lifecycle nodes without ports, which the test takes up and down as another program does.
OTHERS = {
    "managed": ("life.py", "preload"),
    "managednone": ("life.py", "none"),
    "managedrelay": ("life.py", "relay"),
}
LIFECYCLE = ("life", "lifepre")
MEASURED = tuple(role for role in GATES if role != "none")
CONTROL = "control"


def specification() -> str:
    text = ["system robot"]
    for role, (program, gate) in (GATES | BARE | OTHERS | {CONTROL: ("talk.py", "preload")}).items():
        kind = role.capitalize()
        own = "activate 0.5 s " if "lifecycle" in (gate or "") else ""
        own += "" if gate is None else "stop sigterm 0.5 s sigkill 0.5 s "
        own += "" if gate is None else f"gate {gate}"
        text.append(f'component {kind} {{ run "python3 {program} {role}" {own}')
        if role in GATES:
            name = "" if gate is None else f" as /said/{role}"
            text.append(f"  output out{name}\n  functionality f {{ produces out")
            text.append("    mode normal { guarantee out : std_msgs/msg/String @ 18 Hz } mode degraded { } }")
            text.insert(1, f"topic /said/{role} : std_msgs/msg/String @ 18 Hz")
        text.append("}")
        text.append(f"node {role} : {kind}" + (f" {{ out -> /said/{role} }}" if role in GATES else ""))
    return "\n".join(text) + "\n"


def role_of(name: str) -> str:
    """The role of a topic, an instance or a functionality."""
    return re.sub(r"_\d+$", "", name.removeprefix("/said/").partition(".")[0])


def subjects(assessment: Assessment) -> set[str]:
    return {role_of(word.rstrip(",")) for word in assessment.subject.split()}


def about(found: Assessments, role: str) -> list[Assessment]:
    return [each for each in found.found if role in subjects(each)]


@dataclass
class Robot:
    """The robot, what an outside recorder has heard of it, and every word that was false."""

    folder: Path
    manager: Manager
    bare: Bare
    heard: dict[str, list[tuple[float, str]]] = field(default_factory=lambda: defaultdict(list))
    false: list[str] = field(default_factory=list)
    cells: int = 0

    def listen(self, role: str) -> None:
        from std_msgs.msg import String

        def hear(message: Any) -> None:
            name, at = message.data.split()
            self.heard[role].append((float(at), name))

        self.bare.node.create_subscription(String, f"/said/{role}", hear, 1000)

    def fault(self, what: str, *roles: str) -> None:
        for role in roles:
            (self.folder / role).write_text(what, encoding="utf-8")

    def says(self, role: str, since: float) -> bool:
        return bool(self.heard[role]) and self.heard[role][-1][0] > since

    async def hears(self, *roles: str) -> None:
        """Return when all of these have said something from now on."""
        since = time.monotonic()
        while silent := [role for role in roles if not self.says(role, since)]:
            assert time.monotonic() < since + 60, (silent, await self._faults())
            await self.bare.spin()

    def silence(self, role: str, begun: float, ended: float) -> float:
        """The longest silence between two times, by the time at which messages were written (s)."""
        within = [at for at, _ in self.heard[role] if begun < at < ended]
        return max(after - before for before, after in itertools.pairwise([begun, *within, ended]))

    def quiet(self, begun: float, ended: float) -> float:
        return QUIET + 2 * self.silence(CONTROL, begun, ended)

    async def change(self, fault: str, roles: Sequence[str], **options: Any) -> tuple[Outcome, Assessments]:
        """Restart ``roles``, and compare each with what is said of it in plan, report and history."""
        request = PlanRequest(restart=tuple(roles), **options)
        plan = PlanPreview.of(await self.manager.plan(request)).continuity
        assert isinstance(plan, Assessments)
        begun = time.monotonic()
        task = asyncio.ensure_future(self.manager.change(request))
        await self.bare.until(task.done, 90)
        ended, outcome = time.monotonic(), task.result()
        await self.hears(CONTROL)  # what was written before has been read
        said = outcome.continuity
        assert said is not None
        if (await self.manager.history(1)).changes[-1].continuity != said:
            self.false.append(f"{fault}: the history says something else than the report")
        for role in roles:
            self.judge(f"{fault}, {role}, {outcome.outcome}", role, plan, said, begun, ended, outcome)
        return outcome, said

    def judge(
        self, cell: str, role: str, plan: Assessments, said: Assessments, begun: float, ended: float, outcome: Outcome
    ) -> None:
        self.cells += 1
        heard, tolerance = self.silence(role, begun, ended), self.quiet(begun, ended)
        lost = [each for each in about(said, role) if each.verdict == "lost"]
        times = [each.seconds for each in lost if each.seconds is not None]
        exact = [each.seconds for each in lost if each.seconds is not None and not each.at_most]
        words = "; ".join(each.words for each in about(said, role)) or said.headline
        if role in BARE | OTHERS or role == "none":  # nothing measures it, and that is named before and after
            for when, found in (("plan", plan), ("report", said)):
                if found.verdict == "kept" or not about(found, role):
                    self.false.append(f"{cell}: the {when} claims to know what it does: {found.headline}")
        elif heard > tolerance and not times:
            self.false.append(f"{cell}: silent for {heard:.2f} s, and said: {words}")
        if times:
            if heard > max(times) + tolerance:
                self.false.append(f"{cell}: silent for {heard:.2f} s, and said {max(times):.2f} s: {words}")
            if max(times) > heard + tolerance + ANSWER or max(exact, default=0.0) > heard + tolerance:
                self.false.append(f"{cell}: {max(times):.2f} s are said to be lost, and heard {heard:.2f} s: {words}")
            if outcome.outcome == "done" and plan.verdict == "kept":
                self.false.append(f"{cell}: lost as planned, and the plan said {plan.headline}")

    async def running(self, role: str) -> Any:
        (found,) = (each for each in (await self.manager.status()).instances if each.role == role)
        return found

    async def signal(self, number: signal.Signals, *roles: str) -> None:
        for role in roles:
            os.kill((await self.running(role)).pid, number)

    async def names(self, *roles: str) -> dict[str, str]:
        """The instances that run now, by role."""
        return {role: (await self.running(role)).name for role in roles}

    async def nodes(self, *roles: str) -> dict[str, str]:
        """The names of the nodes that run now, by role: one that loads the library keeps that of its role."""
        gates = {role: gate for role, (_, gate) in (GATES | BARE | OTHERS).items()}
        names = await self.names(*roles)
        keeps = {"preload", "lifecycle", "lifecycle preload"}
        return {role: role if gates[role] in keeps else name for role, name in names.items()}

    async def condition_names(self, words: Mapping[str, str]) -> None:
        """Wait until the status is degraded, or down, and says of each role its ``words``."""
        deadline = time.monotonic() + 30
        while missing := [said for said in words.values() if not any(said in each for each in await self._faults())]:
            assert time.monotonic() < deadline, (missing, await self._faults())
            await self.bare.spin()
        self.cells += len(words)

    async def is_up(self) -> None:
        """Wait until the status reports no problem."""
        deadline = time.monotonic() + 30
        while faults := await self._faults():
            assert time.monotonic() < deadline, faults
            await self.bare.spin()

    async def _faults(self) -> list[str]:
        condition = (await self.manager.status()).condition
        return condition.faults if condition.state != "up" else []


@asynccontextmanager
async def robot(folder: Path) -> AsyncIterator[Robot]:
    for name, text in {"common": COMMON, "talk": TALK, "life": LIFE, "ours": OURS}.items():
        (folder / f"{name}.py").write_text(text, encoding="utf-8")
    roles = [*GATES, *BARE, *OTHERS, CONTROL]
    for role in roles:
        (folder / role).write_text("", encoding="utf-8")
    (folder / "robot.stride").write_text(specification(), encoding="utf-8")
    (folder / "system").mkdir()
    manager = manager_of(load(folder / "robot.stride").require(), folder)
    with Bare("recorder") as bare:
        made = Robot(folder, manager, bare)
        for role in roles:
            made.listen(role)
        try:
            task = asyncio.ensure_future(manager.up())
            await bare.until(task.done, 120)
            task.result()
            await made.hears(*GATES, *BARE, CONTROL)
            yield made
        finally:
            made.fault("", *roles)
            await manager.down()
            await manager.close()


async def transition(robot: Robot, number: int, *roles: str) -> None:
    """Change the state of lifecycle nodes, as another program does."""
    from lifecycle_msgs.srv import ChangeState

    request = ChangeState.Request()
    request.transition.id = number
    asked = []
    for name in (await robot.nodes(*roles)).values():
        client = robot.bare.node.create_client(ChangeState, f"/{name}/change_state")
        await robot.bare.until(client.service_is_ready, 30)
        asked.append(client.call_async(request))
    await robot.bare.until(lambda: all(each.done() for each in asked), 30)
    assert all(each.result().success for each in asked)


CONFIGURE, ACTIVATE, DEACTIVATE = 1, 3, 4


def seen_active(folder: Path, name: str) -> bool:
    """Whether the agent of a node has seen it active, by its record."""
    return any(
        record.was_active
        for path in folder.rglob(f"{name}.json")
        if (record := ForeignRecord.read(path.parent, name)) is not None
    )


async def is_refused(robot: Robot, role: str) -> bool:
    """Whether a restart is, since another program asks for the state of the node by its name."""
    try:
        await robot.manager.plan(PlanRequest(restart=(role,)))
    except PlanRefused as error:
        return "may ask" in str(error)
    return False


async def taken_down_by_another_program(robot: Robot) -> None:
    """R3: the new node is as active as the old one; none is replaced while its manager may miss it, or it is down."""
    from lifecycle_msgs.srv import ChangeState, GetState

    await transition(robot, CONFIGURE, *OTHERS)
    await transition(robot, ACTIVATE, *OTHERS)
    await robot.hears(*OTHERS)
    outside = [role for role, (_, gate) in OTHERS.items() if gate != "relay"]  # whose agent is in the manager
    await robot.bare.until(lambda: all(seen_active(robot.folder, role) for role in outside), 30)
    outcome, said = await robot.change("R3", [*OTHERS])
    assert outcome.outcome == "done", outcome.because
    for role in OTHERS:
        assert any(f"what {role} does: no ports are stated" in each.words for each in about(said, role)), said
    await robot.hears(*OTHERS)
    services = (ChangeState, "change_state"), (GetState, "get_state")
    asking = [
        robot.bare.node.create_client(kind, f"/{name}/{service}")
        for name in (await robot.nodes(*OTHERS)).values()
        for kind, service in services
    ]
    for role in OTHERS:
        begun = time.monotonic()
        while not await is_refused(robot, role):
            assert time.monotonic() < begun + 30, "a restart that the manager would notice is not refused"
            await robot.bare.spin()
        assert robot.silence(role, begun, time.monotonic()) < robot.quiet(begun, time.monotonic())
    for client in asking:
        robot.bare.node.destroy_client(client)
    await transition(robot, DEACTIVATE, *OTHERS)
    names = (await robot.nodes(*OTHERS)).items()
    await robot.condition_names(
        {role: f"lifecycle node /{name} is inactive, and was active before" for role, name in names}
    )
    await transition(robot, ACTIVATE, *OTHERS)
    await robot.hears(*OTHERS)


async def taken_down_beside_midstride(robot: Robot) -> None:
    """R3: another program takes nodes down whose lifecycle Midstride manages."""
    await robot.is_up()
    await transition(robot, DEACTIVATE, *LIFECYCLE)
    names = (await robot.names(*LIFECYCLE)).items()
    await robot.condition_names({role: f"{name}.f is in mode degraded" for role, name in names})


def has_looked(manager: Manager, role: str) -> bool:
    latest = manager.system.life.latest(role)
    if latest is None:
        return False
    return [each.words for each in latest.state.serves] == [f"service /save/{role}"] and bool(latest.state.undeclared)


async def restarted(robot: Robot) -> None:
    """R13: a restart as it should be."""
    for role, (_, gate) in BARE.items():
        await robot.bare.until(partial(has_looked, robot.manager, role), 20)  # at the graph, which it does now and then
        plan = PlanPreview.of(await robot.manager.plan(PlanRequest(restart=(role,)))).continuity
        assert isinstance(plan, Assessments) and "no ports are stated" in plan.headline
        assert ("so both write there" in plan.headline) == (gate == "none")
        assert (f"service /save/{role} ends with {role}" in plan.headline) == (gate == "none")
    outcome, said = await robot.change("R13 restart", [*MEASURED, *BARE])
    assert outcome.outcome == "done", outcome.because
    assert about(said, "api") == [], said
    for role in ("preload", "relay", "lifepre"):
        assert {each.verdict for each in about(said, role)} <= {"not_measurable"}, said
    assert not any("service /save/preload" in each.words for each in about(said, "preload"))
    assert any("that are under way at service /ask/preload" in each.words for each in about(said, "preload"))
    assert any("it is behind a relay" in each.words for each in about(said, "relay"))
    for role, (_, gate) in BARE.items():
        words = "; ".join(each.words for each in about(said, role))
        assert "no ports are stated" in words
        assert ("so both could write there" in words) == (gate == "none")
        assert (f"service /save/{role} ended with {role}" in words) == (gate == "none")
        assert f"at service /ask/{role}: they continued" in words
        assert {name for _, name in robot.heard[role]} == {role, f"{role}_2"}
    outcome, said = await robot.change("R13 restart", ["none"], strategy="paper")
    assert outcome.outcome == "done" and said.verdict == "lost" and "is not known" in said.lines[0], said


async def broken(robot: Robot) -> None:
    """R13: the new program ends at once. What ran goes on, and is all that the status speaks of."""
    for role in [*MEASURED, *BARE]:
        robot.fault("broken", role)
        outcome, _ = await robot.change("R13 broken", [role])
        assert outcome.outcome == "rolled_back", outcome
        assert "broken build" in str(outcome.because), outcome.because
        robot.fault("", role)
        await robot.hears(role)
    condition = (await robot.manager.status()).condition
    assert condition.state == "up", condition
    assert condition.unknown == [
        "what barenone, barepre, control, managed, managednone and managedrelay do (no ports are stated)",
        "what none does (nothing counts messages (`gate none`))",
    ]


async def slow(robot: Robot) -> None:
    """R12: what does not become active, or does not write, in its time is not let in."""
    robot.fault("slow", *LIFECYCLE)
    for role in LIFECYCLE:
        outcome, said = await robot.change("R12 slow", [role])
        assert outcome.outcome == "rolled_back"
        if role == "life":
            assert said.lost_seconds is not None
    robot.fault("", *LIFECYCLE)
    await robot.hears(*LIFECYCLE)


async def mute(robot: Robot) -> None:
    robot.fault("mute", "preload", "relay")
    with patch.object(probation, "PROBATION", 1.0):
        outcome, _ = await robot.change("R12 mute", ["preload", "relay"])
    assert outcome.outcome == "rolled_back"
    robot.fault("", "preload", "relay")
    await robot.hears("preload", "relay")


async def killed(robot: Robot) -> None:
    """R7: a program that does not end in its time; one with the API ends in order, but breaks off its `on_stop`."""
    for roles, options in ([*MEASURED, *BARE], {}), (["none"], {"strategy": "paper"}):
        before = await robot.names(*roles)
        robot.fault("stubborn", *roles)
        outcome, said = await robot.change("R7", roles, **options)
        robot.fault("", *roles)
        assert outcome.outcome == "done", outcome.because
        named = {each.instance for each in outcome.killed}
        assert named == set(before.values())
        for name in named:
            assert any(name in each.words and "what it does at its end is lost" in each.words for each in said.found)


async def stopped(robot: Robot) -> None:
    """R12: a process that is stopped is no health, whatever holds back its outputs."""
    every = [*GATES, *BARE]
    names = await robot.names(*every)
    since = time.monotonic()
    await robot.signal(signal.SIGSTOP, *every)
    try:
        agents = "api", "relay"  # what is stopped has its agent inside
        words = {role: "does not answer" if role in agents else "is stopped (SIGSTOP)" for role in every}
        await robot.condition_names({role: f"{name} {words[role]}" for role, name in names.items()})
        for role in every:
            assert not robot.says(role, since + 2.0)
        # It is killed when it is replaced: it could be continued at any time, and would write beside the other.
        task = asyncio.ensure_future(robot.manager.change(PlanRequest(restart=("life",))))
        await robot.bare.until(task.done, 60)
        assert (task.result().outcome, [each.how for each in task.result().fenced]) == ("done", ["killed"])
        await robot.hears("life")
    finally:
        await robot.signal(signal.SIGCONT, *every)
    await robot.hears(*every)


async def crashed(robot: Robot) -> None:
    """R13: no node is left, and that is what the status says."""
    every = [*GATES, *BARE, *OTHERS, CONTROL]
    names = (await robot.names(*every)).items()
    await robot.signal(signal.SIGKILL, *every[:-1])
    await robot.condition_names({role: f"{name} exited unexpectedly" for role, name in names if role != CONTROL})
    assert (await robot.manager.status()).condition.state == "degraded"
    await robot.signal(signal.SIGKILL, CONTROL)
    await robot.bare.until(lambda: not robot.manager.configuration.instances, 20)
    assert (await robot.manager.status()).condition.state == "down"


FAULTS = (
    restarted,
    broken,
    taken_down_by_another_program,
    slow,
    mute,
    killed,
    stopped,
    taken_down_beside_midstride,
    crashed,
)


def test_no_word_of_plan_report_history_and_status_is_false(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gated_agent, "endpoints_seconds", lambda _: 4.0)
    monkeypatch.setattr(graph_watch, "GRAPH_LOOK", 0.5)  # the recorder is taken for a manager, and says no parameters
    monkeypatch.setattr(lifecycle_managers, "_PATIENCE", 0.1)

    async def scenario() -> None:
        async with robot(tmp_path) as found:
            for fault in FAULTS:
                begun = time.monotonic()
                await fault(found)
                print(f"{fault.__name__}: {time.monotonic() - begun:.1f} s, {found.cells} cells", found.false)
            assert not found.false, "\n".join(found.false)

    with ended():
        run(scenario())
