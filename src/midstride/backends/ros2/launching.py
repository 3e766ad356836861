"""What a component's process is started with: its command and its environment."""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from midstride.backends.ros2 import tuning
from midstride.backends.ros2.tuning import Tuning
from midstride.errors import StartFailed
from midstride.runtime.backend import Launch
from midstride.wire.messages import ENV_BACKEND, ENV_INSTANCE, ENV_NAMESPACE, ENV_PARAMETERS, ENV_TOKEN

_OURS: Final = ("python", "python3")
# Set by the ROS wheels in an interpreter that they have started anew with their libraries' paths.
_BOOTSTRAPPED: Final = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"


def command(arguments: Sequence[str], directory: Path, environment: Mapping[str, str]) -> tuple[str, ...]:
    """The command with its program found. Raises StartFailed, naming what cannot be found.

    ``python`` and ``python3`` mean the interpreter that the manager runs in: there ROS and Midstride
    can be imported, whatever comes first on the PATH. Any other one is asked for by its path.
    """
    program, *rest = arguments
    if program in _OURS:
        return (sys.executable, *rest)
    if "/" in program:
        found = shutil.which(os.path.join(directory, program))
    else:
        found = shutil.which(program, path=environment.get("PATH"))
    if found is None:
        raise StartFailed(f"cannot start `{' '.join(arguments)}`: there is no program {program} that can be run")
    return (found, *rest)


def environment(launch: Launch, program: str, chosen: Tuning, base: Mapping[str, str]) -> dict[str, str]:
    """The environment of a component's process: the manager's, without what would break another interpreter."""
    result = dict(base)
    if program != sys.executable:
        _leave_own_wheels(result)
    _drop_ros1(result)
    result.update(_variables(program, chosen, base))
    result.update(
        {
            ENV_BACKEND: "ros2",
            ENV_INSTANCE: launch.instance,
            ENV_NAMESPACE: launch.namespace,
            ENV_TOKEN: launch.token,
            ENV_PARAMETERS: json.dumps(launch.parameters),
            "PYTHONUNBUFFERED": "1",
        }
    )
    return result


def _leave_own_wheels(environment: dict[str, str]) -> None:
    """Another interpreter finds its own libraries: those of the wheels in this one's prefix would come first."""
    if environment.pop(_BOOTSTRAPPED, None) is None:
        return
    paths = environment.get("LD_LIBRARY_PATH", "").split(os.pathsep)
    kept = [path for path in paths if path and not Path(path).is_relative_to(sys.prefix)]
    if kept:
        environment["LD_LIBRARY_PATH"] = os.pathsep.join(kept)
    else:
        environment.pop("LD_LIBRARY_PATH", None)


def _drop_ros1(environment: dict[str, str]) -> None:
    """ROS 1 and ROS 2 on one path break each other's messages."""
    paths = environment.get("PYTHONPATH")
    if paths is not None:
        kept = [path for path in paths.split(os.pathsep) if not os.path.isdir(os.path.join(path, "rospy"))]
        environment["PYTHONPATH"] = os.pathsep.join(kept)


def _variables(program: str, chosen: Tuning, base: Mapping[str, str]) -> Mapping[str, str]:
    """The tuning for the Fast DDS that ``program`` will load, which may be another one than the manager's."""
    major = None if program == sys.executable else tuning.installed_major(Path(program).parent.parent)
    if major is None or not chosen.variables:
        return chosen.variables
    return tuning.choose(base, chosen.middleware, major).variables
