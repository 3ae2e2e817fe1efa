"""What callables take and classes name is known without what their annotations name."""

from __future__ import annotations

import inspect
import sys

import pytest

from robot_runner.core.late_annotations import names_in, signature_of

LATE = """
def start_run(context: Context, speed: Speed = 0.2) -> None: ...
class Robot:
    speed: Speed
    def __init__(self, name: Name) -> None: ...
"""


def test_names_are_those_of_the_class_itself_with_and_without_values() -> None:
    class Robot:
        speed: float
        name: str = "burger"

    class Faster(Robot):
        gear: int

    assert {"speed", "name"} <= names_in(Robot)
    assert names_in(Faster) & {"speed", "name", "gear"} == {"gear"}


@pytest.mark.parametrize("called", [3, None])
def test_what_cannot_be_called_has_no_signature(called: object) -> None:
    with pytest.raises(TypeError):
        signature_of(called)  # type: ignore[arg-type]


@pytest.mark.skipif(sys.version_info < (3, 14), reason="Python before 3.14 evaluates annotations at once")
def test_annotations_may_name_what_nobody_has_imported() -> None:
    made: dict = {}
    exec(compile(LATE, "late", "exec", dont_inherit=True), made)  # noqa: S102 - it cannot be written here
    with pytest.raises(NameError):
        inspect.signature(made["start_run"])
    assert list(signature_of(made["start_run"]).parameters) == ["context", "speed"]
    assert list(signature_of(made["Robot"]).parameters) == ["name"]
    assert "speed" in names_in(made["Robot"])
