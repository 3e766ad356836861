"""The hosts of specifications as `check --hosts` finds them."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from midstride.errors import BackendError
from midstride.model.specification import Specification, initial
from midstride.runtime.backend_protocol import Launch
from midstride.runtime.hosts.host_check import RANGE, CheckedHost, check_all
from midstride.runtime.options import SystemOptions
from midstride.runtime.process.launches import launch_of


def check(specifications: Iterable[Specification]) -> list[CheckedHost]:
    """Check every host of each specification."""

    async def run() -> list[CheckedHost]:
        found: list[CheckedHost] = []
        for specification in specifications:
            launches, faults = _launches(specification)
            checked = await check_all(specification.hosts, specification.name, launches)
            for each in checked:
                each.faults[:0] = faults.get(each.host.name, [])
                if (own := os.environ.get(RANGE, "")).upper() in ("LOCALHOST", "OFF"):
                    each.faults.append(f"{RANGE}={own} is set here, so the nodes here find none there: unset it")
            found += checked
        return found

    return asyncio.run(run())


def _launches(specification: Specification) -> tuple[dict[str, list[Launch]], dict[str, list[str]]]:
    """By host, what would be started there first, and why some of it cannot be."""
    launches: dict[str, list[Launch]] = {}
    faults: dict[str, list[str]] = {}
    for instance in initial(specification).instances.values():
        if not instance.host or instance.component.run is None:
            continue
        topics = {}
        if instance.component.gate is not None:
            attachments = specification.attachments_of(instance.role)
            topics = {port.port: specification.connectors[connector].topic for port, connector in attachments}
        try:
            launch = launch_of(instance, "ros2", token="", directory=Path("/"), options=SystemOptions(), topics=topics)
            launches.setdefault(instance.host, []).append(launch)
        except BackendError as error:
            faults.setdefault(instance.host, []).append(str(error))
    return launches, faults


def lines(checked: Sequence[CheckedHost]) -> Iterator[str]:
    """Yield what was found, in words."""
    if not checked:
        yield "There are no hosts but that of the manager: nothing to log in on."
    for each in checked:
        where = f"host {each.host.name} ({each.host.ssh})"
        for fault in each.faults:
            yield f"{where}: {fault}"
        if not each.faults:
            yield f"{where}: ready{_figures(each)}"
        for note in each.notes:
            yield f"  note: {note}"


def _figures(each: CheckedHost) -> str:
    found = f", with Midstride {each.version}"
    if each.seconds is not None:
        found += f"; login and start took {each.seconds:.1f} s"
    if each.offset is not None and each.uncertainty is not None:
        found += (
            f"; its clock is {1e3 * each.offset:+.1f} ms from the one here, to within {1e3 * each.uncertainty:.1f} ms"
        )
    return found


def document(each: CheckedHost) -> dict[str, Any]:
    """The form for `--json`."""
    return {
        "host": each.host.name,
        "ssh": each.host.ssh,
        "ok": not each.faults,
        "faults": each.faults,
        "notes": each.notes,
        "version": each.version,
        "login_seconds": each.seconds,
        "clock_offset_seconds": each.offset,
        "clock_uncertainty_seconds": each.uncertainty,
    }
