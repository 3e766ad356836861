"""The hall and the robot's hardware: simulates them, and is what the drivers read. Not a part of the robot's software.

With the parameter ``trace``, the true state is written to that file, a line of JSON ten times a second. On ROS 2 it
publishes ``/clock``, at the parameter ``speed``.
"""

import json
import struct
from array import array

import hall
from beams import ANGLES, CAMERA_RANGE, IN_VIEW, put
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from sensor_msgs.msg import BatteryState, Image, LaserScan
from sim_clock import SimClock
from std_msgs.msg import Bool

from midstride import Component, guarantee

comp = Component("world")
seed = comp.parameter("seed", 1)
people = comp.parameter("people", 6)
trace = comp.parameter("trace", "")
speed = comp.parameter("speed", 1.0, on_change=lambda value: clock.set_speed(value))
clock = SimClock(speed.value)
comp.on_setup(clock.publish)
cmd = comp.create_input("cmd", Twist)
lidar = comp.create_output("lidar", LaserScan)
camera = comp.create_output("camera", Image)
wheels = comp.create_output("wheels", Odometry)
bumper = comp.create_output("bumper", Bool)
cells = comp.create_output("cells", BatteryState)
outputs = [lidar, camera, wheels, bumper, cells]
move = comp.create_functionality("move", inputs=[cmd], outputs=outputs)
state = hall.start(seed.value, people.value)
ticks, last, bumped = 0, None, False


def tick() -> None:
    global state, ticks, last, bumped
    now = comp.clock.seconds()
    seconds = 0.05 if last is None else min(0.2, max(0.0, now - last))
    last, ticks = now, ticks + 1
    fresh = cmd.latest is not None and cmd.age is not None and cmd.age < hall.COMMAND_TIMEOUT
    forward, turn = (cmd.latest.linear.x, cmd.latest.angular.z) if fresh else (0.0, 0.0)
    state = hall.step(state, forward, turn, seconds)
    bumped = bumped or state.bumped
    write_wheels()
    if ticks % 2 == 0:
        write_sensors()
        bumper.write(Bool(data=bumped))
        bumped = False
        write_trace(forward, fresh)
    if ticks % 20 == 0:
        cells.write(BatteryState(voltage=20.0 + 5.0 * state.charge, percentage=state.charge))


def write_wheels() -> None:
    message = Odometry()
    comp.clock.stamp(message.header.stamp)
    put(message.pose.pose, *state.wheels)
    message.twist.twist.linear.x = state.speed
    wheels.write(message)


def write_sensors() -> None:
    ranges = hall.cast(state, ANGLES, CAMERA_RANGE)
    scan, image = LaserScan(), Image()
    comp.clock.stamp(scan.header.stamp)
    comp.clock.stamp(image.header.stamp)
    scan.ranges = array("f", ranges)
    image.height, image.width, image.encoding, image.step = 1, len(IN_VIEW), "32FC1", 4 * len(IN_VIEW)
    depth = [ranges[beam] for beam in IN_VIEW]
    image.data = array("B", struct.pack(f"<{len(depth)}f", *depth))
    lidar.write(scan)
    camera.write(image)


def write_trace(forward: float, commanded: bool) -> None:
    if trace.value:
        with open(trace.value, "a", encoding="utf-8") as file:
            figures = {
                name: getattr(state, name) for name in ("time", "x", "y", "heading", "speed", "progress", "charge")
            }
            people = [[round(each.x, 2), round(each.y, 2)] for each in state.people]
            counts = {"collisions": state.collisions, "near_misses": state.near_misses}
            line = {"at": comp.clock.seconds(), **figures, **counts, "people": people, "forward": forward}
            file.write(json.dumps({**line, "commanded": commanded}) + "\n")


image = guarantee(rate=10, where={"encoding": "32FC1"})
rates = {lidar: 10, camera: image, bumper: 10, cells: 1}
move.set_normal_mode(tick, rate=20, outputs=outputs, guarantees=rates)
move.set_degraded_mode(lambda: None, name="off")
comp.start()
