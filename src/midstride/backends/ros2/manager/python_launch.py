"""Carries out a launch file in Python by ROS's own `launch`, in a process for it alone, and starts nothing.

Its arguments are the file, and a file that has as JSON what holds where the launch file is included, and is replaced by
what was found: the processes that would be started, what was left out, and what holds after it. Exit status 3 means
that `launch` or `launch_ros` cannot be imported.
"""

from __future__ import annotations

import asyncio
import json
import os
import sys
import traceback
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Final

from midstride.backends.ros2.manager.described_launch import DescribedLaunch, role_of
from midstride.backends.ros2.manager.harmless_launch import LeftOut, with_places, without_effect

NO_LAUNCH: Final = 3
_HARMLESS: Final = frozenset({"LogInfo", "SetROSLogDir"})
_AT_EXIT: Final = float("inf")  # when processes end, which is later than any time
# The transitions of a lifecycle node by their numbers in lifecycle_msgs/msg/Transition: name, start, while it lasts,
# goal.
_TRANSITIONS: Final = {
    1: ("configure", "unconfigured", "configuring", "inactive"),
    2: ("cleanup", "inactive", "cleaningup", "unconfigured"),
    3: ("activate", "inactive", "activating", "active"),
    4: ("deactivate", "active", "deactivating", "inactive"),
    5: ("shutdown", "unconfigured", "shuttingdown", "finalized"),
    6: ("shutdown", "inactive", "shuttingdown", "finalized"),
    7: ("shutdown", "active", "shuttingdown", "finalized"),
}

# What a launch file may raise; one that ends the interpreter is left out, and the others are carried out.
_RAISED: Final = (Exception, SystemExit)

# A file and a line.
Place = tuple[str, int]


class _Visitor:
    """Visits the actions of launch files as launch does; what would start a process is noted."""

    def __init__(self, given: dict[str, Any], file: str) -> None:
        import launch
        import launch.actions
        import launch_ros.actions
        from launch_ros.events.lifecycle import ChangeState

        self._launch: Any = launch
        self._actions: Any = launch.actions
        self._ros: Any = launch_ros.actions
        self._change_state: Any = ChangeState
        self.context: Any = launch.LaunchContext(noninteractive=True)
        self._description = DescribedLaunch(self.context, launch_ros.actions.Node)
        self.text = self._description.text
        self.context._set_asyncio_loop(asyncio.new_event_loop())
        configurations = self.context.launch_configurations
        configurations.update(given["variables"])
        if given["namespace"] is not None:
            configurations["ros_namespace"] = given["namespace"]
        if given["remaps"]:
            configurations["ros_remaps"] = [(old, new) for old, new in given["remaps"]]
        if given["parameters"]:
            configurations["global_params"] = [
                each if isinstance(each, str) else tuple(each) for each in given["parameters"]
            ]
        self._given = set(given["arguments"])
        self.processes: list[dict[str, Any]] = []
        self.left: list[tuple[str, str, str, int]] = []
        self.declared: list[str] = []
        self._place: Place = (file, 1)
        self._after: dict[str, Any] | None = None
        self._later: list[tuple[float, int, Any, dict[str, Any], Place]] = []
        self._missing: set[str] = set()
        self._labels: dict[int, str] = {}
        # The lifecycle nodes that are started, and what waits for a change of their states.
        self._lifecycle_nodes: list[tuple[Any, dict[str, Any]]] = []
        self._state_handlers: list[tuple[Any, Place]] = []
        self.files = 0
        # What follows the start or the end of an action that has not been carried out: kind, actions, locals, place.
        self._carried_out: set[int] = set()
        self._waiting: dict[int, list[tuple[str, Iterable[Any], dict[str, Any], Place]]] = {}

    def note(self, kind: str, message: str, place: Place | None = None) -> None:
        """A finding, at the action that is visited unless stated."""
        self.left.append((kind, message, *(place or self._place)))

    def note_package(self, name: str) -> None:
        """A package that is not here is named once."""
        if name not in self._missing:
            self._missing.add(name)
            self.note("package", f"package `{name}` is not here")

    # -- visiting --------------------------------------------------------------------------------------------

    def main(self, file: str) -> dict[str, Any]:
        """Carry out the file, and what it does later. Returns what holds right after it."""
        from launch.launch_description_sources import PythonLaunchDescriptionSource

        self._include(self._actions.IncludeLaunchDescription(PythonLaunchDescriptionSource(file)), self._given)
        configurations = dict(self.context.launch_configurations)
        state = {
            "namespace": configurations.pop("ros_namespace", None),
            "remaps": list(configurations.pop("ros_remaps", None) or ()),
            "parameters": [
                each if isinstance(each, str) else (each[0], str(each[1]))
                for each in configurations.pop("global_params", None) or ()
            ],
            "variables": {name: str(value) for name, value in configurations.items()},
            "environment": self._description.changes(os.environ),
        }
        while self._later:
            self._later.sort(key=lambda each: each[:2])
            time, _, actions, how, place = self._later.pop(0)
            self._after, self._place = {**how, "time": None if time == _AT_EXIT else time}, place
            self.context._push_locals()
            self.context.extend_locals(how["locals"])
            self._all(actions)
            self.context._pop_locals()
        for handler, place in self._state_handlers:
            message = f"what is done on an event (`{type(handler).__name__}`) that nothing here causes is left out"
            self.note("unsupported", message, place)
        return state

    def _all(self, entities: Iterable[Any] | None) -> None:
        for entity in entities or ():
            self._visit(entity)

    def _visit(self, entity: Any) -> None:
        outer, self._place = self._place, getattr(entity, "_midstride_place", self._place)
        try:
            self._carry_out(entity)
        except LeftOut as error:
            self.note(error.kind, str(error))
        except _RAISED as error:
            self.note("python", f"`{type(entity).__name__}` is left out: {_described(error)}")
        finally:
            self._carried_out.add(id(entity))
            if not isinstance(entity, self._actions.ExecuteLocal):
                for _, actions, variables, place in self._waiting.pop(id(entity), ()):
                    self._postpone(self._now(), f"when `{type(entity).__name__}` is done", actions, variables, place)
            self._place = outer

    def _carry_out(self, entity: Any) -> None:
        name = type(entity).__name__
        if name in _HARMLESS or (isinstance(entity, self._launch.Action) and not self._applies(entity)):
            return
        if isinstance(entity, self._actions.ExecuteLocal):
            self._process(entity)
        elif isinstance(entity, self._actions.IncludeLaunchDescription):
            self._include(entity)
        elif isinstance(entity, self._actions.DeclareLaunchArgument):
            self._declare(entity)
        elif isinstance(entity, self._actions.TimerAction):
            self._timer(entity)
        elif isinstance(entity, self._actions.RegisterEventHandler):
            self._handler(entity.event_handler)
        elif isinstance(entity, self._ros.LoadComposableNodes):
            self._load(entity)
        elif isinstance(entity, self._actions.Shutdown):
            self.note("unsupported", "`Shutdown` is left out: it would end all that was started")
        elif isinstance(entity, self._ros.SetUseSimTime):
            message = "`SetUseSimTime` sets the time of launch's own node, and of no other; it is left out"
            self.note("unsupported", message)
        elif isinstance(entity, self._actions.EmitEvent):
            self._send(entity.event)
        elif isinstance(entity, self._change_state):
            self._change(entity)
        elif isinstance(entity, self._actions.OpaqueCoroutine):
            self.note("unsupported", f"`{name}` in Python is left out")
        else:
            self._all(entity.visit(self.context))

    def _applies(self, action: Any) -> bool:
        try:
            return action.condition is None or bool(action.condition.evaluate(self.context))
        except Exception as error:
            raise LeftOut("condition", f"a condition has no known value: {_described(error)}") from None

    def _declare(self, argument: Any) -> None:
        self.declared.append(argument.name)
        try:
            argument.execute(self.context)
        except RuntimeError as error:
            raise LeftOut("argument", str(error)) from None

    def _include(self, entity: Any, given: Iterable[str] = ()) -> None:
        source = entity.launch_description_source
        try:
            description = source.get_launch_description(self.context)
        except _RAISED as error:
            file = str(source.location)
            where = _line_in(error, file)
            self.note("python" if where else "include", f"`{os.path.basename(file)}`: {_described(error)}", where)
            return
        self.files += 1
        file = entity._get_launch_file()
        self.context.extend_locals(
            {"current_launch_file_path": file, "current_launch_file_directory": entity._get_launch_file_directory()}
        )
        stated = [self.text(name) for name, _ in entity.launch_arguments]
        if missing := list(dict.fromkeys(self._required(description, {*stated, *given}))):
            self.declared += [argument.name for argument in description.get_launch_arguments()]
            for name in missing:
                self.note(
                    "argument", f"`{name}` of `{os.path.basename(file)}` has no value and no default; pass `{name}:=…`"
                )
            return
        for name, value in entity.launch_arguments:
            self.context.launch_configurations[self.text(name)] = self.text(value)
        if not any(hasattr(each, "_midstride_place") for each in description.entities):
            self._all(description.entities)  # of XML or YAML: the place is that of the action that includes it
            return
        outer, self._place = self._place, (file, 1)
        self._all(description.visit(self.context))
        self._place = outer

    @staticmethod
    def _required(description: Any, stated: set[str]) -> Iterator[str]:
        """The arguments that launch insists on before it begins."""
        for argument, including in description.get_launch_arguments_with_include_launch_description_actions():
            if argument._conditionally_included or argument.default_value is not None or argument.name in stated:
                continue
            for action in including or ():
                stated.update(action._try_get_arguments_names_without_context() or ())
            if argument.name not in stated:
                yield argument.name

    # -- later -----------------------------------------------------------------------------------------------

    def _postpone(
        self,
        time: float,
        how: str,
        actions: Iterable[Any],
        variables: dict[str, Any] | None = None,
        place: Place | None = None,
    ) -> None:
        """``variables``: launch's locals for the actions; these and the ``place`` are those of now unless stated."""
        after = {"how": how, "locals": dict(self.context.get_locals_as_dict()) if variables is None else variables}
        self._later.append((time, len(self._later), list(actions), after, place or self._place))

    def _now(self) -> float:
        if self._after is None:
            return 0.0
        return _AT_EXIT if self._after["time"] is None else float(self._after["time"])

    def _timer(self, timer: Any) -> None:
        from launch.utilities.type_utils import perform_typed_substitution

        period = float(perform_typed_substitution(self.context, timer.period, float))
        self._postpone(self._now() + period, f"{period:g} s later", timer.actions)

    def _handler(self, handler: Any) -> None:
        kind = type(handler).__name__
        actions = getattr(handler, "_OnActionEventBase__actions_on_event", None)
        target = getattr(handler, "_OnActionEventBase__action_matcher", None)
        label = self._labels.get(id(target), "a process")
        if kind == "OnShutdown":
            return self.note("unsupported", "what is done at the shutdown is left out")
        if kind == "OnStateTransition":
            return self._state_handlers.append((handler, self._place))
        if not actions or kind not in {"OnProcessExit", "OnProcessStart", "OnExecutionComplete"}:
            function = getattr(handler, "_OnActionEventBase__on_event", None)
            return self._function(function, f"on an event (`{kind}`) of `{label}`", self._event(kind, target))
        follow = (kind, actions, dict(self.context.get_locals_as_dict()), self._place)
        begun = self._labels if isinstance(target, self._actions.ExecuteLocal) else self._carried_out
        if isinstance(target, self._launch.Action) and id(target) not in begun:  # until then, if ever
            self._waiting.setdefault(id(target), []).append(follow)
        elif kind != "OnExecutionComplete":
            self._follow(label, *follow)
        else:
            self.note("unsupported", f"what follows the end of `{label}`, but is registered after it, is left out")
        return None

    def _follow(self, label: str, kind: str, actions: Iterable[Any], variables: dict[str, Any], place: Place) -> None:
        """Postpone what follows the start or the end of a process that is started now."""
        if kind in {"OnProcessExit", "OnExecutionComplete"}:
            self._postpone(_AT_EXIT, f"when `{label}` has ended", actions, variables, place)
        else:
            self._postpone(self._now(), f"when `{label}` has started", actions, variables, place)

    def _event(self, kind: str, action: Any) -> Any:
        """An event as launch would send it where all goes well; None for another kind."""
        from launch.events import process

        details = {
            "action": action,
            "name": self._labels.get(id(action), ""),
            "cmd": [],
            "cwd": None,
            "env": None,
            "pid": 1,
        }
        match kind:
            case "OnProcessExit":
                return process.ProcessExited(returncode=0, **details)
            case "OnProcessStart":
                return process.ProcessStarted(**details)
            case "OnExecutionComplete":
                from launch.events import ExecutionComplete

                return ExecutionComplete(action=action)
        return None

    def _function(self, function: Any, when: str, event: Any) -> None:
        """Name what a function would start: whether and when it does is for the function to decide."""
        code = getattr(function, "__code__", None)
        place = self._place
        if code is not None and not code.co_filename.startswith(os.path.dirname(self._launch.__file__) + os.sep):
            place = code.co_filename, code.co_firstlineno
        started: list[Any] = []
        if callable(function) and event is not None:
            try:
                found = function(event, self.context)
            except _RAISED as error:
                message = f"what a function does {when} is left out, and not known: {_described(error)}"
                return self.note("unsupported", message, place)
            started = list(found) if isinstance(found, (list, tuple)) else [] if found is None else [found]
        if not started:
            return self.note("unsupported", f"what a function does {when} is left out", place)
        for each in started:
            message = f"{self._named(each)}, which a function returns {when}, is left out"
            self.note("unsupported", message, getattr(each, "_midstride_place", place))
        return None

    def _named(self, entity: Any) -> str:
        """Name in words what an action would start."""
        try:
            if isinstance(entity, self._ros.Node):
                name = entity._Node__node_name
                program = f"`{self.text(entity.node_executable)}` of package `{self.text(entity.node_package)}`"
                return program if name is None else f"the node `{self.text(name)}` ({program})"
            if isinstance(entity, self._actions.ExecuteLocal):
                words = [self.text(word) for word in entity.process_description.cmd]
                return f"`{' '.join(words)}`"
        except Exception:  # what it needs is known when launch has begun it only
            pass
        return f"`{type(entity).__name__}`"

    # -- lifecycle -------------------------------------------------------------------------------------------

    def _send(self, event: Any) -> None:
        """Launch looks at an event when it has carried out what it is doing."""
        if isinstance(event, self._change_state):
            self._postpone(self._now(), "", [event])
        elif type(event).__name__ == "Shutdown":
            self.note("unsupported", "`EmitEvent` of `Shutdown` is left out: it would end all that was started")
        else:
            self.note("unsupported", f"`EmitEvent` of `{type(event).__name__}` in Python is left out")

    def _change(self, event: Any) -> None:
        """Take the nodes that are meant to another state, as where all goes well."""
        name, start, lasting, goal = _TRANSITIONS.get(event.transition_id, ("", "", "", ""))
        meant = [(node, found) for node, found in self._lifecycle_nodes if event.lifecycle_node_matcher(node)]
        if not meant or any(found["state"] != start for _, found in meant):
            of = ", ".join(f"`{role_of(node)}`, which is {found['state']}," for node, found in meant)
            what = f"`ChangeState` ({name or event.transition_id}) of {of or 'what is no lifecycle node here'}"
            self.note("unsupported", f"{what} is left out")
            return
        for node, found in meant:
            found["state"] = goal
            for entered in ((name, start, lasting), ("transition_success", lasting, goal)):
                self._state_changed(node, *entered)

    def _state_changed(self, node: Any, transition: str, start: str, goal: str) -> None:
        """Carry out what waits for this, once: launch would do it each time."""
        from launch_ros.events.lifecycle import StateTransition
        from lifecycle_msgs.msg import TransitionEvent

        message: Any = TransitionEvent()
        message.transition.label, message.start_state.label, message.goal_state.label = transition, start, goal
        event = StateTransition(action=node, msg=message)
        for entry in [each for each in self._state_handlers if each[0].matches(event)]:
            self._state_handlers.remove(entry)
            handler, place = entry
            entities = handler.entities
            actions = entities if isinstance(entities, (list, tuple)) else [entities]
            outer, self._place = self._place, place
            self._postpone(self._now(), f"when `{role_of(node)}` has become {goal}", actions)
            self._place = outer

    # -- processes -------------------------------------------------------------------------------------------

    def _process(self, action: Any) -> None:
        is_node = isinstance(action, self._ros.Node)
        own = type(action).__module__.partition(".")[0] not in {"launch", "launch_ros"}
        noted = len(self.processes)
        # A class of the user's does what it does; those of launch_ros would join ROS to follow the node.
        (type(action).execute if own or not is_node else self._ros.Node.execute)(action, self.context)
        if len(self.processes) == noted:  # the action has its own way to start something
            raise LeftOut("unsupported", f"`{type(action).__name__}` is left out: what it starts is not known")

    def started(self, action: Any) -> None:
        """Record what launch would start now, in place of `ExecuteLocal.__execute_process`."""
        found = {"place": self._place, "after": self._after_what(), **self._description.process(action)}
        if isinstance(action, self._ros.LifecycleNode):
            found["state"] = "unconfigured"
            self._lifecycle_nodes.append((action, found))
        label = self._labels[id(action)] = found["label"]
        for follow in self._waiting.pop(id(action), ()):
            self._follow(label, *follow)
        self.processes.append(found)
        self._on_exit(action, label)
        if type(action).__name__ == "ComposableNodeContainer":
            descriptions = action._ComposableNodeContainer__composable_node_descriptions
            self._components(descriptions, f"/{role_of(action)}")

    def _on_exit(self, action: Any, label: str) -> None:
        stated = getattr(action, "_ExecuteLocal__on_exit", None)
        actions = stated if isinstance(stated, (list, tuple)) else [stated]
        if stated is None:
            return
        if any(isinstance(each, self._actions.Shutdown) for each in actions):
            self.note("unsupported", f"`on_exit` of `{label}` is left out: it would end all when this process ends")
        elif all(isinstance(each, self._launch.LaunchDescriptionEntity) for each in actions):
            self._postpone(_AT_EXIT, f"when `{label}` has ended", actions)
        else:
            event = self._event("OnProcessExit", action)
            self._function(stated, f"when `{label}` has ended (`on_exit`)", event)

    def _load(self, action: Any) -> None:
        target = action._LoadComposableNodes__target_container
        if isinstance(target, self._ros.Node):
            name = f"/{role_of(target)}"
        else:
            name = self.text(target)
            if not name.startswith("/"):
                name = f"{self.context.launch_configurations.get('ros_namespace', '').rstrip('/')}/{name}"
        self._components(action._LoadComposableNodes__composable_node_descriptions, name)

    def _components(self, descriptions: Iterable[Any] | None, container: str) -> None:
        """Record the composable nodes that launch would have the ``container`` load."""
        for description in descriptions or ():
            condition = description.condition()
            if condition is None or condition.evaluate(self.context):
                place = getattr(description, "_midstride_place", self._place)
                found = self._description.component(description, container)
                self.processes.append({"place": place, "after": self._after_what(), **found})

    def _after_what(self) -> dict[str, Any] | None:
        """Return what launch waits for before it starts what comes now; None where it does not wait."""
        return None if self._after is None else {"how": self._after["how"], "time": self._after["time"]}


def _described(error: BaseException) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:400]


def _line_in(error: BaseException, file: str) -> Place | None:
    """The last line of the file that was carried out when the error was raised."""
    if isinstance(error, SyntaxError) and error.filename == file:
        return file, error.lineno or 1
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
    return (file, frames[-1].lineno or 1) if frames else None


def main(file: str, exchange: str) -> int:
    """The exit status."""
    try:
        import launch
        import launch_ros
    except ImportError as error:
        print(error, file=sys.stderr)
        return NO_LAUNCH
    given = json.loads(Path(exchange).read_text(encoding="utf-8"))
    visitor = _Visitor(given, file)
    with_places([os.path.dirname(os.path.abspath(str(each.__file__))) for each in (launch, launch_ros)], __file__)
    without_effect(visitor)
    state = visitor.main(file)
    found = {
        "processes": visitor.processes,
        "left": visitor.left,
        "declared": visitor.declared,
        "files": visitor.files,
        "state": state,
    }
    Path(exchange).write_text(json.dumps(found, default=str), encoding="utf-8")
    return 0


if __name__ == "__main__":
    status = main(*sys.argv[1:])
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)  # threads of the launch file's do not keep the process
