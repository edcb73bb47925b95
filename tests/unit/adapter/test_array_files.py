"""Arrays of process variables as files of a result."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labos.adapter._channels import ChannelReading
from labos.adapter._signals import encode_array
from labos.errors import DeviceError
from labos.spec.signals import SignalMapping
from labos.spec.validation import find_first_flaw


def read(values: Any) -> Any:
    attachment = encode_array("series", ChannelReading(values))
    assert attachment.name == "series.npy"
    assert not isinstance(attachment.content, Path)
    return np.load(io.BytesIO(attachment.content), allow_pickle=False)


def test_numbers_come_back_as_they_were() -> None:
    counts = read([0, 7, 255])
    assert (counts.tolist(), counts.dtype) == ([0, 7, 255], np.uint8)
    assert read([-1, 300]).tolist() == [-1, 300]
    assert read([0.5, float("inf")]).tolist() == [0.5, float("inf")]
    assert np.isnan(read([float("nan")]))
    assert read(3).tolist() == [3], "an array of one value comes as that value"
    assert read([]).size == 0


@pytest.mark.parametrize("values", ["a picture", ["a", "b"], None])
def test_what_is_no_array_of_numbers_is_told(values: Any) -> None:
    with pytest.raises(DeviceError, match="series is not an array of numbers") as told:
        encode_array("series", ChannelReading(values))
    assert told.value.effects == "all", "the action itself is over"


def test_beside_files_a_result_has_names() -> None:
    action = {"start": {"pv": "Expose"}, "files": {"series": "Series"}}
    assert not find_first_flaw(
        SignalMapping, {"actions": {"expose": {**action, "result": {"frames": "Taken"}}}}
    )
    assert not find_first_flaw(SignalMapping, {"actions": {"expose": action}})
    flaw = find_first_flaw(SignalMapping, {"actions": {"expose": {**action, "result": "Taken"}}})
    assert "needs a name for each process variable" in str(flaw)
