"""The video task writes what a camera sees to a file that others can read, and says what keeps it from that."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import pytest
from robot_runner_onboard.cameras import DeviceCamera, SyntheticCamera, opened_camera
from robot_runner_onboard.errors import TaskError
from robot_runner_onboard.topic_video import TopicVideo, record_topic
from robot_runner_onboard.video import record
from robot_runner_onboard.video_files import FrameFile

if TYPE_CHECKING:
    from pathlib import Path

cv2 = pytest.importorskip("cv2")
np = pytest.importorskip("numpy")


class Orders:
    """A channel whose node has the task end when it has looked so many times."""

    def __init__(self, looks: int) -> None:
        self.looks = looks
        self.is_ready = False

    def ready(self) -> None:
        self.is_ready = True

    def is_over(self) -> bool:
        self.looks -= 1
        return self.looks < 0


def frames_of(path: Path) -> list[tuple[int, ...]]:
    video, shapes = cv2.VideoCapture(str(path)), []
    while (read := video.read())[0]:
        shapes.append(read[1].shape)
    return shapes


@pytest.mark.long
def test_five_megapixels_are_recorded_frame_by_frame(tmp_path: Path) -> None:
    path, orders = tmp_path / "new" / "video.avi", Orders(3)
    said = record(
        orders,
        lambda: SyntheticCamera(2592, 1944, 100.0),
        lambda: FrameFile(str(path), 2592, 1944, 15.0),
    )
    assert orders.is_ready
    assert said.startswith("4 frames, 2592x1944, ")
    assert said.endswith(f" MB in {path}")
    assert frames_of(path) == [(1944, 2592, 3)] * 4


def test_the_synthetic_camera_moves_and_keeps_its_rate() -> None:
    camera = SyntheticCamera(64, 48, 50.0)
    first, second = camera.frame(), camera.frame()
    assert first.shape == (48, 64, 3)
    assert (first != second).any()
    assert camera._count / camera._rate == pytest.approx(0.04)


def test_a_camera_is_opened_by_file_and_delivers_its_frames(tmp_path: Path) -> None:
    path = tmp_path / "seen.avi"
    record(Orders(4), lambda: SyntheticCamera(64, 48, 500.0), lambda: FrameFile(str(path), 64, 48, 15.0))
    camera = opened_camera("camera", str(path), 64, 48, 15.0)
    assert camera.frame().shape == (48, 64, 3)
    camera.close()


def test_a_camera_of_another_size_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "small.avi"
    record(Orders(1), lambda: SyntheticCamera(64, 48, 500.0), lambda: FrameFile(str(path), 64, 48, 15.0))
    with pytest.raises(TaskError, match="takes 64x48 instead of 2592x1944: set video/width and video/height"):
        DeviceCamera(str(path), 2592, 1944, 15.0)


def test_a_camera_that_falls_silent_ends_the_task(tmp_path: Path) -> None:
    path = tmp_path / "short.avi"
    record(Orders(2), lambda: SyntheticCamera(64, 48, 500.0), lambda: FrameFile(str(path), 64, 48, 15.0))
    with pytest.raises(TaskError, match="delivers no frame"):
        record(
            Orders(100),
            lambda: DeviceCamera(str(path), 64, 48, 15.0),
            lambda: FrameFile(str(tmp_path / "copy.avi"), 64, 48, 15.0),
        )


def test_a_camera_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(TaskError, match=r"there is no camera .*: set video/device to its number or file"):
        DeviceCamera(str(tmp_path / "none.avi"), 64, 48, 15.0)


def test_a_file_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("a file, not a folder")
    with pytest.raises(TaskError, match=r"cannot be written .*: set video/file"):
        FrameFile(str(tmp_path / "taken" / "video.avi"), 64, 48, 15.0)


def test_a_missing_opencv_is_named_with_its_package(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(TaskError, match="sudo apt install python3-opencv"):
        FrameFile(str(tmp_path / "video.avi"), 64, 48, 15.0)


def test_jpeg_pictures_of_a_topic_are_kept_as_they_are(tmp_path: Path) -> None:
    picture = cv2.imencode(".jpg", np.full((48, 64, 3), 128, dtype=np.uint8))[1].tobytes()
    video = TopicVideo(str(tmp_path / "video.avi"), 15.0)
    for _ in range(3):
        video.take_jpeg("bgr8; jpeg compressed bgr8", picture)
    said = record_topic(Orders(2), video, "/camera")
    assert said.startswith("3 frames, JPEG, ")
    assert (tmp_path / "video.mjpeg").read_bytes() == picture * 3
    assert frames_of(tmp_path / "video.mjpeg") == [(48, 64, 3)] * 3


@pytest.mark.parametrize(("encoding", "channels"), [("rgb8", 3), ("bgr8", 3), ("mono8", 1)])
def test_plain_pictures_of_a_topic_are_encoded_with_their_padding_left_out(
    tmp_path: Path, encoding: str, channels: int
) -> None:
    step = 64 * channels + 8
    rows = np.full((48, step), 255, dtype=np.uint8)
    rows[:, : 64 * channels] = 60
    video = TopicVideo(str(tmp_path / "video.avi"), 15.0)
    video.take_image(encoding, (64, 48), step, rows.tobytes())
    record_topic(Orders(0), video, "/camera")
    frame = cv2.VideoCapture(str(tmp_path / "video.avi")).read()[1]
    assert frame.shape == (48, 64, 3)
    assert abs(frame.astype(int) - 60).max() < 8


def test_red_stays_red(tmp_path: Path) -> None:
    red = np.zeros((48, 64, 3), dtype=np.uint8)
    red[:, :, 0] = 200
    video = TopicVideo(str(tmp_path / "video.avi"), 15.0)
    video.take_image("rgb8", (64, 48), 64 * 3, red.tobytes())
    record_topic(Orders(0), video, "/camera")
    blue, green, seen_red = cv2.VideoCapture(str(tmp_path / "video.avi")).read()[1][24, 32]
    assert seen_red > 180
    assert max(blue, green) < 20


def test_pictures_that_cannot_be_written_are_named_by_their_kind(tmp_path: Path) -> None:
    video = TopicVideo(str(tmp_path / "video.avi"), 15.0)
    video.take_image("yuv422", (64, 48), 128, bytes(64 * 48 * 2))
    with pytest.raises(TaskError, match="encoded as 'yuv422', not as one of bgr8, mono8, rgb8"):
        record_topic(Orders(0), video, "/camera")
    video.take_jpeg("png", b"")
    with pytest.raises(TaskError, match="the topic's pictures are 'png', not JPEG"):
        record_topic(Orders(0), video, "/camera")


def test_what_the_disk_is_too_slow_for_is_counted(tmp_path: Path) -> None:
    video = TopicVideo(str(tmp_path / "video.avi"), 15.0)
    for _ in range(103):
        video.take_jpeg("jpeg", b"picture")
    said = record_topic(Orders(99), video, "/camera")
    assert said.endswith("3 more were lost: this computer is too slow")


def test_what_waits_at_the_end_is_written_or_counted(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def said(looks: int) -> str:
        video = TopicVideo(str(tmp_path / "video.avi"), 15.0)
        for _ in range(5):
            video.take_jpeg("jpeg", b"picture")
        return record_topic(Orders(looks), video, "/camera")

    assert said(1).startswith("5 frames, JPEG, ")
    monkeypatch.setattr("robot_runner_onboard.topic_video._REST", 0.0)
    assert said(1).startswith("2 frames, JPEG, ")
    assert said(1).endswith("3 more were lost: this computer is too slow")


def test_pictures_that_change_their_size_are_not_passed_over_in_silence(tmp_path: Path) -> None:
    video = TopicVideo(str(tmp_path / "video.avi"), 15.0)
    for width, height in ((64, 48), (32, 24)):
        video.take_image("mono8", (width, height), width, bytes(width * height))
    with pytest.raises(TaskError, match="the pictures changed from 64x48 to 32x24"):
        record_topic(Orders(1), video, "/camera")


def test_a_silent_topic_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("robot_runner_onboard.topic_video._PATIENCE", 0.05)
    with pytest.raises(TaskError, match=r"no picture came on /camera within 0\.05 s: start the camera's node"):
        record_topic(Orders(5), TopicVideo(str(tmp_path / "video.avi"), 15.0), "/camera")
