"""``labos driver describe``: the geometry of an instrument, for people and for simulators."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import click

from labos.cli._complete import make_completer
from labos.cli._options import json_option
from labos.cli._out import show_json, show_lines, show_table, wants_json

if TYPE_CHECKING:
    from labos.spec.description import DescriptionFile, MovesEntry, PlaceEntry
    from labos.spec.frames import Frame


@click.command("describe")
@click.argument("driver", shell_complete=make_completer("driver"))
@click.option("--variant", default="", metavar="NAME", help="Another size of the instrument.")
@click.option("--urdf", metavar="FOLDER", help="Write a URDF and its meshes into this folder.")
@json_option
def describe_command(driver: str, variant: str, urdf: str | None) -> None:
    """Show the size of DRIVER's instrument, its moving parts, and its places for labware.

    DRIVER is an installed driver, a file (shaker.py), or a description.yaml, which is also checked.
    Lengths are in mm, angles in degrees. `from` names the source of the numbers. `assumed` marks an
    estimate that is used only for drawings.

    \b
    labos driver describe pf400
    labos driver describe ur --variant ur3e --urdf models
    labos driver describe ./shaker/labos_shaker/description.yaml
    """
    from labos.spec.describing import apply_variant as variant_of
    from labos.spec.describing import load_description, make_plain

    file = load_description(_find_path(driver))
    if variant:
        file = variant_of(file, variant)
    if urdf is not None:
        written = _write(Path(urdf), f"{file.driver}_{variant}" if variant else file.driver, file)
        if wants_json():
            show_json({"written": [str(path) for path in written]})
        else:
            show_lines(written, "wrote ")
    elif wants_json():
        show_json(make_plain(file))
    else:
        _show(file)


def _find_path(driver: str) -> Path:
    """The description's file. Raises NotFound, BadInput."""
    if driver.endswith((".yaml", ".yml")):
        return Path(driver)
    from labos.bootstrap import find_description_path, load_driver

    return find_description_path(load_driver(driver))


def _write(folder: Path, name: str, file: DescriptionFile) -> list[Path]:
    from labos.spec.urdf import make_meshes, write_urdf

    folder.mkdir(parents=True, exist_ok=True)
    robot = folder / f"{name}.urdf"
    robot.write_text(write_urdf(file, name), encoding="utf-8")
    for mesh, content in make_meshes().items():
        (folder / mesh).write_bytes(content)
    return [robot, *(folder / mesh for mesh in make_meshes())]


def _show(file: DescriptionFile) -> None:
    foot = file.footprint
    click.echo(f"{file.driver}: {file.instrument}")
    size = " × ".join(f"{side:g}" for side in foot.size_mm)
    click.echo(f"footprint: {size} mm, {foot.height_mm:g} mm high ({foot.basis})")
    if file.reach is not None:
        reach = file.reach
        rail = f", {reach.rail_axis} {_show_span_of(reach.rail_mm)} mm on a rail" if reach.rail_mm else ""
        click.echo(
            f"reach: {_show_span_of(reach.radius_mm)} mm from the axis of {reach.on},"
            f" {_show_span_of(reach.height_mm)} mm high{rail} ({reach.basis})"
        )
    for name, grip in file.grips.items():
        note = f", {grip.note}" if grip.note else ""
        click.echo(f"grip {name}: {_show_span_of(grip.width_mm)} mm{note} ({grip.basis})")
    for name, limit in file.limits.items():
        click.echo(f"limit {name}: {_show_limit(limit)}")
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
        (name, part.on, _show_three(part.at_mm), _describe_moves(part.moves), part.basis)
        for name, part in file.parts.items()
    ]
    show_table(("part", "on", "at", "moves", "from"), rows, gap=True)


def _show_stations(file: DescriptionFile) -> None:
    if not file.stations:
        return
    from labos.spec.describing import locate_places

    at = locate_places(file)
    rows = [
        (
            _show_range(name, entry),
            entry.kind,
            _describe_place(name, entry, at),
            entry.approach,
            entry.basis,
            entry.note,
        )
        for name, entry in file.stations.items()
    ]
    show_table(("station", "kind", "at", "approach", "from", "note"), rows, gap=True)


def _describe_place(name: str, entry: PlaceEntry, at: Mapping[str, Frame]) -> str:
    """Where a station is in the instrument's own frame; the first one of a row."""
    for key, each in entry.each.items():
        name = name.replace(f"{{{key}}}", str(each.from_to[0]))
    return _show_three(at[name].at)


def _show_range(name: str, entry: PlaceEntry) -> str:
    for key, each in entry.each.items():
        name = name.replace(f"{{{key}}}", f"{each.from_to[0]}…{each.from_to[1]}")
    return name


def _describe_moves(moves: MovesEntry | None) -> str:
    if moves is None:
        return ""
    what = "mm" if moves.slide_mm is not None else "°"
    along = "along" if moves.slide_mm is not None else "about"
    like = f", as {moves.like}" if moves.like else ""
    return f"{_show_span_of(moves.limits)} {what} {along} {_show_three(moves.axis)}{like} ({moves.basis})"


def _show_span_of(pair: list[float]) -> str:
    return f"{pair[0]:g} to {pair[1]:g}"


def _show_three(values: list[float] | tuple[float, float, float]) -> str:
    return ", ".join(f"{round(value, 1) + 0.0:g}" for value in values)


def _show_limit(limit: float | str | list[float]) -> str:
    values = limit if isinstance(limit, list) else [limit]
    return ", ".join(value if isinstance(value, str) else f"{value:g}" for value in values)
