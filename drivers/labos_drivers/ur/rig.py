"""The simulated pendant drop: the real state of its dock, pipette and tips.

The state follows from the recorded motions of the arm, so a new device of the same arm begins with it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from labos.node.world import World, lid_of
from labos_drivers.ur import protocol

TIPS = 2.0


class Rig:
    """``holds_pipette``: the pipette is on the arm, not in its dock. ``has_tip``: it has a tip with a sample.
    ``is_docked``: the arm is in the dock, in which the tool changer is locked or unlocked."""

    def __init__(self, world: World, arm: str) -> None:
        self._world, self._arm = world, arm
        self.holds_pipette = self.has_tip = self.is_docked = False
        for motion in world.motions():
            if motion.device == arm:
                self._note(motion.verb, motion.facts)

    def do(self, action: str, plate: str = "", **facts: Any) -> None:
        """Carry out an action. Raises Crash if the state of dock, pipette or tip does not allow it."""
        if action in ("dock", "undock"):
            self._dock(action, str(facts.get("tool", "")))
            return
        if self.is_docked:
            self._crash(f"does {action} in the dock")
        wanted = {
            "pick_pipette": (False, None),
            "place_pipette": (True, None),
            "create_sample": (True, False),
            "run_droplet": (False, True),
            "dispose_tip": (True, True),
        }[action]
        if self.holds_pipette is not wanted[0]:
            self._crash(f"does {action} with{'out' if wanted[0] else ''} the pipette on its wrist")
        if wanted[1] is not None and self.has_tip is not wanted[1]:
            self._crash(f"does {action} with{'out' if wanted[1] else ''} a tip on the pipette")
        if action == "create_sample":
            self._pipette(plate)
        self._world.work(self._arm, action, plate, **facts)
        self._note(action, facts)

    def _dock(self, action: str, tool: str) -> None:
        if self.is_docked is (action == "dock"):
            self._crash(f"does {action} {'in' if self.is_docked else 'away from'} the dock")
        facts = {"tool": tool} if action == "undock" else {}
        self._world.work(self._arm, action, **facts)
        self._note(action, facts)

    def read_sensors(self, wired: Mapping[str, Any]) -> dict[str, Any]:
        """The values of the sensors that are wired to the arm (``wired``), by variable."""
        on = self.list_inputs()
        return {
            name: yes if key in on else no
            for name, (key, yes, no) in protocol.SENSORS.items()
            if key in wired
        }

    def list_inputs(self) -> set[str]:
        """The names of the inputs whose sensors are on."""
        sensors = (
            ("dock_input", self.is_docked),
            ("pipette_input", self.holds_pipette),
            ("tip_input", self.has_tip),
        )
        return {key for key, is_on in sensors if is_on}

    def _pipette(self, plate: str) -> None:
        here = self._world.at(plate)
        if not here:
            self._crash("pipettes into nothing")
        if self._world.last(here[-1], "seal", "peel") == "seal" or self._world.at(lid_of(here[-1])):
            self._crash("drives its tip into a seal or a lid")
        self._world.use(self._arm, "tips", TIPS)

    def _note(self, verb: str, facts: Mapping[str, Any]) -> None:
        if verb in ("dock", "undock"):
            self.is_docked = verb == "dock"
            if verb == "undock":
                self.holds_pipette = facts.get("tool") == "pipette"
        elif verb in ("pick_pipette", "place_pipette"):
            self.holds_pipette = verb == "pick_pipette"
        elif verb in ("create_sample", "dispose_tip"):
            self.has_tip = verb == "create_sample"

    def _crash(self, what: str) -> None:
        self._world.crash(self._arm, self._arm, what)
