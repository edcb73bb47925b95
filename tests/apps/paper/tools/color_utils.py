"""The payload of the mixing workflow."""

from __future__ import annotations

from typing import Any

WELLS = [f"{row}{column}" for row in "ABCDEFGH" for column in range(1, 13)]


def convert_volumes_to_payload(
    volumes: list[tuple[float, float, float]], wells_used: list[str]
) -> tuple[dict[str, Any], list[str]]:
    """The payload for mixtures in the next free wells, and all wells that are used then."""
    wells = WELLS[len(wells_used) :][: len(volumes)]
    payload = {
        **{f"color_{name}_volumes": [volume[i] for volume in volumes] for i, name in enumerate("ABC")},
        "destination_wells": wells,
        "use_existing_resources": bool(wells_used),
    }
    return payload, wells_used + wells
