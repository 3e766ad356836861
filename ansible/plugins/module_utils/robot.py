"""The ``midstride`` command of a robot, and the results of the modules that call it.

Nothing here needs Ansible: ``parameters`` are those of a module, and the results are what it returns. The Python of a
robot may be older than Midstride's: 3.8 is enough.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
from typing import Any, Dict, List, NoReturn, Optional, Tuple  # noqa: UP035

Document = Dict[str, Any]  # noqa: UP006

# How long the command has to say what becomes of its request after it has been interrupted (s).
INTERRUPT_SECONDS = 5.0
# The exit status of the shell for a command that it may not run, and for one that it cannot find.
NOT_RUN = (126, 127)
# Reads the scripts before `--`, then becomes the command after it.
SHELL = 'while [ "$1" != -- ]; do . "$1" || exit 125; shift; done; shift; exec "$@"'

COMMON: Document = {
    "system": {"type": "str"},
    "executable": {"type": "str", "default": "midstride"},
    "setup": {"type": "list", "elements": "path", "default": []},
    "timeout": {"type": "float", "default": 600.0},
}
CHANGE: Document = {
    "strategy": {"type": "str", "default": "minimal", "choices": ["minimal", "paper", "quiesce", "stop"]},
    "detours": {"type": "bool", "default": False},
    "declared_parameters": {"type": "bool", "default": False},
    "with_other_nodes": {"type": "bool", "default": False},
    "wait": {"type": "float", "default": 5.0},
    "despite_lock": {"type": "bool", "default": False},
    "despite_requirements": {"type": "bool", "default": False},
    "verify": {"type": "bool", "default": False},
}
APPLY: Document = {
    "file": {"type": "path", "required": True},
    "keep_code": {"type": "bool", "default": False},
    "same_process": {"type": "bool", "default": False},
    **CHANGE,
    **COMMON,
}
ROLLBACK: Document = {"version": {"type": "int", "required": True}, **CHANGE, **COMMON}
STATUS: Document = {"watch": {"type": "float"}, "details": {"type": "bool", "default": False}, **COMMON}

# How a change ended that was not carried out, in words.
NOT_DONE = {
    "refused": "refused, nothing was changed",
    "rolled_back": "rolled back, every step undone",
    "failed": "failed, and could not be rolled back entirely",
    "incomplete": "done in part",
}
# Errors that a command ends with before the manager has begun a change. After others it may have made it.
NOTHING_CHANGED = ("ChangeForbidden", "NoManager", "PlanRefused", "SpecificationError", "UsageError")


class Failure(Exception):
    """Why a module fails, in a sentence; ``result``: what it returns besides."""

    def __init__(self, message: str, **result: Any) -> None:
        super().__init__(message)
        self.message = message
        self.result = result


class Robot:
    """Calls ``midstride`` for the system that the parameters of a module name. Raises Failure."""

    def __init__(self, parameters: Document) -> None:
        self.parameters = parameters
        for path in parameters["setup"]:
            if not os.path.isfile(path):
                raise Failure(f"setup: there is no file {path} on the robot")

    def ask(self, *words: str, seconds: float = 0.0) -> Tuple[int, Document]:  # noqa: UP006
        """The exit status of a command and its JSON document. Raises Failure where it has none, or is an error.

        ``seconds``: how long the command takes besides, when it is to wait.
        """
        status, out, err = self._run([*words, "--json"], seconds)
        try:
            document: Document = json.loads(out)
        except ValueError:
            said = (err or out).strip() or "nothing"
            command = f"`{self.parameters['executable']} {words[0]}`"
            raise Failure(f"{command} ended with status {status} without an answer in JSON, and said: {said}") from None
        if "error" in document:  # also of a change that was refused before it was asked for
            raise Failure(document["error"]["message"], error=document["error"]["kind"])
        return status, document

    def text(self, *words: str) -> str:
        """What a command prints for people."""
        return self._run(list(words), 0.0)[1]

    def _run(self, words: List[str], seconds: float) -> Tuple[int, str, str]:  # noqa: UP006
        """The exit status, standard output and standard error of a command. Raises Failure where it cannot be run."""
        executable, setup = self.parameters["executable"], self.parameters["setup"]
        command = [executable, *words]
        if self.parameters["system"] is not None:
            command += ["--system", self.parameters["system"]]
        if setup:
            command = ["bash", "-c", SHELL, "bash", *setup, "--", *command]
        try:
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                universal_newlines=True,
                start_new_session=True,
            )
        except OSError as error:
            raise Failure(_not_run(executable, str(error.strerror))) from None
        limit = self.parameters["timeout"]
        try:
            out, err = process.communicate(timeout=limit + seconds)
        except subprocess.TimeoutExpired:
            message = f"`midstride {words[0]}` had not ended after {limit:g} s, the `timeout`. {_interrupt(process)}"
            raise Failure(message, timed_out=True) from None
        if setup and process.returncode in NOT_RUN and not out:
            raise Failure(_not_run(executable, err.strip()))
        return process.returncode, out, err


def _not_run(executable: str, reason: str) -> str:
    return (
        f"{executable} cannot be run on the robot ({reason}): install Midstride there, or name its path with "
        "`executable`, or with `setup` the scripts that set PATH"
    )


def _interrupt(process: subprocess.Popen[str]) -> str:
    """Interrupt a command, as Ctrl-C does, and return what it says of the request that it has sent."""
    _signal(process, signal.SIGINT)
    try:
        said = process.communicate(timeout=INTERRUPT_SECONDS)[1].strip()
    except subprocess.TimeoutExpired:
        _signal(process, signal.SIGKILL)
        said = process.communicate()[1].strip()
    return said or "What becomes of its request is not known: `midstride log` shows it"


def _signal(process: subprocess.Popen[str], number: int) -> None:
    """Send a signal to a command and what it has started, unless all of that has just ended."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, number)


def apply(parameters: Document, check: bool = False, diff: bool = False) -> Document:
    """Bring the robot to the specification in a file: the result of ``midstride_apply``. Raises Failure."""
    words = ["apply", parameters["file"], *_flags(parameters, "keep_code", "same_process")]
    return _change(Robot(parameters), words, check, diff)


def rollback(parameters: Document, check: bool = False, diff: bool = False) -> Document:
    """Bring the robot back to a version: the result of ``midstride_rollback``. Raises Failure."""
    return _change(Robot(parameters), ["rollback", str(parameters["version"]), *_flags(parameters)], check, diff)


def status(parameters: Document, check: bool = False) -> Document:
    """The condition of the robot: the result of ``midstride_status``. Raises Failure for a fault in what is watched."""
    robot, watch = Robot(parameters), parameters["watch"]
    seconds = 0.0 if check or watch is None else watch
    document = robot.ask("status", *(["--for", f"{seconds:g}"] if seconds else []), seconds=seconds)[1]
    condition = document["condition"]
    result = {
        "changed": False,
        "system": document["system"],
        "condition": condition,
        "file": document["file"],
        "version": _version(robot),
    }
    if parameters["details"]:
        result["status"] = document
    if watch is not None and condition["state"] != "up":
        raise Failure(f"{document['system']} is {condition['headline']}", **result)
    return result


def _flags(parameters: Document, *more: str) -> List[str]:  # noqa: UP006
    """The options of a change, as words of the command line."""
    names = ("detours", "declared_parameters", "with_other_nodes", "despite_lock", "despite_requirements", "verify")
    words = ["--" + name.replace("_", "-") for name in (*names, *more) if parameters[name]]
    return [*words, "--strategy", parameters["strategy"], "--wait", f"{parameters['wait']:g}"]


def _change(robot: Robot, words: List[str], check: bool, diff: bool) -> Document:  # noqa: UP006
    """Plan a change, and carry it out where there is something to do."""
    plan = robot.ask(*words, "--dry-run")[1]
    changed = bool(plan["steps"]) or plan["start"] != plan["target"]
    result = {"changed": changed, "plan": _short(plan), "words": plan["continuity"]["headline"]}
    if diff and changed:
        result["diff"] = {"prepared": robot.text(*words, "--dry-run")}
    despite = robot.parameters["despite_lock"] or robot.parameters["despite_requirements"]
    if changed and "forbidden" in plan and not despite:
        raise Failure(f"it may not be carried out now: {plan['forbidden']}", **{**result, "changed": False})
    result["version_before"] = result["version"] = _version(robot)
    if changed and not check:
        try:
            exit_status, report = robot.ask(*words, "--yes")
        except Failure as failure:
            failure.result["changed"] = failure.result.get("error") not in NOTHING_CHANGED
            raise
        result.update(_reported(report))
        try:
            result["version"] = _version(robot)
        except Failure as failure:  # what became of the change is known all the same
            del result["version"]
            if exit_status == 0:
                failure.result = {**result, **failure.result}
                raise
        if exit_status != 0:
            _fail(report, result)
    return result


def _reported(report: Document) -> Document:
    """What the report of a change adds to the result."""
    if report.get("plan"):
        report["plan"] = _short(report["plan"])
    words = "Nothing was changed." if report.get("continuity") is None else report["continuity"]["headline"]
    return {"changed": report["outcome"] not in ("refused", "rolled_back"), "report": report, "words": words}


def _fail(report: Document, result: Document) -> NoReturn:
    """Raises Failure: the change was not carried out, or has left something worse than planned."""
    if report["outcome"] == "done":
        lasting = [each["words"] for each in report["continuity"]["found"] if each["lasting"]]
        raise Failure(f"done, but afterwards: {'; '.join(lasting)}", **result)
    ended = NOT_DONE.get(report["outcome"], str(report["outcome"]))
    raise Failure(f"{ended}: {report['because']}" if report.get("because") else ended, **result)


def _short(plan: Document) -> Document:
    """A plan without the specifications before and after it, which are most of it."""
    return {name: value for name, value in plan.items() if name not in ("start", "target")}


def _version(robot: Robot) -> Optional[int]:  # noqa: UP045
    """The number of the specification that is in force; None where the history has no change."""
    changes = robot.ask("history", "-n", "1")[1]["changes"]
    return int(changes[-1]["version"]) if changes else None
