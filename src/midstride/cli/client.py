"""The client of a manager's HTTP API over its Unix socket.

It uses the standard library alone: importing an HTTP library takes longer than most commands do. Answers come as the
API's forms, whose classes are imported when they are needed; what is sent, as documents.
"""

from __future__ import annotations

import http.client
import json
import socket
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar
from urllib.parse import urlencode

from midstride import errors
from midstride.codec.form import Document

if TYPE_CHECKING:
    from midstride.model.specification import Specification
    from midstride.runtime.records.change_history import History, SpecificationVersion
    from midstride.runtime.records.change_report import ChangeReport
    from midstride.runtime.records.reports import (
        DeadHost,
        DownReport,
        Event,
        LiveConfiguration,
        Outcome,
        PlannedChange,
        UpReport,
    )
    from midstride.runtime.records.status_forms import ChangeLock, ParametersReport, ProgramStatus, Service, Status, Why

F = TypeVar("F")

# Requests that only read are answered at once, or something is wrong (s).
READ_TIMEOUT = 10.0
# How often a connection is tried again where too many wait to be accepted (s).
_CONNECT_INTERVAL = 0.02


class _UnixConnection(http.client.HTTPConnection):
    def __init__(self, path: Path, timeout: float | None) -> None:
        super().__init__("localhost")
        self._path = path
        self._timeout = timeout

    def connect(self) -> None:
        """Raises OSError; TimeoutError also where too many connections wait to be accepted for so long."""
        self.sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.sock.settimeout(self._timeout)
        deadline = None if self._timeout is None else time.monotonic() + self._timeout
        while True:
            try:
                return self.sock.connect(str(self._path))
            except BlockingIOError:  # at once, whatever the time-out
                if deadline is not None and time.monotonic() >= deadline:
                    raise TimeoutError from None
            time.sleep(_CONNECT_INTERVAL)


@dataclass(frozen=True)
class _Request:
    """``begin`` is called right before the first byte is sent; where it raises, the manager is not asked."""

    method: str
    path: str
    document: Document | None = None
    timeout: float | None = READ_TIMEOUT
    begin: Callable[[], object] = lambda: None


class Client:
    """Talks to one manager.

    Raises NoManager if none is running, MidstrideError if this user may not connect to it, and the manager's own
    errors by their kind.
    """

    def __init__(self, path: Path) -> None:
        self._socket = path

    def text(self, path: str, timeout: float | None = READ_TIMEOUT, **query: Any) -> str:
        """The answer to a request for a text."""
        return self._answer(_Request("GET", _with_query(path, query), timeout=timeout)).decode()

    def answers(self, timeout: float = 2.0) -> bool:
        """Return whether a manager answers in time."""
        try:
            self._answer(_Request("GET", "", timeout=timeout))
        except errors.ManagerError:
            return False
        return True

    def service(self) -> Service | None:
        """The manager's description of itself; None if no manager answers in time."""
        from midstride.runtime.records.status_forms import Service

        try:
            return self._form(Service, "GET", "", timeout=2.0)
        except errors.ManagerError:
            return None

    def activity(self) -> str | None:
        """The work of a manager of any version, in words; None if it has none, or does not say so."""
        try:
            service, view = (json.loads(self._answer(_Request("GET", path))) for path in ("", "/view"))
            if service.get("phase") == "starting":
                return "is still bringing it up"
            running = view.get("running")
            return None if not running else f"carries out `{running['command']}`"
        except (errors.MidstrideError, ValueError, KeyError, TypeError, AttributeError):
            return None

    def status(self) -> Status:
        """The running system: the live view, without the change in it."""
        from midstride.runtime.records.status_forms import Status

        return self._form(Status, "GET", "/view")

    def programs(self) -> list[ProgramStatus]:
        """The files of the programs that run, and which of them have changed on disk since."""
        from midstride.runtime.records.status_forms import ProgramStatus

        return self._form(list[ProgramStatus], "GET", "/programs")

    def why(self, functionality: str) -> Why:
        """The reason why a functionality is in its mode. Raises PlanRefused for an unknown one."""
        from midstride.runtime.records.status_forms import Why

        return self._form(Why, "GET", _with_query("/why", {"functionality": functionality}))

    def parameters(self, node: str | None = None) -> list[ParametersReport]:
        """The parameters of a role or an instance, or of all, as the nodes say them now."""
        from midstride.runtime.records.status_forms import ParametersReport

        return self._form(list[ParametersReport], "GET", _with_query("/parameters", {"node": node}))

    def set_parameters(
        self,
        node: str,
        values: Mapping[str, Any],
        *,
        by: str,
        id: str | None = None,
        despite_lock: bool = False,
        despite_requirements: bool = False,
        begin: Callable[[], object] = lambda: None,
    ) -> ParametersReport:
        """Set parameters of a role or an instance, once the commands before are done; all of them or none.

        ``id`` and ``begin`` as for a change.
        """
        from midstride.codec.parameter import json_values
        from midstride.runtime.records.status_forms import ParametersReport

        setting: Document = {"node": node, "parameters": json_values(values), "by": by, "id": id}
        setting |= {"despite_lock": despite_lock, "despite_requirements": despite_requirements}
        return self._form(ParametersReport, "POST", "/parameters", setting, timeout=None, begin=begin)

    def specification(self) -> Specification:
        """The specification that the system runs."""
        from midstride.codec.specification_form import SpecificationForm

        return self._form(SpecificationForm, "GET", "/specification").specification()

    def earlier_specification(self, version: int | None) -> SpecificationVersion:
        """A version of the specification; None: the one before the latest change of it."""
        from midstride.runtime.records.change_history import SpecificationVersion

        return self._form(SpecificationVersion, "GET", _with_query("/specification/earlier", {"version": version}))

    def history(self, latest: int) -> History:
        """The latest changes, and the incidents since the first of them."""
        from midstride.runtime.records.change_history import History

        return self._form(History, "GET", _with_query("/history", {"latest": latest}))

    def change_report(self, number: int | None) -> ChangeReport:
        """Change ``number`` of the history with all that was recorded of it; None: the latest."""
        from midstride.runtime.records.change_report import ChangeReport

        return self._form(ChangeReport, "GET", _with_query("/change", {"number": number}))

    def configuration(self) -> LiveConfiguration:
        """The configuration as its components report it."""
        from midstride.runtime.records.reports import LiveConfiguration

        return self._form(LiveConfiguration, "GET", "/configuration")

    def up(self) -> UpReport:
        """The result of bringing the system up; waits until it is known."""
        from midstride.runtime.records.reports import UpReport

        return self._form(UpReport, "GET", "/up", timeout=None)

    def plan(self, request: Document) -> PlannedChange:
        """The plan for a request, however long it takes."""
        from midstride.runtime.records.reports import PlannedChange

        return self._form(PlannedChange, "POST", "/plan", _stated(request), timeout=None)

    def change(self, change: Document, begin: Callable[[], object] = lambda: None) -> Outcome:
        """Carry out a change, and wait until it has been measured.

        ``begin`` is called right before the first byte is sent; where it raises, the manager is not asked.
        """
        from midstride.runtime.records.reports import Outcome

        change = {**_stated(change), "request": _stated(change["request"])}
        return self._form(Outcome, "POST", "/change", change, timeout=None, begin=begin)

    def down(self, id: str | None = None, begin: Callable[[], object] = lambda: None) -> DownReport:
        """End every component, and then the manager. ``id`` and ``begin`` as for a change."""
        from midstride.runtime.records.reports import DownReport

        return self._form(DownReport, "POST", _with_query("/down", {"id": id}), None, None, begin)

    def lock(
        self,
        reason: str,
        by: str,
        until: float | None,
        *,
        holds_recovery: bool,
        begin: Callable[[], object] = lambda: None,
    ) -> ChangeLock:
        """Lock the system until it is unlocked, or until then (unix s). ``begin`` as for a change."""
        from midstride.runtime.records.status_forms import ChangeLock

        lock = {"reason": reason, "by": by, "until": until, "holds_recovery": holds_recovery}
        return self._form(ChangeLock, "POST", "/lock", lock, begin=begin)

    def unlock(self, by: str, begin: Callable[[], object] = lambda: None) -> ChangeLock:
        """End the lock of the system. ``begin`` as for a change."""
        from midstride.runtime.records.status_forms import ChangeLock

        return self._form(ChangeLock, "POST", "/unlock", {"by": by}, begin=begin)

    def declare_dead(self, host: str, by: str) -> DeadHost:
        """Say that ``host``, which cannot be reached, is dead."""
        from midstride.runtime.records.reports import DeadHost

        return self._form(DeadHost, "POST", "/dead", {"host": host, "by": by})

    def log(self) -> list[Event]:
        """The events so far that the manager has kept."""
        from midstride.runtime.records.reports import Event

        return self._form(list[Event], "GET", "/log")

    def events(self, since: int = 0) -> Iterator[Event]:
        """The events after number ``since`` and each new one, until the manager closes the stream or exits."""
        import msgspec

        from midstride.runtime.records.reports import Event

        connection = _UnixConnection(self._socket, None)
        try:
            response = self._send(connection, _Request("GET", f"/view/stream?only=event&since={since}"))
            while line := response.readline():
                if line.startswith(b"data: "):
                    yield msgspec.json.decode(line[len(b"data: ") :], type=Event)
        except (OSError, http.client.HTTPException):  # the manager was killed
            return
        except msgspec.ValidationError as error:
            raise _of_another_version(error) from None
        finally:
            connection.close()

    def _form(
        self,
        form: type[F],
        method: str,
        path: str,
        document: Document | None = None,
        timeout: float | None = READ_TIMEOUT,
        begin: Callable[[], object] = lambda: None,
    ) -> F:
        """The answer, which has that form. Raises ManagerError where it has another one, as of another version."""
        import msgspec

        answer = self._answer(_Request(method, path, document, timeout, begin))
        try:
            return msgspec.json.decode(answer, type=form)
        except msgspec.ValidationError as error:
            raise _of_another_version(error) from None
        except msgspec.DecodeError as error:
            raise self._unanswered(error, method, path) from None

    def _unanswered(self, error: Exception, method: str, path: str) -> errors.ManagerError:
        reason = str(error) or type(error).__name__
        log = self._socket.parent / "logs" / "manager.log"
        words = f"the manager exited before it answered ({reason})"
        if method == "GET" or path == "/plan":
            return errors.ManagerError(f"{words}; see {log}")
        then = "what was asked for may have begun, or be done: `midstride up FILE` finishes it or takes it back"
        return errors.OutcomeUnknown(f"{words}, and {then}; see {log}")

    def _answer(self, request: _Request) -> bytes:
        connection = _UnixConnection(self._socket, request.timeout)
        try:
            return self._send(connection, request).read()
        except TimeoutError:
            raise errors.ManagerError(f"the manager did not answer within {request.timeout:g} s") from None
        except (OSError, http.client.HTTPException) as error:
            raise self._unanswered(error, request.method, request.path) from None
        finally:
            connection.close()

    def _send(self, connection: _UnixConnection, request: _Request) -> http.client.HTTPResponse:
        try:
            connection.connect()
        except (FileNotFoundError, ConnectionRefusedError):
            name = self._socket.parent.name
            raise errors.NoManager(f"no manager of {name} is running; start one with `midstride up FILE`") from None
        except PermissionError:
            raise errors.MidstrideError(
                f"this user may not connect to {self._socket}: run the command as the user that runs the manager"
            ) from None
        except TimeoutError:
            raise
        except OSError as error:
            raise errors.ManagerError(f"the manager cannot be reached: {error.strerror or error}") from None
        body = None if request.document is None else json.dumps(request.document)
        headers = {"Content-Type": "application/json"} if body else {}
        request.begin()
        connection.request(request.method, f"/api/v1{request.path}", body, headers)
        response = connection.getresponse()
        if response.status >= 400:
            raise _error(response.read())
        return response


# What to do about a manager that has not the API that is used here.
_OTHER_VERSION = (
    "another version of Midstride has started the manager. `midstride up FILE --replace-manager` has this version "
    "manage the system, and its components keep running; or use the `midstride` of that version"
)


def _of_another_version(error: Exception) -> errors.OtherVersion:
    return errors.OtherVersion(f"cannot read the manager's answer ({error}): {_OTHER_VERSION}")


def _stated(request: Document) -> Document:
    """A request without what is False or an empty object, which is the default of all that may be either.

    An earlier version may not know it.
    """
    return {name: value for name, value in request.items() if value is not False and value != {}}


def _with_query(path: str, query: Mapping[str, Any]) -> str:
    """The path with what of the query is not None."""
    stated = {name: value for name, value in query.items() if value is not None}
    return f"{path}?{urlencode(stated)}" if stated else path


# Errors that are constructed from their message alone.
_KINDS = (
    errors.PlanRefused,
    errors.StepFailed,
    errors.CommandRefused,
    errors.BackendError,
    errors.StartFailed,
    errors.CallTimeout,
    errors.Unreachable,
    errors.ManagerBusy,
    errors.NoManager,
)


def _error(body: bytes) -> errors.MidstrideError:
    """The error in an answer of the manager."""
    try:
        document = json.loads(body)["error"]
        kind, message = str(document["kind"]), str(document["message"])
    except (ValueError, KeyError, TypeError):
        return errors.ManagerError(f"unexpected answer from the manager: {body[:200]!r}")
    if kind == "NoOperation":
        return errors.OtherVersion(f"{message}: {_OTHER_VERSION}")
    if kind == "SpecificationError":
        problems = document.get("problems") or [message]
        if any("a request has no key" in str(problem) for problem in problems):
            return errors.OtherVersion(f"{'; '.join(map(str, problems))}: {_OTHER_VERSION}")
        return errors.SpecificationError(problems)
    return next((error(message) for error in _KINDS if error.__name__ == kind), errors.ManagerError(message))
