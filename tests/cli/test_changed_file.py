"""What a user has just written in a system's file, and asks for before the running system knows it."""

from __future__ import annotations

import re
import shutil

import pytest

from tests.cli.conftest import EXAMPLES, Midstride


@pytest.mark.full
def test_a_component_of_the_changed_file_is_named_with_the_way_to_get_it(
    midstride: Midstride, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("talker")
    shutil.copytree(EXAMPLES / "talker", folder, dirs_exist_ok=True)
    file = folder / "talker.stride"
    text = file.read_text()
    assert midstride("up", str(file), "--backend", "sim", "--detach").status == 0
    refused = midstride("replace", "talker", "Newer", "--yes")
    assert refused.status == 1
    assert refused.out.endswith("`--from FILE` takes `Newer` from the specification that declares it\n")
    component = re.search(r"component NewTalker .*?\n}\n", text, re.DOTALL)
    node = re.search(r"node listener .*\n(?:    .*\n|}\n)*", text)
    assert component is not None and node is not None
    file.write_text(
        text
        + component[0].replace("NewTalker", "Newer")
        + node[0].replace("node listener", "node second").replace("listener_", "second_")
    )
    refused = midstride("replace", "talker", "Newer", "--yes")
    words = f"{file} has `Newer`, which the running system does not know yet: add `--from {file}`, or carry out all"
    assert refused.status == 1 and words in refused.out and f"`midstride apply {file}`" in refused.out
    for command in (["restart", "second", "--yes"], ["param", "list", "second"], ["status", "second"]):
        refused = midstride(*command)
        words = f"{file} has `second`, which the running system does not know yet: `midstride apply {file}` adds it"
        assert refused.status == 1 and words in refused.out + refused.err
    assert "has `" not in midstride("restart", "talkr", "--yes").out
    assert midstride("replace", "talker", "Newer", "--from", str(file), "--yes").status == 0
