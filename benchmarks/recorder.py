"""Whether the recorder of topics keeps up with 5 MB/s of images, published by another process over DDS on loopback."""

from __future__ import annotations

import multiprocessing
import os
import resource
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks.table import Row, print_table

if TYPE_CHECKING:
    from multiprocessing.synchronize import Event

_DOMAIN = 62
_LOOPBACK = (
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo' multicast='true'/></Interfaces></General>"
    "</Domain></CycloneDDS>"
)
_TOPIC, _IMAGE = "/image", "sensor_msgs/Image"
_RATE, _BYTES, _SECONDS = 110.0, 50_000, 10.0
_COUNT = round(_RATE * _SECONDS)
_DEADLINE = 60.0


def main() -> None:
    """Record images for ten seconds into an MCAP file, and count what is in it."""
    os.environ["CYCLONEDDS_URI"] = _LOOPBACK
    with tempfile.TemporaryDirectory() as folder:
        begun = resource.getrusage(resource.RUSAGE_SELF)
        recorded, size, seconds = _recorded(Path(folder))
        ended = resource.getrusage(resource.RUSAGE_SELF)
    cpu = ended.ru_utime + ended.ru_stime - begun.ru_utime - begun.ru_stime
    rows = [
        Row("throughput", f"{size / seconds / 1e6:.2f} MB/s", bound="5 MB/s"),
        Row(f"lost of {_COUNT} images of {_BYTES // 1000} kB", str(_COUNT - recorded), bound="0"),
        Row("CPU time of the recording process", f"{100 * cpu / seconds:.0f} % of a core"),
    ]
    print_table("Recorder: dds to MCAP", rows)


def _recorded(folder: Path) -> tuple[int, int, float]:
    from robot_runner.ros.bag_file import LinkRecorder, messages_in  # noqa: PLC0415  # heavy
    from robot_runner.ros.topic_statistics import TypedTopic  # noqa: PLC0415

    context = multiprocessing.get_context("spawn")
    is_ready, is_recording = context.Event(), context.Event()
    speaker = context.Process(target=_speak, args=(is_ready, is_recording))
    speaker.start()
    link = _link()
    try:
        recorder = LinkRecorder(link, [TypedTopic(_TOPIC, _TOPIC, _IMAGE)], folder)
        if not is_ready.wait(_DEADLINE):
            raise TimeoutError("the speaker did not begin")
        recorder.begin()
        begun = time.monotonic()
        is_recording.set()
        speaker.join(_DEADLINE)
        seconds = time.monotonic() - begun - 1.0  # the speaker's last words
        recorder.close()
    finally:
        link.close()
        speaker.kill()
    return messages_in(folder) or 0, recorder.path.stat().st_size, seconds


def _speak(is_ready: Event, is_recording: Event) -> None:
    link = _link()
    image = {"width": 250, "height": 200, "step": 250, "encoding": "mono8", "data": os.urandom(_BYTES)}
    link.publish(_TOPIC, _IMAGE, image)
    is_ready.set()
    is_recording.wait(_DEADLINE)
    begun = time.monotonic()
    for number in range(_COUNT):
        time.sleep(max(0.0, begun + number / _RATE - time.monotonic()))
        link.publish(_TOPIC, _IMAGE, image)
    time.sleep(1.0)
    link.close()


def _link() -> Any:
    from robot_runner.core.events.context import SystemClock  # noqa: PLC0415  # a link is opened in the process that uses it
    from robot_runner.ros.link_opening import open_dds_link  # noqa: PLC0415

    return open_dds_link({"domain": str(_DOMAIN), "distro": "jazzy"}, SystemClock())


if __name__ == "__main__":
    main()
