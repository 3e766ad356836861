"""A change judged by all that was measured of it, in the words of :mod:`midstride.verdicts`."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence

from immutables import Map

from midstride.model import wording
from midstride.model.action import Action, Create, Degrade, Detach, Remove
from midstride.model.configuration import Configuration
from midstride.plan.expected_losses import planned_instances, unmeasured_pair
from midstride.plan.plan import Plan
from midstride.runtime.change.lost_endpoints import endpoints_that_ended
from midstride.runtime.change.planned_transfers import silences_for_state
from midstride.runtime.change.successor_names import names_now
from midstride.runtime.instance_life import LatestState
from midstride.runtime.process.launcher import LastKnown
from midstride.runtime.records.reports import Outcome, StepTime
from midstride.runtime.records.status_forms import SilenceFault
from midstride.verdicts import assessment, change_facts, unmeasured
from midstride.verdicts.assessment import Assessment, Assessments


def change_assessment(
    outcome: Outcome,
    plan: Plan,
    now: Configuration,
    silences: Sequence[SilenceFault],
    at_outputs: Sequence[Assessment],
    states: Mapping[str, LatestState],
    last_known: Mapping[str, LastKnown] = Map(),
    ended: Sequence[Assessment] = (),
    offers: Mapping[str, Collection[str]] = Map(),
) -> Assessments:
    """Return what may be said of ``outcome``, after which ``now`` runs.

    ``silences``: all that is silent now, also what was before; ``at_outputs``: what the counts of outputs show;
    ``states``: what each component reported before the change; ``last_known``: what was known of those that it has
    ended. ``ended``: what has become of the nodes that have ended with an instance; ``offers``: the services and ROS
    actions of those that run now (in words), by instance, where they are known.
    """
    lowered = bool(outcome.below_baseline_seconds)
    return assessment.assessed(
        [
            *reported(outcome, silences, _unmeasured_roles(plan), _deactivations(plan, outcome)),
            *(each for each in at_outputs if each.verdict != "lost" or each.at_most or not lowered),
            *_exchanged(plan, outcome),
            *silences_for_state(outcome, now),
            *endpoints_that_ended(plan, last_known, states, _together(plan, outcome), offers),
            *names_now(plan, states, {time.step: time for time in outcome.steps if outcome.outcome == "done"}),
            *ended,
            *_others(plan, now),
            *_started(plan, now),
        ]
    )


def reported(
    outcome: Outcome,
    silences: Sequence[SilenceFault],
    unmeasured: Collection[str] = (),
    deactivations: Mapping[str, float] = Map(),
) -> list[Assessment | None]:
    """Return what the figures of ``outcome`` say; ``silences``: all that is silent now, also what was before.

    ``unmeasured``: the roles of which nothing measures when a new node has begun its work. ``deactivations``: those of
    lifecycle nodes, each with how long it took at most until it was acknowledged (s).
    """
    found: list[Assessment | None] = []
    for name, spent in sorted(outcome.below_baseline_seconds.items()):
        role = name.partition(".")[0]
        spent, at_most = round(spent + deactivations.get(role, 0.0), 6), role in deactivations
        found.append(change_facts.below_level(name, spent, unmeasured=role in unmeasured, at_most=at_most))
    for each in outcome.remaining_degradations:
        because = f": {each.because.splitlines()[0]}" if each.because else ""
        words = f"{wording.lowered(each.functionality, each.after, each.before)}{because}"
        found.append(change_facts.lower_afterwards(each.functionality, words, planned=each.planned))
    if outcome.unexpected_exits:
        found.append(change_facts.exited(outcome.unexpected_exits))
    if outcome.unexpected_degradations:
        found.append(change_facts.degraded_unexpectedly(outcome.unexpected_degradations))
    found += [change_facts.fenced(each.instance, each.words) for each in outcome.fenced]
    begun = {fault.words for fault in outcome.silences}
    for fault in silences:
        subject = fault.port or fault.instance
        found.append(
            change_facts.silent(subject, fault.words, fault.seconds or None, since_before=fault.words not in begun)
        )
    for swap in outcome.swaps:
        counts = {name: getattr(swap, name) for name in ("missed", "lost", "duplicates")}
        found.append(change_facts.received(swap.topic, swap.subscriber, counts, swap.gap))
    killed = (change_facts.killed(each.instance, each.words, unfinished=each.unfinished) for each in outcome.killed)
    return [*found, *killed]


def _exchanged(plan: Plan, outcome: Outcome) -> Iterator[Assessment]:
    """The nodes of which nothing measures what they do, and that were started again, or were to be."""
    created: dict[str, StepTime | None] = {}
    removed: dict[str, StepTime | None] = {}
    instances = planned_instances(plan)
    for action, time in _timed_actions(plan, outcome):
        match action:
            case Create(instance):
                created[instance.name] = time
            case Remove(name):
                removed[name] = time
    for old, new in sorted(plan.change.replaced.items()):
        if new not in created or old not in removed:
            continue
        if (because := unmeasured_pair(instances, old, new)) is None:
            continue
        up, end, down, together = created[new], removed[old], None, None
        if up is not None and end is not None:
            started = up.began + up.seconds
            down, together = started - end.began, end.began + end.seconds - started
        done = outcome.outcome == "done"
        if end is not None or not done:
            yield unmeasured.unmeasured_exchange(instances[new].role, because, down=down, together=together, done=done)


def _timed_actions(plan: Plan, outcome: Outcome) -> Iterator[tuple[Action, StepTime | None]]:
    """The actions of ``plan``, each with when its step was carried out; None where it was not."""
    times = {time.step: time for time in outcome.steps}
    return ((step.action, times.get(number)) for number, step in enumerate(plan.steps, start=1))


def _together(plan: Plan, outcome: Outcome) -> dict[str, float]:
    """For how long both instances of a role ran at once, as measured (s)."""
    created: dict[str, float] = {}
    found: dict[str, float] = {}
    for action, time in _timed_actions(plan, outcome):
        if time is None:
            continue
        match action:
            case Create(instance):
                created[instance.role] = time.began
            case Remove(name) if (role := plan.change.role_of(name)) in created:
                found[role] = time.began + time.seconds - created[role]
    if outcome.outcome != "done":  # until the new one was ended
        found |= {role: outcome.seconds - began for role, began in created.items() if role not in found}
    return found


def _unmeasured_roles(plan: Plan) -> set[str]:
    instances = planned_instances(plan).values()
    return {each.role for each in instances if unmeasured.why_unmeasured(each.component) is not None}


def _deactivations(plan: Plan, outcome: Outcome) -> dict[str, float]:
    """The roles of lifecycle nodes, each with how long the step took at most that deactivated its node (s).

    A node may fall silent as soon as it is asked to become inactive, and acknowledges that once it is.
    """
    instances = planned_instances(plan)
    found = {each.role: 0.0 for each in instances.values() if each.component.has_lifecycle}
    for action, time in _timed_actions(plan, outcome):
        if time is None or not isinstance(action, Degrade | Detach):
            continue
        for role in {instances[name].role for name in action.instances()} & found.keys():
            found[role] = max(found[role], time.seconds)
    return found


def _started(plan: Plan, now: Configuration) -> Iterator[Assessment]:
    """The outputs that guarantee a rate in a system that has just been started, and that is not measured yet."""
    if not plan.change.start.instances and (
        rated := [str(port) for ports in now.publishers.values() for port in ports if now.rate(port)]
    ):
        yield change_facts.just_started(sorted(rated))


def _others(plan: Plan, now: Configuration) -> list[Assessment]:
    """The nodes that run and were not exchanged, of which nothing measures whether they do their work."""
    exchanged = {plan.change.role_of(old) for old in plan.change.replaced}
    others = (instance for instance in now.instances.values() if instance.role not in exchanged)
    return unmeasured.unmeasured_nodes({instance.role: instance.component for instance in others})
