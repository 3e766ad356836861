"""What the tests of the gate share: the library, and the programs behind it, compiled once."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from tests.foreign.lab import Lab
from tests.native import c_compiler

HERE = Path(__file__).parent


@pytest.fixture(scope="session")
def programs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the nodes, the server, and the library that they are linked with."""
    return compiled(tmp_path_factory.mktemp("fake"))


@pytest.fixture(scope="session")
def packaged_programs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Such a folder, its library linked as librcl is in packages for Ubuntu: calls within it stay there."""
    return compiled(tmp_path_factory.mktemp("packaged"), "-Wl,-Bsymbolic-functions")


@pytest.fixture(scope="session")
def of_humble(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Such a folder, as far as the library notices a difference: as on Humble."""
    return compiled(tmp_path_factory.mktemp("humble"), distribution="HUMBLE")


@pytest.fixture(scope="session")
def of_lyrical(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Likewise as on Lyrical."""
    return compiled(tmp_path_factory.mktemp("lyrical"), distribution="LYRICAL")


@pytest.fixture(scope="session")
def on_cyclone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Likewise, requests as Cyclone DDS has them."""
    return compiled(tmp_path_factory.mktemp("cyclone"), distribution="CYCLONE")


def compiled(folder: Path, *linked: str, distribution: str = "JAZZY") -> Path:
    fake_programs(folder, c_compiler(), linked, distribution)
    return folder


@pytest.fixture
def lab(tmp_path: Path, programs: Path, gate_library: Path) -> Iterator[Lab]:
    made = Lab(tmp_path, programs, gate_library)
    yield made
    made.close()


def fake_programs(
    folder: Path, compiler: Sequence[str], linked: Sequence[str] = (), distribution: str = "JAZZY"
) -> None:
    """Compile them into ``folder`` as on a ROS 2 ``distribution``, libraries with options ``linked`` for the linker."""
    options = [*compiler, "-std=c11", "-O2", "-pthread", f"-D{distribution}"]
    for library in ("rcl", "types"):
        built = ["-shared", "-fPIC", *linked, "-o", str(folder / f"lib{library}.so"), str(HERE / f"fake_{library}.c")]
        subprocess.run([*options, *built], check=True)
    link = ["-L", str(folder), "-lrcl", "-ltypes", f"-Wl,-rpath,{folder}"]
    for program in ("node", "server", "leaving"):
        subprocess.run([*options, "-o", folder / program, HERE / f"fake_{program}.c", *link], check=True)
