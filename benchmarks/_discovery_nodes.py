"""The processes of benchmarks/discovery_deadlock.py, bare rclpy with the endpoints of components and managers.

``watched`` stays: a subscriber. ``manager`` stays as well. ``peers`` forks publishers that come and go, for so many
seconds, and prints how many there were. ``probe`` prints with how many subscribers a new publisher was matched.

With ``services`` (the control plane before Unix sockets), a peer says on a topic that it is there, and the manager
calls one of its services through a client that lives as long as the peer. Without, the manager has no endpoint at all.
"""

from __future__ import annotations

import os
import random
import signal
import sys
import threading
import time
from typing import Any

import rclpy
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.executors import SingleThreadedExecutor
from std_msgs.msg import String

TOPIC, PRESENT = "/discovery", "/discovery_present"
# How many peers are there at once, and for how long (s) each.
PEERS, LIFE = 3, (0.3, 0.8)
PROBE = 8.0


def spin(node: Any) -> None:
    """With an executor for itself: two threads cannot share one."""
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    executor.spin()


def nodes(name: str) -> tuple[Any, Any]:
    """As a component: a node for the data, and a hidden one with the parameter services."""
    rclpy.init(signal_handler_options=rclpy.SignalHandlerOptions.NO)
    control = rclpy.create_node(f"_{name}_control", enable_rosout=False)
    return rclpy.create_node(name, start_parameter_services=False), control


def watched(name: str) -> None:
    data, control = nodes(name)
    data.create_subscription(String, TOPIC, lambda message: None, 10)
    threading.Thread(target=spin, args=(control,), daemon=True).start()
    spin(data)


def manager(services: bool) -> None:
    rclpy.init(signal_handler_options=rclpy.SignalHandlerOptions.NO)
    node = rclpy.create_node("_manager", start_parameter_services=False, enable_rosout=False)
    clients: dict[str, tuple[float, Any]] = {}

    def present(message: String) -> None:
        now = time.monotonic()
        client = node.create_client(SetParametersAtomically, f"{message.data}/set_parameters_atomically")
        clients[message.data] = now, client
        for name, (since, old) in list(clients.items()):
            if now - since > LIFE[1]:
                del clients[name]
                node.destroy_client(old)

    def call() -> None:
        for _, client in clients.values():
            if client.service_is_ready():
                client.call_async(SetParametersAtomically.Request())

    if services:
        node.create_subscription(String, PRESENT, present, 100)
        node.create_timer(0.05, call)
    spin(node)


def peer(name: str, services: bool) -> None:
    data, control = nodes(name)
    publisher = data.create_publisher(String, TOPIC, 10)
    if services:
        present = control.create_publisher(String, PRESENT, 10)
        present.publish(String(data=control.get_fully_qualified_name()))
    data.create_timer(0.02, lambda: publisher.publish(String(data=name)))
    threading.Thread(target=spin, args=(control,), daemon=True).start()

    def leave(*_: object) -> None:
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, leave)
    try:
        spin(data)
    except KeyboardInterrupt:
        rclpy.shutdown()
        os._exit(0)


def peers(services: bool, seconds: float) -> None:
    """Half of them end in order, half are killed."""
    chance = random.Random(1)
    alive: dict[int, float] = {}
    count, until = 0, time.monotonic() + seconds
    while time.monotonic() < until or alive:
        now = time.monotonic()
        while len(alive) < PEERS and now < until:
            count += 1
            child = os.fork()
            if child == 0:
                peer(f"peer_{os.getpid()}_{count}", services)
            alive[child] = now + chance.uniform(*LIFE)
        for child, end in list(alive.items()):
            if now > end:
                os.kill(child, chance.choice((signal.SIGTERM, signal.SIGKILL)))
                alive[child] = now + 2.0
            if os.waitpid(child, os.WNOHANG)[0]:
                del alive[child]
        time.sleep(0.01)
    print(count)


def probe(expected: int) -> None:
    rclpy.init()
    node = rclpy.create_node(f"probe_{os.getpid()}")
    publisher = node.create_publisher(String, TOPIC, 10)
    until = time.monotonic() + PROBE
    while publisher.get_subscription_count() < expected and time.monotonic() < until:
        time.sleep(0.05)
    print(publisher.get_subscription_count())


if __name__ == "__main__":
    words = sys.argv[1:]
    if words[0] == "watched":
        watched(words[1])
    elif words[0] == "manager":
        manager(words[1] == "services")
    elif words[0] == "peers":
        peers(words[1] == "services", float(words[2]))
    else:
        probe(int(words[1]))
