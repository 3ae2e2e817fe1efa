"""The profiler of docs/frames.md keeps to the contract of profilers, and measures what it says."""

from __future__ import annotations

from pathlib import Path

import pytest

from robot_runner.testing import FakeLinks, FakeRobotLink, ProfilerContract

PAGE = Path(__file__).parents[2] / "docs" / "frames.md"


def documented():
    """Return the class that the page's first block of Python defines."""
    text = PAGE.read_text(encoding="utf-8").partition("```python\n")[2].partition("```")[0]
    names = {"__name__": "documented"}
    exec(compile(text, PAGE.name, "exec"), names)  # noqa: S102 - our own page
    return names["LocalisationError"]


class TestLocalisationError(ProfilerContract):
    def make_plugin(self):
        return documented()()

    def make_links(self, clock):
        link = FakeRobotLink(clock)

        def told(child, x):
            transform = {
                "translation": {"x": x, "y": 0.4, "z": 0.0},
                "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
            }
            header = {"stamp": {"sec": int(clock.now()), "nanosec": 0}, "frame_id": "map"}
            return {"header": header, "child_frame_id": child, "transform": transform}

        def tell():
            both = [told("base_link", 0.3 + 0.01 * clock.now()), told("base_link_true", 0.0)]
            link.deliver("/tf", {"transforms": both})

        clock.every(0.5, tell)
        return FakeLinks(robot=link)

    def test_it_says_how_far_frames_are_apart(self, tmp_path):
        found = self.execute(tmp_path, self.make_plugin())
        assert found["PoseError"] == pytest.approx(0.3075)  # told at 0.5 and at 1.0 s
        assert found["FinalPoseError"] == pytest.approx(0.31)
