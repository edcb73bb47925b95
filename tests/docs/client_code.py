"""Writes the methods of the client from the operations of the API: ``python -m tests.docs.client_code``.

A test compares each file with what would be written now.
"""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
import textwrap
import types
import typing
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import msgspec
from msgspec import NODEFAULT

from labos.client import LabClient
from labos.http import limits, routes
from labos.http.operation import JSON, Method, Operation
from labos.http.problems import PROBLEMS
from tests.docs.markdown import ROOT

FOLDER = ROOT / "labos" / "client" / "_generated"
WIDTH = 106

CLASSES = {
    "LabOperations": ("lab", "accounts", "log", "modules", "bookings", "bench", "people", "words"),
    "WorkOperations": (
        *("runs", "campaigns", "approvals", "signatures"),
        *("forecasts", "planning", "finding"),
    ),
}
"""Each class of generated methods, with the modules of ``labos.http.routes`` whose operations it has."""

DISTINCT = ("not_found", "refused", "forbidden", "spec_errors", "log_damaged")
"""Problems that a caller tells apart; those that may come with each request are said once."""


class Field(NamedTuple):
    """Something that a request says, and what the method calls it."""

    parameter: str
    sent: str
    type: str
    default: str | None
    place: Literal["path", "query", "body", "user", "request"]
    is_empty_table: bool = False  # if it is left out

    @property
    def declared(self) -> str:
        return f"{self.parameter}: {self.type}" + (f" = {self.default}" if self.default is not None else "")


# -- types ---------------------------------------------------------------------------------------


def find_argument_type(kind: Any) -> str:
    """The type of what a caller gives."""
    return _type(kind, {list: "Sequence", tuple: "Sequence", dict: "Mapping"}, "Mapping[str, Any]")


def find_answer_type(kind: Any) -> str:
    """The type of what is answered, as JSON has it."""
    return _type(kind, {list: "list", tuple: "list", dict: "dict"}, "dict[str, Any]")


def _type(kind: Any, containers: Mapping[type, str], struct: str) -> str:
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if origin is Annotated:
        return _type(inner[0], containers, struct)
    if origin in (types.UnionType, typing.Union):
        return " | ".join(dict.fromkeys(_type(each, containers, struct) for each in inner))
    if origin is Literal:
        return "str"  # programs have them in variables; the lab says which there are
    if (base := origin or kind) in containers:
        inner = tuple(each for each in inner if each is not Ellipsis) or (Any,)
        shown = [_type(each, containers, struct) for each in inner]
        if base is tuple and len(set(shown)) > 1:
            shown = ["Any"]
        return f"{containers[base]}[{', '.join(shown if base is dict else shown[:1])}]"
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        return struct
    if kind in (str, int, float, bool, bytes):
        return str(kind.__name__)
    if kind is type(None):
        return "None"
    return "str" if isinstance(kind, typing.NewType) else "Any"


# -- parameters ----------------------------------------------------------------------------------


def fields_of(operation: Operation) -> Iterator[Field]:
    """All that a caller may say, in the order of the declaration."""
    shape, method = operation.shape, operation.client
    places: tuple[tuple[Literal["path", "query", "body"], Any], ...]
    places = (("path", shape.path), ("query", shape.query), ("body", shape.body))
    for place, struct in places:
        for field in msgspec.structs.fields(struct) if struct is not None else ():
            name = field.encode_name
            if name in method.fixed or name in method.without:
                continue
            kind, default = find_argument_type(field.type), _default(field)
            if place == "body" and field.type == limits.Asker:
                default = None  # who asks is always said
            if default == "None" and "None" not in kind.split(" | ") and kind != "Any":
                kind += " | None"
            yield Field(name, name, kind, default, place, field.default_factory is dict)
    if "LabOS-User" in operation.headers:
        yield Field("user", "user", "str", "''", "user")
    if method.key == "given":
        yield Field("request", "request", "str", "''", "request")


def _default(field: Any) -> str | None:
    if field.default is not NODEFAULT:
        return repr(field.default)
    if field.default_factory is NODEFAULT:
        return None
    return "()" if field.default_factory() in ([], ()) else "None"


def parameters(operation: Operation) -> tuple[list[Field], list[Field]]:
    """Those that may be told by their place, and those that are told by name."""
    found = {field.sent: field for field in fields_of(operation)}
    chosen = [
        _find_field(part.strip(), found) for part in operation.client.positional.split(",") if part.strip()
    ]
    if not chosen:
        chosen = [field for field in found.values() if field.place == "path"]
        chosen += [field for field in found.values() if field.place == "body" and field.default is None]
        chosen.sort(key=lambda field: field.sent == "by")
    last = max((at for at, field in enumerate(chosen) if field.default is None), default=-1)
    chosen = [field._replace(default=None) if at < last else field for at, field in enumerate(chosen)]
    taken = {field.sent for field in chosen}
    return chosen, [field for field in found.values() if field.sent not in taken]


def _find_field(part: str, found: Mapping[str, Field]) -> Field:
    name, _, value = part.partition("=")
    if value.startswith(("'", '"')):
        return found[name]._replace(default=value)
    return found[value or name]._replace(parameter=name)


# -- methods -------------------------------------------------------------------------------------


def method_of(operation: Operation) -> str:
    """The source of the method that calls an operation."""
    method = operation.client
    first, named = parameters(operation)
    signature = ["self", *(field.declared for field in first)]
    if named:
        signature += ["*", *(field.declared for field in named)]
    result, body = _write_call(operation, [*first, *named])
    lines = [f"def {method.name}({', '.join(signature)}) -> {result}:", *_write_docstring(operation), *body]
    return "\n".join([lines[0], *(f"    {line}" if line else "" for line in lines[1:])])


def _write_call(operation: Operation, fields: Sequence[Field]) -> tuple[str, list[str]]:
    method = operation.client
    left_out = [f"{field.parameter} = {field.parameter} or {{}}" for field in fields if field.is_empty_table]
    asked = [f'"{operation.path}"', _write_said(operation, fields)]
    if operation.method == "GET":
        ask = "_get" if operation.media == (JSON,) else "_fetch"
    else:
        ask, asked = "_post", [*asked, *_options(method, fields)]
    call = f"self.{ask}({', '.join(asked)})"
    if ask == "_fetch":
        return "bytes", [f"return {call}"]
    if method.take is None:
        return "None", [*left_out, call]
    if not method.take:
        return "dict[str, Any]", [*left_out, f"return {call}"]
    kind = {f.encode_name: f.type for f in msgspec.structs.fields(operation.shape.answer)}[method.take]
    result = find_answer_type(kind)
    return result, [*left_out, f'return {call}["{method.take}"]']


def _write_said(operation: Operation, fields: Sequence[Field]) -> str:
    """All that the method was told, by the names that it has in the request."""
    fixed = [f'"{name}": {value!r}' for name, value in operation.client.fixed.items()]
    if any(field.parameter != field.sent for field in fields):
        return "{" + ", ".join([*(f'"{field.sent}": {field.parameter}' for field in fields), *fixed]) + "}"
    return "locals()" + (f" | {{{', '.join(fixed)}}}" if fixed else "")


def _options(method: Method, fields: Sequence[Field]) -> Iterator[str]:
    if method.key:
        yield "once=True"
    if any(field.place == "user" for field in fields):
        yield "as_user=True"
    if method.repeat:
        yield "repeat=True"
    if method.timeout_s is not None:
        yield f"timeout_s={method.timeout_s}"


def _write_docstring(operation: Operation) -> Iterator[str]:
    """The description of an operation; only its summary for a method that no user calls."""
    if operation.client.name.startswith("_"):
        yield f'"""{operation.summary}."""'
        return
    said = " ".join((operation.handler.__doc__ or "").split()).replace("`", "``")
    text = [
        f"{operation.summary}.",
        said,
        _about_parameters(operation),
        _answer(operation),
        _raises(operation),
    ]
    whole = " ".join(part for part in text if part)
    lines = textwrap.wrap(f'"""{whole}"""', WIDTH - 4, break_long_words=False, break_on_hyphens=False)
    yield from lines


def _about_parameters(operation: Operation) -> str:
    """What the declaration says of what a caller may say by name."""
    found = []
    words = {
        field.encode_name: meta.description
        for struct in (operation.shape.query, operation.shape.body)
        if struct is not None
        for field in msgspec.structs.fields(struct)
        for meta in getattr(field.type, "__metadata__", ())
        if isinstance(meta, msgspec.Meta) and meta.description
    }
    first, named = parameters(operation)
    for field in (*first, *named):
        if field.place in ("query", "body") and field.sent != "by" and field.sent in words:
            found.append(f"``{field.parameter}``: {words[field.sent].replace('`', '``')}.")
    return " ".join(found)


def _answer(operation: Operation) -> str:
    method, answer = operation.client, operation.shape.answer
    if method.take is None or operation.media != (JSON,):
        return ""
    if method.take:
        return f"Returns the {method.take}." if not method.name.endswith(method.take) else ""
    names = [f"``{name}``" for name in answer.__struct_encode_fields__]
    return f"Returns {', '.join(names)}." if names else ""


def _raises(operation: Operation) -> str:
    codes = [code for code in DISTINCT if code in operation.problems and code in PROBLEMS]
    names = ["BadInput" if code == "spec_errors" else code.title().replace("_", "") for code in codes]
    return f"Raises {', '.join(names)}." if names else ""


# -- files ---------------------------------------------------------------------------------------


def files() -> dict[Path, str]:
    """Every generated file with its text."""
    operations = {
        name: [
            operation for module in modules for operation in routes.list_operations(getattr(routes, module))
        ]
        for name, modules in CLASSES.items()
    }
    assert sum(map(len, operations.values())) == len(routes.OPERATIONS)
    texts = {FOLDER / f"{_file(name)}.py": _write_class(name, found) for name, found in operations.items()}
    texts[FOLDER / "__init__.py"] = (
        '"""The operations of the API as methods: written by tests/docs/client_code.py."""\n'
    )
    texts[FOLDER / "twin_calls.py"] = _twin_calls()
    return {path: _format(text, path) for path, text in texts.items()}


def _write_class(name: str, operations: Sequence[Operation]) -> str:
    methods = [method_of(operation) for operation in operations if not operation.client.by_hand]
    body = "\n\n".join(textwrap.indent(method, "    ") for method in methods)
    modules = ", ".join(CLASSES[name])
    said = f"The operations of labos/http/routes ({modules}); written by tests/docs/client_code.py."
    head = textwrap.wrap(f'"""{said}"""', WIDTH + 4, break_on_hyphens=False)
    return (
        "\n".join(head) + "\n\nfrom __future__ import annotations\n\n"
        "from collections.abc import Mapping, Sequence\nfrom typing import Any\n\n"
        "from labos.client._calls import Calls\n\n\n"
        f'class {name}(Calls):\n    """One method for each operation."""\n\n{body}\n'
    )


def _file(name: str) -> str:
    return re.sub(r"(?<!^)(?=[A-Z])", "_", name).lower()


def _twin_calls() -> str:
    """A line for each operation that the client for asyncio asks as the client does."""
    members = inspect.getmembers(LabClient, inspect.isfunction)
    names = [name for name, member in members if member.__qualname__.partition(".")[0] in CLASSES]
    lines = [f"    {name} = ask(LabClient.{name})" for name in names if not name.startswith("_")]
    head = """The operations of the API, to be awaited; written by tests/docs/client_code.py."""
    return (
        f'"""{head}"""\n\nfrom __future__ import annotations\n\n'
        "from labos.client._lab import LabClient\nfrom labos.client._threads import Twin, ask\n\n\n"
        'class AsyncCalls(Twin):\n    """One method for each operation."""\n\n' + "\n".join(lines) + "\n"
    )


def _format(text: str, path: Path) -> str:
    ruff = Path(sys.executable).with_name("ruff")
    for arguments in (["check", "--fix-only", "--quiet", "--select", "I,F401"], ["format", "--quiet"]):
        done = subprocess.run(
            [str(ruff), *arguments, "--stdin-filename", str(path), "-"],
            input=text,
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        text = done.stdout
    return text


def main() -> None:
    for path, text in files().items():
        path.write_text(text)


if __name__ == "__main__":
    main()
