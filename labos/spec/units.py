"""Amounts of consumables as people write them, in the unit in which a driver counts them: ``20``,
``"20 mL"``, ``{amount: 20, unit: mL}``."""

from __future__ import annotations

from collections.abc import Sequence

from labos.errors import SpecError
from labos.spec.durations import match_quantity

FAMILIES: dict[str, dict[str, float]] = {
    "volume": {"nl": 1e-3, "ul": 1.0, "ml": 1e3, "l": 1e6},
    "mass": {"ug": 1e-3, "mg": 1.0, "g": 1e3, "kg": 1e6},
    "length": {"mm": 1.0, "cm": 10.0, "m": 1000.0},
    "number": dict.fromkeys(("", "piece", "pieces", "pcs"), 1.0),
}
"""Units that can be converted to one another, with their factors."""

_SHOWN = {"nl": "nL", "ul": "uL", "ml": "mL", "l": "L"}


def in_unit(value: float | str, unit: str, wanted: str, what: str) -> float:
    """An amount in the unit ``wanted`` (empty: pieces). A text contains its own unit. A number is in
    ``unit``, or in ``wanted`` if ``unit`` is empty. Raises SpecError."""
    if isinstance(value, str):
        found = match_quantity(value)
        if found is None:
            raise SpecError(
                f"{value!r} is not an amount of {what}.", remedy=f"Write {_make_example(wanted)}."
            )
        value, unit = float(found[1]), found[2] or unit
    if value < 0:
        raise SpecError(f"The amount of {what} cannot be {value:g}.", remedy="Write 0 or more.")
    given, counted = _simplify_unit(unit), _simplify_unit(wanted)
    if not given or given == counted:
        return value
    family = next((known for known in FAMILIES.values() if counted in known), {counted: 1.0})
    if given not in family:
        raise SpecError(
            f"{what} is counted in {wanted or 'pieces'}; {unit!r} cannot be converted to it.",
            remedy=f"Write one of {_list_units([name for name in family if name])}.",
        )
    # Divide by the greater factor: then whole results stay whole.
    factor = family[given] / family[counted]
    return value * factor if factor >= 1 else value / (family[counted] / family[given])


def _simplify_unit(unit: str) -> str:
    """The form of a unit for the look-up: without regard to capitals and to the two signs for micro."""
    return unit.strip().lower().replace("µ", "u").replace("μ", "u")


def _list_units(names: Sequence[str]) -> str:
    return ", ".join(_SHOWN.get(name, name) for name in names) or "pieces"


def _make_example(unit: str) -> str:
    return f"20 {unit}, say" if unit else "a number"
