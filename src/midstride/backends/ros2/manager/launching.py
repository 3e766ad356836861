"""The environment that a component's process is started with."""

from __future__ import annotations

import os
import re
import sys
import sysconfig
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from midstride.backends import processes
from midstride.backends.common import drop_paths
from midstride.backends.ros2 import dds_profiles
from midstride.backends.ros2.dds_profiles import DdsSettings
from midstride.runtime.backend_protocol import Launch

# Set by the ROS wheels in an interpreter that they have started anew with their libraries' paths.
_BOOTSTRAPPED: Final = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"


def environment(
    launch: Launch, control: Path, program: str, settings: DdsSettings, base: Mapping[str, str]
) -> dict[str, str]:
    """The environment of a component's process: the manager's, without what would break another interpreter."""
    result, variables = dict(base), settings.variables
    if program != sys.executable:
        if result.pop(_BOOTSTRAPPED, None) is not None:
            if _is_linked_with_wheels(program):
                # The wheels' librcl needs the library of Python, too, which no wheel contains.
                result["LD_LIBRARY_PATH"] += f"{os.pathsep}{sysconfig.get_config_var('LIBDIR')}"
            else:
                # It finds its own libraries: those of the wheels in this interpreter's prefix would come first.
                drop_paths(result, "LD_LIBRARY_PATH", lambda path: not path or Path(path).is_relative_to(sys.prefix))
        # The Fast DDS that it will load may be another one than the manager's.
        major = dds_profiles.installed_major(Path(program).parent.parent)
        if major is not None and variables:
            variables = dds_profiles.choose(base, settings.middleware, major).variables
    # ROS 1 and ROS 2 on one path break each other's messages.
    drop_paths(result, "PYTHONPATH", lambda path: os.path.isdir(os.path.join(path, "rospy")))
    return {**result, **variables, **processes.identity(launch, "ros2", control)}


def _is_linked_with_wheels(program: str) -> bool:
    """Return whether ``program`` is compiled, and linked with a library that the ROS wheels have installed."""
    try:
        content = Path(program).read_bytes()
    except OSError:
        return False
    if not content.startswith(b"\x7fELF"):
        return False
    # The names of needed libraries are among the strings of the file.
    named = set(re.findall(rb"(?<=\0)lib[\w.+-]+\.so[.\d]*(?=\0)", content))
    return any((Path(sys.prefix) / "lib" / os.fsdecode(name)).exists() for name in named)
