"""Puts what /diagnostics says as text into typed messages, which contracts can constrain. It decides nothing."""

from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import Bool, Float64
from suave_messages import values

from midstride import Component, at_least, guarantee

comp = Component("diagnostics_reader")
diagnostics = comp.create_input("diagnostics", DiagnosticArray, qos=100)
visibility = comp.create_output("visibility", Float64)
thrusters_ok = comp.create_output("thrusters_ok", Bool)
read = comp.create_functionality("read", inputs=[diagnostics], outputs=[visibility, thrusters_ok])
failed: set[str] = set()


def on_diagnostics(array: DiagnosticArray) -> None:
    before = len(failed)
    for key, value in values(array):
        if key == "water_visibility":
            visibility.write(Float64(data=float(value)))
        elif key.startswith("c_thruster_"):
            (failed.add if value in ("FALSE", "ERROR") else failed.discard)(key)
    if len(failed) != before:
        thrusters_ok.write(Bool(data=not failed))


# What the best of its messages say: those who read them judge each.
best = {visibility: guarantee(where={"data": at_least(3.25)}), thrusters_ok: guarantee(where={"data": True})}
read.set_normal_mode(on_diagnostics, inputs=[diagnostics], outputs=[visibility, thrusters_ok], guarantees=best)
read.set_degraded_mode(lambda: None, name="off")
comp.start()
