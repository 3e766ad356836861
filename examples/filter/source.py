"""A range finder that measures 200 times a second; ``field_of_view`` counts its measurements."""

import math

from sensor_msgs.msg import Range

from midstride import Component

comp = Component("source")
out = comp.create_output("out", Range, qos=200)
measure = comp.create_functionality("measure", outputs=[out])
count = 0


def normal() -> None:
    global count
    count += 1
    out.write(Range(range=2.0 + math.sin(count / 50), field_of_view=float(count)))


def degraded() -> None:
    """Silent."""


measure.set_normal_mode(normal, rate=200, outputs=[out])
measure.set_degraded_mode(degraded)
comp.start()
