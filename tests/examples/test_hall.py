"""The hall of the patrol example: its rays, its physics, and what it counts."""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Callable
from dataclasses import replace
from types import ModuleType
from typing import Any

import pytest

STEP = 0.05


@pytest.fixture
def hall(patrol: Callable[[str], ModuleType]) -> Any:
    return patrol("hall")


def empty(hall: Any, **changed: Any) -> Any:
    """The robot at the first corner of a hall without people."""
    return replace(hall.start(1, people=0), **changed)


def standing(hall: Any, x: float, y: float) -> Any:
    return hall.Person((x, y), (x, y), x, y, 0.0, waits=math.inf)


def driven(hall: Any, state: Any, forward: float, turn: float, seconds: float) -> Any:
    for _ in range(round(seconds / STEP)):
        state = hall.step(state, forward, turn, STEP)
    return state


def test_the_same_seed_is_the_same_hall_and_another_one_is_not(hall: Any) -> None:
    assert driven(hall, hall.start(3), 1.0, 0.1, 20) == driven(hall, hall.start(3), 1.0, 0.1, 20)
    assert hall.start(3).people != hall.start(4).people


def test_rays_end_at_walls_shelves_and_people_and_nowhere_beyond_their_range(hall: Any) -> None:
    quarters = [0.0, math.pi / 2, math.pi, -math.pi / 2]
    assert hall.cast(empty(hall), quarters, 20.0) == pytest.approx([17.0, 13.0, 3.0, 3.0])
    assert hall.cast(empty(hall), quarters, 4.0) == pytest.approx([math.inf, math.inf, 3.0, 3.0])
    below_the_shelves = empty(hall, x=10.0, y=3.0, heading=math.pi / 2)
    assert hall.cast(below_the_shelves, [0.0, math.pi], 20.0) == pytest.approx([3.0, 3.0])
    someone = empty(hall, people=(standing(hall, 5.0, 3.0), standing(hall, 3.0, 5.5)))
    assert hall.cast(someone, quarters, 20.0) == pytest.approx([1.75, 2.25, 3.0, 3.0])


def test_the_robot_brakes_as_fast_as_its_wheels_allow(hall: Any) -> None:
    state = driven(hall, empty(hall), 9.0, 0.0, 3.0)
    assert state.speed == pytest.approx(hall.TOP_SPEED)
    stopped = driven(hall, state, 0.0, 0.0, hall.TOP_SPEED / hall.BRAKING)
    assert stopped.speed == pytest.approx(0.0, abs=1e-9)
    assert stopped.x - state.x == pytest.approx(hall.TOP_SPEED**2 / (2 * hall.BRAKING), abs=0.05)


def test_driving_into_someone_or_a_wall_is_one_collision_and_stops_it(hall: Any) -> None:
    state = driven(hall, empty(hall, people=(standing(hall, 5.0, 3.0),)), 1.0, 0.0, 6.0)
    assert (state.collisions, state.speed) == (1, 0.0)
    assert 5.0 - state.x == pytest.approx(hall.ROBOT_RADIUS + hall.PERSON_RADIUS, abs=0.06)
    assert driven(hall, empty(hall, heading=math.pi), 1.0, 0.0, 6.0).collisions == 1


@pytest.mark.parametrize("bearing", [0.0, 1.0, 2.0, 3.0])
def test_someone_who_walks_into_a_standing_robot_is_no_collision(hall: Any, bearing: float) -> None:
    x, y = 3.0 + 2 * math.cos(bearing), 3.0 + 2 * math.sin(bearing)
    person = hall.Person((x, y), (6.0 - x, 6.0 - y), x, y, 1.0)
    state = empty(hall, people=(person,))
    for _ in range(200):
        state = hall.step(state, 0.0, 0.0, STEP)
        (person,) = state.people
        assert math.dist((person.x, person.y), (state.x, state.y)) > hall.ROBOT_RADIUS + hall.PERSON_RADIUS
    assert (state.collisions, state.near_misses, state.bumped) == (0, 0, False)


def test_contact_beside_the_direction_of_travel_is_not_by_its_own_motion(hall: Any) -> None:
    beside = standing(hall, 4.0, 3.0 + hall.ROBOT_RADIUS + hall.PERSON_RADIUS - 0.02)
    assert driven(hall, empty(hall, people=(beside,)), 1.0, 0.0, 2.0).collisions == 0


def test_passing_someone_closely_and_fast_is_one_near_miss(hall: Any) -> None:
    beside = standing(hall, 6.0, 3.7)
    assert driven(hall, empty(hall, people=(beside,)), 1.0, 0.0, 6.0).near_misses == 1
    assert driven(hall, empty(hall, people=(beside,)), 0.2, 0.0, 20.0).near_misses == 0


def test_progress_counts_the_way_along_the_route_over_laps_and_not_what_is_not_driven(hall: Any) -> None:
    state = empty(hall)
    corners = [*hall.ROUTE, *hall.ROUTE, hall.ROUTE[0]]
    for (ax, ay), (bx, by) in itertools.pairwise(corners):
        for share in range(1, 21):
            at = {"x": ax + share * (bx - ax) / 20, "y": ay + share * (by - ay) / 20}
            state = hall.step(replace(state, speed=0.0, **at), 0.0, 0.0, STEP)
    assert state.progress == pytest.approx(2 * hall.LAP)
    assert driven(hall, state, 0.0, 0.0, 5.0).progress == state.progress


def test_from_an_allowed_speed_it_stops_before_it_meets_someone_who_walks_up_to_it(
    hall: Any, patrol: Callable[[str], ModuleType]
) -> None:
    stopping, beams = patrol("stopping"), patrol("beams")
    drawn, hit_if_faster = random.Random(5), 0
    for _ in range(120):
        distance, bearing = drawn.uniform(0.7, 5.0), drawn.uniform(-1.5, 1.5)
        x, y = 10.0 + distance * math.cos(bearing), 3.0 + distance * math.sin(bearing)
        beyond = (10.0 + drawn.uniform(-0.5, 2.0), 3.0 + drawn.uniform(-0.3, 0.3))
        aim = x + 3 * (beyond[0] - x), y + 3 * (beyond[1] - y)
        person = hall.Person((x, y), aim, x, y, hall.PERSON_SPEED)
        state = empty(hall, x=10.0, people=(person,))
        speed = stopping.allowed(hall.cast(state, beams.ANGLES, 6.0), hall.TOP_SPEED)

        def stopped(state: Any, speed: float) -> Any:
            moving = driven(hall, replace(state, speed=speed), speed, 0.0, stopping.REACTION)
            return driven(hall, moving, 0.0, 0.0, speed / hall.BRAKING + STEP)

        assert stopped(state, speed).collisions == 0, (distance, bearing, beyond, speed)
        hit_if_faster += stopped(state, speed + 1.0).collisions
    assert hit_if_faster > 5  # so it is the speed that prevents it


def test_the_wheels_drift_by_up_to_a_hundredth(hall: Any) -> None:
    state = driven(hall, empty(hall, drift=(0.01, 0.0)), 1.0, 0.0, 10.0)
    assert state.wheels[0] - 3.0 == pytest.approx(1.01 * (state.x - 3.0))
    assert all(abs(share) <= 0.01 for seed in range(20) for share in hall.start(seed).drift)


def test_nobody_stands_in_a_shelf_or_walks_through_one(hall: Any) -> None:
    for seed in range(10):
        state = hall.start(seed)
        for _ in range(300):
            state = hall.step(state, 0.0, 0.0, 0.1)
            assert not any(hall.is_wall(person.x, person.y) for person in state.people)
