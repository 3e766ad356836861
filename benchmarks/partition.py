"""How a system on two computers behaves while the link between them is cut, on real ROS 2.

Two network namespaces stand for the computers, a veth pair for the link. The manager and the publisher ``a`` are in
one, ``b``, ``c`` and ``d``, each of which relies on the one before, in the other. ROS data crosses the link, and so do
the control connections: a relay forwards each control socket over TCP, as SSH would (docs/how-to/control-sockets.md).
The link is taken down, and later up again; no command is given. Reported are the times from the cut to the entry of
each degraded mode, and from the link's return until all are in their normal modes.

It needs root, and the commands ``ip`` and ``nsenter``.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import os
import shutil
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path
from typing import Any

from _guard import guard
from reflex import CHAIN, NODES, Falls, System, specification

from midstride.runtime.timeouts import within

HERE = Path(__file__).resolve().parent
REMOTE = CHAIN[1:]
NETWORK, CABLE = "10.211.75", "cable"
PORTS = {name: 7701 + number for number, name in enumerate(REMOTE)}
# A connection on which nothing is acknowledged for this long is given up, as by SSH's ServerAliveInterval (s).
GIVEN_UP = 2
# How long the others may take to fall, and all to be restored, before a run counts as failed (s).
PATIENCE = 90.0
# A functionality that fell again within 60 s of its normal mode is restored later; these runs are to be alike (s).
CALM = 61.0


def missing() -> str | None:
    """Why namespaces cannot be made here; None if they can."""
    for command in ("ip", "nsenter"):
        if shutil.which(command) is None:
            return f"there is no command {command}"
    name = f"midstride-{os.getpid()}-try"
    made = subprocess.run(["ip", "netns", "add", name], capture_output=True, text=True)
    if made.returncode == 0:
        link = ["ip", "-n", name, "link", "add", "x", "type", "veth", "peer", "name", "y"]
        made = subprocess.run(link, capture_output=True, text=True)
        subprocess.run(["ip", "netns", "del", name], capture_output=True)
    return made.stderr.strip() or "ip netns add failed" if made.returncode else None


# -- the namespaces ----------------------------------------------------------------------------------------


@contextlib.contextmanager
def two_namespaces() -> Iterator[tuple[str, str]]:
    """Two namespaces with a link named ``cable`` at both ends, as ``10.211.75.1`` and ``.2``."""
    names = (f"midstride-{os.getpid()}-1", f"midstride-{os.getpid()}-2")

    def ip(*words: str) -> None:
        subprocess.run(["ip", *words], check=True)

    try:
        for name in names:
            ip("netns", "add", name)
        ip("-n", names[0], "link", "add", CABLE, "type", "veth", "peer", "name", CABLE, "netns", names[1])
        for number, name in enumerate(names, start=1):
            ip("-n", name, "address", "add", f"{NETWORK}.{number}/24", "dev", CABLE)
            for device in ("lo", CABLE):
                ip("-n", name, "link", "set", device, "up")
        yield names
    finally:
        for name in names:
            subprocess.run(["ip", "netns", "del", name], capture_output=True)


def inside(name: str, *words: object) -> list[str]:
    return ["nsenter", f"--net=/run/netns/{name}", *map(str, words)]


# -- the relays --------------------------------------------------------------------------------------------


async def forward(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with contextlib.suppress(OSError):
        while data := await reader.read(65536):
            writer.write(data)
            await writer.drain()
    writer.close()


Opened = tuple[asyncio.StreamReader, asyncio.StreamWriter]


def relayed(open_other: Callable[[], Awaitable[Opened]]) -> Callable[..., Awaitable[None]]:
    async def accepted(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            async with within(1.0):
                other = await open_other()
        except (OSError, asyncio.TimeoutError):
            writer.close()
            return
        for each in (writer, other[1]):
            bound(each.get_extra_info("socket"))
        await asyncio.gather(forward(reader, other[1]), forward(other[0], writer))

    return accepted


def bound(connection: socket.socket) -> None:
    if connection.family == socket.AF_INET:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for option in (socket.TCP_KEEPIDLE, socket.TCP_KEEPINTVL, socket.TCP_KEEPCNT):
            connection.setsockopt(socket.IPPROTO_TCP, option, 1)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, GIVEN_UP * 1000)


async def relay(folder: Path, near: bool) -> None:
    """Forward the sockets in ``folder``: to the other computer, or from it, where the components listen."""
    await asyncio.gather(*(relay_one(folder / f"{name}.sock", near, PORTS[name]) for name in REMOTE))
    await asyncio.Event().wait()


async def relay_one(path: Path, near: bool, port: int) -> None:
    def far() -> Awaitable[Opened]:
        return asyncio.open_connection(f"{NETWORK}.2", port)

    if not near:
        await asyncio.start_server(relayed(lambda: asyncio.open_unix_connection(path)), f"{NETWORK}.2", port)
        return
    while not await greets(far):  # for the manager, a component runs as soon as its socket is in the folder
        await asyncio.sleep(0.05)
    await asyncio.start_unix_server(relayed(far), path)


async def greets(far: Callable[[], Awaitable[Opened]]) -> bool:
    """Whether a component listens there: it answers any line with its greeting."""
    with contextlib.suppress(OSError, asyncio.TimeoutError):
        async with within(1.0):
            reader, writer = await far()
            writer.write(b"\n")
            found = await reader.read(1)
            writer.close()
            return bool(found)
    return False


# -- the system --------------------------------------------------------------------------------------------


def two_computers(folder: Path, other: str) -> str:
    """The specification of the chain, with all but ``a`` in the namespace ``other``."""
    here = f'run "python3 {NODES} stage {folder}"'
    command = " ".join(inside(other, sys.executable, NODES, "stage", folder))
    there = f'run "env MIDSTRIDE_CONTROL={folder}/far {command}"'
    text = specification(folder)
    assert text.count(here) == 1
    return text.replace(here, there)


def link(state: str) -> None:
    subprocess.run(["ip", "link", "set", CABLE, state], check=True)


async def modes(system: System) -> dict[str, str]:
    status = await system.manager.status()
    return {each.role: each.functionalities[0].mode for each in status.instances if each.reachable}


async def until(holds: Callable[[], Awaitable[bool]], what: str) -> None:
    deadline = time.monotonic() + PATIENCE
    while not await holds():
        if time.monotonic() > deadline:
            raise SystemExit(f"{what}: not within {PATIENCE:g} s")
        await asyncio.sleep(0.05)


async def one_run(system: System, falls: Falls, seconds: float) -> dict[str, Any]:
    async def fallen() -> bool:
        return all(falls.since(name, begun) is not None for name in REMOTE)

    async def restored() -> bool:
        found = await modes(system)
        return len(found) == len(CHAIN) and set(found.values()) == {"normal"}

    before = len(system.manager.log())
    begun = time.monotonic_ns()
    link("down")
    try:
        await until(fallen, "the dependants fall")
        await asyncio.sleep(max(0.0, seconds - (time.monotonic_ns() - begun) / 1e9))
    finally:
        link("up")
    back = time.monotonic()
    await until(restored, "all are restored")
    row: dict[str, Any] = {name: falls.since(name, begun) for name in REMOTE}
    row |= {"cut": seconds, "restored": time.monotonic() - back}
    events = system.manager.log()[before:]
    row["events"] = [(event.at, event.kind, event.words) for event in events]
    return row | {"commands": [event.words for event in events if event.kind == "command"]}


async def measure(folder: Path, other: str, runs: int, cuts: list[float], calm: float) -> list[dict[str, Any]]:
    falls, system, rows = Falls(folder), System(folder, two_computers(folder, other)), []
    await system.up()
    try:
        await system.restored()
        for number in range(runs):
            if number:
                await asyncio.sleep(calm)
            row = await one_run(system, falls, cuts[number % len(cuts)])
            rows.append(row)
            print("".join(f"{name} {row[name]:6.2f}  " for name in (*REMOTE, "cut", "restored")), row["commands"])
            sys.stdout.flush()

        async def valid() -> bool:
            return bool((await system.manager.status()).valid)

        await until(valid, "the system is valid")
        return rows
    except BaseException:
        for event in system.manager.log()[-40:]:
            print(f"{event.at:.2f} {event.kind}: {event.words}", file=sys.stderr)
        raise
    finally:
        await system.manager.down()
        await system.close()


def run(folder: Path, options: argparse.Namespace) -> int:
    """Everything, from the host's namespace; the manager is a process in the first one."""
    near, far = folder / "system" / "components", folder / "far"
    for each in (folder / "system", near, far):
        each.mkdir(mode=0o700)
    me, processes = [sys.executable, __file__, "--folder", folder], []
    environment = {**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
    with two_namespaces() as (one, other):
        try:
            for name, words in ((one, ["--relay", "near"]), (other, ["--relay", "far"])):
                processes.append(subprocess.Popen(inside(name, *me, *words)))
            given = ["--runs", options.runs, "--calm", options.calm, "--out", options.out, "--cut", *options.cut]
            manager = subprocess.Popen(inside(one, *me, "--other", other, *given), env=environment)
            processes.append(manager)
            return manager.wait()
        finally:
            for process in reversed(processes):
                process.send_signal(signal.SIGTERM)
                process.wait()


def show(rows: list[dict[str, Any]]) -> None:
    print(f"\n{'':<12}{'runs':>6}{'least':>9}{'median':>9}{'longest':>9}   (s)")
    for name in (*REMOTE, "restored"):
        found = sorted(row[name] for row in rows)
        print(f"{name:<12}{len(found):>6}{found[0]:>9.2f}{statistics.median(found):>9.2f}{found[-1]:>9.2f}")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=int(os.environ.get("MIDSTRIDE_PARTITION_RUNS", "20")))
    parser.add_argument("--cut", type=float, nargs="+", default=[5.0, 25.0], metavar="SECONDS")
    parser.add_argument("--calm", type=float, default=CALM, metavar="SECONDS")
    parser.add_argument("--out", type=Path, default=HERE / "results" / "partition.json")
    # The parts of this program that run in a namespace:
    parser.add_argument("--folder", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--relay", choices=("near", "far"), help=argparse.SUPPRESS)
    parser.add_argument("--other", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.relay is not None:
        near = options.relay == "near"
        with contextlib.suppress(KeyboardInterrupt):
            asyncio.run(relay(options.folder / "system" / "components" if near else options.folder / "far", near))
        return 0
    if options.other is not None:
        rows = asyncio.run(measure(options.folder, options.other, options.runs, options.cut, options.calm))
        show(rows)
        options.out.parent.mkdir(exist_ok=True)
        options.out.write_text(json.dumps(rows, indent=1))
        return 0
    if (why := missing()) is not None:
        print(f"not measured: no network namespaces can be made here: {why}")
        return 0
    guard()
    with tempfile.TemporaryDirectory() as folder:
        return run(Path(folder), options)


if __name__ == "__main__":
    raise SystemExit(main())
