"""A node with a service and a ROS action; `ask` calls both from a bare node, and writes down what becomes of each call.

Each request gets the number of requests executed before it, which is the node's state.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator

from rcl_interfaces.srv import ListParameters
from test_msgs.action import Fibonacci

# After which time a call without an answer is given up (s).
PATIENCE = 10.0


def serve() -> None:
    from midstride import Component

    comp = Component("counter")
    executed = 0

    def answer(request: ListParameters.Request, response: ListParameters.Response) -> ListParameters.Response:
        nonlocal executed
        response.result.names = [str(executed), comp.instance]
        executed += 1
        return response

    async def count(goal) -> Fibonacci.Result:  # type: ignore[no-untyped-def]
        result = Fibonacci.Result()
        while len(result.sequence) < goal.request.order and not goal.is_cancel_requested:
            result.sequence.append(len(result.sequence))
            await comp.clock.sleep(0.05)
        goal.canceled() if goal.is_cancel_requested else goal.succeed()
        return result

    def export_state() -> bytes:
        return str(executed).encode()

    def import_state(state: bytes) -> None:
        nonlocal executed
        executed = int(state)

    asked = comp.create_server("asked", ListParameters, answer, within=0.5)
    counted = comp.create_action_server("counted", Fibonacci, count, within=0.5)
    work = comp.create_functionality("work", outputs=[asked, counted])
    work.set_normal_mode(lambda: None, outputs=[asked, counted])
    work.set_degraded_mode(lambda: None)
    comp.on_export_state(export_state)
    comp.on_import_state(import_state)
    comp.start()


def ask(path: str) -> None:
    """Call the service at 20 Hz at most, one request after another, and have one goal of 2 s after another executed.

    Each response and result is written in a line, with its time (system, ns). What has no answer is given up.
    """
    import rclpy
    from rclpy.action import ActionClient
    from rclpy.task import Future

    rclpy.init()
    node = rclpy.create_node("asks")
    service = node.create_client(ListParameters, "/asked")
    action = ActionClient(node, Fibonacci, "/counted")
    with open(path, "w", buffering=1) as file:

        def write(*words: object) -> None:
            file.write(" ".join(map(str, (time.time_ns(), *words))) + "\n")

        def requests() -> Iterator[Future]:
            while True:
                begun = time.monotonic()
                yield (response := service.call_async(ListParameters.Request()))
                if response.done():
                    write("request", *response.result().result.names, time.monotonic() - begun)
                else:
                    service.remove_pending_request(response)
                    write("request", "unanswered")
                pause = Future()
                timer = node.create_timer(0.05, lambda pause=pause: pause.set_result(None))
                yield pause
                node.destroy_timer(timer)

        def goals() -> Iterator[Future]:
            while True:
                yield (accepted := action.send_goal_async(Fibonacci.Goal(order=40)))
                if accepted.done() and accepted.result().accepted:
                    yield (finished := accepted.result().get_result_async())
                    if finished.done():
                        write("goal", finished.result().status, len(finished.result().result.sequence))
                        continue
                write("goal", "unanswered", 0)

        while not (service.wait_for_service(0.1) and action.wait_for_server(0.1)):
            pass
        rows = [(calls, next(calls), time.monotonic()) for calls in (requests(), goals())]
        while True:
            now = time.monotonic()
            for number, (calls, waiting, since) in enumerate(rows):
                if waiting.done() or now - since > PATIENCE:
                    rows[number] = calls, next(calls), now
            rclpy.spin_once(node, timeout_sec=0.1)


if __name__ == "__main__":
    if len(sys.argv) == 1:
        serve()
    else:
        ask(sys.argv[1])
