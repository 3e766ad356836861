"""The documentation of each Ansible module says what it takes and returns, as `ansible-test sanity` compares it."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
import yaml  # type: ignore[import-untyped, unused-ignore]  # with its stubs or without

from tests.fleet.collection import COLLECTION, MODULES, ROOT, documentation, robot, texts

ARGUMENTS = {"midstride_apply": robot.APPLY, "midstride_rollback": robot.ROLLBACK, "midstride_status": robot.STATUS}


def test_each_module_is_compared() -> None:
    assert {path.stem for path in MODULES} == ARGUMENTS.keys()


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.stem)
def test_the_arguments_are_those_documented(path: Path) -> None:
    stated = documentation(path)
    assert stated["module"] == path.stem
    options: dict[str, Any] = stated["options"]
    assert all(option.pop("description") for option in options.values())
    assert options == ARGUMENTS[path.stem]


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.stem)
def test_examples_use_arguments_that_exist(path: Path) -> None:
    found = [task[name] for task in texts(path)["EXAMPLES"] for name in task if name.startswith("midstride.fleet.")]
    assert found and all(example.keys() <= ARGUMENTS[path.stem].keys() for example in found)


def tasks(play: list[dict[str, Any]]) -> list[dict[str, Any]]:
    inner = [tasks(task[part]) for task in play for part in ("block", "rescue", "always") if part in task]
    return [*play, *(task for part in inner for task in part)]


def test_the_playbook_uses_arguments_and_variables_that_are_stated() -> None:
    text = (COLLECTION / "playbooks" / "rollout.yml").read_text(encoding="utf-8")
    (play,) = yaml.safe_load(text)
    used = [(name, task[name]) for task in tasks(play["tasks"]) for name in task if name.startswith("midstride.fleet.")]
    used += list(play["module_defaults"].items())
    assert {name for name, _ in used} == {f"midstride.fleet.{name}" for name in ARGUMENTS}
    for name, given in used:
        assert given.keys() <= ARGUMENTS[name.rpartition(".")[2]].keys()
    head = "\n".join(line for line in text.splitlines() if line.startswith("#"))
    variables = set(re.findall(r"(\w+) \| default\(", text)) | set(re.findall(r"{{ (\w+) }}", text))
    registered = set(re.findall(r"register: (\w+)", text)) | {"inventory_hostname", "unreachable"}
    assert variables - registered <= set(re.findall(r"\w+", head))


def test_the_collection_has_the_version_of_the_package() -> None:
    manifest = ElementTree.parse(ROOT / "package.xml").getroot()
    stated = yaml.safe_load((COLLECTION / "galaxy.yml").read_text(encoding="utf-8"))
    assert stated["version"] == manifest.findtext("version")


@pytest.mark.ansible
@pytest.mark.full
def test_it_is_built_and_installed_and_ansible_reads_all_of_it(tmp_path: Path) -> None:
    def ansible(*words: object) -> str:
        done = subprocess.run(
            [ROOT / "tools" / "ansible", *map(str, words)], cwd=tmp_path, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    ansible("ansible-galaxy", "collection", "build", COLLECTION, "--output-path", tmp_path)
    (built,) = tmp_path.glob("*.tar.gz")
    ansible("ansible-galaxy", "collection", "install", "--offline", "--force", "-p", tmp_path / "collections", built)
    installed = tmp_path / "collections" / "ansible_collections" / "midstride" / "fleet"
    assert {path.stem for path in (installed / "plugins" / "modules").iterdir()} == ARGUMENTS.keys()
    assert not list(installed.rglob("__pycache__"))
    with_it = ["env", f"ANSIBLE_COLLECTIONS_PATH={tmp_path / 'collections'}"]
    names = [f"midstride.fleet.{name}" for name in ARGUMENTS]
    shown = yaml.safe_load(ansible(*with_it, "ansible-doc", "--json", *names))
    for name, arguments in ARGUMENTS.items():
        read = shown[f"midstride.fleet.{name}"]
        assert read["doc"]["options"].keys() == arguments.keys() and read["return"] and read["examples"]
    ansible(*with_it, "ansible-playbook", "--syntax-check", "-i", "robot,", "midstride.fleet.rollout")
