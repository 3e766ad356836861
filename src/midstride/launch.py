"""For ROS 2 launch files: an action that brings a specification up, and ends it with the launch.

In Python, ``from midstride.launch import BringUpSystem``; in XML,
``<midstride specification="$(dirname)/chat.stride"/>``.
"""

from midstride.backends.ros2.manager.launch_action import BringUpSystem

__all__ = ["BringUpSystem"]
