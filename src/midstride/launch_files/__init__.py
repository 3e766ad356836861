"""ROS 2 launch files in XML and YAML, read without ROS: the nodes that they start, written as a specification."""

PUBLIC = "CONTAINERS Containers Imported import_launch_file"
