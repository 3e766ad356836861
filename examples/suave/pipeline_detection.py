"""SUAVE's detection: the pipeline is seen within a camera's view of 60 degrees, if the water is clear that far."""

import itertools
import math

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Pose, PoseArray, PoseStamped
from std_msgs.msg import Bool
from suave_messages import SEA_BED, values

from midstride import Component, QoS

# The corners of the pipeline's course, from SUAVE's suave_tools/config/pipeline_poses.csv.
CORNERS = [(-17.0, 0.0), (-35.0, 0.0), (-36.5665, -0.65), (-51.56, -15.14)]
SPACING = 0.5

comp = Component("pipeline_detection")
position = comp.create_input("position", PoseStamped)
diagnostics = comp.create_input("diagnostics", DiagnosticArray, qos=100)
detected = comp.create_output("detected", Bool)
path = comp.create_output("path", PoseArray, qos=QoS(durability="transient_local"))
detect = comp.create_functionality("detect", inputs=[position, diagnostics], outputs=[detected, path])
visibility: float | None = None
found = False


def course() -> list[tuple[float, float]]:
    points = [CORNERS[0]]
    for (x, y), (next_x, next_y) in itertools.pairwise(CORNERS):
        count = max(1, round(math.hypot(next_x - x, next_y - y) / SPACING))
        points += [(x + (next_x - x) * k / count, y + (next_y - y) * k / count) for k in range(1, count + 1)]
    return points


POINTS = course()


def on_diagnostics(array: DiagnosticArray) -> None:
    global visibility
    for key, value in values(array):
        if key == "water_visibility":
            visibility = float(value)


def on_position(message: PoseStamped) -> None:
    global found
    if found or visibility is None:
        return
    here = message.pose.position
    altitude = here.z - SEA_BED
    half = altitude * math.tan(math.pi / 6)
    seen = (k for k, (x, y) in enumerate(POINTS) if abs(here.x - x) <= half and abs(here.y - y) <= half)
    first = next(seen, None) if altitude <= visibility else None
    if first is not None:
        found = True
        order = [*POINTS[first:], *reversed(POINTS)]
        poses = [Pose() for _ in order]
        for pose, (x, y) in zip(poses, order, strict=True):
            pose.position.x, pose.position.y, pose.position.z = x, y, SEA_BED
        path.write(PoseArray(poses=poses))
    detected.write(Bool(data=found))


inputs, outputs = [position, diagnostics], [detected, path]
detect.set_normal_mode({position: on_position, diagnostics: on_diagnostics}, inputs=inputs, outputs=outputs)
detect.set_degraded_mode(lambda: None, name="off")
comp.start()
