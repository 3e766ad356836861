"""Where Alloy gives no answer, the verdict is UNKNOWN with the reason and the exit status says no: never a pass."""

from __future__ import annotations

import json
import os
import stat
import sys
import zipfile
from pathlib import Path

import pytest

from midstride.cli import main
from midstride.verify import run
from midstride.verify.checking import AlloyOptions, verify_specification
from midstride.verify.verdict import Answer, Verdict
from tests.verify.systems import TALKER, specification


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A machine without Java and without Alloy, but for what a test puts there."""
    empty = tmp_path / "bin"
    empty.mkdir()
    monkeypatch.setenv("PATH", str(empty))
    monkeypatch.delenv("JAVA_HOME", raising=False)
    monkeypatch.delenv("MIDSTRIDE_ALLOY", raising=False)
    monkeypatch.setattr(run, "jar_folders", lambda: [tmp_path])
    return tmp_path


def java(folder: Path, *lines: str, version: str = "17.0.2") -> None:
    """A program that says it is Java, and answers as these lines of Python do (``output`` is where to)."""
    body = ["import json, pathlib, sys, time"]
    body += [f"if '-version' in sys.argv: sys.exit('openjdk version \"{version}\"')"]
    body += ["output = pathlib.Path(sys.argv[sys.argv.index('-o') + 1])", *lines]
    script = folder / "bin" / "java"
    script.write_text("\n".join([f"#!{sys.executable} -IS", *body, ""]), encoding="utf-8")
    script.chmod(script.stat().st_mode | stat.S_IXUSR)


def jar(folder: Path) -> Path:
    path = folder / "alloy.jar"
    path.write_bytes(b"")
    return path


def verdict(alloy: Path | None = None, limit: float = 30.0) -> Verdict:
    found = verify_specification(specification(TALKER), options=AlloyOptions(alloy, limit))
    assert found.answer is Answer.UNKNOWN
    assert not found.holds
    return found


def answering(document: object) -> tuple[str, ...]:
    return "output.mkdir()", f"(output / 'receipt.json').write_text({json.dumps(document)!r})"


# -- nothing to ask ------------------------------------------------------------------------------------------


def test_no_java(folder: Path) -> None:
    because = "Java is not installed; the Alloy Analyzer needs Java 17 or later (a JRE is enough)"
    assert verdict(jar(folder)).because == because


def test_a_java_that_is_too_old(folder: Path) -> None:
    java(folder, version="1.8.0_402")
    because = f"{folder / 'bin' / 'java'} is Java 8; the Alloy Analyzer needs Java 17 or later"
    assert verdict(jar(folder)).because == because


def test_no_alloy(folder: Path) -> None:
    java(folder)
    because = str(verdict().because)
    assert because.startswith("the Alloy Analyzer 6.2.0 is not installed: `make alloy` fetches it")
    assert str(verdict(folder / "none.jar").because).startswith(f"there is no Alloy Analyzer at {folder / 'none.jar'}")


def test_the_fetched_file_must_be_alloy(folder: Path) -> None:
    java(folder)
    (folder / run.JAR).write_bytes(b"something else")
    assert "is not Alloy 6.2.0 (its SHA-256 differs)" in str(verdict().because)


# -- no answer, or none that can be trusted ------------------------------------------------------------------


def test_no_answer_in_time(folder: Path) -> None:
    java(folder, "time.sleep(60)")
    assert verdict(jar(folder), limit=0.5).because == "no answer within 0.5 s"


def test_out_of_memory(folder: Path) -> None:
    java(folder, "sys.exit('Exception in thread \"main\" java.lang.OutOfMemoryError: Java heap space')")
    assert verdict(jar(folder)).because == "Alloy ran out of memory"


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        pytest.param(("sys.exit('it fell over')",), "it fell over", id="it says why"),
        pytest.param(("sys.exit(3)",), "Alloy ended without an answer", id="it ends in silence"),
        pytest.param((), "Alloy ended without an answer", id="it ends well and leaves nothing"),
        pytest.param(answering([]), "cannot read Alloy's answer", id="its answer is something else"),
        pytest.param(answering({"commands": {}}), "Alloy finds no instance of it", id="it leaves out the commands"),
        pytest.param(
            answering({"commands": {"Verdict": {"solution": []}}}), "the dump contradicts itself", id="no instance"
        ),
        pytest.param(
            answering({"commands": {"Verdict": {"solution": [{"instances": [{"values": {"Findings$0": {}}}]}]}}}),
            "Alloy's answer is incomplete: no ",
            id="it says nothing of what it was asked",
        ),
    ],
)
def test_an_invalid_answer(lines: tuple[str, ...], words: str, folder: Path) -> None:
    java(folder, *lines)
    assert words in str(verdict(jar(folder)).because)


def nothing_found() -> dict[str, object]:
    fields = ("refused", "wrong", "invalid", "faults", "unsatisfied", "crowded", "overloaded")
    values: dict[str, dict[str, list[str]]] = {"Findings$0": {name: [] for name in fields}}
    return {"Verdict": {"solution": [{"instances": [{"values": values}]}]}, "Verified": {}, "Rules": {}}


def test_no_findings_are_a_pass_only_if_the_checks_agree(folder: Path) -> None:
    java(folder, *answering({"commands": nothing_found()}))
    assert verify_specification(specification(TALKER), options=AlloyOptions(jar(folder))).holds
    for check in ("Verified", "Rules"):
        missing = nothing_found()
        del missing[check]
        for other in (missing, nothing_found() | {check: nothing_found()["Verdict"]}):
            java(folder, *answering({"commands": other}))
            because = str(verdict(jar(folder)).because)
            assert because == f"Alloy contradicts itself: it finds no violation, but the check {check} does not hold"


def test_an_atom_that_is_not_in_the_dump(folder: Path) -> None:
    answer = nothing_found()
    answer["Verdict"]["solution"][0]["instances"][0]["values"]["Findings$0"]["invalid"] = [["S9$0"]]  # type: ignore[index]
    java(folder, *answering({"commands": answer}))
    assert verdict(jar(folder)).because == "Alloy's answer contains S9$0, which is not in the dump"


# -- the real one --------------------------------------------------------------------------------------------


@pytest.mark.alloy
def test_a_jar_that_is_not_alloy(tmp_path: Path) -> None:
    text = tmp_path / "text.jar"
    text.write_text("not a jar", encoding="utf-8")
    assert "Invalid or corrupt jarfile" in str(verdict(text).because)
    other = tmp_path / "other.jar"
    with zipfile.ZipFile(other, "w") as archive:
        archive.writestr("META-INF/MANIFEST.MF", "Manifest-Version: 1.0\nMain-Class: Nothing\n")
    assert "Could not find or load main class Nothing" in str(verdict(other).because)


@pytest.mark.alloy
def test_alloy_itself_without_memory_or_time(monkeypatch: pytest.MonkeyPatch) -> None:
    assert verdict(limit=0.05).because == "no answer within 0.05 s"
    monkeypatch.setenv("JAVA_TOOL_OPTIONS", "-Xmx3m")
    assert verdict().because == "Alloy ran out of memory"


# -- the exit status -----------------------------------------------------------------------------------------


def test_unknown_is_no_pass(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["verify", str(TALKER), "--alloy", str(jar(folder))]) == 1
    assert capsys.readouterr().out.startswith("UNKNOWN: the initial configuration (nothing was verified; Alloy): Java")
    assert main(["verify", str(TALKER), "--json"]) == 1
    document = json.loads(capsys.readouterr().out)
    assert (document["verdict"], document["findings"]) == ("unknown", [])
    assert document["because"].startswith("the Alloy Analyzer 6.2.0 is not installed: `make alloy` fetches it")


def test_the_text_is_saved_without_alloy(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kept = folder / "talker.als"
    assert main(["verify", str(TALKER), "-o", str(kept)]) == 1
    assert "one sig listener extends Component" in kept.read_text(encoding="utf-8")
    assert main(["verify", str(TALKER), "-o", os.fspath(folder / "no" / "talker.als")]) == 1
    assert "cannot write" in capsys.readouterr().err
