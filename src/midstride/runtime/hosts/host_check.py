"""The check of hosts: what prevents a system from running there, and what to do, for `midstride check --hosts`."""

from __future__ import annotations

import asyncio
import os
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from midstride.errors import BackendError
from midstride.model.hosts import HostSpec
from midstride.runtime.backend_protocol import Launch
from midstride.runtime.hosts import call_forms as calls
from midstride.runtime.hosts.call_forms import LaunchForm
from midstride.runtime.hosts.host_frames import HOST_PROTOCOL
from midstride.runtime.hosts.host_link import HostLink
from midstride.runtime.hosts.host_order import SHARED_VARIABLES, HostOrder, HostReport

# The difference of two clocks from which it is said (s), and the free disk space below which that is (bytes).
FAR_OFF: Final = 0.1
LITTLE_ROOM: Final = 100 * 1024 * 1024
RANGE: Final = "ROS_AUTOMATIC_DISCOVERY_RANGE"


@dataclass(slots=True)
class CheckedHost:
    """``faults``: what prevents the system from running there; ``notes``: what is worth knowing. Both say what to do.

    ``seconds``: how long the login and the start of the host process took. ``offset``: how far its clock is ahead of
    the one here, ``uncertainty`` how far that may be off (s).
    """

    host: HostSpec
    faults: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    version: str = ""
    seconds: float | None = None
    offset: float | None = None
    uncertainty: float | None = None


async def check_host(
    host: HostSpec, system: str, launches: Sequence[Launch], environment: Mapping[str, str] = os.environ
) -> CheckedHost:
    """Log in on a host, have a host process started, and ask it for all that a system needs there.

    ``launches``: what would be started there. Nothing is started but that process, which ends by itself.
    """
    checked = CheckedHost(host)
    variables = {name: environment[name] for name in SHARED_VARIABLES if name in environment}
    order = HostOrder(
        protocol=HOST_PROTOCOL, system=system, host=host.name, folder=host.folder, variables=variables, reads=True
    )
    with tempfile.TemporaryDirectory(prefix="midstride-") as folder:
        link = HostLink(host, order, Path(folder), str, lambda _: None, reads=True)
        begun = time.monotonic()
        try:
            await link.open()
            if link.problem is not None or link.report is None:
                checked.faults.append(link.problem or "it does not answer")
                return checked
            checked.seconds = time.monotonic() - begun
            checked.version = link.report.version
            checked.faults += faults_of(link.report)
            checked.notes += _notes_of(link.report)
            await _read_clock(checked, link)
            for launch in launches:
                try:
                    await link.call(calls.Describe(launch=LaunchForm.of(launch)), list[str])
                except BackendError as error:
                    checked.faults.append(f"{launch.instance}: {str(error).removesuffix(f' (on host {host.name})')}")
        except BackendError as error:
            checked.faults.append(str(error))
        finally:
            await link.close()
    return checked


def faults_of(report: HostReport) -> list[str]:
    """The settings of a host with which a system would not go on, or its nodes not find each other; what to do."""
    faults = []
    if report.range.upper() in ("LOCALHOST", "OFF"):
        faults.append(
            f"{RANGE}={report.range} is set there, so its nodes find none of another host: unset it, or set SUBNET"
        )
    if report.kills and not report.lingers:
        faults.append(
            "it ends all processes of a user with the last login (`KillUserProcesses=yes` in logind.conf): let those "
            f"of {report.user} go on (`sudo loginctl enable-linger {report.user}`)"
        )
    return faults


def _notes_of(report: HostReport) -> list[str]:
    notes = []
    if report.kills is None:
        notes.append("whether it ends the processes of a user with the last login is not known: no systemd")
    if report.free_bytes < LITTLE_ROOM:
        notes.append(f"{report.free_bytes // 1_000_000} MB are free on the disk of its folder")
    return notes


async def _read_clock(checked: CheckedHost, link: HostLink) -> None:
    """Compare the clocks. Raises BackendError."""
    found = await link.measure_clock()
    checked.offset, checked.uncertainty = found.ahead / 1e9, found.uncertainty / 1e9
    if abs(checked.offset) - checked.uncertainty > FAR_OFF:
        which = "ahead of" if checked.offset > 0 else "behind"
        checked.faults.append(
            f"its clock is {abs(checked.offset):.1f} s {which} the one here: have both follow one clock (chrony, PTP)"
        )


async def check_all(
    hosts: Mapping[str, HostSpec], system: str, launches: Mapping[str, Sequence[Launch]]
) -> list[CheckedHost]:
    """The check of each host, all at once; ``launches`` by host."""
    found = (check_host(host, system, launches.get(name, ())) for name, host in sorted(hosts.items()))
    return list(await asyncio.gather(*found))
