"""SUAVE's f_generate_search_path_node: a spiral at an altitude of 3, 2 or 1 m, one mode for each.

Which of them it is in is decided by what they assume, in the specification; there is no such rule here.
"""

import math
from collections.abc import Callable

from geometry_msgs.msg import PoseStamped
from rcl_interfaces.msg import ParameterEvent
from std_msgs.msg import Bool, Float64
from suave_messages import parameter, reached, setpoint

from midstride import Component, at_least

NODE = "/f_generate_search_path_node"
STEP = 0.1  # the angle between two points (rad)

comp = Component("spiral_search")
requested = comp.create_input("requested", Bool, where={"data": True})
clear = comp.create_input("clear", Float64, where={"data": at_least(3.25)})
medium = comp.create_input("medium", Float64, where={"data": at_least(2.25)})
murky = comp.create_input("murky", Float64, where={"data": at_least(1.25)})
position = comp.create_input("position", PoseStamped)
out = comp.create_output("setpoint", PoseStamped)
parameter_events = comp.create_output("parameter_events", ParameterEvent, qos=100)
search = comp.create_functionality(
    "f_generate_search_path",
    inputs=[requested, clear, medium, murky, position],
    outputs=[out, parameter_events],
)


class Spiral:
    """Where the vehicle goes next, a point at a time."""

    def __init__(self) -> None:
        self.altitude: float | None = None
        self.centre: tuple[float, float] | None = None
        self.goal: PoseStamped | None = None
        self.count = 0
        self.x = self.y = 0.0

    def advance(self, altitude: float) -> None:
        """Once a second, and when a mode is entered."""
        if altitude != self.altitude:
            self.altitude = altitude
            self.count += 1
            parameter_events.write(parameter(comp, NODE, "spiral_altitude", altitude))
        here = position.latest
        if here is None or requested.latest is None or not requested.latest.data:
            return
        if self.centre is None:
            self.centre, self.count = (here.pose.position.x, here.pose.position.y), 1
        if self.goal is None or reached(here, self.goal, 0.4, "xyz"):
            width = 2 * altitude * math.tan(math.pi / 6)
            radius = math.hypot(self.x, self.y) + width * STEP / (2 * math.pi)
            self.x, self.y = radius * math.cos(self.count * STEP), radius * math.sin(self.count * STEP)
            self.count += 1
        self.goal = setpoint(comp, self.centre[0] + self.x, self.centre[1] + self.y, altitude)
        out.write(self.goal)


spiral = Spiral()


def at(altitude: float) -> Callable[[], None]:
    return lambda: spiral.advance(altitude)


outputs = [out, parameter_events]
search.set_normal_mode(at(3.0), rate=1, inputs=[requested, clear], outputs=outputs, name="fd_spiral_high")
search.set_mode("fd_spiral_medium", at(2.0), rate=1, inputs=[requested, medium], outputs=outputs)
search.set_mode("fd_spiral_low", at(1.0), rate=1, inputs=[requested, murky], outputs=outputs)
search.set_degraded_mode(lambda: None, outputs=outputs, name="fd_unground")
comp.start()
