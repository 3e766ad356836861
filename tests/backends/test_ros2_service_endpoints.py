"""The service of a server that is a port, in rclpy: requests that have arrived when it is to leave the graph."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import pytest

from midstride.node.request_admission import RequestAdmission
from tests.backends.ros2_support import Bare, run

pytestmark = pytest.mark.ros2


class Rig:
    """A server of `/count`, whose node a test spins, and a bare client."""

    def __init__(self, bare: Bare) -> None:
        from rcl_interfaces.srv import ListParameters
        from rclpy.callback_groups import ReentrantCallbackGroup
        from rclpy.executors import SingleThreadedExecutor

        from midstride.backends.ros2.component.admitting_node import AdmittingNode
        from midstride.backends.ros2.component.service_endpoints import RosServer

        self.bare, self.type = bare, ListParameters
        self.admission = RequestAdmission(time.monotonic_ns)
        self.node = AdmittingNode("serving", self.admission, context=bare.node.context, start_parameter_services=False)
        self.executor = SingleThreadedExecutor(context=bare.node.context)
        self.executor.add_node(self.node)
        self.left: list[RosServer] = []
        self.waiting: list[Any] = []
        self.server = RosServer(
            self.node,
            ReentrantCallbackGroup(),
            "/count",
            ListParameters,
            self.answer,
            admission=self.admission,
            later=self.executor.create_task,
            gone=self.left.append,
        )
        self.client = bare.node.create_client(ListParameters, "/count")

    def answer(self, request: Any, response: Any) -> Any:
        response.result.names = ["answered"]
        return self.later(response) if request.depth else response

    async def later(self, response: Any) -> Any:
        from rclpy.task import Future

        self.waiting.append(Future(executor=self.executor))
        await self.waiting[-1]
        return response

    def ask(self, depth: int = 0) -> Any:
        return self.client.call_async(self.type.Request(depth=depth))

    async def until(self, condition: Callable[[], Any]) -> None:
        """Spin both nodes."""

        def done() -> Any:
            self.executor.spin_once(timeout_sec=0.002)
            return condition()

        await self.bare.until(done)

    def has_arrived(self) -> bool:
        """Whether a request waits for the executor, which is not spun meanwhile."""
        from rclpy.impl.implementation_singleton import rclpy_implementation

        wait_set = rclpy_implementation.WaitSet(0, 0, 0, 0, 1, 0, self.bare.node.context.handle)
        wait_set.clear_entities()
        wait_set.add_service(self.server.service.handle)
        wait_set.wait(0)
        return bool(wait_set.get_ready_entities("service"))

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()


def with_a_rig(scenario: Callable[[Rig], Any]) -> None:
    async def main() -> None:
        with Bare() as bare:
            rig = Rig(bare)
            try:
                await bare.until(rig.client.service_is_ready)
                await scenario(rig)
            finally:
                rig.close()

    run(main())


def test_what_has_arrived_is_answered_before_the_service_leaves() -> None:
    async def scenario(rig: Rig) -> None:
        asked = rig.ask()
        await rig.bare.until(rig.has_arrived)
        rig.server.retire()
        assert rig.left == [rig.server]
        await rig.bare.until(asked.done)
        assert asked.result().result.names == ["answered"]
        await rig.bare.until(lambda: not rig.client.service_is_ready())
        assert not rig.admission.passed_handlers.keys() & {"/count"}

    with_a_rig(scenario)


def test_a_request_that_is_being_handled_is_answered_first() -> None:
    async def scenario(rig: Rig) -> None:
        asked = rig.ask(depth=1)
        await rig.until(lambda: rig.waiting)
        rig.server.retire()
        assert rig.left == []
        await rig.until(rig.client.service_is_ready)
        rig.waiting[0].set_result(None)
        await rig.until(asked.done)
        assert asked.result().result.names == ["answered"]
        await rig.until(lambda: rig.left == [rig.server])

    with_a_rig(scenario)


def test_one_whose_successor_answers_stays_and_can_serve_again() -> None:
    async def scenario(rig: Rig) -> None:
        rig.admission.close()
        rig.server.retire()
        asked = rig.ask()
        await rig.until(lambda: rig.admission.passable())
        assert rig.left == [] and not asked.done()
        rig.server.resume(rig.answer)
        rig.admission.open([])
        await rig.until(asked.done)
        rig.server.retire()
        assert rig.left == [rig.server]

    with_a_rig(scenario)
