"""Joins what the two detectors have found.

With both, obstacles are known as far as the camera sees, and ``far`` says so. One of them alone is enough to drive
slowly, by ``near``. The scans are matched by their stamps, so one detector that falls silent keeps the other from
being used in mode ``both``: without a change of the mode, nothing is published any more.
"""

from beams import CAMERA_RANGE, LIDAR_RANGE, scan
from sensor_msgs.msg import LaserScan

from midstride import Component, any_of, approximate, at_least, guarantee

comp = Component("fusion")
lidar = comp.create_input("lidar", LaserScan, rate=10, tolerates=2)
camera = comp.create_input("camera", LaserScan, rate=10, tolerates=2)
near = comp.create_output("near", LaserScan)
far = comp.create_output("far", LaserScan)
fuse = comp.create_functionality("fuse", inputs=[lidar, camera], outputs=[near, far], weight=3)


def both(from_lidar: LaserScan, from_camera: LaserScan) -> None:
    ranges = list(map(min, from_lidar.ranges, from_camera.ranges))
    near.write(scan(from_lidar, ranges, LIDAR_RANGE))
    far.write(scan(from_lidar, ranges, CAMERA_RANGE))


def single(message: LaserScan) -> None:
    near.write(scan(message, message.ranges, LIDAR_RANGE))


def off() -> None:
    """Nothing is known."""


sees = guarantee(rate=10, where={"range_max": at_least(4)})
sees_far = guarantee(rate=10, where={"range_max": at_least(6)})
fuse.set_normal_mode(
    both,
    inputs=[lidar, camera],
    outputs=[near, far],
    guarantees={near: sees, far: sees_far},
    sync=approximate(0.05),
    name="both",
)
fuse.set_mode("single", single, inputs=[any_of(lidar, camera)], outputs=[near], guarantees={near: sees})
fuse.set_degraded_mode(off, name="off")
comp.start()
