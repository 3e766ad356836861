"""A detector with two cameras: sees the same obstacles from a little further away.

The cameras are a device of the environment; what they would show is made up here, so that the example
runs without them.
"""

import math

from sensor_msgs.msg import Range

from midstride import Component

comp = Component("stereo_detector")
out = comp.create_output("out", Range)
detect = comp.create_functionality("detect", outputs=[out])
looked = 0


def normal() -> None:
    global looked
    looked += 1
    out.write(Range(min_range=0.1, max_range=8.0, range=2.6 + 2.0 * math.sin(looked / 15)))


def degraded() -> None:
    """Blind, and says nothing rather than something wrong."""


detect.set_normal_mode(normal, rate=10, outputs=[out])
detect.set_degraded_mode(degraded)
comp.start()
