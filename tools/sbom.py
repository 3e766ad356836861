"""sbom.py ENVIRONMENT WHEEL FOLDER: writes FOLDER/midstride-VERSION.cdx.json, an SBOM in CycloneDX's JSON.

ENVIRONMENT is what cyclonedx-py says of an environment in which WHEEL alone was installed. Midstride becomes what the
document describes, and the libraries that the wheel has vendored are added. Runs in .venv-release, whose library
validates the result against CycloneDX's schema.
"""

from __future__ import annotations

import hashlib
import json
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any


def vendored(wheel: Path) -> Iterator[dict[str, Any]]:
    """The components of CycloneDX for the npm packages whose files are in ``wheel``."""
    with zipfile.ZipFile(wheel) as archive:
        for name in sorted(archive.namelist()):
            if "/vendor/" in name and name.endswith("/package.json"):
                package = json.loads(archive.read(name))
                reference = f"pkg:npm/{package['name']}@{package['version']}"
                yield {
                    "type": "library",
                    "bom-ref": reference,
                    "name": package["name"],
                    "version": package["version"],
                    "description": package["description"],
                    "licenses": [{"expression": package["license"]}],
                    "purl": reference,
                    "properties": [{"name": "midstride:files", "value": name.rpartition("/")[0]}],
                }


def described(document: dict[str, Any], wheel: Path) -> dict[str, Any]:
    """The document about Midstride, from that about an environment."""
    (own,) = [each for each in document["components"] if each["name"] == "midstride"]
    document["components"].remove(own)
    own["type"] = "application"
    own["hashes"] = [{"alg": "SHA-256", "content": hashlib.sha256(wheel.read_bytes()).hexdigest()}]
    own.pop("externalReferences", None)  # where the wheel was installed from on this machine
    document.setdefault("metadata", {})["component"] = own
    added = list(vendored(wheel))
    document["components"] += added
    (needs,) = [each for each in document["dependencies"] if each["ref"] == own["bom-ref"]]
    needs["dependsOn"] = sorted({*needs.get("dependsOn", []), *(each["bom-ref"] for each in added)})
    document["dependencies"] += [{"ref": each["bom-ref"]} for each in added]
    return document


def main(environment: str, wheel: str, folder: str) -> int:
    from cyclonedx.schema import SchemaVersion  # type: ignore[import-not-found, unused-ignore]
    from cyclonedx.validation.json import JsonStrictValidator  # type: ignore[import-not-found, unused-ignore]

    document = described(json.loads(Path(environment).read_text(encoding="utf-8")), Path(wheel))
    text = json.dumps(document, indent=2, ensure_ascii=False) + "\n"
    if error := JsonStrictValidator(SchemaVersion.from_version(document["specVersion"])).validate_str(text):
        print(f"sbom: not valid: {error}", file=sys.stderr)
        return 1
    target = Path(folder) / f"midstride-{document['metadata']['component']['version']}.cdx.json"
    target.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
