"""Finds obstacles in the scan: whatever is closer than the lidar's range. Takes two seconds to start."""

import time

from beams import LIDAR_RANGE, scan
from sensor_msgs.msg import LaserScan

from midstride import Component

time.sleep(2.0)  # loads its model

comp = Component("lidar_detector")
scans = comp.create_input("scan", LaserScan, rate=10, tolerates=4)
out = comp.create_output("out", LaserScan)
detect = comp.create_functionality("detect", inputs=[scans], outputs=[out], weight=3)


def normal(message: LaserScan) -> None:
    out.write(scan(message, message.ranges, LIDAR_RANGE))


def off() -> None:
    """Blind, and says nothing rather than something wrong."""


detect.set_normal_mode(normal, inputs=[scans], outputs=[out], guarantees={out: 10})
detect.set_degraded_mode(off, name="off")
comp.start()
