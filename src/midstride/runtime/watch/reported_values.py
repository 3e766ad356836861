"""The parameter values that were set while components ran, as the components report them.

The values of an instance are known as long as it runs, those of a role also after its instance has crashed and, from
the state store, to the next manager (docs/protocols/state.md).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from midstride.model.configuration import Configuration
from midstride.plan.runtime_values import Origin, Values
from midstride.wire.state import ComponentState

_NONE: Values = {}


@dataclass(slots=True)
class ReportedValues:
    """``saved`` has the values of each role as they were last saved for the next manager."""

    saved: dict[str, Values] = field(default_factory=dict)
    _of_instance: dict[str, Values] = field(default_factory=dict)
    _put_back: dict[str, Values] = field(default_factory=dict)  # by role, until they are saved
    _unknown: dict[str, Mapping[str, Origin]] = field(default_factory=dict)  # by instance
    _unknown_of_role: dict[str, Mapping[str, Origin]] = field(default_factory=dict)  # as of the values that are saved
    _set_at: dict[str, Mapping[str, float]] = field(default_factory=dict)  # by instance

    def report(self, state: ComponentState) -> bool:
        """A component has reported its state; whether its values are others than before."""
        before = self._of_instance.get(state.instance, _NONE)
        self._unknown[state.instance] = {
            name: "node" if name in state.own_values else "unknown" for name in state.unknown_origin
        }
        self._set_at[state.instance] = state.set_at
        self._of_instance[state.instance] = after = state.set_values()
        return before != after

    def of(self, instance: str) -> Values:
        """The last known values of an instance, also if it has ended meanwhile."""
        return self._of_instance.get(instance, _NONE)

    def unknown_of(self, instance: str) -> Mapping[str, Origin]:
        """The parameters of an instance that are not known to have been set by a request, with what is known."""
        return self._unknown.get(instance, {})

    def set_at(self, instance: str) -> Mapping[str, float]:
        """Return, by parameter of an instance, when a request has set it (Unix time, s), where that is known."""
        return self._set_at.get(instance, {})

    def unknown_by_role(self, configuration: Configuration) -> dict[str, Mapping[str, Origin]]:
        """The unknown values of the live instance of each role."""
        return {
            role: self.unknown_of(next(iter(names)))
            for role, names in configuration.instances_by_role.items()
            if len(names) == 1
        }

    def unknown_after(self, role: str) -> Mapping[str, Origin] | None:
        """The unknown values of the last instance of a role that has reported; None where there has been none."""
        return self._unknown_of_role.get(role)

    def by_role(self, configuration: Configuration) -> dict[str, Values]:
        """The values of each role: of its live instance, else those of the one that has exited."""
        live = {
            role: self.of(next(iter(names)))
            for role, names in configuration.instances_by_role.items()
            if len(names) == 1  # else a change is under way
        }
        return {**self.saved, **self._put_back, **live}

    def update_saved(self, configuration: Configuration, roles: Mapping[str, object]) -> dict[str, Values]:
        """The values to save, of each role that has changed. Forgets roles that are not in ``roles``."""
        now = {role: values if role in roles else _NONE for role, values in self.by_role(configuration).items()}
        changed = {role: values for role, values in now.items() if values != self.saved.get(role, _NONE)}
        self.saved = {role: values for role, values in now.items() if values}
        self._put_back.clear()
        reported = {
            role: self._unknown[name]
            for role, names in configuration.instances_by_role.items()
            if len(names) == 1 and (name := next(iter(names))) in self._unknown
        }
        unknown = {**self._unknown_of_role, **reported}
        self._unknown_of_role = {role: names for role, names in unknown.items() if role in roles}
        return changed

    def put_back(self, instance: str, role: str, values: Values) -> None:
        """An instance of a role has ended while a change was carried out: the next one has these ``values`` again."""
        self._of_instance[instance] = self._put_back[role] = values

    def forget_ended(self, configuration: Configuration) -> None:
        """Forget the instances that are not live."""
        self._of_instance = {
            name: values for name, values in self._of_instance.items() if name in configuration.instances
        }
        self._unknown = {name: names for name, names in self._unknown.items() if name in configuration.instances}
        self._set_at = {name: times for name, times in self._set_at.items() if name in configuration.instances}
