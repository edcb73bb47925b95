"""``labos driver describe``: an instrument as a thing in space, for people and for simulators."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import click

from labos.cli._complete import completes
from labos.cli._options import json_option
from labos.cli._out import show_json, show_table

if TYPE_CHECKING:
    from labos.spec.description import DescriptionFile, MovesEntry, PlaceEntry
    from labos.spec.frames import Frame


@click.command("describe")
@click.argument("driver", shell_complete=completes("driver"))
@click.option("--variant", default="", metavar="NAME", help="Another size of the instrument.")
@click.option("--urdf", metavar="FOLDER", help="Write a URDF and its meshes into this folder.")
@json_option
def describe_command(driver: str, variant: str, urdf: str | None, as_json: bool) -> None:
    """Show the size of DRIVER's instrument, its moving parts, and its places for labware.

    DRIVER is an installed driver, a file (shaker.py), or a description.yaml, which is also checked.
    Lengths are in mm, angles in degrees. `from` names the source of the numbers. `assumed` marks an
    estimate that is used only for drawings.

    \b
    labos driver describe pf400
    labos driver describe ur --variant ur3e --urdf models
    labos driver describe ./shaker/labos_shaker/description.yaml
    """
    from labos.spec.describing import load_description, plain_of
    from labos.spec.describing import variant as variant_of

    file = load_description(_path(driver))
    if variant:
        file = variant_of(file, variant)
    if urdf is not None:
        written = _write(Path(urdf), f"{file.driver}_{variant}" if variant else file.driver, file)
        if as_json:
            show_json({"written": [str(path) for path in written]})
        else:
            for path in written:
                click.echo(f"wrote {path}")
    elif as_json:
        show_json(plain_of(file))
    else:
        _show(file)


def _path(driver: str) -> Path:
    """The description's file. Raises NotFound, BadInput."""
    if driver.endswith((".yaml", ".yml")):
        return Path(driver)
    from labos.bootstrap import description_path, load_driver

    return description_path(load_driver(driver))


def _write(folder: Path, name: str, file: DescriptionFile) -> list[Path]:
    from labos.spec.urdf import meshes, urdf_of

    folder.mkdir(parents=True, exist_ok=True)
    robot = folder / f"{name}.urdf"
    robot.write_text(urdf_of(file, name), encoding="utf-8")
    for mesh, content in meshes().items():
        (folder / mesh).write_bytes(content)
    return [robot, *(folder / mesh for mesh in meshes())]


def _show(file: DescriptionFile) -> None:
    foot = file.footprint
    click.echo(f"{file.driver}: {file.instrument}")
    size = " × ".join(f"{side:g}" for side in foot.size_mm)
    click.echo(f"footprint: {size} mm, {foot.height_mm:g} mm high ({foot.basis})")
    if file.reach is not None:
        reach = file.reach
        rail = f", {reach.rail_axis} {_span(reach.rail_mm)} mm on a rail" if reach.rail_mm else ""
        click.echo(
            f"reach: {_span(reach.radius_mm)} mm from the axis of {reach.on},"
            f" {_span(reach.height_mm)} mm high{rail} ({reach.basis})"
        )
    for name, grip in file.grips.items():
        note = f", {grip.note}" if grip.note else ""
        click.echo(f"grip {name}: {_span(grip.width_mm)} mm{note} ({grip.basis})")
    for name, limit in file.limits.items():
        click.echo(f"limit {name}: {_limit(limit)}")
    for name, entry in file.variants.items():
        click.echo(f"variant {name}: {entry.instrument or file.instrument}")
    _show_parts(file)
    _show_stations(file)
    click.echo()
    for name, source in file.sources.items():
        click.echo(f"{name}: {source.strip()}")
    if file.notes:
        click.echo(file.notes.strip())


def _show_parts(file: DescriptionFile) -> None:
    rows = [
        (name, part.on, _three(part.at_mm), _moves(part.moves), part.basis)
        for name, part in file.parts.items()
    ]
    click.echo()
    show_table(("part", "on", "at", "moves", "from"), rows)


def _show_stations(file: DescriptionFile) -> None:
    if not file.stations:
        return
    from labos.spec.describing import places_at

    at = places_at(file)
    rows = [
        (
            _show_range(name, entry),
            entry.kind,
            _where(name, entry, at),
            entry.approach,
            entry.basis,
            entry.note,
        )
        for name, entry in file.stations.items()
    ]
    click.echo()
    show_table(("station", "kind", "at", "approach", "from", "note"), rows)


def _where(name: str, entry: PlaceEntry, at: Mapping[str, Frame]) -> str:
    """Where a station is in the instrument's own frame; the first one of a row."""
    for key, each in entry.each.items():
        name = name.replace(f"{{{key}}}", str(each.from_to[0]))
    return _three(at[name].at)


def _show_range(name: str, entry: PlaceEntry) -> str:
    for key, each in entry.each.items():
        name = name.replace(f"{{{key}}}", f"{each.from_to[0]}…{each.from_to[1]}")
    return name


def _moves(moves: MovesEntry | None) -> str:
    if moves is None:
        return ""
    what = "mm" if moves.slide_mm is not None else "°"
    along = "along" if moves.slide_mm is not None else "about"
    like = f", as {moves.like}" if moves.like else ""
    return f"{_span(moves.limits)} {what} {along} {_three(moves.axis)}{like} ({moves.basis})"


def _span(pair: list[float]) -> str:
    return f"{pair[0]:g} to {pair[1]:g}"


def _three(values: list[float] | tuple[float, float, float]) -> str:
    return ", ".join(f"{round(value, 1) + 0.0:g}" for value in values)


def _limit(limit: float | str | list[float]) -> str:
    values = limit if isinstance(limit, list) else [limit]
    return ", ".join(value if isinstance(value, str) else f"{value:g}" for value in values)
