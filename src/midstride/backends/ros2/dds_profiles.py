"""Discovery and transports for a system whose processes come and go; and whether the settings took effect.

The defaults of Fast DDS keep a killed process in the graph for 20 s, lose first replies over shared
memory, and acknowledge what a reliable writer has sent after up to 3 s. For the processes that
Midstride starts, and for the manager itself, the profiles beside this file say otherwise, unless the
user has set something of their own. Three things are easily got wrong, hence so much care:

- Fast DDS 3 reads the profile named by one variable, Fast DDS 2 by another, in another spelling, and
  each is silent about, or complains of, what is meant for the other.
- Under ``ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST`` rmw_fastrtps replaces all transports, shared
  memory included, whatever the environment asks for. A profile of its own does what that setting
  does, with sockets alone, and the setting is taken back.
- A profile is read once in a process, when its first node is made: later is too late.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

PROFILES: Final = Path(__file__).parent / "profiles"
TRANSPORTS: Final = "FASTDDS_BUILTIN_TRANSPORTS"
RANGE: Final = "ROS_AUTOMATIC_DISCOVERY_RANGE"

# The major version of Fast DDS: the variable that names its profile.
PROFILE_VARIABLES: Final = {3: "FASTDDS_DEFAULT_PROFILES_FILE", 2: "FASTRTPS_DEFAULT_PROFILES_FILE"}
_LIBRARIES: Final = {3: "libfastdds.so", 2: "libfastrtps.so"}
_FAST_DDS: Final = frozenset({"rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp"})
_IN_OPEN: Final = 0x20  # inotify: somebody opened the file

# The profile that this process has been seen to read: Fast DDS keeps it for good, and so it is kept here.
_read: set[str] = set()


@dataclass(frozen=True, slots=True)
class Tuning:
    """What is set in the environment of the processes Midstride starts, and what stays untuned, in words."""

    middleware: str
    variables: Mapping[str, str] = field(default_factory=dict)
    untuned: tuple[str, ...] = ()

    @property
    def profile(self) -> str | None:
        return next((self.variables[name] for name in PROFILE_VARIABLES.values() if name in self.variables), None)


def choose(environment: Mapping[str, str], middleware: str, major: int | None) -> Tuning:
    """What to set, given what the user has set. ``major``: the version of Fast DDS, None where it is not known."""
    if middleware not in _FAST_DDS:
        return Tuning(
            middleware,
            untuned=(f"discovery: {middleware} is left as it comes, and may show a killed process for long",),
        )
    if major is None:
        return Tuning(middleware, untuned=("discovery: which Fast DDS this is cannot be told",))
    own = [name for name in PROFILE_VARIABLES.values() if environment.get(name)]
    if any(Path(environment[name]).parent == PROFILES for name in own):
        return Tuning(middleware)  # tuned already: this process was started by Midstride
    if own:
        return Tuning(middleware, untuned=(f"discovery: your own profile ({own[0]}) counts",))
    transports = environment.get(TRANSPORTS)
    if transports is None and _on_this_host_alone(environment):
        profile = PROFILES / f"fastdds{major}_localhost.xml"
        return Tuning(middleware, {PROFILE_VARIABLES[major]: str(profile), RANGE: "SYSTEM_DEFAULT"})
    variables = {PROFILE_VARIABLES[major]: str(PROFILES / f"fastdds{major}_subnet.xml")}
    if transports is not None:
        return Tuning(middleware, variables, (f"transports: your own {TRANSPORTS}={transports} counts",))
    return Tuning(middleware, {**variables, TRANSPORTS: "UDPv4?sockets_size=4MB"})


def _on_this_host_alone(environment: Mapping[str, str]) -> bool:
    """Peers of the user's own, and the old variable of the same meaning, are understood by rmw_fastrtps alone."""
    if environment.get("ROS_STATIC_PEERS") or environment.get("ROS_LOCALHOST_ONLY") == "1":
        return False
    return environment.get(RANGE, "").upper() == "LOCALHOST"


def of_this_process() -> Tuning:
    """What to set for this process and those like it. Imports rclpy, and so loads the middleware."""
    from rclpy.utilities import get_rmw_implementation_identifier

    middleware = str(get_rmw_implementation_identifier())
    return choose(os.environ, middleware, loaded_major())


def tuned_environment(environment: Mapping[str, str]) -> dict[str, str]:
    """``environment`` as a component's process would get it, for others on the same footing (recorders, benchmarks)."""
    return {**environment, **choose(environment, of_this_process().middleware, loaded_major()).variables}


def loaded_major() -> int | None:
    """The version of the Fast DDS that this process has loaded."""
    with open("/proc/self/maps", encoding="utf-8", errors="replace") as file:
        maps = file.read()
    return next((major for major, library in _LIBRARIES.items() if f"/{library}" in maps), None)


def installed_major(prefix: Path) -> int | None:
    """The version of the Fast DDS that is installed under ``prefix``, as the wheels do it."""
    return next((major for major, library in _LIBRARIES.items() if any((prefix / "lib").glob(f"{library}*"))), None)


class Check:
    """Filled in at the end of :func:`in_force`: the tuning as it turned out."""

    def __init__(self, tuning: Tuning) -> None:
        self.tuning = tuning


@contextmanager
def in_force(tuning: Tuning) -> Iterator[Check]:
    """The environment in which to make this process's first node; afterwards it is as it was.

    Tells, in ``tuning.untuned`` of what it yields, what did not take effect: whether the profile was
    read is seen by watching the file, whether sockets alone are in use by what is mapped.
    """
    check = Check(tuning)
    before = {name: os.environ.get(name) for name in tuning.variables}
    watch = _watch(tuning.profile)
    os.environ.update(tuning.variables)
    try:
        yield check
        check.tuning = _checked(tuning, watch)
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
        if watch is not None:
            os.close(watch)


def _watch(path: str | None) -> int | None:
    if path is None:
        return None
    libc = ctypes.CDLL(None, use_errno=True)
    descriptor = libc.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
    if descriptor < 0:
        return None
    if libc.inotify_add_watch(descriptor, os.fsencode(path), _IN_OPEN) < 0:
        os.close(descriptor)
        return None
    return int(descriptor)


def _checked(tuning: Tuning, watch: int | None) -> Tuning:
    profile = tuning.profile
    if profile is None:
        return tuning
    untuned = list(tuning.untuned)
    if _was_opened(watch):
        _read.add(profile)
    if profile not in _read:
        why = "it cannot be seen" if watch is None else "this process has used ROS 2 before, with other settings"
        untuned.append(f"discovery: whether {Path(profile).name} was read is not known ({why})")
    sockets_alone = TRANSPORTS in tuning.variables or RANGE in tuning.variables
    if sockets_alone and _shared_memory():
        untuned.append("transports: shared memory is in use, and may lose the first messages to a new process")
    return replace(tuning, untuned=tuple(untuned))


def _was_opened(watch: int | None) -> bool:
    if watch is None:
        return False
    try:
        return bool(os.read(watch, 4096))
    except BlockingIOError:
        return False


def _shared_memory() -> bool:
    with open("/proc/self/maps", encoding="utf-8", errors="replace") as file:
        return any("/dev/shm/fastdds" in line or "/dev/shm/fastrtps" in line for line in file)
