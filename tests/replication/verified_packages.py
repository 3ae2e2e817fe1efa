"""What `verify` says of a package, for tests."""

from __future__ import annotations

import pytest

from robot_runner.core.errors import PackageError
from robot_runner.replication.opening import open_package
from robot_runner.replication.verification import refuse_faults, verify_package


def verified(path):
    """Return the verification of a package without faults."""
    with open_package(path) as package:
        verification = verify_package(package)
    refuse_faults(verification)
    return verification


def refusal_of(path):
    """Return the error by which a package is refused."""
    with pytest.raises(PackageError) as refused:
        verified(path)
    return refused.value
