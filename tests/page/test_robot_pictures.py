"""A process that renders is started in the way that works here, and again once it has crashed."""

from __future__ import annotations

import pytest

from robot_runner.core.errors import ExecutionError
from robot_runner.page import robot_pictures
from robot_runner.page.robot_pictures import RobotPictures

HERE, THERE = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0)


class _Renderer:
    """A process that renders in some ways, and so often before it crashes."""

    stdin = stdout = None

    def __init__(self, way: str, *, works: bool, pictures: int) -> None:
        self.way, self.works, self.pictures = way, works, pictures

    def kill(self) -> None: ...

    def wait(self) -> None: ...


@pytest.fixture
def pictures(monkeypatch):
    """Return pictures by a renderer that has no EGL and crashes after two, the ways it was started, those that work."""
    made, started = RobotPictures("simulated"), []

    def start(way):
        started.append(way)
        return _Renderer(way, works=way in works, pictures=2)

    def asked(process, pose, patience):
        process.pictures -= 1
        if not process.works or process.pictures < 0:
            raise ValueError(f"{process.way} does not render")
        return process.way.encode()

    works = {"osmesa"}
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(made, "_started", start)
    monkeypatch.setattr(robot_pictures, "_asked", asked)
    monkeypatch.setattr(robot_pictures, "_EVERY", 0.0)
    return made, started, works


def test_the_second_way_to_render_serves_more_than_one_picture(pictures):
    made, started, _ = pictures
    assert [made.picture(pose) for pose in (HERE, THERE)] == [b"osmesa"] * 2
    assert started == ["egl", "osmesa"]


def test_a_picture_is_never_that_of_another_place_however_soon_it_is_asked_for(pictures, monkeypatch):
    made, *_ = pictures
    monkeypatch.setattr(robot_pictures, "_EVERY", 60.0)
    monkeypatch.setattr(robot_pictures, "_asked", lambda _process, pose, _patience: str(pose).encode())
    assert [made.picture(pose) for pose in (HERE, THERE)] == [str(HERE).encode(), str(THERE).encode()]
    assert made.wait_s(THERE) == 0.0
    assert 0.0 < made.wait_s(HERE) <= 60.0


def test_a_renderer_that_crashed_is_started_again(pictures):
    made, started, _ = pictures
    assert [made.picture(pose) for pose in (HERE, THERE, HERE)] == [b"osmesa"] * 3
    assert started == ["egl", "osmesa"] * 2


@pytest.mark.long
def test_where_no_way_works_that_is_said_and_not_tried_again(pictures):
    made, started, works = pictures
    works.clear()
    for _ in range(2):
        with pytest.raises(ExecutionError, match="osmesa does not render"):
            made.picture(HERE)
    assert started == ["egl", "osmesa"]
