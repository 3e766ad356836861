"""Files of installed packages: in the language, and on the command line."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from midstride.lang.load import load
from midstride.package_files import NotFound, find, name_of, owner, path_of, stride_files
from tests.cli.conftest import Midstride, running
from tests.test_ament_index import TEXT, planted

FRAGMENT = TEXT.removeprefix("system s\n")


@pytest.fixture
def share(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The share folder of `robot`, installed by links to its sources, as `colcon build --symlink-install` does."""
    monkeypatch.delenv("ROS_PACKAGE_PATH", raising=False)
    monkeypatch.setenv("AMENT_PREFIX_PATH", planted(tmp_path / "install", "robot"))
    folder = tmp_path / "install" / "share" / "robot"
    for name, text in {
        "robot.stride": 'system s\ninclude "parts/arm.stride"\nparameters "package://robot/all.yaml"\n',
        "parts/arm.stride": FRAGMENT,
        "all.yaml": "/**: {ros__parameters: {}}\n",
    }.items():
        source = tmp_path / "src" / name.replace("parts/", "made/of/")
        source.parent.mkdir(parents=True, exist_ok=True)
        source.write_text(text, encoding="utf-8")
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).symlink_to(source)
    return folder


def diagnostics(path: Path) -> list[str]:
    return [f"{d.code} {d.message}; {d.help}" for d in load(path).diagnostics if d.severity == "error"]


def test_a_file_of_a_package_includes_what_is_installed_beside_it(share: Path) -> None:
    loaded = load(share / "robot.stride")
    assert diagnostics(share / "robot.stride") == []
    assert {str(source.path) for source in loaded.files} >= {str(share / "parts/arm.stride"), str(share / "all.yaml")}


def test_a_file_is_included_once_however_it_is_named(share: Path, tmp_path: Path) -> None:
    (tmp_path / "mine.stride").write_text(
        'system s\ninclude "package://robot/parts/arm.stride"\ninclude "package://robot/parts/../parts/arm.stride"\n'
    )
    assert diagnostics(tmp_path / "mine.stride") == []
    (share / "all.stride").write_text('include "arms.stride"\n')
    (share / "arms.stride").write_text('include "package://robot/all.stride"\n')
    (tmp_path / "mine.stride").write_text('system s\ninclude "package://robot/all.stride"\n')
    (cycle,) = diagnostics(tmp_path / "mine.stride")
    assert cycle.startswith("E103 include cycle: all.stride includes arms.stride includes all.stride")


@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("package://robto/parts/arm.stride", "E108 `{}` cannot be included: package robto is not installed: there is "
         "no share/ament_index/resource_index/packages/robto in {install}; did you mean `robot`?"),
        ("package://elsewhere/a.stride", "E108 `{}` cannot be included: package elsewhere is not installed: there is "
         "no share/ament_index/resource_index/packages/elsewhere in {install}; "
         "build it, and source the `setup.bash` of its workspace"),
        ("package://robot/../../../src/made/of/arm.stride",
         "E108 `{}` cannot be included: {} is not a file of package robot; its files are below {share}"),
        ("package://robot//etc/x.stride",
         "E108 `{}` cannot be included: {} is not a file of package robot; its files are below {share}"),
        ("package://robot/parts/amr.stride", "E100 `{}` cannot be included: no such file or directory; in {share}: "
         "did you mean `parts/arm.stride`?"),
        ("package://robot/x.yaml", "E107 `{}` cannot be included: its name does not end in .stride; None"),
        ("../src/made/of/arm.stride", None),
    ],
)  # fmt: skip
def test_what_cannot_be_included_is_said(share: Path, tmp_path: Path, name: str, found: str | None) -> None:
    mine = tmp_path / "mine" / "mine.stride"
    mine.parent.mkdir()
    mine.write_text(f'system s\ninclude "{name}"\n{FRAGMENT}')
    (error,) = diagnostics(mine)
    if found is None:  # what a package links to may be read by the name in the package alone
        assert error.startswith("E107")
    else:
        assert error == found.replace("{}", name).format(install=tmp_path / "install", share=share)


def test_a_parameter_file_that_a_package_lacks_is_named(share: Path, tmp_path: Path) -> None:
    mine = tmp_path / "mine.stride"
    mine.write_text(f'system s\nparameters "package://robot/al.yaml"\n{FRAGMENT}')
    (error,) = diagnostics(mine)
    assert error.startswith("E100") and error.endswith(f"in {share}: did you mean `all.yaml`?")


def test_paths_and_names(share: Path, tmp_path: Path) -> None:
    assert path_of("package://robot/robot.stride", os.environ) == str(share / "robot.stride")
    assert find("robot", "arm.stride", os.environ) == str(share / "parts" / "arm.stride")
    assert name_of(str(share / "parts" / "arm.stride"), os.environ) == "package://robot/parts/arm.stride"
    assert name_of(str(tmp_path / "src" / "robot.stride"), os.environ) is None
    assert stride_files("robot", os.environ) == ["robot.stride", "parts/arm.stride"]
    (share / "other").mkdir()
    (share / "other" / "arm.stride").write_text("")
    several = "package robot has 2 files arm.stride; write `package://robot/other/arm.stride` or `package://robot/parts"
    with pytest.raises(NotFound, match=several):
        find("robot", "arm.stride", os.environ)


def test_an_overlay_comes_first(share: Path, tmp_path: Path) -> None:
    over = planted(tmp_path / "over", "robot")
    environment = {"AMENT_PREFIX_PATH": f"{over}{os.pathsep}{tmp_path / 'install'}"}
    assert path_of("package://robot/robot.stride", environment).startswith(over)
    assert owner(str(share / "robot.stride"), environment) == ("robot", str(share))
    assert name_of(str(share / "robot.stride"), environment) is None


def test_packages_of_ros_1_are_below_ros_package_path(tmp_path: Path) -> None:
    (tmp_path / "src" / "deep" / "arm").mkdir(parents=True)
    (tmp_path / "src" / "deep" / "arm" / "package.xml").write_text("<package><name>arm_robot</name></package>")
    (tmp_path / "src" / "deep" / "arm" / "arm.stride").write_text("")
    environment = {"ROS_PACKAGE_PATH": str(tmp_path / "src")}
    path = str(tmp_path / "src" / "deep" / "arm" / "arm.stride")
    assert find("arm_robot", "arm.stride", environment) == path
    assert name_of(path, environment) == "package://arm_robot/arm.stride"
    missing = f"package arm_robt is not below {tmp_path}/src \\(ROS_PACKAGE_PATH\\); did you mean `arm_robot`"
    with pytest.raises(NotFound, match=missing):
        find("arm_robt", "arm.stride", environment)


# -- commands ------------------------------------------------------------------------------------------------


@pytest.fixture
def midstride(share: Path, tmp_path: Path) -> Midstride:
    for midstride in running():
        midstride.environment["AMENT_PREFIX_PATH"] = str(tmp_path / "install")
        return midstride
    raise AssertionError


@pytest.mark.parametrize(
    ("command", "status", "said"),
    [
        ("export robot robot.stride", 0, ""),
        ("check package://robot/robot.stride", 0, ""),
        ("diff package://robot/robot.stride package://robot/robot.stride", 0, ""),
        ("plan robot robot.stride --to package://robot/robot.stride", 0, ""),
        ("impact package://robot/robot.stride", 0, ""),
        ("fmt --check package://robot/all.yaml", 1, ""),
        (
            "export robot rbot.stride",
            1,
            "package robot has no file rbot.stride in {share}; did you mean `robot.stride`?",
        ),
        ("export robot nothing.at_all", 1, "it has no .at_all files: install them to share/robot"),
        ("export package://robot/rbot.stride", 1, "package robot has no file rbot.stride in {share}; did you mean"),
        ("export robot", 1, "there is no file robot; package robot has `package://robot/robot.stride` or `package:"),
        ("export robbot robot.stride", 1, "did you mean `robot`?"),
        ("export robot package://robot/robot.stride", 2, "says where it is; leave robot out"),
        ("export a.stride b.stride", 2, "got unexpected extra argument (b.stride); give one file, or a package"),
        ("export robot robot.stride more", 2, "got unexpected extra argument (more)"),
    ],
)
def test_commands(midstride: Midstride, share: Path, command: str, status: int, said: str) -> None:
    done = midstride(*command.split())
    assert done.status == status, done.err
    assert said.format(share=share) in done.err


def test_an_installed_copy_is_not_formatted(midstride: Midstride, share: Path) -> None:
    (share / "copy.stride").write_text("system   s\n")
    done = midstride("fmt", "package://robot/copy.stride")
    assert done.status == 1 and "copy.stride is an installed copy, which the next build replaces" in done.err
    assert midstride("fmt", "package://robot/parts/arm.stride").status == 0


def test_a_file_here_that_differs_is_said(
    midstride: Midstride, share: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "robot.stride").write_text("system edited\n")
    done = midstride("export", "robot", "robot.stride")
    assert done.json["system"] == "s"
    assert done.err == f"({share}/robot.stride of package robot is taken; robot.stride here differs from it)\n"
    (tmp_path / "robot").mkdir()
    assert "robot is a folder; package robot has `package://robot/robot.stride`" in midstride("export", "robot").err
