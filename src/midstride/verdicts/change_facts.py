"""The facts of a change, or of a plan, each as an assessment with its sentence.

What was measured, what a gate or a hand-over enforces, and what nothing measures.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from midstride.model.wording import LOST_AT_END, counted
from midstride.verdicts.assessment import (
    Assessment,
    listed,
    seconds_in_words,
    sentences,
    silence_in_words,
    split_by_verdict,
    time_in_words,
)
from midstride.verdicts.conditions import whether_kept

# A count of messages shows a silence only if more than this part of them is missing, and more than so many: the
# tolerance of a rate, and what is uncertain at both ends of the count.
MISSING_PART: Final = 0.1
MISSING_LEAST: Final = 3
# A silence that a count would not show is named where it may last longer than this (s).
SHORT: Final = 0.5


def below_level(functionality: str, seconds: float, *, unmeasured: bool = False, at_most: bool = False) -> Assessment:
    """A functionality was below its level for so long, by the modes that components have acknowledged.

    ``unmeasured``: nothing measures when the one node has ended its work, and the other has begun it. ``at_most``: it
    is that of a lifecycle node, which answers some time after it has become active.
    """
    if unmeasured:
        words = f"{functionality} was below its level, for how long is not known: nothing counts what its node writes"
        return Assessment(functionality, "lost", words)
    words = f"{functionality} was below its level for {time_in_words(seconds, at_most=at_most)}"
    return Assessment(functionality, "lost", words, seconds, at_most=at_most)


def lower_afterwards(functionality: str, words: str, *, planned: bool) -> Assessment:
    """A functionality is in a worse mode afterwards; ``words`` say in which, and why."""
    return Assessment(functionality, "lost", f"Afterwards: {words}", lasting=not planned)


def exited(instances: Sequence[str]) -> Assessment:
    """Instances have exited without being asked to."""
    names = ", ".join(instances)
    return Assessment(names, "lost", f"Exited unexpectedly meanwhile: {names}; see `midstride log`", lasting=True)


def degraded_unexpectedly(functionalities: Sequence[str]) -> Assessment:
    """Functionalities have entered a worse mode that no command had asked for. Those that still are, are said so."""
    names = ", ".join(functionalities)
    words = f"Degraded unexpectedly meanwhile: {names}; see `midstride why {functionalities[0]}`"
    return Assessment(names, "lost", words)


def fenced(instance: str, words: str) -> Assessment:
    """An instance hung, and was kept from publishing: since when it had done nothing is not known."""
    return Assessment(instance, "lost", f"Fenced: {words}")


def silent(subject: str, words: str, seconds: float | None, *, since_before: bool) -> Assessment:
    """A component does not answer, or a port is silent; ``since_before``: already when the change began."""
    already = ", as before the change" if since_before else ""
    return Assessment(
        subject, "lost", f"{silence_in_words(words, seconds)}{already}", seconds, lasting=not since_before
    )


def received(
    topic: str, subscriber: str, counts: Mapping[str, int | None], gap: float | None = None
) -> Assessment | None:
    """Return what was counted at one subscriber: ``missed``, ``lost`` and ``duplicates``; None where all of it is 0."""
    found = [f"{count} {name.removesuffix('s') if count == 1 else name}" for name, count in counts.items() if count]
    unknown = [name for name, count in counts.items() if count is None]
    if found:
        besides = f" ({listed(unknown)} {'is' if len(unknown) == 1 else 'are'} not known)" if unknown else ""
        words = f"Messages on {topic} at {subscriber}: {listed(found)}{besides}"
        return Assessment(topic, "lost", words, gap if counts.get("missed") else None)
    if unknown:
        return Assessment(topic, "not_measurable", f"{listed(unknown)} at {subscriber} on {topic}")
    return None


def inactive(topic: str, port: str, seconds: float, rate: float | None) -> Assessment | None:
    """No lifecycle node was active that writes an output, for so long at most (s); None if its period is longer.

    The time begins before the one node is asked to become inactive, and ends when the other has said that it is active.
    When each has made its transition in between, nothing shows.
    """
    if seconds <= (1 / rate if rate else 0.0):
        return None
    time = time_in_words(seconds, at_most=True)
    words = f"{topic} was silent while no node that writes {port} was active, for {time}, and until it wrote again"
    return Assessment(topic, "lost", words, round(seconds, 6), at_most=True)


def written(topic: str, port: str, passed: int, window: float, rate: float) -> Assessment | None:
    """So many messages passed the gates of an output in ``window`` s, which wrote ``rate`` Hz before; None: enough."""
    missing = rate * window - passed
    if missing <= _unseen(window, rate):
        return None
    silence = missing / rate
    words = (
        f"{topic} was silent for about {seconds_in_words(silence)}: {passed} messages of {port} in "
        f"{seconds_in_words(window)}, and it wrote {rate:.3g} Hz before"
    )
    return Assessment(topic, "lost", words, round(silence, 3))


def _unseen(window: float, rate: float) -> float:
    """The number of messages that may be missing in ``window`` (s) without a word."""
    return max(MISSING_LEAST, MISSING_PART * rate * window)


def silent_between_counts(topic: str, port: str, window: float, rate: float) -> Assessment | None:
    """A count that lacks nothing shows no silence that is as short as what it tolerates; None where that is short.

    For an output whose messages no subscriber of the system has recorded. One that wrote nothing before (0 Hz) does not
    fall silent.
    """
    if rate == 0 or (seconds := _unseen(window, rate) / rate) <= SHORT:
        return None
    words = (
        f"whether {topic} was silent for up to {seconds_in_words(seconds)}: the messages of {port} were counted over "
        f"{seconds_in_words(window)}, and no subscriber in the system has recorded them"
    )
    return Assessment(topic, "not_measurable", words)


def written_by_lifecycle(topic: str, port: str) -> Assessment:
    """A lifecycle node is active, which is not that it writes: for an output that no subscriber has recorded."""
    words = (
        f"when {topic} was written again: nothing counts the messages of {port}, and no subscriber in the system has "
        "recorded them"
    )
    return Assessment(topic, "not_measurable", words)


def not_counted(topic: str, port: str) -> Assessment:
    """Of an exchanged output, one side has not said how much it had written when it ended."""
    return Assessment(topic, "not_measurable", f"whether {topic} was silent: how much {port} wrote last is not known")


def just_started(ports: Sequence[str]) -> Assessment:
    """Outputs whose components have just been started: no rate has been measured over a whole window."""
    they = "it has" if len(ports) == 1 else "they have"
    return Assessment(listed(ports), "not_measurable", f"{whether_kept(ports)}: {they} just been started")


def unanswered_outputs(instance: str, topics: Sequence[str]) -> Assessment:
    """The outputs of an instance could not be counted, since nothing has answered for it in the end."""
    return Assessment(instance, "not_measurable", f"what was written on {listed(topics)}: {instance} has not answered")


def killed(instance: str, words: str, *, unfinished: bool = False) -> Assessment:
    """A process was killed at its end, so that what it does then, such as writing a file, is not done.

    ``unfinished``: it was not, and ``words`` are what it has said itself of what it has left undone.
    """
    return Assessment(instance, "not_measurable", words if unfinished else f"{words}: {LOST_AT_END}")


def ends_with(instance: str, served: Sequence[str], *, planned: bool) -> Assessment:
    """The services and ROS actions of a node without Midstride's API end with its instance."""
    verb = "ended" if not planned else "ends" if len(served) == 1 else "end"
    words = (
        f"requests and goals of others: {listed(served)} {verb} with {instance}, and what is under way is not answered"
    )
    return Assessment(instance, "not_measurable", words)


def another_name(instance: str, before: str, after: str | None, *, planned: bool) -> Assessment:
    """The node of a replacement is not called ``before``, as that of the instance that it replaces.

    ``after``: how it is called; None where its program has it from another name.
    """
    name = "has another name" if after is None else f"is called {after}"
    until = f"from the end of {instance} on" if planned else f"since {instance} has ended"
    words = (
        f"requests of others to services below {before}, as for its parameters: the node of its replacement {name}, so "
        f"none is answered {until}"
    )
    return Assessment(instance, "not_measurable", words)


def unanswered_meanwhile(
    instance: str, node: str, replacement: str, seconds: float, *, planned: bool, serves: bool
) -> Assessment:
    """A node was ended before the one that replaces it, under its name, was started.

    ``seconds``: from when it is asked to end until the other one is started. ``serves``: that has its services by then.
    """
    words = f"requests of others to services of {node}, as for its parameters: {instance} "
    if planned:
        words += f"ends before {replacement} is started, so none is answered for about {seconds_in_words(seconds)}"
        words += "" if serves else ", and until its program has started up"
    else:
        words += f"had ended before {replacement} was started, so none was answered for {seconds_in_words(seconds)}"
        words += "" if serves else ", and when its program had started up is not known"
    return Assessment(instance, "not_measurable", words)


def answered_if_offered(instance: str, served: Sequence[str], *, planned: bool) -> Assessment:
    """Assess services of a node without Midstride's API that its successor, of another component, goes on to serve."""
    one = len(served) == 1
    verb = ("is" if one else "are") if planned else ("was" if one else "were")
    replacement = f"the replacement of {instance} only if that offers {'it' if one else 'them'}"
    words = f"requests of others: {listed(served)} {verb} answered by {replacement}"
    return Assessment(instance, "not_measurable", words)


def not_offered(instance: str, lacking: Sequence[str]) -> Assessment:
    """Assess services of a node that the graph has not shown of its successor by the end of the change."""
    answered = "it is not answered" if len(lacking) == 1 else "they are not answered"
    words = (
        f"requests of others: as far as the graph shows, the replacement of {instance} does not offer "
        f"{listed(lacking)}, so {answered} since {instance} has ended"
    )
    return Assessment(instance, "not_measurable", words)


def answered_by_both(instance: str, served: Sequence[str], *, planned: bool) -> Assessment:
    """Of two nodes of a role that run at the same time, both answer, as nothing decides between them."""
    verb, may = ("", "may be") if planned else ("ed", "may have been")
    words = (
        f"requests of others: {instance} and its replacement answer{verb} {listed(served)} while both run, where both "
        f"have it, so that a request {may} handled twice"
    )
    return Assessment(instance, "not_measurable", words)


def goals_go_on(instance: str, actions: Sequence[str], patience: float) -> Assessment:
    """Goals that a node has accepted stay with it; new ones go to its successor."""
    words = (
        f"goals of others that are under way at {listed(actions)}: they continue at {instance}, which runs beside its "
        f"replacement until they have ended, for at most {patience:g} s (`patience`); what is left then is cancelled"
    )
    return Assessment(instance, "not_measurable", words)


def waits_for_goals(instance: str, because: str, goals: int, seconds: float) -> str:
    """An instance that an earlier manager has left is ended when its goals have ended, in words."""
    have = f"{counted(goals, 'goal')} of ROS actions in progress"
    until = f"it is ended when they have ended, after {seconds:g} s at the latest"
    return f"{instance}, {because}, has {have}: {until}"


def goals_end_with(instance: str, actions: Sequence[str], *, planned: bool) -> Assessment:
    """The goals of a component with Midstride's API that has no successor beside it, or none with the API."""
    verb = "ended" if not planned else "end"
    words = f"goals of others that are under way at {listed(actions)}: they {verb} with {instance}"
    return Assessment(instance, "not_measurable", words)


def calls_end_with(instance: str, called: Sequence[str], *, planned: bool) -> Assessment:
    """The requests that a node has sent to services, and its goals of ROS actions, continue without it."""
    words = "they continue when it ends, and it gets no answer" if planned else "they continued, and it got no answer"
    words = f"requests and goals of {instance} that are under way at {listed(called)}: {words}"
    return Assessment(instance, "not_measurable", words)


def not_looked_at(instance: str, because: str) -> Assessment:
    """The services, ROS actions and other topics of a node without Midstride's API are not known."""
    words = f"what others rely on of {instance} besides its ports: {because}"
    return Assessment(instance, "not_measurable", words)


def management_unknown(instance: str, starting: Sequence[str], *, planned: bool) -> Assessment:
    """Say that it was unknown whether instances that were starting manage the lifecycle of one that is removed."""
    have = "had" if not planned else "has" if len(starting) == 1 else "have"
    words = (
        f"whether a lifecycle manager deactivates its nodes as {instance} {'ends' if planned else 'ended'}: "
        f"{listed(starting)} {have} just been started, and may be one"
    )
    return Assessment(instance, "not_measurable", words)


def management_not_seen(instance: str, *, planned: bool) -> Assessment:
    """Say that nothing told in time whether a lifecycle manager would notice the end of an instance."""
    words = (
        f"whether a lifecycle manager deactivates its nodes as {instance} {'ends' if planned else 'ended'}: what "
        f"answers for {instance} {'does' if planned else 'did'} not look at the graph in time"
    )
    return Assessment(instance, "not_measurable", words)


def will_end_with(node: str, words: str, instance: str, *, replaced: bool) -> Assessment:
    """A plan ends a process that has another node; ``words`` say what that does. ``replaced``: a new one is started."""
    again = "; whether the new instance has it is not known" if replaced else ""
    return Assessment(node, "lost", f"node {words} ends with {instance}, whose process it is in{again}")


def ended_with(node: str, words: str, instance: str, *, again: str | None, planned: bool) -> Assessment:
    """A node has ended with another one of its process. ``again``: the instance that has one of its name now."""
    if again is not None:
        found = f"what node {words} does: it ended with {instance}, and {again} has such a node"
        return Assessment(node, "not_measurable", f"{found}; for how long it did nothing is not measured")
    gone = f"node {words} ended with {instance}, and had not been started again when this was reported"
    return Assessment(node, "lost", gone, lasting=not planned)


def unknown_others(instance: str, because: str) -> Assessment:
    """The other nodes that end with an instance cannot be known."""
    return Assessment(instance, "not_measurable", f"which other nodes end with {instance}: {because}")


def two_writers(
    role: str, topics: Sequence[str], seconds: float | None = None, *, publishes: bool = True
) -> Assessment:
    """Both instances of a role write to topics that no port states, while both run (``seconds``, once measured).

    ``publishes``: the old one is known to publish there; False: or it subscribes.
    """
    time = "while both instances run" if seconds is None else f"for up to {seconds_in_words(seconds)}"
    verb = "could write" if seconds is not None else "write" if publishes else "may write"
    words = f"which instance writes on {listed(topics)}: no port of {role} states it, so both {verb} there {time}"
    return Assessment(role, "not_measurable", words)


def ended_half_done(
    instance: str,
    because: str,
    goes_on: str | None,
    seconds: float,
    found: Sequence[Assessment],
    values: Sequence[str] = (),
) -> str:
    """An instance was ended without a change that has a report: what that has cost, and what is not known of it.

    ``values``: what has become of those that were set on it, in words.
    """
    rest = "nothing of its role goes on" if goes_on is None else f"{goes_on} goes on"
    words = [f"stopped {instance}, {because}, within {seconds_in_words(seconds)}; {rest}"]
    words += values
    lost, unknown = split_by_verdict(found)
    if lost:
        words.append(f"lost: {sentences(lost)}")
    if unknown:
        words.append(f"not measurable here: {sentences(unknown)}")
    if not found:
        words.append("it wrote on no topic of a port, and nothing is known to have been lost with it")
    return "; ".join(words)


def handed_back(instance: str, topics: Sequence[str], goes_on: str | None) -> Assessment:
    """Topics on which an instance wrote until it was ended, and another one of its role did not."""
    since = "nothing of its role has since" if goes_on is None else f"only {goes_on} may since"
    words = (
        f"for how long {listed(topics)} {_is(topics)} silent: {instance} wrote there until it was ended, and {since}"
    )
    return Assessment(instance, "not_measurable", words)


def both_wrote(instance: str, other: str, topics: Sequence[str]) -> Assessment:
    """Two instances of a role could write on the same topics while no manager ran."""
    words = f"which instance wrote on {listed(topics)}: both {instance} and {other} could until the one was ended"
    return Assessment(instance, "not_measurable", words)


def values_lost(instance: str, values: Mapping[str, object]) -> Assessment:
    """Parameter values that were set on an instance while it ran, and that the one which goes on does not have."""
    found = ", ".join(f"{name} = {value!r}" for name, value in values.items())
    return Assessment(instance, "lost", f"what was set on {instance} while it ran: {found}")


def values_unknown(instance: str, words: str) -> Assessment:
    """Nothing shows which values were set on an instance while it ran."""
    return Assessment(instance, "not_measurable", words)


def silent_for_state(old: str, new: str, topics: Sequence[str], seconds: float) -> Assessment:
    """A plan moves the state of a node without Midstride's API, which cannot be held at a slot."""
    silent = f"nothing is published on {listed(topics)}, and " if topics else ""
    words = f"while the state of {old} moves to {new}, {silent}requests to its services wait, for at most {seconds:g} s"
    return Assessment(new, "lost", words, seconds=seconds, at_most=True)


def state_left_behind(old: str, new: str, because: str) -> Assessment:
    """A plan replaces a node that exports its state, and the state does not move."""
    return Assessment(new, "lost", f"the state of {old} is lost: {because}")


def was_silent_for_state(new: str, words: str, seconds: float) -> Assessment:
    """The state of a node without Midstride's API has moved, and nothing was published for so many ``seconds``."""
    return Assessment(new, "lost", words, seconds=seconds)


def state_lost(instance: str, goes_on: str | None) -> Assessment:
    """An instance that keeps a state has ended without passing it on."""
    rest = "no other has it" if goes_on is None else f"{goes_on} has its own"
    return Assessment(instance, "not_measurable", f"what has changed in the state of {instance}: {rest}")


def managed_end(instance: str, reasons: Sequence[str]) -> Assessment:
    """An instance was ended although a lifecycle manager may notice that."""
    words = f"whether a lifecycle manager deactivates its nodes as {instance} ended: {'; '.join(reasons)}"
    return Assessment(instance, "not_measurable", words)


# -- what a plan expects -------------------------------------------------------------------------------------------


def will_degrade(functionality: str) -> Assessment:
    """A plan lowers a functionality on the way or for good: the plan's own lines say how far, and why."""
    return Assessment(functionality, "lost", f"{functionality} degrades")


def will_be_inactive(topic: str, old: str, new: str, longest: float, back: float) -> Assessment:
    """A lifecycle node without a gate inside is deactivated before its successor is activated.

    The silence lasts ``longest`` seconds at most; ``back``, if the successor fails and the old one is activated again.
    """
    words = (
        f"{topic} is silent from the deactivation of {old} until {new} is active, {longest:g} s at the longest; if "
        f"that fails, until {old} is active again, {back:g} s at the longest"
    )
    return Assessment(topic, "lost", words)


def will_be_exchanged(role: str, because: str, *, side_by_side: bool, seconds: float) -> Assessment:
    """A node of which nothing measures what it does is going to be started and ended."""
    if side_by_side:
        words = f"what {role} does: {because}. The new instance has to be up before the old one is ended"
        return Assessment(role, "not_measurable", words)
    words = (
        f"{role} is down from the end of the old instance until the new one is up, about {seconds_in_words(seconds)}"
    )
    return Assessment(role, "lost", f"{words}; what it does is not measurable here: {because}")


def _is(words: Sequence[str]) -> str:
    return "was" if len(words) == 1 else "were"
