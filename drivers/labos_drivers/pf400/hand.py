"""The state of the fingers, from their width: open, holding something, shut, or unknown.

Actions that need an empty hand require open fingers. At an unknown width, a plate may be between the fingers.
It would fall if they opened.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

from labos.errors import BadInput
from labos_drivers.pf400.protocol import BETWEEN_GRIPS_MM, NARROW, WIDE, Grip

ABOUT_MM = 1.2
"""How far a width may be from the one expected."""

SHUT_MM = 75.0
"""Closed further than any plate is wide."""

Grips = Mapping[str, Grip]


class Fingers(NamedTuple):
    """The state of the fingers, and the grip with which they hold something (None: they do not)."""

    state: Literal["open", "holding", "unknown", "shut"]
    grip: Grip | None = None


class Hand:
    """The grips of one arm: ``grips:`` of its configuration, and ``grips_of:`` for types of labware. Widths
    are in mm of the gripper's joint. Raises BadInput for grips that are impossible or ambiguous."""

    def __init__(self, name: str, config: Mapping[str, Any]) -> None:
        self._name = name
        self._grips = self._read_grips("grips", config.get("grips", {}), {"narrow": NARROW, "wide": WIDE})
        of = config.get("grips_of", {})
        if not isinstance(of, Mapping):
            raise BadInput(f"{name}: `grips_of` must map types of labware to their grips.")
        self._of: dict[str, Grips] = {
            str(kind): self._read_grips(f"grips_of: {kind}", configured, self._grips)
            for kind, configured in of.items()
        }
        self._grasped: tuple[Grip, float] | None = None
        self._refuse_ambiguous()

    def find_grip(self, side: str, kind: str) -> Grip:
        """The grip ``narrow`` or ``wide`` for a type of labware."""
        return self._of.get(kind, self._grips)[side]

    def read(self, width_mm: float) -> Fingers:
        """The state of the fingers at this width (mm)."""
        if self._grasped is not None and abs(width_mm - self._grasped[1]) <= ABOUT_MM:
            return Fingers("holding", self._grasped[0])
        known = self._list_grips()
        for grip in known:
            if abs(width_mm - grip.closed_mm) <= ABOUT_MM:
                return Fingers("holding", grip)
        if any(abs(width_mm - grip.open_mm) <= ABOUT_MM for grip in known):
            return Fingers("open")
        return Fingers("shut") if width_mm < SHUT_MM else Fingers("unknown")

    def guess_grip(self, width_mm: float, kind: str) -> Grip:
        """The grip of fingers that hold something, from their width (mm) alone."""
        return self.find_grip("wide" if width_mm > BETWEEN_GRIPS_MM else "narrow", kind)

    def grasp(self, grip: Grip, width_mm: float) -> None:
        """Note that the fingers have closed on something at this width (mm)."""
        self._grasped = (grip, width_mm)

    def forget(self) -> None:
        """Forget what the fingers hold, before they open."""
        self._grasped = None

    def looks_open(self, width_mm: float) -> bool:
        """Whether fingers that hold something at this width (mm) look open. Forgets the last grasp."""
        self._grasped = None
        return self.read(width_mm).state == "open"

    def describe_widths(self) -> str:
        """The open widths (mm), as a text for messages."""
        return " or ".join(f"{width:g}" for width in sorted({grip.open_mm for grip in self._list_grips()}))

    def _list_grips(self) -> list[Grip]:
        return [grip for grips in (self._grips, *self._of.values()) for grip in grips.values()]

    def _refuse_ambiguous(self) -> None:
        for one in self._list_grips():
            for other in self._list_grips():
                if abs(one.open_mm - other.closed_mm) <= 2 * ABOUT_MM:
                    raise BadInput(
                        f"{self._name}: open at {one.open_mm:g} mm could not be distinguished from closed at "
                        f"{other.closed_mm:g} mm.",
                        remedy="Choose wider open widths under `grips:` and `grips_of:`.",
                    )

    def _read_grips(self, key: str, configured: Any, usual: Grips) -> Grips:
        if not isinstance(configured, Mapping) or set(configured) - set(usual):
            raise BadInput(
                f"{self._name}: `{key}` does not describe grips.",
                remedy="Write, say, `{narrow: {open: 90, closed: 85}, wide: {open: 130, closed: 127}}` (mm).",
            )
        return {
            side: self._read_grip(f"{key}: {side}", configured.get(side, {}), grip)
            for side, grip in usual.items()
        }

    def _read_grip(self, key: str, configured: Any, usual: Grip) -> Grip:
        widths = {"open": usual.open_mm, "closed": usual.closed_mm}
        if isinstance(configured, Mapping) and not set(configured) - set(widths):
            widths.update(configured)
            values = list(widths.values())
            if all(isinstance(value, int | float) for value in values):
                grip = Grip(usual.name, float(values[0]), float(values[1]))
                if SHUT_MM < grip.closed_mm < grip.open_mm - 2 * ABOUT_MM:
                    return grip
        raise BadInput(
            f"{self._name}: `{key}` is no grip.",
            remedy=f"Give `open` and `closed` in mm; closed above {SHUT_MM:g}, and open more than "
            f"{2 * ABOUT_MM:g} above closed.",
        )
