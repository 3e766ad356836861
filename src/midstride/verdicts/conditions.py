"""The condition of a system: what runs, what is missing or worse than it should be, and the exit status."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Final, Literal, TypeAlias

from msgspec import Meta, structs

from midstride.codec.form import Form
from midstride.model.wording import counted
from midstride.verdicts.assessment import listed, some_of

ConditionState: TypeAlias = Literal["up", "degraded", "down"]

# The exit status of `up` and `status`: all is up, nothing runs, or something is missing or worse than it should be.
EXIT_STATUS: Final[Mapping[ConditionState, int]] = {"up": 0, "down": 1, "degraded": 3}
# An output that writes less than this part of the rate that it guarantees is a fault. One that writes more is named,
# and no fault in itself: a busy machine may be the reason.
FAULTY_PART: Final = 0.5


class SystemCondition(Form, frozen=True, omit_defaults=False, forbid_unknown_fields=False):
    """The condition of a system: `degraded` where anything is missing or worse than it should be.

    It is about the components. Whether a configuration is valid is a word about the manager's model.
    """

    state: ConditionState
    headline: str
    faults: Annotated[list[str], Meta(description="what is missing or worse than it should be")] = []
    unknown: Annotated[list[str], Meta(description="what is not measurable here")] = []
    slow: Annotated[list[str], Meta(description="outputs somewhat below the rates that they guarantee: no faults")] = []

    @property
    def besides(self) -> str:
        """The rest of the headline: rates, and what is not measurable."""
        rates = [f"below its rate: {some_of(self.slow)}"] if self.slow else []
        return "; ".join([*rates, *([f"not measurable here: {'; '.join(self.unknown)}"] if self.unknown else [])])


def system_condition(
    nodes: int,
    running: int,
    faults: Sequence[str],
    unknown: Sequence[str] = (),
    *,
    answering: int | None = None,
    unreachable: int = 0,
    slow: Sequence[str] = (),
) -> SystemCondition:
    """Return what may be said of a system of so many ``nodes``, of which ``running`` have an instance that runs.

    ``answering`` of them answer, if not all of them do. ``unreachable``: how many others are on hosts that cannot be
    reached, so that nothing is known of them. ``faults``: what is missing or worse than it should be.
    """
    if nodes and not running and not unreachable:
        return SystemCondition("down", f"down: none of its {counted(nodes, 'node')} runs", [*faults], [*unknown])
    run = f"{running} of {counted(nodes, 'node')} {'run' if nodes != 1 else 'runs'}"
    if running == nodes:
        run = f"all {nodes} nodes run" if nodes > 1 else "its node runs" if nodes else "it has no nodes"
    if answering is not None and answering < running:
        run += f", {running - answering} of them without an answer"
    if unreachable:
        run += f", and whether {unreachable} more {'do' if unreachable > 1 else 'does'} is not known"
    reasons = f": {some_of(faults)}" if faults else ""
    state: ConditionState = "degraded" if faults or running < nodes else "up"
    found = SystemCondition(state, f"{state}, {run}{reasons}", [*faults], [*unknown], [*slow])
    return structs.replace(found, headline=f"{found.headline}; {found.besides}") if found.besides else found


def is_missing(role: str, because: str) -> str:
    """An instance of ``role`` has exited without being asked to, or could not be started, ``because`` of what."""
    if not because:
        return f"{role} does not run any more"
    return because if because.startswith(role) else f"{role}: {because}"


def cannot_be_reached(host: str, instances: Sequence[str]) -> str:
    """A host with instances cannot be reached."""
    return f"host {host} cannot be reached, so nothing is known of {some_of(instances)}"


def crashes_again(role: str, number: int, window: float, because: str) -> str:
    """A node that runs has been restarted so often in the last ``window`` (s) during which it ran."""
    return f"{role} has been restarted {number} times in {window:g} s of running, the last time as {because}"


def does_not_run(role: str) -> str:
    """A node of the specification has no instance, and none has exited: it is started by hand, or not yet."""
    return f"{role} does not run"


def waits(instance: str, reason: str) -> str:
    """An instance waits, as for the clock of a simulation."""
    return f"{instance} is waiting: {reason}"


def is_in_mode(functionality: str, mode: str) -> str:
    """A functionality is in a worse mode than the specification provides."""
    return f"{functionality} is in mode {mode}"


def is_not_attached(port: str, topic: str) -> str:
    """A port is not attached to a topic, service or ROS action to which the specification attaches it."""
    return f"{port} is not attached to {topic}"


def writes_less(port: str, rate: float | None, declared: float | None) -> str:
    """An output does not keep the rate (Hz) that it guarantees, as measured over a whole window."""
    found = "nothing" if not rate else f"{rate:.3g} Hz"
    return f"{port} writes {found}, and guarantees {declared or 0.0:.3g} Hz"


def is_far_below(rate: float | None, declared: float | None) -> bool:
    """Return whether an output writes so little of the rate (Hz) that it guarantees that this is a fault."""
    return (rate or 0.0) < FAULTY_PART * (declared or 0.0)


def not_yet_judged(ports: Sequence[str]) -> str:
    """Outputs whose rates have not been measured over a whole window yet."""
    return f"Not known yet: {whether_kept(ports)}"


def whether_kept(ports: Sequence[str]) -> str:
    return f"whether {listed(ports)} {'keeps its rate' if len(ports) == 1 else 'keep their rates'}"
