"""Which corner of the patrol is next. Which one that is travels to a replacement of this node."""

import math

from beams import pose, read
from geometry_msgs.msg import PoseStamped
from hall import ROUTE
from sensor_msgs.msg import BatteryState

from midstride import Component

comp = Component("mission")
here = comp.create_input("pose", PoseStamped, rate=10, tolerates=4)
battery = comp.create_input("battery", BatteryState, rate=1, tolerates=3)
out = comp.create_output("goal", PoseStamped)
patrol = comp.create_functionality("patrol", inputs=[here, battery], outputs=[out], weight=5)
corner = 1


def normal() -> None:
    global corner
    if here.latest is None or (battery.latest is not None and battery.latest.percentage < 0.1):
        return
    x, y, _ = read(here.latest.pose)
    if math.dist((x, y), ROUTE[corner % len(ROUTE)]) < 1.0:
        corner += 1
    out.write(pose(comp, *ROUTE[corner % len(ROUTE)]))


patrol.set_normal_mode(normal, rate=2, inputs=[here, battery], outputs=[out])
patrol.set_degraded_mode(lambda: None, name="hold")
comp.on_export_state(lambda: str(corner).encode())


@comp.on_import_state
def import_state(state: bytes) -> None:
    global corner
    corner = int(state)


comp.start()
