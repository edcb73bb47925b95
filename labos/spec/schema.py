"""JSON Schemas of the files, made from the models, for editors and other programs."""

from __future__ import annotations

from typing import Any

from labos.errors import NotFound
from labos.spec import models
from labos.spec.campaign import CampaignFile
from labos.spec.description import DescriptionFile
from labos.spec.findings import suggest_name
from labos.spec.parts import Part
from labos.spec.policy import PolicyFile
from labos.spec.shares import SharesFile

FILES: dict[str, type[Part]] = {
    "workcell": models.WorkcellFile,
    "workflow": models.WorkflowFile,
    "labware": models.LabwareFile,
    "description": DescriptionFile,
    "campaign": CampaignFile,
    "shares": SharesFile,
    "policy": PolicyFile,
}
DRAFT = "https://json-schema.org/draft/2020-12/schema"
MODELINE = "# yaml-language-server: $schema="
"""The comment that names a file's schema for an editor; its path is relative to the file's folder."""

ONE_OR_MANY = {"StepEntry": ("wait", "within")}
"""Fields that take one table or a list of them."""


def make_schema(kind: str) -> dict[str, Any]:
    """The JSON Schema of a kind of file. Raises NotFound."""
    if kind not in FILES:
        raise NotFound(f"There is no schema of a {kind!r}.", remedy=suggest_name(kind, FILES, "schema"))
    model = FILES[kind]
    schema = model.model_json_schema()
    for name, part in (*schema.get("$defs", {}).items(), (model.__name__, schema)):
        _describe(name, part)
    head = {"$schema": DRAFT, "$id": f"urn:labos:schema:{kind}:1", "title": f"LabOS {kind}"}
    return {**head, **schema}


def _describe(name: str, part: dict[str, Any]) -> None:
    part["description"] = _write_plainly(part.get("description", ""))
    for field, content in part["properties"].items():
        content.pop("title", None)
        if field in ONE_OR_MANY.get(name, ()):
            items = content.pop("items")
            content.pop("type")
            content["anyOf"] = [items, {"type": "array", "items": items}]
        content["description"] = _write_plainly(content.pop("description", ""))
        if content.get("default", 0) is None:
            del content["default"]
    part.pop("title", None)


def _write_plainly(docstring: str) -> str:
    return docstring.replace("``", "`").replace("\n", " ")
