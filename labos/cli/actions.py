"""``labos actions``: the actions of a module."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import click
import msgspec

from labos.cli._complete import make_completer
from labos.cli._lab import read_workcell
from labos.cli._out import end_with_json, show_table, terminal_width
from labos.cli._query import Where, log_and_json, open_log
from labos.core.arguments import describe_arg, shorten
from labos.core.ids import local
from labos.errors import NotFound, StoreUnavailable
from labos.services.history import find_position_at
from labos.services.log import fold_to
from labos.services.times import Moment

if TYPE_CHECKING:
    from labos.core.model import ActionSpec, Arg, Description, ModuleSpec

WIDTH = 100


class Offer(msgspec.Struct, frozen=True):
    """The actions of one module, or of one driver without a module."""

    name: str
    driver: str
    description: str
    actions: tuple[ActionSpec, ...]


@click.command("actions")
@click.argument(
    "name",
    shell_complete=make_completer("module", "driver"),
    required=False,
    default="",
    metavar="[MODULE|DRIVER]",
)
@click.argument("action", required=False, default="")
@click.option("--drivers", is_flag=True, help="Show all installed drivers, even if there is a lab.")
@click.option("--workcell", "file", metavar="FILE", help="The modules of this workcell file.")
@log_and_json
def command(where: Where, name: str, action: str, drivers: bool, file: str | None) -> None:
    """Show the actions of a module, with the arguments for a step of a workflow.

    MODULE is a module of the lab, or with --workcell of the workcell file. DRIVER is a driver or a model.
    Without a name, the command shows all modules of the lab, or all installed drivers if there is no lab.

    \b
    labos actions                         every module, and its actions
    labos actions sealer                  the actions of one module, with units and ranges
    labos actions sealer seal             one action
    labos actions pf400 --drivers         a driver, even if a module has the same name
    labos actions --workcell cell.yaml    the actions of all modules of a file
    """
    offers = list(_list_offers(where, file, drivers=drivers))
    if name:
        offers = _find_offers(offers, list(_list_drivers()), name)
    if action:
        offers = [_keep_only(offer, action) for offer in offers]
    end_with_json([_make_plain(offer) for offer in offers])
    if name:
        for offer in offers:
            _show(offer)
    else:
        rows = [(o.name, o.driver, ", ".join(spec.name for spec in o.actions)) for o in offers]
        show_table(("module" if any(o.name != o.driver for o in offers) else "", "driver", "actions"), rows)


# -- modules and drivers -------------------------------------------------------------------------


def _list_offers(where: Where, file: str | None, *, drivers: bool) -> Iterator[Offer]:
    from labos.spec.about import find_description

    modules = [] if drivers else _list_modules(where, file)
    if not modules:
        yield from _list_drivers()
        return
    known = _load_descriptions()
    for module in modules:
        found = find_description(module, known)
        if found is not None:
            yield Offer(local(module.name), module.driver, found.description, _sort_actions(found))


def _list_modules(where: Where, file: str | None) -> list[ModuleSpec]:
    """The modules of the file, or those of the lab; none if there is no lab yet."""
    if file is not None:
        return list(read_workcell(file).workcell.modules)
    try:
        with open_log(where) as store:
            state = fold_to(store, find_position_at(store, Moment()))
            return [module.spec for module in state.modules.by_name.values()]
    except StoreUnavailable:
        if where.database:
            raise
        return []


def _list_drivers() -> Iterator[Offer]:
    for name, found in sorted(_load_descriptions().items()):
        yield Offer(name, name, found.description, _sort_actions(found))


def _load_descriptions() -> Any:
    from labos.bootstrap import descriptions

    return descriptions()


def _sort_actions(found: Description) -> tuple[ActionSpec, ...]:
    """The actions that runs use first, then those that only observe."""
    return tuple(sorted(found.actions, key=lambda spec: (not spec.exclusive, spec.recovers)))


def _find_offers(offers: list[Offer], drivers: list[Offer], name: str) -> list[Offer]:
    """Modules of that name; else those with that driver; else the driver or model itself. Raises NotFound."""
    from labos.spec.findings import suggest_name

    wanted = local(name).lower()
    for found in (
        [offer for offer in offers if offer.name.lower() == wanted],
        [offer for offer in drivers if wanted in _names_of(offer.driver)],
    ):
        if found:
            return found
    known = [offer.name for offer in (*offers, *drivers)]
    raise NotFound(f"There is no module and no driver {name!r}.", remedy=suggest_name(name, known, "module"))


def _names_of(driver: str) -> set[str]:
    found = _load_descriptions()[driver]
    return {driver.lower(), *(model.lower() for model in found.models)}


def _keep_only(offer: Offer, action: str) -> Offer:
    from labos.spec.findings import suggest_name

    found = tuple(spec for spec in offer.actions if action in (spec.name, *spec.aliases))
    if not found:
        names = [spec.name for spec in offer.actions]
        raise NotFound(
            f"{offer.name} has no action {action!r}.", remedy=suggest_name(action, names, "action")
        )
    return msgspec.structs.replace(offer, actions=found)


# -- output -------------------------------------------------------------------------------------


def _make_plain(offer: Offer) -> dict[str, Any]:
    plain: dict[str, Any] = msgspec.to_builtins(offer)
    for spec in plain["actions"]:
        for arg in spec["args"]:
            arg.setdefault("required", True)
    return plain


def _show(offer: Offer) -> None:
    who = offer.name if offer.name == offer.driver else f"{offer.name} (driver {offer.driver})"
    click.echo(f"{who}: {offer.description}" if offer.description else who)
    for spec in offer.actions:
        formatter = click.HelpFormatter(width=terminal_width(WIDTH))
        formatter.write("\n")
        formatter.write_text(f"{spec.name}: {_describe_action(spec)}")
        if spec.args:
            with formatter.indentation():
                formatter.write_dl([(arg.name, _describe_argument(arg)) for arg in spec.args], col_max=26)
        click.echo(formatter.getvalue(), nl=False)


def _describe_action(spec: ActionSpec) -> str:
    words = [f"{spec.description.rstrip('.')}." if spec.description else ""]
    words.append(f"About {_show_seconds(spec.duration_s)}." if spec.duration_s else "")
    if spec.duration_from:
        words.append(f"Its duration depends on {spec.duration_from}.")
    if spec.aliases:
        words.append(f"Also written {', '.join(spec.aliases)}.")
    if not spec.exclusive:
        words.append("The module can do it during another action.")
    if spec.recovers:
        words.append("It resets the module after an error.")
    if spec.dangerous:
        words.append(f"Dangerous: {spec.dangerous}.")
    return " ".join(filter(None, words)) or "No description."


def _show_seconds(duration_s: float) -> str:
    return f"{duration_s / 60:g} min" if duration_s >= 120 and duration_s % 30 == 0 else f"{duration_s:g} s"


def _describe_argument(arg: Arg) -> str:
    words = describe_arg(arg)
    if arg.default in (None, ""):
        words += "" if arg.required and arg.default is None else ", may be left out"
    else:
        words += f", {_show_value(arg.default)} if not given"
    words += f": {arg.description.rstrip('.')}" if arg.description else ""
    if arg.aliases:
        words += f" (also {', '.join(arg.aliases)})"
    return f"{words}."


def _show_value(value: Any) -> str:
    """A value in the form of a workflow file."""
    return str(value).lower() if isinstance(value, bool) else shorten(value)
