"""Every exception Midstride raises on purpose.

    MidstrideError
    ├── SpecificationError      a specification is not well formed; carries every problem found
    ├── ActionRefused           an action's precondition does not hold; nothing has changed
    ├── PlanRefused             no plan meets the request; says why
    ├── NodeError               the author's API was used wrongly
    ├── Unanswered              a request of a client ends without a response
    ├── CommandRefused          a component refused a command of the manager (token, state)
    │   ├── RevisionChanged     it has changed since the manager last heard of it
    │   └── ImportRefused       it has not imported the state, and will not
    ├── BackendError            the platform below failed
    │   ├── StartFailed         a component did not start, register or match its declaration
    │   ├── CallTimeout         a component did not answer in time
    │   ├── Unreachable         a component or the middleware is gone
    │   └── ProtocolError       the other end of a control connection speaks something else
    ├── VerificationError       a question about safety could not be answered: neither yes nor no
    │   ├── AlloyMissing        there is no Alloy Analyzer, or no Java to run it
    │   ├── AlloyFailed         the Alloy Analyzer did not come to an answer
    │   └── SolverMissing       an SMT solver is not installed
    ├── StepFailed              a step of a running plan failed; the plan is rolled back
    └── ManagerError            the manager cannot do what was asked of it
        ├── ManagerBusy         another command is running
        ├── Superseded          another manager of the system has taken over
        ├── OtherVersion        the manager is of another version of Midstride, and has not what is asked for
        ├── OutcomeUnknown      nobody says whether what was asked for has been done
        ├── ChangeForbidden     no change may happen now, as while the system is locked
        └── NoManager           no manager of that system is running

This module imports nothing, so that every other one may import it.
"""

from __future__ import annotations


def internal_error(error: BaseException) -> str:
    """The message for the user of an unexpected exception, with all that it names, such as a file."""
    return f"internal error: {type(error).__name__}: {error}"


# What PyYAML raises besides its own errors: for a value that is not of the type that its tag states, for a date that
# does not exist, or for thousands of brackets.
NOT_OF_TAG = (ValueError, TypeError, AttributeError, LookupError, RecursionError)


class MidstrideError(Exception):
    """The base class of everything that Midstride raises on purpose. ``str(error)`` is a message for the user."""


class SpecificationError(MidstrideError):
    """A specification is not well formed. ``problems`` lists every independent fault found."""

    def __init__(self, problems: object) -> None:
        self.problems = tuple(problems) if isinstance(problems, (list, tuple)) else (problems,)
        super().__init__("\n".join(str(problem) for problem in self.problems))


class ActionRefused(MidstrideError):
    """An action's precondition does not hold (semantics.md section 4). Nothing has changed.

    ``reasons`` names the failed preconditions with the ports, functionalities and contracts
    on whose account they failed.
    """

    def __init__(self, action: str, reasons: tuple[object, ...]) -> None:
        self.action = action
        self.reasons = reasons
        because = "; ".join(str(reason) for reason in reasons)
        super().__init__(f"cannot {action}: {because}")


class PlanRefused(MidstrideError):
    """No plan takes the start to the target as asked; ``str`` of it says why."""


class NodeError(MidstrideError):
    """The author's API was used wrongly. The message says what is wrong, where, and what to write instead."""


class Unanswered(MidstrideError):
    """A request to a service ends without a response: its server has gone, or takes longer than its bound allows."""


class CommandRefused(MidstrideError):
    """A component refused a command, and nothing in it changed."""


class RevisionChanged(CommandRefused):
    """A component refused a command because it has changed since its last report. Observe it and retry."""


class ImportRefused(CommandRefused):
    """A node has not imported the state that it was given, and will not."""


class BackendError(MidstrideError):
    """The platform below (ROS, the simulator, the operating system) failed."""


class EndUnknown(BackendError):
    """A component was asked to end, and has not said whether it does: it may end at any time."""


class StartFailed(BackendError):
    """A component did not start, did not register in time, or is not what was declared."""


class CallTimeout(BackendError):
    """A component did not answer a command in time."""


class Unreachable(BackendError):
    """A component, or the middleware itself, is gone."""


class ProtocolError(BackendError):
    """The other end of a control connection does not speak this version of the protocol; says what it sent."""


class VerificationError(MidstrideError):
    """A question about safety could not be answered. That is neither a yes nor a no, and never a pass."""


class AlloyMissing(VerificationError):
    """There is no Alloy Analyzer, or no Java to run it; the message says how to get it."""


class AlloyFailed(VerificationError):
    """The Alloy Analyzer did not come to an answer: out of time, out of memory, or it did not take the text."""


class SolverMissing(VerificationError):
    """An SMT solver is not installed; the message says how to get it."""


class StepFailed(MidstrideError):
    """A step of a running plan failed.

    ``outcome`` is ``rolled_back`` once everything has been undone, and ``failed`` where that
    failed too; the message then says both.
    """

    def __init__(self, because: str, outcome: str = "failed") -> None:
        self.outcome = outcome
        super().__init__(because)


class ManagerError(MidstrideError):
    """The manager cannot do what was asked of it, and says why."""


class ManagerBusy(ManagerError):
    """Another command is running; the message says which, and since when."""


class OtherVersion(ManagerError):
    """The manager is of another version of Midstride: it has not what is asked for, or says it in another form."""


class Superseded(ManagerError):
    """Another manager of the system has taken over: this one must not change anything any more."""


class OutcomeUnknown(ManagerError):
    """The manager ended before it answered a command, which it may have begun, or carried out."""


class ChangeForbidden(ManagerError):
    """No change of the system may happen now; the message says why, by whose lock, and what to do."""


class NoManager(ManagerError):
    """No manager of that system is running."""
