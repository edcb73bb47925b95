"""Arguments that earlier steps of a run have worked out."""

from __future__ import annotations

from typing import Any

from labos.core.model import Plan, PlanStep


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


def files_returned(step: PlanStep, args: dict[str, Any]) -> tuple[dict[str, Any], dict[str, str]] | str:
    """Arguments with the names of files that earlier steps have returned, and their digests by these names;
    or what is no file."""
    named, files = dict(args), dict[str, str]()
    for name, written in step.args.items():
        if not (isinstance(written, dict) and written.get("$file")):
            continue
        found = args[name]
        if isinstance(found, dict) and len(found) == 1:  # a step's only file
            (found,) = found.values()
        if not isinstance(found, dict) or not {"file", "sha256"} <= found.keys():
            return f"{name}: what the step {written['$result'][0]} returned is no file"
        file, sha256 = str(found["file"]), str(found["sha256"])
        named[name] = file if files.get(file, sha256) == sha256 else f"{name}-{file}"
        files[named[name]] = sha256
    return named, files
