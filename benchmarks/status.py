"""How soon a node says how it is while its user code sleeps, on real ROS 2: `status` beside a service of bare rclpy.

Both nodes sleep for two of every four seconds, and are asked at moments that keep no step with that. Times are from
the question to the answer; which of the two states a question met is told by the answer.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from _guard import guard
from _status_nodes import PERIOD, SECONDS_ASLEEP

HERE = Path(__file__).resolve().parent
NODES = HERE / "_status_nodes.py"
IDLE, ASLEEP = "idle", "asleep"
# Between two questions (s): they come at every moment of the nodes' period.
PAUSE = 0.0937

# A question: asks, and says what it met. Times: seconds, by what they met.
Question = Callable[[], str]
Times = dict[str, list[float]]


def specification() -> str:
    return f"""
system status_benchmark
contract Text = std_msgs/msg/String @ {1 / PERIOD} Hz
topic /late : Text
component Busy {{
  run "python3 {NODES} component"
  output out
  functionality work {{
    produces out
    mode normal {{ guarantee out : Text }}
    mode degraded {{ }}
  }}
}}
node busy : Busy {{ out -> /late }}
"""


def asked(question: Question, each: int) -> Times:
    """Ask until there are ``each`` times of either state."""
    times: Times = {IDLE: [], ASLEEP: []}
    while min(map(len, times.values())) < each:
        begun = time.monotonic()
        state = question()
        times[state].append(time.monotonic() - begun)
        time.sleep(PAUSE)
    return times


def midstride(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", "midstride", *words], check=True, capture_output=True, text=True)


def of_midstride(each: int, folder: Path) -> dict[str, Times]:
    """By the manager's API, and by the command, the start of its Python included."""
    from midstride.cli.client import Client
    from midstride.runtime.workspace import Workspace

    def state(document: str) -> str:
        (view,) = json.loads(document)["instances"][0]["functionalities"]
        return IDLE if view["busy"] is None else ASLEEP

    file = folder / "status.stride"
    file.write_text(specification())
    midstride("up", str(file), "--detach")
    try:
        client = Client(Workspace.of("status_benchmark").socket)
        by_api = asked(lambda: state(client.text("/view")), each)
        by_command = asked(lambda: state(midstride("status", "--json").stdout), max(2, each // 10))
    finally:
        midstride("down")
    return {"status, by the API": by_api, "status, by the command": by_command}


def of_rclpy(each: int) -> dict[str, Times]:
    """A service of a node with one executor, as most nodes are."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from std_srvs.srv import Trigger

    process = subprocess.Popen([sys.executable, str(NODES), "bare"])
    rclpy.init()
    try:
        node = rclpy.create_node("asking")
        client = node.create_client(Trigger, "/bare/status")
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        if not client.wait_for_service(timeout_sec=20):
            raise SystemExit("the bare node does not come up")

        def question() -> str:
            begun = time.monotonic()
            future = client.call_async(Trigger.Request())
            executor.spin_until_future_complete(future, timeout_sec=20)
            slept = float(future.result().message)
            return ASLEEP if slept <= begun < slept + SECONDS_ASLEEP else IDLE

        return {"a service of bare rclpy": asked(question, max(2, each // 10))}
    finally:
        rclpy.shutdown()
        process.terminate()
        process.wait()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--each", type=int, default=200, help="questions in either state (a tenth of it where slow)")
    parser.add_argument("--out", type=Path, default=HERE / "results" / "status.json")
    options = parser.parse_args()
    guard()
    from _tuned import tuned_environment

    os.environ.setdefault("ROS_DOMAIN_ID", "86")
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.update(tuned_environment(dict(os.environ)))
    with tempfile.TemporaryDirectory() as folder:
        os.environ["XDG_RUNTIME_DIR"] = folder
        found = {**of_midstride(options.each, Path(folder)), **of_rclpy(options.each)}
    print(f"{'ms':<26}{'user code':>10}{'asked':>8}{'median':>10}{'p99':>10}{'longest':>10}")
    result = []
    for what, times in found.items():
        for state, seconds in times.items():
            p99 = statistics.quantiles(seconds, n=100, method="inclusive")[98]
            figures = {"median": statistics.median(seconds), "p99": p99, "longest": max(seconds)}
            shown = "".join(f"{1000 * figure:>10.1f}" for figure in figures.values())
            print(f"{what:<26}{state:>10}{len(seconds):>8}{shown}")
            result.append({"what": what, "user_code": state, "asked": len(seconds), "seconds": figures})
    options.out.parent.mkdir(exist_ok=True)
    options.out.write_text(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
