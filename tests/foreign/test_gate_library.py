"""The preloaded library itself, in plain processes: instead of librcl, they are linked with one that keeps a log."""

from __future__ import annotations

import ctypes
import errno
import os
import platform
import re
import shutil
import signal
import struct
import subprocess
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import pairwise
from pathlib import Path

import pytest

from midstride.errors import BackendError, StartFailed
from midstride.foreign import build
from midstride.foreign.gates import share_baton
from midstride.foreign.page import JOINED_WITHIN, Page
from midstride.foreign.page_layout import (
    NODES,
    OPEN,
    OUTPUT,
    VERSION,
    PageBaton,
    PageLayout,
    PageNode,
    PagePort,
    PageReceipts,
    PageRequests,
    PortFlag,
)
from midstride.node.handover.baton import BatonState, BatonStep, SharedSlot
from midstride.wire.replies import SharedSlotPlace
from tests.foreign.lab import LOG_SIZE, MS, Lab, until, variables
from tests.native import c_compiler

RATED, TIMED = PortFlag.RATED | PortFlag.OFFERS, PortFlag.TIMED | PortFlag.OFFERS


def started(lab: Lab, period: int, flags: PortFlag) -> tuple[int, int, int]:
    """An old node that publishes, and a new one that waits at its open gate; their indices, and the baton."""
    old = lab.node(period, flags)
    baton = lab.port(old).baton
    lab.port(old).gate = OPEN
    until(lambda: lab.written_by(old) > 0, "the old one does not publish")
    return old, lab.node(period, flags, baton=baton), baton


def test_the_layout_is_that_of_the_library(gate_library: Path) -> None:
    sizes = (ctypes.c_uint32 * 7)()
    ctypes.CDLL(str(gate_library)).midstride_layout(sizes)
    assert list(sizes) == [
        VERSION,
        *(ctypes.sizeof(each) for each in (PageLayout, PageBaton, PageNode, PagePort, PageRequests, PageReceipts)),
    ]


@pytest.mark.parametrize(("period", "flags"), [(0, TIMED), (MS, RATED)], ids=["flat out", "1 kHz"])
def test_one_writer_at_each_moment_and_nothing_missing(lab: Lab, period: int, flags: PortFlag) -> None:
    old, new, baton = started(lab, period, flags)
    lab.page.layout.batons[baton - 1].patience = 10**12
    swaps = 0

    def published(index: int, before: int) -> bool:
        return lab.written_by(index) > before

    def answered() -> bool:
        return lab.word(baton).holder == new + 1

    while swaps < 10:
        before = lab.written_by(new)
        lab.page.step(baton, BatonStep.NAME_SUCCESSOR, old, new)
        until(answered, "no answer")
        until(partial(published, new, before), "the new one does not publish")
        old, new, swaps = new, old, swaps + 1
    lab.page.step(baton, BatonStep.SETTLE, old)  # the other one does not go on when this one is ended
    lab.close()
    assert lab.overlaps() == 0
    records = lab.records()
    changes = [index for index in range(1, len(records)) if records[index][0] != records[index - 1][0]]
    assert len(changes) == swaps
    held_back = 0
    for (before, last, _), (writer, number, _) in pairwise(records):
        if writer == before:
            held_back += number != last + 1
    # While it has the baton, nothing of it is held back, but for one slot that it may have left to its successor.
    assert held_back <= (swaps if flags == RATED else 0)


def test_the_old_one_goes_on_if_the_new_one_dies_with_the_baton(lab: Lab) -> None:
    old, new, baton = started(lab, MS, RATED)
    while lab.word(baton).holder != new + 1:
        lab.page.step(baton, BatonStep.NAME_SUCCESSOR, old, new)
        time.sleep(0.01)
    lab.kill(new)
    before = lab.written_by(old)
    until(lambda: lab.written_by(old) > before + 10, "the old one does not go on")
    assert lab.word(baton).holder == old + 1
    assert lab.page.is_dead(new)
    assert not lab.page.is_dead(old)


def test_what_is_settled_is_not_taken_back(lab: Lab) -> None:
    old, new, baton = started(lab, MS, RATED)
    while lab.word(baton).holder != new + 1:
        lab.page.step(baton, BatonStep.NAME_SUCCESSOR, old, new)
        time.sleep(0.01)
    lab.page.step(baton, BatonStep.SETTLE, new)
    lab.kill(new)
    gated = lab.port(old).gated
    until(lambda: lab.port(old).gated > gated + 10, "the old one does not write")
    assert lab.word(baton).holder == new + 1


def test_the_new_one_takes_over_if_the_old_one_dies(lab: Lab) -> None:
    old, new, baton = started(lab, MS, RATED)
    os.kill(lab.processes[old].pid, signal.SIGSTOP)
    lab.page.step(baton, BatonStep.NAME_SUCCESSOR, old, new)
    lab.kill(old)
    until(lambda: lab.written_by(new) > 10, "the new one does not take over")


def test_of_several_nodes_of_one_name_the_one_that_lives_is_found(lab: Lab) -> None:
    """A hand-over that broke off may leave one: what succeeded it would write beside the one that lives."""
    left, living = lab.node(MS, RATED), lab.node(MS, RATED)
    for index in (left, living):
        lab.page.layout.nodes[index].instance = b"talker"
    assert lab.page.index_of("talker") == left
    lab.kill(left)
    assert lab.page.index_of("talker") == living
    lab.kill(living)
    assert lab.page.index_of("talker") is not None, "it can still be taken over from"
    assert lab.page.index_of("listener") is None


def test_a_part_of_the_page_that_nobody_joined_is_given_to_another(lab: Lab) -> None:
    """A manager that is killed in a hand-over leaves one; a node that is only slow to start keeps its own."""
    nodes = lab.page.layout.nodes
    left, *others = [lab.page.allocate(f"left_{number}") for number in range(NODES)]
    with pytest.raises(BackendError, match="more than 512 nodes have a gate"):
        lab.page.allocate("talker")
    nodes[left].beat -= JOINED_WITHIN
    assert lab.page.allocate("talker") == left
    assert nodes[left].instance == b"talker"
    with pytest.raises(BackendError, match="more than 512"):
        lab.page.allocate("listener")
    nodes[others[-1]].beat += 10**6  # from before the machine was started again
    assert lab.page.allocate("listener") == others[-1]


def test_the_old_one_misses_nothing_if_the_new_one_does_not_write(lab: Lab) -> None:
    old, new, baton = started(lab, MS, RATED)
    os.kill(lab.processes[new].pid, signal.SIGSTOP)
    before, gated = lab.written_by(old), lab.port(old).gated
    lab.page.step(baton, BatonStep.NAME_SUCCESSOR, old, new)
    until(lambda: lab.written_by(old) > before + 10, "the old one does not go on")
    assert lab.port(old).gated == gated
    os.kill(lab.processes[new].pid, signal.SIGCONT)
    until(lambda: lab.written_by(new) > 10, "the new one does not take it when it goes on")
    assert lab.overlaps() == 0


def test_a_slot_is_left_only_to_a_successor_that_comes_while_the_old_one_publishes(
    tmp_path: Path, gate_library: Path
) -> None:
    """Its period may be the same, and its messages always come at that moment: it would never find the baton lying."""
    page = Page(tmp_path / "page", gate_library)
    indices = page.allocate("old"), page.allocate("new")
    baton = page.new_baton(indices[0])
    for index in indices:
        page.set_ports(index, [("/chat", OUTPUT)])
        page.ports(index)[0].gate = OPEN
        share_baton(page, [(page.ports(index)[0], 50.0)], baton)

    def slot(own: int, other: int) -> SharedSlot:
        return SharedSlot(
            SharedSlotPlace(
                page=str(page.path),
                library=str(gate_library),
                baton=baton,
                index=indices[own],
                other=indices[other],
                timed=False,
            )
        )

    old, new = slot(0, 1), slot(1, 0)

    def written(*, slot: bool = True, meets: bool = False) -> bool:
        """Whether the old one publishes: at its next slot, or sooner. ``meets``: meanwhile, the new one tries to."""
        page.layout.batons[baton - 1].offered = time.monotonic_ns() - (10**10 if slot else -(10**10))
        if not old.begin(0):
            return False
        assert not (meets and new.begin(0))
        old.end()
        return True

    assert written(meets=True), "no successor has been named"
    page.step(baton, BatonStep.NAME_SUCCESSOR, *indices)
    assert all(written() for _ in range(20)), "the new one does not come"
    assert written(meets=True) and written(meets=True)
    assert written(slot=False), "it catches up, which leaves the new one no time"
    assert not written()
    assert all(written() for _ in range(20)), "it was for once"
    assert written(meets=True) and written(meets=True) and not written()
    assert new.begin(0)
    new.end()
    assert not old.begin(0)


def test_one_that_is_stopped_is_fenced_and_held_back_when_it_goes_on(lab: Lab) -> None:
    old, new, baton = started(lab, MS, RATED)
    os.kill(lab.processes[old].pid, signal.SIGSTOP)
    lab.page.step(baton, BatonStep.FENCE, old)
    if lab.word(baton).writers:  # it was stopped while it published: such a process is killed
        lab.kill(old)
    lab.page.step(baton, BatonStep.GIVE, new)
    until(lambda: lab.written_by(new) > 10, "the new one does not take over")
    if lab.processes[old].poll() is None:
        gated = lab.port(old).gated
        os.kill(lab.processes[old].pid, signal.SIGCONT)
        until(lambda: lab.port(old).gated > gated + 10, "the old one does not go on")
    assert lab.overlaps() == 0 or lab.processes[old].poll() is not None
    assert lab.word(baton).state is BatonState.HELD


def test_without_a_rate_it_is_left_to_the_successor_for_a_stated_time(lab: Lab) -> None:
    old, new, baton = started(lab, MS, TIMED)
    lab.page.layout.batons[baton - 1].patience = 10**12
    os.kill(lab.processes[new].pid, signal.SIGSTOP)
    lab.page.step(baton, BatonStep.NAME_SUCCESSOR, old, new, at_once=True)
    until(lambda: lab.word(baton).state is BatonState.OFFERED, "it is not offered")
    gated = lab.port(old).gated
    until(lambda: lab.port(old).gated > gated + 10, "the old one does not wait")
    before = lab.written_by(old)
    lab.page.layout.batons[baton - 1].patience = 0
    until(lambda: lab.written_by(old) > before + 10, "the old one does not go on")


def test_a_message_written_once_is_kept_and_published_when_the_gate_opens(lab: Lab) -> None:
    index = lab.node(0, TIMED | PortFlag.KEEPS, messages=1)
    until(lambda: bool(lab.port(index).kept), "it is not kept")
    assert lab.count() == 0
    lab.port(index).gate = OPEN
    lab.page.ring(index)
    until(lambda: lab.count() == 1, "it is not published")
    assert lab.records()[0][:2] == (index + 1, 1)
    until(lambda: not lab.port(index).kept, "it is still kept")


@pytest.mark.parametrize(("depth", "published"), [(0, [4]), (1, [4]), (3, [2, 3, 4]), (9, [1, 2, 3, 4])])
def test_of_a_latched_publisher_all_is_kept_that_a_late_subscriber_would_get(
    lab: Lab, monkeypatch: pytest.MonkeyPatch, depth: int, published: list[int]
) -> None:
    if depth:
        monkeypatch.setenv("FAKE_LATCHED", str(depth))
    index = lab.node(0, TIMED | PortFlag.KEEPS, messages=4)
    until(lambda: lab.port(index).gated == 4, "it has not written all")
    lab.port(index).gate = OPEN
    lab.page.ring(index)
    until(lambda: not lab.port(index).kept, "they are not published")
    assert [number for _, number, _ in lab.records()] == published
    assert lab.written_by(index) == len(published)


def test_one_written_once_is_published_at_the_change(lab: Lab) -> None:
    old = lab.node(0, TIMED | PortFlag.KEEPS, messages=1)
    baton = lab.port(old).baton
    lab.port(old).gate = OPEN
    lab.page.ring(old)
    until(lambda: lab.count() == 1, "the old one's message is not published")
    new = lab.node(0, TIMED | PortFlag.KEEPS, baton=baton, messages=1)
    lab.page.step(baton, BatonStep.NAME_SUCCESSOR, old, new, at_once=True)
    lab.page.ring(new)
    until(lambda: lab.count() == 2, "the new one's message is not published")
    assert [writer for writer, _, _ in lab.records()] == [old + 1, new + 1]


def test_a_process_may_have_any_number_of_endpoints(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that the library did not know would publish whatever its gate says."""
    monkeypatch.setenv("FAKE_OTHERS", "1000")
    index = lab.node(MS, PortFlag(0))
    until(lambda: lab.port(index).gated > 10, "it does not write")
    assert lab.count() == 0
    assert lab.port(index).endpoints == 1, "those that it has removed are still known"
    lab.port(index).gate = OPEN
    until(lambda: lab.written_by(index) > 10, "it does not write when its gate is open")


def test_the_helper_thread_reports_how_many_readers_there_are(lab: Lab) -> None:
    index = lab.node(MS, RATED)
    until(lambda: lab.port(index).matched == 3, "it does not say")


@pytest.mark.parametrize("page", ["nothing there", "another version", "cut off", "no number"])
def test_without_a_page_a_process_behaves_as_without_the_library(
    tmp_path: Path, programs: Path, gate_library: Path, page: str
) -> None:
    path, node = tmp_path / "page", "0"
    if page != "nothing there":
        Page(path, gate_library).layout.version = VERSION + (page == "another version")
    if page == "cut off":
        os.truncate(path, 100)
    if page == "no number":
        node = str(NODES)
    log = tmp_path / "log"
    log.touch()
    os.truncate(log, LOG_SIZE)
    environment = {**os.environ, **variables(path, programs, gate_library, log, node)}
    command = [str(programs / "node"), "1", "/chat", "0", "100", "time"]
    subprocess.run(command, env=environment, check=True, capture_output=True, timeout=60)
    with open(log, "rb") as file:
        assert struct.unpack("Q", file.read(8))[0] == 100
    if page in ("another version", "cut off"):
        with pytest.raises(BackendError, match="midstride down"):
            Page(path, gate_library)


def test_a_page_has_its_space_on_the_disk_or_is_refused(
    tmp_path: Path, gate_library: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A write to memory for which the disk has none ends the process."""
    path = tmp_path / "page"

    def full(*_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patched:
        patched.setattr(os, "posix_fallocate", full)
        with pytest.raises(BackendError, match="No space left on device"):
            Page(path, gate_library)
    Page(path, gate_library)  # there is space again
    assert path.stat().st_blocks * 512 >= path.stat().st_size


def test_the_gate_library_is_compiled_once(tmp_path: Path) -> None:
    c_compiler()
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path)}
    with ThreadPoolExecutor() as pool:
        first, second = pool.map(lambda _: build.library(environment), range(2))
    assert first == second
    assert [path.name for path in (tmp_path / "midstride").iterdir()] == [first.name]
    assert build.library({"HOME": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path), "PATH": ""}) == first


def test_an_upgrade_under_a_process_leaves_it_its_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    c_compiler()
    here = {"XDG_CACHE_HOME": str(tmp_path), "PATH": os.environ["PATH"]}
    sources = tmp_path / "gate"
    sources.mkdir()
    copies = [Path(shutil.copy(source, sources)) for source in build.SOURCES]
    monkeypatch.setattr(build, "SOURCES", tuple(copies))
    compiled = build.library(here)
    for changed in (True, False):
        copies[0].write_text("int changed;") if changed else copies[0].unlink()
        assert build.library(here) == compiled and build.is_available(here)
        assert str(compiled) in build.origin(here), "the manager names it as it ends"
        with pytest.raises(StartFailed, match=r"have changed since this process was started.*`midstride down`"):
            build.library(here | {"XDG_CACHE_HOME": str(tmp_path / "none")})


NO_COMPILER = r"there is no C compiler on the PATH to make it: install one .*, or write `gate relay`, which needs none"


def test_without_a_compiler_it_says_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(StartFailed, match=rf"\(the package has none for {platform.machine()}\), and {NO_COMPILER}"):
        build.library({"XDG_CACHE_HOME": str(tmp_path), "PATH": str(tmp_path)})


def test_the_prebuilt_library_is_used_where_it_can_be_loaded(
    tmp_path: Path, gate_library: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(build, "PREBUILT", tmp_path / "prebuilt")
    here = {"XDG_CACHE_HOME": str(tmp_path), "PATH": os.environ["PATH"]}
    nowhere = {"XDG_CACHE_HOME": str(tmp_path / "none"), "PATH": str(tmp_path)}
    path = build.prebuilt_path()
    assert path.name == gate_library.name, "its name has the hash of the sources"
    path.parent.mkdir()
    path.with_name(f"gate-0000000000000000-{platform.machine()}.so").write_bytes(gate_library.read_bytes())
    assert not build.is_available(nowhere), "that is of other sources"
    path.write_bytes(gate_library.read_bytes())
    assert build.library(nowhere) == build.library(here) == path and build.is_available(nowhere)
    assert build.origin(nowhere) == f"the prebuilt one of the package, {path}"

    monkeypatch.setattr(build, "PREBUILT", tmp_path / "unfit")
    unfit = build.prebuilt_path()
    unfit.parent.mkdir()
    unfit.write_bytes(gate_library.read_bytes().replace(b"GLIBC_2.34", b"GLIBC_9.99"))  # as of a newer C library
    compiled = build.library(here)
    assert compiled == tmp_path / "midstride" / unfit.name
    why = f"the one for {platform.machine()} cannot be loaded: .*GLIBC_9.99"
    assert re.match(rf"compiled here \({why}.*\), {compiled}$", build.origin(here))
    with pytest.raises(StartFailed, match=rf"\({why}.*\), and {NO_COMPILER}"):
        build.library(nowhere)
    assert not build.is_available(nowhere)


def test_what_the_compiler_says_is_reported(tmp_path: Path) -> None:
    broken = tmp_path / "broken"
    broken.write_text("#!/bin/sh\necho 'no libc here' >&2\nexit 1\n")
    broken.chmod(0o755)
    with pytest.raises(StartFailed, match=r"write `gate relay`, which needs no compiler, [^\0]*no libc here"):
        build.library({"XDG_CACHE_HOME": str(tmp_path), "PATH": os.environ["PATH"], "CC": str(broken)})
    assert list((tmp_path / "midstride").iterdir()) == []
