"""How full the battery is: the mean of what its cells have reported."""

from collections import deque

from sensor_msgs.msg import BatteryState

from midstride import Component

comp = Component("battery")
cells = comp.create_input("cells", BatteryState, rate=1, tolerates=3)
out = comp.create_output("out", BatteryState)
watch = comp.create_functionality("watch", inputs=[cells], outputs=[out])
recent: deque[float] = deque(maxlen=5)


def normal(message: BatteryState) -> None:
    recent.append(message.percentage)
    message.percentage = sum(recent) / len(recent)
    out.write(message)


watch.set_normal_mode(normal, inputs=[cells], outputs=[out], guarantees={out: 1})
watch.set_degraded_mode(lambda: None, name="off")
comp.start()
