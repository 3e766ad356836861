"""How fast the robot may drive, given what it sees. Pure.

At any speed it must be able to stop before it meets someone who walks up to it: a speed is allowed only if nothing is
closer to the way until it stands than a person gets in that time. Walls are treated as if they were people.
"""

import math

from beams import ANGLES
from hall import BRAKING, PERSON_SPEED, ROBOT_RADIUS

REACTION = 0.35  # s, from what happens to what the wheels do
MARGIN = ROBOT_RADIUS + 0.15  # m; a scan ends at the skin of a person
RAYS = [(math.cos(angle), math.sin(angle)) for angle in ANGLES]


def allowed(ranges, most):
    """The highest speed up to ``most`` (m/s) from which it could stop in time, with these distances around it (m)."""
    way, reach = stopping(most)
    rays = zip(ranges, RAYS, strict=True)
    ahead = [(r * x, r * y) for r, (x, y) in rays if r <= way + reach and x > 0]  # what is further away does not matter
    speed = most
    while speed > 0.01:
        way, reach = stopping(speed)
        if all(math.hypot(x - min(x, way), y) > reach for x, y in ahead):
            return speed
        speed -= 0.05
    return 0.0


def stopping(speed):
    """The way until it stands (m), and how close to that nothing may be (m)."""
    seconds = REACTION + speed / BRAKING
    return speed * REACTION + speed**2 / (2 * BRAKING), MARGIN + PERSON_SPEED * seconds
