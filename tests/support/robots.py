"""URDFs as others read them: by the parser of the ROS project, with kinematics of their own."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from urdf_parser_py.urdf import URDF

from labos.spec.description import DescriptionFile
from labos.spec.urdf import make_meshes, write_urdf

Array = NDArray[np.float64]


def write_robot(file: DescriptionFile, folder: Path | None = None) -> Path:
    """A folder with the URDF, which is called robot.urdf, and its meshes."""
    folder = folder or Path(tempfile.mkdtemp())
    (folder / "robot.urdf").write_text(write_urdf(file), "utf-8")
    for name, content in make_meshes().items():
        (folder / name).write_bytes(content)
    return folder


def parse_robot(file: DescriptionFile) -> Any:
    """The URDF as the foreign parser has it."""
    return URDF.from_xml_string(write_urdf(file).encode())


def poses(robot: Any, joints: Mapping[str, float]) -> dict[str, Array]:
    """Each link's pose in the root's frame as a 4 × 4 matrix, in metres; ``joints`` in metres or radians by
    the name of the joint, 0 for others."""
    found: dict[str, Array] = {robot.get_root(): np.eye(4)}
    waiting = list(robot.joints)
    while waiting:
        ready = [joint for joint in waiting if joint.parent in found]
        assert ready, "links that hang on nothing"
        for joint in ready:
            found[joint.child] = found[joint.parent] @ _origin(joint) @ _move(joint, joints)
            waiting.remove(joint)
    return found


def _move(joint: Any, joints: Mapping[str, float]) -> Array:
    if joint.type == "fixed":
        return np.eye(4)
    value = joints.get(joint.name, 0.0)
    if joint.mimic is not None:
        value = joints.get(joint.mimic.joint, 0.0) * joint.mimic.multiplier
    axis = np.array(joint.axis, dtype=float)
    axis /= np.linalg.norm(axis)
    moved = np.eye(4)
    if joint.type == "prismatic":
        moved[:3, 3] = axis * value
        return moved
    across = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    moved[:3, :3] += np.sin(value) * across + (1 - np.cos(value)) * across @ across
    return moved


def _origin(joint: Any) -> Array:
    (x, y, z), (roll, pitch, yaw) = joint.origin.xyz, joint.origin.rpy
    (cr, cp, cy), (sr, sp, sy) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    pose = np.eye(4)
    pose[:3, :3] = about_z @ about_y @ about_x
    pose[:3, 3] = x, y, z
    return pose
