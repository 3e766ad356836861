"""What the graph shows of the servers of a node, beside what its component declares."""

from __future__ import annotations

from midstride.foreign.declared_servers import DeclaredServers
from midstride.foreign.graph_check import NamedServer, Served
from midstride.foreign.node import of_topics
from midstride.lang.load import load_text

TEXT = """system mapping
service /map : nav_msgs/srv/GetMap
action /dock : nav2_msgs/action/DockRobot
topic /pose : std_msgs/msg/String
component Server {
  run "server" gate preload
  client clear : std_srvs/srv/Empty
  server map
  action server dock
  output pose
  functionality serve {
    uses clear
    produces map, dock, pose
    mode normal {
      guarantee map : nav_msgs/srv/GetMap
      guarantee dock : nav2_msgs/action/DockRobot
      guarantee pose : std_msgs/msg/String @ 1 Hz
    }
    mode off { }
  }
}
"""
COMPONENT = load_text(TEXT).require().components["Server"]
SERVERS = DeclaredServers(
    COMPONENT, {"map": "/map", "dock": "/dock", "pose": "/pose", "clear": "/clear"}, "/map_server"
)
MAP = NamedServer("service", "/map", "nav_msgs/srv/GetMap")
DOCK = NamedServer("action", "/dock", "nav2_msgs/action/DockRobot")


def test_servers_that_are_as_declared() -> None:
    served = Served(servers=frozenset({MAP, DOCK}))
    assert SERVERS.ports == ["map", "dock"]
    assert SERVERS.shown(served)
    assert SERVERS.differences(served) == []


def test_a_server_that_is_missing() -> None:
    served = Served(own=(MAP._replace(name="/mapp"),), servers=frozenset({DOCK, MAP._replace(name="/mapp")}))
    assert not SERVERS.shown(served)
    assert SERVERS.differences(served) == [
        "node /map_server does not serve service /map, for server map of Server; it serves service /mapp"
    ]


def test_a_server_of_another_type() -> None:
    served = Served(servers=frozenset({MAP._replace(type="nav_msgs/srv/GetPlan"), DOCK}))
    assert SERVERS.shown(served)
    assert SERVERS.differences(served) == [
        "node /map_server serves service /map of type nav_msgs/srv/GetPlan, "
        "and server map of Server is declared as nav_msgs/srv/GetMap"
    ]


def test_a_service_is_no_ros_action_of_its_name() -> None:
    assert not SERVERS.shown(Served(servers=frozenset({MAP, DOCK._replace(kind="service")})))


def test_only_topics_have_gates() -> None:
    assert of_topics(COMPONENT).ports() == ["pose"]
