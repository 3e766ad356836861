"""The map: the plan of the hall, and what else has stood in one place for six scans, a second apart.

People rarely do, and are not in it: the detectors see them.
"""

import math
from array import array

import hall
from beams import ANGLES, read
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid
from sensor_msgs.msg import LaserScan

from midstride import Component

CELL = 0.25
COLUMNS, ROWS = round(hall.OUTER[2] / CELL), round(hall.OUTER[3] / CELL)

comp = Component("mapping")
pose = comp.create_input("pose", PoseStamped, rate=10, tolerates=4)
scan = comp.create_input("scan", LaserScan, rate=10, tolerates=4)
out = comp.create_output("map", OccupancyGrid)
chart = comp.create_functionality("chart", inputs=[pose, scan], outputs=[out], weight=2)


def is_plan(column: int, row: int) -> bool:
    """Whether the plan has a wall in that cell or, at the edge of the hall, beside it."""
    x, y = (column + 0.5) * CELL, (row + 0.5) * CELL
    return hall.is_wall(x, y) or column in (0, COLUMNS - 1) or row in (0, ROWS - 1)


plan = frozenset(row * COLUMNS + column for row in range(ROWS) for column in range(COLUMNS) if is_plan(column, row))
seen: dict[int, int] = {}


def normal() -> None:
    hits = set()
    if pose.latest is not None and scan.latest is not None:
        x, y, heading = read(pose.latest.pose)
        for angle, distance in zip(ANGLES, scan.latest.ranges, strict=True):
            if math.isfinite(distance):
                column = int((x + distance * math.cos(heading + angle)) / CELL)
                row = int((y + distance * math.sin(heading + angle)) / CELL)
                cell = row * COLUMNS + column
                if 0 <= column < COLUMNS and 0 <= row < ROWS and cell not in plan:
                    hits.add(cell)
    for cell in hits | seen.keys():
        seen[cell] = min(100, seen.get(cell, 0) + 10) if cell in hits else seen[cell] - 20
        if seen[cell] <= 0:
            del seen[cell]
    grid = OccupancyGrid()
    grid.header.frame_id = "map"
    comp.clock.stamp(grid.header.stamp)
    grid.info.resolution, grid.info.width, grid.info.height = CELL, COLUMNS, ROWS
    cells = array("b", bytes(COLUMNS * ROWS))
    for cell in plan:
        cells[cell] = 100
    for cell, count in seen.items():
        cells[cell] = count
    grid.data = cells
    out.write(grid)


chart.set_normal_mode(normal, rate=1, inputs=[pose, scan], outputs=[out])
chart.set_degraded_mode(lambda: None, name="off")
comp.start()
