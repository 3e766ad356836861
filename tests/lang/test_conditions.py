"""`condition` on an input: in the text, in JSON, in the editor, in a difference, and in a skeleton."""

from __future__ import annotations

from pathlib import Path

import pytest

from midstride.codec.specification_form import decode_specification, encode_specification
from midstride.errors import NodeError
from midstride.generate.project import project
from midstride.lang import format_text, load_text
from midstride.lang.completion import complete
from midstride.lang.service import LanguageService
from midstride.lang.source import Source
from midstride.node.author.component_class import Component
from midstride.plan.specification_diff import component_differences

TEXT = """system s

component Diver {
  run "python3 diver.py"
  input depth : std_msgs/msg/Float64 @ 10 Hz where data >= 3 tolerates 3 missed condition
  functionality dive {
    uses depth
    mode normal { assume depth }
    mode degraded { }
  }
}
component Careless like Diver {
  input depth : std_msgs/msg/Float64 @ 10 Hz where data >= 3 tolerates 3 missed
}
component Same like Diver
"""


def test_a_condition_is_read_inherited_and_kept_by_the_formatter() -> None:
    components = load_text(TEXT).require().components
    found = {name: component.conditions for name, component in components.items()}
    assert found == {"Diver": {"depth"}, "Careless": frozenset(), "Same": {"depth"}}
    assert components["Diver"].same_body(components["Same"])
    assert not components["Diver"].same_body(components["Careless"])
    assert list(component_differences(components["Careless"], components["Diver"])) == ["condition depth: added"]
    assert format_text(TEXT).text == TEXT


def test_the_json_form_has_it() -> None:
    system = load_text(TEXT).require()
    document = encode_specification(system)
    stated = {name: document["components"][name]["inputs"]["depth"].get("condition") for name in ("Diver", "Careless")}
    assert stated == {"Diver": True, "Careless": None}
    assert decode_specification(document) == system


@pytest.mark.parametrize(
    ("wrong", "code", "words"),
    [
        (TEXT.replace(" where data >= 3", "", 1), "E004", "input depth is a condition, but constrains no field"),
        (TEXT.replace('diver.py"', 'diver.py" gate none', 1), "E027", "input depth of Diver cannot be a condition"),
    ],
)
def test_what_is_wrong_is_said_at_its_place(wrong: str, code: str, words: str) -> None:
    [first, *_] = load_text(wrong).diagnostics
    assert first.code == code and first.message.startswith(words)
    assert first.span is not None and first.span.text == "condition"


def test_the_editor_knows_it(tmp_path: Path) -> None:
    service, path = LanguageService(), tmp_path / "s.stride"
    service.open(path, TEXT)
    hover = service.hover(path, 8, 26)
    assert hover is not None and hover.endswith("tolerates 3 missed, a condition")
    resolved = service.analysis(path).loaded.resolved
    assert resolved is not None

    def words(before: str) -> set[str]:
        return {each.word for each in complete(Source("s.stride", before), len(before), resolved)}

    start = "system s\ncomponent A {\n  input a : std_msgs/msg/String where data = x "
    assert {"condition", "tolerates"} <= words(start)
    assert "condition" not in words(f"{start}condition ")


def test_a_skeleton_states_it_and_the_api_asks_for_a_constraint() -> None:
    text = TEXT + "topic /t : std_msgs/msg/Float64 @ 10 Hz where data >= 3\nnode diver : Diver { depth <- /t }\n"
    text = text.partition("component Careless")[0] + text.partition("component Same like Diver\n")[2]
    files = project(load_text(text).require(), "s.stride", {}).files
    [program] = [file.text for file in files if file.path.name == "diver.py"]
    assert "tolerates=3, condition=True)" in program
    with pytest.raises(NodeError, match="a condition needs a constraint"):
        Component("c").create_input("a", type("String", (), {"__msgtype__": "std_msgs/msg/String"}), condition=True)
