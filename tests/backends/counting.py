"""A component with a service that notes each request, and clients that call it without a pause.

Nothing here imports ROS at the top, so that the tests can be collected where there is none.
"""

from __future__ import annotations

import time
from collections import Counter
from pathlib import Path
from typing import Any

# Its service ``~/count`` appends the request's name and the instance that handles it to the file ``calls`` beside it.
COUNTING = """
from pathlib import Path

from midstride import Component
from rcl_interfaces.srv import ListParameters
from std_msgs.msg import String

comp = Component("counter")
out = comp.create_output("out", String)
work = comp.create_functionality("work", outputs=[out])
work.set_normal_mode(lambda: out.write(String(data="x")), rate=50, outputs=[out])
work.set_degraded_mode(lambda: None)
gain = comp.parameter("gain", 1.0, on_change=lambda value: None)

@comp.on_setup
def set_up(node):
    def count(request, response):
        with (Path(__file__).parent / "calls").open("a") as calls:
            calls.write(f"{request.prefixes[0]} {comp.instance}\\n")
        response.result.names = [comp.instance]
        return response

    node.create_service(ListParameters, "~/count", count)

comp.start()
"""


class Caller:
    """Bare clients of ``service`` on a bare node; each calls again once it is answered."""

    def __init__(self, node: Any, service: str, clients: int = 3) -> None:
        from rcl_interfaces.srv import ListParameters

        self._request = ListParameters.Request
        self._clients = [node.create_client(ListParameters, service) for _ in range(clients)]
        self._waiting: dict[int, tuple[Any, float, int]] = {}
        self._calls = 0
        self.answered: Counter[str] = Counter()  # by instance
        self.longest = 0.0  # from a request to its answer (s)
        self.calling = True

    def ready(self) -> bool:
        return all(client.service_is_ready() for client in self._clients)

    def step(self) -> None:
        """Take the answers that have come, and call again; to be repeated, between spins."""
        now = time.monotonic()
        for index, client in enumerate(self._clients):
            if index in self._waiting:
                future, since, _ = self._waiting[index]
                if not future.done():
                    continue
                self.longest = max(self.longest, now - since)
                self.answered[future.result().result.names[0]] += 1
                del self._waiting[index]
            if self.calling:
                self._calls += 1
                self._waiting[index] = client.call_async(self._request(prefixes=[f"{self._calls}"])), now, self._calls

    def finished(self) -> bool:
        """Whether every call has been answered, once no more are to be made."""
        self.calling = False
        self.step()
        return not self._waiting

    async def finish(self, bare: Any, calls: Path) -> None:
        """Make no more calls, and spin until each is answered. A failure says which is not, and who has handled it."""
        try:
            await bare.until(self.finished)
        except AssertionError as error:
            raise AssertionError("; ".join(self.unanswered(calls))) from error

    def unanswered(self, calls: Path) -> list[str]:
        """The requests that wait for their answers: their ages, who has handled them, and what their clients know."""
        handled = dict(line.split() for line in calls.read_text().splitlines()) if calls.exists() else {}
        return [
            f"request {number}, made {time.monotonic() - since:.1f} s ago, handled by {handled.get(f'{number}')} "
            f"(its client knows {'a' if self._clients[index].service_is_ready() else 'no'} server)"
            for index, (_, since, number) in self._waiting.items()
        ]

    def handled_once(self, calls: Path) -> None:
        """Every request was handled by one instance, the one that answered it, once."""
        handled = [line.split() for line in calls.read_text().splitlines()]
        assert Counter(name for name, _ in handled) == {f"{number}": 1 for number in range(1, self._calls + 1)}
        assert Counter(instance for _, instance in handled) == self.answered
