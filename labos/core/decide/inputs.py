"""Arguments of a step from the results of earlier steps."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from labos.core.model import Plan, PlanStep


def fill_inputs(plan: Plan, results: Mapping[int, Any], args: dict[str, Any]) -> dict[str, Any] | str:
    """The arguments with the results of earlier steps filled in, or the first reference that cannot be
    resolved."""
    filled: dict[str, Any] = {}
    for name, value in args.items():
        if isinstance(value, dict) and "$result" in value:
            index, *path = value["$result"]
            if index not in results:
                return f"{name}: step {plan.steps[index].key!r} was left out and has no result"
            found = results[index]
            for part in path:
                try:
                    found = found[int(part)] if isinstance(found, list | tuple) else found[part]
                except (KeyError, IndexError, TypeError, ValueError):
                    return f"{name}: the result of step {plan.steps[index].key!r} has no {part!r}"
            value = found
        filled[name] = value
    return filled


def name_returned_files(
    plan: Plan, step: PlanStep, args: dict[str, Any]
) -> tuple[dict[str, Any], dict[str, str]] | str:
    """The arguments with file names instead of the files that earlier steps have returned, and the digests of
    all files of the step by these names. Returns the name of the argument if it got no file."""
    named = dict(args)
    files = {name: found for name, found in plan.files.items() if name in args.values()}
    for name, written in step.args.items():
        if not (isinstance(written, dict) and written.get("$file")):
            continue
        found = args[name]
        if isinstance(found, dict) and len(found) == 1:  # the only file of the step
            (found,) = found.values()
        if not isinstance(found, dict) or not {"file", "sha256"} <= found.keys():
            key = plan.steps[written["$result"][0]].key
            return f"{name}: the result of step {key!r} is not a file"
        file, sha256 = str(found["file"]), str(found["sha256"])
        named[name] = file if files.get(file, sha256) == sha256 else f"{name}-{file}"
        files[named[name]] = sha256
    return named, files
