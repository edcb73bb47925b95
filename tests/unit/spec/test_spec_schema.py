"""The JSON Schemas say what the models say."""

from __future__ import annotations

from typing import Any

import pytest
from spec_bench import WORKCELL

from labos.errors import NotFound
from labos.spec import find_spec, find_specs_folder, list_specs
from labos.spec.schema import FILES, MODELINE, make_schema
from labos.spec.source import make_plain, parse, read

FOLDERS = {"workcell": "workcells", "workflow": "workflows", "labware": "labware"}


def faults(kind: str, data: Any) -> list[str]:
    jsonschema = pytest.importorskip("jsonschema")
    schema = make_schema(kind)
    jsonschema.Draft202012Validator.check_schema(schema)
    return [error.message for error in jsonschema.Draft202012Validator(schema).iter_errors(data)]


@pytest.mark.parametrize("kind", FILES)
def test_every_field_is_described(kind: str) -> None:
    schema = make_schema(kind)
    parts = {FILES[kind].__name__: schema, **schema["$defs"]}
    silent = [
        f"{name}.{field}"
        for name, part in parts.items()
        for field, content in part["properties"].items()
        if not content.get("description")
    ]
    assert silent == [], "say in their models what they mean"
    assert all(part["description"] and not part["additionalProperties"] for part in parts.values())


@pytest.mark.parametrize("kind", FOLDERS)
def test_packaged_files_fit_their_schema_and_name_it(kind: str) -> None:
    for name in list_specs(FOLDERS[kind]):
        path = find_spec(FOLDERS[kind], name)
        assert faults(kind, make_plain(read(path).data)) == []
        first = path.read_text("utf-8").partition("\n")[0]
        assert first.startswith(MODELINE)
        named = path.parent / first.removeprefix(MODELINE)
        assert named.resolve() == find_specs_folder().parent / "docs/reference/schemas" / f"{kind}.json"


def test_what_the_models_take_fits_and_what_they_refuse_does_not() -> None:
    assert faults("workcell", make_plain(parse(WORKCELL).data)) == []
    step: dict[str, Any] = {"name": "a", "module": "b", "action": "c"}
    flow = {"labos": 1, "name": "w", "steps": [step]}
    for wait in (
        {"after": "a", "at_least": 5},
        {"after": "a", "at_least": "10 min"},
        [{"after": "a", "at_least": 1}],
    ):
        assert faults("workflow", {**flow, "steps": [step, {**step, "wait": wait}]}) == []
    assert faults("workflow", {**flow, "stepz": 1})
    assert faults("workflow", {**flow, "steps": []})
    assert faults("workflow", {**flow, "steps": [{**step, "name": 5}]})
    assert faults("workcell", {"name": "a/b", "modules": [{"name": "x"}]})
    assert faults("labware", {"labware": {}})


def test_an_unknown_schema() -> None:
    with pytest.raises(NotFound, match="Did you mean 'workflow'"):
        make_schema("workflwo")
