"""Images of the heads of one housing: each head once, whatever the images are called."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from horizonval.commands.estimate import observation_from_heads
from horizonval.commands.picture import GreyImage
from horizonval.core.errors import UserError
from horizonval.estimation import registry


def picture(head: str) -> GreyImage:
    truth = SimpleNamespace(
        head=head, camera={}, r_itrs=(7e6, 0.0, 0.0), epoch_utc="", roll_rad=0.0, pitch_rad=0.0, yaw_rad=0.0
    )
    source: Any = SimpleNamespace(truth=truth)
    return GreyImage(np.zeros((4, 4)), None, source)


@pytest.mark.parametrize("names", [("a.exr", "b.exr"), ("a.exr", "a.exr")])
def test_a_second_image_of_a_head_is_refused(names):
    method = registry.get("video-vertical")
    with pytest.raises(UserError, match="a second image of the head 'left'") as caught:
        observation_from_heads([(name, picture("left")) for name in names], method)
    assert caught.value.where == names[1]
