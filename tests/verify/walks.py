"""Worlds, drawn and walked: what the model's actions say, tried in one configuration after another."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, replace
from typing import Final

from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from hypothesis.internal.conjecture.providers import AVAILABLE_PROVIDERS, HypothesisProvider

from midstride.model.action import Action, Create
from midstride.model.component import EnvironmentGuarantee
from midstride.model.configuration import Configuration, Instance
from midstride.model.rules import violations
from tests.model.build import at, component, filter_, mode, named, source, system
from tests.strategies import systems as strategies
from tests.strategies.actions import actions

KINDS: Final = (
    "create",
    "remove",
    "attach",
    "attach",
    "detach",
    "degrade",
    "degrade",
    *["upgrade"] * 3,
    *["handover"] * 2,
)


class Steady(HypothesisProvider):
    """Draws the same for the same seed. Hypothesis's own provider also draws constants from the modules loaded so
    far, which depend on the tests that ran before."""

    def _maybe_draw_constant(self, *arguments: object, **more: object) -> None:
        return None


AVAILABLE_PROVIDERS["steady"] = Steady


@dataclass(frozen=True, slots=True)
class Claim:
    """What the code says of an action in a configuration. ``after`` is where it leads to, if it is allowed."""

    world: int
    before: Configuration
    action: Action
    reasons: tuple[str, ...]
    after: Configuration | None

    @property
    def allowed(self) -> bool:
        return not self.reasons

    def __str__(self) -> str:
        return f"{self.action.describe(self.before)} (world {self.world})"


@dataclass(slots=True)
class World:
    """A walk: the configurations reached, all of them valid, and the actions tried there."""

    instances: list[Instance]
    configurations: dict[Hashable, Configuration]
    claims: list[Claim]
    invalid: list[Configuration]


def walks(worlds: int, *, tries: int, configurations: int, start: int) -> list[World]:
    """Worlds with what was tried in them, the same ones for the same seed ``start``."""
    found: list[World] = []

    @seed(start)
    @settings(
        max_examples=worlds,
        database=None,
        backend="steady",
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(st.data())
    def draw(data: st.DataObject) -> None:
        if data.draw(st.integers(0, 5)):
            found.append(_walk(data, len(found), data.draw(strategies.scenes(most=3)), tries, configurations))
        else:
            found.append(_walk(data, len(found), set_piece(), 2 * tries, 2 * configurations))

    draw()
    return found


def set_piece() -> strategies.GeneratedSystem:
    """Seldom drawn: two that only work together, inputs that are not alternatives, a topic served from outside."""
    modes = [mode("both", [named("left"), named("right")]), mode("one", [named("left")]), mode("degraded")]
    stereo = component("Stereo", {"left": at(5.0), "right": at(5.0)}, [], modes)
    configuration = system(
        {"n0": filter_(), "n1": filter_(), "eye": stereo},
        ["n0.in /b", "n0.out /a", "n1.in /a", "n1.out /b", "eye.left /l", "eye.right /r"],
        environment=[EnvironmentGuarantee("camera", at(10.0), "/l")],
        modes={"n0.work": 0, "n1.work": 0, "eye.work": 1},
    )
    return strategies.GeneratedSystem(configuration, (filter_(), source()))


def _walk(data: st.DataObject, number: int, scene: strategies.GeneratedSystem, tries: int, most: int) -> World:
    configuration = scene.configuration
    fresh = {component.name: Instance(f"new_{component.name}", "new", component) for component in scene.components[:2]}
    world = World([*configuration.instances.values(), *fresh.values()], {key(configuration): configuration}, [], [])
    tried: set[Hashable] = set()
    for _ in range(tries):
        before = [*world.configurations.values()][data.draw(st.integers(0, len(world.configurations) - 1))]
        action = data.draw(actions(replace(scene, configuration=before), kinds=KINDS))
        if isinstance(action, Create) and action.instance.name not in before.instances:
            # One name stands for one declaration in a dump.
            action = Create(data.draw(st.sampled_from(list(fresh.values()))))
        if (case := (key(before), repr(action))) in tried:
            continue
        tried.add(case)
        claim = claimed(number, before, action)
        if claim.after is not None and key(claim.after) not in world.configurations:
            if len(world.configurations) == most:
                continue
            world.configurations[key(claim.after)] = claim.after
        if not claim.allowed and len(world.invalid) < most // 8:
            world.invalid += _refused_result(before, action)
        world.claims.append(claim)
    return world


def claimed(world: int, before: Configuration, action: Action) -> Claim:
    """What the code says now."""
    reasons = tuple(map(str, action.check(before)))
    return Claim(world, before, action, reasons, None if reasons else action.effect(before))


def _refused_result(before: Configuration, action: Action) -> list[Configuration]:
    """Where a refused action would have led to, if that is a configuration and not valid."""
    if action.kind not in ("degrade", "upgrade", "detach", "handover"):
        return []
    try:
        after = action.effect(before)
        spoilt = violations(after) and all(after.has_port(port) for port, _ in after.attachments())
        return [after] if spoilt else []
    except LookupError:
        return []


def key(configuration: Configuration) -> Hashable:
    """Configurations of one world are the same iff their keys are."""
    return (
        frozenset(configuration.instances),
        frozenset(configuration.attachments()),
        frozenset(configuration.modes.items()),
    )
