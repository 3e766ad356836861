"""Whether there is memory for both processes of a container while its nodes move."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from midstride.errors import PlanRefused
from midstride.plan.plan import Plan
from midstride.plan.request import PlanRequest
from midstride.plan.strategies.registry import planner
from midstride.runtime.change.container_copies import room_for_copies
from midstride.runtime.process.memory import Memory, free_memory, memory_of
from tests.lang.test_shared_containers import changed, read

MIB = 2**20
PIDS = {"b": 7, "front/a": 7}


def plan(folder: Path, request: PlanRequest, strategy: str = "minimal") -> Plan:
    return planner(strategy)(changed(read(folder), request))


def said(found: Plan, free: Memory | None, pids: dict[str, int] = PIDS) -> list[str]:
    memory = {7: Memory(100 * MIB, 10 * MIB), 8: Memory(2048 * MIB, 0)}
    return list(room_for_copies(found, pids, memory.get, lambda: free))


def test_a_repacking_that_fits_says_how_much_it_needs(tmp_path: Path) -> None:
    moved = plan(tmp_path, PlanRequest(restart=("front/pipeline",)))
    what = "front/pipeline_2, beside its predecessor, needs about 100 MiB of memory"
    assert said(moved, Memory(200 * MIB, 10 * MIB)) == [f"{what}, and 200 MiB are left"]
    assert said(moved, None) == [f"{what}; how much is left is not known"]
    unknown = "how much memory front/pipeline_2 needs while the old process runs as well is not known"
    assert said(moved, Memory(0, 0), {}) == said(moved, Memory(0, 0), {"b": 9, "front/a": 7}) == [unknown]


def test_shared_memory_that_may_be_that_of_others_is_no_reason_to_refuse(tmp_path: Path) -> None:
    moved = plan(tmp_path, PlanRequest(restart=("front/pipeline",)))
    [_, remark] = said(moved, Memory(200 * MIB, 9 * MIB))
    assert remark == (
        "front/pipeline_2, beside its predecessor, may need up to 10 MiB of shared memory (/dev/shm), of which 9 MiB "
        "are left; how much of that others have made is not known"
    )


def test_a_repacking_that_does_not_fit_is_refused(tmp_path: Path) -> None:
    moved = plan(tmp_path, PlanRequest(restart=("front/pipeline",)))
    way_out = r"end something, restart its nodes one at a time \(`midstride restart b`, then the others\), each in"
    with pytest.raises(PlanRefused, match=f"100 MiB of memory, as much .* has, and 99 MiB are left; {way_out}"):
        said(moved, Memory(99 * MIB, 10 * MIB))
    with pytest.raises(PlanRefused, match=r"2\.1 GiB of memory, as much .* 2\.0 GiB are left"):  # in two processes now
        said(moved, Memory(2047 * MIB, 100 * MIB), {"b": 7, "front/a": 8})


def test_what_the_refusal_names_needs_less(tmp_path: Path) -> None:
    """The last one that leaves has a new process of the container, which is looked at again: it has one node now."""
    specification, nothing = read(tmp_path), Memory(0, 0)
    first = changed(specification, PlanRequest(restart=("b",)))
    assert said(planner()(first), nothing) == []
    last = changed(specification, PlanRequest(restart=("front/a",)), first)
    pids = {"b_2": 8, "front/a": 7}
    with pytest.raises(PlanRefused, match="99 MiB are left; end something, or use `--strategy stop`, which ends"):
        said(planner()(last), Memory(99 * MIB, 0), pids)
    assert len(said(planner()(last), Memory(100 * MIB, 100 * MIB), pids)) == 1
    for change, running in ((changed(specification, PlanRequest(restart=("front/pipeline",))), PIDS), (last, pids)):
        assert said(planner("stop")(change), nothing, running) == []


def test_what_needs_no_second_process_is_not_looked_at(tmp_path: Path) -> None:
    nothing = Memory(0, 0)
    assert said(plan(tmp_path, PlanRequest(restart=("b",))), nothing) == []
    assert said(plan(tmp_path, PlanRequest(restart=("front/pipeline",)), "stop"), nothing) == []


def test_what_a_process_has_and_what_is_left_is_read(tmp_path: Path) -> None:
    own = memory_of(os.getpid())
    assert own is not None
    kept = bytearray(os.urandom(64 * MIB))
    more = memory_of(os.getpid())
    assert more is not None
    assert 48 * MIB < more.own - own.own < 128 * MIB, len(kept)
    left = free_memory()
    assert left is not None
    assert 0 < left.own < os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    assert memory_of(-1) is None
    assert free_memory(proc=tmp_path) is None


def test_the_limits_of_control_groups_count(tmp_path: Path) -> None:
    proc, groups = tmp_path / "proc", tmp_path / "groups"
    (proc / "self").mkdir(parents=True)
    (proc / "self" / "cgroup").write_text("0::/robot/stack\n", encoding="utf-8")
    (proc / "meminfo").write_text("MemTotal:  900 kB\nMemAvailable:  500 kB\n", encoding="utf-8")
    inner, outer = groups / "robot" / "stack", groups / "robot"
    inner.mkdir(parents=True)
    for folder, limit in ((inner, "max"), (outer, str(400 * 1024))):
        (folder / "memory.max").write_text(limit, encoding="utf-8")
        (folder / "memory.current").write_text(str(300 * 1024), encoding="utf-8")
        (folder / "memory.stat").write_text(f"anon 1\ninactive_file {50 * 1024}\n", encoding="utf-8")
    left = free_memory(proc, groups, tmp_path)
    assert left is not None
    assert left.own == 150 * 1024
