"""SUAVE's monitor: has thrusters fail at stated times of the mission, and says so."""

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import ParameterEvent
from std_msgs.msg import String
from suave_messages import diagnostics, parameter

from midstride import Component

comp = Component("thruster_monitor")
guided = comp.create_input("guided", String, where={"data": "GUIDED"}, condition=True)
out = comp.create_output("diagnostics", DiagnosticArray, qos=100)
servo = comp.create_output("servo", ParameterEvent, qos=100)
monitor = comp.create_functionality("monitor", inputs=[guided], outputs=[out, servo])
events = comp.parameter("events", ["(1, failure, 100)", "(3, failure, 100)"])
due = [[word.strip() for word in event.strip("()").split(",")] for event in events.value if event]
began: float | None = None


def on_state(state: String) -> None:
    """Once a second: one event at a time, as in SUAVE."""
    global began
    if state.data != "GUIDED":
        return
    now = comp.clock.seconds()
    began = now if began is None else began
    if due and now - began >= float(due[0][2]):
        thruster, what, _ = due.pop(0)
        fails = what == "failure"
        servo.write(parameter(comp, "mavros", f"SERVO{thruster}_FUNCTION", 0 if fails else int(thruster) + 32))
        words = ("FALSE", "ERROR") if fails else ("RECOVERED", "OK")
        out.write(diagnostics(comp, "Component status", f"c_thruster_{thruster}", *words))


monitor.set_normal_mode(on_state, inputs=[guided], outputs=[out, servo])
monitor.set_degraded_mode(lambda: None, name="off")
comp.start()
