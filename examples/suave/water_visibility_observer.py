"""SUAVE's observer: measures a visibility that rises and falls, once a second while the vehicle is guided."""

import math

from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import String
from suave_messages import diagnostics

from midstride import Component

comp = Component("water_visibility_observer")
guided = comp.create_input("guided", String, where={"data": "GUIDED"}, condition=True)
out = comp.create_output("diagnostics", DiagnosticArray, qos=100)
observe = comp.create_functionality("observe", inputs=[guided], outputs=[out])
period = comp.parameter("period", 120.0)
lowest = comp.parameter("lowest", 1.25)
highest = comp.parameter("highest", 3.75)
shift = comp.parameter("shift", 0.0)
began: float | None = None


def on_state(state: String) -> None:
    global began
    if state.data != "GUIDED":
        return
    now = comp.clock.seconds()
    began = now if began is None else began
    angle = 2 * math.pi / period.value * (int(now - began) + shift.value)
    visibility = (lowest.value + highest.value) / 2 + (highest.value - lowest.value) / 2 * math.cos(angle)
    out.write(diagnostics(comp, "QA status", "water_visibility", str(visibility)))


observe.set_normal_mode(on_state, inputs=[guided], outputs=[out])
observe.set_degraded_mode(lambda: None, name="off")
comp.start()
