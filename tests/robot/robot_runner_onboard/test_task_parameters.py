"""What a person may get wrong in the parameters of the tasks' node is answered by the service that needs it."""

from __future__ import annotations

import pytest
from robot_runner_onboard.errors import TaskError
from robot_runner_onboard.parameters import PARAMETERS, task_commands


def command(task: str, **given: object) -> list[str]:
    values = {**PARAMETERS, **{name.replace("_", "/", 1): value for name, value in given.items()}}
    return task_commands(values, ["record-topic"])[task]()


def test_the_default_picture_has_five_megapixels() -> None:
    assert round(PARAMETERS["video/width"] * PARAMETERS["video/height"] / 1e6) == 5


def test_a_topic_is_recorded_by_the_worker_that_speaks_ros() -> None:
    words = command("video", video_source="topic", video_topic="/camera", video_file="video.avi")
    assert words == ["record-topic", "--topic", "/camera", "--rate", "15.0", "--file", "video.avi"]


@pytest.mark.parametrize(
    ("task", "given", "problem"),
    [
        ("network", {}, "network/address is ''"),
        ("network", {"network_address": "file:///etc/passwd"}, "http:// or https://"),
        ("network", {"network_address": "http://x/", "network_rate": -1.0}, "network/rate is -1.0"),
        ("video", {"video_source": "webcam"}, "set it to camera, topic or synthetic"),
        ("video", {"video_rate": 0.0}, "video/rate is 0.0: set it to a number above 0"),
        ("video", {"video_width": "wide"}, "video/width is 'wide'"),
        ("video", {"video_height": True}, "video/height is True"),
    ],
)
def test_a_value_that_cannot_be_is_named_with_its_remedy(task: str, given: dict[str, object], problem: str) -> None:
    with pytest.raises(TaskError, match=problem):
        command(task, **given)
