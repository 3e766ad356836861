"""What crosses between the manager and a component: commands, replies, announcements, as plain values.

Both sides speak it and neither knows the other; how it travels is the back end's affair (ROS 2:
parameter services; ROS 1: one service; the simulator: a call). Everything here maps to JSON.
"""
