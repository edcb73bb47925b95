"""The MiR's REST interface, version 2.0.0: the meaning of its numbers, and the contents of requests.

Sources: AD-SDL/mir_module, src/mir_interface/mir_interface.py and MiR *API Features* rev 02 there;
JanJericevic/MiRco_robot; wiesenklee/mir250-demo; InOrbit's public connector (recorded status);
mir_msgs/RobotState.
"""

from __future__ import annotations

import base64
import hashlib

BASE = "/api/v2.0.0"
READY, PAUSE, EXECUTING, EMERGENCY_STOP, MANUAL, ERROR = 3, 4, 5, 10, 11, 12
AT_REST = (READY, PAUSE, EMERGENCY_STOP, MANUAL, ERROR)
"""States in which it carries nothing out. Other numbers, such as those of starting or docking, are not known
to be told here: they do not say that it rests."""

DONE, ABORTED = "Done", "Aborted"
"""Ends of an entry in the queue; ``Pending`` and ``Executing`` come before."""

MOVE_M = 0.1
"""So near to its target a ``move`` ends."""


def make_authorization(user: str, password: str) -> str:
    """The header ``Authorization`` of a user. It differs from the usual scheme Basic: it contains a SHA-256
    digest of the password, not the password."""
    digest = hashlib.sha256(password.encode()).hexdigest()
    return "Basic " + base64.b64encode(f"{user}:{digest}".encode()).decode()


def make_steps(kind: str, position: str) -> dict[str, object]:
    """The only action of a mission: it moves to a position, or docks at it (``kind``)."""
    values: dict[str, object]
    if kind == "docking":
        values = {"marker": position, "retries": 10, "max_linear_speed": 0.3}
    else:
        values = {
            "position": position,
            "cart_entry_position": "main",
            "main_or_entry_position": "main",
            "marker_entry_position": "entry",
            "retries": 10,
            "distance_threshold": MOVE_M,
        }
    parameters = [{"id": name, "value": value, "input_name": None} for name, value in values.items()]
    return {"action_type": kind, "parameters": parameters, "priority": 1}
