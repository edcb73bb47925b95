"""The protocols of the dashboard of an e-Series controller, and of the gripper's port.

Dashboard, port 29999: lines that end with a line feed. It sends a greeting, then one answer to each command.
Gripper (Robotiq's URCap), port 63352: the answer to ``GET OBJ`` is ``OBJ n``.

Sources: Universal Robots, *Dashboard Server Remote Control Interface e-Series* (2022);
UniversalRobots/Universal_Robots_Client_Library, doc/architecture/dashboard_client.rst;
AD-SDL/ur_module, src/ur_interface.
"""

from __future__ import annotations

DASHBOARD, GRIPPER = 29999, 63352
END = b"\n"
GREETING = b"Connected: Universal Robots Dashboard Server"

STOPPED, PLAYING, PAUSED = "STOPPED", "PLAYING", "PAUSED"
OFF, IDLE, RUNNING = "POWER_OFF", "IDLE", "RUNNING"
NORMAL, REDUCED, PROTECTIVE = "NORMAL", "REDUCED", "PROTECTIVE_STOP"
FAULTS = ("VIOLATION", "FAULT")
REFUSALS = ("Failed to execute", "Command is not allowed")
"""How answers begin that refuse ``play``."""

MOVING, HELD_OPENING, HELD_CLOSING, EMPTY = range(4)
"""What ``OBJ`` says of the fingers."""

SENSORS: dict[str, tuple[str, str | bool, str | bool]] = {
    "docked": ("dock_input", True, False),
    "tool": ("pipette_input", "pipette", ""),
    "tip": ("tip_input", "sample", ""),
}
"""Of the pendant drop: by which input of the arm, and what it means when it is on and when it is off."""
