"""What constants of the tasks are said to be, by other means."""

from __future__ import annotations

import pytest

from visuohaptic.tasks import fetch


def test_one_of_twenty_decisions_to_bring_a_container_may_be_wrong() -> None:
    assert pytest.approx(1.0) == 20 * (1.0 - fetch.DECIDED)
