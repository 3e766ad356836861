"""What the nodes of this example have in common: the beams of a scan, and short ways to write messages."""

import math
from array import array

import numpy as np
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import LaserScan

BEAMS = 120  # all around, evenly, from straight back
STEP = 2 * math.pi / BEAMS
ANGLES = [-math.pi + number * STEP for number in range(BEAMS)]
LIDAR_RANGE = 4.0  # m
CAMERA_RANGE = 6.0
# The beams within the field of view of the depth camera, 120 degrees.
IN_VIEW = range(40, 81)


def scan(like, ranges, longest):
    """A scan with the stamp of ``like``; what is further away than ``longest`` (m) is infinite."""
    return LaserScan(
        header=like.header,
        angle_min=-math.pi,
        angle_max=math.pi - STEP,
        angle_increment=STEP,
        range_min=0.1,
        range_max=float(longest),
        ranges=array("f", [distance if distance <= longest else math.inf for distance in ranges]),
    )


def pose(comp, x, y, heading=0.0):
    """A pose in the map, stamped now."""
    message = PoseStamped()
    message.header.frame_id = "map"
    comp.clock.stamp(message.header.stamp)
    put(message.pose, x, y, heading)
    return message


def put(target, x, y, heading):
    """Set a ``geometry_msgs/Pose``."""
    target.position.x, target.position.y = float(x), float(y)
    target.orientation.z, target.orientation.w = math.sin(heading / 2), math.cos(heading / 2)


def read(source):
    """The x, y and heading of a ``geometry_msgs/Pose``."""
    heading = 2 * math.atan2(source.orientation.z, source.orientation.w)
    return source.position.x, source.position.y, heading


def wrapped(angle):
    return (angle + math.pi) % (2 * math.pi) - math.pi


def fit(grid, ranges, poses):
    """For each pose, how many beams from there end at something that the map has; of every third."""
    distances, angles = np.asarray(ranges)[::3], np.asarray(ANGLES[::3])
    seen = np.isfinite(distances)
    x, y, heading = np.asarray(poses).T[:, :, np.newaxis]
    angles = heading + angles[seen]
    columns = ((x + distances[seen] * np.cos(angles)) / grid.info.resolution).astype(int)
    rows = ((y + distances[seen] * np.sin(angles)) / grid.info.resolution).astype(int)
    inside = (columns >= 0) & (columns < grid.info.width) & (rows >= 0) & (rows < grid.info.height)
    cells = np.where(inside, rows * grid.info.width + columns, 0)
    return (inside & (np.asarray(grid.data)[cells] > 50)).sum(axis=1)
