"""What one side of a hand-over runs on: a host in virtual time, an arbiter and functionalities that a test sets."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TypeVar, cast

from midstride.node.component_host import Host, MessageInfo

T = TypeVar("T")
SECOND = 1_000_000_000


class VirtualHost:
    """All clocks show the time of the loop (ns); work of the data thread is done at once."""

    simulated_time = publishes_ros_time = False

    def steady(self) -> int:
        return round(asyncio.get_running_loop().time() * SECOND)

    now = message_now = steady

    async def sleep(self, seconds: float) -> None:
        await asyncio.sleep(seconds)

    async def on_data(self, function: Callable[[], T]) -> T:
        return function()

    def read_info(self, info: Any) -> MessageInfo:
        return info if isinstance(info, MessageInfo) else MessageInfo(info, None, None)

    @property
    def host(self) -> Host:
        return cast(Host, self)


def seconds() -> float:
    """The virtual time."""
    return asyncio.get_running_loop().time()


@dataclass(eq=False)
class Rights:
    """An arbiter that answers what the test sets, and notes when it was left."""

    admitted: bool = True
    refused: bool = False
    settled: bool = True
    passed_on: bool = False
    is_overtaken: bool = False
    undecided: bool = False
    reclaims: bool = False
    frees: bool = False
    asked: int = 0
    left_at: float | None = None
    shared: list[str] = field(default_factory=list)

    def begin(self, output: int) -> bool:
        return self.admitted

    def end(self) -> None: ...

    def admits(self) -> bool:
        self.asked += 1
        return self.admitted

    def request(self) -> None: ...

    def renounce(self) -> bool:
        return not self.admitted

    def give_back(self) -> None: ...

    def share(self, place: str) -> None:
        self.shared.append(place)

    def free(self) -> None: ...

    def reclaim(self) -> bool:
        return self.reclaims

    def reclaim_freed(self) -> bool:
        return self.frees

    def leave(self) -> None:
        self.left_at = seconds()
