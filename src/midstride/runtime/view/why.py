"""The reason why a functionality is in its mode, and what an operator can do about it."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Final

from msgspec import UNSET

from midstride.errors import PlanRefused
from midstride.model.component import FunctionalityRef, InputAlternatives, PortRef
from midstride.model.configuration import Configuration
from midstride.model.diagnostics import suggestion
from midstride.model.rules import Evaluator
from midstride.runtime.records.status_forms import Why
from midstride.runtime.running_system import RunningSystem
from midstride.runtime.view.watched_system import WatchedSystem
from midstride.verdicts.assessment import seconds_in_words, silence_in_words

# A call of user code that takes so long (s) is named as what to do something about: longer than any that is planned.
LONG_CALL: Final = 5.0


@dataclass(frozen=True, slots=True)
class Explainer:
    """Answers ``midstride why``."""

    watched: WatchedSystem

    @property
    def system(self) -> RunningSystem:
        return self.watched.system

    def why(self, functionality: str) -> Why:
        """The reason for the mode of ``functionality`` (of a role or instance). Raises PlanRefused if unknown."""
        ref = self._find(functionality)
        configuration, evaluator = self.system.configuration, Evaluator(self.system.configuration)
        declared, state = configuration.functionality(ref), self.watched.client.life.responsive(ref.instance)
        reported = None if state is None else state.functionalities[ref.functionality]
        mode = configuration.mode(ref).name if reported is None else reported.mode
        inputs = [PortRef(ref.instance, name) for name in declared.inputs]
        return Why(
            functionality=str(_of_role(configuration, ref)),
            instance=ref.instance,
            host=configuration.instances[ref.instance].host or UNSET,
            mode=mode,
            normal=mode == declared.modes[0].name,
            because=None if reported is None else reported.because,
            chain=self._reasons(evaluator, ref),
            inputs={str(port): evaluator.input_satisfied(port) for port in inputs},
            remedies=self._remedies(evaluator, ref),
        )

    def _find(self, functionality: str) -> FunctionalityRef:
        configuration, asked = self.system.configuration, FunctionalityRef.parse(functionality)
        every = [ref for instance in configuration.instances.values() for ref in instance.functionality_refs()]
        matching = [ref for ref in every if ref == asked] or [
            ref
            for ref in every
            if ref.functionality == asked.functionality and configuration.instances[ref.instance].role == asked.instance
        ]
        if not matching:
            for node in (asked.instance, functionality):
                if missing := self._missing(node):
                    raise PlanRefused(f"nothing serves {functionality} now: {missing}")
            named = [_of_role(configuration, ref) for ref in every]
            of_node = [ref for ref in named if ref.instance in (functionality, asked.instance)]
            hint = suggestion(functionality, map(str, of_node or named)) or "nothing runs"
            raise PlanRefused(f"there is no functionality {functionality}; {hint}")
        return sorted(matching)[0]

    def _reasons(self, evaluator: Evaluator, ref: FunctionalityRef) -> list[str]:
        """For each better mode than the current one: which of its assumptions are not satisfied."""
        configuration = self.system.configuration
        functionality, reasons = configuration.functionality(ref), []
        for mode in functionality.modes[: configuration.modes[ref]]:
            missing = [a for a in mode.assumptions if not evaluator.assumption_satisfied(ref, functionality, a)]
            reasons += [f"not {mode.name}: it {evaluator.why_assumption_unsatisfied(ref, a)}" for a in missing]
            if not missing:
                reasons.append(f"not {mode.name}: its assumptions are satisfied")
        return reasons

    # -- what to do --------------------------------------------------------------------------------------

    def _remedies(self, evaluator: Evaluator, ref: FunctionalityRef) -> list[str]:
        """The remedies that bring ``ref`` back into its normal mode: for each root cause, the nearest first."""
        stuck = self._stuck(ref)
        if not (stuck or self._is_lowered(ref)):
            return []
        if (commands := self.watched.commands).is_changing:
            return [f"wait for `{commands.current}`, which is being carried out"]
        found: dict[str, None] = {}
        waiting, seen = deque([ref]), {ref}
        while waiting:
            below = waiting.popleft()
            suppliers, missing = self._lacking(evaluator, below)
            if own := self._own_remedy(evaluator, below):
                found[own if below == ref else f"{_of_role(self.system.configuration, below)}: {own}"] = None
            found |= dict.fromkeys(missing)
            waiting.extend(other for other in suppliers if other not in seen)
            seen.update(suppliers)
        return list(found)

    def _own_remedy(self, evaluator: Evaluator, ref: FunctionalityRef) -> str | None:
        """The remedy for a functionality that is not lowered because of what it relies on alone."""
        configuration = self.system.configuration
        role = configuration.instances[ref.instance].role
        if stuck := self._stuck(ref):
            return "; ".join(stuck)
        if restoring := self.watched.restorer.status(ref):
            return restoring
        if not configuration.modes[ref]:
            return None
        if evaluator.mode_satisfied(ref, 0):
            return f"fix the cause, then {self.system.remedy(role)}"
        return None

    def _is_lowered(self, ref: FunctionalityRef) -> bool:
        """Return whether ``ref`` is below its normal mode, in the model or as its component reports."""
        configuration, state = self.system.configuration, self.watched.client.life.responsive(ref.instance)
        found = None if state is None else state.functionalities.get(ref.functionality)
        best = configuration.functionality(ref).modes[0].name
        return configuration.modes[ref] > 0 or (found is not None and found.mode != best)

    def _stuck(self, ref: FunctionalityRef) -> list[str]:
        """The remedies for an instance that hangs, or is silent where ``ref`` guarantees messages; else nothing.

        Of one on a host that cannot be reached, nothing is known, and a restart would not be possible.
        """
        configuration = self.system.configuration
        state = self.watched.client.life.responsive(ref.instance)
        if state is None and self.watched.monitor.is_unreachable(ref.instance, configuration):
            host = configuration.instances[ref.instance].host
            because = next(each.problem for each in self.watched.backend.host_links() if each.host == host)
            then = self.watched.leases.in_words(ref.instance) or "the manager connects again by itself"
            return [f"host {host} cannot be reached: {because}; {then}"]
        instance, functionality = configuration.instances[ref.instance], configuration.functionality(ref)
        ports = {*functionality.inputs, *functionality.outputs}
        silent = [
            silence_in_words(fault.words, fault.seconds or None)
            for fault in self.watched.monitor.faults(configuration)
            if fault.instance == ref.instance and (fault.port is None or PortRef.parse(fault.port).port in ports)
        ]
        found = None if state is None else state.functionalities.get(ref.functionality)
        if found is not None and found.busy is not None and found.busy >= LONG_CALL:
            silent.append(f"a call of its code has not returned for {seconds_in_words(found.busy)}")
        by_hand = "start it anew, then " if instance.component.run is None else ""
        return [f"{'; '.join(silent)}; {by_hand}`midstride restart {instance.role}` replaces it"] if silent else []

    def _lacking(self, evaluator: Evaluator, ref: FunctionalityRef) -> tuple[list[FunctionalityRef], list[str]]:
        """The lowered publishers on the inputs that the normal mode lacks, and why and how others are missing."""
        configuration = self.system.configuration
        functionality = configuration.functionality(ref)
        suppliers: list[FunctionalityRef] = []
        missing: list[str] = []
        for assumption in functionality.modes[0].assumptions:
            # The model may have what has just fallen silent.
            satisfied = evaluator.assumption_satisfied(ref, functionality, assumption)
            names = assumption.inputs if isinstance(assumption, InputAlternatives) else functionality.inputs
            for topic in (topic for name in names for topic in configuration.attached_to(PortRef(ref.instance, name))):
                for output in sorted(configuration.publishers_on(topic)):
                    owner = configuration.component(output.instance).find_owner(output.port)
                    other = None if owner is None else FunctionalityRef(output.instance, owner.name)
                    if other is not None and (self._stuck(other) or (not satisfied and configuration.modes[other])):
                        suppliers.append(other)
                if satisfied:
                    continue
                missing += [words for role in self._roles_missing_on(topic) if (words := self._missing(role))]
        return suppliers, missing

    def _roles_missing_on(self, topic: str) -> list[str]:
        """The roles without an instance that publish on ``topic``."""
        specification = self.system.specification
        return [
            role
            for role in self.system.crashes
            if any(
                topic in topics and specification.component_of(role).has_output(port)
                for port, topics in specification.nodes[role].attachments.items()
            )
        ]

    def _missing(self, node: str) -> str | None:
        """The reason why a role or an instance that has exited is missing, and what comes next; None for any other."""
        for name, exited in reversed(self.system.life.missing.items()):
            role = self.system.role_of_missing(name)
            if role is None or node not in (name, role) or self.system.has_instance(role):
                continue
            respawn = self.watched.respawner.status(role)
            next_ = None if respawn is None else respawn.words
            remedy = None if respawn is not None and respawn.restarting else self.system.remedy(role)
            return "; ".join(filter(None, [exited.words, next_, remedy]))
        return None


def _of_role(configuration: Configuration, ref: FunctionalityRef) -> FunctionalityRef:
    return FunctionalityRef(configuration.instances[ref.instance].role, ref.functionality)
