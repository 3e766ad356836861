"""The wording of actions and counts: the same wherever one is shown, in a plan, a report, a refusal or a proof.

Plain strings go in, since what is shown is sometimes an action, sometimes a step of a JSON document.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final, NamedTuple

from midstride.model.contract import ConnectorKind


class KindWords(NamedTuple):
    """The words for a connector of one kind, and for what is attached to it."""

    connector: str
    output: str
    input: str
    provider: str
    user: str


KIND_WORDS: Final[Mapping[ConnectorKind, KindWords]] = {
    "topic": KindWords("topic", "output", "input", "publisher", "subscriber"),
    "service": KindWords("service", "server", "client", "server", "client"),
    "action": KindWords("ROS action", "action server", "action client", "action server", "action client"),
}


def indefinite(noun: str) -> str:
    """The noun with its indefinite article: ``a server``, ``an output``."""
    return f"{'an' if noun[0] in 'aeio' else 'a'} {noun}"


def existence(kind: str, instance: str, component: str = "", host: str = "") -> str:
    """``create camera_2 (BetterCamera)``, ``create gripper_2 (Gripper) on arm``, ``remove camera``"""
    return f"{kind} {instance}" + (f" ({component})" if component else "") + (f" on {host}" if host else "")


def attachment(kind: str, port: str, topic: str) -> str:
    """``attach camera.image to /image``, ``detach camera.image from /image``"""
    return f"{kind} {port} {'to' if kind == 'attach' else 'from'} {topic}"


def mode_changes(kind: str, changes: Iterable[tuple[str, str | None, str]]) -> str:
    """``degrade viewer.show from normal to degraded``, for each functionality, its mode if known, and the next."""
    parts = [
        f"{name} to {after}" if before is None else f"{name} from {before} to {after}"
        for name, before, after in changes
    ]
    return f"{kind} {', '.join(parts) or 'nothing'}"


def handover(swaps: Iterable[tuple[str, str, str]]) -> str:
    """``hand over /image from camera.image to camera_2.image``, for each topic, its old and its new output."""
    return f"hand over {', '.join(swap(*each) for each in swaps) or 'nothing'}"


def swap(topic: str, old: str, new: str) -> str:
    """``/image from camera.image to camera_2.image``"""
    return f"{topic} from {old} to {new}"


def lowered(functionality: str, mode: str | None, instead_of: str | None) -> str:
    """``viewer.show is in mode degraded instead of normal``; without a mode, no instance serves it."""
    return (
        f"no instance serves {functionality}"
        if mode is None
        else f"{functionality} is in mode {mode} instead of {instead_of}"
    )


def parameters(instance: str, values: Mapping[str, object]) -> str:
    """``set gain = 2.0, label = 'left' on filter``"""
    return f"set {', '.join(f'{name} = {value!r}' for name, value in sorted(values.items()))} on {instance}"


def exited(status: int | None) -> str:
    """``exited with status 1``, ``was killed by signal 9``; ``ended`` where the status is not known."""
    if status is None:
        return "ended"
    return f"was killed by signal {-status}" if status < 0 else f"exited with status {status}"


def exception_in(text: str) -> str | None:
    """The last exception that the log of a program in Python or C++ shows, as ``ValueError: no input``."""
    found, in_traceback = None, False
    for line in text.splitlines():
        words = line.strip()
        if "Traceback (most recent call last):" in line:
            in_traceback = True
        elif in_traceback and words and not line[0].isspace():
            found, in_traceback = words, False
        elif words.startswith("what():"):
            found = words.removeprefix("what():").strip()
    return found


def with_log(how: str, log: str) -> str:
    """``camera exited with status 1: ValueError: no input``, and below it the end of its log, which is ``log``."""
    exception = exception_in(log)
    return f"{how}{'' if exception is None else f': {exception}'}{'' if exception else ':'}\n{log.strip()}"


# What follows where a process was killed, and where its `on_stop` has failed.
LOST_AT_END: Final = "what it does at its end is lost"


def killed(instance: str, seconds: float) -> str:
    """``camera had not ended 3 s after it was asked to, and was killed (SIGKILL)``"""
    return f"{instance} had not ended {seconds:g} s after it was asked to, and was killed (SIGKILL)"


def counted(count: int, what: str) -> str:
    """``1 step``, ``2 steps``."""
    return f"{count} {what}" if count == 1 else f"{count} {what}s"
