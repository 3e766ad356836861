"""Drives along the path, as fast as what it can see allows.

How fast that is at most depends on the mode:

- ``full`` sees as far as the camera;
- ``slow`` needs only what one detector sees;
- ``creep`` needs neither a pose nor a new path: it follows the last path for some seconds, by the wheels;
- ``stop`` needs nothing.

``timeout`` (s; 0: none) is for a robot without Midstride: it stops where the obstacles are older.
"""

import math

from beams import read, wrapped
from geometry_msgs.msg import PoseStamped, Twist
from hall import TOP_SPEED
from nav_msgs.msg import Odometry, Path
from sensor_msgs.msg import LaserScan
from stopping import allowed

from midstride import Component, at_least

SLOW, CREEP, CREEPS = 0.6, 0.2, 5.0  # m/s, m/s, s

comp = Component("controller")
timeout = comp.parameter("timeout", 0.0)
near = comp.create_input("near", LaserScan, rate=10, tolerates=4, where={"range_max": at_least(4)})
far = comp.create_input("far", LaserScan, rate=10, tolerates=4, where={"range_max": at_least(6)})
pose = comp.create_input("pose", PoseStamped, rate=10, tolerates=4)
odom = comp.create_input("odom", Odometry, rate=10, tolerates=4)
path = comp.create_input("path", Path, rate=2, tolerates=2)
cmd = comp.create_output("cmd", Twist)
drive = comp.create_functionality("drive", inputs=[near, far, pose, odom, path], outputs=[cmd], weight=10)
kept: Path | None = None  # the last path
crept = 0.0  # for how long it has crept


def follow(most: float, scan: LaserScan | None) -> None:
    global kept
    command = Twist()
    kept = path.latest or kept
    if scan is not None and odom.latest is not None and kept is not None and not outdated():
        x, y, heading = read(odom.latest.pose.pose)
        ahead = [read(each.pose)[:2] for each in kept.poses]
        target = next((each for each in ahead if math.dist(each, (x, y)) > 0.7), None)
        if target is not None:
            error = wrapped(math.atan2(target[1] - y, target[0] - x) - heading)
            command.angular.z = max(-1.0, min(1.0, 1.5 * error))
            command.linear.x = allowed(scan.ranges, most * max(0.0, 1 - abs(error)))
    cmd.write(command)


def outdated() -> bool:
    return 0 < timeout.value < (near.age or 0.0)


def full() -> None:
    global crept
    crept = 0.0
    follow(TOP_SPEED, far.latest or near.latest)


def slow() -> None:
    global crept
    crept = 0.0
    follow(SLOW, near.latest)


def creep() -> None:
    global crept
    crept += 0.05
    follow(CREEP if crept < CREEPS else 0.0, near.latest)


def stop() -> None:
    cmd.write(Twist())


drive.set_normal_mode(full, rate=20, inputs=[near, far, pose, odom, path], outputs=[cmd], name="full")
drive.set_mode("slow", slow, rate=20, inputs=[near, pose, odom, path], outputs=[cmd])
drive.set_mode("creep", creep, rate=20, inputs=[near, odom], outputs=[cmd])
drive.set_degraded_mode(stop, rate=20, outputs=[cmd], name="stop")
comp.on_stop(stop)
comp.start()
