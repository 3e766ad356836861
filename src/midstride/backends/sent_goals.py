"""The goals that a client of a ROS action has sent, on any platform."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


def hand_on(response: Any, given: Any, handle_of: Callable[[Any], Any], accepted: Callable[[Any], object]) -> None:
    """Set the future ``given`` once the ``response`` to a goal is done: to the handle that ``handle_of`` makes of it.

    ``accepted`` is called with the handle of a goal that was accepted. Nothing happens if ``given`` has ended already.
    """

    def done(_: Any) -> None:
        if given.done():
            return
        if (error := response.exception()) is not None:
            given.set_exception(error)
            return
        if (handle := handle_of(response.result())).accepted:
            accepted(handle)
        given.set_result(handle)

    response.add_done_callback(done)
