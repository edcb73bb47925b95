"""A real ROS 2 node as a process, and how its services are called."""

from __future__ import annotations

from typing import Any

from tests.support.foreign import ForeignProcess, python_of

NODE = "/std_ns/shaker"

# The messages of `wei_services` are on no package index: those of `test_msgs` carry the same.
SERVICE = {
    "service": f"{NODE}/action_handler",
    "type": "test_msgs/srv/BasicTypes",
    "fields": {"string_value": "{message}"},
    "status": "int8_value",
    "done": [0],
    "error": "string_value",
    "result": "string_value",
}
WEI = {
    "action": SERVICE,
    "about": {**SERVICE, "service": f"{NODE}/description_handler", "fields": {}},
    "reset": {"service": f"{NODE}/reset", "type": "std_srvs/srv/Trigger", "status": "success"},
}


class RosProcess(ForeignProcess):
    """A ROS node; its port is the number of its domain."""

    says_up = "the ROS node is up"

    def environment(self) -> dict[str, str]:
        return {"ROS_DOMAIN_ID": str(self.port), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}

    @property
    def config(self) -> dict[str, Any]:
        return {"ros_python": str(python_of("ros")), "ros_domain": self.port, "ros_node_address": NODE}
