#!/bin/sh
# Installs the package nav_demo below the folder $1, as `colcon build` installs a package.
set -eu
here=$(dirname "$0") prefix=$(mkdir -p "$1" && cd "$1" && pwd)
mkdir -p "$prefix/lib/nav_demo" "$prefix/share/nav_demo/launch" "$prefix/share/ament_index/resource_index/packages"
cp "$here"/*_server "$here"/lifecycle_manager "$here"/base_driver "$here"/set_pose "$here"/nav_node.py "$prefix/lib/nav_demo"
cp "$here"/launch/* "$prefix/share/nav_demo/launch"
cp "$here"/nav2_params.yaml "$prefix/share/nav_demo"
touch "$prefix/share/ament_index/resource_index/packages/nav_demo"
echo "export AMENT_PREFIX_PATH=\"$prefix\${AMENT_PREFIX_PATH:+:\$AMENT_PREFIX_PATH}\"" > "$prefix/setup.sh"
