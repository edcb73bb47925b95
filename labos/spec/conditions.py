"""Conditions on results: ``when`` and ``expect``, with the payload filled in and steps named by keys."""

from __future__ import annotations

from typing import Any

from labos.core.conditions import fill_in, make_condition
from labos.core.expressions import ExpressionError, Tree, list_names, look_up, parse_expression
from labos.core.model import Condition
from labos.spec.layout import Written
from labos.spec.source import Path_
from labos.spec.steps import Steps


class StepConditions:
    """The conditions of a workflow's steps. The steps whose results they read are added to ``feeds``. Faults
    are reported at the place where they were written."""

    def __init__(self, steps: Steps, feeds: set[int]) -> None:
        self.steps, self.feeds = steps, feeds

    def find_condition(self, index: int) -> Condition | None:
        """The condition under which a step is done, composed of all its conditions."""
        written = self.steps.layout.leaves[index].conditions
        found = [self._read(index, one, "when") for one in written]
        known = [one for one in found if one is not None]
        if len(known) < 2:
            return self._make_condition(index, *known[0], "when") if known else None
        signs = ("and",) * (len(known) - 1)
        text = " and ".join(f"({text})" for text, _ in known)
        return self._make_condition(index, text, ("row", signs, tuple(tree for _, tree in known)), "when")

    def expect(self, index: int) -> Condition | None:
        """The condition that a step's result has to fulfil."""
        leaf = self.steps.layout.leaves[index]
        if not leaf.entry.expect:
            return None
        path: Path_ = ("steps", index, "expect")
        found = self._read(index, Written(leaf.entry.expect, path, leaf.scope, leaf.box), "expect")
        return self._make_condition(index, *found, "expect") if found is not None else None

    def _make_condition(self, index: int, text: str, tree: Tree, key: str) -> Condition | None:
        try:
            return make_condition(text, tree)
        except ExpressionError as error:
            what = f"Step {self.steps.keys[index]!r}: {error.message}"
            self.steps.error(what, ("steps", index, key), error.remedy)
            return None

    def _read(self, index: int, written: Written, key: str) -> tuple[str, Tree] | None:
        path: Path_ = ("steps", index, key)
        values: dict[tuple[Any, ...], Tree] = {}
        try:
            tree = parse_expression(written.text)
            names = list_names(tree)
            for name in names:
                if name[0] == "payload":
                    values[name] = ("value", look_up(name, {"payload": written.scope}))
                elif name[0] == "steps":
                    found = self._resolve_name(index, name, written, path)
                    if found is None:
                        return None
                    values[name] = found
        except ExpressionError as error:
            self.steps.error(f"Step {self.steps.keys[index]!r}: {error.message}", path, error.remedy)
            return None
        if key == "expect" and not any(name[0] == "result" for name in names):
            what = "`expect` does not use the step's result."
            self.steps.error(f"Step {self.steps.keys[index]!r}: {what}", path, "Name it: `result.od > 0.1`.")
            return None
        return written.text, fill_in(tree, values)

    def _resolve_name(self, index: int, name: tuple[Any, ...], written: Written, path: Path_) -> Tree | None:
        """The name of an earlier step's result, with the step's key."""
        if len(name) < 3 or name[2] != "result":
            what = f"Step {self.steps.keys[index]!r}: of an earlier step, only the result can be used."
            self.steps.error(what, path, 'Write `steps.Read.result.od`, or `steps["Read it"].result.od`.')
            return None
        step = self.steps.find(str(name[1]), path, written.box)
        if step is None:
            return None
        if step not in self.steps.list_before(index):
            what = f"The step {name[1]!r} is not done before this one."
            self.steps.error(what, path, "Refer to an earlier step, or add it under `after:`.")
            return None
        self.feeds.add(step)
        return ("name", ("steps", self.steps.keys[step], *name[3:]))
