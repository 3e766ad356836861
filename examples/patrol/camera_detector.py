"""Finds obstacles in the depth image with a network that fills most of the GPU. Takes four seconds to start.

``model`` names the network: the large one is another implementation that needs as much memory.
"""

import math
import struct
import time

from beams import BEAMS, CAMERA_RANGE, IN_VIEW, scan
from sensor_msgs.msg import Image, LaserScan

from midstride import Component

time.sleep(4.0)  # loads its model into the GPU

comp = Component("camera_detector")
model = comp.parameter("model", "small")
images = comp.create_input("image", Image, rate=10, tolerates=4, where={"encoding": "32FC1"})
out = comp.create_output("out", LaserScan)
detect = comp.create_functionality("detect", inputs=[images], outputs=[out], weight=3)


def normal(image: Image) -> None:
    ranges = [math.inf] * BEAMS
    ranges[IN_VIEW.start : IN_VIEW.stop] = struct.unpack(f"<{image.width}f", bytes(image.data))
    out.write(scan(image, ranges, CAMERA_RANGE))


def off() -> None:
    """Blind, and says nothing rather than something wrong."""


detect.set_normal_mode(normal, inputs=[images], outputs=[out], guarantees={out: 10})
detect.set_degraded_mode(off, name="off")
comp.start()
