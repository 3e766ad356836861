"""SUAVE's f_follow_pipeline_node: from point to point of the pipeline, looking every two seconds."""

import math

from geometry_msgs.msg import PoseArray, PoseStamped
from std_msgs.msg import Bool, Float32
from suave_messages import reached, setpoint

from midstride import Component, QoS

ALTITUDE = 1.25

comp = Component("follow_pipeline")
requested = comp.create_input("requested", Bool, where={"data": True})
path = comp.create_input("path", PoseArray, qos=QoS(durability="transient_local"))
position = comp.create_input("position", PoseStamped)
out = comp.create_output("setpoint", PoseStamped)
distance = comp.create_output("distance", Float32)
follow = comp.create_functionality("f_follow_pipeline", inputs=[requested, path, position], outputs=[out, distance])
passed: list[tuple[float, float]] = []
inspected = 0.0


def normal() -> None:
    global inspected
    if path.latest is None or requested.latest is None or not requested.latest.data:
        return
    for pose in path.latest.poses[len(passed) :]:
        goal = setpoint(comp, pose.position.x, pose.position.y, ALTITUDE)
        out.write(goal)
        if not reached(position.latest, goal, 0.5, "xy"):
            return
        point = (pose.position.x, pose.position.y)
        if passed:
            inspected += math.dist(passed[-1], point)
            distance.write(Float32(data=inspected))
        passed.append(point)


outputs = [out, distance]
follow.set_normal_mode(normal, rate=0.5, inputs=[requested], outputs=outputs, name="fd_follow_pipeline")
follow.set_degraded_mode(lambda: None, outputs=outputs, name="fd_unground")
comp.start()
