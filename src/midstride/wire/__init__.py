"""The control plane: what crosses between the manager and its components, and how it travels.

Each component listens on its own address; the manager connects to it, and so does its peer of a hand-over.
:mod:`.commands` has the typed commands, each with its reply; :mod:`.state` what a component reports; :mod:`.frames` the
envelope and its codec. :mod:`.transport` defines what a transport is: :mod:`.sockets` is that of real systems (Unix
sockets, in the folders of :mod:`.folders`), :mod:`.pipe` an in-memory one. :mod:`.channel` and :mod:`.command_server`
are the two ends of a connection. Nothing here uses ROS.
"""
