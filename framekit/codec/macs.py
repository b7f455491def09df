"""Codes made with a key: HMAC by the standard library, AES-CMAC by the library `cryptography`, which is an extra."""

from __future__ import annotations

import hmac
from typing import Any

from framekit.codec.ciphers import aes_key, bytes_given
from framekit.codec.support import Unfit


def hmac_code(data: bytes | bytearray, key: Any, digest: str, size: int) -> int:
    """The number of the first `size` bytes of the HMAC (RFC 2104). Raises ValueError for a key that is no bytes."""
    return int.from_bytes(hmac.digest(bytes_given(key, "key"), data, digest)[:size], "big")


def first_bytes(code: Any, size: int) -> int:
    """The number of the first `size` bytes of a code. Raises ValueError for a code that is no bytes, or fewer."""
    data = bytes_given(code, "code")
    if len(data) < size:
        raise Unfit(f"a code of {len(data)} bytes does not have {size}")
    return int.from_bytes(data[:size], "big")


def is_same_code(found: int, wanted: int, size: int) -> bool:
    """Whether two codes of `size` bytes are the same; the time it takes tells nothing of how far they are."""
    return hmac.compare_digest(found.to_bytes(size, "big"), wanted.to_bytes(size, "big"))


def cmac_code(data: bytes | bytearray, key: Any, size: int) -> int:
    """The number of the first `size` bytes of the AES-CMAC (RFC 4493). Raises ValueError for a wrong key."""
    from cryptography.hazmat.primitives.ciphers.algorithms import AES
    from cryptography.hazmat.primitives.cmac import CMAC

    run = CMAC(AES(aes_key(key)))
    run.update(bytes(data))
    return int.from_bytes(run.finalize()[:size], "big")
