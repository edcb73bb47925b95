"""``ros:`` of a module's config: a table with the ROS services, actions and topics for its actions.

Texts may contain ``{argument}``, ``{action}`` (the node's name of the action), ``{args}`` (all arguments),
``{vars}`` (the same as JSON), ``{message}`` (the JSON of WEI: ``action_handle`` and ``action_vars``) and
``{id}``. A text that consists of only one of these is replaced by the value itself.
"""

from __future__ import annotations

from typing import Any

from pydantic import model_validator

from labos.spec.parts import Part


class Call(Part):
    """A call of a ``service``, a goal for an ``action``, or one image from the topic ``frame``. ``fields``
    are the request's or the goal's. ``status`` is the field of the answer with the outcome; one of the values
    ``done`` is a success. Without ``status``, any answer is a success."""

    service: str = ""
    action: str = ""
    frame: str = ""
    type: str = ""
    fields: dict[str, Any] = {}
    status: str = ""
    done: list[Any] = [True]
    error: str = ""
    result: str = ""

    @model_validator(mode="after")
    def _is_one_thing(self) -> Call:
        if sum(map(bool, (self.service, self.action, self.frame))) != 1:
            raise ValueError("write one of `service`, `action` and `frame`")
        if not self.frame and not self.type:
            raise ValueError("`type` is missing, as `std_srvs/srv/Trigger`")
        return self


class RosState(Part):
    """The topic on which a node tells its state. A word counts wherever it stands in the text. With ``idle``,
    a text with none of the words is not idle."""

    topic: str
    type: str = "std_msgs/msg/String"
    field: str = "data"
    busy: list[str] = ["BUSY", "RUNNING"]
    idle: list[str] = []
    error: list[str] = ["ERROR"]


class RosMapping(Part):
    """A node's interface. ``action`` is how all actions are started, ``actions`` what differs for single
    ones."""

    action: Call | None = None
    actions: dict[str, Call] = {}
    state: RosState | None = None
    about: Call | None = None
    resources: Call | None = None
    reset: Call | None = None
    stop: Call | None = None

    def call(self, action: str) -> Call | None:
        """The call that starts an action; None if the table has none."""
        return self.actions.get(action) or self.action


WEI_AT_REST = ["READY", "IDLE", "OK", "COMPLETED", "LOCKED", "PAUSED", "CANCELLED"]
"""The states of WEI's ROS nodes in which they carry nothing out. Other states, such as ``UNKNOWN``, do not
show this."""


def make_wei_mapping(address: str) -> dict[str, Any]:
    """The services of WEI's ROS nodes below their names (``wei_services``, as its own client calls them)."""
    service = {"status": "action_response", "done": [0], "error": "action_msg", "result": "action_msg"}
    fields = {"action_handle": "{action}", "vars": "{vars}"}
    action = f"{address}/action_handler"
    reply = {"type": "wei_services/srv/WeiDescription", "result": "description_response"}
    return {
        "action": {"service": action, "type": "wei_services/srv/WeiActions", "fields": fields, **service},
        "state": {"topic": f"{address}/state", "idle": WEI_AT_REST},
        "about": {"service": f"{address}/description_handler", **reply},
    }


def make_camera_mapping(address: str) -> dict[str, Any]:
    """WEI's ROS cameras publish images, and have no services."""
    return {"action": {"frame": f"{address}/video_frames"}}
