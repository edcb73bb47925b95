"""Arguments that earlier steps of a run have worked out."""

from __future__ import annotations

from typing import Any

from labos.core.model import Plan


def inputs_known(plan: Plan, results: dict[str, Any], args: dict[str, Any]) -> dict[str, Any] | str:
    """Arguments with earlier results written in, or the reference that leads nowhere."""
    filled: dict[str, Any] = {}
    for name, value in args.items():
        if isinstance(value, dict) and "$result" in value:
            index, *path = value["$result"]
            if str(index) not in results:
                return f"{name}: step {plan.steps[index].key!r} was left out and has no result"
            found = results[str(index)]
            for part in path:
                try:
                    found = found[int(part)] if isinstance(found, list | tuple) else found[part]
                except (KeyError, IndexError, TypeError, ValueError):
                    return f"{name}: the result of step {plan.steps[index].key!r} has no {part!r}"
            value = found
        filled[name] = value
    return filled
