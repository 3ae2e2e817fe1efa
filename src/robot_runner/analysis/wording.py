"""Numbers in sentences."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["counted", "in_figures", "listed", "p_in_words"]

_SMALLEST_P = 0.001


def counted(count: int, noun: str) -> str:
    """Return how many there are.

    Example:
        >>> counted(1, "run"), counted(1500, "run")
        ('1 run', '1,500 runs')
    """
    return f"{count:,} {noun}{'' if count == 1 else 's'}"


def listed(words: Sequence[str]) -> str:
    """Return words as an enumeration, as in `a, b and c`."""
    return " and ".join(filter(None, [", ".join(words[:-1]), words[-1] if words else ""]))


def p_in_words(p_value: float) -> str:
    """Return a p-value as a paper prints it.

    Example:
        >>> p_in_words(0.0159), p_in_words(2e-16)
        ('p = 0.016', 'p < 0.001')
    """
    return f"p < {_SMALLEST_P}" if p_value < _SMALLEST_P else f"p = {p_value:.3f}"


def in_figures(value: float) -> str:
    """Return a number with four significant figures, without an exponent where it can be avoided.

    Example:
        >>> in_figures(867.0963), in_figures(0.0123456), in_figures(1086351234.5)
        ('867.1', '0.01235', '1,086,000,000')
    """
    text = f"{value:.4g}"
    if "e+" in text:
        return f"{float(text):,.0f}"
    return text
