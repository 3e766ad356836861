"""The options of `midstride up` for every process of a system; its next manager keeps to it."""

from __future__ import annotations

from typing import Final

import msgspec


class SystemOptions(msgspec.Struct, frozen=True):
    """``use_sim_time``: ``/clock`` drives every node that does not say otherwise.

    ``middleware_settings``: Midstride sets transports and discovery for its processes, where the user has not.
    ``spares``: how many processes to keep ready for the next components.
    ``diagnostics``: components publish on ``/diagnostics``.
    ``finish_interrupted``: a change that was interrupted because the manager was killed is finished, not rolled back.
    ``keep_degraded``: what the local reflex has degraded stays so until a command restores it.
    ``strict``: the first `up` starts all nodes or none.
    """

    use_sim_time: bool = False
    middleware_settings: bool = True
    spares: int = 0
    diagnostics: bool = True
    finish_interrupted: bool = False
    keep_degraded: bool = False
    strict: bool = False

    def with_(self, later: SystemOptions) -> SystemOptions:
        """The options with what a later ``up`` asks for besides; `midstride down` ends them."""
        return SystemOptions(
            self.use_sim_time or later.use_sim_time,
            self.middleware_settings and later.middleware_settings,
            max(self.spares, later.spares),
            self.diagnostics and later.diagnostics,
            self.finish_interrupted or later.finish_interrupted,
            self.keep_degraded or later.keep_degraded,
            self.strict or later.strict,
        )


NO_OPTIONS: Final = SystemOptions()
