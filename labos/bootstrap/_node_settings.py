"""The settings of a module on its node's own computer: files, programs, secrets. These are never sent over
HTTP."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from labos.errors import BadInput
from labos.node.protocol import SetupReply


def with_own_settings(reply: SetupReply, path: Path, module: str) -> SetupReply:
    """The lab's data about a module, with the settings file of this computer instead of its ``config``.
    Raises SpecError, and BadInput for a secret without an address to which it may be sent."""
    if not path.is_file():
        return reply
    # Few computers have such a file: other nodes need not load this code.
    from labos.spec.onsite import ADDRESSES, is_secret
    from labos.spec.source import make_plain, read

    source = read(path)
    own: Any = make_plain(source.data.get(module, {}))
    if not isinstance(own, Mapping):
        raise source.error(
            f"{module} is not a table.", (module,), remedy="Write `key: value` lines below it."
        )
    secrets = [key for key in own if is_secret(key)]
    addressed = [key for key in ADDRESSES if key in own]
    if secrets and not addressed:
        raise BadInput(
            f"{path} gives {module} a secret ({', '.join(secrets)}), but not the address to which it "
            "may be sent.",
            remedy=f"Add the device's address there too: one of {', '.join(ADDRESSES)}.",
        )
    # Only the address beside a secret is used.
    kept = {key: value for key, value in reply.config.items() if not (addressed and key in ADDRESSES)}
    return msgspec.structs.replace(reply, config={**kept, **own})
