"""A message-driven filter: for every measurement, the mean of the last five.

The measurements travel with it when it is replaced, so its successor does not begin with nothing.
"""

import json
from collections import deque

from sensor_msgs.msg import Range

from midstride import Component

comp = Component("filter")
raw = comp.create_input("in", Range, rate=200, qos=200)
out = comp.create_output("out", Range, qos=200)
smooth = comp.create_functionality("smooth", inputs=[raw], outputs=[out])
window: deque[float] = deque(maxlen=5)


def normal(message: Range) -> None:
    window.append(message.range)
    out.write(Range(range=sum(window) / len(window), field_of_view=message.field_of_view))


def degraded() -> None:
    """Silent."""


smooth.set_normal_mode(normal, inputs=[raw], outputs=[out], guarantees={out: 200})
smooth.set_degraded_mode(degraded)


@comp.on_export_state
def export_state() -> bytes:
    return json.dumps(list(window)).encode()


@comp.on_import_state
def import_state(state: bytes) -> None:
    window.extend(json.loads(state))


comp.start()
