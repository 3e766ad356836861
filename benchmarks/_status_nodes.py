"""The two nodes of benchmarks/status.py: user code that sleeps, in a component and in bare rclpy.

Both sleep for two of every four seconds. The bare one says in its answers when it slept last.
"""

from __future__ import annotations

import signal
import sys
import time
from types import FrameType
from typing import Any

SECONDS_ASLEEP = 2.0
PERIOD = 4.0


def component() -> None:
    from std_msgs.msg import String

    from midstride import Component

    comp = Component("busy")
    out = comp.create_output("out", String)
    work = comp.create_functionality("work", outputs=[out])

    def normal() -> None:
        time.sleep(SECONDS_ASLEEP)
        out.write(String(data="late"))

    work.set_normal_mode(normal, rate=1 / PERIOD, outputs=[out])
    work.set_degraded_mode(lambda: None)
    comp.start()


def bare() -> None:
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from std_srvs.srv import Trigger

    rclpy.init(signal_handler_options=rclpy.SignalHandlerOptions.NO)
    node = rclpy.create_node("bare")
    slept = [0.0]
    going = [True]

    def end(signum: int, frame: FrameType | None) -> None:
        going[0] = False

    def work() -> None:
        slept[0] = time.monotonic()
        time.sleep(SECONDS_ASLEEP)

    def answer(request: Any, response: Any) -> Any:
        response.success = True
        response.message = repr(slept[0])
        return response

    signal.signal(signal.SIGTERM, end)
    node.create_timer(PERIOD, work)
    node.create_service(Trigger, "~/status", answer)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while going[0]:
        executor.spin_once(timeout_sec=0.1)


if __name__ == "__main__":
    {"component": component, "bare": bare}[sys.argv[1]]()
