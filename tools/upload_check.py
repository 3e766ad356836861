"""upload_check.py WHEEL: lists what still prevents an upload, for the maintainer who releases. The exit status is 0."""

from __future__ import annotations

import re
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from email import message_from_string
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LINK = re.compile(r"\]\((?!https?://|#)([^)\s]+)\)")


def metadata_faults(text: str) -> Iterator[str]:
    """What the metadata of a wheel lack for readers of an index of packages."""
    metadata = message_from_string(text)
    if not metadata.get_all("Project-URL"):
        yield "pyproject.toml has no [project.urls]: the repository, the documentation, the issues and the changelog"
    links = LINK.findall(str(metadata.get_payload()))
    if links:
        yield f"README.md has {len(links)} links within the repository, such as {links[0]}: they are broken on an index"


def faults(wheel: Path) -> Iterator[str]:
    """All that prevents the upload of ``wheel``."""
    with zipfile.ZipFile(wheel) as archive:
        (name,) = [each for each in archive.namelist() if each.endswith(".dist-info/METADATA")]
        yield from metadata_faults(archive.read(name).decode())
    manifest = (ROOT / "package.xml").read_text(encoding="utf-8")
    if ".invalid" in manifest:
        yield "package.xml: the maintainer's address reaches nobody"
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    if "(not released yet)" in changelog:
        yield "CHANGELOG.md says that this version is not released yet"
    if any((ROOT / "changes").glob("*.*.md")):
        yield "changes/ has entries that are not in CHANGELOG.md"
    status = subprocess.run(["git", "status", "--porcelain"], cwd=ROOT, capture_output=True, text=True, check=False)
    if status.stdout.strip():
        yield "the work tree has changes that are not committed"


if __name__ == "__main__":
    found = list(faults(Path(sys.argv[1])))
    for each in found:
        print(f"dist: before an upload: {each}", file=sys.stderr)
    print("dist: nothing prevents an upload" if not found else f"dist: {len(found)} things prevent an upload")
