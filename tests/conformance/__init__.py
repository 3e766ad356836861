"""The checks that any back end must pass: each an async function of a back end and a folder to work in.

``CHECKS`` lists them all, and ``SERVICE_CHECKS`` those for platforms with services and ROS actions. They use puppets,
so they check the same on every platform, except for latencies and the time that discovery takes. The tests of a back
end run each check with an unopened back end::

    @pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
    def test_conformance(check, tmp_path):
        simulator = Simulator()
        simulator.run(check(simulator, tmp_path))
"""

# Each of these modules adds its checks to the list.
from tests.conformance import calls, handovers, life, port_checks, services, walks  # noqa: F401
from tests.conformance.lab import CHECKS, SERVICE_CHECKS, Check

__all__ = ["CHECKS", "SERVICE_CHECKS", "Check"]
