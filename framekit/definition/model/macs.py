"""Codes made with a key (MACs): HMAC (RFC 2104) and AES-CMAC (RFC 4493), as check methods.

`codec/macs.py` works them out.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple


class Mac(NamedTuple):
    """A code of `size` bytes. `key_sizes`: the keys there are, any if none stands here; `is_extra`: by an extra."""

    size: int
    key_sizes: tuple[int, ...] = ()
    is_extra: bool = False


AES_KEY_SIZES = (16, 24, 32)
"""Bytes that a key of AES may have. `aes_key` of `codec/ciphers.py`, which generated modules carry, says the same."""

MACS: Mapping[str, Mac] = {
    "hmac-md5": Mac(16),
    "hmac-sha1": Mac(20),
    "hmac-sha224": Mac(28),
    "hmac-sha256": Mac(32),
    "hmac-sha384": Mac(48),
    "hmac-sha512": Mac(64),
    "cmac-aes": Mac(16, AES_KEY_SIZES, is_extra=True),
}
"""The codes by name."""
