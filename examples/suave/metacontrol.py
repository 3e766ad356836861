"""In the place of the model: Metacontrol's own reasoner, with SUAVE's ontology, every 1.5 s.

It runs `mros2_reasoner.reasoner.Reasoner` of a checkout of mc_mros_reasoner without its ROS node. The time that the
reasoning takes on this machine is slept, so that it takes as much virtual time. Its choice is said as in
`behaviour_tree.py`. The parameter `folder` has mc_mros_reasoner, tomasys.owl, mros.owl and suave.owl.
"""

import logging
import signal
import sys
import time
from pathlib import Path
from types import SimpleNamespace

from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import Bool, Float64

from midstride import Component, Output, at_least, guarantee

PERIOD = 1.5
NEEDS = {"fd_spiral_high": 3.25, "fd_spiral_medium": 2.25, "fd_spiral_low": 1.25}

comp = Component("metacontrol")
diagnostics = comp.create_input("diagnostics", DiagnosticArray, qos=100)
visibility = comp.create_output("visibility", Float64)
thrusters_ok = comp.create_output("thrusters_ok", Bool)
folder = Path(comp.parameter("folder", "").value)
chosen: dict[Output, Float64 | Bool] = {}
listen = comp.create_functionality("listen", inputs=[diagnostics])
choose = comp.create_functionality("choose", outputs=[visibility, thrusters_ok])

sys.path.insert(0, str(folder / "mc_mros_reasoner" / "mros2_reasoner"))
import owlready2  # noqa: E402  # it and the reasoner are not installed with Midstride
from mros2_reasoner.reasoner import Reasoner  # noqa: E402

owlready2.onto_path.append(str(folder))
logging.getLogger().setLevel(logging.ERROR)
install, signal.signal = signal.signal, lambda *arguments: None  # it wants a signal, which threads cannot have
reasoner = Reasoner([str(folder / name) for name in ("tomasys.owl", "mros.owl", "suave.owl")])
signal.signal = install
with reasoner.tomasys:  # the branch of tomasys.owl that is there does not say that this has one value

    class o_always_improve(owlready2.DataProperty, owlready2.FunctionalProperty):
        range = [bool]


def on_diagnostics(array: DiagnosticArray) -> None:
    """As `RosReasoner.diagnostics_callback`, and the objectives of the task `search_pipeline` at the first message."""
    if not reasoner.has_objective():
        for function in ("f_maintain_motion", "f_generate_search_path"):
            objective = reasoner.get_new_tomasys_objective(f"obj_{function}", f"*{function}")
            if function == "f_generate_search_path":
                reasoner.set_objective_always_improve(objective)
            reasoner.update_objective_status(objective, "UNGROUNDED")
    for status in array.status:
        plain = SimpleNamespace(values=[SimpleNamespace(key=each.key, value=each.value) for each in status.values])
        if status.message == "Component status":
            reasoner.update_component_status(plain)
        elif status.message == "QA status":
            reasoner.update_qa(plain)


def loop() -> None:
    """As `RosReasoner.metacontrol_loop_callback`: analyse, plan, execute."""
    if not reasoner.has_objective():
        return
    began = time.perf_counter()
    desired = reasoner.plan(reasoner.analyze())
    time.sleep(time.perf_counter() - began)
    for objective, design in desired.items():
        if design in NEEDS:
            chosen[visibility] = Float64(data=NEEDS[design])
        else:
            chosen[thrusters_ok] = Bool(data=design == "fd_all_thrusters")
        reasoner.set_new_grounding(design, objective)
    for port, message in chosen.items():  # also where nothing is new: a component whose calls take long and that writes
        port.write(message)  # nothing hangs, as far as its reflex knows


best = {visibility: guarantee(where={"data": at_least(3.25)}), thrusters_ok: guarantee(where={"data": True})}
listen.set_normal_mode(on_diagnostics, inputs=[diagnostics])
listen.set_degraded_mode(lambda: None, name="off")
choose.set_normal_mode(loop, rate=1 / PERIOD, outputs=[visibility, thrusters_ok], guarantees=best)
choose.set_degraded_mode(lambda: None, name="off")
comp.start()
