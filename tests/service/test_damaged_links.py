"""Link procedures with repeats, master against slave on the bit-exact line at 19200, whole and damaged."""

from __future__ import annotations

import pytest
from line_faults import Faults
from spread import TRANSFERS
from transfer_world import TransferWorld

PLACES = {"R1": 1024, "R1501": 40, "I1": 256, "Q17": 64}
ROLES = [("master", "slave"), ("peer", "peer")]


@pytest.mark.parametrize("roles", ROLES)
@pytest.mark.parametrize("count", TRANSFERS)
def test_transfers_up_to_2_kb(roles: tuple[str, str], count: int) -> None:
    world = TransferWorld("ccm", *roles, client_own=1, server_own=5, station=5)
    world.mixed(count, PLACES, longest=1024)
    assert world.wrong == []
    assert world.outcomes == {"ok": count}


@pytest.mark.parametrize("roles", ROLES)
@pytest.mark.parametrize("count", TRANSFERS)
def test_most_blocks_are_hit_and_most_transfers_succeed(roles: tuple[str, str], count: int) -> None:
    """A full block has 2,849 bits, so with one wrong bit in 3,000 more than half of the blocks are refused at first."""
    faults = Faults(bit_errors=1 / 3000, seed=5)
    counts = {"data_count": 30, "header_count": 30}
    world = TransferWorld("ccm", *roles, client_own=1, server_own=5, station=5, faults=faults, params=counts)
    world.mixed(count, PLACES, longest=1024)
    assert world.wrong == []
    assert world.outcomes.total() == count
    assert world.outcomes["ok"] > 0.9 * count
    refused = world.engine.scope.get("block_retries") + world.engine.scope.get("header_retries")
    assert refused > count, "on the whole every transfer needed a repeat"
