"""PDF files are made by a second process, whose faults are told as if they were our own."""

from __future__ import annotations

import pytest

from robot_runner.analysis.figures import pdf_worker
from robot_runner.analysis.figures.distribution import draw_quantiles
from robot_runner.analysis.figures.pdf_worker import PdfWorker
from robot_runner.core.errors import AnalysisError, StorageError


@pytest.fixture
def figure():
    return draw_quantiles([-1, 0, 1], [-2, 0, 2], slope=2, intercept=0, value_label="Energy (J)")


@pytest.mark.long
def test_figures_are_written_by_the_time_it_is_left(figure, tmp_path):
    with PdfWorker() as worker:
        for name in ("a", "b"):
            worker.write(figure, tmp_path / f"{name}.pdf", tmp_path)
    assert (tmp_path / "a.pdf").read_bytes() == (tmp_path / "b.pdf").read_bytes()
    assert (tmp_path / "a.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.long
def test_modules_in_the_user_s_folder_are_not_taken_for_ours(figure, tmp_path, monkeypatch):
    (tmp_path / "statistics.py").write_text("raise RuntimeError")
    monkeypatch.chdir(tmp_path)
    with PdfWorker() as worker:
        worker.write(figure, tmp_path / "a.pdf", tmp_path)
    assert (tmp_path / "a.pdf").is_file()


@pytest.mark.long
def test_a_file_that_cannot_be_written_is_named(figure, tmp_path):
    with pytest.raises(StorageError, match="cannot be written") as caught, PdfWorker() as worker:
        worker.write(figure, tmp_path / "missing" / "a.pdf", tmp_path)
    assert "missing" in caught.value.where


def write_with(worker, figure, path):
    with worker:
        worker._process.wait(timeout=30)
        worker.write(figure, path, path.parent)


def test_a_process_that_fails_is_told_with_its_last_words(figure, tmp_path, monkeypatch):
    monkeypatch.setattr(pdf_worker, "_MODULE", "robot_runner.no_such_module")
    worker = PdfWorker()
    with pytest.raises(AnalysisError, match="no_such_module"):
        write_with(worker, figure, tmp_path / "a.pdf")


def test_it_is_ended_when_its_user_fails(figure, tmp_path):
    worker = PdfWorker()
    worker.write(figure, tmp_path / "a.pdf", tmp_path)
    worker.__exit__(ZeroDivisionError, ZeroDivisionError(), None)
    assert worker._process.poll() is not None
