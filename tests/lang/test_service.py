"""The language service: diagnostics of whole systems, hover, definition, rename, completion, formatting."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import pytest

from midstride.lang import load_text
from midstride.lang.service import LanguageService
from midstride.lang.source_files import Unreadable

SEEDS = Path(__file__).parent / "seeds"
PATROL = (SEEDS / "patrol.stride").read_text(encoding="utf-8")
SENSORS = (SEEDS / "sensors.stride").read_text(encoding="utf-8")
ROOT, PART = Path("/ws/patrol.stride"), Path("/ws/sensors.stride")


@pytest.fixture
def service() -> LanguageService:
    disk = {ROOT: PATROL, PART: SENSORS}

    def read(path: Path) -> str:
        if path not in disk:
            raise Unreadable("E100", "no such file")
        return disk[path]

    made = LanguageService(read=read)
    made.open(ROOT, PATROL)
    made.open(PART, SENSORS)
    return made


def at(text: str, marked: str) -> tuple[int, int]:
    """Line and column of the place marked `|` in an excerpt of ``text``."""
    before, _, after = marked.partition("|")
    assert text.count(before + after) == 1, (text.count(before + after), marked)
    offset = text.index(before + after) + len(before)
    line = text.count("\n", 0, offset) + 1
    return line, offset - (text.rfind("\n", 0, offset) + 1) + 1


def test_a_fragment_is_seen_as_part_of_its_system(service: LanguageService) -> None:
    assert service.diagnostics(PART) == {ROOT: [], PART: []}
    service.open(PART, SENSORS.replace("out : Scan", "out : Scam"))
    found = service.diagnostics(PART)
    assert [(d.code, d.help) for d in found[PART]] == [("E008", "did you mean `Scan`?")]
    assert found[ROOT] == []
    service.close(PART)
    assert service.diagnostics(ROOT) == {ROOT: [], PART: []}


def test_a_file_that_is_no_system_and_that_none_includes(service: LanguageService) -> None:
    lone = Path("/other/lone.stride")
    service.open(lone, "topic /a : std_msgs/msg/String\n")
    assert [d.code for d in service.diagnostics(lone)[lone]] == ["E106"]


@pytest.mark.parametrize(
    ("where", "expected"),
    [
        (
            "topic /sc|an      :",
            [
                "**topic** `/scan`",
                "`sensor_msgs/msg/LaserScan @ 10 Hz",
                "published by `lidar.out`",
                "subscribed by `detector.scan`",
                "satisfied",
            ],
        ),
        ("      assume Came|ra", ["**contract** `Camera`", "sensor_msgs/msg/Image @ 15 Hz"]),
        ("node det|ector   :", ["component `ObstacleDetector`", "`detector.detect` will be in mode **normal**"]),
        (
            "like Obs|tacleDetector",
            ["`python3 -m patrol.detector`", "input `scan : sensor_msgs", "functionality `detect`"],
        ),
        ("controller.con|trol at", ["modes: normal, stop; weight 10", "will be in mode **normal**"]),
        ("control at nor|mal", ["assumes obstacles", "guarantees `cmd : geometry_msgs/msg/Twist @ 20 Hz`"]),
        ("produces o|ut\n\n    mode", ["normal: `sensor_msgs/msg/Range @ 10 Hz`", "degraded: `nothing`"]),
        ("gpu_mem|ory = 8192", ["capacity 8192", "in use initially: 2048"]),
        ("guarantee camera_|device", ["`sensor_msgs/msg/Image @ 30 Hz"]),
        ("changeable thres|hold", ["`0.4`, changeable in place"]),
    ],
)
def test_hover(service: LanguageService, where: str, expected: list[str]) -> None:
    text = service.hover(ROOT, *at(PATROL, where))
    assert text is not None
    for piece in expected:
        assert piece in text


def test_hover_says_why_a_functionality_falls(service: LanguageService) -> None:
    changed = PATROL.replace('include "sensors.stride"', "").replace("node controller", "node  controller")
    service.open(ROOT, changed)
    text = service.hover(ROOT, *at(changed, "node  contr|oller"))
    assert text is not None
    assert "`controller.control` will be in mode **stop**" in text
    assert "no publisher satisfies /obstacles" in text


@pytest.mark.parametrize(
    ("path", "where", "declared"),
    [
        (ROOT, "scan <- /sc|an", (ROOT, "topic |/scan      :")),
        (PART, "out : Sc|an", (ROOT, "contract |Scan   =")),
        (ROOT, "node detector   : Obs|tacleDetector", (ROOT, "component |ObstacleDetector {")),
        (ROOT, "detector.de|tect below", (ROOT, "functionality |detect weight")),
        (ROOT, "order detector before contr|oller", (ROOT, "node |controller :")),
        (ROOT, "detector   : ObstacleDetector { sc|an", (ROOT, "input  |scan :")),
        (PART, "node lidar : Lid|ar", (PART, "component |Lidar {")),
    ],
)
def test_definition(service: LanguageService, path: Path, where: str, declared: tuple[Path, str]) -> None:
    texts = {ROOT: PATROL, PART: SENSORS}
    span = service.definition(path, *at(texts[path], where))
    assert span is not None
    assert (span.source.path, *span.source.position(span.start)) == (declared[0], *at(texts[declared[0]], declared[1]))
    assert service.definition(ROOT, 1, 1) is None


def applied(service: LanguageService, path: Path, where: str, name: str) -> dict[Path, str]:
    texts = {ROOT: PATROL, PART: SENSORS}
    edits = service.rename(path, *at(texts[path], where), name)
    for span, text in sorted(edits, key=lambda edit: -edit[0].start):
        file = span.source.path
        assert file is not None
        texts[file] = texts[file][: span.start] + text + texts[file][span.end :]
    return texts


@pytest.mark.parametrize(
    ("where", "name", "count"),
    [
        ("contract Sc|an   =", "Laser", 4),
        ("topic /obst|acles :", "/things", 3),
        ("component Obst|acleDetector {", "Finder", 3),
        ("node det|ector   :", "finder", 3),
        ("functionality det|ect weight", "find", 2),
        ("  input  sc|an : Scan", "laser", 5),
        ("control at nor|mal", "usual", 2),
        ("gpu_mem|ory = 8192", "vram", 2),
    ],
)
def test_rename_changes_every_place_and_nothing_of_the_meaning(
    service: LanguageService, where: str, name: str, count: int
) -> None:
    texts = applied(service, ROOT, where, name)
    found = sum(texts[path].count(name) - {ROOT: PATROL, PART: SENSORS}[path].count(name) for path in texts)
    assert found == count
    loaded = load_text(texts[ROOT], str(ROOT), read=lambda path: texts[path])
    assert loaded.diagnostics == ()


def test_rename_in_namespaces_keeps_names_relative() -> None:
    text = (
        "system s\nnamespace a {\n  topic t : std_msgs/msg/String\n  component C { output out }\n"
        "  node n : C { out -> t }\n  node m : C { out -> /a/t }\n}\n"
    )
    service = LanguageService(read=lambda path: text)
    path = Path("/ws/s.stride")
    service.open(path, text)
    edits = service.rename(path, *at(text, "topic |t :"), "u")
    assert [(span.text, new) for span, new in edits] == [("t", "u"), ("t", "u"), ("/a/t", "/a/u")]


def test_rename_in_a_file_included_twice_changes_both_of_what_it_declares() -> None:
    """One declaration, two topics and two nodes: every reference to either is renamed, however it is written."""
    texts = {
        Path("/ws/s.stride"): (
            'system s\ncontract C = std_msgs/msg/String\ninclude "c.stride"\nnode z : In { in <- r1/t }\n'
            'namespace r1 { include "part.stride"   node in : In { in <- t } }\n'
            'namespace r2 { include "part.stride"   node in : In { in <- /r2/t } }\n'
            "order r1/n before /r2/n\n"
        ),
        Path("/ws/c.stride"): (
            "component In { input in : C functionality f { uses in mode m { assume in } mode d { } } }\n"
            "component Out { output out functionality f { produces out mode m { guarantee out : C } mode d { } } }\n"
        ),
        Path("/ws/part.stride"): "topic t : C\nnode n : Out { out -> t }\n",
    }
    service = LanguageService(read=lambda path: texts[path])
    for path, text in texts.items():
        service.open(path, text)
    part, root = Path("/ws/part.stride"), Path("/ws/s.stride")
    assert service.diagnostics(root) == {path: [] for path in texts}
    edits = service.rename(part, *at(texts[part], "topic |t :"), "u")
    assert sorted((span.text, new) for span, new in edits) == [
        ("/r2/t", "/r2/u"), ("r1/t", "r1/u"), ("t", "u"), ("t", "u"), ("t", "u"),
    ]  # fmt: skip
    edits = service.rename(root, *at(texts[root], "before /r2/|n"), "m")
    assert sorted((span.text, new) for span, new in edits) == [("/r2/n", "/r2/m"), ("n", "m"), ("r1/n", "r1/m")]


@pytest.mark.parametrize(
    ("where", "name", "message"),
    [
        ("node det|ector   :", "lidar", "node `lidar` is already declared"),
        ("topic /obst|acles :", "/odom", "topic `/odom` is already declared"),
        ("mode lid|ar_only {", "normal", "duplicate mode `normal`"),
        ("  input  sc|an : Scan", "Camera", "`Camera` is both an input of ObstacleDetector and a contract"),
        ("contract Sc|an   =", "contract", "`contract` is a keyword"),
    ],
)
def test_a_name_that_is_taken_is_refused(service: LanguageService, where: str, name: str, message: str) -> None:
    with pytest.raises(ValueError, match=f"^the rename would cause an error: {re.escape(message)}"):
        service.rename(ROOT, *at(PATROL, where), name)


@pytest.mark.parametrize(
    ("where", "name", "message"),
    [
        ("contract Sc|an   =", "a b", "`a b` is not a valid contract name"),
        ("contract Sc|an   =", "a/b", "`a/b` is not a valid contract name"),
        ("# pat|rol", "x", "there is no symbol to rename at this position"),
    ],
)
def test_what_cannot_be_renamed_is_refused(service: LanguageService, where: str, name: str, message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}$"):
        service.rename(ROOT, *at(PATROL, where), name)


@pytest.mark.parametrize(
    ("written", "offered", "not_offered"),
    [
        ("node n : |", {"ObstacleDetector", "Lidar"}, {"Scan", "detector"}),
        ("component X like |", {"MotorController"}, {"Scan"}),
        ("node n : Lidar { |", {"out", "parameters"}, {"run"}),
        ("node n : Lidar { out -> |", {"/scan", "/cmd_vel"}, {"Scan"}),
        ("topic /x : |", {"Scan", "Camera"}, {"/scan"}),
        ("topic /x : Scan qos(|", {"reliability", "depth"}, {"reliable"}),
        ("topic /x : Scan qos(reliability = |", {"reliable", "best_effort"}, {"volatile"}),
        ("keep |", {"detector", "controller"}, {"Scan"}),
        ("keep detector.|", {"detect"}, {"control"}),
        ("keep detector.detect at |", {"normal", "lidar_only", "degraded"}, {"stop"}),
        ("order detector before |", {"controller"}, {"Scan"}),
        ("|", {"node", "component", "topic"}, {"assume", "run"}),
        ("component X { |", {"run", "functionality"}, {"assume", "node"}),
        ("component X { holds |", {"gpu_memory", "/dev/video0"}, set()),
        ("timing { |", {"create", "handover"}, {"node"}),
        ("environment { guarantee x on |", {"/scan"}, {"Scan"}),
        ("# node n : |", set(), {"Lidar"}),
    ],
)
def test_completion(service: LanguageService, written: str, offered: set[str], not_offered: set[str]) -> None:
    text = PATROL + written.replace("|", "")
    service.open(ROOT, text)
    line = text.count("\n") + 1
    words = {c.word for c in service.complete(ROOT, line, written.index("|") + 1)}
    assert offered <= words
    assert not words & not_offered


def test_completion_inside_a_component_knows_its_ports(service: LanguageService) -> None:
    text = PATROL.replace("      assume Camera  ", "      assume sc  ")
    service.open(ROOT, text)
    words = {c.word for c in service.complete(ROOT, *at(text, "      assume sc|  "))}
    assert {"scan", "Camera"} <= words
    assert "obstacles" not in words


def test_format(service: LanguageService) -> None:
    assert service.format(ROOT) == PATROL
    service.open(ROOT, "system   s\n")
    assert service.format(ROOT) == "system s\n"
    service.open(ROOT, "system {\n")
    assert service.format(ROOT) is None


def test_every_request_is_answered_while_a_file_is_being_written(service: LanguageService) -> None:
    """The file up to the middle of each line: the answers agree with each other, and there are some of each kind."""
    lines = PATROL.split("\n")
    answered: Counter[str] = Counter()
    for number, whole in enumerate(lines[1:], 1):
        text = "\n".join([*lines[:number], whole[: len(whole) // 2]])
        service.open(ROOT, text)
        line, column = number + 1, len(whole) // 2 + 1
        errors = [d.code for found in service.diagnostics(ROOT).values() for d in found if d.severity == "error"]
        assert ("E106" in errors) == ("\nsystem" not in text), text
        formatted = service.format(ROOT)
        if formatted is None:
            assert {code for code in errors if "E110" <= code <= "E134"}, text
        else:
            assert formatted.split() == text.split(), text
        for row, place in [(line, column), *((number, place + 1) for place in range(len(lines[number - 1])))]:
            hover, definition = service.hover(ROOT, row, place), service.definition(ROOT, row, place)
            assert definition is None or (hover is not None and f"`{definition.text}`" in hover)
            answered["hover"] += hover is not None
            answered["definition"] += definition is not None
        words = service.complete(ROOT, line, column)
        assert not (words and "#" in lines[number][: column - 1]), "nothing is proposed in a comment"
        answered["words"] += bool(words)
        answered["not formatted" if formatted is None else "formatted"] += 1
    assert set(answered) == {"hover", "definition", "words", "formatted", "not formatted"}
    assert min(answered.values()) >= 10, answered
