"""A node in Rust that uses nothing of ROS's libraries, but a DDS in Rust: behind a relay, and refused elsewhere."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from midstride.errors import MidstrideError
from midstride.lang.load import load
from tests.acceptance.foreign_support import declared_talker, programs_of_the_page, robot
from tests.acceptance.support import ended
from tests.backends.ros2_support import run
from tests.native import RUST_TALKER

pytestmark = [pytest.mark.ros2, pytest.mark.rust, pytest.mark.full]


def written(folder: Path, first: str) -> Path:
    """A system whose talker is at first a ``first``; the programs are beside it."""
    programs_of_the_page(folder)
    text = "system swaps\ntopic /chat : std_msgs/msg/String @ 50 Hz\n"
    text += declared_talker("Rust", str(RUST_TALKER), "relay")
    text += declared_talker("Plain", "python3 talker.py", "preload")
    text += declared_talker("Seen", str(RUST_TALKER), "preload")
    text += declared_talker("Deaf", f"{RUST_TALKER} --deaf", "relay")
    path = folder / "swaps.stride"
    path.write_text(f"{text}node talker : {first} {{ out -> /chat }}\n", encoding="utf-8")
    return path


def test_a_node_in_rust_is_replaced_by_one_in_rclpy_and_the_other_way_round(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with robot(load(written(tmp_path, "Rust")).require(), tmp_path) as system:
            await system.replaced("Plain")
            await system.replaced("Rust")
            assert system.changes() == [("talker", "talker_2"), ("talker_2", "talker_3")]
            assert system.holes() == []
            assert (await system.manager.status()).valid
            # It cannot be held back inside its process, nor if it takes no notice of its names: both are refused, and
            # the old one goes on. The first of them publishes beside it until then: nothing keeps it from doing so.
            for component, words in (
                ("Seen", "node /talker publishes on /chat, and the library of `gate preload` does not see it"),
                ("Deaf", "node /talker_2 publishes on /chatter itself, for output out of Deaf; it takes no notice of"),
            ):
                begun = time.monotonic()
                outcome = await system.change(component)
                assert outcome.outcome == "rolled_back" and words in (outcome.because or ""), outcome
                print(f"{component}: refused after {time.monotonic() - begun:.1f} s")
                await system.hears()
            old = [(name, number) for _, name, number in system.heard if name == "talker_3"]
            assert [number for _, number in old] == list(range(old[0][1], old[-1][1] + 1))

    with ended():
        run(scenario())


def test_a_node_in_rust_with_a_preloaded_gate_does_not_start(tmp_path: Path) -> None:
    async def scenario() -> None:
        with pytest.raises(MidstrideError, match=r"does so without rcl, .* declare Seen with `gate relay`"):
            async with robot(load(written(tmp_path, "Seen")).require(), tmp_path):
                pass

    with ended():
        run(scenario())
