"""The simulator: the real node code in virtual time, every component in one process, no ROS needed."""

from __future__ import annotations

from midstride.backends.simulator.backend import Simulator
from midstride.backends.simulator.virtual_loop import PacedLoop, VirtualLoop, run_paced

PUBLIC = (
    "ControlOfHost CooperativeThread Ended HostClock Links ProcessOutput RequestFault SUCCEEDED ServiceObserver "
    "SimulatedClock SimulatedProcess SimulatedProgram SimulatedRequest SimulatedWriter Simulator ThreadYield "
    "UNKNOWN beside run_at_once"
)

__all__ = ["PacedLoop", "Simulator", "VirtualLoop", "run_paced"]
