"""Uses the smoothed measurements, and reports any that is missing or duplicated."""

from sensor_msgs.msg import Range

from midstride import Component

comp = Component("sink")
smooth = comp.create_input("in", Range, rate=200, qos=200)
use = comp.create_functionality("use", inputs=[smooth])
last = 0.0


def normal(message: Range) -> None:
    global last
    count = message.field_of_view
    if last and count != last + 1:
        comp.logger.warning(f"measurement {count:.0f} came after {last:.0f}")
    last = count


def degraded() -> None:
    global last
    last = 0.0


use.set_normal_mode(normal, inputs=[smooth])
use.set_degraded_mode(degraded)
comp.start()
