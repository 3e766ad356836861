"""Discovery and transports for a system whose processes come and go; and whether the settings took effect.

By default Fast DDS uses shared memory, which loses the first messages to a new process and leaves files behind when a
process is killed; a new process is matched only at the next announcement, up to 3 s later; a reliable writer learns
only after up to 3 s that everything has arrived; and each endpoint that comes or goes costs three messages to every
process. For the processes that Midstride starts, and for the manager itself, the profiles beside this file change these
four, unless the user has set a profile. Everything else keeps its default, the lease of 20 s in particular: the manager
knows of deaths from sockets and processes (docs/decisions/fast-dds-settings.md has figures).
Three things are easy to get wrong:

- Fast DDS 3 reads the profile named by one variable, Fast DDS 2 by another, in another spelling, and
  each ignores, or warns about, what is meant for the other.
- Under ``ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST`` rmw_fastrtps replaces all transports, and uses shared
  memory whatever the environment asks for. A profile does what that setting does, with sockets
  alone, and the setting is reset.
- A profile is read once in a process, when its first node is created: later is too late.
"""

from __future__ import annotations

import ctypes
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from midstride.backends.ros2.middleware import of_identifier
from midstride.backends.ros2.middleware import of_this_process as middleware_of_this_process
from midstride.runtime.records.status_forms import Middleware

PROFILES: Final = Path(__file__).parent / "profiles"
TRANSPORTS: Final = "FASTDDS_BUILTIN_TRANSPORTS"
RANGE: Final = "ROS_AUTOMATIC_DISCOVERY_RANGE"

# The major version of Fast DDS: the variable that names its profile.
PROFILE_VARIABLES: Final = {3: "FASTDDS_DEFAULT_PROFILES_FILE", 2: "FASTRTPS_DEFAULT_PROFILES_FILE"}
_LIBRARIES: Final = {3: "libfastdds.so", 2: "libfastrtps.so"}
_IN_OPEN: Final = 0x20  # inotify: the file was opened

# What ROS 2 and its middlewares read of a user's settings.
USER_VARIABLES: Final = (
    "RMW_IMPLEMENTATION",
    *PROFILE_VARIABLES.values(),
    TRANSPORTS,
    RANGE,
    "ROS_STATIC_PEERS",
    "ROS_LOCALHOST_ONLY",
    "ROS_DISCOVERY_SERVER",
    "CYCLONEDDS_URI",
    "ZENOH_SESSION_CONFIG_URI",
)

# The profiles that this process has read: Fast DDS keeps the first one, and so it is remembered here.
_read: set[str] = set()


@dataclass(frozen=True, slots=True)
class DdsSettings:
    """The variables that are set for the processes that Midstride starts; ``warnings`` say what is left as it was."""

    middleware: str
    variables: Mapping[str, str] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    def described(self, environment: Mapping[str, str], notes: Iterable[str]) -> Middleware:
        """Describe what is set, what the user has set in ``environment`` and is left, and what the middleware does
        not tell.
        """
        kept = {
            name: value for name in USER_VARIABLES if (value := environment.get(name)) and name not in self.variables
        }
        notes = [*notes, *of_identifier(self.middleware).limits()]
        return Middleware(name=self.middleware, set=dict(self.variables), kept=kept, notes=notes)

    @property
    def profile(self) -> str | None:
        return next((self.variables[name] for name in PROFILE_VARIABLES.values() if name in self.variables), None)


def choose(environment: Mapping[str, str], middleware: str, major: int | None) -> DdsSettings:
    """Choose what to set, given what the user has set. ``major``: the version of Fast DDS, None where it is not
    known.
    """
    if not of_identifier(middleware).fast_dds:
        return DdsSettings(
            middleware, {}, (f"discovery: {middleware} keeps its defaults, and may find new processes late",)
        )
    if major is None:
        return DdsSettings(middleware, {}, ("discovery: the version of Fast DDS is unknown, so it keeps its defaults",))
    own = [name for name in PROFILE_VARIABLES.values() if environment.get(name)]
    if any(Path(environment[name]).parent == PROFILES for name in own):
        return DdsSettings(middleware)  # set already: this process was started by Midstride
    if own:
        return DdsSettings(middleware, warnings=(f"discovery: your own profile ({own[0]}) is used",))
    transports = environment.get(TRANSPORTS)
    if transports is None and _on_this_host_alone(environment):
        profile = PROFILES / f"fastdds{major}_localhost.xml"
        return DdsSettings(middleware, {PROFILE_VARIABLES[major]: str(profile), RANGE: "SYSTEM_DEFAULT"})
    variables = {PROFILE_VARIABLES[major]: str(PROFILES / f"fastdds{major}_subnet.xml")}
    if transports is not None:
        return DdsSettings(middleware, variables, (f"transports: your own {TRANSPORTS}={transports} is used",))
    return DdsSettings(middleware, {**variables, TRANSPORTS: "UDPv4?sockets_size=4MB"})


def _on_this_host_alone(environment: Mapping[str, str]) -> bool:
    """The user's static peers, and the older variable for the same, are left to rmw_fastrtps."""
    if environment.get("ROS_STATIC_PEERS") or environment.get("ROS_LOCALHOST_ONLY") == "1":
        return False
    return environment.get(RANGE, "").upper() == "LOCALHOST"


def of_this_process(*, enabled: bool = True) -> DdsSettings:
    """The settings for this process and those it starts. Imports rclpy, which loads the middleware.

    Nothing where that is not ``enabled``.
    """
    middleware = middleware_of_this_process().identifier
    if not enabled:
        return DdsSettings(middleware, warnings=("discovery and transports: switched off (--no-middleware-settings)",))
    return choose(os.environ, middleware, loaded_major())


def loaded_major() -> int | None:
    """The version of the Fast DDS that this process has loaded."""
    maps = _maps()
    return next((major for major, library in _LIBRARIES.items() if f"/{library}" in maps), None)


def _maps() -> str:
    return Path("/proc/self/maps").read_text(encoding="utf-8", errors="replace")


def installed_major(prefix: Path) -> int | None:
    """The version of the Fast DDS that is installed under ``prefix``, as the wheels lay it out."""
    return next((major for major, library in _LIBRARIES.items() if any((prefix / "lib").glob(f"{library}*"))), None)


@contextmanager
def applied_profile(settings: DdsSettings) -> Iterator[list[str]]:
    """The environment in which to create this process's first node; afterwards it is as it was.

    The list that it yields has, in the end, the warnings of ``settings`` and what did not take effect: whether the
    profile was read shows by watching a copy of the file, which no other process opens, whether shared memory is in use
    by what is mapped.
    """
    warnings = list(settings.warnings)
    before = {name: os.environ.get(name) for name in settings.variables}
    with TemporaryDirectory(prefix="midstride-") as folder:
        copy = None if settings.profile is None else shutil.copy(settings.profile, folder)
        watch = _watch(copy)
        os.environ.update(settings.variables)
        if copy is not None:
            os.environ.update({name: copy for name in PROFILE_VARIABLES.values() if name in settings.variables})
        try:
            yield warnings
            warnings += _not_applied(settings, watch)
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


def _not_applied(settings: DdsSettings, watch: int | None) -> Iterator[str]:
    profile = settings.profile
    if profile is None:
        return
    if watch is not None:
        with suppress(BlockingIOError):  # nothing has opened it
            os.read(watch, 4096)
            _read.add(profile)
    if profile not in _read:
        why = "it cannot be watched" if watch is None else "this process has used ROS 2 before, with other settings"
        yield f"discovery: whether {Path(profile).name} was read is unknown ({why})"
    replaced = TRANSPORTS in settings.variables or RANGE in settings.variables
    if replaced and any(file in _maps() for file in ("/dev/shm/fastdds", "/dev/shm/fastrtps")):
        yield "transports: shared memory is in use, and may lose the first messages to a new process"
