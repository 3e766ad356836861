"""The hall that the robot patrols: walls, people, and the physics of a differential drive. Pure functions, seeded.

Lengths in m, times in s, angles in rad. ``step`` makes the next state from a state and a command; nothing is drawn at
random after ``start``. The assumptions: people walk at PERSON_SPEED at most, straight on, and do not look where the
robot goes; they never walk into it, but stop at its hull and turn back.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass, replace

import numpy as np

# Two boxes (left, bottom, right, top): the outer walls, and a block of shelves in the middle.
OUTER = (0.0, 0.0, 20.0, 16.0)
SHELVES = (6.0, 6.0, 14.0, 10.0)
# The corners of the patrol, in order, and its length.
ROUTE = ((3.0, 3.0), (17.0, 3.0), (17.0, 13.0), (3.0, 13.0))
LAP = 48.0

ROBOT_RADIUS = 0.3
PERSON_RADIUS = 0.25
PERSON_SPEED = 1.0
TOP_SPEED = 1.5
BRAKING = 1.0  # m/s²; it accelerates as fast as it brakes
TOP_TURN = 1.5  # rad/s
COMMAND_TIMEOUT = 0.5  # the base stops where no command has come for so long, as ros2_control's does
# What lies in this half-angle of the direction of travel is ahead. Contact elsewhere is not by the robot's own motion.
AHEAD = math.radians(60)
# A near miss: a gap below the first (m) to someone ahead, while it drives faster than the second (m/s).
NEAR, NEAR_SPEED = 0.3, 0.3
CRAWL = 0.05  # below this speed contact is no collision
APART = 2.0  # contact so soon after another (s) is the same collision


@dataclass(frozen=True)
class Person:
    """Walks from ``a`` to ``b`` and back. ``waits``: for how long it still stands."""

    a: tuple[float, float]
    b: tuple[float, float]
    x: float
    y: float
    speed: float
    waits: float = 0.0


@dataclass(frozen=True)
class Hall:
    """The state. ``odometer`` is the way driven, with the error of the wheels; ``progress`` the way along the route."""

    time: float
    x: float
    y: float
    heading: float
    speed: float
    turn: float
    people: tuple[Person, ...]
    drift: tuple[float, float]  # what the wheels add, as a share: of the way, and of each turn
    wheels: tuple[float, float, float]  # x, y, heading by the wheels alone
    charge: float = 1.0
    progress: float = 0.0
    bumped: bool = False
    touched: float = -math.inf  # when it last bumped
    near: bool = False
    collisions: int = 0
    near_misses: int = 0


def start(seed: int, people: int = 6) -> Hall:
    """The robot at the first corner, and ``people`` who cross its lanes."""
    drawn = random.Random(seed)
    found: list[Person] = []
    while len(found) < people:
        a = drawn.uniform(0.6, 19.4), drawn.uniform(0.6, 15.4)
        b = drawn.uniform(0.6, 19.4), drawn.uniform(0.6, 15.4)
        share = drawn.random()
        x, y = a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])
        clear = math.dist((x, y), ROUTE[0]) > 3.0 and not _crosses(a, b, SHELVES, PERSON_RADIUS)
        if clear and 3.0 < math.dist(a, b) < 9.0:
            found.append(Person(a, b, x, y, drawn.uniform(0.6, 1.0) * PERSON_SPEED))
    x, y = ROUTE[0]
    drift = drawn.uniform(-0.01, 0.01), drawn.uniform(-0.01, 0.01)
    return Hall(0.0, x, y, 0.0, 0.0, 0.0, tuple(found), drift, (x, y, 0.0))


def step(hall: Hall, forward: float, turn: float, seconds: float) -> Hall:
    """The state ``seconds`` later, while the base is commanded to drive ``forward`` (m/s) and ``turn`` (rad/s)."""
    forward = max(-0.2, min(TOP_SPEED, forward))
    speed = hall.speed + max(-BRAKING * seconds, min(BRAKING * seconds, forward - hall.speed))
    turn = max(-TOP_TURN, min(TOP_TURN, turn))
    heading = _wrapped(hall.heading + turn * seconds)
    x, y = hall.x + speed * math.cos(heading) * seconds, hall.y + speed * math.sin(heading) * seconds
    bumped = _blocked(x, y, hall.people, ahead=heading if speed >= 0 else heading + math.pi)
    hit = bumped and abs(speed) > CRAWL
    if _blocked(x, y, hall.people):
        x, y, speed = hall.x, hall.y, 0.0
    gap = _gap(x, y, heading, hall.people)
    near = gap < NEAR and speed > NEAR_SPEED
    people = tuple(_walk(person, x, y, seconds) for person in hall.people)
    return replace(
        hall,
        time=hall.time + seconds,
        x=x,
        y=y,
        heading=heading,
        speed=speed,
        turn=turn,
        people=people,
        wheels=_rolled(hall, speed * seconds, turn * seconds),
        charge=max(0.0, hall.charge - (0.0001 + 0.0002 * abs(speed)) * seconds),
        progress=_progress(hall.progress, x, y),
        bumped=bumped,
        touched=hall.time if bumped else hall.touched,
        near=near,
        collisions=hall.collisions + (hit and hall.time - hall.touched > APART),
        near_misses=hall.near_misses + (near and not hall.near),
    )


def cast(hall: Hall, angles: list[float], longest: float) -> list[float]:
    """How far a ray goes from the robot in each direction (rad, from its heading); infinite beyond ``longest``."""
    headings = hall.heading + np.asarray(angles)
    dx, dy = np.cos(headings), np.sin(headings)
    found = np.minimum(_to_outer(hall.x, hall.y, dx, dy), _to_box(hall.x, hall.y, dx, dy, SHELVES))
    for person in hall.people:
        px, py = person.x - hall.x, person.y - hall.y
        if math.hypot(px, py) < longest + PERSON_RADIUS:
            along = px * dx + py * dy
            aside = PERSON_RADIUS**2 - (px * px + py * py - along * along)
            met = (along > 0) & (aside >= 0)
            found[met] = np.minimum(found[met], along[met] - np.sqrt(aside[met]))
    found[found > longest] = math.inf
    return found.tolist()


def is_wall(x: float, y: float) -> bool:
    """Whether a wall or a shelf is there."""
    return not _inside(x, y, OUTER) or _inside(x, y, SHELVES)


def _walk(person: Person, x: float, y: float, seconds: float) -> Person:
    if person.waits > 0:
        return replace(person, waits=person.waits - seconds)
    left = math.dist((person.x, person.y), person.b)
    if left < person.speed * seconds:
        return replace(person, a=person.b, b=person.a, waits=1.0)
    share = person.speed * seconds / left
    to_x, to_y = person.x + share * (person.b[0] - person.x), person.y + share * (person.b[1] - person.y)
    if math.dist((to_x, to_y), (x, y)) < ROBOT_RADIUS + PERSON_RADIUS + 0.02:
        return replace(person, a=person.b, b=person.a, waits=2.0)
    return replace(person, x=to_x, y=to_y)


def _blocked(x: float, y: float, people: tuple[Person, ...], ahead: float | None = None) -> bool:
    """Whether the robot would touch something there; with ``ahead``, something that is in that direction."""
    touched = [
        (person.x - x, person.y - y)
        for person in people
        if math.dist((person.x, person.y), (x, y)) < ROBOT_RADIUS + PERSON_RADIUS
    ]
    left, bottom, right, top = OUTER
    near_x, near_y = max(left, min(right, x)), max(bottom, min(top, y))
    for edge in ((left, near_y), (right, near_y), (near_x, bottom), (near_x, top), _nearest(x, y, SHELVES)):
        if math.dist(edge, (x, y)) < ROBOT_RADIUS:
            touched.append((edge[0] - x, edge[1] - y))
    if ahead is None:
        return bool(touched)
    return any(abs(_wrapped(math.atan2(dy, dx) - ahead)) < AHEAD for dx, dy in touched)


def _gap(x: float, y: float, heading: float, people: tuple[Person, ...]) -> float:
    """The free space to the closest person ahead."""
    gaps = [
        math.dist((person.x, person.y), (x, y)) - ROBOT_RADIUS - PERSON_RADIUS
        for person in people
        if abs(_wrapped(math.atan2(person.y - y, person.x - x) - heading)) < AHEAD
    ]
    return min(gaps, default=math.inf)


def _rolled(hall: Hall, way: float, turned: float) -> tuple[float, float, float]:
    x, y, heading = hall.wheels
    heading = _wrapped(heading + turned * (1 + hall.drift[1]))
    way *= 1 + hall.drift[0]
    return x + way * math.cos(heading), y + way * math.sin(heading), heading


def _progress(before: float, x: float, y: float) -> float:
    """How far along the route the robot is, over all laps: the closest point of it, never more than 2 m from before."""
    best, found, at = math.inf, before, 0.0
    for (ax, ay), (bx, by) in zip(ROUTE, ROUTE[1:] + ROUTE[:1], strict=True):
        length = math.dist((ax, ay), (bx, by))
        share = max(0.0, min(1.0, ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / length**2))
        apart = math.dist((x, y), (ax + share * (bx - ax), ay + share * (by - ay)))
        along = (at + share * length - before + LAP / 2) % LAP - LAP / 2
        if apart < best and abs(along) <= 2.0:
            best, found = apart, before + along
        at += length
    return found


def _to_outer(x: float, y: float, dx: np.ndarray, dy: np.ndarray) -> np.ndarray:
    left, bottom, right, top = OUTER
    with np.errstate(divide="ignore"):
        across = np.where(dx == 0, math.inf, (np.where(dx > 0, right, left) - x) / dx)
        along = np.where(dy == 0, math.inf, (np.where(dy > 0, top, bottom) - y) / dy)
    return np.minimum(across, along)


def _to_box(x: float, y: float, dx: np.ndarray, dy: np.ndarray, box: tuple[float, float, float, float]) -> np.ndarray:
    """From outside to where each ray enters a box; infinite where it misses it."""
    enters, leaves = np.zeros_like(dx), np.full_like(dx, math.inf)
    with np.errstate(divide="ignore", invalid="ignore"):  # a ray along a side misses it
        for at, d, low, high in ((x, dx, box[0], box[2]), (y, dy, box[1], box[3])):
            one, other = (low - at) / d, (high - at) / d
            enters, leaves = np.maximum(enters, np.minimum(one, other)), np.minimum(leaves, np.maximum(one, other))
    return np.where((enters > 0.0) & (enters <= leaves), enters, math.inf)


def _crosses(
    a: tuple[float, float], b: tuple[float, float], box: tuple[float, float, float, float], margin: float
) -> bool:
    wide = (box[0] - margin, box[1] - margin, box[2] + margin, box[3] + margin)
    length = math.dist(a, b)
    if _inside(*a, wide) or not length:
        return True
    dx, dy = np.array([(b[0] - a[0]) / length]), np.array([(b[1] - a[1]) / length])
    return _to_box(*a, dx, dy, wide).item() < length


def _inside(x: float, y: float, box: tuple[float, float, float, float]) -> bool:
    return box[0] <= x <= box[2] and box[1] <= y <= box[3]


def _nearest(x: float, y: float, box: tuple[float, float, float, float]) -> tuple[float, float]:
    return max(box[0], min(box[2], x)), max(box[1], min(box[3], y))


def _wrapped(angle: float) -> float:
    return (angle + math.pi) % (2 * math.pi) - math.pi
