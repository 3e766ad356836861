"""Whether everything is there that the robot needs, as ROS's diagnostics say it."""

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import BatteryState, LaserScan
from std_msgs.msg import Bool

from midstride import Component

comp = Component("health")
near = comp.create_input("near", LaserScan, rate=10, tolerates=4)
pose = comp.create_input("pose", PoseStamped, rate=10, tolerates=4)
battery = comp.create_input("battery", BatteryState, rate=1, tolerates=3)
bumper = comp.create_input("bumper", Bool, rate=10)
out = comp.create_output("out", DiagnosticArray)
judge = comp.create_functionality("judge", inputs=[near, pose, battery, bumper], outputs=[out])


def report(level: int, words: str) -> None:
    message = DiagnosticArray()
    comp.clock.stamp(message.header.stamp)
    if bumper.latest is not None and bumper.latest.data:
        level, words = max(level, 1), f"{words}; touched something"
    status = DiagnosticStatus(name="patrol", level=bytes([level]), message=words)
    if battery.latest is not None:
        status.values = [KeyValue(key="charge", value=f"{battery.latest.percentage:.0%}")]
    message.status = [status]
    out.write(message)


judge.set_normal_mode(lambda: report(0, "all is well"), rate=1, inputs=[near, pose, battery], outputs=[out])
judge.set_mode("impaired", lambda: report(1, "no pose or no obstacles"), rate=1, inputs=[battery], outputs=[out])
judge.set_degraded_mode(lambda: report(2, "no battery state"), rate=1, outputs=[out], name="alarm")
comp.start()
