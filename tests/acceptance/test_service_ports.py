"""Servers and clients as ports of components with the API, on real processes."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from midstride.lang.load import load
from midstride.model.component import FunctionalityRef
from midstride.plan.request import PlanRequest
from tests.acceptance.foreign_support import robot
from tests.acceptance.serving import called, written_with_the_api
from tests.acceptance.support import ended
from tests.backends.ros2_support import run

pytestmark = [pytest.mark.ros2, pytest.mark.full]

# Relies on the server, in an async mode, and notes the mode that it is in.
USER = """
from pathlib import Path

from midstride import Component
from rcl_interfaces.srv import ListParameters

comp = Component("User")
modes = (Path(__file__).parent / "modes").open("a", buffering=1)
count = comp.create_client("count", ListParameters, within=0.5)
use = comp.create_functionality("use", inputs=[count])

async def normal():
    while True:
        response = await count.call_async(ListParameters.Request(prefixes=["-"]))
        modes.write(f"normal {response.result.names[0]}\\n")
        await comp.clock.sleep(0.2)

use.set_normal_mode(normal, inputs=[count])
use.set_degraded_mode(lambda: modes.write("off\\n"), name="off")
comp.start()
"""
MORE = """
component User {
  run "python3 user.py"
  client count : rcl_interfaces/srv/ListParameters responds within 0.5 s
  functionality use { uses count  mode normal { assume count }  mode off { } }
}
node user : User { count <- /count }
"""


def test_servers_and_clients_are_ports(tmp_path: Path) -> None:
    path = written_with_the_api(tmp_path, MORE)
    (tmp_path / "user.py").write_text(USER)

    async def scenario() -> None:
        from rcl_interfaces.srv import ListParameters

        async with robot(load(path).require(), tmp_path) as system:
            manager, node = system.manager, system.bare.node
            count, maps = (node.create_client(ListParameters, name) for name in ("/count", "/map"))
            use = FunctionalityRef("user", "use")

            def mode(ref: FunctionalityRef) -> str:
                return manager.configuration.mode(ref).name

            def seen() -> str:
                return (tmp_path / "modes").read_text().splitlines()[-1]

            async def because(role: str) -> str:
                (found,) = (each for each in (await manager.status()).instances if each.role == role)
                return found.functionalities[0].because or ""

            async def asked(client: object, depth: int = 0) -> list[str]:
                future = client.call_async(ListParameters.Request(prefixes=["-"], depth=depth))  # type: ignore[attr-defined]
                await system.until(future.done)
                return list(future.result().result.names)

            await system.until(lambda: count.service_is_ready() and maps.service_is_ready())
            await system.until(lambda: seen() == "normal talker")
            assert mode(use) == "normal"

            async with called(tmp_path, system, clients=5):  # which judges that each request is handled once
                await system.replaced("OurOther")
            assert system.holes() == []
            await system.until(lambda: seen() == "normal talker_2")

            # A server whose process is stopped does not answer: what relies on it degrades, and is restored with it.
            (talker,) = (each for each in (await manager.status()).instances if each.role == "talker")
            assert talker.pid is not None
            os.kill(talker.pid, signal.SIGSTOP)
            try:
                await system.until(lambda: seen() == "off")
                while "a request to /count has not been answered for" not in await because("user"):
                    await system.bare.spin()  # the mode is entered before its report arrives
            finally:
                os.kill(talker.pid, signal.SIGCONT)
            await system.until(lambda: seen() == "normal talker_2")

            # A mode that does not serve: one server leaves the graph, the other one refuses.
            assert await asked(maps) == ["talker_2"]
            assert await asked(maps, depth=77) == ["refused"]
            assert await asked(maps) == ["refused"]
            count.call_async(ListParameters.Request(prefixes=["-"], depth=77))
            await system.until(lambda: not count.service_is_ready())
            await system.until(lambda: seen() == "off")
            assert maps.service_is_ready()

            # Replaced, it serves again.
            report = await system.meanwhile(manager.change(PlanRequest(restart=("talker",))))
            assert (report.outcome, report.because) == ("done", None)
            await system.until(count.service_is_ready)
            assert await asked(maps) == await asked(count)
            await system.until(lambda: seen().startswith("normal"))

    with ended():
        run(scenario(), 120)
