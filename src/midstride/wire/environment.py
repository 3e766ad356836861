"""The environment variables from which a component's process learns which instance of which system it is."""

from __future__ import annotations

from typing import Final

ENV_INSTANCE: Final = "MIDSTRIDE_INSTANCE"
# Another for each start, by which the processes are found that this one has started.
ENV_START: Final = "MIDSTRIDE_START"
# The name of its ROS node, which all instances of a role share on ROS 2; and whether another of them answers requests.
ENV_NODE: Final = "MIDSTRIDE_NODE"
ENV_STANDBY: Final = "MIDSTRIDE_STANDBY"
# Set where a program of the system that does not use Midstride's API has, or had, a node of that name.
ENV_SHARED_NAME: Final = "MIDSTRIDE_SHARED_NAME"
ENV_NAMESPACE: Final = "MIDSTRIDE_NAMESPACE"
ENV_TOKEN: Final = "MIDSTRIDE_TOKEN"
ENV_BACKEND: Final = "MIDSTRIDE_BACKEND"
ENV_PARAMETERS: Final = "MIDSTRIDE_PARAMETERS"
# The values that were set while its predecessor ran, which it starts with instead.
ENV_SET_PARAMETERS: Final = "MIDSTRIDE_SET_PARAMETERS"
# For how long it continues the goals of its ROS actions, once its successor takes new ones (s).
ENV_PATIENCE: Final = "MIDSTRIDE_PATIENCE"
# Whether it publishes on `/diagnostics`: "0" switches that off.
ENV_DIAGNOSTICS: Final = "MIDSTRIDE_DIAGNOSTICS"
# The folder of the system's control sockets.
ENV_CONTROL: Final = "MIDSTRIDE_CONTROL"
# The system that a component started by hand belongs to, by name.
ENV_SYSTEM: Final = "MIDSTRIDE_SYSTEM"
