"""What the contract of links needs to try links everywhere: interruptions at each point."""

from __future__ import annotations

from robot_runner.testing.link_contract import interruptions


class Held:
    """Its end is code in Python, in which exceptions are dropped."""

    def __del__(self) -> None:
        len("held")


def test_an_interruption_that_python_drops_is_one_of_many() -> None:
    def act() -> None:
        begun.append(1)
        held = Held()
        del held
        ended.append(1)

    begun: list[int] = []
    ended: list[int] = []
    moments = list(interruptions(act))
    assert len(moments) == len(begun) + 1  # the first one comes before the act's first line
    assert len(ended) >= 3  # the two that were dropped, and the whole
    assert len(begun) > len(ended)
