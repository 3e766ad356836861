"""The build as a ROS package, by colcon; the wheel is built from pyproject.toml (docs/how-to/ros-package.md).

Everything is said here, as Ubuntu 22.04's setuptools ignores [project]; later versions are made to ignore it, too.
The version has one place, package.xml, entry points another, pyproject.toml, and tests compare the rest with the wheel.
"""

import glob
import os
import re
import xml.etree.ElementTree as ET

from setuptools import Distribution, find_packages, setup
from setuptools.command.build_py import build_py

ROOT = os.path.dirname(os.path.realpath(__file__))


class ThisFileAlone(Distribution):
    """Reads setup.cfg, and not pyproject.toml, whose forms differ between versions of setuptools."""

    def parse_config_files(self, filenames=None, ignore_option_errors=False):
        super().parse_config_files(["setup.cfg"], ignore_option_errors)


class ExamplesAsData(build_py):
    """Does not ask the folder of the examples, which is no package of Python, for an `__init__.py`."""

    def check_package(self, package, package_dir):
        return None if package == "midstride.examples" else super().check_package(package, package_dir)


def files(folder):
    """Every file below a folder, relative to it, but the modules of packages, which `packages` lists."""
    found = []
    for path, folders, names in os.walk(os.path.join(ROOT, folder)):
        folders[:] = [name for name in folders if name != "__pycache__"]
        found += [os.path.relpath(os.path.join(path, name), os.path.join(ROOT, folder)) for name in names]
    return sorted(glob.escape(name) for name in found if not name.endswith((".pyc", ".pyo")))


def entry_points():
    """Those of pyproject.toml, read as text: Python 3.10 has no reader of TOML."""
    with open(os.path.join(ROOT, "pyproject.toml"), encoding="utf-8") as file:
        text = file.read()
    sections = re.findall(r'^\[project\.(?:scripts|entry-points\."(.+)")\]\n((?:.+ = ".+"\n)+)', text, re.MULTILINE)
    return {
        group or "console_scripts": [
            f"{name} = {value}" for name, value in re.findall(r'^"?([^" ]+)"? = "(.+)"', lines, re.MULTILINE)
        ]
        for group, lines in sections
    }


packages = find_packages(os.path.join(ROOT, "src"))
package_dir = {"": "src"}
package_data = {"midstride": files("src/midstride")}
if os.path.isdir("examples"):  # not in the folder of `--symlink-install`, which leads to this one
    packages.append("midstride.examples")
    package_dir["midstride.examples"] = "examples"
    package_data["midstride.examples"] = files("examples")

setup(
    name="midstride",
    version=ET.parse(os.path.join(ROOT, "package.xml")).findtext("version"),
    description="Replace the components of a running ROS system, with the least functionality lost on the way",
    license="Apache-2.0 AND EPL-2.0",
    distclass=ThisFileAlone,
    cmdclass={"build_py": ExamplesAsData},
    python_requires=">=3.10",
    packages=packages,
    package_dir=package_dir,
    package_data=package_data,
    data_files=[
        ("share/ament_index/resource_index/packages", ["ros/resource/midstride"]),
        ("share/midstride", ["package.xml", "ros/resource/package.dsv"]),
        ("share/midstride/environment", ["ros/completion/midstride.bash", "ros/completion/midstride.zsh"]),
        ("share/fish/vendor_completions.d", ["ros/completion/midstride.fish"]),
        ("bin", ["ros/bin/midstride"]),
    ],
    zip_safe=False,
    entry_points=entry_points(),
)
