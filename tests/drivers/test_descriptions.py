"""The descriptions of the instruments: of one mind with their drivers, and what simulators can read."""

from __future__ import annotations

import itertools
import random
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from math import cos, degrees, dist, hypot, pi, radians, sin
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from labos.bootstrap import load_driver
from labos.spec.describing import (
    apply_model,
    apply_variant,
    list_places,
    load_description,
    locate_parts,
    locate_places,
)
from labos.spec.description import BASE, DescriptionFile
from labos.spec.frames import frame, from_quaternion
from labos.spec.schema import make_schema
from labos.spec.source import make_plain, read
from labos.spec.urdf import name_station_link
from labos_drivers.pf400 import kinematics, protocol
from tests.support.robots import parse_robot, poses, write_robot

ROOT = Path(__file__).parents[2]
DRIVERS = ROOT / "drivers" / "labos_drivers"
FOLDERS = sorted(path.parent.name for path in DRIVERS.glob("*/description.yaml"))


def list_descriptions(name: str) -> Iterator[tuple[str, DescriptionFile]]:
    file = load_description(DRIVERS / name / "description.yaml")
    yield name, file
    for other in file.variants:
        yield f"{name}-{other}", apply_variant(file, other)


FILES = dict(pair for name in FOLDERS for pair in list_descriptions(name))


@pytest.fixture(params=FILES)
def file(request: pytest.FixtureRequest) -> DescriptionFile:
    return FILES[request.param]


def any_joints(file: DescriptionFile, seed: int) -> dict[str, float]:
    """Values within their limits for all that moves by itself, in mm or degrees."""
    dice = random.Random(seed)
    moving = {n: p.moves for n, p in file.parts.items() if p.moves is not None and p.moves.like is None}
    return {name: dice.uniform(*moves.limits) for name, moves in moving.items()}


def for_urdf(file: DescriptionFile, joints: dict[str, float]) -> dict[str, float]:
    """The same in metres or radians."""
    found = {}
    for name, value in joints.items():
        moves = file.parts[name].moves
        assert moves is not None
        found[f"{name}_joint"] = value / 1000 if moves.slide_mm is not None else radians(value)
    return found


# -- of one mind with the driver -----------------------------------------------------------------


def test_every_driver_describes_its_instrument() -> None:
    interfaces = {path.parent.name for path in DRIVERS.glob("*/interface.py")}
    assert set(FOLDERS) == interfaces


def test_stations_are_those_of_the_driver(file: DescriptionFile) -> None:
    about = load_driver(file.driver).describe()
    assert {name: place.kind for name, place in list_places(file).items()} == {
        station.name: station.kind for station in about.stations
    }


def test_who_carries_labware_has_a_reach_and_a_hand(file: DescriptionFile) -> None:
    about = load_driver(file.driver).describe()
    assert (file.reach is not None) == about.manipulator
    assert ("gripper" in list_places(file)) == about.manipulator


def test_variants_are_of_models_that_the_driver_serves(file: DescriptionFile) -> None:
    models = {model.lower() for model in load_driver(file.driver).describe().models}
    for entry in file.variants.values():
        assert {model.lower() for model in entry.models} <= models


@pytest.mark.parametrize("name", FOLDERS)
def test_it_fits_the_published_schema(name: str) -> None:
    jsonschema = pytest.importorskip("jsonschema")
    path = DRIVERS / name / "description.yaml"
    validator = jsonschema.Draft202012Validator(make_schema("description"))
    assert [error.message for error in validator.iter_errors(make_plain(read(path).data))] == []
    schema = path.read_text("utf-8").partition("\n")[0].partition("$schema=")[2]
    assert (path.parent / schema).resolve() == ROOT / "docs/reference/schemas/description.json"


# -- sizes ----------------------------------------------------------------------------------------


def still(file: DescriptionFile, name: str) -> bool:
    """Whether a part, and all that carries it, stands still."""
    while name != BASE:
        if file.parts[name].moves is not None:
            return False
        name = file.parts[name].on
    return True


def test_what_stands_still_is_within_footprint_and_height(file: DescriptionFile) -> None:
    at = locate_parts(file)
    (length, width), (x, y) = file.footprint.size_mm, file.footprint.middle_mm
    for name, part in file.parts.items():
        for shape in part.shapes if still(file, name) else ():
            size = shape.box_mm or [shape.cylinder_mm[0], *shape.cylinder_mm]  # type: ignore[index]
            here = at[name].then(frame(shape.at_mm, shape.turn_deg))
            for signs in itertools.product((-0.5, 0.5), repeat=3):
                corner = here.point([sign * side for sign, side in zip(signs, size, strict=True)])
                assert abs(corner[0] - x) <= length / 2 + 1e-6, name
                assert abs(corner[1] - y) <= width / 2 + 1e-6, name
                assert -1e-6 <= corner[2] <= file.footprint.height_mm + 1e-6, name


def test_the_hand_stays_within_reach_and_comes_near_its_ends() -> None:
    for name, file in FILES.items():
        if file.reach is None or "gripper" not in list_places(file) or name == "operator":
            continue  # a person's joints are not described
        reach, gripper = file.reach, file.stations["gripper"]
        farthest, lowest, highest = 0.0, 9e9, -9e9
        for seed in range(700):
            parts = locate_parts(file, any_joints(file, seed))
            base, hand = parts[reach.on], parts[gripper.on].then(frame(gripper.at_mm))
            away = dist(base.at[:2], hand.at[:2])
            assert reach.radius_mm[0] - 1 <= away <= reach.radius_mm[1] + 1, name
            assert reach.height_mm[0] - 1 <= hand.at[2] <= reach.height_mm[1] + 1, name
            farthest = max(farthest, away)
            lowest, highest = min(lowest, hand.at[2]), max(highest, hand.at[2])
        if name != "liconic":  # its shovel meets walls that are not joints
            assert farthest >= 0.93 * reach.radius_mm[1], name
            assert highest - lowest >= 0.85 * (reach.height_mm[1] - reach.height_mm[0]), name


# -- as others read it ----------------------------------------------------------------------------


def test_a_foreign_parser_finds_all_links_and_joints(file: DescriptionFile) -> None:
    robot = parse_robot(file)
    assert robot.get_root() == BASE
    assert {link.name for link in robot.links} == {
        BASE, *file.parts, *(name_station_link(name) for name in list_places(file))
    }  # fmt: skip
    for name, part in file.parts.items():
        joint = robot.joint_map[f"{name}_joint"]
        assert joint.parent == part.on
        assert np.allclose(np.array(joint.origin.xyz) * 1000, part.at_mm)
        if part.moves is None:
            assert joint.type == "fixed"
        elif part.moves.slide_mm is not None:
            assert joint.type == "prismatic"
            assert np.allclose([joint.limit.lower * 1000, joint.limit.upper * 1000], part.moves.limits)
        else:
            assert joint.type == "revolute"
            assert np.allclose(
                [degrees(joint.limit.lower), degrees(joint.limit.upper)], part.moves.limits, atol=1e-6
            )
        assert (joint.mimic is not None) == (part.moves is not None and part.moves.like is not None)


def test_its_meshes_are_as_big_as_the_parts(file: DescriptionFile, tmp_path: Path) -> None:
    folder = write_robot(file, tmp_path)
    for link in parse_robot(file).links:
        shapes = file.parts[link.name].shapes if link.name in file.parts else []
        assert len(link.visuals) == len(link.collisions) == len(shapes)
        for shape, visual in zip(shapes, link.visuals, strict=True):
            mesh: Any = trimesh.load(folder / visual.geometry.filename, file_type="stl")
            assert mesh.is_watertight
            assert mesh.is_winding_consistent
            mesh.apply_scale(visual.geometry.scale)
            size = shape.box_mm or [shape.cylinder_mm[0], *shape.cylinder_mm]  # type: ignore[index]
            assert np.allclose(mesh.extents * 1000, size)
            part = 1.0 if shape.box_mm else 32 * sin(2 * pi / 32) / 8  # of a prism with 32 sides
            assert mesh.volume * 1e9 == pytest.approx(part * size[0] * size[1] * size[2], rel=1e-4)


@pytest.mark.parametrize("seed", range(5))
def test_a_foreign_reader_has_every_frame_where_we_have_it(file: DescriptionFile, seed: int) -> None:
    joints = any_joints(file, seed)
    theirs = poses(parse_robot(file), for_urdf(file, joints))
    ours = locate_parts(file, joints) | {
        name_station_link(n): at for n, at in locate_places(file, joints).items()
    }
    assert theirs.keys() == ours.keys()
    for name, here in ours.items():
        assert np.allclose(theirs[name][:3, 3] * 1000, here.at, atol=1e-6), name
        assert np.allclose(theirs[name][:3, :3], here.turn, atol=1e-9), name


# -- arms -----------------------------------------------------------------------------------------


def test_the_pf400_is_where_its_driver_takes_it_to_be() -> None:
    file = FILES["pf400"]
    robot = parse_robot(file)
    links = [robot.joint_map[name].origin.xyz[0] for name in ("outer_link_joint", "hand_joint")]
    links.append(robot.joint_map["station_gripper_joint"].origin.xyz[0])
    assert np.allclose(links, [0.302, 0.289, 0.162])
    axis = np.array([-100.5 + 30.05 + 173.001, 0.0, 0.0])  # where the shoulder is with the rail at 0
    for seed in range(200):
        told = any_joints(file, seed)
        joints = (told["carriage"], told["inner_link"], told["outer_link"], told["hand"], 0.0, told["slide"])
        hand = poses(robot, for_urdf(file, told))["station_gripper"]
        x, y, z, yaw = kinematics.find_hand(joints)
        assert np.allclose(hand[:2, 3] * 1000 - axis[:2], (x, y), atol=1e-6)
        assert hand[2, 3] * 1000 - z == pytest.approx(98.633)
        assert np.allclose(hand[:2, 0], (cos(radians(yaw)), sin(radians(yaw))), atol=1e-9)


def test_the_pf400_grips_as_its_driver_does() -> None:
    assert {name: grip.width_mm for name, grip in FILES["pf400"].grips.items()} == {
        grip.name: [grip.closed_mm, grip.open_mm] for grip in (protocol.NARROW, protocol.WIDE)
    }


UR_DH = {  # a, d in m and alpha, as the maker publishes them
    "ur": [
        (0, 0.1625, pi / 2),
        (-0.425, 0, 0),
        (-0.3922, 0, 0),
        (0, 0.1333, pi / 2),
        (0, 0.0997, -pi / 2),
        (0, 0.0996, 0),
    ],
    "ur-ur3e": [
        (0, 0.15185, pi / 2),
        (-0.24355, 0, 0),
        (-0.2132, 0, 0),
        (0, 0.13105, pi / 2),
        (0, 0.08535, -pi / 2),
        (0, 0.0921, 0),
    ],
}
UR_JOINTS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")


@pytest.mark.parametrize("name", UR_DH)
def test_the_ur_is_as_its_maker_s_table_has_it(name: str) -> None:
    file = FILES[name]
    robot = parse_robot(file)
    for seed in range(100):
        told = any_joints(file, seed)
        flange = np.eye(4)
        for joint, (a, d, alpha) in zip(UR_JOINTS, UR_DH[name], strict=True):
            theta = radians(told[joint])
            (ct, ca), (st, sa) = np.cos([theta, alpha]), np.sin([theta, alpha])
            flange = flange @ np.array(
                [
                    [ct, -st * ca, st * sa, a * ct],
                    [st, ct * ca, -ct * sa, a * st],
                    [0, sa, ca, d],
                    [0, 0, 0, 1],
                ]
            )
        assert np.allclose(poses(robot, for_urdf(file, told))["flange"], flange, atol=1e-9)


TAUGHT = {
    "sealer.default": ("a4s_sealer", 15),
    "peeler.default": ("brooks_peeler", 15),
    "biometra.default": ("biometra", 15),
    "sciclops.exchange": ("sciclops", 15),
    "ot2_cp_gamma.deck2": ("ot2", 15),
}
"""Places of a real workcell, and within how many mm an arm that was taught by hand holds a plate there."""


@pytest.mark.parametrize("place", TAUGHT)
def test_taught_joints_of_a_real_workcell_lead_to_its_stations(place: str) -> None:
    """The modules' coordinates were measured, and the arm's joints taught, independently of each other."""
    cell = make_plain(read(ROOT / "specs/workcells/rpl.yaml").data)
    module, station = place.split(".")
    at = {
        entry["name"]: from_quaternion([1000 * v for v in entry["coordinates"][:3]], entry["coordinates"][3:])
        for entry in cell["modules"]
        if entry.get("coordinates")
    }
    column, shoulder, elbow, wrist, _, rail = cell["locations"]["pf400"][place]
    joints = {"carriage": column, "inner_link": shoulder, "outer_link": elbow, "hand": wrist, "slide": rail}
    hand = at["pf400"].then(locate_places(FILES["pf400"], joints)["gripper"])
    driver, within_mm = TAUGHT[place]
    there = at[module].then(locate_places(FILES[driver])[station])
    assert hypot(*(a - b for a, b in zip(hand.at, there.at, strict=True))) < within_mm, (hand.at, there.at)


# -- simulators, packages -------------------------------------------------------------------------


@pytest.mark.full
def test_a_simulator_has_every_frame_where_we_have_it(file: DescriptionFile, tmp_path: Path) -> None:
    """MuJoCo loads the meshes too; it is too large to be installed for this alone."""
    mujoco = pytest.importorskip("mujoco")
    spec = mujoco.MjSpec.from_file(str(write_robot(file, tmp_path) / "robot.urdf"))
    spec.compiler.fusestatic = False
    model = spec.compile()
    data = mujoco.MjData(model)
    shapes = sum(len(part.shapes) for part in file.parts.values())
    assert model.ngeom >= shapes
    for seed in range(20):
        joints = any_joints(file, seed)
        for name, value in for_urdf(file, joints).items():
            data.joint(name).qpos[0] = value
        for name, part in file.parts.items():
            if part.moves is not None and part.moves.like is not None:
                follows = for_urdf(file, joints)[f"{part.moves.like}_joint"] * part.moves.times
                data.joint(f"{name}_joint").qpos[0] = follows
        mujoco.mj_forward(model, data)
        for name, here in locate_parts(file, joints).items():
            if name != BASE:
                assert np.allclose(data.body(name).xpos * 1000, here.at, atol=1e-6), name


def test_a_wheel_holds_every_description(tmp_path: Path) -> None:
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True, timeout=100)
    (wheel,) = tmp_path.glob("*.whl")
    names = set(zipfile.ZipFile(wheel).namelist())
    assert {f"labos_drivers/{name}/description.yaml" for name in FOLDERS} <= names
    assert "labos/spec/urdf.py" in names  # the meshes are made by it


def test_models_find_their_size() -> None:
    assert apply_model(FILES["ur"], "ur3").instrument.endswith("UR3e")
    assert apply_model(FILES["ur"], "ur5e").instrument.endswith("UR5e")
    assert apply_model(FILES["mir"], "MiR100").footprint.height_mm == 352
