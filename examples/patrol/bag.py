"""A bag of the demonstration on ROS 2: recorded and checked by programs that know nothing of Midstride."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from midstride.errors import MidstrideError
from midstride.runtime.records.reports import Outcome
from midstride.runtime.timeouts import within

FOLDER = Path(__file__).resolve().parent
TOPICS = (
    "/cmd_vel:geometry_msgs/Twist",
    "/obstacles/near:sensor_msgs/LaserScan",
    "/device/wheels:nav_msgs/Odometry",
)
# What the robot is held to (s): two commands may be that far apart, as its base tolerates. Obstacles are stale after
# four missed messages at 10 Hz, as its controller states; it has stopped moving on them within REACTION.
SILENCE, STALE, REACTION = 0.5, 0.5, 0.5
# What writes the commands.
DRIVES = "controller.drive"
# The environment variable that names the folder in which the bag is kept. It must not exist, or be empty.
KEEP = "PATROL_BAG"
ENDING = 20.0  # how long the recorder may take to write the bag to its end (s)


@dataclass
class Bag:
    """Records in ``folder`` from :meth:`open` to :meth:`check`."""

    folder: Path
    events: list[dict[str, Any]] = field(default_factory=list)
    silent: list[dict[str, Any]] = field(default_factory=list)
    _recorder: asyncio.subprocess.Process | None = None

    async def open(self) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        self._recorder = await asyncio.create_subprocess_exec(
            sys.executable, str(FOLDER / "recorder.py"), str(self.folder / "bag"), *TOPICS, cwd=FOLDER
        )

    def event(self, name: str, begun: float, came_to: Outcome | str) -> None:
        """``name`` was from ``begun`` (unix s) to now. Where its plan said that nothing drives, nothing is missed."""
        now = time.time()
        self.events.append({"name": name, "from": begun, "to": now})
        if isinstance(came_to, Outcome) and came_to.plan is not None:
            for fall in came_to.plan.degradations:
                if fall.functionality == DRIVES and fall.unserved is not None:
                    self.silent.append({"from": begun, "to": now, "why": fall.because})

    async def end(self) -> None:
        """End the recorder, if it runs."""
        recorder, self._recorder = self._recorder, None
        if recorder is None or recorder.returncode is not None:
            return
        recorder.send_signal(signal.SIGINT)
        try:
            async with within(ENDING):
                await recorder.wait()
        except asyncio.TimeoutError:
            recorder.kill()
            await recorder.wait()

    async def check(self) -> tuple[dict[str, dict[str, Any]], dict[str, Any]]:
        """What ``check_bag.py`` found during each event, and in the whole bag. Raises MidstrideError where it fails."""
        await self.end()
        announced = self.folder / "announced.json"
        limits = {"topic": "/cmd_vel", "silence": SILENCE, "stale": STALE, "reaction": REACTION}
        announced.write_text(json.dumps({**limits, "silent": self.silent, "events": self.events}, indent=1))
        said, errors = await _run("check_bag.py", str(self.folder / "bag"), str(announced))
        lines = [json.loads(line) for line in said.splitlines()]
        if len(lines) != len(self.events) + 1:
            raise MidstrideError(f"the bag could not be checked: {errors.strip()}")
        return {line["name"]: line for line in lines[:-1]}, lines[-1]


def kept() -> Path | None:
    """Where the user wants the bag to be kept. Raises MidstrideError where something is there already."""
    if not (name := os.environ.get(KEEP)):
        return None
    if (folder := Path(name)).exists() and any(folder.iterdir()):
        raise MidstrideError(f"{KEEP} is a folder with something in it: {folder}")
    return folder


async def _run(program: str, *arguments: str) -> tuple[str, str]:
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(
        sys.executable, str(FOLDER / program), *arguments, stdout=pipe, stderr=pipe
    )
    said, errors = await process.communicate()
    return said.decode(), errors.decode()


def verdict(whole: dict[str, Any]) -> str:
    """What is said below the table."""
    return (
        f"From the bag: {whole['commands']} commands of {whole['writers']} writer(s); {whole['lost']} missed, "
        f"{whole['interleaved']} interleaved, {whole['silence']:.2f} s the longest silence beyond {SILENCE:g} s; "
        f"it moved on what it saw more than {STALE:g} s ago for {whole['moved_blind']:.2f} s at most "
        f"(stated: {REACTION:g} s). "
        f"{'All of this holds.' if whole['holds'] else 'This does not hold.'}"
    )
