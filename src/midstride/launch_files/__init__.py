"""Launch files of ROS 2 and ROS 1, read without ROS: the nodes that they start, written as a specification."""

PUBLIC = "CONTAINERS Containers Imported import_launch_file"
