from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.core.links.ssh_server import SshServer

if TYPE_CHECKING:
    from collections.abc import Iterator


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SshServer]:
    started = SshServer(tmp_path_factory.mktemp("sshd"))
    yield started
    started.stop()
