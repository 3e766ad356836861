"""The control plane: what crosses between the manager and its components, and how it travels.

Each component listens on an address of its own; the manager connects to it, and so does the component's
peer of a hand-over. :mod:`.commands` are the typed commands, each with its reply; :mod:`.state` is what a
component says of itself; :mod:`.frames` is the envelope and its one codec; :mod:`.transport` says what a
transport is, :mod:`.sockets` is the one of real systems (Unix sockets), :mod:`.pipe` an in-memory one.
:mod:`.channel` and :mod:`.command_server` are the two ends of a connection. Nothing here uses ROS.
"""
