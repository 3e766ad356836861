"""SUAVE's f_maintain_motion_node: on entry to its degraded mode it recovers the thrusters, which takes 10 s."""

from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import TransitionEvent
from rcl_interfaces.msg import ParameterEvent
from std_msgs.msg import Bool
from suave_messages import diagnostics, parameter

from midstride import Component

comp = Component("recover_thrusters")
thrusters_ok = comp.create_input("thrusters_ok", Bool, where={"data": True})
servo = comp.create_output("servo", ParameterEvent, qos=100)
out = comp.create_output("diagnostics", DiagnosticArray, qos=100)
transition = comp.create_output("transition", TransitionEvent, qos=100)
maintain = comp.create_functionality("f_maintain_motion", inputs=[thrusters_ok], outputs=[servo, out, transition])


def announce(goal: str) -> None:
    """As a lifecycle node does: it is active while it recovers thrusters."""
    event = TransitionEvent(timestamp=comp.clock.now())
    event.goal_state.label = goal
    transition.write(event)


def all_thrusters(message: Bool) -> None:
    announce("inactive")


async def recover() -> None:
    announce("active")
    if thrusters_ok.latest is None:  # it has just been started
        return
    await comp.clock.sleep(10.0)
    for thruster in range(1, 7):
        servo.write(parameter(comp, "mavros", f"SERVO{thruster}_FUNCTION", thruster + 32))
        out.write(diagnostics(comp, "Component status", f"c_thruster_{thruster}", "RECOVERED"))
        await comp.clock.sleep(0.25)


outputs = [servo, out, transition]
maintain.set_normal_mode(all_thrusters, inputs=[thrusters_ok], outputs=outputs, name="fd_all_thrusters")
maintain.set_degraded_mode(recover, outputs=outputs, name="fd_recover_thrusters")
comp.start()
