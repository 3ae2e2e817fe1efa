"""What the manifest says of the clocks of other computers: for each one, over all runs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["note_clock"]


def note_clock(manifest: dict[str, Any], facts: Mapping[str, Any]) -> None:
    """Bring the manifest's `clocks` up to date with how a computer's clock stood to ours before and after one run.

    The manifest sums up, so that it does not grow with the number of runs; the journal keeps each run's facts.

    Args:
        manifest: what is changed.
        facts: as a run reports them: `host`; `before` and `after`, each with `wall_offset` and `round_trip` in s;
            `uncertainty` in s; `drift` in parts of one.

    Example:
        >>> manifest = {}
        >>> before = {"wall_offset": 1.5, "round_trip": 0.002}
        >>> note_clock(manifest, {"host": "pi", "before": before, "after": None, "uncertainty": 0.001, "drift": None})
        >>> manifest["clocks"]["pi"]["runs"], manifest["clocks"]["pi"]["largest_offset_s"]
        (1, 1.5)
    """
    offsets = [each for each in (facts["before"], facts["after"]) if each is not None]
    ahead = [each["wall_offset"] for each in offsets]
    known = manifest.setdefault("clocks", {}).get(facts["host"])
    so_far = known or {
        "runs": 0,
        "first_offset_s": ahead[0],
        "smallest_offset_s": ahead[0],
        "largest_offset_s": ahead[0],
        "largest_round_trip_s": 0.0,
        "largest_uncertainty_s": 0.0,
        "last_drift": None,
    }
    manifest["clocks"][facts["host"]] = so_far | {
        "runs": so_far["runs"] + 1,
        "smallest_offset_s": min(so_far["smallest_offset_s"], *ahead),
        "largest_offset_s": max(so_far["largest_offset_s"], *ahead),
        "last_offset_s": ahead[-1],
        "largest_round_trip_s": max(so_far["largest_round_trip_s"], *(each["round_trip"] for each in offsets)),
        "largest_uncertainty_s": max(so_far["largest_uncertainty_s"], facts["uncertainty"]),
        "last_drift": so_far["last_drift"] if facts["drift"] is None else facts["drift"],
    }
