"""A page that cannot be served beside an execution is refused under the option that asked for it."""

from __future__ import annotations

import socket
from typing import TYPE_CHECKING

import pytest

from robot_runner.cli.executing import page_beside
from robot_runner.core.errors import ExecutionError

if TYPE_CHECKING:
    from pathlib import Path


def refusal(folder: Path, address: str | None) -> ExecutionError:
    with pytest.raises(ExecutionError) as caught, page_beside(folder, address):
        pass
    return caught.value


@pytest.mark.parametrize(
    ("address", "problem", "fix"),
    [
        ("foo:99999", "'99999' is not a port", "0 to 65,535"),
        ("foo:80", "'foo' is not an address", "127.0.0.1"),
        ("fe80::zz", "'fe80::zz' is not an address", "127.0.0.1"),
        ("", "'' is not an address", "127.0.0.1"),
    ],
)
def test_an_address_is_refused_under_the_option_that_gave_it(
    tmp_path: Path, address: str, problem: str, fix: str
) -> None:
    refused = refusal(tmp_path, address)
    assert (refused.where, refused.problem) == (f"--page-at {address}".strip(), problem)
    assert fix in refused.fix


def test_a_port_that_is_taken_is_answered_with_a_free_one_for_the_same_option(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        refused = refusal(tmp_path, f"127.0.0.1:{port}")
    assert f"port {port} is in use" in refused.problem
    assert "--page-at 127.0.0.1:0" in refused.fix
    assert "--port" not in refused.fix


def test_an_address_of_ipv6_needs_no_brackets_where_no_port_follows(tmp_path: Path) -> None:
    refused = refusal(tmp_path, "2001:db8::1")
    assert "this machine has no such address" in refused.problem
