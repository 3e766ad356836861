"""The tests. ``colcon test`` runs those in :mod:`tests.ros_package.installed` alone; pytest runs all others."""

from __future__ import annotations

import unittest


def load_tests(loader: unittest.TestLoader, _: unittest.TestSuite, __: str | None) -> unittest.TestSuite:
    """The tests for `python -m unittest`, as `colcon test` calls it in the folder of the package."""
    return loader.loadTestsFromName("tests.ros_package.installed")
