"""Stand-in for ArduSub, MAVROS and Gazebo: a vehicle that goes straight to its setpoint.

Each failed thruster takes three tenths of the speed that is left. It is GUIDED once it has been asked to be.
"""

import math

from geometry_msgs.msg import PoseStamped
from rcl_interfaces.msg import ParameterEvent
from std_msgs.msg import String
from suave_messages import SEA_BED

from midstride import Component, guarantee

RATE = 5
LEFT = 0.7  # of the speed, with each failed thruster

comp = Component("vehicle")
setpoint = comp.create_input("setpoint", PoseStamped)
servo = comp.create_input("servo", ParameterEvent, qos=100)
set_mode = comp.create_input("set_mode", String)
position = comp.create_output("position", PoseStamped)
state = comp.create_output("state", String)
start_y = comp.parameter("y", 2.8)
speed = comp.parameter("speed", 0.28)
drive = comp.create_functionality("drive", inputs=[setpoint], outputs=[position, state])
obey = comp.create_functionality("obey", inputs=[servo, set_mode])

here = [-17.0, start_y.value, SEA_BED + 1.5]
failed: set[str] = set()
flight_mode = "MANUAL"
calls = 0


def normal() -> None:
    global calls
    goal = setpoint.latest
    if goal is not None and flight_mode == "GUIDED":
        there = goal.pose.position
        way = [there.x - here[0], there.y - here[1], there.z - here[2]]
        length = math.hypot(*way)
        step = min(1.0, speed.value * LEFT ** len(failed) / RATE / length) if length else 0.0
        here[:] = [a + step * b for a, b in zip(here, way, strict=True)]
    message = PoseStamped()
    comp.clock.stamp(message.header.stamp)
    message.pose.position.x, message.pose.position.y, message.pose.position.z = here
    position.write(message)
    if calls % RATE == 0:
        state.write(String(data=flight_mode))
    calls += 1


def on_servo(event: ParameterEvent) -> None:
    """``SERVOn_FUNCTION``: 0 means that thruster n does not turn."""
    for changed in event.changed_parameters:
        (failed.discard if changed.value.double_value else failed.add)(changed.name)


def on_set_mode(mode: String) -> None:
    global flight_mode
    flight_mode = mode.data


guided = {state: guarantee(where={"data": "GUIDED"})}
drive.set_normal_mode(normal, rate=RATE, outputs=[position, state], guarantees=guided)
drive.set_degraded_mode(lambda: None, name="off")
obey.set_normal_mode({servo: on_servo, set_mode: on_set_mode}, inputs=[servo, set_mode])
obey.set_degraded_mode(lambda: None, name="off")
comp.start()
