"""The program `ros2` for tests: that of ros2cli where it can be imported, else of its documented interface."""

from __future__ import annotations

import importlib
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Final

DOCUMENTED: Final = Path(__file__).with_name("documented")
# Its program imports rclpy.
IS_HERE: Final = all(find_spec(name) for name in ("ros2cli", "rclpy"))


def main() -> object:
    if not IS_HERE:
        sys.path.insert(0, str(DOCUMENTED))
    sys.argv[0] = "ros2"
    return importlib.import_module("ros2cli.cli").main()


if __name__ == "__main__":
    sys.exit(main())  # type: ignore[arg-type]
