"""The report file: one script of the page's modules, and nothing in its data that could end an element."""

from __future__ import annotations

import base64
import hashlib
import html.parser
import json
import re
from pathlib import Path
from typing import Any

import pytest

from midstride.errors import MidstrideError
from midstride.model.specification import initial
from midstride.plan.change_builder import change_between
from midstride.plan.forms.plan_forms import encode_plan
from midstride.plan.strategies.registry import planner
from midstride.server.report.documents import plan_file
from midstride.server.report.file import DASHBOARD, report_file
from midstride.server.report.modules import inlined
from tests.runtime.systems import example

HOSTILE = "</script><script>alert(1)</script><!-- \u2028 ]]> & \" '"


class Elements(html.parser.HTMLParser):
    """The elements of a page with their attributes, and the text in each script and style."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[tuple[str, str]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.texts.append((self.tags[-1][0] if self.tags else "", data))


def modules(folder: Path, **texts: str) -> str:
    for name, text in texts.items():
        (folder / f"{name}.js").write_text(text)
    return inlined(folder, "main.js")


def test_modules_become_one_script_in_the_order_in_which_they_need_each_other(tmp_path: Path) -> None:
    script = modules(
        tmp_path,
        main='import { a as b,\n  c } from "./one.js";\nimport "./two.js";\nexport const d = b + c();\n',
        one='import { z } from "./two.js";\n/** import {x} from "./no" */\nexport const a = z;\nexport function c() {}',
        two="export const z = 1; // import\n",
    )
    assert not re.search(r"^\s*(import|export)\b", script, re.MULTILINE)
    assert script.index("m_two_js") < script.index("m_one_js") < script.index("m_main_js")
    assert "const { a: b, c } = m_one_js;" in script and "return { a, c };" in script
    assert script.count("const z = 1") == 1, "a module is there once"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("export default 1;\n", "an import or export of another form"),
        ('import * as all from "./one.js";\n', "an import or export of another form"),
        ("const a = 1;\nexport { a };\n", "an import or export of another form"),
        ("export let a = 1;\n", "an import or export of another form"),
        ('const a = await import("./one.js");\n', "an import or export of another form"),
        ('import { d } from "./main.js";\n', "import each other: main.js -> main.js"),
    ],
)
def test_a_form_that_would_be_lost_is_an_error(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(MidstrideError, match=re.escape(words)):
        modules(tmp_path, main=text, one="export const a = 1;\n")


def test_all_modules_of_the_page_keep_to_these_forms() -> None:
    assert "m_main_js" in inlined(DASHBOARD, "main.js")


def test_nothing_in_the_data_ends_its_element() -> None:
    text = report_file({"title": HOSTILE}, HOSTILE)
    page = Elements(text)
    scripts = [attributes for tag, attributes in page.tags if tag == "script"]
    assert [attributes.get("type") for attributes in scripts] == ["application/json", None, "module"]
    [data] = re.findall(r'<script type="application/json" id="data">(.*?)</script>', text, re.DOTALL)
    assert "<" not in data and json.loads(data) == {"title": HOSTILE}


def test_the_policy_allows_the_scripts_and_the_style_of_the_file_and_nothing_else() -> None:
    text = report_file({}, "t")
    [policy] = re.findall(r'Content-Security-Policy" content="([^"]*)"', text)
    allowed = re.findall(r"'sha256-([^']*)'", policy)
    parts = re.findall(r"<script(?: type=\"module\")?>(.*?)</script>", text, re.DOTALL)
    parts += re.findall(r"<style>(.*?)</style>", text, re.DOTALL)
    hashes = [base64.b64encode(hashlib.sha256(each.encode()).digest()).decode() for each in parts]
    assert sorted(allowed) == sorted(hashes)
    assert "unsafe" not in policy and "default-src 'none'" in policy
    assert not re.search(r'(?:src|href)="', text), "nothing is fetched"


def plan_of(**changed: Any) -> dict[str, Any]:
    start = example("talker")
    target = start.with_replaced("talker", "NewTalker")
    return encode_plan(planner("minimal")(change_between(initial(start), start, target))) | changed


def data_of(text: str) -> Any:
    [data] = re.findall(r'<script type="application/json" id="data">(.*?)</script>', text, re.DOTALL)
    return json.loads(data)


def test_a_plan_has_the_views_that_it_leads_from_and_to() -> None:
    plan = plan_of()
    data = data_of(plan_file({"minimal": plan, "paper": {"refused": "it cannot"}}, "talker", "replace talker"))
    assert data["plans"]["paper"] == {"refused": "it cannot"} and data["plans"]["minimal"]["steps"] == plan["steps"]
    assert {each["name"]: each["component"] for each in data["before"]["instances"]} == {
        "listener": "Listener",
        "talker": "Talker",
    }
    assert {each["name"]: each["component"] for each in data["after"]["instances"]} == {
        "listener": "Listener",
        "talker_2": "NewTalker",
    }
    [topic] = data["before"]["topics"]
    assert (topic["name"], topic["publishers"], topic["rate"]) == ("/chatter", ["talker.out"], 10)


def test_what_changes_require_is_said_unless_the_plan_says_whether_it_holds() -> None:
    plan = plan_of()
    required = {"topic": "/estop/released", "assumption": {"type": "std_msgs/msg/Bool"}}
    plan["start"] = {**plan["start"], "changes_require": [required]}
    words = ["changes require /estop/released : std_msgs/msg/Bool"]
    assert data_of(plan_file({"minimal": plan}, "talker", "replace"))["required"] == words
    assert data_of(plan_file({"minimal": {**plan, "requires": []}}, "talker", "replace"))["required"] == []


def test_a_plan_that_cannot_be_read_is_shown_without_a_graph() -> None:
    data = data_of(plan_file({"minimal": plan_of(steps=[{"action": "unheard of"}])}, "talker", "replace"))
    assert data["before"] is None and data["plans"]["minimal"]["steps"] == [{"action": "unheard of"}]
