"""Names that an action cannot have."""

from __future__ import annotations

import pytest

from labos.node import Node, action


def test_an_action_that_hides_what_every_node_has_is_refused_at_once() -> None:
    with pytest.raises(TypeError, match=r"cannot be called 'rest'.*aliases=\(\"rest\",\)"):

        class Shaker(Node):
            @action()
            async def rest(self) -> None:
                """Stand still."""


def test_the_reset_of_every_node_is_an_action_and_may_be_another() -> None:
    class Shaker(Node):
        @action(recovers=True)
        async def reset(self) -> None:
            """Bring the plate to the middle."""

    assert [spec.description for spec in Shaker.describe().actions] == ["Bring the plate to the middle."]
