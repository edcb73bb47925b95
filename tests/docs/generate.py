"""Writes the generated parts of the reference, and of the client: ``python -m tests.docs.generate``.

A part stands between ``<!-- generated: name -->`` and ``<!-- end -->``; a test compares each
with what would be written now.
"""

from __future__ import annotations

import enum
import inspect
import re
import types
import typing
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import click
import msgspec

from labos.audit.tables import VIEWS, Table, list_view_columns
from labos.cli._exit import CODES
from labos.cli.app import group
from labos.cli.schema import write_schema
from labos.core import (
    approvals,
    campaigns,
    fold,
    labware,
    model,
    policy,
    runs,
    setups,
    shares,
    suggestions,
    topics,
)
from labos.core.decide.reactions import REACTIONS
from labos.core.effects import AnyEffect
from labos.core.registry import TYPES
from labos.core.state import LabState
from labos.core.topics import AnyTopic
from labos.core.words import find_fields_of_words
from labos.node import protocol
from labos.spec.describing import apply_variant, load_description
from labos.spec.description import DescriptionFile
from labos.spec.schema import FILES
from labos.telemetry.api import ApiMetrics
from labos.telemetry.kernel import KernelMetrics
from labos.telemetry.node import NodeMetrics
from labos.telemetry.series import LabMetric
from labos.torture import CHECKS, describe_check
from tests.docs import client_code, drawings, http_page, rights_page
from tests.docs.badges import badges
from tests.docs.markdown import DOCS, REFERENCE, ROOT

_REGION = re.compile(r"(<!-- generated: (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)


# -- commands ----------------------------------------------------------------------------------


def commands(
    command: click.Command = group, path: str = "labos", parent: click.Context | None = None
) -> Iterator[tuple[str, click.Command, click.Context]]:
    """Every command with its full name, groups included, in the order of ``labos --help``."""
    context = click.Context(command, info_name=path.split()[-1], parent=parent)
    yield path, command, context
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            found = command.get_command(context, name)
            assert found is not None
            if not found.hidden:
                yield from commands(found, f"{path} {name}", context)


def cli() -> str:
    """The commands, each with its usage, its words and its options."""
    return "\n".join(_command(path, command, context) for path, command, context in commands())


def exits() -> str:
    """What exit codes say."""
    return _table(("exit code", "means"), [(f"`{code}`", means) for code, means in CODES.items()]) + "\n"


def _command(path: str, command: click.Command, context: click.Context) -> str:
    usage = " ".join((path, *command.collect_usage_pieces(context)))
    parts = [f"## {path}", f"```usage\n{usage}\n```"]
    for paragraph in inspect.cleandoc(command.help or "").split("\n\n"):
        if paragraph.startswith("\b"):
            parts.append(f"```text\n{paragraph.removeprefix(chr(8)).strip(chr(10))}\n```")
        elif paragraph:
            parts.append(paragraph)
    options = [param for param in command.params if isinstance(param, click.Option)]
    if options:
        rows = [(_names(option), _takes(option), _default(option), option.help or "") for option in options]
        parts.append(_table(("option", "takes", "if not given", "meaning"), rows))
    return "\n\n".join(parts) + "\n"


def _names(option: click.Option) -> str:
    on = ", ".join(f"`{name}`" for name in option.opts)
    off = ", ".join(f"`{name}`" for name in option.secondary_opts)
    return f"{on} / {off}" if off else on


def _takes(option: click.Option) -> str:
    if option.is_flag:
        return ""
    many = ", repeated" if option.multiple else ""
    return f"`{option.metavar or option.type.name.upper().replace(' RANGE', '')}`{many}"


def _default(option: click.Option) -> str:
    said = [f"`{option.envvar}`"] if option.envvar else []
    if option.required:
        said.append("required")
    elif isinstance(option.default, str | int | float | Path) and not isinstance(option.default, bool):
        said += [f"`{option.default}`"] if str(option.default) else []
    return ", else ".join(said)


# -- events ------------------------------------------------------------------------------------


def events() -> str:
    """Every event type: what it says, and its fields."""
    assert fold  # it registers them
    parts, family = [], ""
    # In an order that does not depend on what was imported first.
    for name, kind in sorted(TYPES.items(), key=lambda item: (item[0].partition(".")[0], item[1].__module__)):
        if name.partition(".")[0] != family:
            family = name.partition(".")[0]
            parts.append(f"## {family}\n")
        schema = f" (schema {kind.SCHEMA})" if kind.SCHEMA > 1 else ""
        parts.append(f"### {name}{schema}\n\n{_words(kind)}\n\n{_fields(kind)}\n")
    return "\n".join(parts)


def parts() -> str:
    """The structures that events hold."""
    kinds = [
        *typing.get_args(AnyEffect),
        *(
            getattr(model, name)
            for name in (
                "ModuleSpec",
                "RetryDefault",
                "Together",
                "StationSpec",
                "LabwareSpec",
                "TransferWay",
                "WellGrid",
                "PlanStep",
                "Window",
                "Hold",
                "Retry",
                "OnError",
                "Condition",
            )
        ),
        setups.Setup,
        setups.SetupChange,
        runs.Anchor,
        suggestions.Suggested,
        campaigns.Terms,
        campaigns.Budget,
        shares.Group,
        shares.Member,
        shares.Quota,
        policy.Policy,
        policy.BookingLimits,
        approvals.Why,
        approvals.Demand,
        topics.Choice,
        labware.Sample,
    ]
    return "\n".join(f"### {kind.__name__}\n\n{_words(kind)}\n\n{_fields(kind)}\n" for kind in kinds)


def reactions() -> str:
    """What follows from which event, in the order in which it is worked out."""
    order = [
        (f"`{kind.TYPE}`", ", ".join(f"`{react.__name__}`" for react in found))
        for kind, found in REACTIONS.items()
    ]
    known = {react: True for found in REACTIONS.values() for react in found}
    says = [(f"`{react.__name__}`", " ".join(_words(react).split())) for react in known]
    head = ("reaction", "what follows")
    return f"{_table(('after', 'reactions, in this order'), order)}\n\n{_table(head, says)}\n"


# -- node protocol -----------------------------------------------------------------------------


def messages() -> str:
    """Every message between kernel and node."""
    kinds = [kind for kind in vars(protocol).values() if _is_struct(kind, protocol)]
    return "\n".join(_message(kind) for kind in kinds if kind is not protocol.Message)


def _message(kind: type[msgspec.Struct]) -> str:
    tag = kind.__struct_config__.tag
    note = f'\n\nMarked by `"{kind.__struct_config__.tag_field}": "{tag}"`.' if tag else ""
    return f"### {kind.__name__}\n\n{_words(kind)}{note}\n\n{_fields(kind)}\n".replace("\n\n\n", "\n\n")


# -- one structure -----------------------------------------------------------------------------


def _is_struct(kind: Any, module: types.ModuleType) -> bool:
    return isinstance(kind, type) and issubclass(kind, msgspec.Struct) and kind.__module__ == module.__name__


def _words(kind: type | Callable[..., Any]) -> str:
    """The docstring as Markdown; empty if it says nothing itself."""
    own = kind.__dict__.get("__doc__") if isinstance(kind, type) else kind.__doc__
    text = inspect.cleandoc(own or "")
    return text.replace("``", "`").replace(" ;", ";")


def _fields(kind: type[msgspec.Struct]) -> str:
    fields = msgspec.structs.fields(kind)
    if not fields:
        return "No fields."
    words = find_fields_of_words(kind)
    rows = [
        (
            f"`{field.encode_name}`",
            "words" if field.name in words else type_name(field.type),
            _show_default(field),
        )
        for field in fields
    ]
    return _table(("field", "type", "if left out"), rows)


def _show_default(field: Any) -> str:
    if field.default is msgspec.NODEFAULT and field.default_factory is msgspec.NODEFAULT:
        return ""
    value = field.default if field.default is not msgspec.NODEFAULT else field.default_factory()
    return f"`{msgspec.json.encode(value).decode()}`"


_PLAIN = {
    str: "text",
    bytes: "bytes in base64",
    int: "integer",
    float: "number",
    bool: "true or false",
    type(None): "null",
}


def type_name(hint: Any) -> str:
    """A type in plain words."""
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if hint in _PLAIN:
        return _PLAIN[hint]
    if isinstance(hint, typing.NewType):
        return f"text ({re.sub(r'(?<!^)(?=[A-Z])', ' ', hint.__name__).lower()})"
    if origin in (typing.Union, types.UnionType):
        if set(args) == set(typing.get_args(AnyEffect)):
            return "effect"
        if set(args) == {*typing.get_args(AnyTopic), type(None)}:
            return "[topic](questions.md) or null"
        return " or ".join(type_name(arg) for arg in args)
    if isinstance(hint, type) and issubclass(hint, enum.Enum):
        return " or ".join(f"`{value.value}`" for value in hint)
    if origin is typing.Literal:
        return " or ".join(f"`{arg}`" for arg in args)
    if origin in (tuple, list):
        return f"list of {type_name(args[0])}"
    if origin is dict:
        return "table" if args[1] is Any else f"table of {type_name(args[1])}"
    return "any" if hint is Any else f"[{hint.__name__}](#{hint.__name__.lower()})"


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = [head, tuple("---" for _ in head), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", r"\|") for cell in row) + " |" for row in lines)


# -- drivers ------------------------------------------------------------------------------------


def checks() -> str:
    """The checks of the torture suite."""
    return (
        _table(
            ("check", "badge", "what must hold"),
            ((n, tier, describe_check(n)) for n, (tier, _) in CHECKS.items()),
        )
        + "\n"
    )


def sizes() -> str:
    """The packaged descriptions: how big each instrument is, and where that comes from."""
    rows = []
    for path in sorted((ROOT / "drivers" / "labos_drivers").glob("*/description.yaml")):
        file = load_description(path)
        rows += [
            _size(file.driver, file),
            *(_size(f"{file.driver}, {n}", apply_variant(file, n)) for n in file.variants),
        ]
    head = (
        "driver",
        "footprint (mm)",
        "height",
        "from",
        "reach (mm)",
        "from",
        "stations from",
        "moving parts from",
    )
    return _table(head, rows) + "\n"


def _size(name: str, file: DescriptionFile) -> tuple[str, ...]:
    foot, reach = file.footprint, file.reach
    moves = (part.moves for part in file.parts.values())
    return (
        name,
        " × ".join(f"{side:g}" for side in foot.size_mm),
        f"{foot.height_mm:g}",
        foot.basis,
        f"{reach.radius_mm[1]:g}" if reach else "",
        reach.basis if reach else "",
        ", ".join(dict.fromkeys(place.basis for place in file.stations.values())),
        ", ".join(dict.fromkeys(move.basis for move in moves if move is not None)),
    )


# -- SQL --------------------------------------------------------------------------------------


def views() -> str:
    """Every view that SQL is asked of, with its columns."""
    return "\n".join(_one_view(table) for table in VIEWS)


def _one_view(table: Table) -> str:
    rows = [(f"`{column.name}`", column.kind, column.about) for column in list_view_columns(table)]
    return f"## {table.view}\n\n{table.about}\n\n{_table(('column', 'kind', 'what it says'), rows)}\n"


# -- files -------------------------------------------------------------------------------------

# -- metrics -----------------------------------------------------------------------------------


def kernel_metrics() -> str:
    """What a kernel shows to Prometheus."""
    return _metrics(KernelMetrics(LabState).registry.families)


def node_metrics() -> str:
    """What a node shows to Prometheus."""
    return _metrics(NodeMetrics("", "", simulated=True).families)


def api_metrics() -> str:
    """What an API process shows to Prometheus."""
    return _metrics(ApiMetrics().registry.families)


def _metrics(families: Iterable[LabMetric]) -> str:
    head = ("metric", "kind", "labels", "meaning", "most series")
    rows = [
        (
            f"`{family.name}`",
            family.kind,
            ", ".join(f"`{name}`" for name in family.labels),
            family.help,
            f"{(family.most if family.labels else 1) * family.width:,}",
        )
        for family in families
    ]
    return _table(head, rows) + "\n"


PARTS: dict[str, Callable[[], str]] = {
    "cli": cli,
    "exits": exits,
    "events": events,
    "parts": parts,
    "reactions": reactions,
    "machines": drawings.machines,
    "waits": partial(drawings.waits, _table),
    "questions": partial(drawings.questions, _table),
    "messages": messages,
    "checks": checks,
    "badges": badges,
    "sizes": sizes,
    "http": partial(http_page.http, _table),
    "operations": partial(http_page.operations, _table),
    "problems": partial(http_page.problems, _table),
    "rights": partial(rights_page.rights, _table),
    "routes": partial(rights_page.routes, _table),
    "kernel_metrics": kernel_metrics,
    "node_metrics": node_metrics,
    "api_metrics": api_metrics,
    "views": views,
}

PAGES = (*sorted(REFERENCE.glob("*.md")), DOCS / "torture.md", DOCS / "descriptions.md")


def renew(text: str) -> str:
    """A page with its generated parts as they should be now."""
    return _REGION.sub(lambda found: f"{found[1]}{PARTS[found[2]]()}{found[3]}", text)


def schemas() -> dict[Path, str]:
    """The published JSON Schemas, by file."""
    return {REFERENCE / "schemas" / f"{kind}.json": write_schema(kind) for kind in FILES}


def main() -> None:
    for path, text in schemas().items():
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
    for page in PAGES:
        text = page.read_text()
        if renew(text) != text:
            page.write_text(renew(text))
    client_code.main()


if __name__ == "__main__":
    main()
