"""What replacing a publisher costs its subscribers, at 50 Hz on real ROS 1, by four ways in one run.

As benchmarks/swap.py: Midstride's hand-over, its `paper` strategy, a process killed and another started, and a
window in which nothing is swapped. Messages have a header, so that the bare recorder, which is rospy and
nothing else, has numbers (by which rospy counts them), times and publishers from ROS 1 itself.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import tempfile
import time

from _guard import guard
from swap import HERE, Platform, compare, options, ways


def main() -> None:
    asked = options(__doc__, ["handover", "paper", "kill", "none"], "swap_ros1.json").parse_args()
    guard()
    from midstride.backends.ros1 import launching

    python = launching.interpreter()
    if python is None:
        print("ROS 1 cannot be had here (tools/ros1 says why): this benchmark is left out")
        return
    with socket.create_server(("127.0.0.1", 0)) as door:
        port = door.getsockname()[1]
    uri = os.environ["ROS_MASTER_URI"] = f"http://127.0.0.1:{port}"
    platform = Platform(
        "ros1", python, HERE / "_swap_nodes_ros1.py", "sensor_msgs/msg/Range", launching.environment(os.environ, uri)
    )
    with tempfile.TemporaryDirectory() as folder:
        # The stock master, as `roscore` runs it, for all ways alike.
        master = subprocess.Popen(
            [python, "-c", "import sys, rosmaster; rosmaster.rosmaster_main(sys.argv)", "--core", "-p", str(port)],
            env={**platform.env, "ROS_LOG_DIR": folder},
            stdout=subprocess.DEVNULL,
            start_new_session=True,
        )
        try:
            _answers(port)
            compare(platform, asked.ways, ways(platform, asked.swaps), asked.out)
        finally:
            master.kill()
            master.wait()


def _answers(port: int) -> None:
    deadline = time.monotonic() + 20
    while True:
        try:
            socket.create_connection(("127.0.0.1", port), timeout=1).close()
            return
        except OSError:
            if time.monotonic() > deadline:
                sys.exit("the ROS master did not start")
            time.sleep(0.05)


if __name__ == "__main__":
    main()
