"""What each application has found, held against what the simulated instruments know."""

from __future__ import annotations

import csv
import json
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from polymer_colours import difference, lab_of

from labos.node.world import World
from labos_drivers import _optics, _polymers
from labos_drivers._growth import IC50_MG_PER_L
from tests.apps.together.bench import Bench
from tests.apps.together.programs import Program

DYES = ("color_A", "color_B", "color_C")
COLOR_OFF = 5.0
"""Of 255, in each channel (specs/apps/color_picker/README.md)."""
IC50_OFF = 0.1
"""Of one plate (specs/apps/growth_assay/README.md)."""
DIFFUSION, DIFFUSION_OFF = 4.9065e-12, 0.08
"""m²/s, of spheres of 50 nm in water at 25 °C by Stokes and Einstein (specs/apps/pendant_drop/README.md)."""
POLYMER_OFF = 1.0
"""CIE 2000: what is just seen (specs/apps/polymers/README.md)."""


def check_color_picker(world: World, program: Program) -> str:
    """Each well of the table holds on one of the plates what the table says, and has the colour that its
    contents have."""
    rows = _table(program.out / "data.csv")
    mixing = [motion for motion in world.motions("pipette") if "color_A" in motion.facts["volumes"]]
    plates = {motion.plate: world.contents(motion.plate) for motion in mixing}
    worst = 0.0
    for row in rows:
        told = [float(row[f"dye_{name}_ul"]) for name in "ABC"]
        wells = [contents[row["well"]] for contents in plates.values() if row["well"] in contents]
        mixed = next(well for well in wells if np.allclose([well[dye] for dye in DYES], told))
        seen = [float(row[channel]) for channel in ("red", "green", "blue")]
        worst = max(worst, float(np.abs(np.subtract(seen, _optics.color_of(mixed))).max()))
    assert worst <= COLOR_OFF, worst
    count = sum(map(len, plates.values()))
    return f"{count} wells mixed on {len(plates)} plates, {len(rows)} colours at most {worst:.1f} of 255 off"


def check_pcr(world: World, program: Program) -> str:
    """Each plate was sealed, cycled and peeled once, and its picture is there."""
    cycled = [motion.plate for motion in world.motions("cycle")]
    rows = _table(program.out / "data.csv")
    assert len(cycled) == len(set(cycled)) == len(rows), cycled
    for plate in cycled:
        done = Counter(motion.verb for motion in world.history(plate, "seal", "peel", "pipette"))
        assert done == {"seal": 1, "peel": 1, "pipette": 1}, (plate, done)
    assert len(list(program.out.glob("plate*.jpg"))) == len(rows)
    return f"{len(rows)} plates sealed, cycled and peeled once each"


def check_growth_assay(world: World, program: Program) -> str:
    """The concentration is that by which the simulated drug works; each plate was warm once."""
    (folder,) = [path.parent for path in program.out.glob("*/readings.json")]
    curve = json.loads((folder / "readings.json").read_text())["curve"]
    truth = IC50_MG_PER_L["tetracycline"]
    off = curve["ic50"] / truth - 1
    assert abs(off) <= IC50_OFF, curve
    warm = [motion.plate for motion in world.motions("incubate")]
    assert len(warm) == len(set(warm)), warm
    return f"IC50 {curve['ic50']:.3f} mg/L from {len(warm)} plates, {off:+.1%} off"


def check_polymers(world: World, program: Program) -> str:
    """Each well holds the recipe that the table names, and has the colour of its spectrum."""
    rows = _table(program.out / "data.csv")
    plates = {motion.plate for motion in world.motions("synthesise")}
    assert len(plates) == 1, plates
    made = _polymers.find_polymers(world, plates.pop())
    worst = 0.0
    for row in rows:
        polymer = made[row["well"]]
        shares = np.array(polymer.volumes_ul) / sum(polymer.volumes_ul)
        told = [float(row[f"share_{name}"]) for name in "ABC"]
        np.testing.assert_allclose(shares, told, atol=2e-3)
        nm = np.arange(300.0, 1001.0, 10.0)
        really = lab_of(nm, np.array([_polymers.absorbance_of(polymer, at) for at in nm]))
        worst = max(worst, difference(tuple(float(row[name]) for name in "Lab"), really))  # type: ignore[arg-type]
    nearest = min(float(row["difference_CIE2000"]) for row in rows)
    assert worst <= POLYMER_OFF, worst
    assert nearest <= program.app.payload.get("tolerance", POLYMER_OFF), nearest
    told = f"{len(rows)} polymers, colours at most {worst:.2f} (CIE 2000) off"
    return f"{told}, the nearest {nearest:.2f} from its target"


def check_pendant_drop(world: World, program: Program) -> str:
    """The diffusion coefficient is that of Stokes and Einstein."""
    rows = _table(program.out / "data.csv")
    mean = float(np.mean([float(row["diffusion_m2_per_s"]) for row in rows]))
    off = mean / DIFFUSION - 1
    assert abs(off) <= DIFFUSION_OFF, mean
    drops, made = len(world.motions("run_droplet")), len(world.motions("create_sample"))
    assert drops == made, (drops, made)
    return f"D {mean * 1e12:.3f} µm²/s from {len(rows)} of {drops} drops, {off:+.1%} off"


CHECKS: dict[str, Callable[[World, Program], str]] = {
    "color_picker": check_color_picker,
    "pcr": check_pcr,
    "growth_assay": check_growth_assay,
    "polymers": check_polymers,
    "pendant_drop": check_pendant_drop,
}


def check_results(bench: Bench, programs: list[Program]) -> dict[str, str]:
    """What each application found and how far it is off. Raises AssertionError."""
    found = {}
    for program in programs:
        with bench.world(program.app.cell) as world:
            found[program.app.name] = CHECKS[program.app.name](world, program)
    return found


def _table(path: Path) -> list[dict[str, Any]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))
