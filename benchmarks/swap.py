"""The price of replacing a publisher for its subscribers, at 50 Hz on real ROS 2, by several ways in one run.

Midstride's hand-over, its `paper` strategy, a lifecycle node deactivated and another activated, a
process killed and another started, and a window in which nothing is swapped (what this machine
does by itself). Of components in a container: Midstride's hand-over of one of them, one unloaded and loaded again, and
two with a lifecycle. If `--dora` names a folder with its command and its Python (`pip install dora-rs dora-rs-cli` in a
virtual environment: its `bin`), Dora's `node replace`, with its own transport, where a node of Dora records. All others
are recorded by a bare recorder outside Midstride; the figures are worked out
from the rows in the same way for each. Functionality-seconds lost are those of the subscriber that relies on
the topic: as Midstride reports them where its system has that subscriber, else the silence beyond one period.
swap_ros1.py does the same on ROS 1.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from _composed_swaps import Components, by_lifecycle_in_container, by_loading
from _dora_swaps import replaced_by_dora
from _guard import guard
from _judging import judged
from immutables import Map

from midstride.codec.form import encode
from midstride.model.component import ComponentSpec, Connector, FunctionalitySpec, InputAlternatives, Mode
from midstride.model.contract import Predicate
from midstride.model.specification import Node, Specification
from midstride.plan.request import PlanRequest
from midstride.runtime.records.measure import Observation, SwapReport
from midstride.wire.replies import Receipt

HERE = Path(__file__).resolve().parent
sys.path.append(str(HERE.parent))  # for the stand-in of the tests
PERIOD = 0.02
TAIL = 20 * PERIOD


@dataclass(frozen=True)
class Platform:
    """Where the programs run: by which interpreter, in which environment, and what they send each other."""

    backend: str
    python: str
    nodes: Path
    type: str
    env: dict[str, str]


@dataclass
class Way:
    """One way of swapping: when each swap began and ended (steady ns), and what it reported itself."""

    name: str
    windows: list[tuple[int, int]] = field(default_factory=list)
    lost_seconds: list[float] = field(default_factory=list)
    own: list[dict[str, Any]] = field(default_factory=list)
    rolled_back: list[str] = field(default_factory=list)
    rows: list[Receipt] = field(default_factory=list)

    def reports(self) -> list[SwapReport]:
        seen = []
        for begun, ended in self.windows:
            near = [row for row in self.rows if begun - 1e9 < row.received <= ended]
            seen.append(judged(Observation("/swap", "recorder", near, begun, ended, PERIOD, PERIOD)))
        return seen


def specification(platform: Platform) -> Specification:
    text = platform.type
    run = f"python3 {platform.nodes}"
    talk = FunctionalitySpec(
        "talk", (Mode("normal", (), Map({"out": Predicate(text, 50)})), Mode("degraded")), (), ("out",)
    )
    listen = FunctionalitySpec("listen", (Mode("normal", (InputAlternatives(("in",)),)), Mode("degraded")), ("in",))
    sources = [
        ComponentSpec.of(name, outputs=("out",), functionalities=(talk,), run=f"{run} source", startup_seconds=1.0)
        for name in ("Source", "OtherSource")
    ]
    # Two names of one program: a swap there and back is a swap all the same.
    sources[1] = ComponentSpec.of(
        "OtherSource", outputs=("out",), functionalities=(talk,), run=f"{run} source other", startup_seconds=1.0
    )
    sink = ComponentSpec.of(
        "Sink", inputs={"in": Predicate(text, 50)}, functionalities=(listen,), run=f"{run} sink", startup_seconds=1.0
    )
    return Specification(
        "swap_benchmark",
        connectors=Map({"/swap": Connector("/swap", Predicate(text, 50))}),
        components=Map({component.name: component for component in (*sources, sink)}),
        nodes=Map(
            {
                "source": Node("source", "Source", Map({"out": ("/swap",)})),
                "sink": Node("sink", "Sink", Map({"in": ("/swap",)})),
            }
        ),
    )


@contextmanager
def program(platform: Platform, *arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    command = [platform.python, str(platform.nodes), *arguments]
    process = subprocess.Popen(command, env=platform.env, start_new_session=True)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


@contextmanager
def recorded(way: Way, platform: Platform) -> Iterator[None]:
    """The bare recorder runs inside; afterwards the way has its rows."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rows.json"
        with program(platform, "recorder", str(path), "10", "word") as process:
            time.sleep(1.0)
            yield
            process.send_signal(signal.SIGTERM)
            process.wait(timeout=10)
        way.rows = [Receipt(*row) for row in json.loads(path.read_text())]


def timed(way: Way, swap: Callable[[], None]) -> None:
    time.sleep(TAIL)
    begun = time.monotonic_ns()
    swap()
    time.sleep(TAIL)
    way.windows.append((begun, time.monotonic_ns()))


async def midstride(
    way: Way, platform: Platform, strategy: str, swaps: int, system: Specification | None = None
) -> None:
    """``system``: the one whose `source` is replaced; without, that of the platform."""
    from midstride import backends
    from midstride.runtime.manager import Manager
    from midstride.runtime.workspace import Workspace

    with tempfile.TemporaryDirectory() as folder:
        manager = Manager(
            specification(platform) if system is None else system,
            backends.make(platform.backend, Workspace(Path(folder))),
            Workspace(Path(folder)),
            HERE,
        )
        try:
            await manager.up()
            component, other = "OtherSource", "Source"
            while len(way.windows) < swaps:
                await asyncio.sleep(TAIL)
                begun = time.monotonic_ns()
                outcome = await manager.change(PlanRequest(replace=(("source", component),), strategy=strategy))
                way.windows.append((begun, time.monotonic_ns()))
                way.own.extend(map(encode, outcome.swaps))
                if system is None:  # else nothing in it relies on the topic
                    way.lost_seconds.append(sum(outcome.below_baseline_seconds.values()))
                if outcome.outcome == "done":
                    component, other = other, component
                elif outcome.outcome == "rolled_back":  # the subscriber is none the wiser: its window counts as well
                    way.rolled_back.append(str(outcome.because))
                else:
                    raise SystemExit(f"{way.name}: swap {len(way.windows)}: {outcome.because}")
        finally:
            await manager.down()
            await manager.close()


def by_lifecycle(way: Way, platform: Platform, swaps: int) -> None:
    import rclpy
    from lifecycle_msgs.msg import Transition
    from lifecycle_msgs.srv import ChangeState

    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node("changer", context=context)
    executor = rclpy.executors.SingleThreadedExecutor(context=context)
    executor.add_node(node)
    names = ("first", "second")
    clients = {name: node.create_client(ChangeState, f"/{name}/change_state") for name in names}

    def change(name: str, transition: int) -> None:
        request = ChangeState.Request(transition=Transition(id=transition))
        future = clients[name].call_async(request)
        executor.spin_until_future_complete(future, timeout_sec=5)
        if not (future.done() and future.result().success):
            raise SystemExit(f"lifecycle: {name} did not change")

    with program(platform, "lifecycle", "first"), program(platform, "lifecycle", "second"):
        for name in names:
            clients[name].wait_for_service(timeout_sec=10)
            time.sleep(0.5)
            change(name, Transition.TRANSITION_CONFIGURE)
        change("first", Transition.TRANSITION_ACTIVATE)
        time.sleep(1)
        for index in range(swaps):
            old, new = names[index % 2], names[1 - index % 2]

            def swap(old: str = old, new: str = new) -> None:
                change(old, Transition.TRANSITION_DEACTIVATE)
                change(new, Transition.TRANSITION_ACTIVATE)

            timed(way, swap)
    executor.shutdown()
    node.destroy_node()
    rclpy.shutdown(context=context)


def by_killing(way: Way, platform: Platform, swaps: int) -> None:
    running: list[subprocess.Popen[bytes]] = []

    def start() -> None:
        command = [platform.python, str(platform.nodes), "bare", f"bare_{time.monotonic_ns()}"]
        running.append(subprocess.Popen(command, env=platform.env, start_new_session=True))

    try:
        start()
        time.sleep(2)
        for _ in range(swaps):

            def swap() -> None:
                running[-1].kill()
                running[-1].wait()
                start()
                time.sleep(1.5)  # until it certainly writes: the window must hold its first messages

            timed(way, swap)
    finally:
        for process in running:
            process.kill()
            process.wait()


def by_doing_nothing(way: Way, platform: Platform, swaps: int) -> None:
    with program(platform, "bare", "steady"):
        time.sleep(2)
        for _ in range(swaps):
            timed(way, lambda: time.sleep(1))


def summary(way: Way) -> dict[str, Any]:
    seen = [entry for entry in way.reports() if entry.gap_periods is not None]
    gaps = sorted(entry.gap_periods for entry in seen if entry.gap_periods is not None)
    if not way.lost_seconds:
        way.lost_seconds = [max(0.0, (entry.gap or 0.0) - PERIOD) for entry in seen]

    def total(figure: str) -> int | None:
        values = [getattr(entry, figure) for entry in seen]
        return None if any(value is None for value in values) else sum(values)

    return {
        "way": way.name,
        "swaps": len(seen),
        "gap_median": statistics.median(gaps),
        "gap_p99": gaps[min(len(gaps) - 1, len(gaps) * 99 // 100)],
        "gap_max": gaps[-1],
        "missed": total("missed"),
        "lost": total("lost"),
        "duplicates": total("duplicates"),
        "rolled_back": way.rolled_back,
        "functionality_seconds_median": statistics.median(way.lost_seconds),
        "reported": way.own,
    }


def ways(platform: Platform, swaps: int) -> dict[str, Callable[[Way], None]]:
    """What can be done on any platform."""
    return {
        "handover": lambda way: asyncio.run(midstride(way, platform, "minimal", swaps)),
        "paper": lambda way: asyncio.run(midstride(way, platform, "paper", swaps)),
        "kill": lambda way: by_killing(way, platform, swaps),
        "none": lambda way: by_doing_nothing(way, platform, swaps),
    }


def by_dora(way: Way, programs: Path, swaps: int) -> None:
    way.rows = [Receipt(*row) for row in replaced_by_dora(programs, swaps, partial(timed, way))]


def composed_ways(platform: Platform, swaps: int, components: Components) -> dict[str, Callable[[Way], None]]:
    """The ways to swap a component in a container."""
    from midstride.lang.load import load_text

    system = load_text(components.specification()).require()
    return {
        "composed": lambda way: asyncio.run(midstride(way, platform, "minimal", swaps, system)),
        "load": lambda way: by_loading(components, swaps, partial(timed, way)),
        "composed_lifecycle": lambda way: by_lifecycle_in_container(components, swaps, partial(timed, way)),
    }


def compare(platform: Platform, chosen: list[str], runs: dict[str, Callable[[Way], None]], out: Path) -> None:
    """Run each way, print a line of the table for it, and write them all to ``out``."""
    columns = ("way", "swaps", "gap_median", "gap_p99", "gap_max", "missed", "lost", "duplicates")
    print("  ".join(f"{column:>18}" for column in columns) + "  functionality-seconds (median)")
    results = []
    for name in chosen:
        way = Way(name)
        with nullcontext() if name == "dora" else recorded(way, platform):
            runs[name](way)
        row = summary(way)
        results.append(row)
        shown = [row[column] for column in columns]
        cells = [f"{cell:.3f}" if isinstance(cell, float) else str(cell) for cell in shown]
        print("  ".join(f"{cell:>18}" for cell in cells) + f"  {row['functionality_seconds_median']:.3f}", flush=True)
        for because in row["rolled_back"]:
            print(f"            one was taken back: {because}", flush=True)
    out.parent.mkdir(exist_ok=True)
    out.write_text(json.dumps({"period": PERIOD, "load": os.getloadavg(), "results": results}, indent=1))


def options(description: str | None, chosen: list[str], out: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--swaps", type=int, default=200)
    parser.add_argument("--ways", nargs="*", default=chosen)
    parser.add_argument("--out", type=Path, default=HERE / "results" / out)
    return parser


COMPOSED = ["composed", "load", "composed_lifecycle"]


def class_of(words: str) -> tuple[str, str]:
    """Package and class of a component, as `PACKAGE:CLASS`."""
    package, _, plugin = words.partition(":")
    return package, plugin


def main() -> None:
    parser = options(__doc__, ["handover", "paper", "lifecycle", "kill", "none", *COMPOSED], "swap.json")
    parser.add_argument("--dora", type=Path, help="the folder with Dora's command and its Python")
    parser.add_argument("--components", type=Path, help="the component_container of an installed rclcpp_components")
    parser.add_argument(
        "--talker", type=class_of, help="with --components: PACKAGE:CLASS that publishes a String on chatter"
    )
    parser.add_argument("--managed", type=class_of, help="with --components: the same, with a lifecycle")
    asked = parser.parse_args()
    guard()
    from _tuned import tuned_environment

    os.environ.setdefault("ROS_DOMAIN_ID", "86")
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.update(tuned_environment(dict(os.environ)))
    chosen = [*asked.ways, *(["dora"] if asked.dora and "dora" not in asked.ways else [])]
    with tempfile.TemporaryDirectory() as folder:
        components = Components(asked.talker, asked.managed, asked.components) if asked.components else Components()
        if not asked.components and {*chosen} & {*COMPOSED}:
            components = components.prepared(Path(folder))
        platform = Platform("ros2", sys.executable, HERE / "_swap_nodes.py", "std_msgs/msg/String", dict(os.environ))
        runs = {**ways(platform, asked.swaps), **composed_ways(platform, asked.swaps, components)}
        runs["lifecycle"] = lambda way: by_lifecycle(way, platform, asked.swaps)
        runs["dora"] = lambda way: by_dora(way, asked.dora.absolute(), asked.swaps)
        compare(platform, chosen, runs, asked.out)


if __name__ == "__main__":
    main()
