"""Link procedures with repeats, master against slave on the bit-exact line at 19200, whole and damaged."""

from __future__ import annotations

import pytest
from line_faults import Faults
from transfer_world import TransferWorld

PLACES = {"R1": 1024, "R1501": 40, "I1": 256, "Q17": 64}
ROLES = [("master", "slave"), ("peer", "peer")]


@pytest.mark.parametrize("roles", ROLES)
def test_a_thousand_transfers_up_to_2_kb(roles: tuple[str, str]) -> None:
    there = TransferWorld("ccm", *roles, client_own=1, server_own=5, station=5)
    there.mixed(1000, PLACES, longest=1024)
    assert there.wrong == []
    assert there.outcomes == {"ok": 1000}


@pytest.mark.parametrize("roles", ROLES)
def test_most_blocks_are_hit_and_most_transfers_succeed(roles: tuple[str, str]) -> None:
    """A whole block has 2,849 bits, so with one wrong bit in 3,000 more than half of them are refused at first."""
    faults = Faults(bit_errors=1 / 3000, seed=5)
    counts = {"data_count": 30, "header_count": 30}
    there = TransferWorld("ccm", *roles, client_own=1, server_own=5, station=5, faults=faults, params=counts)
    there.mixed(1000, PLACES, longest=1024)
    assert there.wrong == []
    assert there.outcomes.total() == 1000
    assert there.outcomes["ok"] > 900
    refused = there.engine.scope.get("block_retries") + there.engine.scope.get("header_retries")
    assert refused > 1000, "on the whole every transfer needed a repeat"
