"""Where the robot is: the way of the wheels, corrected by how the scan fits the map.

It needs the map, and the map needs its pose: neither can be in its normal mode without the other. Without map or scan
it follows the wheels alone, which drift: ``odom`` is then as good as it gets, and ``pose`` is not published.
"""

import json
import math

from beams import fit, pose, put, read, wrapped
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid, Odometry
from sensor_msgs.msg import LaserScan

from midstride import Component

SHIFTS = (0, 0, 0), (0.05, 0, 0), (-0.05, 0, 0), (0, 0.05, 0), (0, -0.05, 0), (0, 0, 0.01), (0, 0, -0.01)

comp = Component("localization")
wheels = comp.create_input("wheels", Odometry, rate=20, tolerates=9)
scan = comp.create_input("scan", LaserScan, rate=10, tolerates=4)
map_ = comp.create_input("map", OccupancyGrid, rate=1, tolerates=2)
out = comp.create_output("pose", PoseStamped)
odom = comp.create_output("odom", Odometry)
locate = comp.create_functionality("locate", inputs=[wheels, scan, map_], outputs=[out, odom], weight=5)
here = None  # x, y, heading
rolled = None  # what the wheels said when that was right
matched = None  # the last scan that was used


def follow_wheels() -> None:
    """Move ``here`` by what the wheels have turned since."""
    global here, rolled
    if wheels.latest is None:
        return
    now = read(wheels.latest.pose.pose)
    if here is None:
        here = now  # it starts where the wheels do
    elif rolled is not None:
        way, turned = math.dist(now[:2], rolled[:2]), wrapped(now[2] - rolled[2])
        forward = math.copysign(way, math.cos(math.atan2(now[1] - rolled[1], now[0] - rolled[0]) - now[2]))
        heading = here[2] + turned
        here = here[0] + forward * math.cos(heading), here[1] + forward * math.sin(heading), wrapped(heading)
    rolled = now


def match() -> None:
    """Shift ``here`` a little if the scan then fits the map better."""
    global here, matched
    if here is None or scan.latest is None or map_.latest is None or scan.latest is matched:
        return
    matched, grid, ranges = scan.latest, map_.latest, scan.latest.ranges
    tried = [(here[0] + x, here[1] + y, here[2] + turned) for x, y, turned in SHIFTS]
    here = tried[fit(grid, ranges, tried).argmax()]  # the first of the best: it stays where nothing is better


def write_odom() -> None:
    if here is not None:
        message = Odometry(header=wheels.latest.header)
        put(message.pose.pose, *here)
        odom.write(message)


def normal() -> None:
    follow_wheels()
    match()
    write_odom()
    if here is not None:
        out.write(pose(comp, *here))


def odometry() -> None:
    follow_wheels()
    write_odom()


locate.set_normal_mode(normal, rate=10, inputs=[wheels, scan, map_], outputs=[out, odom], name="matched")
locate.set_mode("odometry", odometry, rate=10, inputs=[wheels], outputs=[odom])
locate.set_degraded_mode(lambda: None, name="lost")
comp.on_export_state(lambda: json.dumps([here, rolled]).encode())


@comp.on_import_state
def import_state(state: bytes) -> None:
    global here, rolled
    here, rolled = (None if each is None else tuple(each) for each in json.loads(state))


comp.start()
