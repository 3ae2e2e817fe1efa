"""Errors of Robot Runner, and the findings that they carry."""

import pytest

from robot_runner.core.errors import DesignError, Finding, LinkError


def test_the_findings_of_a_call_that_is_refused_are_returned_and_other_errors_are_raised():
    findings = [Finding.error("factors", f"there is {word}", "Correct it.") for word in ("one", "another")]

    assert DesignError.raised_by(DesignError.refuse, findings) == tuple(findings)
    assert DesignError.raised_by(DesignError.refuse, findings=()) == ()
    with pytest.raises(LinkError, match="there is one"):
        DesignError.raised_by(LinkError.refuse, findings)
