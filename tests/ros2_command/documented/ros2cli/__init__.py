"""The interface of ros2cli that extensions use, as it documents it: for machines where there is no ros2cli."""
