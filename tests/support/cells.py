"""Workcells for tests, made from packaged ones."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import yaml

from labos.spec import find_spec

PCR = ("sciclops", "pf400", "ot2_pcr_alpha", "sealer", "biometra", "peeler", "camera_module")
"""The modules that the paper's PCR uses."""


def rpl_with(modules: Iterable[str], path: Path) -> Path:
    """The workcell of the paper with these modules only: fewer processes to start."""
    cell = yaml.safe_load(find_spec("workcells", "rpl").read_text())
    known = {*modules, "wc"}
    cell["modules"] = [module for module in cell["modules"] if module["name"] in known]
    for module, poses in cell["locations"].items():
        kept = {place: pose for place, pose in poses.items() if place.partition(".")[0] in known}
        cell["locations"][module] = kept
    path.write_text(yaml.safe_dump(cell))
    return path
