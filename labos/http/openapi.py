"""The description of the API (OpenAPI 3.1), generated from its operations."""

from __future__ import annotations

import inspect
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from typing import Any

import msgspec

from labos.http.identity import COOKIE, SECURE_COOKIE
from labos.http.limits import LONGEST_NAME, LONGEST_PERSON
from labos.http.operation import JSON, Operation
from labos.http.problems import MEDIA_TYPE, PROBLEMS, Problem
from labos.http.routes import PREFIX
from labos.version import VERSION

REF = "#/components/schemas/{name}"

ALWAYS = ("bad_input", "not_signed_in", "forbidden", "uri_too_long", "internal")
"""The problems that every request may have."""
AWAY = ("store_unavailable", "kernel_away", "behind")
"""Further problems of every request while a part is away: the last two only from an API process."""
OF_POSTS = (
    *("too_slow", "too_large", "unsupported_media_type", "too_many"),
    *("commit_in_doubt", "fenced", "internal_fault", "key_reused", "already_done"),
)
"""Further problems of requests that change something."""

TAGS = {
    "lab": "The lab as a whole",
    "accounts": "Users: signing in, tokens of programs, names",
    "log": "The log, and the files that results name",
    "runs": "Runs of workflows",
    "experiments": "Experiments of applications",
    "campaigns": "Campaigns: a workflow for each row of a table; shares and quotas",
    "modules": "Modules: service, resources, poses",
    "workcells": "Workcells, and access to them",
    "bookings": "Bookings: reserved times of a module or a workcell",
    "bench": "The bench: labware at stations, and questions to people",
    "people": "Users, groups, roles and their rights",
}

SIGNED_IN = {
    "token": {"type": "http", "scheme": "bearer", "description": "a token of a program"},
    "session": {
        "type": "apiKey",
        "in": "cookie",
        "name": COOKIE,
        "description": f"the session cookie of a browser; over TLS `{SECURE_COOKIE}`",
    },
}

HEADERS: dict[str, tuple[str, dict[str, Any]]] = {
    "LabOS-User": (
        "the user who asks; `application` if left out",
        {"type": "string", "maxLength": LONGEST_PERSON},
    ),
    "Last-Event-ID": (
        "the position after which to continue; takes precedence over `after`",
        {"type": "string"},
    ),
    "Range": ("a part of the file, such as `bytes=0-1023`", {"type": "string"}),
    "If-Range": ("the `ETag` for which `Range` is meant", {"type": "string"}),
    "If-None-Match": ("an `ETag`; the same file is not sent again", {"type": "string"}),
    "LabOS-Position": (
        "a position of the log from an earlier answer; this answer has to include it",
        {"type": "integer", "minimum": 0},
    ),
    "Idempotency-Key": (
        "the same key twice is one request, with the same answer",
        {"type": "string", "maxLength": LONGEST_NAME},
    ),
}


def document(operations: Iterable[Operation]) -> dict[str, Any]:
    """The whole description, as plain data."""
    operations = list(operations)
    types = {
        kind
        for shape in (operation.shape for operation in operations)
        for kind in (shape.path, shape.query, shape.body, shape.answer)
        if kind is not None and kind not in (str, bytes)
    }
    ordered = sorted(types, key=lambda kind: kind.__name__)
    schemas, components = msgspec.json.schema_components([*ordered, Problem], ref_template=REF)
    names = dict(zip(ordered, schemas, strict=False))
    paths: dict[str, dict[str, Any]] = defaultdict(dict)
    for operation in operations:
        paths[PREFIX + operation.path][operation.method.lower()] = _operation(operation, names, components)
    inline = {kind.__name__ for op in operations for kind in (op.shape.path, op.shape.query) if kind}
    return {
        "openapi": "3.1.0",
        "info": {
            "title": "LabOS",
            "version": VERSION,
            "summary": "A lab: its runs, its bench, its log.",
            "license": {"name": "MIT", "identifier": "MIT"},
        },
        "tags": [{"name": name, "description": about} for name, about in TAGS.items()],
        "paths": dict(paths),
        "components": {
            "schemas": {name: _plain(part) for name, part in components.items() if name not in inline},
            "securitySchemes": SIGNED_IN,
        },
        # Any of these schemes; or none, for a lab without users.
        "security": [*({name: []} for name in SIGNED_IN), {}],
    }


def problems_of(operation: Operation) -> dict[int, list[str]]:
    """The codes of the problems of an operation, by their status."""
    codes = [*ALWAYS, *AWAY, *operation.problems]
    if operation.shape.path is not None:
        codes.append("not_found")
    if operation.method == "POST":
        codes += OF_POSTS
    found: dict[int, list[str]] = defaultdict(list)
    for code in dict.fromkeys(codes):
        found[PROBLEMS[code].status].append(code)
    return dict(sorted(found.items()))


def parameters(operation: Operation) -> Iterator[dict[str, Any]]:
    """The parameters that an operation reads from its path, its query and its headers."""
    for kind, place in ((operation.shape.path, "path"), (operation.shape.query, "query")):
        if kind is None:
            continue
        _, components = msgspec.json.schema_components([kind], ref_template=REF)
        whole = components[kind.__name__]
        for name, part in whole["properties"].items():
            schema = _plain(part)
            found: dict[str, Any] = {"name": name, "in": place}
            found["description"] = schema.pop("description", "")
            if place == "path":
                found["required"] = True
            if examples := schema.pop("examples", None):
                found["example"] = examples[0]
            yield found | {"schema": schema}
    own = ("LabOS-Position", "Idempotency-Key") if operation.method == "POST" else ("LabOS-Position",)
    for name in (*operation.headers, *own):
        about, schema = HEADERS[name]
        yield {"name": name, "in": "header", "description": about, "schema": schema}


def about(operation: Operation) -> str:
    """The description of an operation after its summary."""
    return inspect.cleandoc(operation.handler.__doc__ or "")


def _operation(operation: Operation, names: dict[Any, Any], components: dict[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = {
        "operationId": operation.id,
        "summary": operation.summary,
        "description": " ".join(about(operation).split()),
        "tags": [operation.tag],
        "x-needs": operation.needs,
        "parameters": list(parameters(operation)),
    }
    if operation.shape.body is not None:
        content: dict[str, Any] = {"schema": names[operation.shape.body]}
        if operation.example is not None:
            content["example"] = operation.example
        required = bool(components[operation.shape.body.__name__].get("required"))
        found["requestBody"] = {"required": required, "content": {JSON: content}}
    elif operation.method == "POST":
        found["requestBody"] = {"content": {JSON: {"schema": {"type": "object"}}}}
    found["responses"] = {str(operation.status): _answer(operation, names)}
    for status, text in operation.other_statuses.items():
        content = {} if status == 304 else {"content": _answer(operation, names)["content"]}
        found["responses"][str(status)] = {"description": text, **content}
    for status, codes in problems_of(operation).items():
        found["responses"][str(status)] = {
            "description": "; ".join(f"`{code}`: {PROBLEMS[code].title}" for code in codes),
            "content": {MEDIA_TYPE: {"schema": {"$ref": REF.format(name="Problem")}}},
        }
    return found


def _answer(operation: Operation, names: dict[Any, Any]) -> dict[str, Any]:
    kind = operation.shape.answer
    schema = names.get(kind, {"type": "string"})
    if kind is bytes:
        schema = {"type": "string", "format": "binary"}
    content = {"schema": schema}
    if operation.example_answer is not None:
        content["example"] = operation.example_answer
    return {"description": operation.summary, "content": dict.fromkeys(operation.media, content)}


def _plain(schema: Any) -> Any:
    """A schema as JSON Schema: patterns in the syntax of ECMAScript, descriptions on one line, and pairs of
    one type as lists of two, since few generators know tuples."""
    if isinstance(schema, list):
        return [_plain(item) for item in schema]
    if not isinstance(schema, dict):
        return schema
    found = {key: _plain(value) for key, value in schema.items()}
    parts = found.get("prefixItems")
    if parts and parts.count(parts[0]) == len(parts):
        del found["prefixItems"]
        found |= {"items": parts[0], "minItems": len(parts), "maxItems": len(parts)}
    if isinstance(pattern := found.get("pattern"), str):
        found["pattern"] = re.sub(r"\\Z$", "$", re.sub(r"^\\A", "^", pattern))
    if isinstance(text := found.get("description"), str):
        found["description"] = " ".join(text.replace("``", "`").split())
    return found
