"""The patrol as an animation: ``python3 animate.py FILE.svg``. It is drawn from a run in the simulator, seed and all.

The picture is of that run: where the robot and the people are, in which mode it drives, and how far that mode sees.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import sys
from collections.abc import Awaitable, Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

import hall
from beams import CAMERA_RANGE, LIDAR_RANGE
from lab import Lab, Managed, robot

SEED, PEOPLE = 3, 6
SAMPLE, SECONDS = 0.2, 40.0
SCALE, MARGIN, FOOT = 32, 8, 44  # px: a metre, around the hall, and below it
COLOURS = {"full": "#2a7", "slow": "#d90", "creep": "#c60", "stop": "#c33"}
SEES = {"full": CAMERA_RANGE, "slow": LIDAR_RANGE, "creep": LIDAR_RANGE, "stop": 0.0}


@dataclass(frozen=True)
class Frame:
    """What is seen at one moment."""

    x: float
    y: float
    heading: float
    mode: str
    people: tuple[tuple[float, float], ...]
    words: str


async def _lidar_dies(under: Managed) -> None:
    under.lab.simulator.faults.kill(under.instance("lidar"))
    await asyncio.sleep(0.01)
    await under.restore("lidar", hangs=False)


# When what happens (s), what is said from then on, and how it is done.
EVENTS: tuple[tuple[float, str, Callable[[Managed], Awaitable[object]]], ...] = (
    (4.0, "the lidar driver is replaced", lambda under: under.change(("lidar", "SmoothLidar"))),
    (13.0, "the detector moves to another", lambda under: under.change(("camera_detector", "LargeDetector"))),
    (28.0, "the lidar driver dies, and is restored", _lidar_dies),
)


def record() -> list[Frame]:
    """A run in virtual time: the same frames each time."""
    lab = Lab(robot(), SEED, PEOPLE)
    frames: list[Frame] = []

    async def main() -> None:
        under = Managed(lab, Path("simulated"), "minimal")
        await under.up()
        await lab.open_hall()
        drive = lab.specification.components["Controller"].functionalities["drive"]
        left, words, acting = list(EVENTS), "", list[asyncio.Future[object]]()
        for tick in range(round(SECONDS / SAMPLE)):
            if left and tick * SAMPLE >= left[0][0]:
                _, words, act = left.pop(0)
                acting.append(asyncio.ensure_future(act(under)))
            index = under.level("controller", drive)
            state = lab.state
            people = tuple((each.x, each.y) for each in state.people)
            mode = "stop" if index is None else drive.modes[index].name
            frames.append(Frame(state.x, state.y, state.heading, mode, people, words))
            await asyncio.sleep(SAMPLE)
        for each in acting:
            each.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await each
        await under.close()

    lab.simulator.run(main())
    return frames


def drawn(frames: Sequence[Frame]) -> str:
    """The animation as SVG."""
    _, _, wide, high = hall.OUTER
    width, height = wide * SCALE + 2 * MARGIN, high * SCALE + 2 * MARGIN + FOOT
    left, bottom, right, top = hall.SHELVES
    parts = [
        '<rect width="100%" height="100%" fill="#fff"/>',
        f'<g transform="translate({MARGIN} {MARGIN + high * SCALE:g}) scale({SCALE} {-SCALE})">',
        f'<path d="M0 0H{wide:g}V{high:g}H0Z" fill="#f6f6f6" stroke="#555" stroke-width=".1"/>',
        f'<path d="M{left:g} {bottom:g}H{right:g}V{top:g}H{left:g}Z" fill="#bbb" stroke="#555" stroke-width=".05"/>',
        f'<g>{_moved((each.x, each.y) for each in frames)}<circle r="0" fill="#2a7" fill-opacity=".1">',
        _stepped("r", [f"{SEES[each.mode]:g}" for each in frames]),
        f'</circle><circle r="{hall.ROBOT_RADIUS}" fill="#2a7">{_stepped("fill", [COLOURS[e.mode] for e in frames])}',
        f'</circle><path d="M0 0H{2 * hall.ROBOT_RADIUS:g}" stroke="#000" stroke-width=".1">',
        f"{_turned(frames)}</path></g>",
    ]
    for number in range(len(frames[0].people)):
        moved = _moved(each.people[number] for each in frames)
        parts.append(f'<circle r="{hall.PERSON_RADIUS}" fill="#549">{moved}</circle>')
    parts.append("</g>")
    for words, mode in dict.fromkeys((each.words, each.mode) for each in frames):
        shown = ["1" if (each.words, each.mode) == (words, mode) else "0" for each in frames]
        parts.append(
            f'<g opacity="0">{_stepped("opacity", shown)}<text x="{MARGIN}" y="{height - 18:g}">{words}</text>'
        )
        end = f'x="{width - MARGIN:g}" y="{height - 18:g}" text-anchor="end"'
        parts.append(f'<text {end} fill="{COLOURS[mode]}">controller: {mode}</text></g>')
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" width="{width:g}"'
    return f'{head} font-family="sans-serif" font-size="18">{"".join(parts)}</svg>\n'


def _moved(places: Iterable[tuple[float, float]]) -> str:
    values = ";".join(f"{x:.2f} {y:.2f}" for x, y in places)
    return f'<animateTransform attributeName="transform" type="translate" values="{values}" {_repeated()}/>'


def _turned(frames: Sequence[Frame]) -> str:
    """Without a jump where the heading passes straight back."""
    angles, before = [], 0.0
    for each in frames:
        before += math.remainder(each.heading - before, 2 * math.pi)
        angles.append(f"{math.degrees(before):.0f}")
    values = ";".join(angles)
    return f'<animateTransform attributeName="transform" type="rotate" values="{values}" {_repeated()}/>'


def _stepped(attribute: str, values: Sequence[str]) -> str:
    """Only where the value changes."""
    kept = [(n, each) for n, each in enumerate(values) if not n or each != values[n - 1]]
    times = ";".join(f"{n / len(values):.4f}" for n, _ in kept)
    found = ";".join(each for _, each in kept)
    timing = f'values="{found}" keyTimes="{times}" calcMode="discrete" {_repeated()}'
    return f'<animate attributeName="{attribute}" {timing}/>'


def _repeated() -> str:
    return f'dur="{SECONDS:g}s" repeatCount="indefinite"'


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(drawn(record()), encoding="utf-8")
