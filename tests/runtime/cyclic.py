"""A system with a cycle: the estimator and the corrector each rely on what the other writes, and change together."""

from __future__ import annotations

from pathlib import Path

from midstride.lang.load import load_text
from midstride.model.specification import Specification
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager

TEXT = """
system loop

contract Image = std_msgs/msg/String @ 10 Hz
contract Words = std_msgs/msg/String @ 2 Hz

topic /image      : Image
topic /estimate   : Words
topic /correction : Words

component Camera {
  run "python3 camera.py"
  output out
  functionality see { produces out   mode normal { guarantee out : Image }   mode degraded { } }
}
component Estimator {
  run "python3 estimator.py"
  input image : Image
  input other : Words
  output out
  functionality work {
    uses image, other
    produces out
    mode normal { assume image   assume other   guarantee out : Words }
    mode degraded { }
  }
}
component Corrector {
  run "python3 corrector.py"
  input other : Words
  output out
  functionality work {
    uses other
    produces out
    mode normal { assume other   guarantee out : Words }
    mode degraded { }
  }
}

node camera    : Camera    { out -> /image }
node estimator : Estimator { image <- /image   other <- /correction   out -> /estimate }
node corrector : Corrector { other <- /estimate   out -> /correction }
"""
CAMERA = """
from midstride import Component
from std_msgs.msg import String

comp = Component("camera")
out = comp.create_output("out", String)
see = comp.create_functionality("see", outputs=[out])
see.set_normal_mode(lambda: out.write(String(data="an image")), rate=10, outputs=[out])
see.set_degraded_mode(lambda: None)
comp.start()
"""
# Each call takes most of the time until the next one: a change of modes has to wait for it.
MEMBER = """
from midstride import Component
from std_msgs.msg import String

comp = Component({name!r})
inputs = [comp.create_input(name, String, rate=rate) for name, rate in {inputs!r}]
out = comp.create_output("out", String)
work = comp.create_functionality("work", inputs=inputs, outputs=[out])

async def normal():
    await comp.clock.sleep({seconds})
    out.write(String(data="from {name}"))

work.set_normal_mode(normal, rate=2, inputs=inputs, outputs=[out])
work.set_degraded_mode(lambda: None)
comp.start()
"""
MEMBERS = {"estimator.work", "corrector.work"}
WITHOUT_CAMERA = PlanRequest(remove=("camera",))


def cyclic(folder: Path) -> Specification:
    """The system; its programs are written to ``folder``."""
    folder.mkdir(exist_ok=True)
    (folder / "camera.py").write_text(CAMERA)
    for name, inputs, seconds in (
        ("estimator", [("image", 10), ("other", 2)], 0.4),
        ("corrector", [("other", 2)], 0.3),
    ):
        (folder / f"{name}.py").write_text(MEMBER.format(name=name, inputs=inputs, seconds=seconds))
    return load_text(TEXT).require()


def with_camera(specification: Specification) -> PlanRequest:
    return PlanRequest(add=(specification.nodes["camera"],))


async def check_both_ways(manager: Manager, specification: Specification, within: float) -> None:
    """Without the camera and with it again, the members change their modes in one step, ``within`` so many seconds."""
    assert (await manager.status()).valid
    for request, kind, mode in (
        (WITHOUT_CAMERA, "degrade", "degraded"),
        (with_camera(specification), "upgrade", "normal"),
    ):
        outcome = await manager.change(request)
        assert outcome.outcome == "done", outcome.because
        [skew] = outcome.skews
        assert (skew.kind, set(skew.functionalities)) == (kind, MEMBERS)
        assert 0.0 <= skew.seconds < within
        print(f"{kind}: within {1000 * skew.seconds:.2f} ms")
        for name in ("estimator", "corrector"):
            assert (await manager.peek(name)).functionalities["work"].mode == mode


async def check_members_replaced(manager: Manager) -> None:
    """Each member in turn, and then both in one change: the other one relies on it throughout, and misses nothing."""
    for roles in (("estimator",), ("corrector",), ("corrector", "estimator")):
        outcome = await manager.change(PlanRequest(restart=roles))
        assert (outcome.outcome, outcome.because, outcome.below_baseline_seconds) == ("done", None, {})
        assert outcome.plan is not None
        actions = [step.action for step in outcome.plan.steps]
        assert actions.count("handover") == len(roles)
        hears = {"estimator": "corrector", "corrector": "estimator"}
        topics = {"estimator": "/estimate", "corrector": "/correction"}
        expected = {topics[role] for role in roles if hears[role] not in roles}
        assert {swap.topic for swap in outcome.swaps} == expected, "of those that are there before and after"
        assert [(swap.missed, swap.lost, swap.duplicates) for swap in outcome.swaps] == [(0, 0, 0)] * len(expected)
        status = await manager.status()
        assert status.valid, status
        for name in manager.configuration.instances:
            for view in (await manager.peek(name)).functionalities.values():
                assert view.mode == "normal", name
