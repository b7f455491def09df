"""Encrypt and decrypt content, and compute codes with a key.

`codec/python/codings.py` and `codec/checks.py` refer to these functions by name. HMAC uses the standard library;
everything else uses the optional library `cryptography`, which is imported on first use, so that framekit works without
it.
"""

from __future__ import annotations

import hmac
from collections.abc import Callable
from hmac import compare_digest
from typing import Any

from framekit.codec.stuffing import Opened
from framekit.codec.support import Unfit


def cipher_of(cipher: str, key: Any, iv: Any) -> Any:
    """Return the cipher object of the library. Raises ValueError, without the key in its message."""
    from cryptography.hazmat.primitives.ciphers import Cipher, algorithms, modes

    key, iv = aes_key(key), bytes_given(iv, "iv")
    mode = {"aes-cbc": modes.CBC, "aes-ctr": modes.CTR, "aes-gcm": modes.GCM}[cipher]
    if not (8 <= len(iv) <= 128 if cipher == "aes-gcm" else len(iv) == 16):
        raise Unfit(f"an iv of {len(iv)} bytes is none for {cipher}")
    return Cipher(algorithms.AES(key), mode(iv))


def aes_key(value: Any) -> bytes:
    """Return an AES key as bytes. Raises ValueError, without the key in its message."""
    key = bytes_given(value, "key")
    if len(key) not in (16, 24, 32):
        raise Unfit(f"a key of {len(key)} bytes is none of 16, 24 or 32")
    return key


def aes(key: Any, data: Any, iv: Any = bytes(16)) -> bytes:
    """Encrypt whole blocks in CBC mode; for a single block and no initial value this is AES itself.

    Raises ValueError, without the key in its message.
    """
    run = cipher_of("aes-cbc", key, iv).encryptor()
    return bytes(run.update(padded(bytes_given(data, "data"), "none")) + run.finalize())


def bytes_given(value: Any, name: str) -> bytes:
    """Return a value that must be bytes. Raises ValueError, without the value in its message."""
    if not isinstance(value, (bytes, bytearray)):
        raise Unfit(f"{name} is not known" if value is None else f"the value for {name} is no bytes")
    return bytes(value)


def padded(data: bytes, pad: str) -> bytes:
    """Return the content padded to whole blocks of 16 bytes.

    Raises ValueError for incomplete blocks without padding.
    """
    rest = 16 - len(data) % 16
    if pad == "none":
        if rest != 16:
            raise Unfit(f"{len(data)} bytes are no whole blocks of 16")
        return data
    return data + (bytes((rest,)) * rest if pad == "pkcs7" else b"\x80" + bytes(rest - 1))


def unpadded(data: bytes, pad: str) -> bytes:
    """Return the content without its padding. Raises ValueError for an invalid padding."""
    if pad == "none":
        return data
    plain = data[: -data[-1]] if pad == "pkcs7" and data else data.rstrip(b"\0")[:-1]
    if not data or padded(plain, pad) != data:
        raise Unfit("the content is not filled up as the padding says")
    return plain


def with_tag(cipher: str, data: bytes, key: Any, iv: Any, also: Any) -> tuple[bytes, bytes]:
    """Return the encrypted content and its whole tag."""
    run = cipher_of(cipher, key, iv).encryptor()
    run.authenticate_additional_data(bytes_given(also, "also"))
    return run.update(data) + run.finalize(), run.tag


def encipher(
    data: bytes | bytearray, cipher: str, pad: str, tag: int, clear: int, key: Any, iv: Any, also: Any = b""
) -> bytes:
    """Return the encrypted content, after the first `clear` bytes and before the tag. Raises ValueError."""
    start, plain = parted(bytes(data), clear)
    if tag:
        wire, whole = with_tag(cipher, plain, key, iv, also)
        return start + wire + whole[:tag]
    run = cipher_of(cipher, key, iv).encryptor()
    plain = padded(plain, pad) if cipher == "aes-cbc" else plain
    return bytes(start + run.update(plain) + run.finalize())


def parted(data: bytes, clear: int) -> tuple[bytes, bytes]:
    """Return the clear bytes and the encrypted bytes. Raises ValueError for fewer than `clear` bytes."""
    if len(data) < clear:
        raise Unfit(f"{len(data)} bytes are not the {clear} that stand as they are")
    return data[:clear], data[clear:]


def opened(
    raw: bytes, cipher: str, pad: str, tag: int, clear: int, key: Any, iv: Any, also: Any = b""
) -> tuple[bytes, bytes, bytes]:
    """Return the decrypted content, the expected tag and the received tag. Raises ValueError."""
    start, raw = parted(raw, clear)
    wire, found = (raw[:-tag], raw[-tag:]) if tag else (raw, b"")
    if tag and len(raw) < tag:
        raise Unfit(f"{len(raw)} bytes have no room for a tag of {tag}")
    if cipher == "aes-cbc" and (len(raw) % 16 or (pad != "none" and not raw)):
        raise Unfit(f"{len(raw)} bytes are no whole blocks of 16")
    run = cipher_of(cipher, key, iv).decryptor()
    if not tag:
        return start + unpadded(bytes(run.update(wire) + run.finalize()), pad), b"", b""
    plain = bytes(run.update(wire))
    return start + plain, with_tag(cipher, plain, key, iv, also)[1][:tag], found


def decipher(
    data: bytes | bytearray, cipher: str, pad: str, tag: int, clear: int, key: Any, iv: Any, also: Any = b""
) -> bytes:
    """Return the decrypted content. Raises ValueError for a wrong tag or padding, and for incomplete blocks."""
    plain, wanted, found = opened(bytes(data), cipher, pad, tag, clear, key, iv, also)
    if not compare_digest(wanted, found):
        raise Unfit("the tag is wrong")
    return plain


def open_ciphered(
    raw: bytes, cipher: str, pad: str, tag: int, clear: int, given: Callable[[], tuple[Any, ...]]
) -> Opened:
    """Decrypt carefully; the content is returned even if its tag is wrong.

    `given` returns key, iv and additional data.
    """
    try:
        values = given()
        cipher_of(cipher, *values[:2])
        bytes_given(b"".join(values[2:]), "also")
    except (ValueError, LookupError, TypeError, ArithmeticError, AttributeError):
        return b"", [0], "value", "a key and an iv that fit"
    try:
        plain, wanted, found = opened(raw, cipher, pad, tag, clear, *values)
    except ValueError:
        return b"", [0], "constant"
    if not compare_digest(wanted, found):
        bad = len(raw) - tag
        places = [*range(len(plain)), len(raw), bad]
        return plain, places, "check", "the tag made with the key", found.hex(" ").upper()
    return plain, [*range(len(plain)), len(raw)], ""


# ---- codes made with a key ---------------------------------------------------------------------------------


def hmac_code(data: bytes | bytearray, key: Any, digest: str, size: int) -> int:
    """Return the first `size` bytes of the HMAC (RFC 2104) as a number.

    Raises ValueError for a key that is not bytes.
    """
    return int.from_bytes(hmac.digest(bytes_given(key, "key"), data, digest)[:size], "big")


def first_bytes(code: Any, size: int) -> int:
    """Return the first `size` bytes of a code as a number.

    Raises ValueError for a code that is not bytes, or too short.
    """
    data = bytes_given(code, "code")
    if len(data) < size:
        raise Unfit(f"a code of {len(data)} bytes does not have {size}")
    return int.from_bytes(data[:size], "big")


def is_same_code(found: int, wanted: int, size: int) -> bool:
    """Return whether two codes of `size` bytes are equal, in constant time."""
    return hmac.compare_digest(found.to_bytes(size, "big"), wanted.to_bytes(size, "big"))


def cmac_code(data: bytes | bytearray, key: Any, size: int) -> int:
    """Return the first `size` bytes of the AES-CMAC (RFC 4493) as a number. Raises ValueError for an invalid key."""
    from cryptography.hazmat.primitives.ciphers.algorithms import AES
    from cryptography.hazmat.primitives.cmac import CMAC

    run = CMAC(AES(aes_key(key)))
    run.update(bytes(data))
    return int.from_bytes(run.finalize()[:size], "big")
