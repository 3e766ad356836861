#!/bin/sh
# Installs stand-ins for Nav2 below the folder $1: packages, programs and nodes with the names that Nav2's default bring-up
# has, each program a copy of nav2_server or of the lifecycle manager of this example.
set -eu
here=$(cd "$(dirname "$0")" && pwd) prefix=$1

package() { # package NAME: it is in the index
    mkdir -p "$prefix/lib/$1" "$prefix/share/$1" "$prefix/share/ament_index/resource_index/packages"
    touch "$prefix/share/ament_index/resource_index/packages/$1"
}
server() { # server PACKAGE PROGRAM
    package "$1"
    cp "$here/../nav_node.py" "$prefix/lib/$1"
    cp "$here/nav2_server" "$prefix/lib/$1/$2"
}
server nav2_controller controller_server
server nav2_smoother smoother_server
server nav2_planner planner_server
server nav2_route route_server
server nav2_behaviors behavior_server
server nav2_bt_navigator bt_navigator
server nav2_waypoint_follower waypoint_follower
server nav2_velocity_smoother velocity_smoother
server nav2_collision_monitor collision_monitor
server opennav_docking opennav_docking
server opennav_following opennav_following
server nav2_map_server map_server
server nav2_map_server costmap_filter_info_server
server nav2_amcl amcl
package nav2_lifecycle_manager
cp "$here/../lifecycle_manager" "$prefix/lib/nav2_lifecycle_manager"
package nav2_bringup
mkdir -p "$prefix/share/nav2_bringup/launch" "$prefix/share/nav2_bringup/params"
cp "$here"/*.launch.xml "$prefix/share/nav2_bringup/launch"
cp "$here"/nav2_params.yaml "$prefix/share/nav2_bringup/params"
root=$(cd "$prefix" && pwd)
printf 'export AMENT_PREFIX_PATH="%s${AMENT_PREFIX_PATH:+:$AMENT_PREFIX_PATH}"\n' "$root" >"$prefix/setup.sh"
