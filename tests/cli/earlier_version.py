"""An earlier version of Midstride: the wheel of a recorded commit, built from the history of the repository."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from tests.cli.conftest import ROOT

# Version 10 of the control protocol and layout 19 of the page: the oldest that this version can take over.
TAKEN_OVER = "11a846200b3a6e24c141e1218fd26f8e746dbdb2"
# Version 7 of the control protocol, and a journal of form 1.
TOO_EARLY = "c8cd49194ae536f49c1253e3f12a455d5e518283"


def installed(commit: str, folder: Path) -> Path:
    """A folder with what the wheel of ``commit`` installs; skips the test where it cannot be built."""
    archive = subprocess.run(["git", "archive", commit], cwd=ROOT, capture_output=True, check=False)
    if archive.returncode != 0:
        pytest.skip(f"this clone has no commit {commit}, as a shallow one has not: `git fetch --unshallow` gets it")
    if importlib.util.find_spec("hatchling") is None:
        pytest.skip("hatchling is not installed, which builds the wheel: `make test` installs it")
    sources, site = folder / "sources", folder / "site"
    sources.mkdir()
    subprocess.run(["tar", "-x", "-C", str(sources)], input=archive.stdout, check=True)
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder / "wheel")]
    subprocess.run(build, cwd=sources, capture_output=True, check=True)
    (wheel,) = (folder / "wheel").glob("midstride-*.whl")
    with zipfile.ZipFile(wheel) as files:
        files.extractall(site)
    return site


def environment(site: Path) -> dict[str, str]:
    """The variable with which Python, here and in what is started, uses what is installed in ``site``."""
    before = os.environ.get("PYTHONPATH")
    return {"PYTHONPATH": os.pathsep.join([str(site), *([before] if before else [])])}
