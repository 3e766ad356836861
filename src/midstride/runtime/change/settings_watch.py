"""The watch after a change has set parameters, over the contracts of nodes that have new values, and over all modes.

A node may accept a value with which it does not keep what it guarantees, or with which what relies on it degrades: then
the change is rolled back as a whole (docs/semantics.md section 6).
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from midstride.codec.parameter import json_values
from midstride.errors import StepFailed
from midstride.model.configuration import Configuration
from midstride.model.specification import FEWEST_PERIODS
from midstride.plan.runtime_values import Origin, Values
from midstride.runtime.handover.probation import WatchedOutput, watch_after
from midstride.runtime.process.component_client import ComponentClient
from midstride.runtime.records.events import EventLog
from midstride.runtime.running_system import RunningSystem
from midstride.runtime.watch.observed_configuration import own_degradations
from midstride.runtime.watch.simulated_time import stretch_of
from midstride.wire.commands import SetParametersCommand

# Where the specification does not say for how long it is watched: rates are judged over so long (s), or five periods
# where that is not longer than the second, and are watched for so many times as long.
DEFAULT_WINDOW: Final = 0.5
LONGEST_WINDOW: Final = 2.0
WINDOWS: Final = 1.2
# How often it is looked whether something has degraded or exited (s).
INTERVAL: Final = 0.02


class BrokenBySetting(StepFailed):
    """A contract is broken after parameters were set. ``instance``: the one whose contract it is."""

    def __init__(self, message: str, instance: str) -> None:
        super().__init__(message)
        self.instance = instance


@dataclass(frozen=True, slots=True)
class Setting:
    """Parameters of an instance of ``role`` that are set ``since`` (steady s).

    ``values``: what had been set on it at run time before, ``unknown``: those of unknown origin. ``outputs``: the
    attached ones that kept their rates.
    """

    role: str
    since: float
    values: Values
    unknown: Mapping[str, Origin]
    outputs: tuple[WatchedOutput, ...]

    @classmethod
    def begun(cls, client: ComponentClient, system: RunningSystem, name: str, configuration: Configuration) -> Setting:
        """The one that begins now."""
        latest, values = system.life.latest(name), system.values
        outputs: list[WatchedOutput] = []
        for port, connector in configuration.attached_ports(name):
            component, topic = configuration.component(name), configuration.topic(connector)
            rate = configuration.rate(port) if configuration.is_output(port) else None
            if not rate or not component.counts_messages or latest is None:
                continue
            link = latest.state.ports.get(port.port, {}).get(topic)
            if link is not None and (link.measured is None or link.measured.meets(rate) is not False):
                outputs.append(WatchedOutput(port, None, topic, rate))
        role = configuration.instances[name].role
        return cls(role, client.clock.steady(), values.of(name), values.unknown_of(name), tuple(outputs))

    def back(self, values: Values) -> SetParametersCommand:
        """The command that sets the ``values`` before, which count as set at run time where they did."""
        unknown = sorted(name for name in values if name in self.unknown)
        return SetParametersCommand(parameters=json_values(values), declared={}, unknown_origin=unknown)


@dataclass(frozen=True)
class SettingsWatch:
    """Watches what the instances of ``settings``, by name, do from now on."""

    client: ComponentClient
    system: RunningSystem
    events: EventLog
    settings: Mapping[str, Setting]

    def by_default(self) -> tuple[float, float]:
        """For how long it is watched where the specification does not say, and the shortest window of a rate (s)."""
        rates = [each.rate for setting in self.settings.values() for each in setting.outputs]
        periods = [FEWEST_PERIODS / rate for rate in rates if rate * LONGEST_WINDOW >= FEWEST_PERIODS]
        return WINDOWS * max([DEFAULT_WINDOW, *periods]), DEFAULT_WINDOW

    async def run(self, seconds: float, shortest: float) -> None:
        """Watch for ``seconds``; rates over ``shortest`` seconds, or five periods. Raises BrokenBySetting."""
        outputs = [
            each
            for setting in self.settings.values()
            for each in setting.outputs
            if max(shortest, FEWEST_PERIODS / each.rate) <= seconds
        ]
        what = [str(each.port) for each in outputs] or sorted(self.settings)
        self.events.add("watching", f"watching {', '.join(what)} for {seconds:g} s")
        slowest = max((stretch_of(self.client, name) for name in self.settings), default=1.0)
        watching = [asyncio.ensure_future(self._rate(each, seconds, slowest, shortest)) for each in outputs]
        watching.append(asyncio.ensure_future(self._modes(seconds)))
        try:
            done, _ = await asyncio.wait(watching, return_when=asyncio.FIRST_EXCEPTION)
            for task in done:
                task.result()
        finally:
            for task in watching:
                task.cancel()
            await asyncio.gather(*watching, return_exceptions=True)

    async def _rate(self, output: WatchedOutput, seconds: float, stretch: float, shortest: float) -> None:
        try:
            await watch_after(self.client, [output], seconds, stretch, shortest)
        except StepFailed as error:
            raise BrokenBySetting(str(error), output.port.instance) from error

    async def _modes(self, seconds: float) -> None:
        clock = self.client.clock
        until = clock.steady() + seconds
        while True:
            self._look()
            if clock.steady() >= until:
                return
            await clock.sleep(INTERVAL)

    def _look(self) -> None:
        """Check what rates do not show.

        Raises BrokenBySetting where a node that was set has ended, or a functionality has degraded by itself.
        """
        for name in self.settings:
            if self.system.life.is_gone(name):
                raise BrokenBySetting(f"{name} has ended after its parameters were set", name)
        configuration = self.system.configuration
        for ref, index in sorted(own_degradations(configuration, self.system.life).items()):
            mode = configuration.functionality(ref).modes[index].name
            latest = self.system.life.latest(ref.instance)
            because = "" if latest is None else latest.state.functionalities[ref.functionality].because.strip()
            words = f"{ref} entered mode {mode} after parameters were set" + (f": {because}" if because else "")
            raise BrokenBySetting(words, ref.instance)
