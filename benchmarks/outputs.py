"""How long the replacement of a node takes with one output and with thirty, on real ROS 2, without the API and with it.

Each output is at 9 Hz, so its probation takes 1.1 s; the outputs are on probation at the same time. Beside the time of
the hand-over is that of the plan. `--outputs 1 5 10 20 30` for more rows.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import statistics
import sys
import tempfile
from pathlib import Path

from _guard import guard

from midstride import backends
from midstride.lang.load import load
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.workspace import Workspace

RESULTS = Path(__file__).parent / "results" / "outputs.json"
RATE = 9
# Of the hand-over of many outputs in that of one.
LIMIT = 1.5
PLAIN = """
import sys
import rclpy
from std_msgs.msg import String

rclpy.init()
node = rclpy.create_node("many")
publishers = [node.create_publisher(String, f"p{number}", 10) for number in range(int(sys.argv[1]))]
node.create_timer(1 / int(sys.argv[2]), lambda: [each.publish(String(data="x")) for each in publishers])
rclpy.spin(node)
"""
OURS = """
import sys
from midstride import Component
from std_msgs.msg import String

comp = Component("Ours")
outputs = [comp.create_output(f"p{number}", String) for number in range(int(sys.argv[1]))]
work = comp.create_functionality("work", outputs=outputs)
work.set_normal_mode(
    lambda: [each.write(String(data="x")) for each in outputs], rate=int(sys.argv[2]), outputs=outputs
)
work.set_degraded_mode(lambda: None)
comp.start()
"""
WAYS = {"gate preload": ("plain.py", " gate preload"), "with the API": ("ours.py", "")}


def system(folder: Path, outputs: int, way: str) -> Path:
    """A node with so many outputs, and the component by which it is replaced, in a file."""
    program, gate = WAYS[way]
    (folder / "plain.py").write_text(PLAIN)
    (folder / "ours.py").write_text(OURS)
    ports = [f"p{number}" for number in range(outputs)]
    contract = f"std_msgs/msg/String @ {RATE} Hz"
    text = "system outputs\n" + "".join(f"topic /{port} : {contract}\n" for port in ports)
    for name in ("Old", "New"):
        text += f'component {name} {{\n  run "python3 {program} {outputs} {RATE}"{gate}\n'
        text += "".join(f"  output {port}\n" for port in ports)
        text += f"  functionality work {{\n    produces {', '.join(ports)}\n    mode normal {{\n"
        text += "".join(f"      guarantee {port} : {contract}\n" for port in ports)
        text += "    }\n    mode degraded { }\n  }\n}\n"
    path = folder / "outputs.stride"
    path.write_text(f"{text}node many : Old {{ {', '.join(f'{port} -> /{port}' for port in ports)} }}\n")
    return path


async def measure(outputs: int, way: str, runs: int) -> tuple[list[float], list[float]]:
    """How long the hand-overs took, and how long the plans said that they take (s)."""
    took: list[float] = []
    planned: list[float] = []
    with tempfile.TemporaryDirectory(prefix="ms") as name:
        folder = Path(name)
        specification = load(system(folder, outputs, way)).require()
        (folder / "system").mkdir(mode=0o700)
        workspace = Workspace(folder / "system")
        manager = Manager(specification, backends.make("ros2", workspace), workspace, folder)
        await manager.up()
        try:
            for number in range(runs):
                outcome = await manager.change(PlanRequest(replace=(("many", ("New", "Old")[number % 2]),)))
                if outcome.outcome != "done" or outcome.plan is None:
                    raise SystemExit(f"the replacement was {outcome.outcome}: {outcome.because}")
                for step in outcome.steps:
                    if outcome.plan.steps[step.step - 1].action == "handover":
                        took.append(step.seconds)
                        planned.append(outcome.plan.steps[step.step - 1].seconds)
        finally:
            await manager.down()
            await manager.close()
    return took, planned


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--outputs", type=int, nargs="+", default=[1, 30])
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--ways", nargs="+", choices=WAYS, default=list(WAYS))
    options = parser.parse_args()
    guard()
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    rows, slow = [], False
    print(f"{'':14}{'outputs':>8}{'hand-over, s':>14}{'longest, s':>12}{'the plan says, s':>18}")
    for way in options.ways:
        first = 0.0
        for outputs in options.outputs:
            took, planned = asyncio.run(measure(outputs, way, options.runs))
            found = statistics.median(took)
            first = first or found
            slow |= found > LIMIT * first
            rows.append({"way": way, "outputs": outputs, "seconds": took, "planned": planned})
            print(f"{way:14}{outputs:>8}{found:>14.2f}{max(took):>12.2f}{planned[-1]:>18.2f}", flush=True)
    RESULTS.parent.mkdir(exist_ok=True)
    RESULTS.write_text(json.dumps(rows, indent=1) + "\n")
    print(f"many outputs take {'more' if slow else 'no more'} than {LIMIT} times as long as one")
    return int(slow)


if __name__ == "__main__":
    sys.exit(main())
