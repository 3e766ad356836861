"""What `midstride up` was given for every process of a system; its next manager keeps to it."""

from __future__ import annotations

from typing import Final

import msgspec


class SystemOptions(msgspec.Struct, frozen=True):
    """``use_sim_time``: ``/clock`` drives every node that does not say otherwise.

    ``middleware_settings``: Midstride sets transports and discovery for its processes, where the user has not.
    ``diagnostics``: components publish on ``/diagnostics``.
    """

    use_sim_time: bool = False
    middleware_settings: bool = True
    diagnostics: bool = True

    def with_(self, later: SystemOptions) -> SystemOptions:
        """These, and what a later ``up`` asks for besides; `midstride down` ends them."""
        return SystemOptions(
            self.use_sim_time or later.use_sim_time,
            self.middleware_settings and later.middleware_settings,
            self.diagnostics and later.diagnostics,
        )


NO_OPTIONS: Final = SystemOptions()
