"""What the width of the fingers tells: they are open, they hold something, or nobody knows.

A hand is empty only when its fingers are seen open. A width that is not known says nothing: a plate may be
between them, and to open them would drop it.
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
    """What they do, and if they hold something, in which grip (as far as that is known)."""

    state: Literal["open", "holding", "unknown", "shut"]
    grip: Grip | None = None


class Hand:
    """The grips of one arm: ``grips:`` of its configuration, and ``grips_of:`` for types of labware. Widths
    are mm of the gripper's joint. Raises BadInput for grips that cannot be."""

    def __init__(self, name: str, config: Mapping[str, Any]) -> None:
        self._name = name
        self._grips = self._read("grips", config.get("grips", {}), {"narrow": NARROW, "wide": WIDE})
        of = config.get("grips_of", {})
        if not isinstance(of, Mapping):
            raise BadInput(f"{name}: `grips_of` must map types of labware to their grips.")
        self._of: dict[str, Grips] = {
            str(kind): self._read(f"grips_of: {kind}", told, self._grips) for kind, told in of.items()
        }
        self._grasped: tuple[Grip, float] | None = None
        self._refuse_ambiguous()

    def grip(self, side: str, kind: str) -> Grip:
        """The grip ``narrow`` or ``wide`` for a type of labware."""
        return self._of.get(kind, self._grips)[side]

    def read(self, width_mm: float) -> Fingers:
        """What fingers tell that are so far apart."""
        if self._grasped is not None and abs(width_mm - self._grasped[1]) <= ABOUT_MM:
            return Fingers("holding", self._grasped[0])
        known = self._known()
        for grip in known:
            if abs(width_mm - grip.closed_mm) <= ABOUT_MM:
                return Fingers("holding", grip)
        if any(abs(width_mm - grip.open_mm) <= ABOUT_MM for grip in known):
            return Fingers("open")
        return Fingers("shut") if width_mm < SHUT_MM else Fingers("unknown")

    def likely_grip(self, width_mm: float, kind: str) -> Grip:
        """The grip in which something is held, from its width alone."""
        return self.grip("wide" if width_mm > BETWEEN_GRIPS_MM else "narrow", kind)

    def grasp(self, grip: Grip, width_mm: float) -> None:
        """Remember that something is held since the fingers closed to this width."""
        self._grasped = (grip, width_mm)

    def forget(self) -> None:
        """The fingers are about to open."""
        self._grasped = None

    def looks_open(self, width_mm: float) -> bool:
        """Whether fingers that hold something at this width could be taken for open ones later."""
        self._grasped = None
        return self.read(width_mm).state == "open"

    def widths(self) -> str:
        """The open widths, for people."""
        return " or ".join(f"{width:g}" for width in sorted({grip.open_mm for grip in self._known()}))

    def _known(self) -> list[Grip]:
        return [grip for grips in (self._grips, *self._of.values()) for grip in grips.values()]

    def _refuse_ambiguous(self) -> None:
        for one in self._known():
            for other in self._known():
                if abs(one.open_mm - other.closed_mm) <= 2 * ABOUT_MM:
                    raise BadInput(
                        f"{self._name}: open at {one.open_mm:g} mm could not be told from closed at "
                        f"{other.closed_mm:g} mm.",
                        remedy="Choose wider open widths under `grips:` and `grips_of:`.",
                    )

    def _read(self, key: str, told: Any, usual: Grips) -> Grips:
        if not isinstance(told, Mapping) or set(told) - set(usual):
            raise BadInput(
                f"{self._name}: `{key}` does not describe grips.",
                remedy="Write, say, `{narrow: {open: 90, closed: 85}, wide: {open: 130, closed: 127}}` (mm).",
            )
        return {side: self._one(f"{key}: {side}", told.get(side, {}), grip) for side, grip in usual.items()}

    def _one(self, key: str, told: Any, usual: Grip) -> Grip:
        widths = {"open": usual.open_mm, "closed": usual.closed_mm}
        if isinstance(told, Mapping) and not set(told) - set(widths):
            widths.update(told)
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
