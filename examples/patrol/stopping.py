"""How fast the robot may drive, given what it sees. Pure.

At any speed it must be able to stop before it meets someone who walks up to it: a speed is allowed only if nothing is
closer to the way until it stands than a person gets in that time. Walls are treated as if they were people.
"""

import numpy as np
from beams import ANGLES
from hall import BRAKING, PERSON_SPEED, ROBOT_RADIUS

REACTION = 0.35  # s, from what happens to what the wheels do
MARGIN = ROBOT_RADIUS + 0.15  # m; a scan ends at the skin of a person
STEP = 0.05  # m/s
RAYS = np.array([np.cos(ANGLES), np.sin(ANGLES)])


def allowed(ranges, most):
    """The highest speed up to ``most`` (m/s) from which it could stop in time, with these distances around it (m)."""
    speeds = np.arange(most, 0.01, -STEP)[:, np.newaxis]
    way = speeds * REACTION + speeds**2 / (2 * BRAKING)  # until it stands
    reach = MARGIN + PERSON_SPEED * (REACTION + speeds / BRAKING)
    distances = np.asarray(ranges)
    ahead = np.isfinite(distances) & (RAYS[0] > 0)
    x, y = RAYS[:, ahead] * distances[ahead]
    (possible,) = np.nonzero((np.hypot(x - np.minimum(x, way), y) > reach).all(axis=1))
    return float(speeds[possible[0], 0]) if len(possible) else 0.0
