"""How fast the robot may drive, given what it sees. Pure.

At any speed it must be able to stop before it meets someone who walks up to it: a speed is allowed only if nothing is
closer to the way until it stands than a person gets in that time. Walls are treated as if they were people.
"""

import math

from beams import ANGLES
from hall import BRAKING, PERSON_SPEED, ROBOT_RADIUS

REACTION = 0.35  # s, from what happens to what the wheels do
MARGIN = ROBOT_RADIUS + 0.15  # m; a scan ends at the skin of a person


def allowed(ranges, most):
    """The highest speed up to ``most`` (m/s) from which it could stop in time, with these distances around it (m)."""
    points = [(r * math.cos(a), r * math.sin(a)) for a, r in zip(ANGLES, ranges, strict=True) if math.isfinite(r)]
    ahead = [point for point in points if point[0] > 0]
    speed = most
    while speed > 0.01:
        seconds = REACTION + speed / BRAKING
        way = speed * REACTION + speed**2 / (2 * BRAKING)
        reach = MARGIN + PERSON_SPEED * seconds
        if all(math.hypot(x - min(x, way), y) > reach for x, y in ahead):
            return speed
        speed -= 0.05
    return 0.0
