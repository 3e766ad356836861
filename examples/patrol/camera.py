"""The driver of the depth camera: passes on its images, one row of distances in front of the robot."""

import time

from sensor_msgs.msg import Image

from midstride import Component, guarantee

time.sleep(1.0)  # opens the device

comp = Component("camera")
device = comp.create_input("device", Image, rate=10, tolerates=4)
out = comp.create_output("out", Image)
drive = comp.create_functionality("drive", inputs=[device], outputs=[out])


def normal(image: Image) -> None:
    out.write(image)


def off() -> None:
    """Silent."""


promise = guarantee(rate=10, where={"encoding": "32FC1"})
drive.set_normal_mode(normal, inputs=[device], outputs=[out], guarantees={out: promise})
drive.set_degraded_mode(off, name="off")
comp.start()
