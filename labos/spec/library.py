"""The specs that are part of LabOS."""

from __future__ import annotations

from pathlib import Path

from labos.errors import NotFound
from labos.spec.findings import suggest_name

SUFFIXES = (".yaml", ".yml")


def find_specs_folder() -> Path:
    """The folder of the packaged specs: in the wheel, otherwise in the checkout."""
    package = Path(__file__).resolve().parents[1]
    packaged = package / "_specs"
    return packaged if packaged.is_dir() else package.parent / "specs"


def list_specs(kind: str) -> list[str]:
    """The names of the packaged specs of a kind: workcells, workflows or labware."""
    folder = find_specs_folder() / kind
    return sorted(path.stem for path in folder.glob("*") if path.suffix in SUFFIXES)


def find_spec(kind: str, name: str) -> Path:
    """The path of a packaged spec: ``find_spec("workcells", "rpl")``. Raises NotFound."""
    known = list_specs(kind)
    stem = name.removesuffix(".yaml").removesuffix(".yml")
    if stem not in known:
        raise NotFound(
            f"There is no packaged spec {name!r} in {kind!r}.", remedy=suggest_name(stem, known, "spec")
        )
    return next(
        path for suffix in SUFFIXES if (path := find_specs_folder() / kind / f"{stem}{suffix}").is_file()
    )
