"""`tolerates N missed` on an input: in the text, in JSON, in the editor, in a difference, and in a skeleton."""

from __future__ import annotations

import copy
from pathlib import Path

import pytest

from midstride.codec.specification_form import decode_specification, encode_specification
from midstride.errors import SpecificationError
from midstride.generate.project import project
from midstride.lang import format_text, load_text
from midstride.lang.completion import complete
from midstride.lang.service import LanguageService
from midstride.lang.source import Source
from midstride.model.specification import Specification
from midstride.plan.specification_diff import component_differences

TEXT = """system s

component Listener {
  run "python3 listener.py"
  input in : std_msgs/msg/String @ 10 Hz tolerates 3 missed
  functionality hear {
    uses in
    mode normal { assume in }
    mode degraded { }
  }
}
component Patient like Listener {
  input in : std_msgs/msg/String @ 10 Hz tolerates 20 missed
}
component Same like Listener
"""


def loaded(text: str = TEXT) -> Specification:
    return load_text(text).require()


def test_a_tolerance_is_read_and_inherited() -> None:
    components = loaded().components
    assert {name: component.tolerates["in"] for name, component in components.items()} == {
        "Listener": 3,
        "Patient": 20,
        "Same": 3,
    }
    assert components["Listener"].same_body(components["Same"])
    assert not components["Listener"].same_body(components["Patient"])
    assert list(component_differences(components["Listener"], components["Patient"])) == ["tolerates in: 3 -> 20"]


def test_the_formatter_keeps_it() -> None:
    assert format_text(TEXT).text == TEXT
    assert format_text(TEXT.replace("tolerates 3 missed", "tolerates   3\n    missed")).text is not None


def test_the_json_form_has_it() -> None:
    document = encode_specification(loaded())
    stated = document["components"]["Listener"]["inputs"]["in"]
    assert stated == {"type": "std_msgs/msg/String", "rate": 10, "tolerates": 3}
    assert decode_specification(document) == loaded()
    for wrong in (0, 2.5, "3"):
        changed = copy.deepcopy(document)
        changed["components"]["Listener"]["inputs"]["in"]["tolerates"] = wrong
        with pytest.raises(SpecificationError, match="tolerates"):
            decode_specification(changed)


@pytest.mark.parametrize(
    ("wrong", "code", "words"),
    [
        ("tolerates 0 missed", "E126", "must be a whole number of at least 1"),
        ("tolerates 2.5 missed", "E126", "must be a whole number of at least 1"),
        ("tolerates 3", "E120", "expected `missed` after `tolerates 3`"),
        ("tolerates missed", "E120", "expected a number of messages after `tolerates`"),
    ],
)
def test_what_is_wrong_is_said(wrong: str, code: str, words: str) -> None:
    found = load_text(TEXT.replace("tolerates 3 missed", wrong)).diagnostics
    assert [(diagnostic.code, words in diagnostic.message) for diagnostic in found] == [(code, True)]


def test_without_a_rate_nothing_is_ever_missed() -> None:
    found = load_text(TEXT.replace("@ 10 Hz tolerates 3", "tolerates 3")).diagnostics
    assert {diagnostic.code for diagnostic in found} == {"E004"}
    assert found[0].span is not None and found[0].span.text == "3"
    assert not load_text(TEXT.replace("@ 10 Hz tolerates 3", "qos(deadline = 100 ms) tolerates 3")).diagnostics


def test_the_editor_knows_it(tmp_path: Path) -> None:
    service, path = LanguageService(), tmp_path / "s.stride"
    service.open(path, TEXT)
    hover = service.hover(path, 8, 26)
    assert hover is not None and hover.endswith("assumes `std_msgs/msg/String @ 10 Hz`, tolerates 3 missed")
    resolved = service.analysis(path).loaded.resolved
    assert resolved is not None

    def words(before: str) -> set[str]:
        source = Source("s.stride", before)
        return {each.word for each in complete(source, len(before), resolved)}

    assert "tolerates" in words("system s\ncomponent A {\n  input a : std_msgs/msg/String @ 10 Hz ")
    assert words("system s\ncomponent A {\n  input a : std_msgs/msg/String @ 10 Hz tolerates 3 ") == {"missed"}
    assert "tolerates" not in words("system s\ncomponent A {\n  output a ")


def test_a_skeleton_states_it() -> None:
    text = TEXT + "topic /t : std_msgs/msg/String @ 10 Hz\nnode listener : Listener { in <- /t }\n"
    files = project(loaded(text), "s.stride", {}).files
    [program] = [file.text for file in files if file.path.name == "listener.py"]
    assert "create_input('in', String, rate=10, tolerates=3)" in program


CLIENT = """system s

component User {
  run "user" gate preload
  client map : nav_msgs/srv/GetMap responds within 50 ms tolerates 3 missed
  functionality use {
    uses map
    mode normal { assume map }
    mode off { }
  }
}
"""


def test_a_client_with_a_bound_tolerates_missed_requests() -> None:
    specification = loaded(CLIENT)
    assert specification.components["User"].tolerates["map"] == 3
    assert format_text(CLIENT).text == CLIENT
    assert decode_specification(encode_specification(specification)) == specification


def test_without_a_bound_no_request_is_ever_missed() -> None:
    [found] = load_text(CLIENT.replace("responds within 50 ms ", "")).diagnostics
    assert found.code == "E004" and found.span is not None and found.span.text == "3"
    assert found.message == "client map tolerates 3 missed requests, but assumes no bound, so none is ever missed"
    assert found.help is not None and "responds within 0.1 s" in found.help


def test_the_editor_knows_the_tolerance_of_a_client() -> None:
    resolved = load_text(CLIENT).resolved
    assert resolved is not None

    def words(before: str) -> set[str]:
        return {each.word for each in complete(Source("s.stride", before), len(before), resolved)}

    begun = "system s\ncomponent A {\n  client a : nav_msgs/srv/GetMap responds within 50 ms "
    assert "tolerates" in words(begun)
    assert words(f"{begun}tolerates 3 ") == {"missed"}
