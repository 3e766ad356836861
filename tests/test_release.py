"""The version has one place, package.xml; what repeats it for readers says the same. The tools of a release."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path

import midstride
from tools.sbom import described, vendored
from tools.upload_check import metadata_faults

ROOT = Path(__file__).parents[1]


def test_the_version_is_that_of_the_manifest_everywhere() -> None:
    version = ET.parse(ROOT / "package.xml").findtext("version")
    assert version == midstride.__version__
    extension = json.loads((ROOT / "editors" / "vscode" / "package.json").read_text(encoding="utf-8"))
    assert extension["version"] == version
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    latest = re.search(r"^## (\S+) \((\S.*)\)$", changelog, re.MULTILINE)
    assert latest is not None
    assert latest[1] == version


def test_the_licences_of_vendored_files_are_in_the_metadata() -> None:
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    vendored = sorted((ROOT / "src").rglob("vendor/*/LICENSE*"))
    assert len(vendored) == len(list((ROOT / "src").glob("**/vendor/*/"))) == 1
    releasing = (ROOT / "RELEASING.md").read_text(encoding="utf-8")
    (expression,) = re.findall(r'^license = "(.+)"$', project, re.MULTILINE)
    manifest = ET.parse(ROOT / "package.xml").findall("license")
    assert " AND ".join(each.text or "" for each in manifest) == expression
    assert all((ROOT / each.attrib["file"]).is_file() for each in manifest)
    assert f'license="{expression}"' in (ROOT / "setup.py").read_text(encoding="utf-8")
    for licence in vendored:
        package = json.loads((licence.parent / "package.json").read_text(encoding="utf-8"))
        assert f'"{licence.relative_to(ROOT)}"' in project
        assert f"{package['name']} {package['version']}" in releasing
        assert package["license"] in releasing
        assert set(package["license"].split(" OR ")) & set(expression.split(" AND "))


def test_a_bill_of_materials_describes_midstride_and_what_it_has_vendored(tmp_path: Path) -> None:
    wheel = tmp_path / "midstride-0.1.0-py3-none-any.whl"
    package = ROOT / "src" / "midstride" / "server" / "dashboard" / "vendor" / "elkjs" / "package.json"
    with zipfile.ZipFile(wheel, "w") as archive:
        archive.write(package, "midstride/server/dashboard/vendor/elkjs/package.json")
    (elk,) = vendored(wheel)
    assert elk["bom-ref"] == "pkg:npm/elkjs@0.12.1"
    own = {"bom-ref": "midstride==0.1.0", "name": "midstride", "type": "library", "externalReferences": ["file:///x"]}
    environment = {
        "components": [own, {"bom-ref": "click==8", "name": "click"}],
        "dependencies": [{"ref": "midstride==0.1.0", "dependsOn": ["click==8"]}, {"ref": "click==8"}],
    }
    document = described(environment, wheel)
    assert document["metadata"]["component"]["type"] == "application"
    assert "externalReferences" not in document["metadata"]["component"]
    assert [each["name"] for each in document["components"]] == ["click", "elkjs"]
    assert document["dependencies"][0]["dependsOn"] == ["click==8", "pkg:npm/elkjs@0.12.1"]


def test_metadata_that_an_index_shows_wrongly_is_found() -> None:
    found = list(
        metadata_faults("Name: midstride\n\n[docs](docs/tutorial.md), [site](https://example.org), [top](#top)\n")
    )
    assert [each.split()[0] for each in found] == ["pyproject.toml", "README.md"]
    assert "1 links" in found[1] and "docs/tutorial.md" in found[1]
    whole = "Project-URL: Repository, https://example.org/midstride\n\n[site](https://example.org)\n"
    assert list(metadata_faults(whole)) == []
