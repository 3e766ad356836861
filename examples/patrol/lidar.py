"""The driver of the lidar: reads the device, and publishes what lies within its range, all around.

``median`` smooths each beam with its neighbours, as a later version of the driver does.
"""

import time
from statistics import median as middle

from beams import BEAMS, LIDAR_RANGE, scan
from sensor_msgs.msg import LaserScan

from midstride import Component

time.sleep(1.0)  # opens the device, which has to spin up

comp = Component("lidar")
median = comp.parameter("median", 1)
device = comp.create_input("device", LaserScan, rate=10, tolerates=4)
out = comp.create_output("out", LaserScan)
drive = comp.create_functionality("drive", inputs=[device], outputs=[out])


def normal(message: LaserScan) -> None:
    ranges = message.ranges
    if median.value > 1:
        around = range(-(median.value // 2), median.value // 2 + 1)
        smooth = [middle(ranges[(beam + by) % BEAMS] for by in around) for beam in range(BEAMS)]
        ranges = list(map(min, ranges, smooth))  # nothing may move away by smoothing
    out.write(scan(message, ranges, LIDAR_RANGE))


def off() -> None:
    """Silent."""


drive.set_normal_mode(normal, inputs=[device], outputs=[out], guarantees={out: 10})
drive.set_degraded_mode(off, name="off")
comp.start()
