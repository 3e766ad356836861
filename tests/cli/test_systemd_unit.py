"""`midstride systemd`: the unit that is printed, and how its words are read by systemd."""

from __future__ import annotations

import os
import resource
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from midstride.cli import main
from midstride.cli.commands import systemd
from midstride.cli.commands.manage import OF_NO_USE
from midstride.cli.systemd_unit import OF_NO_USE as NOT_AGAIN
from midstride.cli.systemd_unit import Unit
from midstride.errors import MidstrideError

EXAMPLE = Path(__file__).parents[2] / "examples" / "talker" / "talker.stride"


def a_unit(**changes: object) -> Unit:
    values: dict[str, object] = {
        "system": "talker",
        "file": Path("/bot/talker.stride"),
        "command": ["/venv/bin/python", "-m", "midstride"],
        "up": ["/bot/talker.stride", "--backend", "ros2", "--spares", "0"],
        "environment": {"ROS_DOMAIN_ID": "5", "PATH": "/usr/bin", "HOME": "/home/me", "MIDSTRIDE_TOKEN": "secret"},
        "user": "robot",
        "uid": 1000,
        "runtime": "/run/user/1000",
    }
    return Unit(**{**values, **changes})  # type: ignore[arg-type]


def lines(unit: Unit, *names: str) -> list[str]:
    return [line for line in unit.text().splitlines() if line.split("=")[0] in names]


def verified(unit: Unit, folder: Path) -> str:
    """What systemd says about the unit."""
    if shutil.which("systemd-analyze") is None:
        pytest.skip("there is no systemd-analyze")
    path = folder / unit.name
    path.write_text(unit.text(), encoding="utf-8")
    command = ["systemd-analyze", "verify", "--man=no", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    return done.stdout + "".join(line for line in done.stderr.splitlines(True) if unit.name in line)


def test_a_unit_of_the_machine() -> None:
    assert a_unit().text() == (
        """[Unit]
Description=The robot talker, kept up by Midstride
Wants=network-online.target
After=network-online.target
RequiresMountsFor=/bot/talker.stride
# The folder of the user's run-time files, where every shell of theirs looks.
Wants=user-runtime-dir@1000.service
After=user-runtime-dir@1000.service
StartLimitIntervalSec=0

[Service]
Type=notify
User=robot
WorkingDirectory=/bot
Environment=XDG_RUNTIME_DIR=/run/user/1000
Environment=PATH=/usr/bin
Environment=ROS_DOMAIN_ID=5
ExecStart=/venv/bin/python -m midstride up /bot/talker.stride --backend ros2 --spares 0 --foreground --take-over talker
ExecReload=/venv/bin/python -m midstride apply /bot/talker.stride --yes --system talker
ExecStop=/venv/bin/python -m midstride down --system talker
# A manager that has died comes back and takes over its components, which go on meanwhile.
Restart=on-failure
RestartSec=1
RestartPreventExitStatus=2 78
KillMode=process
OOMPolicy=continue
WatchdogSec=30
# Starting, changing and stopping may take longer: the manager asks for more time.
TimeoutStartSec=90
TimeoutStopSec=90

[Install]
WantedBy=multi-user.target
"""
    )


def test_a_unit_of_a_user_has_what_a_user_may_ask_for() -> None:
    text = a_unit(user=None).text()
    assert "WantedBy=default.target" in text
    assert not any(word in text for word in ("User=", "network-online", "RequiresMountsFor", "XDG_RUNTIME_DIR"))


def test_only_a_folder_that_systemd_makes_is_waited_for() -> None:
    unit = a_unit(runtime="/srv/shared")
    assert "user-runtime-dir" not in unit.text() and "Environment=XDG_RUNTIME_DIR=/srv/shared" in unit.text()


def test_with_scripts_the_paths_are_theirs() -> None:
    environment = {"ROS_DOMAIN_ID": "5", "PATH": "/x", "AMENT_PREFIX_PATH": "/y", "ROS_DISTRO": "jazzy"}
    unit = a_unit(setup=[Path("/opt/ros/jazzy/setup.bash"), Path("/my ws/install/setup.bash")], environment=environment)
    assert lines(unit, "Environment") == ["Environment=XDG_RUNTIME_DIR=/run/user/1000", "Environment=ROS_DOMAIN_ID=5"]
    (stop,) = lines(unit, "ExecStop")
    assert stop == (
        "ExecStop=/bin/bash -c \"source /opt/ros/jazzy/setup.bash && source '/my ws/install/setup.bash' && "
        'exec \\"$$@\\"" bash /venv/bin/python -m midstride down --system talker'
    )


def test_words_with_signs_of_systemd_are_quoted(tmp_path: Path) -> None:
    file = Path('/bot/50% "of" $HOME\\x.stride')
    unit = a_unit(file=file, environment={"ROS_DOMAIN_ID": '7 "%h" $USER \\', "CYCLONEDDS_URI": "<a>\n<b/>"})
    assert 'Environment="ROS_DOMAIN_ID=7 \\"%%h\\" $USER \\\\"' in unit.text()
    assert 'Environment="CYCLONEDDS_URI=<a>\\n<b/>"' in unit.text()
    (reload,) = lines(unit, "ExecReload")
    assert '"/bot/50%% \\"of\\" $$HOME\\\\x.stride"' in reload


def test_a_folder_on_two_lines_is_refused() -> None:
    with pytest.raises(MidstrideError, match="cannot be written in a unit"):
        a_unit(file=Path("/bot\n2/talker.stride")).text()


@pytest.mark.parametrize("user", ["root", None])
def test_systemd_has_nothing_to_say_about_it(user: str | None, tmp_path: Path) -> None:
    unit = a_unit(
        user=user,
        command=[sys.executable, "-m", "midstride"],
        file=tmp_path / 'a "%b" $c.stride',
        setup=[Path("/etc/profile")],
        limits={"LimitRTPRIO": "98", "LimitMEMLOCK": "infinity", "LimitNICE": "40"},
    )
    assert verified(unit, tmp_path) == ""


def test_systemd_would_say_something(tmp_path: Path) -> None:
    unit = a_unit(command=[sys.executable], user="root", limits={"LimitRTPRIO": "high"})
    assert "ignoring: high" in verified(unit, tmp_path)


def test_the_command(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp")
    monkeypatch.setenv("MIDSTRIDE_INCLUDE_PATH", "shared:/x")
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/run/user/7")
    monkeypatch.delenv("MIDSTRIDE_BACKEND", raising=False)
    monkeypatch.setattr(systemd, "_limits", lambda: {"LimitRTPRIO": "98"})
    monkeypatch.chdir(tmp_path)
    words = ["systemd", str(EXAMPLE), "--http", "8745", "--strict", "--metrics-file", "talker.prom"]
    assert main(words) == 0
    shown, said = capsys.readouterr()
    start = next(line for line in shown.splitlines() if line.startswith("ExecStart="))
    assert shlex.split(start.removeprefix("ExecStart=")) == [
        *(sys.executable, "-m", "midstride", "up", str(EXAMPLE), "--backend", "ros2", "--spares", "0"),
        *("--http", "8745", "--strict", "--metrics-file", str(tmp_path / "talker.prom")),
        *("--foreground", "--take-over", "talker"),
    ]
    assert "Environment=RMW_IMPLEMENTATION=rmw_fastrtps_cpp" in shown and "LimitRTPRIO=98" in shown
    assert f"Environment=MIDSTRIDE_INCLUDE_PATH={tmp_path}/shared:/x" in shown
    assert "sudo systemctl enable --now midstride-talker" in said
    assert main([*words, "--user", "-o", "my.service"]) == 0
    shown, said = capsys.readouterr()
    assert shown == "" and "WantedBy=default.target" in (tmp_path / "my.service").read_text()
    assert "install -D -m 644 my.service ~/.config/systemd/user/midstride-talker.service" in said


def test_what_systemd_is_asked_for_is_what_the_user_has(monkeypatch: pytest.MonkeyPatch) -> None:
    hard = {resource.RLIMIT_RTPRIO: 98, resource.RLIMIT_NICE: 0, resource.RLIMIT_MEMLOCK: resource.RLIM_INFINITY}
    monkeypatch.setattr(resource, "getrlimit", lambda limit: (0, hard[limit]))
    assert systemd._limits() == {"LimitRTPRIO": "98", "LimitMEMLOCK": "infinity"}


def test_a_wrong_file_is_told_before_there_is_a_unit(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["systemd", str(tmp_path / "none.stride")]) == 1
    shown, said = capsys.readouterr()
    assert shown == "" and "there is no file" in said
    assert main(["systemd", str(EXAMPLE), "--http-host", "0.0.0.0"]) == 2


def test_attempts_that_are_of_no_use_are_not_made() -> None:
    assert NOT_AGAIN == (2, OF_NO_USE) == (2, os.EX_CONFIG)
