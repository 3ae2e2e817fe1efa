"""Files such as the kernel of Linux shows them, in a folder of a test."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path


def write(path: Path, content: object) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"{content}\n", encoding="ascii")
    return path


class FakePowercap:
    """Energy counters of a processor with one package, its cores and its memory, as Intel's driver lays them out."""

    def __init__(self, root: Path, *, package=0, core=0, dram=0, wraps_at=262_143_328_850) -> None:
        self.root = root
        self.wraps_at = wraps_at
        self.counts = {"intel-rapl:0": package, "intel-rapl:0:0": core, "intel-rapl:0:1": dram}
        for folder, name in zip(self.counts, ("package-0", "core", "dram"), strict=True):
            write(root / folder / "name", name)
            write(root / folder / "max_energy_range_uj", wraps_at)
            self._show(folder)
        # The same package once more, as another driver shows it: to be counted once.
        write(root / "intel-rapl-mmio:0" / "name", "package-0")
        write(root / "intel-rapl-mmio:0" / "energy_uj", package)
        write(root / "intel-rapl-mmio:0" / "max_energy_range_uj", wraps_at)

    def draw(self, *, package=0.0, core=0.0, dram=0.0) -> None:
        """Count so many joules more."""
        for folder, joules in zip(self.counts, (package, core, dram), strict=True):
            self.counts[folder] = (self.counts[folder] + round(joules * 1e6)) % self.wraps_at
            self._show(folder)

    def _show(self, folder: str) -> None:
        write(self.root / folder / "energy_uj", self.counts[folder])
