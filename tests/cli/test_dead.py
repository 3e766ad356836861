"""``midstride dead``: it asks, passes on what a person knows, and says what that allows."""

from __future__ import annotations

import pytest
from click.testing import CliRunner

from midstride.cli.commands import dead_command
from midstride.runtime.records.reports import DeadHost
from tests.cli.conftest import Midstride


class Client:
    def declare_dead(self, host: str, by: str) -> DeadHost:
        assert by
        return DeadHost(host=host, instances=["gripper_2", "gripper_camera"], nodes=["gripper", "gripper_camera"])


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (["arm"], 2, "not a terminal; pass --yes"),
        (
            ["arm", "--yes"],
            0,
            "Host arm counts as dead, and with it gripper_2, gripper_camera.\n`midstride replace gripper --on",
        ),
    ],
)
def test_it_is_not_done_by_mistake(
    arguments: list[str], status: int, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dead_command, "find", lambda system: (Client(), None))
    done = CliRunner().invoke(dead_command.dead_command, arguments)
    assert done.exit_code == (2 if status else 0) and words in done.output


@pytest.mark.full
def test_a_host_that_is_not_declared_is_refused(talker: Midstride) -> None:
    done = talker("dead", "arm", "--yes")
    assert done.status == 1 and "there is no host `arm`" in done.err
