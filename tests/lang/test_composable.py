"""Composable nodes in the language: read, checked, written as JSON and back, compared, shown."""

from __future__ import annotations

from pathlib import Path

import pytest

from midstride.ament_index import component_library
from midstride.codec.specification_form import decode_specification, encode_specification
from midstride.errors import StartFailed
from midstride.lang import format_text
from midstride.lang.catalogue_entry import CHATTER, NODE
from midstride.lang.load import load
from midstride.model.component import ContainerProgram
from midstride.model.load_words import LoadWords
from midstride.plan.specification_diff import component_differences
from tests.test_ament_index import planted, warnings

RUN = '  run component "demo::Talker -r a:=b" package "demo" in "component_container_mt" takes 2 s gate preload\n'
TEXT = CHATTER.replace("  output", f"{RUN}  output") + NODE


def registered(prefix: Path, package: str, content: str) -> None:
    index = prefix / "share" / "ament_index" / "resource_index" / "rclcpp_components"
    index.mkdir(parents=True, exist_ok=True)
    (index / package).write_text(content, encoding="utf-8")


def loaded(folder: Path, text: str) -> Path:
    path = folder / "s.stride"
    path.write_text(text, encoding="utf-8")
    return path


def errors(folder: Path, run: str) -> list[tuple[str, str, str | None]]:
    found = load(loaded(folder, TEXT.replace(RUN, f"  run {run}\n"))).diagnostics
    return [(each.code, each.message, each.help) for each in found if each.severity == "error"]


def test_it_is_read_written_and_compared(tmp_path: Path) -> None:
    specification = load(loaded(tmp_path, TEXT)).require()
    talker = specification.components["Talker"]
    container = ContainerProgram("component_container_mt", "rclcpp_components")
    assert (talker.run, talker.package, talker.container) == ("demo::Talker -r a:=b", "demo", container)
    assert (talker.startup_seconds, talker.gate) == (2, "preload")
    assert decode_specification(encode_specification(specification)) == specification
    assert format_text(TEXT).text == TEXT
    own = TEXT.replace('"component_container_mt"', '"box --fast" package "boxes"')
    other = load(loaded(tmp_path, own)).require().components["Talker"]
    assert other.container == ContainerProgram("box --fast", "boxes")
    assert not other.same_body(talker)
    assert list(component_differences(talker, other)) == [
        "in: component_container_mt of package rclcpp_components -> box --fast of package boxes"
    ]
    default = TEXT.replace(' in "component_container_mt"', "")
    assert load(loaded(tmp_path, default)).require().components["Talker"].container == ContainerProgram()


def test_its_class_and_its_container_are_looked_up_by_check(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, prefix = loaded(tmp_path, TEXT), tmp_path / "prefix"
    planted(prefix, "demo")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(prefix))
    found = warnings(path)
    assert len(found) == 2
    assert "package demo registers no component classes" in found[0]
    assert "is loaded by `component_container_mt`, but package rclcpp_components is not installed" in found[1]
    registered(prefix, "demo", "demo::Tolker;lib/libdemo.so\n")
    assert "package demo has no component class demo::Talker; did you mean `demo::Tolker`?" in warnings(path)[0]
    registered(prefix, "demo", "demo::Talker;lib/libdemo.so\n")
    assert f"the library of demo::Talker is not there: {prefix}/lib/libdemo.so; build package demo" in warnings(path)[0]
    (prefix / "lib" / "libdemo.so").touch()
    containers = planted(tmp_path / "ros", "rclcpp_components", "component_container_mt")
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{prefix}:{containers}")
    assert warnings(path) == []
    environment = {"AMENT_PREFIX_PATH": f"{containers}:{prefix}"}
    assert component_library("demo", "demo::Talker", environment) == f"{prefix}/lib/libdemo.so"
    with pytest.raises(StartFailed, match=r"package none is not installed: there is no .*rclcpp_components/none in"):
        component_library("none", "none::X", environment)
    with pytest.raises(StartFailed, match="AMENT_PREFIX_PATH is not set"):
        component_library("demo", "demo::Talker", {})


@pytest.mark.parametrize(
    ("run", "code", "message", "help"),
    [
        ('component "demo::T" gate preload', "E027", "no package is stated", 'run component "…" package "…"'),
        ('component "demo::T" package "demo"', "E027", "has no gate", "gate preload"),
        ('component "demo::T" package "demo" gate relay', "E027", "yet it has `gate relay`", "a relay starts programs"),
        ('component "demo::T" package "demo" gate preload unnamed', "E027", "yet it is `unnamed`", "states its name"),
        ('component "demo::T" package "demo" gate none renames t', "E027", "it `renames t`", "that is loaded"),
        ('component "demo::T" package "demo" once', "E027", "it is `once`", "does not end"),
        ('component "-r a:=b" package "demo" gate none', "E009", "does not begin with a class", None),
        ('component "demo::T -p a:=1" package "demo" gate none', "E009", "state it in `parameters { … }`", None),
        ('component "demo::T -n talker" package "demo" gate none', "E009", "is named after its role", None),
        ('component "demo::T --fast" package "demo" gate none', "E009", "`--fast` is none of", None),
        ('component "demo::T -r a" package "demo" gate none', "E009", "and not by `FROM:=TO`", None),
        ('component "demo::T -e n:=" package "demo" gate none', "E009", "and not by `NAME:=VALUE`", None),
        ('component "demo::T -e n:=[1]" package "demo" gate none', "E009", "is not one value", None),
        (f'component "demo::T -e n:={2**63}" package "demo" gate none', "E009", "the integers of 64 bits", None),
        ('component "demo::T" package "demo" in "./box" gate none', "E009", "names a file", "executable"),
        ('component "demo::T" package "demo" in "box" package "b x" gate none', "E009", "not a valid package", None),
        ("component demo::T", "E120", "a class in double quotes after `run component`", 'run component "demo::T'),
        ('component "demo::T" package "demo" in box', "E120", "the program of a component container", None),
    ],
)
def test_what_cannot_be_is_refused(tmp_path: Path, run: str, code: str, message: str, help: str | None) -> None:
    found = errors(tmp_path, run)
    assert any(each == code and message in said and (help or "") in (hint or "") for each, said, hint in found), found


def test_the_words_after_the_class() -> None:
    words = LoadWords.of(
        "a::B -r x:=/y -e use_clock_thread:=false -e threads:=3 -e share:=0.5 --remap-rule c:=d -e n:=m"
        f" -e most:={2**63 - 1} -e least:=-{2**63}"
    )
    assert (words.plugin, words.remaps) == ("a::B", ("x:=/y", "c:=d"))
    assert dict(words.extra) == {
        "use_clock_thread": False,
        "threads": 3,
        "share": 0.5,
        "n": "m",
        "most": 2**63 - 1,
        "least": -(2**63),
    }
