"""Shell completion, as the shells ask for it: commands, options, and names of a file and of the running system."""

from __future__ import annotations

import os
import pty
import select
import shlex
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from midstride.cli import main
from midstride.cli.command_list import COMMANDS
from tests.cli.conftest import EXAMPLES, Midstride, running

TALKER = str(EXAMPLES / "talker" / "talker.stride")
GROUPED = str(Path(__file__).parent / "grouped.stride")
OBSTACLE = str(EXAMPLES / "obstacle" / "obstacle.stride")

Complete = Callable[..., list[str]]


@pytest.fixture(scope="module")
def talker() -> Iterator[Midstride]:
    for midstride in running():
        up = midstride("up", TALKER, "--backend", "sim", "--detach")
        assert up.status == 0, up.err
        yield midstride


@pytest.fixture
def nothing_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))


def in_bash(words: str) -> list[str]:
    """The words that Bash makes of a line: it splits at ``=`` and at spaces."""
    pieces = [piece for word in shlex.split(words) for piece in word.replace("=", "\n=\n").split("\n") if piece]
    return pieces + [""] * (not words or words.endswith(" "))


@pytest.fixture
def complete(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Complete:
    """The candidates that Bash gets for a line, with the cursor at its end; and nothing on standard error."""

    def complete(line: str) -> list[str]:
        words = in_bash(f"midstride {line}")
        monkeypatch.setenv("_MIDSTRIDE_COMPLETE", "bash_complete")
        monkeypatch.setenv("COMP_WORDS", "\n".join(words))
        monkeypatch.setenv("COMP_CWORD", str(len(words) - 1))
        main([])
        out, err = capfd.readouterr()
        assert err == ""
        return [
            value if kind == "plain" else kind for kind, _, value in (line.partition(",") for line in out.splitlines())
        ]

    return complete


# -- without a running system --------------------------------------------------------------------------------


@pytest.mark.usefixtures("nothing_runs")
@pytest.mark.parametrize(
    ("line", "candidates"),
    [
        ("re", ["report", "replace", "restart", "remove"]),
        ("--v", ["--version"]),
        ("check --", ["--strict", "--no-types", "--hosts", "--json", "--help"]),
        ("plan x --strategy ", ["minimal", "paper", "quiesce", "stop"]),
        ("up x --backend r", ["ros2", "ros1"]),
        ("explain E01", [f"E01{digit}" for digit in range(10)]),
        ("explain w03", ["w030", "w031", "w032", "w033", "w034", "w035"]),
        ("demo t", ["talker"]),
        ("check ", ["file"]),
        ("nonsense --system", []),
    ],
)
def test_commands_options_and_fixed_values(complete: Complete, line: str, candidates: list[str]) -> None:
    assert complete(line) == candidates


@pytest.mark.usefixtures("nothing_runs")
def test_every_command_and_its_options(complete: Complete) -> None:
    assert complete("") == list(COMMANDS)
    for name in COMMANDS:
        assert {"--json", "--help"} <= set(complete(f"{name} --")), name


@pytest.mark.usefixtures("nothing_runs")
@pytest.mark.parametrize(
    ("line", "candidates"),
    [
        (f"impact {OBSTACLE} ", ["controller", "detector"]),
        (f"impact {OBSTACLE} detector ", ["controller"]),
        (f"impact {GROUPED} front/", ["front/left", "front/pipeline", "front/right"]),
        (f"plan {TALKER} --remove l", ["listener"]),
        (f"plan {TALKER} --replace t", ["talker="]),
        (f"plan {TALKER} --replace talker=", ["Listener", "NewTalker", "Talker"]),
        (f"plan {TALKER} --replace talker=N", ["NewTalker"]),
        (f"plan {TALKER} --remove listener --replace talker=N", ["NewTalker"]),
        (f"plan {GROUPED} --restart ", ["front/left", "front/pipeline", "front/right"]),
        (f"plan {GROUPED} --replace front/p", []),
        ("plan nowhere.stride --remove ", []),
        (f"plan {Path(__file__)} --remove ", []),
        ("plan --remove ", []),
    ],
)
def test_names_of_the_file(complete: Complete, line: str, candidates: list[str]) -> None:
    assert complete(line) == candidates


@pytest.mark.usefixtures("nothing_runs")
@pytest.mark.parametrize(
    "line",
    [
        "replace ",
        "replace talker ",
        "remove ",
        "why ",
        "add ear Ear ",
        "param set ",
        "param get talker ",
        "down --system ",
    ],
)
def test_nothing_is_offered_where_nothing_runs(complete: Complete, line: str) -> None:
    assert complete(line) == []


# -- with a running system -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "candidates"),
    [
        ("param ", ["get", "list", "set"]),
        ("param set ", ["listener", "talker"]),
        ("replace ", ["listener", "talker"]),
        ("replace t", ["talker"]),
        ("replace talker ", ["Listener", "NewTalker", "Talker"]),
        ("replace talker New", ["NewTalker"]),
        ("replace --system talker talker New", ["NewTalker"]),
        ("replace --system=talker talker New", ["NewTalker"]),
        ("replace --system other talker New", []),
        (f"replace --from {OBSTACLE} talker Ste", ["StereoDetector"]),
        ("remove listener ", ["talker"]),
        ("status listener ", ["talker"]),
        ("plan --remove l", ["listener"]),
        ("why ", ["listener.listen", "talker.talk"]),
        ("why t", ["talker.talk"]),
        ("add ear L", ["Listener"]),
        ("add ear Listener ", ["in=/chatter"]),
        ("add ear Listener in=", ["/chatter"]),
        ("add ear Unknown ", []),
        ("status --system ", ["talker"]),
        ("status --system=t", ["talker"]),
    ],
)
def test_names_of_the_running_system(
    talker: Midstride, complete: Complete, monkeypatch: pytest.MonkeyPatch, line: str, candidates: list[str]
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(talker.runtime))
    assert complete(line) == candidates


@pytest.mark.parametrize(
    ("shell", "words", "answer"),
    [
        ("zsh", ("midstride why t", "2"), "plain\ntalker.talk\n_\n"),
        ("zsh", ("midstride status --system=t", "2"), "plain\n--system=talker\n_\n"),
        ("fish", ("midstride status --system=t", "--system=t"), "plain,--system=talker\n"),
        ("fish", ("midstride why t", "t"), "plain,talker.talk\n"),
    ],
)
def test_other_shells(talker: Midstride, shell: str, words: tuple[str, str], answer: str) -> None:
    environment = {"_MIDSTRIDE_COMPLETE": f"{shell}_complete", "COMP_WORDS": words[0], "COMP_CWORD": words[1]}
    done = talker.process(timeout=60, **environment)
    assert (done.out.replace("\\n", "\n"), done.err) == (answer, "")


@pytest.mark.skipif(shutil.which("bash") is None, reason="Bash is not installed")
def test_bash_itself(talker: Midstride, tmp_path: Path) -> None:
    """The script that `midstride` prints for Bash, sourced and called as Bash calls it."""
    program = tmp_path / "midstride"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m midstride "$@"\n', encoding="utf-8")
    program.chmod(0o755)
    script = """
        eval "$(_MIDSTRIDE_COMPLETE=bash_source midstride)"
        COMP_WORDS=(midstride replace talker "") COMP_CWORD=3
        _midstride_completion midstride
        echo "${COMPREPLY[@]}"
        complete -p midstride
    """
    environment = {**talker.environment, "PATH": f"{tmp_path}:{talker.environment['PATH']}"}
    done = subprocess.run(
        ["bash", "--norc", "-c", script], env=environment, capture_output=True, text=True, check=True, timeout=60
    )
    candidates, registered = done.stdout.splitlines()
    assert candidates.split() == ["Listener", "NewTalker", "Talker"]
    assert registered == "complete -o nosort -F _midstride_completion midstride"
    assert done.stderr == ""


@pytest.mark.full
@pytest.mark.skipif(shutil.which("zsh") is None, reason="Zsh is not installed")
def test_zsh_itself(talker: Midstride, tmp_path: Path) -> None:
    """A line that is typed at a terminal, up to the key Tab."""
    program = tmp_path / "midstride"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m midstride "$@"\n', encoding="utf-8")
    program.chmod(0o755)
    setup = 'autoload -Uz compinit; compinit -D; eval "$(_MIDSTRIDE_COMPLETE=zsh_source midstride)"; PS1=ready:'
    environment = {**talker.environment, "PATH": f"{tmp_path}:{talker.environment['PATH']}", "TERM": "dumb"}
    terminal, other = pty.openpty()
    shell = subprocess.Popen(["zsh", "-f", "-i"], stdin=other, stdout=other, stderr=other, env=environment)
    os.close(other)
    seen = b""

    def read_until(words: bytes) -> None:
        nonlocal seen
        while words not in seen:
            assert select.select([terminal], [], [], 20)[0], seen.decode(errors="replace")
            seen += os.read(terminal, 4096)
        seen = seen.partition(words)[2]

    try:
        os.write(terminal, setup.encode() + b"\n")
        read_until(b"ready:\x1b[?2004h")  # which it says once it is ready for a line
        os.write(terminal, b"midstride why tal\t")
        read_until(b"talker.talk ")
        os.write(terminal, b"\x15midstride replace --sys\t")
        read_until(b"--system")
    finally:
        shell.kill()
        shell.wait()
        os.close(terminal)


def test_completion_does_not_wait_for_a_silent_manager(complete: Complete, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its socket accepts, and nothing comes."""
    from midstride.runtime.workspace import Workspace

    with tempfile.TemporaryDirectory(prefix="ms") as folder:
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        workspace = Workspace.of("silent")
        with workspace.lock(), socket.socket(socket.AF_UNIX) as server:
            server.bind(str(workspace.socket))
            server.listen()
            workspace.state.write_text("{}")
            assert complete("status --system ") == ["silent"]
            begun = time.monotonic()
            assert complete("replace ") == []
            assert 0.2 < time.monotonic() - begun < 3
            accepted, _ = server.accept()  # it was asked
            accepted.close()


def test_an_unexpected_error_prints_nothing(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    """Words that no shell would send."""
    monkeypatch.setenv("_MIDSTRIDE_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_WORDS", "midstride")
    monkeypatch.setenv("COMP_CWORD", "x")
    assert main([]) == 1
    assert capfd.readouterr() == ("", "")
    monkeypatch.setenv("_MIDSTRIDE_COMPLETE", "ksh_complete")
    assert main([]) == 1
    assert capfd.readouterr() == ("", "")


def test_completion_is_fast(talker: Midstride) -> None:
    """A person waits for it: nothing slow is imported to ask the manager."""
    environment = {
        **talker.environment,
        "_MIDSTRIDE_COMPLETE": "bash_complete",
        "COMP_WORDS": "midstride\nreplace\n",
        "COMP_CWORD": "2",
    }
    command = [sys.executable, "-X", "importtime", "-m", "midstride"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.split() == ["plain,listener", "plain,talker"]
    imported = {line.rpartition("|")[2].strip() for line in done.stderr.splitlines()}
    assert not imported & {"rich", "asyncio", "fastapi", "uvicorn", "httpx", "pydantic", "rclpy", "immutables"}
