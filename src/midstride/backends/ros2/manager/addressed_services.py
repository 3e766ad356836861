"""The lifecycle, parameter and state services of one process, asked without ROS.

The two nodes of a hand-over have one name, and a request by ROS reaches both. One through the page of the gates is
taken by the executor of the node that is meant, like any other (docs/decisions/addressed-requests.md).
"""

from __future__ import annotations

import asyncio
from typing import Any, Final

from rclpy.serialization import deserialize_message, serialize_message

from midstride.backends.ros2.manager.node_services import INTERVAL, Lost, RosNodeServices
from midstride.errors import BackendError
from midstride.foreign.page import Page
from midstride.foreign.services import NoAnswer

# How often it looks whether the node has a service (s).
_LOOK: Final = 0.02


class AddressedServices(RosNodeServices):
    """The services of the node ``index`` of ``page``, with the full name ``name``: see :class:`RosNodeServices`.

    ``alone``: no other process had its name when it was started, so what the library does not see may be asked by ROS.
    """

    def __init__(self, node: Any, name: str, page: Page, index: int, *, alone: bool) -> None:
        super().__init__(node, name)
        self._page = page
        self._index = index
        self._alone = alone

    @property
    def _is_ambiguous(self) -> bool:
        return not self._page.servers(self._index) and super()._is_ambiguous

    def _is_in_page(self, service: str) -> bool:
        return f"{self._name}/{service}" in self._page.servers(self._index)

    def _asks_by_ros(self, type_: Any, service: str) -> bool:
        return self._alone and self._offers(type_, service) and not super()._is_ambiguous

    def _is_offered(self, type_: Any, service: str) -> bool:
        return self._is_in_page(service) or self._asks_by_ros(type_, service)

    async def _response(self, type_: Any, service: str, timeout: float, request: Any, lost: Lost | None) -> Any:
        loop, name = asyncio.get_running_loop(), f"{self._name}/{service}"
        deadline = loop.time() + timeout
        while not self._is_in_page(service):
            if self._asks_by_ros(type_, service):
                return await super()._response(type_, service, deadline - loop.time(), request, lost)
            if loop.time() >= deadline:
                raise NoAnswer(f"it has offered no service {name} within {timeout:g} s")
            await asyncio.sleep(_LOOK)
        try:
            number = self._page.ask(self._index, name, serialize_message(request or type_.Request()))
            try:
                while (found := self._page.response(self._index, number)) is None:
                    if self._page.is_dead(self._index):
                        raise NoAnswer(f"its process ended before {name} had answered")
                    if loop.time() >= deadline:
                        raise NoAnswer(f"{name} has not answered within {timeout:.3g} s")
                    await asyncio.sleep(INTERVAL)
            finally:
                self._page.withdraw(self._index, number)
        except BackendError as error:
            raise NoAnswer(str(error)) from None
        return deserialize_message(found, type_.Response)
