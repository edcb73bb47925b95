"""Copies the results of an iteration to where others read them."""

from __future__ import annotations

import shutil
from pathlib import Path

from labos.client.paper import Experiment


def publish_iter(folder_path: Path, dest_path: Path, exp: Experiment) -> None:
    shutil.copytree(folder_path, dest_path, dirs_exist_ok=True)
    exp.events.log_globus_flow("publish", flow_id=dest_path.name)
