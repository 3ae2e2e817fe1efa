"""Texts as LaTeX prints them, with no package beyond LaTeX itself."""

from __future__ import annotations

from collections.abc import Iterator
from unicodedata import normalize

from robot_runner.analysis.figures.style import verbatim

_TEXT = {
    "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "$": r"\$", "&": r"\&", "#": r"\#", "_": r"\_", "%": r"\%",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": r"\textless{}", ">": r"\textgreater{}",
    "|": r"\textbar{}", '"': r"\char34{}", "`": r"\textasciigrave{}", "\N{EN DASH}": "--", "°": r"\textdegree{}",
    "…": r"\ldots{}", "℉": r"\textdegree{}F", "\N{MINUS SIGN}": "$-$", "\N{ASTERISK OPERATOR}": "$*$",
    "\N{DIVISION SLASH}": "/",
    "\N{PRIME}": r"$^{\prime}$", "\N{DOUBLE PRIME}": r"$^{\prime\prime}$",
}  # fmt: skip
#: Signs of mathematics, each with its command.
_MATHEMATICS = (
    "\N{MULTIPLICATION SIGN}times ±pm ∓mp ·cdot ⋅cdot ≤leq ≥geq ≪ll ≫gg ≈approx ≠neq ≡equiv ≃simeq ≅cong "
    "\N{TILDE OPERATOR}sim ∝propto ∞infty √surd ∂partial ∇nabla ∆Delta ∑sum ∏prod ∫int ∈in ∉notin ∋ni "
    "∅emptyset ∀forall ∃exists ∧wedge \N{LOGICAL OR}vee ∩cap \N{UNION}cup ⊂subset ⊃supset ⊆subseteq ⊇supseteq "
    "⇐Leftarrow ⇒Rightarrow ⇔Leftrightarrow ↔leftrightarrow ∘circ ∠angle ∥parallel ⊥perp ⌈lceil ⌉rceil "
    "⌊lfloor ⌋rfloor ★star \N{SCRIPT SMALL L}ell ℏhbar ϵepsilon ϑvartheta ϕphi ϖvarpi "
    "\N{GREEK RHO SYMBOL}varrho"
)
_SUPERSCRIPTS = dict(zip("⁰¹²³⁴⁵⁶⁷⁸⁹⁺⁼⁽⁾ⁿⁱ", "0123456789+=()ni", strict=True))
_SUBSCRIPTS = dict(zip("₀₁₂₃₄₅₆₇₈₉₊₌₍₎ₐₑₒₓₙᵢ", "0123456789+=()aeoxni", strict=True))
#: From alpha on: LaTeX has no command for letters that look like Latin ones.
_GREEK = (
    (0x391, "A B Gamma Delta E Z H Theta I K Lambda M N Xi O Pi P"),
    (0x3A3, "Sigma T Upsilon Phi X Psi Omega"),
    (0x3B1, "alpha beta gamma delta varepsilon zeta eta theta iota kappa lambda mu nu xi o pi rho"),
    (0x3C2, "varsigma sigma tau upsilon varphi chi psi omega"),
)
#: Accents of Greek letters, over Latin letters and in mathematics.
_ACCENTS = {"\N{COMBINING ACUTE ACCENT}": (r"\'", r"\acute"), "\N{COMBINING DIAERESIS}": (r"\"", r"\ddot")}


def _signs() -> Iterator[tuple[str, str]]:
    yield from _TEXT.items()
    yield from ((sign[0], f"$\\{sign[1:]}$") for sign in _MATHEMATICS.split())
    yield from ((sign, rf"\textsuperscript{{{plain}}}") for sign, plain in _SUPERSCRIPTS.items())
    yield from ((sign, rf"\textsubscript{{{plain}}}") for sign, plain in _SUBSCRIPTS.items())
    yield from (("⁻", r"\textsuperscript{$-$}"), ("₋", r"\textsubscript{$-$}"))
    greek = {
        chr(code): f"\\{name}" if len(name) > 1 else name
        for first, names in _GREEK
        for code, name in enumerate(names.split(), first)
    }
    for code in range(0x386, 0x3CF):
        letter, *accents = list(normalize("NFD", chr(code)))
        if letter in greek and all(accent in _ACCENTS for accent in accents):
            written, is_latin = greek[letter], len(greek[letter]) == 1
            for accent in accents:
                written = f"{_ACCENTS[accent][not is_latin]}{{{written}}}"
            yield chr(code), written if is_latin else f"${written}$"


_LATEX = dict(_signs())


def latex_text(text: str) -> str:
    r"""Return a text that LaTeX prints as it is.

    Example:
        >>> latex_text("50% of $x_1$ \\input{a}")
        '50\\% of \\$x\\_1\\$ \\textbackslash{}input\\{a\\}'
        >>> latex_text("--fast"), latex_text("[0, 1]")  # neither a dash nor the argument of the line that ends before
        ('-{}-fast', '{}[0, 1]')
    """
    line = normalize("NFC", verbatim(text))  # a letter and its accents are one sign, an ohm sign is an omega
    signs = (
        _LATEX.get(sign, sign) + "{}" * (sign == after and sign in "-',")
        for sign, after in zip(line, f"{line[1:]} ", strict=False)
    )
    return "{}" * line.startswith(("[", "*")) + "".join(signs)
