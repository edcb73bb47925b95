"""Handlers are found by the type of their event: none is overlooked."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from types import ModuleType
from typing import Any

import pytest

from labos.audit import projection
from labos.core import bench, lab, modules, resources, runs, steps
from labos.core.fold import TABLE
from labos.core.registry import list_handlers
from labos.core.resources import Resources

WITHOUT = {"ExperimentResumed", "RecordsSigned", "RequestRepeated", "RunSigned", "StopReported", "UserErased"}
"""The state does not depend on these events."""

CALLED_DIRECTLY = {"fold_action_requested", "fold_run_submitted"}
"""These also need the position of the event."""


def test_each_event_changes_the_state_but_for_those_that_are_named_here() -> None:
    assert {kind.__name__ for kind, handlers in TABLE.items() if not handlers} == WITHOUT


@pytest.mark.parametrize("module", [bench, lab, modules, resources, runs, steps])
def test_each_function_that_folds_an_event_is_found(module: ModuleType) -> None:
    found = {handler for handlers in TABLE.values() for _, handler in handlers}
    assert {
        name
        for name, function in vars(module).items()
        if name.startswith("fold_") and inspect.isfunction(function) and function not in found
    } <= CALLED_DIRECTLY


def test_each_function_that_changes_rows_is_found() -> None:
    """Sample sheets need the blobs too, and are handled by themselves."""
    missed = {
        name
        for module, found in zip(projection._SLICES, projection._FOUND, strict=True)
        for name, function in vars(module).items()
        if name.startswith("on_") and inspect.isfunction(function) and function not in found.values()
        if function.__module__ == module.__name__
    }
    assert missed == {"on_samples_registered"}


def test_two_handlers_for_one_event_are_refused() -> None:
    def fold_first(slice_: Resources, event: resources.ResourceConsumed, at: int) -> None: ...

    def fold_second(slice_: Resources, event: resources.ResourceConsumed, at: int) -> None: ...

    for function in (fold_first, fold_second):
        function.__annotations__ = {"slice_": Resources, "event": resources.ResourceConsumed, "at": int}
    names: Mapping[str, Any] = {"__name__": __name__, "fold_first": fold_first, "fold_second": fold_second}
    with pytest.raises(TypeError, match="fold_second and fold_first are both for ResourceConsumed"):
        list_handlers(names, Resources)
