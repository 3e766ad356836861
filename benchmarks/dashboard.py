"""What the live view costs the manager, and how soon a step is seen: 500 nodes, 1,500 topics, 150 nodes that change.

A process serves a system whose components are not there: their reports are made up, and handed to the manager as its
control connections hand them over, 10 times a second of the nodes that change (their rate, reason and a parameter
differ each time, with `--modes` also their mode) and twice a second of the others. So what is counted is the view, the
server and its sockets, and not what components and their connections cost. Clients are in another process. Processor
time is that of the whole serving process, beside the same without a view; the delay is from a step's event to its
arrival at each client.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

from _guard import guard

HERE = Path(__file__).resolve().parent
PORTS = 3
# How often nodes report that do not change, and how often a step is said to be taken (Hz).
IDLE, STEPS = 2.0, 4.0
WARM_UP = 4.0


def document(nodes: int) -> dict[str, Any]:
    """Nodes in a ring: each publishes on three topics, and uses those of the node before it."""
    message = {"type": "std_msgs/msg/String", "rate": 10}
    component = {
        "inputs": {f"in_{index}": message for index in range(PORTS)},
        "outputs": [f"out_{index}" for index in range(PORTS)],
        "functionalities": {
            "work": {
                "uses": [f"in_{index}" for index in range(PORTS)],
                "produces": [f"out_{index}" for index in range(PORTS)],
                "modes": {
                    "normal": {"guarantees": {f"out_{index}": message for index in range(PORTS)}},
                    "degraded": {},
                },
            }
        },
        "parameters": {"gain": {"value": 0.5}, "count": {"value": 0}},
    }
    return {
        "system": "ring",
        "topics": {f"/t_{node}_{index}": message for node in range(nodes) for index in range(PORTS)},
        "components": {"Worker": component},
        "nodes": {
            f"group_{node % 10}/node_{node}": {
                "component": "Worker",
                "attachments": {
                    **{f"out_{index}": [f"/t_{node}_{index}"] for index in range(PORTS)},
                    **{f"in_{index}": [f"/t_{(node - 1) % nodes}_{index}"] for index in range(PORTS)},
                },
            }
            for node in range(nodes)
        },
    }


class Reports:
    """Makes up what the components report."""

    def __init__(self, watched: Any, changing: int, rate: float, modes: bool) -> None:
        from midstride.wire.state import ComponentState, FunctionalityState

        self._watched, self._changing, self._rate, self._modes = watched, changing, rate, modes
        self._begun = time.monotonic()
        self._count = 0
        configuration = watched.system.configuration
        self._attached = {
            name: [(port.port, topic) for port, topic in configuration.attached_ports(name)]
            for name in configuration.instances
        }
        self._states = [
            ComponentState(
                instance=name,
                uuid=name,
                pid=1,
                revision=1,
                functionalities={"work": FunctionalityState(mode="normal", since=0.0, because="the plan asked for it")},
                ports=self._ports(name, 10.0),
                parameters={"gain": 0.5, "count": 0},
                stopping=1.0,
            )
            for name in sorted(configuration.instances)
        ]

    def _ports(self, instance: str, rate: float) -> dict[str, Any]:
        from midstride.wire.state import LinkState, Measured

        self._count += 1
        measured = Measured(window=2.0, covered=2.0, rate=rate, age=self._count % 97 / 1000, jitter=0.001, longest=0.11)
        out, into = (LinkState(gate=gate, count=self._count, measured=measured) for gate in ("open", None))  # type: ignore[arg-type]
        return {port: {topic: out if port.startswith("out") else into} for port, topic in self._attached[instance]}

    def report(self, index: int) -> None:
        """One node reports, as its control connection would hand it over."""
        from msgspec import structs

        from midstride.wire.state import FunctionalityState

        state = self._states[index]
        changes = index < self._changing
        count = state.parameters["count"] + changes
        because = f"message {count} of the plan" if changes else "the plan asked for it"
        name = "degraded" if changes and self._modes and count % 2 else "normal"
        began = time.monotonic() if changes and self._modes else self._begun
        mode = FunctionalityState(mode=name, since=time.monotonic() - began, because=because)
        state = structs.replace(
            state,
            functionalities={"work": mode},
            ports=self._ports(state.instance, 10.0 + (count % 7 if changes else 0)),
            parameters={"gain": 0.5, "count": count},
        )
        self._states[index] = state
        self._watched.system.life.reported(state)
        for listener in self._watched.client.listeners:
            listener(state)

    async def run(self) -> None:
        """Reports evenly over time, in slices of 10 ms."""
        loop, begun = asyncio.get_running_loop(), asyncio.get_running_loop().time()
        done = [0.0, 0.0]
        groups = ((range(self._changing), self._rate), (range(self._changing, len(self._states)), IDLE))
        stepped = 0.0
        for index in range(len(self._states)):
            self.report(index)
        while True:
            await asyncio.sleep(0.01)
            now = loop.time() - begun
            for place, (nodes, rate) in enumerate(groups):
                if not nodes:
                    continue
                due = now * rate * len(nodes)
                while done[place] < due:
                    self.report(nodes[int(done[place]) % len(nodes)])
                    done[place] += 1
            if now * STEPS >= stepped:
                stepped += 1
                self._watched.events.add("step", f"{int(stepped)}/1 a step")


class Manager:
    """Of a system whose components are not there."""

    def __init__(self, nodes: int) -> None:
        from midstride.codec.specification_form import decode_specification
        from midstride.model.specification import initial
        from midstride.runtime.command_queue import CommandQueue
        from midstride.runtime.manager_clock import SystemClock
        from midstride.runtime.process.component_client import ComponentClient
        from midstride.runtime.records.events import EventLog
        from midstride.runtime.records.reports import UpReport
        from midstride.runtime.records.status_forms import Middleware
        from midstride.runtime.running_system import RunningSystem
        from midstride.runtime.view.watched_system import WatchedSystem
        from midstride.runtime.watch.silence import SilenceMonitor

        self.specification = decode_specification(document(nodes))
        self.events, clock = EventLog(), SystemClock()
        client = ComponentClient(cast(Any, None), clock, "token")
        none = cast(Any, SimpleNamespace(status=lambda _: None, unwritten=None, damaged=None))
        session = SimpleNamespace(
            system=RunningSystem(self.specification, initial(self.specification), client.life),
            client=client,
            launcher=none,
            events=self.events,
            store=none,
            commands=CommandQueue(clock, self.events),
            monitor=SilenceMonitor(client.life, clock, self.events),
            clock=clock,
            backend=SimpleNamespace(
                name="none",
                clock=clock,
                middleware=lambda: Middleware(name="none"),
                spares=lambda: 0,
                unwritten=lambda: None,
            ),
            journal=none,
        )
        self.watched = WatchedSystem(cast(Any, session), none, none, 0)
        self._report = UpReport

    async def up(self) -> Any:
        return self._report("done", [])

    def log(self, since: int) -> Any:
        return self.events.since(since)

    async def history(self, latest: int) -> Any:
        from midstride.runtime.records.change_history import History

        return History([], [], None)

    async def down(self) -> None:
        pass

    async def close(self) -> None:
        pass


def serving(nodes: int, changing: int, rate: float, modes: bool, view: bool) -> None:
    """The serving process: until SIGTERM."""
    from midstride.runtime.workspace import Workspace
    from midstride.server.serve import serve

    async def run() -> None:
        manager = Manager(nodes)
        server = asyncio.ensure_future(serve(cast(Any, manager), Workspace.of("ring"), backend="none"))
        await asyncio.sleep(0.5)
        if not view:
            manager.watched.client.listeners.clear()
            manager.events.listeners.clear()
        reports = asyncio.ensure_future(Reports(manager.watched, changing, rate, modes).run())
        await asyncio.wait({server, reports}, return_when=asyncio.FIRST_COMPLETED)
        reports.cancel()

    asyncio.run(run())


async def lines(socket: Path) -> AsyncIterator[bytes]:
    reader, writer = await asyncio.open_unix_connection(socket, limit=2**24)
    writer.write(b"GET /api/v1/view/stream HTTP/1.1\r\nHost: m\r\n\r\n")
    while line := await reader.readline():
        yield line
    writer.close()


def clients(socket: Path, number: int, seconds: float) -> None:
    """The process of the clients: prints what they have seen as JSON."""
    delays: list[float] = []
    seen = {"bytes": 0, "patches": 0, "views": 0}

    async def follow() -> None:
        kind, begun = b"", time.monotonic()
        async for line in lines(socket):
            seen["bytes"] += len(line)
            if line.startswith(b"event: "):
                kind = line[7:].strip()
                seen["patches"] += kind == b"patch"
                seen["views"] += kind == b"view"
            elif line.startswith(b"data: ") and kind == b"event" and time.monotonic() - begun > 1:
                event = json.loads(line[6:])
                delays.append(time.time() - event["at"])

    async def run() -> None:
        tasks = [asyncio.ensure_future(follow()) for _ in range(number)]
        await asyncio.sleep(seconds)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    asyncio.run(run())
    print(json.dumps({"delays": delays, **seen}))


def spent(pid: int) -> float:
    """The processor time of a process (s)."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def resident(pid: int) -> float:
    """The resident memory of a process (MB)."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


@contextmanager
def served(options: argparse.Namespace, *, modes: bool, view: bool) -> Iterator[tuple[int, Path]]:
    """The serving process while the context is open: its id, and the socket of its manager."""
    with tempfile.TemporaryDirectory(prefix="ms") as folder:
        environment = {**os.environ, "XDG_RUNTIME_DIR": folder}
        shape = [str(options.nodes), str(options.changing), str(options.rate), "modes" if modes else ""]
        command = [sys.executable, __file__, "--serving", *shape, "view" if view else ""]
        server = subprocess.Popen(command, env=environment)
        try:
            socket = Path(folder) / "midstride" / "ring" / "manager.sock"
            while not socket.exists():
                if server.poll() is not None:
                    raise SystemExit("the server has ended")
                time.sleep(0.05)
            time.sleep(WARM_UP)
            yield server.pid, socket
        finally:
            server.kill()  # nothing runs that it would have to leave in order
            server.wait()


def measured(options: argparse.Namespace, number: int | None) -> dict[str, Any]:
    """With so many clients; None: without a view."""
    with served(options, modes=options.modes, view=number is not None) as (server, socket):
        readers = None
        if number:
            words = [sys.executable, __file__, "--clients", str(socket), str(number), str(options.seconds + 2)]
            readers = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
            time.sleep(2)
        begun, before, memory = time.monotonic(), spent(server), [resident(server)]
        while time.monotonic() - begun < options.seconds:
            time.sleep(min(options.seconds / 10, 60))
            memory.append(resident(server))
        share = (spent(server) - before) / (time.monotonic() - begun)
        seen = json.loads(readers.communicate(timeout=60)[0]) if readers is not None else {}
        delays = sorted(seen.pop("delays", []))
    return {
        "clients": number,
        "processor": share,
        "memory": memory,
        "delay": None
        if len(delays) < 2
        else {
            "median": statistics.median(delays),
            "p99": statistics.quantiles(delays, n=100, method="inclusive")[98],
            "longest": delays[-1],
        },
        **seen,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=30.0, help="of each measurement")
    parser.add_argument("--nodes", type=int, default=500)
    parser.add_argument("--changing", type=int, default=150, help="of the nodes")
    parser.add_argument("--rate", type=float, default=10.0, help="how often these change (Hz)")
    parser.add_argument("--modes", action="store_true", help="they change their modes as well")
    parser.add_argument("--clients-each", type=int, nargs="+", default=[0, 1, 5])
    parser.add_argument("--out", type=Path, default=HERE / "results" / "dashboard.json")
    options = parser.parse_args()
    guard()
    found = [measured(options, number) for number in [None, *options.clients_each]]
    base = found[0]["processor"]
    print(
        f"{options.nodes} nodes, {PORTS * options.nodes} topics, {options.changing} nodes change at {options.rate:g} Hz"
    )
    print(
        f"{'clients':>10}{'processor':>12}{'of the view':>13}{'memory':>18}{'patches/s':>11}{'MB/s':>7}{'delay ms':>24}"
    )
    for row in found:
        clients_there = row["clients"] or 0
        each = clients_there * (options.seconds + 2)
        delay = row["delay"]
        shown = (
            "" if delay is None else " / ".join(f"{1000 * delay[name]:.0f}" for name in ("median", "p99", "longest"))
        )
        print(
            f"{'no view' if row['clients'] is None else clients_there:>10}{100 * row['processor']:>10.1f} %"
            f"{100 * (row['processor'] - base):>11.1f} %{row['memory'][0]:>8.0f} to {row['memory'][-1]:.0f} MB"
            + (f"{row['patches'] / each:>11.1f}{row['bytes'] / each / 1e6:>7.2f}{shown:>24}" if clients_there else "")
        )
    options.out.parent.mkdir(exist_ok=True)
    options.out.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["--serving", nodes, changing, rate, modes, view]:
            serving(int(nodes), int(changing), float(rate), bool(modes), bool(view))
        case ["--clients", socket, number, seconds]:
            clients(Path(socket), int(number), float(seconds))
        case _:
            main()
