"""``ros:`` of a module's config: which ROS services, actions and topics do what, as a table.

Texts may hold ``{argument}``, ``{action}`` (the node's name of it), ``{args}`` (all arguments), ``{vars}``
(the same as JSON), ``{message}`` (the JSON of WEI: ``action_handle`` and ``action_vars``) and ``{id}``. A
text that is one of these and nothing else becomes the value itself.
"""

from __future__ import annotations

from typing import Any

from pydantic import model_validator

from labos.spec.parts import Part


class Call(Part):
    """A call of a ``service``, a goal for an ``action``, or one picture from the topic ``frame``. ``fields``
    are the request's or the goal's. Of the answer, ``status`` is the field that says how it ended, with one
    of ``done`` if well; without it, that an answer came is a success."""

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
            raise ValueError("say one of `service`, `action` and `frame`")
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
        """How an action is started; None if it is not said."""
        return self.actions.get(action) or self.action


WEI_AT_REST = ["READY", "IDLE", "OK", "COMPLETED", "LOCKED", "PAUSED", "CANCELLED"]
"""What WEI's ROS nodes say when they carry nothing out; others, as ``UNKNOWN``, do not say that."""


def make_wei_mapping(address: str) -> dict[str, Any]:
    """What WEI's ROS nodes have below their names (``wei_services``, as its own client calls them)."""
    service = {"status": "action_response", "done": [0], "error": "action_msg", "result": "action_msg"}
    fields = {"action_handle": "{action}", "vars": "{vars}"}
    action = f"{address}/action_handler"
    told = {"type": "wei_services/srv/WeiDescription", "result": "description_response"}
    return {
        "action": {"service": action, "type": "wei_services/srv/WeiActions", "fields": fields, **service},
        "state": {"topic": f"{address}/state", "idle": WEI_AT_REST},
        "about": {"service": f"{address}/description_handler", **told},
    }


def make_camera_mapping(address: str) -> dict[str, Any]:
    """WEI's ROS cameras publish pictures, and have no services."""
    return {"action": {"frame": f"{address}/video_frames"}}
