"""In the place of the model: rules written by hand, evaluated ten times a second, as SUAVE's behaviour tree does.

It says which mode it has chosen by what that mode assumes: a visibility for the altitude of the spiral, and whether
all thrusters turn. With the parameter `adapts` at false it never recovers a thruster, and stays with what the
visibility `fixed` allows: SUAVE's baseline.
"""

from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import Bool, Float64
from suave_messages import values

from midstride import Component, at_least, guarantee

comp = Component("behaviour_tree")
diagnostics = comp.create_input("diagnostics", DiagnosticArray, qos=100)
visibility = comp.create_output("visibility", Float64)
thrusters_ok = comp.create_output("thrusters_ok", Bool)
adapts = comp.parameter("adapts", True)
fixed = comp.parameter("fixed", 1.25)
phase = comp.parameter("phase", 0.0)  # of its ticks (s): it keeps step with nothing else
listen = comp.create_functionality("listen", inputs=[diagnostics])
choose = comp.create_functionality("choose", outputs=[visibility, thrusters_ok])
measured: float | None = None
failed: set[str] = set()
chosen: dict[str, object] = {}


def on_diagnostics(array: DiagnosticArray) -> None:
    global measured
    for key, value in values(array):
        if key == "water_visibility":
            measured = float(value)
        elif key.startswith("c_thruster_"):
            (failed.add if value in ("FALSE", "ERROR") else failed.discard)(key)


async def tick() -> None:
    await comp.clock.sleep(phase.value)
    if measured is None:
        return
    level = next((each for each in (3.25, 2.25, 1.25) if measured >= each), 0.0) if adapts.value else fixed.value
    if chosen.get("visibility") != level:
        chosen["visibility"] = level
        visibility.write(Float64(data=level))
    well = not failed or not adapts.value
    if chosen.get("thrusters_ok", True) != well:
        chosen["thrusters_ok"] = well
        thrusters_ok.write(Bool(data=well))


best = {visibility: guarantee(where={"data": at_least(3.25)}), thrusters_ok: guarantee(where={"data": True})}
listen.set_normal_mode(on_diagnostics, inputs=[diagnostics])
listen.set_degraded_mode(lambda: None, name="off")
choose.set_normal_mode(tick, rate=10, outputs=[visibility, thrusters_ok], guarantees=best)
choose.set_degraded_mode(lambda: None, name="off")
comp.start()
