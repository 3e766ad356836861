"""A link between two network namespaces that delays frames of Ethernet, and loses some.

It is a process that has a TAP device in each of the namespaces, and passes on what comes out of one to the other. Most
kernels have TUN, and not all have netem. As with netem, each frame has a delay of its own, so that frames overtake one
another. Once terminated, it prints a :class:`Passed` in a line of JSON.
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import heapq
import json
import os
import random
import select
import signal
import struct
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

TUNSETIFF, IFF_TAP, IFF_NO_PI = 0x400454CA, 0x0002, 0x1000
CLONE_NEWNET = 0x40000000
LONGEST_FRAME = 65536


@dataclass(frozen=True)
class Slow:
    """Each frame is late by ``delay`` ± ``jitter`` (s), evenly distributed; ``loss``: the share that is lost."""

    delay: float
    jitter: float
    loss: float
    seed: int = 1

    def __str__(self) -> str:
        return f"{self.delay * 1000:g} ms ± {self.jitter * 1000:g} ms, {self.loss:.1%} lost"


@dataclass
class Passed:
    """Frames of both ways: how many were passed on, and ``lost``; ``late``: how much later than drawn, at most (s)."""

    frames: int = 0
    lost: int = 0
    late: float = 0.0


def start(namespaces: list[str], device: str, slow: Slow) -> subprocess.Popen[str]:
    """Start the process; the devices are there when this returns."""
    words = [sys.executable, __file__, *namespaces, device, json.dumps(asdict(slow))]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    return process


def stop(process: subprocess.Popen[str]) -> Passed:
    """End the process, and with it the devices."""
    process.terminate()
    said, _ = process.communicate()
    return Passed(**json.loads(said))


def _open_devices(namespaces: list[str], name: str) -> list[int]:
    libc = ctypes.CDLL(None, use_errno=True)
    found = []
    for namespace in namespaces:
        with Path("/run/netns", namespace).open() as where:
            if libc.setns(where.fileno(), CLONE_NEWNET) != 0:
                raise OSError(ctypes.get_errno(), "setns", namespace)
        device = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
        fcntl.ioctl(device, TUNSETIFF, struct.pack("16sH", name.encode(), IFF_TAP | IFF_NO_PI))
        found.append(device)
    return found


def _read_all(device: int) -> list[bytes]:
    found = []
    try:
        while True:
            found.append(os.read(device, LONGEST_FRAME))
    except OSError:  # no more, or the interface is down
        return found


def _pass_on(devices: list[int], slow: Slow, passed: Passed) -> None:
    """Until SIGTERM. The same seed and the same frames in the same order have the same delays and losses."""
    draw = random.Random(slow.seed)
    other = dict(zip(devices, reversed(devices), strict=True))
    waiting: list[tuple[float, int, int, bytes]] = []
    came = 0
    while True:
        now = time.monotonic()
        while waiting and waiting[0][0] <= now:
            due, _, device, frame = heapq.heappop(waiting)
            passed.frames += 1
            passed.late = max(passed.late, now - due)
            try:
                os.write(device, frame)
            except OSError:  # its interface is down
                passed.lost += 1
        ready, _, _ = select.select(devices, [], [], waiting[0][0] - now if waiting else None)
        now = time.monotonic()
        for device in ready:
            for frame in _read_all(device):
                came += 1
                if draw.random() < slow.loss:
                    passed.lost += 1
                else:
                    due = now + draw.uniform(slow.delay - slow.jitter, slow.delay + slow.jitter)
                    heapq.heappush(waiting, (due, came, other[device], frame))


def main(words: list[str]) -> None:
    *namespaces, device, settings = words
    given: dict[str, Any] = json.loads(settings)
    with contextlib.suppress(OSError):  # a cable does not wait for a processor that other processes use
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    devices, passed = _open_devices(namespaces, device), Passed()
    print("ready", flush=True)
    try:
        _pass_on(devices, Slow(**given), passed)
    except KeyboardInterrupt:
        print(json.dumps(asdict(passed)))


if __name__ == "__main__":
    main(sys.argv[1:])
