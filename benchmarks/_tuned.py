"""The environment of a process with the middleware set as for one that a manager starts."""

from __future__ import annotations

from collections.abc import Mapping

from midstride.backends.ros2 import dds_profiles


def tuned_environment(environment: Mapping[str, str]) -> dict[str, str]:
    """``environment`` with these settings; what it has set itself is left."""
    middleware = dds_profiles.of_this_process().middleware
    settings = dds_profiles.choose(environment, middleware, dds_profiles.loaded_major())
    return {**environment, **settings.variables}
