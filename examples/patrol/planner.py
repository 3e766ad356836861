"""A path to the goal: A* on the map, in cells of half a metre, a metre away from what is there if possible."""

import heapq
import math

import numpy as np
from beams import pose, read
from geometry_msgs.msg import PoseStamped
from hall import OUTER
from nav_msgs.msg import OccupancyGrid, Path

from midstride import Component

CELL = 0.5
COLUMNS, ROWS = round(OUTER[2] / CELL), round(OUTER[3] / CELL)
CLEARANCE = 2  # cells
TOO_CLOSE = 20.0  # what a cell within that costs more, so that the robot finds out of it

comp = Component("planner")
here = comp.create_input("pose", PoseStamped, rate=10, tolerates=4)
map_ = comp.create_input("map", OccupancyGrid, rate=1, tolerates=2)
goal = comp.create_input("goal", PoseStamped, rate=2, tolerates=4)
out = comp.create_output("path", Path)
plan = comp.create_functionality("plan", inputs=[here, map_, goal], outputs=[out], weight=5)
charted, blocked = None, frozenset()


def inflated(grid: OccupancyGrid) -> frozenset:
    """The cells that are too close to something, each as (column, row)."""
    rows, columns = np.nonzero(np.reshape(grid.data, (grid.info.height, grid.info.width)) > 50)
    ratio, around = CELL / grid.info.resolution, range(2 * CLEARANCE + 1)
    near = np.zeros((ROWS + 2 * CLEARANCE, COLUMNS + 2 * CLEARANCE), bool)
    for up in around:
        for by in around:
            near[(rows / ratio).astype(int) + up, (columns / ratio).astype(int) + by] = True
    rows, columns = np.nonzero(near[CLEARANCE:-CLEARANCE, CLEARANCE:-CLEARANCE])
    return frozenset(zip(columns.tolist(), rows.tolist(), strict=True))


def search(start, end) -> list:
    """The cells from ``start`` to ``end``; empty where there is no way."""
    came, cost, ready = {start: None}, {start: 0.0}, [(0.0, start)]
    while ready:
        _, cell = heapq.heappop(ready)
        if cell == end:
            path = [cell]
            while (cell := came[cell]) is not None:
                path.append(cell)
            return path[::-1]
        for by, up in ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1)):
            to = cell[0] + by, cell[1] + up
            so_far = cost[cell] + math.hypot(by, up) + TOO_CLOSE * (to in blocked)
            inside = 0 <= to[0] < COLUMNS and 0 <= to[1] < ROWS
            if inside and so_far < cost.get(to, math.inf):
                came[to], cost[to] = cell, so_far
                heapq.heappush(ready, (so_far + math.dist(to, end), to))
    return []


def normal() -> None:
    global charted, blocked
    if here.latest is None or map_.latest is None or goal.latest is None:
        return
    if map_.latest is not charted:
        charted, blocked = map_.latest, inflated(map_.latest)
    (x, y, _), (to_x, to_y, _) = read(here.latest.pose), read(goal.latest.pose)
    cells = search((int(x / CELL), int(y / CELL)), (int(to_x / CELL), int(to_y / CELL)))
    steps = zip(cells, cells[1:], cells[2:], strict=False)
    corners = [cell for before, cell, after in steps if turns(before, cell, after)]
    path = Path()
    path.header.frame_id = "map"
    comp.clock.stamp(path.header.stamp)
    path.poses = [pose(comp, (column + 0.5) * CELL, (row + 0.5) * CELL) for column, row in corners[:12]]
    if cells:
        path.poses.append(pose(comp, to_x, to_y))
    out.write(path)


def turns(before, cell, after) -> bool:
    return (cell[0] - before[0], cell[1] - before[1]) != (after[0] - cell[0], after[1] - cell[1])


plan.set_normal_mode(normal, rate=2, inputs=[here, map_, goal], outputs=[out])
plan.set_degraded_mode(lambda: None, name="off")
comp.start()
