"""A version of the detector with a mistake: it starts, and fails on the first scan."""

import time

from sensor_msgs.msg import LaserScan

from midstride import Component

time.sleep(2.0)  # loads its model

comp = Component("lidar_detector")
scans = comp.create_input("scan", LaserScan, rate=10, tolerates=4)
out = comp.create_output("out", LaserScan)
detect = comp.create_functionality("detect", inputs=[scans], outputs=[out], weight=3)


def normal(message: LaserScan) -> None:
    out.write(message.range)  # there is no such field


def off() -> None:
    """Silent."""


detect.set_normal_mode(normal, inputs=[scans], outputs=[out], guarantees={out: 10})
detect.set_degraded_mode(off, name="off")
comp.start()
