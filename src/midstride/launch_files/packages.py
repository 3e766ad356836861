"""The folders of ROS packages: installed ones by the ament index, and source trees in folders that the user names."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from functools import cached_property

from midstride.ament_index import executable, prefix_of, prefixes
from midstride.errors import StartFailed
from midstride.launch_files.findings import UnknownValue
from midstride.model.near_miss import did_you_mean
from midstride.package_files import MAX_FOLDERS, PACKAGE_NAME, packages_below, ros1_folders


class Packages:
    """Installed packages are those of AMENT_PREFIX_PATH in ``environment``; ``folders`` have source trees."""

    def __init__(self, environment: Mapping[str, str], folders: Sequence[str]) -> None:
        self.environment = environment
        self._folders = folders

    def share(self, name: str) -> str:
        """The folder of a package's launch and parameter files. Raises UnknownValue."""
        prefix = self._installed(name)
        if prefix is not None:
            return os.path.join(prefix, "share", name)
        if name in self._sources:
            return self._sources[name]
        raise UnknownValue(f"package `{name}` is not here", "package")

    def prefix(self, name: str) -> str:
        """The folder in which a package is installed. Raises UnknownValue."""
        prefix = self._installed(name)
        if prefix is None:
            raise UnknownValue(f"package `{name}` is not installed here", "package")
        return prefix

    def executable(self, package: str, name: str) -> str:
        """The path of an executable of an installed package. Raises UnknownValue."""
        self.prefix(package)
        try:
            return executable(package, name, self.environment)
        except StartFailed as error:
            raise UnknownValue(str(error), "package") from None

    def is_installed(self, name: str) -> bool:
        return self._installed(name) is not None

    def __contains__(self, name: str) -> bool:
        return self._installed(name) is not None or name in self._sources

    def roots(self) -> list[str]:
        """The folders below which launch files of packages are."""
        return [*self.installed_folders(), *self._folders]

    def installed_folders(self) -> list[str]:
        """The folders below which the files of installed packages are."""
        return [os.path.join(prefix, "share") for prefix in prefixes(self.environment)]

    def _installed(self, name: str) -> str | None:
        return prefix_of(name, self.environment) if PACKAGE_NAME.fullmatch(name) else None

    @cached_property
    def _sources(self) -> dict[str, str]:
        return packages_below(self._folders)


class RosPackagePath(Packages):
    """Packages of ROS 1: those below ROS_PACKAGE_PATH in ``environment``, and those below ``folders``."""

    def __init__(self, environment: Mapping[str, str], folders: Sequence[str]) -> None:
        super().__init__(environment, [*ros1_folders(environment), *folders])

    def executable(self, package: str, name: str) -> str:
        folder, known = self.share(package), set[str]()
        if installed := self.installed_executable(package, name):
            return installed
        for number, (where, inner, files) in enumerate(os.walk(folder)):
            if number > MAX_FOLDERS:
                break
            inner[:] = sorted(each for each in inner if not each.startswith("."))
            found = {each: os.path.join(where, each) for each in files if _can_be_run(os.path.join(where, each))}
            if name in found:
                return found[name]
            known |= found.keys()
        help = did_you_mean(name, known)
        message = f"package `{package}` has no executable `{name}` in {folder}"
        raise UnknownValue(f"{message}; {help}" if help else message, "package")

    def installed_executable(self, package: str, name: str) -> str | None:
        """The path of an executable that catkin has put in `lib/PACKAGE`; None where there is none."""
        share = os.path.dirname(self.share(package))
        beside = [os.path.dirname(share)] if os.path.basename(share) == "share" else []
        prefixes = [*beside, *self.environment.get("CMAKE_PREFIX_PATH", "").split(os.pathsep)]
        paths = (os.path.join(prefix, "lib", package, name) for prefix in prefixes if prefix)
        return next(filter(_can_be_run, paths), None)

    def is_installed(self, name: str) -> bool:
        return name in self

    def installed_folders(self) -> list[str]:
        return ros1_folders(self.environment)

    def _installed(self, name: str) -> str | None:
        return None


def _can_be_run(path: str) -> bool:
    return os.path.isfile(path) and os.access(path, os.X_OK)
