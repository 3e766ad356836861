"""The motor controller of the paper's figures 1 to 3: drives as fast as the obstacle ahead allows.

Without a detector it cannot know what is ahead. Its degraded mode then stops the motor, which
needs no assumption at all.
"""

from geometry_msgs.msg import Twist
from sensor_msgs.msg import Range

from midstride import Component

comp = Component("controller")
obstacles = comp.create_input("in", Range, rate=10)
cmd = comp.create_output("cmd", Twist)
control = comp.create_functionality("control", inputs=[obstacles], outputs=[cmd], weight=10)


def normal() -> None:
    command = Twist()
    ahead = obstacles.latest
    if ahead is not None:
        command.linear.x = max(0.0, min(1.0, (ahead.range - 0.5) / 4))
    cmd.write(command)


def degraded() -> None:
    cmd.write(Twist())  # stand still


control.set_normal_mode(normal, rate=20, inputs=[obstacles], outputs=[cmd])
control.set_degraded_mode(degraded, rate=20, outputs=[cmd])
comp.on_stop(degraded)
comp.start()
