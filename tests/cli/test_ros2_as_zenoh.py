"""Real processes whose middleware answers as rmw_zenoh does (tests/backends/zenoh_like.c): it is not here itself.

Imitated are what it tells and what it does not: identities that are hashes, acknowledgements that nobody has given, no
topics of services, a router that has to be there. How it transports messages is not.
"""

from __future__ import annotations

import json
import socket
import subprocess
from itertools import pairwise
from pathlib import Path

import pytest

from midstride.codec.specification_form import encode_specification
from midstride.foreign import build
from tests.acceptance.support import Recorder, ended, swap_specification
from tests.cli.conftest import Midstride
from tests.native import compile_with_ros

pytestmark = pytest.mark.ros2

SOURCE = Path(__file__).parents[1] / "backends" / "zenoh_like.c"


@pytest.fixture
def like_zenoh(tmp_path: Path, midstride: Midstride) -> Midstride:
    """The command, and all that it starts, on the imitation. The settings are for Fast DDS, on which that stands."""
    compiler, compiled, library = build.compiler(), tmp_path / "zenoh_like.o", tmp_path / "libzenoh_like.so"
    compile_with_ros([SOURCE], compiled, ["-c", "-fPIC", "-Wall", "-Wextra", "-Werror"])
    assert compiler is not None
    subprocess.run([*compiler, "-shared", str(compiled), "-o", str(library)], check=True)
    midstride.environment |= {"LD_PRELOAD": str(library), "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}
    return midstride


@pytest.mark.full
def test_up_says_where_no_router_answers_and_a_replacement_misses_nothing(
    like_zenoh: Midstride, tmp_path: Path
) -> None:
    file = tmp_path / "swap.json"
    file.write_text(json.dumps(encode_specification(swap_specification())))
    with socket.create_server(("127.0.0.1", 0)) as router:
        address = "{}:{}".format(*router.getsockname())
        like_zenoh.environment["ZENOH_CONFIG_OVERRIDE"] = f'connect/endpoints=["tcp/{address}"]'
        up = like_zenoh("up", str(file), "-d")
        assert up.status == 0 and "no Zenoh router" not in up.out + up.err, up.out + up.err
        assert like_zenoh("status", "--json").json["middleware"]["problem"] == ""
        assert like_zenoh("down").status == 0
    said = f"no Zenoh router answers at tcp/{address}: the nodes do not find each other until one runs"
    with ended():
        up = like_zenoh("up", str(file), "-d")
        assert up.status == 0 and said in up.out, up.out + up.err
        assert up.out.index(said) < up.out.index("create "), "it is said before a start that may fail because of it"
        recorder = Recorder(tmp_path)
        recorder.wait_until_it_hears()
        replaced = like_zenoh("replace", "source", "OtherSource", "--yes", "--json").json
        rows = recorder.stop()
        middleware = like_zenoh("status", "--json").json["middleware"]
        verbose = like_zenoh("status", "--verbose").out
        words = [incident["words"] for incident in like_zenoh("history", "--json").json["incidents"]]
    assert replaced["outcome"] == "done", replaced
    (swap,) = replaced["swaps"]
    assert (swap["missed"], swap["lost"], swap["duplicates"]) == (0, 0, 0), "its messages have numbers"
    numbers = [row.number for row in rows]
    assert [after for before, after in pairwise(numbers) if before is None or after != before + 1] == [1]
    assert said in middleware["problem"] and said in " ".join(verbose.split())
    assert (middleware["name"], middleware["set"]) == ("rmw_zenoh_cpp", {})
    assert [note.partition(":")[0] for note in middleware["notes"][:3]] == [
        "discovery",
        "processes",
        "acknowledgements",
    ]
    assert any(" is up with rmw_zenoh_cpp in domain" in each for each in words)
