"""Execute five example studies and write their reports: `make_gallery.py folder [--pictures docs/images/gallery]`.

A study whose report is there is not executed again. Pictures are taken by a headless Chromium (Debian: chromium),
and kept small, as they are part of the repository.
"""

from __future__ import annotations

import argparse
import io
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from PIL import Image

_EXAMPLES = Path(__file__).parents[1] / "examples"
#: The studies, with the part of the report that is pictured.
STUDIES = {
    "basic_experiment": "figures",
    "speed_and_energy": "in-brief",
    "two_rooms": "outcome-of-each-run",
    "offloading": "threats-to-validity",
    "sorting_algorithms": "descriptive-statistics",
}
#: What an operator would type in for the study that asks one.
_ANSWERS = {"offloading": "Light=300"}
_DEADLINE = 300.0  # seconds for one study
#: The part of a report that is shown: as wide as a page of the documentation shows it twice, and one screen high.
_WIDTH, _HEIGHT = 1100, 900
_COLOURS = 64
_BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


def main() -> int:
    """Make the reports, and pictures of them where they are asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="where the reports are written, each as <study>.html")
    parser.add_argument("--pictures", type=Path, metavar="FOLDER", help="where pictures of them are written")
    chosen = parser.parse_args()
    chosen.folder.mkdir(parents=True, exist_ok=True)
    for study, part in STUDIES.items():
        page = chosen.folder / f"{study}.html"
        if not page.exists():
            make_report(study, page)
        if chosen.pictures is not None:
            chosen.pictures.mkdir(parents=True, exist_ok=True)
            take_picture(page, part, chosen.pictures / f"{study}.png")
    return 0


def make_report(study: str, page: Path) -> None:
    """Execute a study in a folder of its own, and write its report."""
    with tempfile.TemporaryDirectory() as folder:
        where = f"results_output_path={folder}"
        command = [_program(), "run", str(_EXAMPLES / f"{study}.py"), "--plain", "--set", where]
        with tempfile.TemporaryFile() as said:
            running = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=said, stderr=said, cwd=folder)
            _accompany(running, study, Path(folder) / study)
            if running.wait() != 0:
                said.seek(0)
                sys.exit(said.read().decode(errors="replace"))
        report = [_program(), "report", str(Path(folder) / study), "--figures", "none"]
        subprocess.run(report, check=True, stdout=subprocess.DEVNULL, timeout=_DEADLINE)
        shutil.copy(Path(folder) / study / "report" / "report.html", page)


def _accompany(running: subprocess.Popen[bytes], study: str, experiment: Path) -> None:
    """Wait until a study has ended, and answer its steps as its operator would."""
    end = time.monotonic() + _DEADLINE
    while running.poll() is None:
        if time.monotonic() > end:
            running.terminate()
            running.wait()
            sys.exit(f"{study} was not done after {_DEADLINE:.0f} s")
        if answer := _ANSWERS.get(study):
            go_on = [_program(), "continue", str(experiment), "--answer", answer]
            subprocess.run(go_on, check=False, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        time.sleep(0.3)


def take_picture(page: Path, part: str, picture: Path) -> None:
    """Picture one part of a report, in few colours."""
    browser = next(filter(None, map(shutil.which, _BROWSERS)), None)
    if browser is None:
        sys.exit("No Chromium is installed, which takes the pictures (Debian: apt install chromium).")
    with tempfile.TemporaryDirectory() as folder:
        # A copy that begins with the part.
        still = Path(folder) / "still.html"
        alone = f"<style>section[id]:not(#{part}):not(:has(#{part})) {{ display: none }}</style></head>"
        still.write_text(page.read_text(encoding="utf-8").replace("</head>", alone, 1), encoding="utf-8")
        shot = Path(folder) / "shot.png"
        options = [
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--hide-scrollbars",
            f"--user-data-dir={folder}/profile",
        ]
        size = f"--window-size={_WIDTH},{_HEIGHT}"
        command = [
            browser,
            *options,
            f"--user-data-dir={folder}/profile",
            size,
            f"--screenshot={shot}",
            still.as_uri(),
        ]
        subprocess.run(command, check=True, capture_output=True, timeout=60)
        image = Image.open(io.BytesIO(shot.read_bytes())).convert("RGB")
    image.quantize(_COLOURS, dither=Image.Dither.NONE).save(picture, optimize=True)


def _program() -> str:
    return str(Path(sys.executable).with_name("robot-runner"))


if __name__ == "__main__":
    sys.exit(main())
