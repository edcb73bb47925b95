"""Passwords and tokens of devices. The workcell file is stored permanently, so it only names them and never
contains them."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from labos.errors import DeviceError


def read_secret(config: Mapping[str, Any], key: str, *, file_key: str = "") -> str:
    """The secret that a config names: ``<key>_env`` names a variable of the node's environment, and
    ``<key>_file`` (or ``file_key``) a file on the node's computer. Empty if it names none. Raises DeviceError
    (``none``) if it names both, a variable that is not set, or a file that cannot be read."""
    by_variable, by_file = f"{key}_env", file_key or f"{key}_file"
    variable, path = str(config.get(by_variable) or ""), str(config.get(by_file) or "")
    if variable and path:
        raise DeviceError(
            f"`config:` has both `{by_variable}` and `{by_file}`.",
            effects="none",
            remedy="Leave one of them out.",
        )
    if variable:
        found = os.environ.get(variable)
        if found is None:
            raise DeviceError(
                f"`{by_variable}` names the variable {variable!r}, which is not set.",
                effects="none",
                remedy="Set it in the environment of this node (of the lab, if the lab starts the node).",
            )
        return found.strip()
    if not path:
        return ""
    try:
        return Path(path).read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "it is not a text"
        raise DeviceError(
            f"`{by_file}` names the file {path!r}, which cannot be read ({why}).",
            effects="none",
            remedy="Put it, and nothing else, into that file on the node's computer.",
        ) from error
