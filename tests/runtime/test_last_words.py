"""What a program has written last, where it is reported: the exception, not only that its process has exited."""

from __future__ import annotations

from pathlib import Path

import pytest

from midstride.backends.simulator import Simulator
from midstride.model.wording import exception_in, with_log
from midstride.runtime.backend_protocol import Exited
from midstride.runtime.manager import Manager
from midstride.runtime.process.log_runs import begin_run, text_of_latest_run
from tests.runtime.systems import managed, replace

TRACEBACK = """Traceback (most recent call last):
  File "new.py", line 12, in tick
    raise ValueError("no input")
ValueError: no input
"""


@pytest.mark.parametrize(
    ("log", "exception"),
    [
        (TRACEBACK, "ValueError: no input"),
        (f"[INFO] [n]: up\n{TRACEBACK}[INFO] [n]: bye\n", "ValueError: no input"),
        (f"{TRACEBACK}\nDuring handling …\n\n{TRACEBACK.replace('no input', 'no output')}", "ValueError: no output"),
        ("[ERROR] [n]: Traceback (most recent call last):\n  File\nKeyError: 'a'", "KeyError: 'a'"),
        ("terminate called after throwing an instance of 'std::runtime_error'\n  what():  no device\n", "no device"),
        ("[INFO] [n]: I heard: x\n", None),
        ("Traceback (most recent call last):\n  File", None),
        ("", None),
    ],
)
def test_the_exception_in_a_log_is_found(log: str, exception: str | None) -> None:
    assert exception_in(log) == exception
    assert (
        Exited("src_2", 1, log).details == f"src_2 exited unexpectedly (status 1){f': {exception}' * bool(exception)}"
    )
    first = with_log("src_2 exited with status 1", log).partition("\n")[0]
    assert first == f"src_2 exited with status 1:{f' {exception}' * bool(exception)}"


def test_only_the_latest_run_counts(tmp_path: Path) -> None:
    log = tmp_path / "a.log"
    assert text_of_latest_run("a\nb\n") == "a\nb\n"
    begin_run(log, "a")
    log.write_text(log.read_text() + TRACEBACK)
    begin_run(log, "a")
    assert text_of_latest_run(log.read_text()) == ""
    assert "\n\n" not in log.read_text()


def test_the_report_of_a_change_has_what_the_new_program_wrote_last(tmp_path: Path) -> None:
    """It exits behind its gate, before it has taken over: what is known of it is in its log."""

    async def body(manager: Manager, simulator: Simulator) -> None:
        async def look(to: str, sent: str) -> None:
            if to == "talker_2" and sent == "await_write":
                simulator.processes["talker_2"].log.write(TRACEBACK)
                simulator.faults.kill("talker_2")

        simulator.control.before_request = look
        outcome = await manager.change(replace("talker", "NewTalker"))
        assert outcome.outcome == "rolled_back" and outcome.because is not None
        first, _, rest = outcome.because.partition("\n")
        assert first.endswith("talker_2 was killed by signal 9: ValueError: no input")
        assert rest.endswith(TRACEBACK.strip())
        [words] = [event.words for event in manager.log() if event.kind == "exited"]
        assert words == "talker_2 exited unexpectedly (status -9): ValueError: no input"

    managed("talker", tmp_path, body)
